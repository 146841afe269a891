"""Periods per segment, the code they need, the angle that needs none.

The oracle of the counts is OpenCV: the viewing ray of a pixel is found by solving for the points
that `projectPoints` puts there, and so are its images in the other devices.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root

from changed_rigs import moved_rig
from cv_lens import cv_project
from fringe3d.design.counts import (
    angle_without_code,
    periods_in_camera,
    periods_on_projector,
    with_projector_at,
)
from fringe3d.design.equations import shortest_period
from fringe3d.design.gray import gray_needs, guard_periods, order_counts, twin_part
from fringe3d.design.paper import shortest_period_exact
from fringe3d.design.reference import facing_direction, reference_of, with_depth
from fringe3d.design.uncertainty import predict_uncertainty
from fringe3d.errors import RigError
from fringe3d.geometry import above, looking_at_origin
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform

pytest.importorskip("embreex")

from fringe3d.simulate import PRESETS

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

PERIOD = 16.0
TOP, BOTTOM = 12.5, -12.5
INNER = [(320, 250), (200, 180), (430, 330), (330, 420)]
"""Pixels (x, y) of `kolibri` whose rays enter by the top of the volume and leave by its bottom."""


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"]((640, 512)).rig


@pytest.fixture(scope="module")
def periods(kolibri: Rig) -> Floats:
    return periods_on_projector(kolibri, period_px=PERIOD)


def on_plane(camera: Device, pixel: tuple[int, int], z: float) -> Floats:
    """Return the point at a height that OpenCV puts into a pixel."""

    def miss(xy: Floats) -> Floats:
        return np.asarray(cv_project(camera, [*xy, z]) - pixel)

    solved = root(miss, np.zeros(2), tol=1e-12)
    assert solved.success
    return np.array([*solved.x, z])


def on_ray(camera: Device, pixel: tuple[int, int], n: int = 1201) -> Floats:
    """Return points of a pixel's ray inside the exact cylinder of the volume."""
    ends = [on_plane(camera, pixel, z) for z in (TOP, BOTTOM)]
    part = np.linspace(0, 1, n)[:, None]
    points = (1 - part) * ends[0] + part * ends[1]
    return np.asarray(points[np.hypot(points[:, 0], points[:, 1]) <= 40.0])


def w_of(pixels: Floats, angle: float = 0.0) -> Floats:
    return np.asarray((pixels + 0.5) @ [math.cos(angle), math.sin(angle)])


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0])
def test_periods_on_the_projector_are_those_of_opencv(kolibri: Rig, angle_deg: float) -> None:
    """Distortion included; the ends of these segments are exact, so no tolerance but rounding."""
    angle = math.radians(angle_deg)
    counted = periods_on_projector(kolibri, period_px=PERIOD, angle=angle)
    assert kolibri.projector is not None
    for x, y in INNER:
        ends = np.stack([on_plane(kolibri.cameras[0], (x, y), z) for z in (TOP, BOTTOM)])
        w = w_of(cv_project(kolibri.projector, ends), angle)
        assert counted[y, x] == pytest.approx(abs(w[1] - w[0]) / PERIOD, abs=1e-6)


def test_the_shape_of_the_volume_cuts_the_segments(kolibri: Rig, periods: Floats) -> None:
    """Rays through the side of the cylinder; the prism around it is 0.12 % of 40 mm wider.

    That is 0.05 mm, and slanted by 40 deg or more 0.1 mm or 0.015 periods at each end.
    """
    assert kolibri.projector is not None
    cut = [(120, 150), (585, 260), (70, 330), (500, 90), (250, 500)]
    for x, y in cut:
        points = on_ray(kolibri.cameras[0], (x, y))
        w = w_of(cv_project(kolibri.projector, points[[0, -1]]))
        assert periods[y, x] == pytest.approx(abs(w[1] - w[0]) / PERIOD, abs=0.03)
        assert periods[y, x] < 3.9
    missed = [(5, 5), (635, 5), (5, 505), (635, 505)]
    assert all(not len(on_ray(kolibri.cameras[0], pixel)) for pixel in missed)
    assert all(math.isnan(periods[y, x]) for x, y in missed)


