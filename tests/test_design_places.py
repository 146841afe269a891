"""Places of the projector: named and screened; what counts as a wrong order there."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from changed_rigs import cut_rig
from cv_lens import cv_points_at, cv_project
from fringe3d.design.counts import (
    longest_reach,
    periods_on_projector,
    spread_pixels,
)
from fringe3d.design.margin import ambiguity_margins
from fringe3d.design.optimise import _candidate
from fringe3d.design.reference import reference_of
from fringe3d.design.residual import Quality
from fringe3d.design.sampling import sloping_normals
from fringe3d.design.screen import screen
from fringe3d.design.stand import stand_of
from fringe3d.design.task import Limits, Task
from fringe3d.design.uncertainty import phase_noise, predict_uncertainty
from fringe3d.geometry import above, looking_at_origin, pixel_grid
from fringe3d.model import Device, MeasuringVolume, Rig

pytest.importorskip("embreex")

from fringe3d.simulate import PRESETS

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

PERIOD = 16.0
COARSE = Limits(spacing=math.radians(10.0), n_starts=1)
QUALITY = Quality()


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"]((640, 512)).rig


def grid(rig: Rig, step: int) -> Floats:
    return pixel_grid(rig.cameras[0].shape)[step // 2 :: step, step // 2 :: step].reshape(-1, 2)


@pytest.mark.parametrize("place", [(30.0, 23.0), (0.0, 0.0), (12.0, -140.0)])
def test_places_are_named_as_those_of_the_presets(kolibri: Rig, place: tuple[float, float]) -> None:
    stand = stand_of(kolibri)
    moved = stand.placed(kolibri, *np.radians(place))
    assert moved.projector is not None
    wanted = looking_at_origin(above(*place, 335.0))
    np.testing.assert_allclose(moved.projector.device_from_world.rotation, wanted.rotation,
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(moved.projector.center_world, above(*place, 335.0), atol=1e-6)
    tilt, azimuth = np.degrees(stand.angles_of(moved.projector))
    assert tilt == pytest.approx(place[0], abs=1e-6)
    if place[0]:
        assert azimuth == pytest.approx(place[1], abs=1e-6)


def test_a_moved_projector_keeps_distance_aim_and_roll(kolibri: Rig) -> None:
    """The reference point stays where it was in the projector's image; a place and back is none."""
    assert kolibri.projector is not None
    rolled = replace(
        kolibri.projector,
        device_from_world=replace_rotation(kolibri.projector, [0.02, -0.03, 0.7]),
    )
    rig = replace(kolibri, projector=rolled)
    stand = stand_of(rig)
    point = stand.point_mm
    moved = stand.placed(rig, 0.5, -2.0)
    assert moved.projector is not None
    before, after = (cv_project(device, point) for device in (rolled, moved.projector))
    np.testing.assert_allclose(after, before, atol=1e-6)
    back = stand.placed(moved, *stand.angles_of(rolled))
    assert back.projector is not None
    np.testing.assert_allclose(back.projector.device_from_world.rotation,
                               rolled.device_from_world.rotation, atol=1e-9)  # fmt: skip
    distance = np.linalg.norm(moved.projector.center_world - point)
    assert distance == pytest.approx(float(np.linalg.norm(rolled.center_world - point)))


def replace_rotation(device: Device, turn: list[float]):  # type: ignore[no-untyped-def]
    rotation = cv2.Rodrigues(np.array(turn))[0] @ device.device_from_world.rotation
    return replace(
        device.device_from_world, rotation=rotation, translation=-rotation @ device.center_world
    )


def test_the_separation_is_that_of_the_nearest_camera(kolibri: Rig) -> None:
    """13.6 deg to both, as in the source paper; (30, 23) deg stands 4.8 deg from C2."""
    stand = stand_of(kolibri)
    assert math.degrees(stand.separation(kolibri)) == pytest.approx(13.6, abs=0.05)
    towards = [above(30, 23, 1.0) @ above(27, azimuth, 1.0) for azimuth in (-31, 31)]
    moved = stand.placed(kolibri, *np.radians([30.0, 23.0]))
    assert stand.separation(moved) == pytest.approx(math.acos(max(towards)), abs=1e-6)


