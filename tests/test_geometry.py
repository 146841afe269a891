"""Projection, rays and epipolar geometry against OpenCV, closed forms and brute force."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from changed_rigs import moved_device, moved_volume
from cv_lens import cv_project
from fringe3d.geometry import (
    closest_depths,
    depth_interval,
    epipolar_curve,
    epipolar_segment,
    frustum,
    normalize,
    pixel_grid,
    project,
    rays,
    sheet_crossing,
    triangulation_angle,
    unproject,
)
from fringe3d.geometry.components import connected
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform

Floats = NDArray[np.float64]

REAL_RIG = Path(__file__).parent.parent / "examples" / "captures" / "sltk-shell-rig.toml"

PIXEL_ROUNDING = 1e-8
"""px; float64 rounding at pixel coordinates of some 1000 and condition numbers of some 100."""

INVERSE_PX = 1e-6
"""px; what `normalize` promises."""

LENGTH_ROUNDING_MM = 1e-7
"""mm; float64 rounding at 1000 mm and triangulation angles above a few degrees."""

SHEET_PX = 1e-4
"""px; the largest residual at which `sheet_crossing` may accept a crossing."""

BORDER_CUT_PX = 0.001
"""px; bulge of a distorted border between two samples of `frustum`."""

FOLD_MARGIN = 1e-3
"""Jacobian determinant (1 at the centre) that may hide between two points of a path."""

DISTORTIONS: dict[str, list[float]] = {
    "none": [],
    "4 barrel": [-0.31, 0.12, 0.002, -0.003],
    "4 pincushion": [0.25, 0.1, -0.004, 0.002],
    "5": [-0.231, 0.147, -0.0009, 0.0013, -0.032],
    "5 strong": [-0.049, 1.42, -0.0075, -0.002, -7.4],
    "8 rational": [0.4, -0.3, 0.001, 0.002, 0.05, 0.6, -0.25, 0.03],
    "12 prism": [-0.2, 0.1, 0.001, 0.001, 0.01, 0.05, 0.02, 0.01, 0.003, -0.001, 0.002, 0.004],
    "14 tilt": [
        -0.2, 0.1, 0.001, 0.001, 0.01, 0.05, 0.02, 0.01, 0.003, -0.001, 0.002, 0.004, 0.05, -0.08,
    ],
}  # fmt: skip

lenses = pytest.mark.parametrize("lens", DISTORTIONS)


def pose(turn: list[float], translation: ArrayLike) -> RigidTransform:
    return RigidTransform(rotation=Rotation.from_rotvec(turn).as_matrix(), translation=translation)


BESIDE = pose([0.02, -0.1, 0.05], [10.0, -5.0, 8.0])
TILTED = pose([0.35, -0.5, 0.2], [40.0, -70.0, 320.0])
ANY_MOTION = pose([-0.7, 1.1, 0.4], [800.0, -300.0, 150.0])


def camera(distortion: ArrayLike = (), device_from_world: RigidTransform | None = None) -> Device:
    return Device(
        name="c1",
        role="camera",
        n_rows=96,
        n_cols=128,
        focal_px=[180.0, 190.0],
        center_px=[70.0, 45.0],
        distortion=distortion,
        device_from_world=device_from_world,
    )


def projector(distortion: ArrayLike = ()) -> Device:
    return Device(
        name="projector",
        role="projector",
        n_rows=192,
        n_cols=256,
        focal_px=[420.0, 410.0],
        center_px=[120.0, 150.0],
        distortion=distortion,
        device_from_world=pose([0.05, 0.3, -0.02], [-150.0, -120.0, 30.0]),
    )


AT_ORIGIN = Device(
    name="p", role="projector", n_rows=100, n_cols=100, focal_px=[100, 100], center_px=[49.5, 49.5]
)


def lens_jacobian(device: Device, normalized: Floats) -> Floats:
    """Return d(pixel / focal) / d(normalised) from OpenCV, (n, 2, 2)."""
    points = np.concatenate([normalized, np.ones((len(normalized), 1))], axis=1)
    _, derivatives = cv2.projectPoints(
        points.reshape(-1, 1, 3),
        np.zeros((3, 1)),
        np.zeros((3, 1)),
        device.camera_matrix,
        device.distortion,
    )
    by_translation = np.asarray(derivatives).reshape(len(points), 2, -1)[:, :, 3:5]
    return np.asarray(by_translation / device.focal_px[:, None])


def visible_points(device: Device, *, n: int = 200) -> Floats:
    rng = np.random.default_rng(7)
    in_front = np.column_stack([rng.uniform(-0.35, 0.35, (n, 2)), np.ones(n)])
    points = in_front * rng.uniform(100, 900, (n, 1))
    return device.device_from_world.inverse().apply(points)


class TestProject:
    @lenses
    def test_project_equals_opencv(self, lens: str) -> None:
        device = camera(DISTORTIONS[lens], TILTED)
        points = visible_points(device)
        np.testing.assert_allclose(
            cv_project(device, points), project(device, points), atol=PIXEL_ROUNDING
        )

    def test_plus_x_moves_right_and_plus_y_moves_down(self) -> None:
        device = camera()
        here, right, down = project(device, [[5, 5, 500], [6, 5, 500], [5, 6, 500]])
        np.testing.assert_allclose([180 / 500, 0], right - here, atol=PIXEL_ROUNDING)
        np.testing.assert_allclose([0, 190 / 500], down - here, atol=PIXEL_ROUNDING)

    def test_point_on_the_axis_falls_on_the_center(self) -> None:
        axis = TILTED.inverse().apply([0, 0, 300])
        found = project(camera(DISTORTIONS["5"], TILTED), axis)
        np.testing.assert_allclose([70, 45], found, atol=PIXEL_ROUNDING)

    def test_point_behind_or_beside_the_device_is_nan(self) -> None:
        points = TILTED.inverse().apply(
            np.array([[1, 2, -300], [1, 2, 0], [np.nan, 0, 300], [1, 2, 300]])
        )
        found = np.isnan(project(camera(device_from_world=TILTED), points))
        assert found.tolist() == [[True] * 2, [True] * 2, [True] * 2, [False] * 2]

    def test_leading_axes_and_no_points_keep_their_shape(self) -> None:
        assert project(camera(), np.ones((4, 5, 3))).shape == (4, 5, 2)
        assert project(camera(), np.ones((0, 3))).shape == (0, 2)
        assert unproject(camera(), np.ones((4, 5, 2))).shape == (4, 5, 3)

    def test_pixels_do_not_depend_on_the_world_frame(self) -> None:
        device = camera(DISTORTIONS["8 rational"], TILTED)
        points = visible_points(device)
        np.testing.assert_allclose(
            project(device, points),
            project(moved_device(device, ANY_MOTION), ANY_MOTION.apply(points)),
            atol=PIXEL_ROUNDING,
        )


class TestUnproject:
    @lenses
    def test_project_of_the_ray_meets_every_pixel(self, lens: str) -> None:
        device = camera(DISTORTIONS[lens], TILTED)
        pixels = pixel_grid(device.shape)
        origin, directions = rays(device, pixels)
        found = cv_project(device, (origin + 400 * directions).reshape(-1, 3))
        np.testing.assert_allclose(pixels.reshape(-1, 2), found, atol=INVERSE_PX)

    def test_real_strong_lenses_invert_up_to_the_image_corners(self) -> None:
        for device in read_rig(REAL_RIG).devices:
            pixels = pixel_grid(device.shape)[::7, ::7]
            corner = [device.n_cols - 0.5, device.n_rows - 0.5]
            pixels = np.vstack([pixels.reshape(-1, 2), [[-0.5, -0.5], corner]])
            origin, directions = rays(device, pixels)
            found = cv_project(device, origin + 700 * directions)
            np.testing.assert_allclose(pixels, found, atol=INVERSE_PX)

    def test_directions_have_unit_length_and_look_forward(self) -> None:
        directions = unproject(camera(DISTORTIONS["5"]), pixel_grid((96, 128)))
        np.testing.assert_allclose(1, np.linalg.norm(directions, axis=-1), rtol=1e-14)
        assert (directions[..., 2] > 0).all()

    def test_plus_x_and_plus_y_turn_the_ray_right_and_down(self) -> None:
        normalized = normalize(camera(), [[70, 45], [71, 45], [70, 46]])
        expected = np.array([[0, 0], [1 / 180, 0], [0, 1 / 190]])
        np.testing.assert_allclose(expected, normalized, atol=1e-15)

    def test_pixel_grid_counts_x_along_columns(self) -> None:
        grid = pixel_grid((96, 128))
        assert grid.shape == (96, 128, 2)
        assert grid[3, 100].tolist() == [100, 3]

    def test_barrel_lens_folds_where_its_closed_form_says(self) -> None:
        # r (1 + k r**2) has its maximum 2 r / 3 at r**2 = -1 / (3 k).
        device = camera([-0.6, 0, 0, 0])
        fold = math.sqrt(1 / 1.8)
        reach = 2 / 3 * fold
        azimuths = np.linspace(0, 2 * np.pi, 50)
        around = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
        inside = normalize(device, device.center_px + 0.999 * reach * around * device.focal_px)
        beyond = normalize(device, device.center_px + 1.001 * reach * around * device.focal_px)
        radius = np.linalg.norm(inside, axis=1)
        np.testing.assert_allclose(
            0.999 * reach, radius * (1 - 0.6 * radius**2), atol=INVERSE_PX / 180
        )
        assert (radius < fold).all()
        assert np.isnan(beyond).all()

    @given(
        radial=st.tuples(*[st.floats(-1.5, 1.5)] * 3),
        tangential=st.tuples(*[st.floats(-0.02, 0.02)] * 2),
        rational=st.one_of(st.just((0.0, 0.0, 0.0)), st.tuples(*[st.floats(-1.0, 1.0)] * 3)),
    )
    @settings(max_examples=60, deadline=None)
    def test_no_fold_lies_between_the_center_and_a_finite_ray(
        self,
        radial: tuple[float, float, float],
        tangential: tuple[float, float],
        rational: tuple[float, float, float],
    ) -> None:
        device = camera([*radial[:2], *tangential, radial[2], *rational])
        pixels = np.random.default_rng(8).uniform([-60, -60], [190, 160], (150, 2))
        normalized = normalize(device, pixels)
        finite = np.isfinite(normalized).all(axis=1)
        normalized = normalized[finite]
        parts = np.linspace(0, 1, 101)[:, None, None]
        path = (parts * normalized).reshape(-1, 2)
        if len(path):
            jacobian = lens_jacobian(device, path)
            assert np.linalg.det(jacobian).min() > -FOLD_MARGIN
            assert np.trace(jacobian, axis1=1, axis2=2).min() > -FOLD_MARGIN
            rays_z1 = np.concatenate([normalized, np.ones((len(normalized), 1))], axis=1)
            np.testing.assert_allclose(pixels[finite], cv_project(device, rays_z1), atol=INVERSE_PX)

    def test_lens_that_unfolds_again_is_not_inverted_beyond_its_fold(self) -> None:
        # r (1 - 0.18 r^2 - 1.02 r^4 + 0.65 r^6) falls between 0.69 and 1.06 and rises again.
        device = camera([-0.18, -1.02, 0, 0, 0.65])
        radii = np.linspace(0, 2, 2001)
        reach = radii * (1 - 0.18 * radii**2 - 1.02 * radii**4 + 0.65 * radii**6)
        fold = radii[np.flatnonzero(np.diff(reach) < 0)[0]]
        asked = np.linspace(0.01, 1.5, 300)
        found = normalize(device, np.column_stack([70 + 180 * asked, np.full(300, 45)]))[:, 0]
        reachable = reach[radii <= fold].max()
        expected = np.interp(asked, reach[radii <= fold], radii[radii <= fold])
        clear = np.abs(asked - reachable) > 0.01
        np.testing.assert_array_equal(asked[clear] > reachable, np.isnan(found[clear]))
        known = clear & (asked < reachable)
        table_step = 1e-3
        np.testing.assert_allclose(expected[known], found[known], atol=table_step)

    def test_nan_pixel_gives_a_nan_ray(self) -> None:
        assert np.isnan(unproject(camera(DISTORTIONS["5"]), [np.nan, 3.0])).all()


class TestRays:
    def test_rays_start_at_the_projection_center(self) -> None:
        device = camera(DISTORTIONS["5"], TILTED)
        origin, _ = rays(device, [10.0, 20.0])
        np.testing.assert_allclose(np.zeros(3), TILTED.apply(origin), atol=LENGTH_ROUNDING_MM)

    def test_rays_move_with_the_world(self) -> None:
        device = camera(DISTORTIONS["5"], TILTED)
        pixels = pixel_grid((96, 128))[::9, ::9]
        origin, directions = rays(device, pixels)
        origin2, directions2 = rays(moved_device(device, ANY_MOTION), pixels)
        np.testing.assert_allclose(ANY_MOTION.apply(origin), origin2, atol=LENGTH_ROUNDING_MM)
        np.testing.assert_allclose(ANY_MOTION.rotate(directions), directions2, atol=1e-12)


def fundamental(a: Device, b: Device) -> Floats:
    """Return F with x_b^T F x_a = 0, from the essential matrix [t]x R."""
    b_from_a = b.device_from_world @ a.device_from_world.inverse()
    tx, ty, tz = b_from_a.translation
    cross = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]])
    essential = cross @ b_from_a.rotation
    inverse_a, inverse_b = np.linalg.inv(a.camera_matrix), np.linalg.inv(b.camera_matrix)
    return np.asarray(inverse_b.T @ essential @ inverse_a)


class TestEpipolarCurve:
    depths = np.linspace(200, 900, 50)

    def test_undistorted_curve_lies_on_the_line_of_the_fundamental_matrix(self) -> None:
        a, b = camera(device_from_world=BESIDE), projector()
        matrix = fundamental(a, b)
        for pixel in ([0.0, 0.0], [127.0, 30.0], [55.5, 95.0]):
            curve = epipolar_curve(a, b, pixel, self.depths)
            line = matrix @ [*pixel, 1.0]
            distance = (curve @ line[:2] + line[2]) / np.hypot(line[0], line[1])
            np.testing.assert_allclose(0, distance, atol=PIXEL_ROUNDING)

    def test_distorted_curve_is_straight_once_undistorted(self) -> None:
        a, b = camera(DISTORTIONS["5"], BESIDE), projector(DISTORTIONS["4 barrel"])
        curve = epipolar_curve(a, b, [20.0, 80.0], self.depths)
        bend = np.linalg.svd(curve - curve.mean(axis=0))[1][1]
        assert bend > 0.1
        straight = normalize(b, curve)
        deviation = np.linalg.svd(straight - straight.mean(axis=0))[1][1]
        assert deviation * 420 < INVERSE_PX

    def test_curve_does_not_depend_on_the_world_frame(self) -> None:
        a, b = camera(DISTORTIONS["5"], BESIDE), projector(DISTORTIONS["4 barrel"])
        expected = epipolar_curve(a, b, [20.0, 80.0], self.depths)
        found = epipolar_curve(
            moved_device(a, ANY_MOTION), moved_device(b, ANY_MOTION), [20.0, 80.0], self.depths
        )
        np.testing.assert_allclose(expected, found, atol=PIXEL_ROUNDING)


class TestDepthInterval:
    volume = MeasuringVolume.box([-60, -50, 350], [70, 40, 480]).intersection(
        MeasuringVolume.cylinder([0, 0, 400], [0.3, 0.1, 1.0], radius_mm=55, height_mm=120)
    )

    def test_interval_equals_brute_force_sampling(self) -> None:
        step = 0.25
        origin, directions = rays(camera(), pixel_grid((96, 128))[::6, ::6].reshape(-1, 2))
        near, far = depth_interval(origin, directions, self.volume)
        depths = np.arange(0, 800, step)
        inside = self.volume.contains(origin + depths[:, None] * directions[:, None, :])
        hit = inside.any(axis=1)
        first = depths[inside.argmax(axis=1)]
        last = depths[len(depths) - 1 - inside[:, ::-1].argmax(axis=1)]
        assert 20 < hit.sum() < hit.size - 20
        np.testing.assert_array_less(np.abs(near - first)[hit], step)
        np.testing.assert_array_less(np.abs(far - last)[hit], step)
        assert (far - near)[~hit].max() < step

    def test_axis_parallel_ray_crosses_a_box_in_closed_form(self) -> None:
        box = MeasuringVolume.box([-1, -1, 10], [1, 1, 14])
        directions = np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0]])
        near, far = depth_interval(np.zeros(3), directions, box)
        assert (near[0], far[0]) == (10, 14)
        assert (near[1:] > far[1:]).all()

    def test_ray_from_inside_starts_at_zero(self) -> None:
        box = MeasuringVolume.box([-1, -1, -1], [1, 1, 14])
        near, far = depth_interval(np.zeros(3), np.array([[0.0, 0, 1]]), box)
        assert (near.item(), far.item()) == (0, 14)

    def test_open_volume_has_an_infinite_end(self) -> None:
        half_space = MeasuringVolume(normals=[[0, 0, -1]], offsets_mm=[-5])
        near, far = depth_interval(np.zeros(3), np.array([[0.0, 0, 1]]), half_space)
        assert (near.item(), far.item()) == (5, np.inf)

    def test_nan_ray_misses_every_volume(self) -> None:
        near, far = depth_interval(np.zeros(3), np.full((1, 3), np.nan), self.volume)
        assert (near > far).all()

    def test_depths_do_not_depend_on_the_world_frame(self) -> None:
        origin, directions = rays(camera(), pixel_grid((96, 128))[::6, ::6])
        expected = depth_interval(origin, directions, self.volume)
        found = depth_interval(
            ANY_MOTION.apply(origin),
            ANY_MOTION.rotate(directions),
            moved_volume(self.volume, ANY_MOTION),
        )
        np.testing.assert_allclose(expected, found, atol=1e-6)


class TestEpipolarSegment:
    volume = MeasuringVolume.box([-80, -60, 380], [80, 60, 470])

    @pytest.mark.parametrize("bounded", [True, False])
    def test_ends_lie_on_the_boundary_of_volume_or_view(self, bounded: bool) -> None:
        a, b = camera(DISTORTIONS["5"]), projector(DISTORTIONS["4 barrel"])
        volume = self.volume if bounded else None
        pixels = pixel_grid(a.shape)[::5, ::5].reshape(-1, 2)
        origin, directions = rays(a, pixels)
        near, far = epipolar_segment(a, b, pixels, volume)
        view = frustum(b)
        bounds = view if volume is None else view.intersection(volume)
        hit = near < far
        assert hit.sum() > 20
        for depth, closed in ((near, hit & (near > 0)), (far, hit & np.isfinite(far))):
            ends = origin + depth[closed, None] * directions[closed]
            outside_mm = (ends @ bounds.normals.T - bounds.offsets_mm).max(axis=1)
            np.testing.assert_allclose(0, outside_mm, atol=LENGTH_ROUNDING_MM)
        middle = (near + np.minimum(far, near + 100)) / 2
        assert bounds.contains((origin + middle[:, None] * directions)[hit]).all()

    def test_ray_outside_the_segment_is_never_seen_by_both(self) -> None:
        a, b = camera(DISTORTIONS["5"]), projector(DISTORTIONS["4 barrel"])
        pixels = pixel_grid(a.shape)[::5, ::5].reshape(-1, 2)
        origin, directions = rays(a, pixels)
        near, far = epipolar_segment(a, b, pixels, self.volume)
        depths = np.linspace(100, 900, 400)
        points = origin + depths[:, None] * directions[:, None, :]
        seen = project(b, points)
        in_view = ((seen >= -0.5) & (seen <= [255.5, 191.5])).all(axis=-1)
        usable = in_view & self.volume.contains(points)
        within = (depths >= near[:, None] - 1e-6) & (depths <= far[:, None] + 1e-6)
        assert usable.any()
        assert within[usable].all()


class TestFrustum:
    @lenses
    def test_frustum_contains_the_ray_of_every_border_pixel(self, lens: str) -> None:
        device = camera(DISTORTIONS[lens], TILTED)
        grid = pixel_grid(device.shape)
        border = np.vstack([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
        origin, directions = rays(device, border)
        for depth in (1, 400, 9000):
            assert frustum(device).contains(origin + depth * directions).all()

    @lenses
    def test_edge_of_the_image_is_cut_by_less_than_a_thousandth_pixel(self, lens: str) -> None:
        device = camera(DISTORTIONS[lens], TILTED)
        xs, ys = np.linspace(-0.5, 127.5, 3001), np.linspace(-0.5, 95.5, 3001)
        edge = np.vstack(
            [np.column_stack(np.broadcast_arrays(xs, y)) for y in (-0.5, 95.5)]
            + [np.column_stack(np.broadcast_arrays(x, ys)) for x in (-0.5, 127.5)]
        )
        origin, directions = rays(device, edge)
        volume = frustum(device)
        beyond_rad = ((origin + directions) @ volume.normals.T - volume.offsets_mm).max()
        assert beyond_rad * 190 < BORDER_CUT_PX

    def test_undistorted_frustum_ends_at_the_image_edge(self) -> None:
        device = camera(device_from_world=TILTED)
        points = visible_points(device, n=3000)
        x, y = cv_project(device, points).T
        expected = (x >= -0.5) & (x <= 127.5) & (y >= -0.5) & (y <= 95.5)
        assert expected.tolist() == frustum(device).contains(points).tolist()
        assert 0 < expected.sum() < len(points)

    def test_nothing_behind_the_device_is_in_its_frustum(self) -> None:
        device = camera(device_from_world=TILTED)
        mirrored = 2 * device.center_world - visible_points(device)
        assert not frustum(device).contains(mirrored).any()

    def test_frustum_of_a_lens_that_folds_inside_the_image_holds_all_finite_rays(self) -> None:
        device = Device(
            name="c1",
            role="camera",
            n_rows=100,
            n_cols=100,
            focal_px=[105, 105],
            center_px=[49.5, 49.5],
            distortion=[-0.6, 0, 0, 0],
        )
        origin, directions = rays(device, pixel_grid(device.shape))
        finite = np.isfinite(directions).all(axis=-1)
        assert 0 < finite.sum() < finite.size
        assert frustum(device).contains(origin + 300 * directions[finite]).all()


angles = pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0])


def lit_points(device: Device, points: Floats) -> NDArray[np.bool_]:
    """Tell which points fall into the image, and into it before the lens folds."""
    x, y = cv_project(device, points).T
    inside = (x >= -0.5) & (x <= 255.5) & (y >= -0.5) & (y <= 191.5)
    in_device = device.device_from_world.apply(points)
    before_fold = np.linalg.norm(in_device[:, :2] / in_device[:, 2:], axis=1) < 0.5
    return np.asarray(inside & before_fold)


def sheet_coordinate(device: Device, points: Floats, angle: float) -> Floats:
    x, y = cv_project(device, points).T
    return np.asarray(math.cos(angle) * (x + 0.5) + math.sin(angle) * (y + 0.5))


class TestSheetCrossing:
    @angles
    def test_pinhole_crossing_equals_ray_plane_intersection(self, angle_deg: float) -> None:
        # The sheet is the plane of l^T K (R X + T) = 0 with l = (cos, sin, (cos + sin) / 2 - w).
        angle = math.radians(angle_deg)
        device = projector()
        origin, directions = rays(camera(), pixel_grid((96, 128))[::8, ::8].reshape(-1, 2))
        position = np.random.default_rng(9).uniform(100, 160, len(directions))
        cosine, sine = math.cos(angle), math.sin(angle)
        pose = device.device_from_world
        expected = []
        for direction, w in zip(directions, position, strict=True):
            line = np.array([cosine, sine, (cosine + sine) / 2 - w])
            normal = line @ device.camera_matrix @ pose.rotation
            offset = line @ device.camera_matrix @ pose.translation
            expected.append(-(normal @ origin + offset) / (normal @ direction))
        depth = np.array(expected)
        depth_in_projector = pose.apply(origin + depth[:, None] * directions)[:, 2]
        met = (depth > 0) & (depth_in_projector > 0)
        found = sheet_crossing(device, origin, directions, position, angle)
        assert met.sum() > 50
        np.testing.assert_array_equal(~met, np.isnan(found))
        np.testing.assert_allclose(depth[met], found[met], rtol=1e-7)

    @angles
    @pytest.mark.parametrize("lens", ["4 barrel", "4 pincushion", "5 strong", "8 rational"])
    def test_crossing_with_distortion_projects_onto_the_sheet(
        self, angle_deg: float, lens: str
    ) -> None:
        angle = math.radians(angle_deg)
        device = projector(DISTORTIONS[lens])
        origin, directions = rays(
            camera(DISTORTIONS["5"]), pixel_grid((96, 128))[::8, ::8].reshape(-1, 2)
        )
        depth = np.random.default_rng(10).uniform(350, 500, len(directions))
        points = origin + depth[:, None] * directions
        lit = lit_points(device, points)
        position = sheet_coordinate(device, points, angle)
        found = sheet_crossing(device, origin, directions[lit], position[lit], angle)
        again = origin + found[:, None] * directions[lit]
        assert lit.sum() > 50
        np.testing.assert_allclose(
            position[lit], sheet_coordinate(device, again, angle), atol=SHEET_PX
        )

    def test_crossing_recovers_the_point_across_the_baseline(self) -> None:
        device = projector(DISTORTIONS["5 strong"])
        origin, directions = rays(camera(), pixel_grid((96, 128))[::8, ::8].reshape(-1, 2))
        depth = np.random.default_rng(11).uniform(350, 500, len(directions))
        points = origin + depth[:, None] * directions
        lit = lit_points(device, points)
        x = cv_project(device, points)[:, 0]
        found = sheet_crossing(device, origin, directions[lit], x[lit] + 0.5, 0.0)
        px_per_mm = 0.1
        np.testing.assert_allclose(depth[lit], found, atol=SHEET_PX / px_per_mm)

    def test_depths_do_not_depend_on_the_world_frame(self) -> None:
        device = projector(DISTORTIONS["4 barrel"])
        origin, directions = rays(camera(), pixel_grid((96, 128))[40:60:4, 40:60:4].reshape(-1, 2))
        position = np.full(len(directions), 130.0)
        expected = sheet_crossing(device, origin, directions, position, 0.3)
        found = sheet_crossing(
            moved_device(device, ANY_MOTION),
            ANY_MOTION.apply(origin),
            ANY_MOTION.rotate(directions),
            position,
            0.3,
        )
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(expected, found, atol=1e-5)

    def test_sheet_that_the_ray_meets_behind_is_nan(self) -> None:
        origin = np.array([50.0, 0.0, 0.0])
        toward = np.array([[0.0, 0.0, 1.0]])
        ahead = sheet_crossing(AT_ORIGIN, origin, toward, np.array([75.0]), 0.0)
        behind = sheet_crossing(AT_ORIGIN, origin, toward, np.array([25.0]), 0.0)
        parallel = sheet_crossing(AT_ORIGIN, origin, toward, np.array([50.0]), 0.0)
        passed = sheet_crossing(AT_ORIGIN, np.array([50.0, 0, 300]), toward, np.array([75.0]), 0.0)
        np.testing.assert_allclose(200, ahead, atol=LENGTH_ROUNDING_MM)
        assert np.isnan([behind, parallel, passed]).all()

    @angles
    def test_larger_position_lies_on_the_side_of_larger_coordinates(self, angle_deg: float) -> None:
        angle = math.radians(angle_deg)
        along = np.array([[math.cos(angle), math.sin(angle), 0.0]])
        origin = np.array([-1000.0 * along[0, 0], -1000.0 * along[0, 1], 200.0])
        middle = 50 * (math.cos(angle) + math.sin(angle))
        for offset_px in (-10.0, 0.0, 10.0):
            position = np.array([middle + offset_px])
            found = sheet_crossing(AT_ORIGIN, origin, along, position, angle)
            expected = 1000 + 200 * offset_px / 100
            np.testing.assert_allclose(expected, found, atol=1e-5)


class TestClosestDepths:
    def test_depths_minimise_the_distance_by_brute_force(self) -> None:
        rng = np.random.default_rng(12)
        origin_a, origin_b = np.array([0.0, 0.0, 0.0]), np.array([120.0, 10.0, -5.0])
        target = rng.uniform([-50, -50, 300], [50, 50, 400], (8, 3))
        toward_a = target + rng.normal(0, 2, target.shape) - origin_a
        toward_b = target + rng.normal(0, 2, target.shape) - origin_b
        directions_a = toward_a / np.linalg.norm(toward_a, axis=1, keepdims=True)
        directions_b = toward_b / np.linalg.norm(toward_b, axis=1, keepdims=True)
        depth_a, depth_b = closest_depths(origin_a, directions_a, origin_b, directions_b)
        for a, b, found_a, found_b in zip(
            directions_a, directions_b, depth_a, depth_b, strict=True
        ):

            def distance2(t: Floats, a: Floats = a, b: Floats = b) -> float:
                gap = origin_a + t[0] * a - origin_b - t[1] * b
                return float(gap @ gap)

            best = minimize(distance2, [300.0, 300.0], method="BFGS", options={"gtol": 1e-9})
            optimiser_mm = 1e-3
            np.testing.assert_allclose(best.x, [found_a, found_b], atol=optimiser_mm)
            assert distance2(np.array([found_a, found_b])) <= distance2(best.x) + 1e-9

    def test_rays_that_meet_have_the_distances_of_the_point(self) -> None:
        point = np.array([30.0, -40.0, 500.0])
        origin_a, origin_b = np.array([1.0, 2.0, 3.0]), np.array([120.0, 10.0, -5.0])
        away_a, away_b = point - origin_a, point - origin_b
        length_a, length_b = np.linalg.norm(away_a), np.linalg.norm(away_b)
        found = closest_depths(origin_a, away_a[None] / length_a, origin_b, away_b[None] / length_b)
        np.testing.assert_allclose([[length_a], [length_b]], found, atol=LENGTH_ROUNDING_MM)

    def test_rays_that_part_meet_at_negative_distances(self) -> None:
        apart = np.array([[-0.6, 0.0, 0.8]]), np.array([[0.6, 0.0, 0.8]])
        depth_a, depth_b = closest_depths(np.zeros(3), apart[0], np.array([60.0, 0, 0]), apart[1])
        np.testing.assert_allclose([-50, -50], [depth_a[0], depth_b[0]], atol=LENGTH_ROUNDING_MM)

    def test_parallel_rays_have_no_finite_answer(self) -> None:
        forward = np.array([[0.0, 0.0, 1.0]])
        found = closest_depths(np.zeros(3), forward, np.array([60.0, 0, 0]), forward)
        assert not np.isfinite(found).any()


class TestTriangulationAngle:
    def test_angle_equals_the_hand_figure(self) -> None:
        # Devices 100 mm left and right of a point 100 sqrt(3) mm away: a triangle of 60 degrees.
        left = camera(device_from_world=pose([0, 0, 0], [100, 0, 0]))
        turned = camera(device_from_world=pose([0.1, 0.2, 0.3], [0, 0, 0]))
        right = moved_device(turned, pose([0, 0, 0], [100, 0, 0]))
        found = triangulation_angle(left, right, [0, 0, 100 * math.sqrt(3)])
        assert math.degrees(found) == pytest.approx(60, abs=1e-9)

    def test_angle_of_the_demo_cameras_equals_the_design_figure(self, rig: Rig) -> None:
        # cos = cos^2 27 + sin^2 27 cos 62, from tilt 27 and azimuths -31 and 31 degrees.
        tilt, azimuth = math.radians(27), math.radians(62)
        expected = math.acos(math.cos(tilt) ** 2 + math.sin(tilt) ** 2 * math.cos(azimuth))
        found = triangulation_angle(rig.cameras[0], rig.cameras[1], [0, 0, 0])
        assert expected == pytest.approx(found, abs=1e-9)
        assert round(math.degrees(found)) == 27


class TestRigFile:
    """Files name a volume as a person would, and mean exactly the same half-spaces."""

    @staticmethod
    def again(rig: Rig, folder: Path) -> tuple[str, MeasuringVolume]:
        """Return the kind of the volume in the file, and the volume read back from it."""
        (folder / "rig.toml").write_text(rig_text(rig), encoding="utf-8")
        kind = tomllib.loads((folder / "rig.toml").read_text(encoding="utf-8"))["volume"]["kind"]
        volume = read_rig(folder / "rig.toml").volume
        assert volume is not None
        return kind, volume

    @pytest.mark.parametrize(
        ("kind", "volume"),
        [
            ("box", MeasuringVolume.box([-10, -20.5, 300], [10, 20, 400])),
            (
                "cylinder",
                MeasuringVolume.cylinder([1, 2, 350.25], [0.1, -2, 3], radius_mm=40, height_mm=9),
            ),
            (
                "depth_slab",
                MeasuringVolume.depth_slab(projector(), depth_min_mm=200, depth_max_mm=500.5),
            ),
            (
                "half_spaces",
                MeasuringVolume.box([-10, -20, 300], [10, 20, 400]).intersection(
                    MeasuringVolume.depth_slab(camera(), depth_min_mm=300, depth_max_mm=350)
                ),
            ),
            ("half_spaces", MeasuringVolume(normals=[[0, 0, 3], [0, 0, -1]], offsets_mm=[900, 5])),
        ],
    )
    def test_volume_round_trips_with_its_kind(
        self, kind: str, volume: MeasuringVolume, tmp_path: Path
    ) -> None:
        rig = Rig(cameras=(camera(),), projector=projector(), volume=volume)
        found, again = self.again(rig, tmp_path)
        assert kind == found
        np.testing.assert_array_equal(volume.normals, again.normals)
        np.testing.assert_array_equal(volume.offsets_mm, again.offsets_mm)
        assert volume.shape == again.shape

    def test_slab_of_a_device_that_moved_stays_where_it_was(self, tmp_path: Path) -> None:
        volume = MeasuringVolume.depth_slab(projector(), depth_min_mm=200, depth_max_mm=500)
        elsewhere = moved_device(projector(), pose([0.1, 0.2, 0.3], [5, 6, 7]))
        kind, again = self.again(Rig(cameras=(camera(),), projector=elsewhere, volume=volume),
                                 tmp_path)  # fmt: skip
        assert kind == "half_spaces"
        np.testing.assert_allclose(volume.normals, again.normals, atol=1e-15)
        np.testing.assert_allclose(volume.offsets_mm, again.offsets_mm, atol=1e-12)

    def test_slab_of_a_device_that_is_not_in_the_rig_stays_where_it_was(
        self, tmp_path: Path
    ) -> None:
        volume = MeasuringVolume.depth_slab(projector(), depth_min_mm=200, depth_max_mm=500)
        kind, again = self.again(Rig(cameras=(camera(),), volume=volume), tmp_path)
        assert kind == "half_spaces"
        np.testing.assert_allclose(volume.offsets_mm, again.offsets_mm, atol=1e-12)


@pytest.mark.parametrize("n_edges", [0, 30, 120])
def test_connected_parts_are_those_of_scipy(n_edges: int) -> None:
    start, end = np.random.default_rng(n_edges).integers(0, 100, (2, n_edges))
    graph = coo_array((np.ones(n_edges), (start, end)), shape=(100, 100))
    expected = connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(connected(start, end, 100), expected)
