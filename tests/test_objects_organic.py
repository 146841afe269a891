"""Teeth, bust and hand: closed meshes with the shapes that their names promise."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects import DIAMETER_MM, HEIGHT_MM, bust, hand, teeth
from fringe3d.simulate.objects._implicit import capsule, carved, ellipsoid, mesh_of, union, within

Floats = NDArray[np.float64]
Builder = Callable[..., Mesh]

BUILDERS: tuple[Builder, ...] = (teeth, bust, hand)
RESOLUTION_MM = {teeth: 0.25, bust: 0.5, hand: 0.5}
"""mm; 0.25 mm tells neighbouring teeth apart, the others have no gaps."""

ABOVE_GUMS_MM = 18.0
"""mm; higher than the gum between two teeth, lower than the pits of the molars."""


@pytest.fixture(scope="module")
def built() -> dict[Builder, Mesh]:
    return {make: make(resolution_mm=RESOLUTION_MM[make]) for make in BUILDERS}


def solid_of(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def off_surface_mm(points: Floats, mesh: Mesh) -> Floats:
    """Return distances of points from the tangent planes at the nearest vertices."""
    nearest = KDTree(mesh.vertices_mm).query(points)[1]
    normals = solid_of(mesh).vertex_normals[nearest]
    return np.asarray(np.abs(((points - mesh.vertices_mm[nearest]) * normals).sum(axis=1)))


def parts_above(mesh: Mesh, level_mm: float) -> list[Floats]:
    """Return the vertices of each connected part above a level."""
    edges = mesh.faces[(mesh.vertices_mm[mesh.faces, 2] > level_mm).all(axis=1)][:, [0, 1, 1, 2]]
    start, end = edges.reshape(-1, 2).T
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(mesh.n_vertices,) * 2)
    labels = connected_components(graph, directed=False)[1]
    used = np.unique(start)
    return [mesh.vertices_mm[used[labels[used] == label]] for label in np.unique(labels[used])]


def loops_at(mesh: Mesh, y_mm: float) -> int:
    """Return how many closed curves a plane across the fingers cuts."""
    section = solid_of(mesh).section(plane_origin=[0, y_mm, 0], plane_normal=[0, 1, 0])
    assert section is not None
    return len(section.discrete)


@pytest.mark.parametrize("make", BUILDERS)
def test_mesh_is_closed_and_faces_outwards(make: Builder, built: dict[Builder, Mesh]) -> None:
    solid = solid_of(built[make])
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.body_count == 1
    # Less than the cylinder, more than a sheet of paper.
    cylinder = np.pi / 4 * DIAMETER_MM**2 * HEIGHT_MM
    assert 0.1 * cylinder < solid.volume < 0.5 * cylinder


@pytest.mark.parametrize("make", BUILDERS)
@pytest.mark.parametrize("resolution_mm", [0.9, 1.2])
def test_coarse_mesh_is_closed_too(make: Builder, resolution_mm: float) -> None:
    solid = solid_of(make(resolution_mm=resolution_mm))
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0


@pytest.mark.parametrize("make", BUILDERS)
def test_stands_on_the_table_inside_the_cylinder(make: Builder, built: dict[Builder, Mesh]) -> None:
    vertices = built[make].vertices_mm
    assert np.hypot(vertices[:, 0], vertices[:, 1]).max() <= DIAMETER_MM / 2
    assert vertices[:, 2].min() == 0.0
    assert vertices[:, 2].max() <= HEIGHT_MM
    # It fills the cylinder rather than hide in it.
    assert np.ptp(vertices, axis=0)[:2].max() > 0.85 * DIAMETER_MM


@pytest.mark.parametrize("make", BUILDERS)
def test_bottom_is_flat(make: Builder, built: dict[Builder, Mesh]) -> None:
    solid = solid_of(built[make])
    at_table = (solid.triangles[:, :, 2] == 0.0).all(axis=1)
    np.testing.assert_allclose(solid.face_normals[at_table], [[0, 0, -1]] * at_table.sum())
    assert solid.area_faces[at_table].sum() > 0.03 * solid.area


@pytest.mark.parametrize("make", BUILDERS)
def test_same_arguments_give_the_same_bytes(make: Builder) -> None:
    first, second = make(resolution_mm=1.0), make(resolution_mm=1.0)
    assert first.vertices_mm.tobytes() == second.vertices_mm.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


@pytest.mark.parametrize(("make", "size"), [(teeth, "width_mm"), (bust, "length_mm")])
def test_half_the_size_at_half_the_resolution_is_the_same_shape(make: Builder, size: str) -> None:
    whole, half = make(**{size: 70.0}, resolution_mm=1.2), make(**{size: 35.0}, resolution_mm=0.6)
    assert np.ptp(whole.vertices_mm, axis=0) == pytest.approx(
        2 * np.ptp(half.vertices_mm, axis=0), abs=1e-3
    )
    assert off_surface_mm(2 * half.vertices_mm, whole).mean() < 1e-3


@pytest.mark.parametrize("make", [bust, hand])
def test_coarse_vertices_lie_on_the_fine_surface(make: Builder, built: dict[Builder, Mesh]) -> None:
    coarse = make(resolution_mm=1.0).vertices_mm
    away = off_surface_mm(coarse[coarse[:, 2] > 1.0], built[make])
    # Curvature within half a fine triangle, at radii above 1 mm: 0.25**2 / 2 mm.
    assert np.median(away) < 0.005
    assert np.quantile(away, 0.95) < 0.25**2 / 2


def test_bust_is_symmetric(built: dict[Builder, Mesh]) -> None:
    mirrored = built[bust].vertices_mm * [-1, 1, 1]
    away = off_surface_mm(mirrored[mirrored[:, 2] > 1.0], built[bust])
    assert np.quantile(away, 0.95) < 0.25**2 / 2


def test_only_a_regular_arch_is_symmetric() -> None:
    def asymmetry_mm(irregularity: float) -> float:
        mesh = teeth(irregularity=irregularity, resolution_mm=0.6)
        high = mesh.vertices_mm[mesh.vertices_mm[:, 2] > ABOVE_GUMS_MM]
        return float(np.mean(off_surface_mm(high * [-1, 1, 1], mesh)))

    assert asymmetry_mm(0.0) < 0.05 < asymmetry_mm(1.0)


def test_seed_moves_teeth_but_not_the_base() -> None:
    first, second = (teeth(seed=seed, resolution_mm=0.8).vertices_mm for seed in (1, 2))
    low, low_too = (v[v[:, 2] < 5.0] for v in (first, second))
    np.testing.assert_array_equal(low, low_too)
    assert first.shape != second.shape or not np.array_equal(first, second)


def test_fourteen_crowns_with_gaps(built: dict[Builder, Mesh]) -> None:
    crowns = parts_above(built[teeth], ABOVE_GUMS_MM)
    assert len(crowns) == 14
    middles = np.array([crown.mean(axis=0) for crown in crowns])
    assert (middles[:, 0] < 0).sum() == 7
    # Incisors look towards -y, where the cameras are.
    assert np.abs(middles[middles[:, 1].argsort()[:4], 0]).max() < 12.0


def test_molars_have_pits_between_their_cusps(built: dict[Builder, Mesh]) -> None:
    crowns = parts_above(built[teeth], ABOVE_GUMS_MM)
    molars = sorted(crowns, key=lambda crown: float(np.ptp(crown[:, :2], axis=0).prod()))[-4:]
    for molar in molars:
        middle = (molar.min(axis=0) + molar.max(axis=0))[:2] / 2
        near = np.hypot(*(molar[:, :2] - middle).T) < 1.2
        assert 1.0 < molar[:, 2].max() - molar[near, 2].min() < 3.5


def test_teeth_have_steep_walls_and_undercuts(built: dict[Builder, Mesh]) -> None:
    solid = solid_of(built[teeth])
    crown = (solid.triangles[:, :, 2] > ABOVE_GUMS_MM).all(axis=1)
    steepness = np.degrees(np.arccos(np.clip(solid.face_normals[crown, 2], -1, 1)))
    area = solid.area_faces[crown]
    assert area[steepness > 60].sum() > 0.4 * area.sum()
    assert 0.02 * area.sum() < area[steepness > 95].sum() < 0.4 * area.sum()


def test_teeth_are_brighter_than_gums(built: dict[Builder, Mesh]) -> None:
    albedo, z = built[teeth].albedo, built[teeth].vertices_mm[:, 2]
    assert albedo is not None
    np.testing.assert_allclose(albedo[z > ABOVE_GUMS_MM], 0.8, rtol=1e-6)
    np.testing.assert_allclose(albedo[z < 10.0], 0.55, rtol=1e-6)


def test_face_has_its_features_where_they_belong(built: dict[Builder, Mesh]) -> None:
    x, y, z = built[bust].vertices_mm.T
    nose = int(z.argmax())
    assert abs(x[nose]) < 0.5
    profile = (np.abs(x) < 0.6) & (z > 10.0)

    def height(at_mm: float, side_mm: float = 0.0) -> float:
        near = np.hypot(x - side_mm, y - y[nose] - at_mm) < 0.8
        return float(z[near].max())

    # Chin, lips and forehead lie behind the nose; eyes behind brow and bridge.
    assert max(height(-9.5), height(-5.0)) < z[nose] - 2.0
    assert height(12.0) < z[nose] - 1.0
    for side in (-5.0, 5.0):
        assert height(6.0, side) < height(9.5, side)
        assert height(6.0, side) < height(6.0) - 2.0
    # The tip of the nose is a third of the head up from the chin.
    chin = y[profile & (y < y[nose] - 8.0) & (z > z[nose] - 9.0)].min()
    assert 0.25 < (y[nose] - chin) / (y.max() - chin) < 0.42


def test_hand_has_four_fingers_and_a_thumb_on_its_left(built: dict[Builder, Mesh]) -> None:
    assert loops_at(built[hand], 14.0) == 4
    assert loops_at(built[hand], 35.0) == 1
    assert loops_at(built[hand], -20.0) == 1
    low = built[hand].vertices_mm[built[hand].vertices_mm[:, 1] < 10.0]
    assert low[low[:, 0].argmin(), 1] > 0.0


@pytest.mark.parametrize("make", BUILDERS)
@pytest.mark.parametrize("resolution_mm", [0.0, -1.0, 5.0, float("nan")])
def test_useless_resolution_is_refused(make: Builder, resolution_mm: float) -> None:
    with pytest.raises(ValueError, match=rf"expected .*resolution_mm.*found {resolution_mm:g}"):
        make(resolution_mm=resolution_mm)


@pytest.mark.parametrize(
    "make",
    [
        partial(teeth, width_mm=-1.0),
        partial(teeth, gap_mm=3.0),
        partial(teeth, irregularity=-0.1),
        partial(bust, length_mm=-70.0),
        partial(hand, length_mm=0.0),
    ],
)
def test_useless_size_is_refused(make: Builder) -> None:
    with pytest.raises(ValueError, match=r"expected .*found"):
        make()


def test_mesh_of_a_ball_is_on_the_ball() -> None:
    center = np.array([1.0, -2.0, 3.0])
    mesh = mesh_of(
        lambda points: np.linalg.norm(points - center[:, None], axis=0) - 5.0,
        center - 5.0,
        center + 5.0,
        0.5,
    )
    above = mesh.vertices_mm[mesh.vertices_mm[:, 2] > 0.5]
    assert np.abs(np.linalg.norm(above - center, axis=1) - 5.0).max() < 1e-6
    # A ball without the cap of 2 mm below the table.
    expected = 4 / 3 * np.pi * 5**3 - np.pi * 2**2 * (3 * 5 - 2) / 3
    assert solid_of(mesh).volume == pytest.approx(expected, rel=0.01)


def test_capsule_equals_the_hull_of_many_balls() -> None:
    points = np.random.default_rng(5).uniform(-6, 6, (3, 400))
    start, end = np.array([-2.0, 0.5, 1.0]), np.array([3.0, -1.0, 0.0])
    shares = np.linspace(0, 1, 4001)
    centers = start + shares[:, None] * (end - start)
    balls = np.linalg.norm(points.T[:, None] - centers, axis=2) - (2.0 - 1.2 * shares)
    found = capsule(points, start, end, 2.0, 0.8)
    np.testing.assert_allclose(found, balls.min(axis=1), atol=1e-5)


def test_blend_adds_at_most_a_quarter() -> None:
    points = np.random.default_rng(6).uniform(-4, 4, (3, 1000))
    one, other = ellipsoid(points, (0, 0, 0), (2, 2, 2)), ellipsoid(points, (2, 0, 0), (1, 2, 3))
    sharp, blended = np.minimum(one, other), union(one, other, 0.8)
    assert (blended <= sharp).all()
    assert (blended >= sharp - 0.8 / 4 - 1e-12).all()
    assert (carved(one, other, 0.8) >= one).all()


def test_within_is_exact_inside_and_a_bound_outside() -> None:
    points = np.random.default_rng(7).uniform(-40, 40, (3, 4000))
    whole = partial(ellipsoid, center=(0, 0, 0), radii=(3, 3, 3))
    bounded = within(whole, points, (-14, -14, -14), (14, 14, 14))
    inside = (np.abs(points) <= 14).all(axis=0)
    np.testing.assert_array_equal(bounded[inside], whole(points)[inside])
    assert (bounded[~inside] <= whole(points)[~inside]).all()
    assert (bounded[~inside] > 0).all()
