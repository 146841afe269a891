"""Residuals of wrong orders and their margins, against hand calculation and brute force.

The oracle follows the light with OpenCV's projections and root searches: it shares no code with
what it judges.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation

from changed_rigs import cut_rig, moved_rig
from cv_lens import cv_points_at, cv_project, cv_rays
from fringe3d.design.margin import ambiguity_margins
from fringe3d.design.reference import facing_direction, reference_of
from fringe3d.design.residual import (
    Quality,
    image_gradient,
    phase_ratio,
    residual_sigma,
    sight_of,
    wrong_order_residuals,
    wrong_points,
)
from fringe3d.errors import RigError
from fringe3d.geometry import above, looking_at_origin
from fringe3d.model import Device, Rig, RigidTransform

pytest.importorskip("embreex")

from fringe3d.simulate import PRESETS

Floats = NDArray[np.float64]

PERIOD = 16.0
SIZE = (640, 512)
EXACT = Quality(noise=0.0, calibration_px=0.0)
TURNED = math.radians(35.0)

POINTS = np.array([[0.0, 0.0, 0.0], [21.0, -13.0, 6.0], [-25.0, 17.0, -9.0], [8.0, 30.0, 3.0]])
NORMALS = np.array([[0.0, 0.0, 1.0], [0.3, -0.1, 0.9], [-0.25, -0.3, 0.9], [0.1, -0.5, 0.85]])


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"](SIZE).rig


def beside_c2() -> Rig:
    """The kolibri with its projector at 30, 23 deg: 4.8 deg from C2, and off the middle."""
    kolibri = PRESETS["kolibri"](SIZE).rig
    assert kolibri.projector is not None
    there = looking_at_origin(above(30.0, 23.0, 335.0))
    return replace(kolibri, projector=replace(kolibri.projector, device_from_world=there))


@pytest.fixture(scope="module")
def off_middle() -> Rig:
    return beside_c2()


def phase(rig: Rig, point: ArrayLike, angle: float) -> float:
    """Periods, from the definition of the fringes."""
    assert rig.projector is not None
    u, v = cv_project(rig.projector, point)
    return float((math.cos(angle) * (u + 0.5) + math.sin(angle) * (v + 0.5)) / PERIOD)


def found_residual(
    rig: Rig,
    point: Floats,
    normal: Floats,
    j: int,
    angle: float = 0.0,
    *,
    e1: float = 0.0,
    e2: float = 0.0,
    e_projector: float = 0.0,
    displaced: tuple[float, float] = (0.0, 0.0),
) -> float:
    """Phase that C2 measures at the wrong point less that of C1, with errors of all kinds."""
    c1, c2 = rig.cameras
    phase1 = phase(rig, point, angle) + e_projector + e1
    eye = -c1.device_from_world.rotation.T @ c1.device_from_world.translation
    along = (point - eye) / np.linalg.norm(point - eye)

    def missed(step: float) -> float:
        return phase(rig, point + step * along, angle) - phase1 - j

    wrong = point + brentq(missed, -150.0, 150.0, xtol=1e-10) * along
    first = np.cross(normal, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first) / np.linalg.norm(normal)
    pixel = cv_project(c2, wrong) + np.array(displaced)

    def beside(place: Floats) -> Floats:
        seen = cv_project(c2, point + place[0] * first + place[1] * second)
        return np.asarray(seen - pixel, np.float64)

    a, b = root(beside, np.zeros(2), tol=1e-12).x
    seen = point + a * first + b * second
    return phase(rig, seen, angle) + e_projector + e2 - phase1


def pinhole(device: Device, place: ArrayLike) -> Device:
    return replace(
        Device(name=device.name, role=device.role, n_rows=device.n_rows, n_cols=device.n_cols,
               focal_px=device.focal_px, center_px=device.center_px),
        device_from_world=looking_at_origin(place),
    )  # fmt: skip


def in_a_plane(rig: Rig, c1_deg: float, p_deg: float, c2_deg: float) -> Rig:
    """All devices in one plane, without distortion, at angles from the normal of the surface."""
    assert rig.projector is not None
    c1, p, c2 = (
        pinhole(device, 335 * np.array([math.sin(math.radians(a)), 0, math.cos(math.radians(a))]))
        for device, a in (
            (rig.cameras[0], c1_deg),
            (rig.projector, p_deg),
            (rig.cameras[1], c2_deg),
        )
    )
    return replace(rig, cameras=(c1, c2), projector=p)


@pytest.mark.parametrize(("first", "expected"), [(10.0, 0.064), (8.0, 0.410), (7.0, 0.036)])
def test_a_projector_on_the_normal_has_the_ratio_of_two_tangents(
    kolibri: Rig, first: float, expected: float
) -> None:
    """Angles C1-P : P-C2 of 10, 8 and 7 to 20 deg. By hand: fringes stand in space, along z and y;
    so rho = -tan 20 / tan 10 = -2.0642, and the first wrong order leaves 0.064 periods."""
    rig = in_a_plane(kolibri, -first, 0.0, 20.0)
    sight = sight_of(rig, [0.0, 0.0, 0.0], period_px=PERIOD)
    rho = float(phase_ratio(sight, [0.0, 0.0, 1.0]))
    assert rho == pytest.approx(
        -math.tan(math.radians(20)) / math.tan(math.radians(first)), rel=1e-6
    )
    assert abs(rho - round(rho)) == pytest.approx(expected, abs=5e-4)


def test_a_projector_in_the_middle_leaves_no_residual(kolibri: Rig) -> None:
    """The reflection that exchanges the cameras leaves projector, fringes and plane alone."""
    rig = in_a_plane(kolibri, -13.5, 0.0, 13.5)
    sight = sight_of(rig, np.zeros(3), period_px=PERIOD)
    assert float(phase_ratio(sight, [0.0, 0.3, 1.0])) == pytest.approx(-1.0, abs=1e-9)
    tilted = float(phase_ratio(sight, [math.sin(0.2), 0.0, math.cos(0.2)]))
    # By hand: (n.d1) / (n.d2) = cos(13.5 + 11.459) / cos(13.5 - 11.459), with the sign of d2 / d1.
    lean = math.degrees(0.2)
    hand = -math.cos(math.radians(13.5 + lean)) / math.cos(math.radians(13.5 - lean))
    assert tilted == pytest.approx(hand, rel=1e-6)


@pytest.mark.parametrize("angle", [0.0, TURNED])
@pytest.mark.parametrize("is_off_middle", [False, True])
def test_exact_residuals_are_those_of_brute_force(
    kolibri: Rig, off_middle: Rig, is_off_middle: bool, angle: float
) -> None:
    rig = off_middle if is_off_middle else kolibri
    orders = [1, -1, 2, -3]
    normals = NORMALS / np.linalg.norm(NORMALS, axis=1, keepdims=True)
    got = wrong_order_residuals(rig, POINTS, normals, orders, period_px=PERIOD, angle=angle)
    for point, normal, row in zip(POINTS, normals, got, strict=True):
        for j, value in zip(orders, row, strict=True):
            # 1e-6: the finite steps of OpenCV's projections and of the root searches.
            assert value == pytest.approx(found_residual(rig, point, normal, j, angle), abs=1e-6)


def test_wrong_points_lie_on_the_ray_and_have_the_phase_of_their_order(off_middle: Rig) -> None:
    wrong = wrong_points(off_middle, POINTS, [1, -2], period_px=PERIOD, angle=TURNED)
    c1 = off_middle.cameras[0]
    for point, pair in zip(POINTS, wrong, strict=True):
        for j, place in zip((1, -2), pair, strict=True):
            away = cv_project(c1, place) - cv_project(c1, point)
            assert np.abs(away).max() < 1e-6
            step = phase(off_middle, place, TURNED) - phase(off_middle, point, TURNED)
            assert step == pytest.approx(j, abs=1e-7)


def test_the_first_order_holds_for_short_steps(off_middle: Rig) -> None:
    """A hundredth of the period is a hundredth of the step, and of the relative error."""
    sight = sight_of(off_middle, POINTS, period_px=PERIOD, angle=TURNED)
    rho = phase_ratio(sight, NORMALS)
    errors = []
    for period in (PERIOD, PERIOD / 100):
        seen = wrong_order_residuals(
            off_middle, POINTS, NORMALS, [1], period_px=period, angle=TURNED
        )
        errors.append(np.abs(seen[:, 0] - (1 - rho)).max())
    assert errors[0] < 0.04
    assert errors[1] < 0.012 * errors[0]


@pytest.mark.parametrize("angle", [0.0, TURNED])
def test_the_standard_deviation_follows_from_the_response_to_each_error(
    off_middle: Rig, angle: float
) -> None:
    quality = Quality(noise=0.02, n_shifts=4, calibration_px=0.2)
    step = 1e-4
    for point, normal in zip(POINTS, NORMALS, strict=True):
        straight = found_residual(off_middle, point, normal, 0, angle)
        assert straight == pytest.approx(0.0, abs=1e-8)
        noise = math.sqrt(2 / 4) * 0.02 / (2 * math.pi)

        def response(**error: ArrayLike) -> float:
            return (found_residual(off_middle, point, normal, 0, angle, **error) - straight) / step  # type: ignore[arg-type] # noqa: B023

        parts = [
            noise * response(e1=step),
            noise * response(e2=step),
            0.2 / PERIOD * response(e_projector=step),
            0.2 * response(displaced=(step, 0.0)),
            0.2 * response(displaced=(0.0, step)),
            0.0015,
        ]
        sight = sight_of(off_middle, point, period_px=PERIOD, angle=angle)
        sigma = float(residual_sigma(sight, normal, quality, period_px=PERIOD))
        assert sigma == pytest.approx(math.sqrt(sum(part**2 for part in parts)), rel=2e-3)
        assert image_gradient(sight, normal)[0] == pytest.approx(parts[3] / 0.2, abs=1e-4)


def test_margins_of_single_pixels_are_those_of_brute_force(kolibri: Rig) -> None:
    """Facing surfaces at mid depth: the smallest residual of the wrong points in the volume."""
    found = ambiguity_margins(
        kolibri, period_px=PERIOD, slopes_deg=(0.0,), depths=(0.5,), step_px=128, quality=EXACT
    )
    facing = reference_of(kolibri).facing
    volume = kolibri.volume
    assert volume is not None
    checked = 0
    for place, margin in zip(found.pixels.reshape(-1, 2), found.margin.ravel(), strict=True):
        if not np.isfinite(margin):
            continue
        line = np.linspace(300, 370, 14001)
        origin, forward = cv_rays(kolibri.cameras[0], place)
        depths = line[volume.contains(origin + line[:, None] * forward)]
        point = origin + (depths[0] + depths[-1]) / 2 * forward
        residuals = [0.5]
        for j in (-3, -2, -1, 1, 2, 3):
            here = phase(kolibri, point, 0.0)
            ends = [
                phase(kolibri, origin + t * forward, 0.0) - here for t in (depths[0], depths[-1])
            ]
            if min(ends) <= j <= max(ends):
                r = found_residual(kolibri, point, facing, j)
                residuals.append(abs(r - round(r)))
        # 1e-3: OpenCV's own inverse of the lens, 0.05 mm between the samples of the line.
        assert margin == pytest.approx(min(residuals), abs=1e-3)
        checked += 1
    assert checked >= 12


def test_orders_of_the_source_papers_rig_can_hardly_be_told(kolibri: Rig) -> None:
    """The first wrong order leaves about 0.026 periods on a level plane, near the border."""
    side = np.linspace(-35, 35, 15)
    x, y = np.meshgrid(side, side)
    level = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    level = level[np.hypot(level[:, 0], level[:, 1]) <= 40]
    up = np.broadcast_to([0.0, 0.0, 1.0], level.shape)
    seen = wrong_order_residuals(kolibri, level, up, [1], period_px=PERIOD)[:, 0]
    assert np.percentile(np.abs(seen - np.rint(seen)), 95) == pytest.approx(0.026, abs=0.003)
    found = ambiguity_margins(kolibri, period_px=PERIOD, step_px=64)
    assert (found.worst_margin == 0).all()
    assert (found.share_unsafe > 0.9).all()


def random_surfaces(rig: Rig, n: int, slope_deg: float) -> tuple[Floats, Floats]:
    """Points of the volume that all devices see, and normals up to a slope, at random."""
    rng = np.random.default_rng(5)
    assert rig.volume is not None
    points = rng.uniform([-40, -40, -12.5], [40, 40, 12.5], (n, 3))
    ok = rig.volume.contains(points)
    for device in rig.devices:
        pixels = cv_project(device, points)
        ok &= (pixels > -0.5).all(axis=1) & (pixels < np.array(device.shape[::-1]) - 0.5).all(
            axis=1
        )
    facing = reference_of(rig).facing
    lean = rng.uniform(0, math.radians(slope_deg), n)
    side = np.cross(rng.standard_normal((n, 3)), facing)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    normals = np.cos(lean)[:, None] * facing + np.sin(lean)[:, None] * side
    return points[ok], normals[ok]


def test_no_surface_has_less_than_the_worst_margin(off_middle: Rig) -> None:
    """0.07 periods for slopes up to 20 deg, beside C2; none of 2000 surfaces has less."""
    found = ambiguity_margins(off_middle, period_px=PERIOD, step_px=64, quality=EXACT)
    assert found.worst_margin[-1] > 0.07
    assert (np.diff(found.worst_margin) <= 0).all()
    points, normals = random_surfaces(off_middle, 2000, 20.0)
    orders = found.orders
    seen = wrong_order_residuals(off_middle, points, normals, orders, period_px=PERIOD)
    wrong = wrong_points(off_middle, points, orders, period_px=PERIOD)
    assert off_middle.volume is not None
    rest = np.abs(seen - np.rint(seen))[off_middle.volume.contains(wrong)]
    assert rest.min() > found.worst_margin[-1] - 0.002  # the grid misses the very corners
    assert rest.min() < found.worst_margin[-1] + 0.02


def test_a_zero_line_between_samples_is_found(kolibri: Rig) -> None:
    """On kolibri some slope below 20 deg makes a residual vanish wherever an order can be wrong;
    no sampled normal need hit it."""
    found = ambiguity_margins(
        kolibri, period_px=PERIOD, slopes_deg=(20.0,), depths=(0.5,), n_azimuths=2, step_px=160,
        quality=EXACT,
    )  # fmt: skip
    ambiguous = np.isfinite(found.margin[0]) & (found.order[0] != 0)
    assert ambiguous.any()
    assert (found.margin[0][ambiguous] == 0).all()
    points, normals = random_surfaces(kolibri, 3000, 20.0)
    seen = wrong_order_residuals(kolibri, points, normals, [1], period_px=PERIOD)
    assert np.abs(seen - np.rint(seen)).min() < 1e-3


def test_without_a_wrong_order_in_the_volume_half_a_period_is_left() -> None:
    rig = PRESETS["kolibri-m5"](SIZE).rig
    found = ambiguity_margins(rig, period_px=PERIOD, step_px=64)
    assert not len(found.orders)
    assert np.nanmax(found.margin) == np.nanmin(found.margin) == 0.5
    assert (found.worst_order == 0).all()
    table = ambiguity_margins(rig, period_px=PERIOD, step_px=64, beyond=0.4)
    assert set(table.orders) == {1, -1}


def periods_at(rig: Rig, pixels: Floats, z_mm: float) -> Floats:
    """Return the phase of what C1 sees in pixels (n, 2) at a height, (n,) periods."""
    assert rig.projector is not None
    points = cv_points_at(rig.cameras[0], pixels, z_mm)
    return (cv_project(rig.projector, points)[:, 0] + 0.5) / PERIOD


@pytest.mark.parametrize("order", [1, -1])
def test_wrong_points_count_up_to_a_part_of_the_depth_beyond_the_volume(
    kolibri: Rig, order: int
) -> None:
    """Of 5 mm with 0.8 periods: order 1 lies 26 % beyond one end, order -1 25 % beyond the other.

    Where exactly is solved for with OpenCV; 0.5 % of the depth on either side decide.
    """
    rig = cut_rig(kolibri, 2.5)
    pixels = ambiguity_margins(rig, period_px=PERIOD, step_px=40).pixels.reshape(-1, 2)

    def missing(beyond: float) -> float:
        outer = 2.5 + 5.0 * beyond
        up, down = (periods_at(rig, pixels, end * outer) - periods_at(rig, pixels, -end * 2.5)
                    for end in (1, -1))  # fmt: skip
        return float((order * np.array([up, down])).max() - 1)

    just = brentq(missing, 0.0, 1.0)
    assert 0.2 < just < 0.3
    found = [ambiguity_margins(rig, period_px=PERIOD, step_px=40, beyond=just + more).orders
             for more in (-0.005, 0.005)]  # fmt: skip
    assert [order in orders for orders in found] == [False, True]


def test_surfaces_seen_flatter_than_75_deg_do_not_count(kolibri: Rig) -> None:
    """A sheet that leans by 45 deg towards C2, seen from C1 at 30 deg: 75 deg in the middle."""
    rig = cut_rig(in_a_plane(kolibri, -30.0, 0.0, 30.0), 0.01)
    found = ambiguity_margins(rig, period_px=PERIOD, slopes_deg=(45.0,), depths=(0.5,),
                              n_azimuths=1, facing=[0.0, 0.0, 1.0], step_px=7)  # fmt: skip
    towards = rig.cameras[0].center_world - cv_points_at(rig.cameras[0], found.pixels, 0.0)
    lean = math.radians(45.0)
    cosine = towards @ [math.sin(lean), 0.0, math.cos(lean)] / np.linalg.norm(towards, axis=-1)
    expected = cosine > math.cos(math.radians(75.0))
    assert 0.4 < expected.mean() < 0.6
    np.testing.assert_array_equal(np.isfinite(found.margin[0]), expected)


def test_a_calibration_twice_as_bad_halves_the_ratio(off_middle: Rig) -> None:
    ratios = [
        ambiguity_margins(off_middle, period_px=PERIOD, step_px=128,
                          quality=Quality(noise=0.0, calibration_px=c)).worst_ratio
        for c in (0.2, 0.4)
    ]  # fmt: skip
    assert ratios[0] / ratios[1] == pytest.approx(2.0, rel=0.02)  # the floor of 0.0015 periods


def test_moving_the_world_changes_nothing(off_middle: Rig) -> None:
    turn = Rotation.from_rotvec([0.4, -0.8, 1.1]).as_matrix()
    there = RigidTransform(rotation=turn, translation=[30.0, -70.0, 500.0])

    rig = moved_rig(off_middle, there)
    here = ambiguity_margins(off_middle, period_px=PERIOD, step_px=128)
    away = ambiguity_margins(rig, period_px=PERIOD, step_px=128)
    np.testing.assert_allclose(away.margin, here.margin, atol=1e-6)
    np.testing.assert_array_equal(away.order, here.order)
    np.testing.assert_allclose(away.facing, there.rotate(here.facing), atol=1e-9)


def test_slopes_count_from_the_given_direction(off_middle: Rig) -> None:
    upright = ambiguity_margins(off_middle, period_px=PERIOD, step_px=128, facing=[0, 0, 5.0])
    assert upright.facing.tolist() == [0, 0, 1]
    own = ambiguity_margins(off_middle, period_px=PERIOD, step_px=128)
    np.testing.assert_allclose(own.facing, facing_direction(off_middle, [0.0, 0.0, 0.0]), atol=1e-3)
    assert upright.worst_margin[-1] != pytest.approx(own.worst_margin[-1], abs=1e-4)


def test_what_is_missing_is_said(kolibri: Rig) -> None:
    def judge(rig: Rig) -> None:
        ambiguity_margins(rig, period_px=PERIOD, step_px=128)

    with pytest.raises(RigError, match="expected two cameras"):
        judge(replace(kolibri, cameras=kolibri.cameras[:1]))
    with pytest.raises(RigError, match="expected a projector"):
        judge(replace(kolibri, projector=None))
    with pytest.raises(RigError, match="expected a measuring volume"):
        judge(replace(kolibri, volume=None))
    assert kolibri.projector is not None
    away = replace(kolibri.projector, device_from_world=looking_at_origin(above(80, 180, 60.0)))
    beside = replace(away, center_px=away.center_px + 5e4)
    with pytest.raises(RigError, match="meet in the measuring volume"):
        judge(replace(kolibri, projector=beside))
    with pytest.raises(ValueError, match="increasing angles"):
        ambiguity_margins(kolibri, period_px=PERIOD, slopes_deg=(20.0, 10.0))
    with pytest.raises(ValueError, match="parts from 0 to 1"):
        ambiguity_margins(kolibri, period_px=PERIOD, depths=(1.5,))
    with pytest.raises(ValueError, match="n_shifts >= 3"):
        Quality(n_shifts=2)