def test_kolibri_has_at_most_four_point_one_periods_on_a_segment(periods: Floats) -> None:
    """The source paper's rig: 2 bits and one image more for the over-determined code."""
    assert 4.1 <= np.nanmax(periods) <= 4.2
    needs = gray_needs(periods, guard=guard_periods(math.sqrt(0.5) * 0.01, 0.1, PERIOD))
    assert needs.bits == 2
    assert (needs.max_orders, needs.exact_bits) == (5, 3)  # 5 orders fit a few phases
    assert 0.005 < needs.twins[2] < 0.01
    assert needs.twins[3] == 0.0
    assert needs.bits_beyond == 3  # with the table below the volume


def test_what_the_projector_does_not_light_has_no_segment(kolibri: Rig, periods: Floats) -> None:
    assert kolibri.projector is not None
    # Only the first 500 columns are lit: the rays with larger w lose their segments, or a part.
    dark = replace(kolibri, projector=replace(kolibri.projector, n_cols=500))
    left = periods_on_projector(dark, period_px=PERIOD)
    assert np.isfinite(left).sum() < 0.65 * np.isfinite(periods).sum()
    both = np.isfinite(left)
    assert (left[both] <= periods[both] + 1e-9).all()
    x, y = 200, 250
    lit = on_ray(kolibri.cameras[0], (x, y))
    assert cv_project(kolibri.projector, lit)[:, 0].max() < 490
    assert left[y, x] == pytest.approx(periods[y, x], abs=1e-9)
    assert math.isnan(left[250, 560])


def test_a_grid_is_a_part_of_the_map(kolibri: Rig, periods: Floats) -> None:
    np.testing.assert_array_equal(
        periods_on_projector(kolibri, period_px=PERIOD, step=7), periods[::7, ::7]
    )


@pytest.mark.parametrize("angle_deg", [0.0, 25.0])
def test_periods_on_c2s_segment_are_those_of_a_plane_that_faces_the_rig(
    kolibri: Rig, angle_deg: float
) -> None:
    assert kolibri.projector is not None
    c1, c2 = kolibri.cameras
    angle = math.radians(angle_deg)
    counted = periods_in_camera(kolibri, period_px=PERIOD, angle=angle)
    # Cameras at tilt 27 and azimuth -31 and 31 deg: the middle between them is tilted in y alone.
    tilt, azimuth = np.radians([27.0, 31.0])
    normal = np.array([0.0, -math.sin(tilt) * math.cos(azimuth), math.cos(tilt)])
    eye = 335.0 * np.array(
        [math.sin(tilt) * math.sin(azimuth), -math.sin(tilt) * math.cos(azimuth), math.cos(tilt)]
    )
    for x, y in INNER[:2]:
        ray = on_ray(c1, (x, y))
        curve = cv_project(c2, ray)
        length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
        toward = ray[[0, -1]] - eye
        met = eye - (eye @ normal / (toward @ normal))[:, None] * toward
        w = w_of(cv_project(kolibri.projector, met), angle)
        assert counted.periods[y, x] == pytest.approx(abs(w[1] - w[0]) / PERIOD, abs=1e-6)
        # Four chords for a curve that bends by a fraction of a pixel.
        assert counted.length_px[y, x] == pytest.approx(length, rel=1e-4)
        assert counted.period_px[y, x] == pytest.approx(
            length * PERIOD / abs(w[1] - w[0]), rel=2e-4
        )


def test_a_given_period_in_c2_needs_no_projector(kolibri: Rig) -> None:
    stereo = replace(kolibri, projector=None)
    with pytest.raises(RigError, match="--camera-period"):
        periods_in_camera(stereo)
    counted = periods_in_camera(stereo, camera_period_px=11.0)
    np.testing.assert_allclose(counted.periods, counted.length_px / 11.0, rtol=1e-12)
    full = periods_in_camera(kolibri, period_px=PERIOD)
    np.testing.assert_array_equal(counted.length_px, full.length_px)