def test_a_rig_without_a_table_stands_on_what_it_faces(kolibri: Rig) -> None:
    slab = MeasuringVolume.depth_slab(kolibri.cameras[0], depth_min_mm=320, depth_max_mm=350)
    facing = reference_of(replace(kolibri, volume=slab)).facing
    np.testing.assert_allclose(stand_of(replace(kolibri, volume=slab)).upright, facing)
    box = MeasuringVolume.box([-30, -30, -10], [30, 30, 10])
    assert stand_of(replace(kolibri, volume=box)).upright.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("place", "angle_deg"), [((30, 23), 0.0), ((30, 23), 45.0), ((33, 0), -45.0), ((24, 44), 45.0)]
)
def test_screening_agrees_with_the_exact_margins(
    kolibri: Rig, place: tuple[float, float], angle_deg: float
) -> None:
    """To first order, on the same pixels and surfaces: 3 %."""
    rig = stand_of(kolibri).placed(kolibri, *np.radians(place))
    angle = math.radians(angle_deg)
    facing = reference_of(kolibri).facing
    normals = np.vstack([facing, sloping_normals(rig, facing, math.radians(20), 8)])
    quick = screen(rig, grid(rig, 90), np.array([0.3, angle]), normals, QUALITY, period_px=PERIOD)
    exact = ambiguity_margins(rig, period_px=PERIOD, angle=angle, slopes_deg=(0, 20), step_px=90,
                              depths=(0, 0.5, 1))  # fmt: skip
    assert quick.ratio[1] == pytest.approx(exact.worst_ratio[1], rel=0.03)
    sigma = predict_uncertainty(rig, period_px=PERIOD, sigma_phase=phase_noise(4, 0.01),
                                angle=angle, step=32)  # fmt: skip
    assert quick.sigma_mm[1] == pytest.approx(sigma.median_mm, rel=0.02)
    periods = periods_on_projector(rig, period_px=PERIOD, angle=angle, step=4)
    assert quick.reach[1] == pytest.approx(float(np.nanmax(periods)), rel=0.12)  # coarser pixels


def test_screening_tells_a_zero_line(kolibri: Rig) -> None:
    facing = reference_of(kolibri).facing
    normals = np.vstack([facing, sloping_normals(kolibri, facing, math.radians(20), 8)])
    quick = screen(kolibri, grid(kolibri, 90), np.array([0.0]), normals, QUALITY, period_px=PERIOD)
    assert quick.ratio[0] < 0


def reach_of(rig: Rig, pixels: Floats) -> float:
    """Return the most periods on a segment of a flat volume, with OpenCV."""
    assert rig.projector is not None
    assert rig.volume is not None
    top, bottom = rig.volume.offsets_mm[2], -rig.volume.offsets_mm[5]
    u = [cv_project(rig.projector, cv_points_at(rig.cameras[0], pixels, z))[:, 0]
         for z in (top, bottom)]  # fmt: skip
    return float(np.abs(u[0] - u[1]).max() / PERIOD)


@pytest.mark.parametrize(("reach", "counts"), [(0.95, False), (0.97, True), (1.05, True)])
def test_screening_counts_a_wrong_order_that_is_a_little_outside_the_volume(
    kolibri: Rig, reach: float, counts: bool
) -> None:
    """By 0.04 periods. On kolibri it fits as well as the right one: hardly a residual is left."""
    pixels = grid(cut_rig(kolibri, 3.0), 40)
    height = brentq(lambda h: reach_of(cut_rig(kolibri, h), pixels) - reach, 1.0, 6.0)
    facing = reference_of(kolibri).facing[None]
    quick = screen(cut_rig(kolibri, height), pixels, np.zeros(1), facing, QUALITY, period_px=PERIOD)
    assert quick.reach[0] == pytest.approx(reach, abs=1e-6)
    # Half a period is 32 standard deviations of 0.0157 periods.
    assert quick.ratio[0] == pytest.approx(0.0 if counts else 32.0, abs=3.0)


def test_fringes_along_the_epipolar_lines_leave_no_periods(kolibri: Rig) -> None:
    """The direction, in the projector, of the image of C1's ray, drawn with OpenCV."""
    rig = stand_of(kolibri).placed(kolibri, *np.radians([15.0, -20.0]))
    assert rig.projector is not None
    towards = rig.cameras[0].center_world / 335
    ends = [cv_project(rig.projector, s * towards) for s in (-10.0, 10.0)]
    line = ends[1] - ends[0]
    along = math.atan2(-line[0], line[1])  # w does not change along the line
    angles = along + np.radians([0.0, 10.0, 90.0])
    normals = reference_of(rig).facing[None]
    quick = screen(rig, grid(rig, 90), angles, normals, QUALITY, period_px=PERIOD)
    assert quick.reach[0] < 0.15  # lines of other pixels fan out by a degree
    assert quick.reach[0] < quick.reach[1] < quick.reach[2]
    assert quick.reach[2] == pytest.approx(np.linalg.norm(line) / PERIOD * 28 / 20, rel=0.15)


