"""Machined objects: closed bodies of the promised size, judged by trimesh and by closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fringe3d.simulate.mesh import FLAT, Mesh

pytest.importorskip("manifold3d")
trimesh = pytest.importorskip("trimesh")

from fringe3d.simulate.objects.balls import ball_bar, ball_bar_spheres, sphere  # noqa: E402
from fringe3d.simulate.objects.bodies import thin_wire, two_bodies  # noqa: E402
from fringe3d.simulate.objects.gauges import (  # noqa: E402
    flat_plate,
    plane,
    prism,
    step_gauge,
)
from fringe3d.simulate.objects.machined import machine_part  # noqa: E402

# Facets of SAGITTA_MM cost at most this share of a volume or an area.
FACETS = 1e-3
# Double precision of a product of a few lengths of 100 mm; outlines are cut on a grid of 1e-8 mm.
ROUNDING_MM = 1e-7
# What is asked of the vertices on a sphere.
ON_SPHERE_MM = 1e-9
# Largest distance of a facet from a cylinder or a fillet.
SAGITTA_MM = 0.002

OBJECTS: dict[str, Callable[..., Mesh]] = {
    make.__name__: make
    for make in (
        plane,
        flat_plate,
        prism,
        step_gauge,
        sphere,
        ball_bar,
        machine_part,
        two_bodies,
        thin_wire,
    )
}
VARIANTS: dict[str, Callable[[], Mesh]] = {
    **OBJECTS,
    "tilted plane": lambda: plane(tilt_deg=10.0, azimuth_deg=35.0),
    "sharp plate": lambda: flat_plate(chamfer_mm=0.0),
    "uneven steps": lambda: step_gauge(heights_mm=(8.0, 3.0, 3.0, 12.0), chamfer_mm=0.3),
    "sphere in a ring": lambda: sphere(seat_mm=3.0),
    "short ball bar": lambda: ball_bar(radius_mm=5.0, distance_mm=12.0, center_z_mm=12.0),
    "small knob": lambda: machine_part(knob_radius_mm=2.0),
    "fine wire": lambda: thin_wire(diameter_mm=0.4),
}


def judge(mesh: Mesh) -> Any:
    """Return the mesh as trimesh sees it, nothing merged or mended."""
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def facing(body: Any, direction: tuple[float, float, float]) -> Any:
    """Return a mask of the faces whose normal is a direction."""
    return body.face_normals @ np.array(direction) > 1 - 1e-12


def rounded_rectangle(width: float, depth: float, radius: float) -> float:
    """Return the area of a rectangle that is enlarged by a radius on all sides."""
    return width * depth + 2 * radius * (width + depth) + math.pi * radius**2


@pytest.mark.parametrize("make", VARIANTS.values(), ids=VARIANTS.keys())
def test_object_is_closed_and_its_normals_point_outwards(make: Callable[[], Mesh]) -> None:
    mesh = make()
    body = judge(mesh)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0
    assert mesh.albedo is None


@pytest.mark.parametrize("make", OBJECTS.values(), ids=OBJECTS.keys())
def test_default_stands_on_the_ground_inside_the_measuring_volume(
    make: Callable[[], Mesh],
) -> None:
    x, y, z = make().vertices_mm.T
    assert np.hypot(x, y).max() <= 38 + ROUNDING_MM
    assert z.max() <= 24
    assert abs(z.min()) <= ROUNDING_MM


@pytest.mark.parametrize(
    ("make", "n_bodies", "n_holes"),
    [(ball_bar, 1, 1), (machine_part, 1, 6), (two_bodies, 2, 0), (thin_wire, 1, 0)],
)
def test_object_has_its_through_holes_and_hangs_together(
    make: Callable[[], Mesh], n_bodies: int, n_holes: int
) -> None:
    body = judge(make())
    assert body.body_count == n_bodies
    assert body.euler_number == 2 * n_bodies - 2 * n_holes


@pytest.mark.parametrize(
    "mesh",
    [
        sphere(),
        sphere(radius_mm=7.3, seat_mm=2.0),
        ball_bar(),
        ball_bar(radius_mm=6.1, distance_mm=41.7),
        machine_part(),
    ],
    ids=["sphere", "sphere in a ring", "ball bar", "other ball bar", "machine part"],
)
def test_faces_of_a_sphere_lie_on_it_and_are_fine(mesh: Mesh) -> None:
    for i, (*center, radius) in enumerate(mesh.spheres):
        triangles = mesh.vertices_mm[mesh.faces[mesh.sphere_of_face == i]]
        distance = np.linalg.norm(triangles - center, axis=-1)
        assert np.abs(distance - radius).max() <= ON_SPHERE_MM
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1)
        assert edges.max() <= math.sqrt(2) * radius / 39  # the diagonal of two triangles


def test_volume_of_sphere_equals_closed_form() -> None:
    mesh = sphere(radius_mm=6.0)
    assert judge(mesh).volume == pytest.approx(4 / 3 * math.pi * 6.0**3, rel=FACETS)
    assert mesh.spheres.tolist() == [[0, 0, 6, 6]]
    assert (mesh.sphere_of_face == 0).all()


def test_ring_hides_the_sphere_below_its_rim_only() -> None:
    """The area of a zone is 2 pi r h."""
    mesh = sphere(radius_mm=10.0, seat_mm=4.0)
    body = judge(mesh)
    zone = body.area_faces[mesh.sphere_of_face == 0].sum()
    assert zone == pytest.approx(2 * math.pi * 10.0 * 16.0, rel=FACETS)
    assert body.volume > judge(sphere(radius_mm=10.0)).volume


@pytest.mark.parametrize("distance", [33.0, 50.0])
def test_ball_bar_has_the_spheres_it_names(distance: float) -> None:
    expected = ball_bar_spheres(radius_mm=8.0, distance_mm=distance, center_z_mm=14.0)
    mesh = ball_bar(radius_mm=8.0, distance_mm=distance, center_z_mm=14.0)
    assert np.array_equal(expected, mesh.spheres)
    assert np.linalg.norm(expected[1, :3] - expected[0, :3]) == distance
    areas = judge(mesh).area_faces
    for i in range(2):
        fitted = mesh.vertices_mm[np.unique(mesh.faces[mesh.sphere_of_face == i])]
        assert fitted[:, 2].max() == pytest.approx(14.0 + 8.0, abs=ON_SPHERE_MM)
        # Nothing but the cap above the post is missing: more than nine tenths are there.
        assert areas[mesh.sphere_of_face == i].sum() > 0.9 * 4 * math.pi * 8.0**2


def test_top_of_plane_is_a_plane_of_the_asked_tilt() -> None:
    mesh = plane(tilt_deg=12.0, azimuth_deg=70.0)
    tilt, azimuth = np.radians([12.0, 70.0])
    normal = (
        -math.sin(tilt) * math.cos(azimuth),
        -math.sin(tilt) * math.sin(azimuth),
        math.cos(tilt),
    )
    body = judge(mesh)
    top = facing(body, normal)
    height = mesh.vertices_mm[mesh.faces[top]] @ np.array(normal)
    assert np.ptp(height) <= 1e-12
    segment = 2 * math.acos(60 / 76)
    disc_with_flats = math.pi * 38**2 - 38**2 * (segment - math.sin(segment))
    assert body.area_faces[top].sum() == pytest.approx(disc_with_flats, rel=FACETS)


def test_chords_of_a_disc_miss_its_circle_by_less_than_two_micrometres() -> None:
    mesh = plane(width_mm=70.0, depth_mm=70.0)
    x, y, _ = mesh.vertices_mm[mesh.faces].mean(axis=1).T
    ends = mesh.vertices_mm[judge(mesh).edges_unique]
    rim = (np.hypot(ends[..., 0], ends[..., 1]) > 34.99).all(axis=1)
    chords = ends[rim & (np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) < 4.0)]
    middle = chords.mean(axis=1)
    assert len(chords) > 100
    assert np.hypot(middle[:, 0], middle[:, 1]).min() >= 35.0 - SAGITTA_MM
    assert np.hypot(x, y).max() <= 35.0


@pytest.mark.parametrize("chamfer", [0.0, 0.5, 1.5])
def test_volume_of_plate_is_a_box_less_its_chamfers(chamfer: float) -> None:
    """The cross sections are integrated from the ground up."""
    w, d, t = 50.0, 30.0, 6.0
    mesh = flat_plate(width_mm=w, depth_mm=d, thickness_mm=t, chamfer_mm=chamfer)
    c = chamfer
    waist = w * d - 2 * c**2
    # At u below the top the sides stand back by c - u, and the corners are cut by u.
    u = np.linspace(0.0, c, 2001)
    back = c - u
    section = (w - 2 * back) * (d - 2 * back) - 2 * u**2
    end = float(np.trapezoid(section, u))
    assert judge(mesh).volume == pytest.approx(waist * (t - 2 * c) + 2 * end, rel=1e-6)
    top = facing(judge(mesh), (0.0, 0.0, 1.0))
    assert judge(mesh).area_faces[top].sum() == pytest.approx((w - 2 * c) * (d - 2 * c))


@pytest.mark.parametrize("slope", [20.0, 30.0])
def test_faces_of_prism_have_the_asked_slope_and_size(slope: float) -> None:
    mesh = prism(width_mm=40.0, length_mm=30.0, slope_deg=slope, base_mm=5.0, ledge_mm=4.0)
    body = judge(mesh)
    angle = math.radians(slope)
    for side in (-1, 1):
        roof = facing(body, (side * math.sin(angle), 0.0, math.cos(angle)))
        expected = 20.0 / math.cos(angle) * 30.0
        assert body.area_faces[roof].sum() == pytest.approx(expected, rel=1e-6)
    ridge = 20.0 * math.tan(angle)
    inset = np.linspace(0.0, 1.0, 1001)
    edge = np.trapezoid([rounded_rectangle(40.0, 30.0, 4.0 - i) for i in inset], inset)
    base = 4.0 * rounded_rectangle(40.0, 30.0, 4.0) + float(edge)
    assert body.volume == pytest.approx(base + 20.0 * ridge * 30.0, rel=FACETS)
    assert body.bounds[1, 2] == pytest.approx(5.0 + ridge, abs=ROUNDING_MM)


def test_each_step_has_its_height_and_place() -> None:
    heights = (6.0, 2.5, 11.0, 11.0, 4.0)
    body = judge(step_gauge(heights_mm=heights, step_mm=7.0, depth_mm=20.0, chamfer_mm=0.0))
    x = 7.0 * (np.arange(5) - 2)
    above = np.column_stack([x, np.full(5, 1.0), np.full(5, 50.0)])
    down = np.tile([0.0, 0.0, -1.0], (5, 1))
    hits, ray, _ = body.ray.intersects_location(above, down, multiple_hits=False)
    found = np.empty(5)
    found[ray] = hits[:, 2]
    assert found == pytest.approx(heights, abs=1e-4)  # rays of single precision
    assert body.volume == pytest.approx(7.0 * 20.0 * sum(heights), rel=1e-9)


def test_chamfer_of_a_step_takes_its_outer_edge_alone() -> None:
    body = judge(step_gauge(heights_mm=(3.0, 8.0), step_mm=10.0, depth_mm=30.0, chamfer_mm=0.4))
    top = facing(body, (0.0, 0.0, 1.0))
    height = body.triangles_center[:, 2]
    area = body.area_faces
    assert area[top & (height < 5)].sum() == pytest.approx((10.0 - 0.4) * 30.0)
    assert area[top & (height > 5)].sum() == pytest.approx((10.0 - 0.8) * 30.0)


def test_bodies_have_their_heights_and_their_gap() -> None:
    mesh = two_bodies(high_mm=20.0, low_mm=6.0, gap_mm=4.5)
    left, right = sorted(judge(mesh).split(), key=lambda part: float(part.bounds[0, 0]))
    assert left.volume > right.volume > 0
    assert left.bounds[1, 2] == pytest.approx(20.0)
    assert right.bounds[1, 2] == pytest.approx(6.0)
    gap = right.bounds[0, 0] - left.bounds[1, 0]
    assert gap == pytest.approx(4.5, abs=SAGITTA_MM)
    r, top = 16.0, 0.6 * 16.0
    cone = math.pi * 6.0 / 3 * (r**2 + r * top + top**2)
    assert right.volume == pytest.approx(cone, rel=FACETS)


def test_part_has_an_undercut_above_its_base() -> None:
    """The shoulders of the T-slot look down at a floor that is 3.5 mm below."""
    body = judge(machine_part())
    down = facing(body, (0.0, 0.0, -1.0)) & (body.triangles_center[:, 2] > 9.0)
    assert body.area_faces[down].sum() > 40.0


@pytest.mark.parametrize("radius", [2.0, 4.5])
def test_knob_of_part_is_an_exact_sphere(radius: float) -> None:
    mesh = machine_part(knob_radius_mm=radius)
    assert mesh.spheres[0, 3] == radius
    ball = judge(mesh).area_faces[mesh.sphere_of_face == 0].sum()
    assert 0.9 < ball / (4 * math.pi * radius**2) < 1
    assert (mesh.sphere_of_face == FLAT).any()


@pytest.mark.parametrize("diameter", [0.5, 1.0, 2.0])
def test_cut_wire_is_as_thick_as_asked(diameter: float) -> None:
    lines = trimesh.intersections.mesh_plane(
        judge(thin_wire(diameter_mm=diameter)), (0, 1, 0), 3 * [0]
    )
    points = lines.reshape(-1, 3)
    outer = points[points[:, 0] > 12.0]
    outer = outer[np.argsort(outer[:, 0])]
    cuts = np.split(outer, np.flatnonzero(np.diff(outer[:, 0]) > 2.0) + 1)
    assert len(cuts) >= 2
    for cut in cuts:
        # The wire rises by 5 deg at most, which lengthens its cut by less than 1 %.
        assert np.ptp(cut[:, 2]) == pytest.approx(diameter, rel=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plane(width_mm=0.0), "width_mm: expected a positive size, found 0.0"),
        (lambda: plane(tilt_deg=90.0), "tilt_deg: expected 0 to 90, found 90.0"),
        (lambda: flat_plate(chamfer_mm=4.0), r"chamfer_mm: expected 0 to 4 .*, found 4.0"),
        (lambda: prism(slope_deg=0.0), "slope_deg: expected 0 to 90, found 0.0"),
        (lambda: step_gauge(heights_mm=()), "at least one step, found none"),
        (lambda: step_gauge(heights_mm=(1.0, -2.0)), "height_mm: .* found -2.0"),
        (lambda: step_gauge(heights_mm=(1.0, 1.2)), r"chamfer_mm: expected 0 to 0.1.* found 0.2"),
        (lambda: sphere(radius_mm=math.nan), "radius_mm: .* found nan"),
        (lambda: sphere(seat_mm=10.0), "seat_mm: expected 0 to 10.0 .* found 10.0"),
        (lambda: ball_bar(distance_mm=16.0), "distance_mm: expected more than 16.0 .* found 16.0"),
        (lambda: ball_bar(bar_mm=7.0), "bar_mm: expected less than 7 .* found 7.0"),
        (lambda: machine_part(knob_radius_mm=6.0), "knob_radius_mm: expected 1 to 5, found 6.0"),
        (lambda: two_bodies(rounding_mm=7.0), "rounding_mm: expected up to 6.0, found 7.0"),
        (lambda: thin_wire(diameter_mm=9.0), "diameter_mm: expected up to .* found 9.0"),
    ],
)
def test_nonsense_is_refused(make: Callable[[], Mesh], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