def test_orders_are_counted_as_by_trying_all_phases() -> None:
    rng = np.random.default_rng(4)
    guard = 0.03
    phases = np.arange(2000) / 2000
    for m in rng.uniform(0.0, 6.0, 40):
        low = rng.uniform(-3, 3) - guard
        orders = np.floor(low + m + 2 * guard - phases) - np.ceil(low - phases) + 1
        expected = int(orders.max())
        # Of a closed interval: only a length within the step of the trial is not decided by it.
        if abs((m + 2 * guard) % 1 - 0.5) < 0.499:
            assert order_counts(np.array([m]), guard=guard)[0] == expected
    assert order_counts(np.array([np.nan, 1.0])).tolist() == [0, 2]


@pytest.mark.parametrize("beyond", [0.0, 0.4])
@pytest.mark.parametrize("bits", [0, 1, 2, 3])
def test_twins_are_counted_as_by_drawing_points(bits: int, beyond: float) -> None:
    """200,000 points: a standard deviation of at most 0.0011."""
    rng = np.random.default_rng(5)
    guard = 0.02
    lengths = rng.uniform(2.0, 7.0, 400)
    m = rng.choice(lengths, 200_000, p=lengths / lengths.sum())
    x = rng.uniform(0, m)
    has = np.zeros(len(m), bool)
    for jump in range(-8, 9):
        twin = x + jump * 2**bits
        has |= (jump != 0) & (twin >= -beyond * m - guard) & (twin <= m + beyond * m + guard)
    found = twin_part(lengths, bits, guard=guard, beyond=beyond)
    assert found == pytest.approx(has.mean(), abs=0.005)


def test_bits_fall_with_the_periods() -> None:
    for m, bits, exact in ((0.9, 0, 0), (1.9, 1, 1), (3.9, 2, 2), (4.5, 3, 3), (15.5, 4, 4)):
        needs = gray_needs(np.full((3, 4), m))
        assert (needs.bits, needs.exact_bits) == (bits, exact)
        assert needs.twins[needs.exact_bits] == 0.0
        assert needs.bits_beyond >= bits
    assert gray_needs(np.full((3, 4), 0.99), guard=0.02).exact_bits == 1


def test_the_guard_is_three_sigma_and_the_calibration() -> None:
    # 3 * 0.05 rad / 2 pi = 0.0238732 periods; 0.4 px / 16 px = 0.025
    assert guard_periods(0.05, 0.4, 16.0) == pytest.approx(0.0488732, abs=1e-7)


def pinhole(name: str, size: tuple[int, int], focal_px: float, tilt_deg: float) -> Device:
    """Return a device in the plane y = 0, 335 mm from the origin, at which it looks."""
    width, height = size
    return Device(
        name=name,
        role="projector" if name == "projector" else "camera",
        n_rows=height,
        n_cols=width,
        focal_px=[focal_px, focal_px],
        center_px=[(width - 1) / 2, (height - 1) / 2],
        device_from_world=looking_at_origin(above(tilt_deg, 90.0, 335.0)),
    )


def paper_rig(*, field_mm: float = 60.0) -> Rig:
    """Return pinholes in one plane with the paper's distances and angles; C1 sees `field_mm`."""
    c1 = pinhole("c1", (64, 48), 64 * 335.0 / field_mm, 0.0)
    c2 = pinhole("c2", (640, 512), 640 * 335.0 / 93.0, 27.0)
    projector = pinhole("projector", (1024, 768), 64.3 / 0.020, 13.6)
    volume = MeasuringVolume.depth_slab(c1, depth_min_mm=320.0, depth_max_mm=350.0)
    return Rig(cameras=(c1, c2), projector=projector, volume=volume)


def test_the_papers_rig_needs_no_code_below_3_18_degrees() -> None:
    """The closed form of equation (5), here by moving the projector until one period is left."""
    free = angle_without_code(paper_rig(), period_px=PERIOD, principal_ray=True)
    assert math.degrees(free) == pytest.approx(3.18, abs=0.005)


def test_all_pixels_and_a_guard_leave_a_smaller_angle(kolibri: Rig) -> None:
    alone = angle_without_code(kolibri, period_px=PERIOD, principal_ray=True)
    free = angle_without_code(kolibri, period_px=PERIOD, step=4)
    guarded = angle_without_code(kolibri, period_px=PERIOD, guard=0.02, step=4)
    assert guarded < free < alone
    # A guard of 0.02 at both ends leaves 0.96 of a period, and periods grow with the sine.
    assert math.sin(guarded) / math.sin(free) == pytest.approx(0.96, abs=0.002)
    moved = with_projector_at(kolibri, free)
    assert np.nanmax(periods_on_projector(moved, period_px=PERIOD)) == pytest.approx(1.0, abs=0.002)
    assert angle_without_code(kolibri, period_px=PERIOD, guard=0.5) != free  # no room: NaN
    assert math.isnan(angle_without_code(kolibri, period_px=PERIOD, guard=0.5))