def reach_of_corners(rig: Rig, half_height_mm: float) -> float:
    """Return the most periods on a segment of a flat volume, of the corners of C1's image."""
    cut = cut_rig(rig, half_height_mm)
    rows, cols = cut.cameras[0].shape
    corners = np.array([[x, y] for x in (0, cols - 1) for y in (0, rows - 1)], np.float64)
    return reach_of(cut, corners)


@pytest.mark.parametrize(("excess", "is_single"), [(-1e-3, True), (1e-3, False)])
def test_one_period_is_below_one_with_the_guard_and_in_the_corners(
    kolibri: Rig, excess: float, is_single: bool
) -> None:
    """Of a flat volume the longest segment is that of a corner, solved for with OpenCV; half a
    pixel from there 1e-4 periods are missing, on a grid of every second pixel more."""
    guard = 3 * phase_noise(4, 0.01) / (2 * math.pi) + 0.1 / PERIOD

    def missing(height: float) -> float:
        return reach_of_corners(kolibri, height) + 2 * guard - 1 - excess

    rig = cut_rig(kolibri, brentq(missing, 1.0, 6.0))
    task = Task.of(rig, period_px=PERIOD, angle=0.0, slopes_deg=(0.0, 10.0), quality=QUALITY,
                   limits=COARSE, beyond=0.0)  # fmt: skip
    given = _candidate(task, "given", rig, 0.0)
    assert given.is_single == is_single
    assert given.periods + 2 * guard == pytest.approx(1 + excess, abs=1e-5)
    # The margins of a fine grid that holds the corners see the wrong order, too.
    assert (len(given.margins.orders) == 0) == is_single


def test_every_nth_pixel_and_the_last_ones_are_counted(kolibri: Rig) -> None:
    pixels = spread_pixels((7, 12), 5)
    assert pixels[0, :, 0].tolist() == [0, 5, 10, 11]
    assert pixels[:, 0, 1].tolist() == [0, 5, 6]
    assert spread_pixels((7, 12), 5, edges=False).shape == (2, 3, 2)
    rig = cut_rig(kolibri, 3.0)
    coarse, fine = (
        periods_on_projector(rig, period_px=PERIOD, step=step, edges=True) for step in (50, 1)
    )
    assert np.nanmax(coarse) == np.nanmax(fine)  # in a corner


@pytest.mark.parametrize("beyond", [0.0, 0.3])
def test_the_reach_is_that_from_the_volume_to_beyond_it(kolibri: Rig, beyond: float) -> None:
    """From either face of a flat volume to a part of the ray behind the other, by OpenCV."""
    rig = cut_rig(kolibri, 2.5)
    assert rig.projector is not None
    pixels = grid(rig, 20)
    angles = np.array([0.0, 0.7])
    found = longest_reach(rig, pixels, angles, period_px=PERIOD, beyond=beyond)
    for angle, reach in zip(angles, found, strict=True):
        heights = (2.5, -2.5, 2.5 + 5 * beyond, -2.5 - 5 * beyond)
        seen = [cv_project(rig.projector, cv_points_at(rig.cameras[0], pixels, z)) for z in heights]
        w = [(xy + 0.5) @ [math.cos(angle), math.sin(angle)] / PERIOD for xy in seen]
        assert reach == pytest.approx(np.abs([w[0] - w[3], w[1] - w[2]]).max(), abs=1e-6)


def test_a_wrong_order_counts_up_to_the_guard_beyond_the_ends(kolibri: Rig) -> None:
    """A longest segment of 0.95 periods, solved for with OpenCV: 0.05 are missing."""
    pixels = spread_pixels((128, 160), 40)
    flat = pixels.reshape(-1, 2)
    height = brentq(lambda h: reach_of(cut_rig(kolibri, h), flat) - 0.95, 1.0, 6.0)
    orders = [
        ambiguity_margins(cut_rig(kolibri, height), period_px=PERIOD, pixels=pixels,
                          guard=guard).orders.tolist()
        for guard in (0.0, 0.0499, 0.0501)
    ]  # fmt: skip
    assert orders == [[], [], [1, -1]]


def test_the_steady_ratio_tells_how_far_a_zero_line_is(kolibri: Rig) -> None:
    """It is the worst ratio where there is none, and negative where there is one."""
    beside = stand_of(kolibri).placed(kolibri, *np.radians([30.0, 23.0]))
    for rig, sign in ((beside, 1), (kolibri, -1)):
        margins = ambiguity_margins(rig, period_px=PERIOD, step_px=90)
        assert (np.sign(margins.steady_ratio) == sign).all()
        if sign > 0:
            np.testing.assert_array_equal(margins.steady_ratio, margins.worst_ratio)
        else:
            assert (margins.worst_ratio == 0).all()
            assert (np.diff(margins.steady_ratio) < 0).all()  # steeper: farther from enough
