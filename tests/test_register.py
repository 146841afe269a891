"""Registration against closed forms: spheres on a table whose axis and angles are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ball_views import AXIS, BALLS, ball_views, camera, rays_of, seen_balls
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.geometry import project
from fringe3d.model import Fate, RigidTransform, SurfaceView, TableAxis, TablePosition
from fringe3d.register import (
    AdjustOptions,
    RegisterOptions,
    TablePrior,
    adjust,
    axis_of_motions,
    axis_of_points,
    border_loops,
    closed_holes,
    fuse,
    land_on,
    mesh_of,
    motion_of,
    register,
    split_edges,
    surface_view,
    vector_of,
    with_edges,
)

TWELVE = tuple(range(0, 360, 30))
MIDDLE = np.array([0.0, 0.0, 2.0])


def shaken(
    poses: list[RigidTransform], seed: int, *, rad: float, mm: float
) -> list[RigidTransform]:
    rng = np.random.default_rng(seed)
    moves = [np.r_[rng.normal(0, rad, 3), rng.normal(0, mm, 3)] for _ in poses]
    return [poses[0]] + [
        motion_of(m, MIDDLE) @ p for m, p in zip(moves[1:], poses[1:], strict=True)
    ]


def errors(found: tuple[RigidTransform, ...], true: list[RigidTransform]) -> np.ndarray:
    pairs = zip(found, true, strict=True)
    return np.array([vector_of(f @ t.inverse(), MIDDLE) for f, t in pairs])


# The table's axis


def test_a_ball_on_a_table_tells_its_axis() -> None:
    """Places of a ball, in closed form; with and without angles; turning back reverses it."""
    angles = np.radians([0, 35, 80, 150, 200, 290])
    true = TableAxis(point_mm=[12.0, -3.0, 40.0], direction=[0.1, -0.3, 0.9])
    places = np.array([true.turn(a).apply([30.0, 5.0, 60.0]) for a in angles])
    for told, sense in ((None, 1), (angles, 1), (-angles, -1)):
        found = axis_of_points(places, angles=told)
        np.testing.assert_allclose(found.direction, sense * true.direction, atol=1e-9)
        np.testing.assert_allclose(found.point_mm, true.point_mm, atol=1e-8)
    with pytest.raises(EmptyResultError, match="at least 3 places"):
        axis_of_points(np.outer(np.arange(4), [1.0, 2, 3]))


def test_poses_of_a_board_tell_the_axis_of_the_table() -> None:
    """Board poses on a table of known axis; noise of 0.01 deg and 5 um stays as small."""
    rng = np.random.default_rng(1)
    board = RigidTransform(rotation=Rotation.from_euler("xyz", [0.4, 0.2, 1.0]).as_matrix(),
                           translation=[20, 5, 10])  # fmt: skip
    angles = np.radians([0, 40, 80, 200])
    poses = [AXIS.turn(a) @ board for a in angles]
    noisy = [motion_of(np.r_[rng.normal(0, 2e-4, 3), rng.normal(0, 5e-3, 3)],
                       pose.translation) @ pose for pose in poses]  # fmt: skip
    for series, tolerance in ((poses, 1e-9), (noisy, 0.03)):
        pairs = [(a, b) for b in range(4) for a in range(b)]
        motions = [series[b] @ series[a].inverse() for a, b in pairs]
        found = axis_of_motions(motions, angles=[angles[b] - angles[a] for a, b in pairs])
        assert found.direction @ AXIS.direction > 1 - 1e-6
        assert found.distance_mm(AXIS.point_mm) < tolerance
    with pytest.raises(EmptyResultError, match="turned by more than 3 deg"):
        axis_of_motions([AXIS.turn(0.01)])


# Views


def test_normals_of_balls_point_from_their_centres() -> None:
    device = camera()
    ball = np.array([[0.0, 0, 0, 12.0]])
    points = seen_balls(device, ball)
    view = surface_view("ball", device, points, np.full(device.shape, 0.01))
    good = np.isfinite(view.normals[..., 0])
    true = points / 12.0
    facing = (true * (device.center_world - points)).sum(-1) / 300 > 0.5  # up to 60 deg
    # A plane through 5 x 5 points of a sphere stands square to it but for their unequal spacing.
    angle = np.degrees(np.arccos(np.clip((view.normals * true).sum(-1)[good & facing], -1, 1)))
    assert (good & facing).sum() > 2000
    assert np.percentile(angle, 99) < 1.5
    with pytest.raises(EmptyResultError, match="ball: expected a view with at least"):
        surface_view("ball", device, np.full_like(points, np.nan), np.full(device.shape, 0.01))


def test_points_without_neighbours_are_put_together() -> None:
    """Gray code alone leaves one point in sixteen pixels: normals come from coarser pixels."""
    device = camera((192, 256))
    points = seen_balls(device, np.array([[0.0, 0, 0, 12.0]]))
    sparse = np.full_like(points, np.nan)
    sparse[1::4, 2::4] = points[1::4, 2::4]
    view = surface_view("sparse", device, sparse, np.full(device.shape, 0.01))
    assert view.camera.shape == (48, 64)
    good = np.isfinite(view.normals[..., 0])
    assert good.sum() > 0.8 * np.isfinite(sparse[..., 0]).sum()
    np.testing.assert_allclose(np.linalg.norm(view.points_mm[good], axis=-1), 12.0, atol=1e-9)
    # The pixel of the coarse camera is where its square of pixels was.
    pixels = project(view.camera, view.points_mm[good])
    rows, cols = np.nonzero(good)
    assert np.abs(pixels - np.stack([cols, rows], axis=-1)).max() < 0.5


def test_points_beside_a_surface_land_at_their_distance() -> None:
    """Points 0.2 mm outside and inside a sphere; hidden ones are behind, others in front."""
    device = camera((192, 256))
    view = surface_view("b", device, seen_balls(device, np.array([[0.0, 0, 0, 12.0]])),
                        np.full(device.shape, 0.01))  # fmt: skip
    towards = (device.center_world / 300.0) @ Rotation.random(200, rng=1).as_matrix()
    near = towards[towards @ (device.center_world / 300) > 0.6]
    for radius in (12.2, 12.0, 11.8):
        landed = land_on(view, radius * near, near)
        # The ray of a point 0.2 mm above, 53 deg beside the normal, meets the sphere 0.27 mm
        # aside: its tangent there is 0.27^2 / (2 * 12 mm) = 3 um farther away.
        np.testing.assert_allclose(landed.distance_mm, radius - 12.0, atol=4e-3)
        np.testing.assert_allclose((landed.normals * near).sum(-1), 1, atol=2e-3)
        assert (np.sign(landed.behind_mm) == np.sign(12.0 - radius)).mean() > 0.95 or radius == 12
    assert np.isnan(land_on(view, 12.0 * near, -near).distance_mm).all()  # a thin wall's other side


def test_past_an_outline_nothing_is_looked_through() -> None:
    """Points 5 mm before a sphere that was seen but at one pixel: beside that pixel the camera may
    have seen past whatever stands there, elsewhere it looked through the point.
    """
    device = camera((96, 128))
    points = seen_balls(device, np.array([[0.0, 0, 0, 12.0]]))
    row, col = 48, 64
    before = points - 5.0 * rays_of(device)
    quads = np.stack([before[row - 5, col], before[row, col] + 1e-3, before[row + 5, col]])
    points[row, col] = np.nan
    view = surface_view("b", device, points, np.full(device.shape, 0.01))
    behind = land_on(view, quads).behind_mm
    np.testing.assert_allclose(behind[[0, 2]], -5.0, atol=0.1)
    assert np.isnan(behind[1])
    hidden = land_on(view, before[row, col : col + 1] + 10.0 * rays_of(device)[row, col]).behind_mm
    np.testing.assert_allclose(hidden, 5.0, atol=0.1)


# All views at once


@pytest.fixture(scope="module")
def views_and_poses() -> tuple[list[SurfaceView], list[RigidTransform]]:
    return ball_views(TWELVE, sigma_mm=0.005, seed=3)


def test_the_adjustment_finds_the_axis_of_the_table(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    views, true = views_and_poses
    start = shaken(true, 5, rad=0.01, mm=0.2)
    found = adjust(views, start, AdjustOptions(table=TablePrior(), n_samples=1500))
    assert found.table is not None
    off = errors(found.body_from_view, true)
    # The noise leaves far less than 1 um; pixels 0.3 mm apart, up to 1 mm on the slopes of balls
    # of 4 to 7 mm radius, leave what interpolation between them misses.
    assert np.abs(off[:, 3:]).max() < 5e-3
    assert np.abs(off[:, :3]).max() < 2e-4
    assert found.table.axis.direction @ AXIS.direction > 1 - 1e-8
    assert AXIS.distance_mm(found.table.middle_mm) < 3e-3
    assert found.noise_factor == pytest.approx(1.0, abs=0.15)
    assert found.closure_mm < 5e-3
    before = np.median([r.rms_mm for r in found.before])
    after = np.median([r.rms_mm for r in found.after])
    assert after < 0.1 * before
    assert after == pytest.approx(0.005 * np.hypot(1, 2 / 3), rel=0.3)  # two views, four pixels
    turned = np.remainder(found.table.angles - np.radians(TWELVE) + np.pi, 2 * np.pi) - np.pi
    assert np.abs(turned).max() < 3e-4


def test_angles_of_a_table_that_nobody_read_are_found(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    views, true = views_and_poses
    start = shaken(true, 6, rad=0.01, mm=0.2)
    wrong = [replace(v, position=TablePosition(angle=0.3 * k)) for k, v in enumerate(views)]
    found = adjust(
        wrong, start, AdjustOptions(table=TablePrior(angle_sigma=math.inf), n_samples=1500)
    )
    assert found.table is not None
    turned = found.table.angles - found.table.angles[0] - np.radians(TWELVE)
    assert np.abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi).max() < 1e-3
    assert np.abs(errors(found.body_from_view, true)[:, 3:]).max() < 5e-3


def test_a_table_that_turns_the_other_way_has_the_opposite_axis(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    """A flipped sign of the angles must flip the axis, never be absorbed."""
    views, true = views_and_poses
    flipped = [replace(v, position=TablePosition(angle=-math.radians(a)))
               for v, a in zip(views, TWELVE, strict=True)]  # fmt: skip
    found = adjust(flipped, true, AdjustOptions(table=TablePrior(), n_samples=1000))
    assert found.table is not None
    assert found.table.axis.direction @ AXIS.direction < -0.999999


def test_sampled_noise_has_the_predicted_covariance() -> None:
    """The spread of the poses over independent noises, against what one adjustment says of it."""
    spread, told = [], []
    for seed in range(24):
        views, true = ball_views((0, 40, 80), sigma_mm=0.02, seed=100 + seed, shape=(48, 64))
        found = adjust(views, true, AdjustOptions(n_samples=100_000))
        spread.append(errors(found.body_from_view, true)[1:].ravel())
        told.append(np.sqrt(np.diagonal(found.covariance))[6:])
    ratio = np.std(spread, axis=0, ddof=1) / np.mean(told, axis=0)
    # 24 draws tell a standard deviation to 15 %; twelve numbers are averaged. The surface on which
    # a point lands is a mean of four pixels, which the prediction does not credit: it is cautious.
    assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.25


def test_the_first_view_stays_and_free_views_need_no_table(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    views, true = views_and_poses
    found = adjust(views[:4], shaken(true[:4], 7, rad=0.01, mm=0.2))
    assert found.table is None
    np.testing.assert_array_equal(found.body_from_view[0].rotation, np.eye(3))
    assert np.abs(errors(found.body_from_view, true[:4])[:, 3:]).max() < 4e-3
    assert not found.covariance[:6].any()


def test_what_is_asked_for_must_be_there(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    views, _ = views_and_poses
    with pytest.raises(MethodError, match="at least 2 views"):
        register(views[:1])
    unread = [replace(v, position=None) for v in views[:3]]
    with pytest.raises(MethodError, match="expected the angle of the table for each scan"):
        register(unread, RegisterOptions(angles="known"))


# One surface


def test_the_fused_surface_is_that_of_the_balls(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    views, true = views_and_poses
    cloud = fuse(views, true)
    counts = cloud.counts()
    assert sum(counts.values()) == sum(view.n_points for view in views)
    assert counts[Fate.KEPT] == len(cloud.points_mm)
    away = np.linalg.norm(cloud.points_mm[:, None] - BALLS[:, :3], axis=-1) - BALLS[:, 3]
    off = away[np.arange(len(away)), np.abs(away).argmin(axis=1)]
    inner = np.abs(off) < 0.1
    assert inner.mean() > 0.995
    single = np.median([np.nanmedian(v.sigma_mm) for v in views])
    many = cloud.n_views >= 6
    assert many.mean() > 0.3
    assert 1.4826 * np.median(np.abs(off[many])) < 0.6 * single
    assert abs(np.median(off)) < 2e-3  # pixels 0.26 mm apart on balls of 4 to 7 mm
    outwards = cloud.points_mm[:, None] - BALLS[:, :3]
    own = outwards[np.arange(len(away)), np.abs(away).argmin(axis=1)]
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    assert ((own * cloud.normals).sum(axis=1) > 0.8).mean() > 0.99


def test_layers_and_strays_are_dropped_with_a_reason(
    views_and_poses: tuple[list[SurfaceView], list[RigidTransform]],
) -> None:
    """A patch of one view lies 0.3 mm too high, another floats where others look through."""
    views, true = views_and_poses
    points = views[0].points_mm.copy()
    rays = rays_of(views[0].camera)
    good = np.argwhere(np.isfinite(views[0].normals[..., 0]))
    center = good[len(good) // 2]
    layer = (slice(center[0] - 5, center[0] + 6), slice(center[1] - 5, center[1] + 6))
    points[layer] -= 0.3 * rays[layer]
    stray = (slice(20, 28), slice(60, 68))
    points[stray] = views[0].camera.center_world + 270 * rays[stray]
    bad = surface_view("bad", views[0].camera, points, views[0].sigma_mm)
    cloud = fuse([bad, *views[1:]], true)
    told = cloud.fates[0]
    inside = (slice(center[0] - 2, center[0] + 3), slice(center[1] - 2, center[1] + 3))
    assert (told[inside] == Fate.OTHER_LAYER).mean() > 0.8
    assert (told[22:26, 62:66] == Fate.SEEN_THROUGH).mean() > 0.8


# Meshes


def test_holes_are_closed_and_what_has_none_stays() -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.int32)
    same = closed_holes(vertices, faces)
    assert len(same[1]) == len(faces)
    away = np.delete(faces, [5, 6, 100, 300, 301, 302, 700], axis=0)
    assert len(border_loops(away)) >= 3
    closed = closed_holes(vertices, away)
    told = trimesh.Trimesh(*closed, process=False)
    assert told.is_watertight
    assert told.is_winding_consistent
    assert told.volume == pytest.approx(ball.volume, rel=0.01)


@pytest.mark.parametrize("kind", ["poisson", "edges"])
def test_a_mesh_of_a_ball_is_closed_and_keeps_its_volume(kind: str) -> None:
    open3d = pytest.importorskip("fringe3d.register.meshing")
    try:
        library = open3d.open3d()
    except MethodError:
        pytest.skip("no open3d here")
    trimesh = pytest.importorskip("trimesh")
    from fringe3d.model import MergedCloud

    way = np.random.default_rng(2).normal(size=(6000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    n = len(way)
    cloud = MergedCloud(
        points_mm=10 * way, normals=way.astype(np.float32), sigma_mm=np.full(n, 0.004, np.float32),
        grey=np.full(n, 90, np.uint8), n_views=np.ones(n, np.uint8),
        source=np.zeros(n, np.uint16), fates=(np.full((1, n), int(Fate.KEPT), np.uint8),),
    )  # fmt: skip
    mesh = mesh_of(cloud, kind=kind, closed=True)  # type: ignore[arg-type]
    assert mesh.is_closed
    told = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert told.is_watertight
    assert told.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.01)
    other = library.geometry.TriangleMesh(library.utility.Vector3dVector(mesh.vertices_mm),
                                          library.utility.Vector3iVector(mesh.faces))  # fmt: skip
    assert other.is_edge_manifold(allow_boundary_edges=False)
    known = np.isfinite(mesh.sigma_mm)
    assert known.mean() > 0.95
    np.testing.assert_allclose(mesh.sigma_mm[known], 0.004, rtol=1e-3)
    assert abs(int(np.median(mesh.grey)) - 90) <= 1
    assert ((mesh.normals * mesh.vertices_mm).sum(axis=1) > 0).mean() > 0.99


# Edges


def test_holes_all_over_are_no_edges() -> None:
    """As from Gray code alone, where one pixel stands for several."""
    (view,), _ = ball_views((0,), sigma_mm=0.005, seed=3)
    sparse = view.points_mm.copy()
    sparse[np.random.default_rng(3).random(view.camera.shape) < 0.1] = np.nan
    holed = surface_view("holed", view.camera, sparse, view.sigma_mm)
    whole, edge = split_edges(holed)
    assert not len(edge.pixels)
    np.testing.assert_array_equal(whole.is_valid, holed.is_valid)


def test_points_beside_edges_fill_what_no_view_saw_better() -> None:
    """Balls in closed form: two pixels at each border count only where nothing else covers."""
    views, true = ball_views((0, 40, 80), sigma_mm=0.005, seed=3)
    parted = [split_edges(view) for view in views]
    inner, edges = [view for view, _ in parted], [edge for _, edge in parted]
    for view, part, edge in zip(views, inner, edges, strict=True):
        # A pixel is inside where all of 5 x 5 have a point, and a step of ten pixels is an edge.
        whole = ndimage.binary_erosion(view.is_valid, np.ones((3, 3), bool), border_value=1)
        assert not (part.is_valid & ~whole).any()
        told = np.zeros(view.camera.shape, int)
        for places in (edge.pixels, edge.unsure, np.flatnonzero(part.is_valid)):
            told.flat[places] += 1
        np.testing.assert_array_equal(told, view.is_valid)  # each point in one of the three
    cloud = fuse(inner, true)
    more = with_edges(cloud, inner, true, edges)
    n = len(cloud.points_mm)
    np.testing.assert_array_equal(more.points_mm[:n], cloud.points_mm)
    added = more.points_mm[n:]
    assert len(added) > 100
    assert sum(more.counts().values()) == sum(view.n_points for view in views)
    off = np.abs(np.linalg.norm(added[:, None] - BALLS[:, :3], axis=-1) - BALLS[:, 3]).min(axis=1)
    assert np.percentile(off, 99) < 0.05  # noise of 5 um along rays that meet the border flatly
    # A point that is off where its neighbours are not, is dropped; so nothing is off by more.
    sample = edges[0].sample
    lift = np.zeros((len(sample.points_mm), 1))
    lift[::10] = 0.3
    lifted = replace(sample, points_mm=sample.points_mm + lift * sample.normals)
    checked = with_edges(cloud, inner, true, [replace(edges[0], sample=lifted), *edges[1:]])
    left = checked.points_mm[n:]
    away = np.abs(np.linalg.norm(left[:, None] - BALLS[:, :3], axis=-1) - BALLS[:, 3]).min(axis=1)
    assert (away > 0.2).sum() == 0
    assert len(left) > 0.85 * len(added)
    # What was seen is covered: more of all points of the views than the inner ones alone cover.
    seen = np.concatenate([pose.apply(view.points_mm[view.is_valid])
                           for view, pose in zip(views, true, strict=True)])  # fmt: skip
    reach = 2 * views[0].spacing_mm
    before, after = (np.mean(np.asarray(cKDTree(c.points_mm).query(seen)[0]) < reach)
                     for c in (cloud, more))  # fmt: skip
    assert after > 0.985
    assert after > before + 0.01


def test_a_point_beside_an_edge_that_another_view_looked_through_is_dropped() -> None:
    views, true = ball_views((0, 20, 40), sigma_mm=0.005, seed=3)
    points = views[0].points_mm.copy()
    center, radius = BALLS[2, :3], BALLS[2, 3]  # the largest ball, where it faces the camera
    towards = views[0].camera.center_world - center
    top = center + radius * towards / np.linalg.norm(towards)
    col, row = np.round(project(views[0].camera, top[None])[0]).astype(int)
    patch = (slice(row - 3, row + 3), slice(col - 3, col + 3))
    points[patch] -= 8 * rays_of(views[0].camera)[patch]  # all of it lies beside its edge
    bad = surface_view("bad", views[0].camera, points, views[0].sigma_mm)
    parted = [split_edges(view) for view in (bad, *views[1:])]
    inner, edges = [view for view, _ in parted], [edge for _, edge in parted]
    cloud = with_edges(fuse(inner, true), inner, true, edges)
    told = cloud.fates[0][patch]
    assert (told == Fate.SEEN_THROUGH).mean() > 0.5
    assert (told != Fate.KEPT).all()