def test_a_moved_projector_keeps_distance_aim_and_plane(kolibri: Rig) -> None:
    camera, before = kolibri.cameras[0], kolibri.projector
    assert before is not None
    moved = with_projector_at(kolibri, math.radians(5.0)).projector
    assert moved is not None
    to_camera, to_old = (d.center_world / 335.0 for d in (camera, before))
    place = moved.center_world
    assert np.linalg.norm(place) == pytest.approx(335.0, rel=1e-9)
    # The angle to C1 is 5 deg, that to the old place the rest of 13.61 deg: on the same circle.
    assert math.degrees(math.acos(place @ to_camera / 335.0)) == pytest.approx(5.0, abs=1e-6)
    rest = math.degrees(math.acos(to_camera @ to_old)) - 5.0
    assert math.degrees(math.acos(place @ to_old / 335.0)) == pytest.approx(rest, abs=1e-6)
    # The origin, at which it looks, stays at its pixel, and so does the epipolar direction.
    pixels = [cv_project(d, np.zeros(3)) for d in (before, moved)]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-9)
    toward = [cv_project(d, 5.0 * to_camera) - p
              for d, p in zip((before, moved), pixels, strict=True)]  # fmt: skip
    directions = [math.atan2(d[1], d[0]) for d in toward]
    # Distortion bends the short line by less than a hundredth of a degree.
    assert directions[1] == pytest.approx(directions[0], abs=2e-3)


def test_nothing_depends_on_the_world_frame(kolibri: Rig) -> None:
    turn = cv2.Rodrigues(np.array([0.4, -0.7, 1.1]))[0]
    moved = moved_rig(kolibri, RigidTransform(rotation=turn, translation=[300.0, -150.0, 80.0]))
    for angle in (0.0, 0.5):
        here, there = (
            periods_on_projector(rig, period_px=PERIOD, angle=angle, step=16)
            for rig in (kolibri, moved)
        )
        np.testing.assert_allclose(there, here, atol=1e-7)
    segments = [periods_in_camera(rig, period_px=PERIOD, step=16) for rig in (kolibri, moved)]
    np.testing.assert_allclose(segments[1].periods, segments[0].periods, atol=1e-7)
    free = [angle_without_code(rig, period_px=PERIOD, step=16) for rig in (kolibri, moved)]
    assert free[1] == pytest.approx(free[0], abs=1e-5)
    sigmas = [
        predict_uncertainty(rig, period_px=PERIOD, sigma_phase=0.01, step=32)
        for rig in (kolibri, moved)
    ]
    np.testing.assert_allclose(sigmas[1].sigma_mm, sigmas[0].sigma_mm, rtol=1e-6)
    steepest = math.radians(25.0)
    shortest = [
        shortest_period(rig, period_px=PERIOD, max_slope=steepest) for rig in (kolibri, moved)
    ]
    # Slopes lean in eight directions, counted from an axis of the world.
    assert shortest[1] == pytest.approx(shortest[0], rel=0.01)


def test_c1_and_projector_in_one_line_can_be_parted(kolibri: Rig) -> None:
    assert kolibri.projector is not None
    pose = kolibri.cameras[0].device_from_world
    coaxial = replace(kolibri, projector=replace(kolibri.projector, device_from_world=pose))
    moved = with_projector_at(coaxial, 0.1).projector
    assert moved is not None
    to_camera, place = kolibri.cameras[0].center_world / 335.0, moved.center_world / 335.0
    assert math.acos(place @ to_camera) == pytest.approx(0.1, abs=1e-9)
    # Towards the second camera: 27 deg less 0.1 rad are left.
    second = kolibri.cameras[1].center_world / 335.0
    assert math.acos(place @ second) == pytest.approx(math.acos(second @ to_camera) - 0.1, abs=1e-9)


def test_the_shortest_period_is_the_closed_form_of_pinholes() -> None:
    """C1 sees only 2 mm around the principal ray, where the closed form holds within 1 %."""
    rig = paper_rig(field_mm=2.0)
    limit = math.radians(25.0)
    found = shortest_period(rig, period_px=PERIOD, max_slope=limit)
    focal_c2 = 640 * 335.0 / 93.0
    exact = shortest_period_exact(
        PERIOD, 64.3 / 0.020, focal_c2, math.radians(13.4), 335.0, 335.0, max_slope=limit
    )
    assert found == pytest.approx(exact, rel=0.01)
    # The normals lean in eight directions, one of which is that towards P within 22.5 deg.


def test_the_reference_is_the_middle_of_the_volume_on_the_principal_ray(kolibri: Rig) -> None:
    reference = reference_of(kolibri)
    np.testing.assert_allclose(reference.point_mm, 0.0, atol=1e-6)
    # 12.5 mm of height at a tilt of 27 deg: 335 -+ 12.5 / cos 27 deg = 335 -+ 14.029
    assert reference.depths.depth_min_mm == pytest.approx(320.971, abs=1e-3)
    assert reference.depths.depth_max_mm == pytest.approx(349.029, abs=1e-3)
    away = [camera.center_world for camera in kolibri.cameras]
    middle = (away[0] + away[1]) / np.linalg.norm(away[0] + away[1])
    np.testing.assert_allclose(facing_direction(kolibri, np.zeros(3)), middle, atol=1e-12)


def test_a_volume_beside_the_principal_ray_has_a_reference_too(kolibri: Rig) -> None:
    box = MeasuringVolume.box([12.0, 8.0, -6.0], [24.0, 16.0, 6.0])
    reference = reference_of(replace(kolibri, volume=box))
    assert box.contains(reference.point_mm)
    np.testing.assert_allclose(reference.point_mm, [18.0, 12.0, 0.0], atol=4.0)


def test_a_depth_range_cuts_the_volume(kolibri: Rig) -> None:
    narrow = with_depth(kolibri, (330.0, 340.0))
    depths = reference_of(narrow).depths
    assert (depths.depth_min_mm, depths.depth_max_mm) == pytest.approx((330.0, 340.0))
    assert with_depth(kolibri, None) is kolibri
    # Of 28.06 mm 10 are left, and periods go nearly with the depth.
    ratio = np.nanmax(periods_on_projector(narrow, period_px=PERIOD, step=4)) / 4.115
    assert ratio == pytest.approx(10 / 28.06, rel=0.06)


def test_missing_parts_are_named(kolibri: Rig) -> None:
    open_rig = replace(kolibri, volume=None)
    for ask in (reference_of, lambda rig: with_depth(rig, None)):
        with pytest.raises(RigError, match=r"expected a measuring volume.*--depth MIN:MAX"):
            ask(open_rig)
    with pytest.raises(RigError, match=r"expected a measuring volume.*--depth MIN:MAX"):
        periods_on_projector(open_rig, period_px=PERIOD)
    with pytest.raises(RigError, match="expected a projector"):
        periods_on_projector(replace(kolibri, projector=None), period_px=PERIOD)
    with pytest.raises(RigError, match="expected a second camera, found one"):
        periods_in_camera(replace(kolibri, cameras=kolibri.cameras[:1]), period_px=PERIOD)
    with pytest.raises(RigError, match=r"depth range: .* lie behind it"):
        with_depth(kolibri, (-20.0, -10.0))
    beside = replace(kolibri, volume=MeasuringVolume.box([500, 500, -5], [510, 510, 5]))
    with pytest.raises(RigError, match="in the view of camera 'c1', found it beside"):
        reference_of(beside)
    with pytest.raises(RigError, match="which 'projector' lights, too; found none"):
        periods_on_projector(beside, period_px=PERIOD)
    with pytest.raises(RigError, match="which 'c2' sees, too; found none"):
        periods_in_camera(beside, period_px=PERIOD)
    half_open = MeasuringVolume(normals=[[0.0, 0.0, 1.0]], offsets_mm=[12.5])
    with pytest.raises(RigError, match="expected a volume with two ends"):
        reference_of(replace(kolibri, volume=half_open))
