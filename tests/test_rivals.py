"""Orders and bias found together, on exact phases: what is decided, and what is left open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from changed_rigs import turned, with_wide_c2
from closed_phases import (
    Surface,
    choose,
    grid_of,
    phase_map,
    seen_points,
    small_rig,
    task_of,
    turns_off,
    visible,
)
from cv_lens import cv_project
from fringe3d.correspond import Rivals, Task, TwoViews, coarse_stride, rivals
from fringe3d.correspond.chosen import ChosenOrders
from fringe3d.correspond.solutions import Solution, edges_px, epipolar_direction, weighed
from fringe3d.model import NO_ORDER, CalibrationBias, Rejection, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCENE = Surface()
PLANE = Surface(plane_z_mm=0.0, radius_mm=0.0)
"""In the middle of the volume: one period up or down is inside, too."""
SEED = 4
STD_RAD = 0.01
TURNED_DEG = 0.01
"""Of C2 against its calibration: 0.28 px."""


@cache
def nearly_symmetric() -> Rig:
    """Return a rig whose projector stands 1 degree off the middle; C2 sees more than C1."""
    return with_wide_c2(small_rig(projector_azimuth_deg=-1.0))


@cache
def views_of(rig: Rig, surface: Surface, sign: int = 1, *, std: float = STD_RAD) -> TwoViews:
    """Return what the cameras see, with a calibration of C2 that is wrong by 0.28 px."""
    assert rig.projector is not None
    rng = np.random.default_rng(SEED)
    c1, c2 = rig.cameras
    phases1, phases2 = (phase_map(c, rig.projector, surface, n_classes=1, std=std, rng=rng)
                        for c in (c1, c2))  # fmt: skip
    return TwoViews(camera1=c1, camera2=turned(c2, "y", sign * TURNED_DEG),
                    phases1=phases1, phases2=phases2)  # fmt: skip


@cache
def solved(surface: Surface, sign: int) -> ChosenOrders:
    rig = nearly_symmetric()
    return choose(rig, views_of(rig, surface, sign), search=True)


# --- what a scan decides ---------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
def test_structure_tells_orders_and_bias(sign: int) -> None:
    rig, result = nearly_symmetric(), solved(SCENE, sign)
    views, seen = views_of(rig, SCENE, sign), visible(rig, SCENE)
    good, off = (
        result.phases.rejection == 0,
        turns_off(rig, views, SCENE, result.phases.order_class),
    )
    assert seen.sum() > 12_000
    assert good[seen].mean() > 0.995
    assert not off[good & seen].any()
    assert (result.probability[good] >= 0.9).all()
    # Where the calibration expects the points, less where C2 sees them.
    c1, c2 = rig.cameras
    points, depth, _ = seen_points(c1, grid_of(c1), SCENE)
    missed = cv_project(views.camera2, points[seen]) - cv_project(c2, points[seen])
    found = result.bias.displacement(grid_of(c1)[seen], depth[seen])
    assert np.abs(missed[:, 0]).min() > 0.25
    assert np.abs(found[:, 0] - missed[:, 0]).max() < 0.06  # vertical fringes: nearly x alone


@pytest.mark.parametrize("sign", [1, -1])
def test_without_search_the_orders_are_others(sign: int) -> None:
    """One start, without a bias: it settles on what lies nearest, or on nothing."""
    rig = nearly_symmetric()
    views, seen = views_of(rig, SCENE, sign), visible(rig, SCENE)
    result = choose(rig, views)
    good, off = (
        result.phases.rejection == 0,
        turns_off(rig, views, SCENE, result.phases.order_class),
    )
    assert (good & (off == 0))[seen].mean() < 0.2
    assert result.rival_shift == 0


@pytest.mark.parametrize("sign", [1, -1])
def test_an_isolated_plane_is_left_open(sign: int) -> None:
    rig, result = nearly_symmetric(), solved(PLANE, sign)
    seen = visible(rig, PLANE)
    good = result.phases.rejection == 0
    off = turns_off(rig, views_of(rig, PLANE, sign), PLANE, result.phases.order_class)
    assert not (good & (off != 0)).any()  # never a wrong plane
    assert good[seen].mean() < 0.05
    assert ((result.phases.rejection & Rejection.AMBIGUOUS) > 0)[seen].mean() > 0.95
    assert result.rival_shift == 1


@pytest.mark.parametrize("sign", [1, -1])
def test_a_learnt_bias_decides_the_plane(sign: int) -> None:
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), PLANE)
    views, bias = views_of(rig, PLANE, sign), solved(SCENE, sign).bias
    result = choose(rig, views, search=True, bias=bias)
    good, off = (
        result.phases.rejection == 0,
        turns_off(rig, views, PLANE, result.phases.order_class),
    )
    assert good[seen].mean() > 0.995
    assert not off[good].any()
    np.testing.assert_allclose(result.bias.coefficients_px, bias.coefficients_px, atol=0.01)
    assert result.rival_shift == 0
    # The bias of the camera turned the other way tells other orders.
    wrong = choose(rig, views, search=True, bias=solved(SCENE, -sign).bias)
    off = turns_off(rig, views, PLANE, wrong.phases.order_class)
    assert ((wrong.phases.rejection == 0) & (off == 0))[seen].mean() < 0.05


def tilted(bias: CalibrationBias, px: float, *, is_known: bool) -> CalibrationBias:
    """Return a stored bias that is wrong towards the sides of the image, and says so or not."""
    wrong = bias.coefficients_px.copy()
    wrong[0, 1] += px
    sigma = np.tile([0.02, px, px] + 6 * [0.02], 2)
    covariance = None if is_known else np.diag(sigma**2)
    return replace(bias, coefficients_px=wrong, covariance_px2=covariance)


@pytest.mark.parametrize("px", [0.35, -0.35])
def test_a_stored_bias_is_refined_where_it_is_not_known(px: float) -> None:
    """A period is a quarter of a pixel: at the sides others fit."""
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), SCENE)
    views, true = views_of(rig, SCENE, 1), solved(SCENE, 1).bias
    right = []
    for is_known in (True, False):
        result = choose(rig, views, search=True, bias=tilted(true, px, is_known=is_known))
        off = turns_off(rig, views, SCENE, result.phases.order_class)
        right.append(((result.phases.rejection == 0) & (off == 0))[seen].mean())
    assert right[0] < 0.7
    assert right[1] > 0.995
    assert result.bias.coefficients_px[0, 1] == pytest.approx(true.coefficients_px[0, 1], abs=0.01)


@pytest.mark.parametrize("search", [False, True])
def test_a_code_refines_a_stored_bias(search: bool) -> None:
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), SCENE)
    assert rig.projector is not None
    maps = [phase_map(c, rig.projector, SCENE) for c in rig.cameras]
    views = replace(views_of(rig, SCENE, 1), phases1=maps[0], phases2=maps[1])
    kept = []
    for is_known in (True, False):
        bias = tilted(solved(SCENE, 1).bias, 1.0, is_known=is_known)
        result = choose(rig, views, search=search, bias=bias)
        kept.append((result.phases.rejection == 0)[seen].mean())
    assert kept[0] < 0.5
    assert kept[1] > 0.995


def test_a_bias_that_is_not_known_well_enough_leaves_a_plane_open() -> None:
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), PLANE)
    views = views_of(rig, PLANE, 1)
    wrong = []
    for is_known in (True, False):
        bias = tilted(solved(SCENE, 1).bias, 0.35, is_known=is_known)
        result = choose(rig, views, search=True, bias=bias)
        off = turns_off(rig, views, PLANE, result.phases.order_class)
        wrong.append(((result.phases.rejection == 0) & (off != 0))[seen].mean())
    assert wrong[0] > 0.1
    assert wrong[1] == 0


def shifted(bias: CalibrationBias, px: float) -> CalibrationBias:
    """Return a stored bias that is wrong by the same everywhere, and says so."""
    wrong = bias.coefficients_px.copy()
    wrong[0, 0] += px
    sigma = np.tile([abs(px)] + 8 * [0.02], 2)
    return replace(bias, coefficients_px=wrong, covariance_px2=np.diag(sigma**2))


@pytest.mark.parametrize("px", [0.25, -0.25, 0.5])
def test_a_stored_bias_that_is_a_period_off_is_put_right_by_structure(px: float) -> None:
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), SCENE)
    views, true = views_of(rig, SCENE, 1), solved(SCENE, 1).bias
    result = choose(rig, views, search=True, bias=shifted(true, px))
    good, off = (
        result.phases.rejection == 0,
        turns_off(rig, views, SCENE, result.phases.order_class),
    )
    assert good[seen].mean() > 0.995
    assert not off[good & seen].any()
    assert result.bias.coefficients_px[0, 0] == pytest.approx(true.coefficients_px[0, 0], abs=0.02)


@pytest.mark.parametrize("px", [0.25, -0.25])
def test_a_plane_stays_open_where_the_stored_bias_may_be_a_period_off(px: float) -> None:
    rig, seen = nearly_symmetric(), visible(nearly_symmetric(), PLANE)
    views = views_of(rig, PLANE, 1)
    result = choose(rig, views, search=True, bias=shifted(solved(SCENE, 1).bias, px))
    good = result.phases.rejection == 0
    off = turns_off(rig, views, PLANE, result.phases.order_class)
    assert not (good & (off != 0))[seen].any()
    assert result.rival_shift == 1


def test_a_bias_that_changes_sign_is_found() -> None:
    """Turned about its axis C2 errs to one side above and to the other below."""
    rig = small_rig(projector_azimuth_deg=-3.0)
    assert rig.projector is not None
    c2 = rig.cameras[1]
    views = views_of(rig, SCENE)
    views = replace(views, camera2=turned(c2, "z", 0.3))
    result, seen = choose(rig, views, search=True), visible(rig, SCENE)
    good, off = (
        result.phases.rejection == 0,
        turns_off(rig, views, SCENE, result.phases.order_class),
    )
    assert good[seen].mean() > 0.995
    assert not off[good & seen].any()


def test_energy_counts_residuals_by_patches_and_the_size_of_the_bias() -> None:
    rig = nearly_symmetric()
    task = task_of(rig, views_of(rig, PLANE))
    found = rivals([task])
    assert found is not None
    assert len(found.solutions) > 1
    prior = 0.25 * np.array([1.0] * 6 + [2 * task.frame.scale[2] / task.frame.middle[2]] * 3)
    n_alike = 256 / (task.grid[0].step * task.grid[1].step)
    for solution in found.solutions:
        cost = task.decide(solution.bias, scatter_px=0.08).cost
        size = solution.bias.coefficients_px / prior
        expected = np.minimum(cost / 2, 1.2).sum() / n_alike + (size**2).sum() / 2
        assert (size**2).sum() / 2 > 0.1
        assert solution.energy == pytest.approx(expected, rel=0.02)  # a plane has no edges


def test_the_border_of_c2_is_no_evidence() -> None:
    """The same where C2 sees less than C1: another order moves points into its image, or out."""
    rig, low = small_rig(projector_azimuth_deg=-1.0), Surface(radius_mm=0.0)
    views = views_of(rig, low)
    result = choose(rig, views, search=True)
    off = turns_off(rig, views, low, result.phases.order_class)
    assert not ((result.phases.rejection == 0) & (off != 0)).any()


def test_two_scans_have_one_bias() -> None:
    """What the plane leaves open the scene decides; their order plays no part."""
    rig = nearly_symmetric()
    scene, plane = (task_of(rig, views_of(rig, s)) for s in (SCENE, PLANE))
    both, turned_round = rivals([plane, scene]), rivals([scene, plane])
    assert both is not None
    assert turned_round is not None
    assert both.weights[0] > 0.99
    assert len(both.solutions[0].orders) == 2
    for number, (task, surface) in enumerate([(plane, PLANE), (scene, SCENE)]):
        order = np.full(task.valid.shape, NO_ORDER, np.int32)
        order[task.valid] = both.solutions[0].orders[number]
        full = np.full(rig.cameras[0].shape, NO_ORDER, np.int32)
        full[task.grid] = order
        seen = visible(rig, surface) & (full != NO_ORDER)
        assert seen.sum() > 2000
        off = turns_off(rig, views_of(rig, surface), surface, full)
        assert not off[seen].any()
    pixels, depths = plane.pixels, np.full(len(plane.pixels), 335.0)
    np.testing.assert_allclose(
        both.best.displacement(pixels, depths), turned_round.best.displacement(pixels, depths),
        atol=0.02,
    )  # fmt: skip


def part_of(views: TwoViews, rows: slice, cols: slice) -> tuple[TwoViews, Mask]:
    """Return the views with a part of C1's pixels alone, and which they are."""
    rejection = np.full(views.phases1.rejection.shape, np.uint16(Rejection.LOW_MODULATION))
    rejection[rows, cols] = 0
    return replace(views, phases1=views.phases1.rejecting(rejection)), rejection == 0


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("size", [(20, 40), (44, 44), (4, 6)])
def test_a_small_plane_is_left_open(size: tuple[int, int], sign: int, strict: bool) -> None:
    """Its pixels share the calibration's error: however few they are, they do not tell it."""
    rig, (rows, cols) = nearly_symmetric(), size
    views = views_of(rig, PLANE, sign)
    few, there = part_of(views, slice(60, 60 + rows), slice(60, 60 + cols))
    result = choose(rig, few, search=True, strict=strict, min_probability=0.99 if strict else 0.9)
    assert (there & visible(rig, PLANE)).sum() > 0.9 * rows * cols
    assert (result.phases.rejection > 0).all()


@pytest.mark.parametrize("px", [0.4, -0.4])
@pytest.mark.parametrize("strict", [False, True])
def test_a_stored_bias_may_be_a_period_off_at_the_side_alone(px: float, strict: bool) -> None:
    """In the middle of the image it is known; the plane stands at its right border."""
    rig, true = nearly_symmetric(), solved(SCENE, 1).bias
    views, _ = part_of(views_of(rig, PLANE), slice(10, 118), slice(110, 158))
    wrong = true.coefficients_px.copy()
    wrong[0, 1] += px
    sigma = np.tile([0.02, abs(px)] + 7 * [0.02], 2)
    stored = replace(true, coefficients_px=wrong, covariance_px2=np.diag(sigma**2))
    result = choose(
        rig, views, search=True, bias=stored, strict=strict, min_probability=0.99 if strict else 0.9
    )
    off = turns_off(rig, views, PLANE, result.phases.order_class)
    assert not ((result.phases.rejection == 0) & (off != 0)).any()


def test_nothing_decoded_tells_nothing() -> None:
    rig = nearly_symmetric()
    views = views_of(rig, PLANE)
    dark = np.full(views.phases1.rejection.shape, np.uint16(Rejection.LOW_MODULATION))
    dark_views = replace(views, phases1=views.phases1.rejecting(dark))
    assert (choose(rig, dark_views, search=True).phases.rejection > 0).all()


def test_an_edge_counts_by_its_length_whatever_the_grid() -> None:
    """A corner with sides of 12 and 36 px, and a step along a column of 60."""
    rows, cols = np.indices((60, 80))
    for down, right in ((1, 1), (4, 2), (2, 4), (3, 1)):
        grid = slice(None, None, down), slice(None, None, right)
        corner = np.where((rows >= 24) & (cols < 12), 3.0, 0.0)
        strip = np.where(cols >= 40, 1.0, 0.0)
        assert edges_px(corner[grid], grid) == 12 + 36
        assert edges_px(strip[grid], grid) == 60


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, -30.0])
def test_the_epipolar_way_turns_with_the_second_camera(roll_deg: float) -> None:
    rig = small_rig()
    c1, c2 = rig.cameras
    c2 = turned(c2, "z", roll_deg)
    pixels = grid_of(c1)[::16, ::16].reshape(-1, 2)
    way = epipolar_direction(c1, c2, pixels, 335.0)
    away = pixels - c1.center_px
    rays = np.column_stack([away / c1.focal_px, np.ones(len(pixels))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rotation, center = c1.device_from_world.rotation, c1.center_world
    near, far = (cv_project(c2, center + t * rays @ rotation) for t in (330.0, 340.0))
    expected = (far - near).mean(axis=0)
    expected /= np.linalg.norm(expected)
    assert way @ expected > np.cos(np.radians(2.0))  # C1's distortion is left out here


# --- by hand ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rise", "stride"),
    [
        ((0.0, 0.0), (4, 4)),
        ((0.37, -0.37), (4, 4)),  # 4 * 0.37 < 1.5
        ((0.4, 0.1), (3, 4)),
        ((-0.49, 0.7), (3, 2)),
        ((0.51, 0.8), (2, 1)),
        ((3.0, -0.74), (1, 2)),
        ((2 * np.pi - 0.4, 0.0), (3, 4)),  # it wraps: a fall of 0.4
    ],
)
def test_stride_along_ramps(rise: tuple[float, float], stride: tuple[int, int]) -> None:
    rows, cols = np.indices((40, 50))
    phase = np.mod(rise[0] * rows + rise[1] * cols, 2 * np.pi).astype(np.float32)
    assert coarse_stride(phase) == stride
    hidden = np.random.default_rng(0).random(phase.shape) < 0.3
    assert coarse_stride(np.where(hidden, np.nan, phase).astype(np.float32)) == stride


def test_stride_is_that_of_the_steep_part() -> None:
    """Three quarters are to be continued: of two fifths steep and three flat the steep count."""
    steps = np.where(np.arange(50) < 20, 0.7, 0.1)
    phase = np.mod(np.cumsum(steps), 2 * np.pi) * np.ones((30, 1))
    assert coarse_stride(phase.astype(np.float32)) == (4, 2)
    steps[10:20] = 0.1
    phase = np.mod(np.cumsum(steps), 2 * np.pi) * np.ones((30, 1))
    assert coarse_stride(phase.astype(np.float32)) == (4, 4)


def test_stride_of_nothing_is_one() -> None:
    assert coarse_stride(np.full((20, 20), np.nan, np.float32)) == (1, 1)


def made_up(task: Task, shares: list[list[int]], weights: list[float]) -> Rivals:
    """Return solutions whose orders differ from the first's by the given numbers, repeated."""
    n = len(task.pixels)
    solutions = tuple(
        Solution(
            task.frame.constant((0.1 * i, 0.0), scatter_px=0.1),
            (np.resize(np.array(shifts, np.int32), n),),
            float(i),
        )
        for i, shifts in enumerate(shares)
    )
    return Rivals((task,), solutions, np.array(weights))


def test_agreement_is_the_weight_of_the_same_order() -> None:
    rig = nearly_symmetric()
    views = views_of(rig, PLANE)
    hole = np.zeros(views.phases1.rejection.shape, np.uint16)
    hole[40:80] = Rejection.LOW_MODULATION
    views = replace(views, phases1=views.phases1.rejecting(hole))
    task = task_of(rig, views, stride=(3, 2))
    n = len(task.pixels)
    rival = made_up(task, [[0], [0, 1, 0, 2], [0, 0, 3, 3]], [0.6, 0.3, 0.1])
    shape = rig.cameras[0].shape
    found = rival.agreement(shape)
    assert found.shape == shape
    expected = np.resize([1.0, 0.7, 0.9, 0.6], n)
    at = task.pixels.astype(int)
    np.testing.assert_allclose(found[at[:, 1], at[:, 0]], expected)
    # Each pixel of the coarse grid stands for those from it to the next.
    whole = np.ones(task.valid.shape)
    whole[task.valid] = expected
    for y, x in ((0, 0), (1, 1), (2, 1), (3, 1), (127, 159), (100, 33)):
        assert found[y, x] == pytest.approx(whole[y // 3, x // 2])
    # In a hole it is that of the nearest one: there are pixels whose sampled neighbour is dark.
    assert found[50, 50] == pytest.approx(whole[39 // 3, 50 // 2])
    assert rival.best is rival.solutions[0].bias


def test_agreement_is_that_of_the_numbered_scan() -> None:
    rig = nearly_symmetric()
    tasks = tuple(task_of(rig, views_of(rig, s), stride=(4, 4)) for s in (PLANE, SCENE))
    frame = tasks[0].frame
    same = [np.full(len(t.pixels), 20, np.int32) for t in tasks]
    pair = (
        Solution(frame.constant((0.0, 0.0), scatter_px=0.1), (same[0], same[1]), 0.0),
        Solution(frame.constant((0.4, 0.0), scatter_px=0.1), (same[0], same[1] + 1), 1.0),
    )
    rival = Rivals(tasks, pair, np.array([0.8, 0.2]))
    shape = rig.cameras[0].shape
    np.testing.assert_allclose(rival.agreement(shape, number=0), 1.0)
    there = tasks[1].pixels.astype(int)
    second = rival.agreement(shape, number=1)[there[:, 1], there[:, 0]]
    np.testing.assert_allclose(second, 0.8)


@pytest.mark.parametrize(
    ("second", "shift"),
    [([2], 2), ([0, 0, 0, -3], 3), ([1, 1, 5], 1), ([0], 0), ([NO_ORDER], 0), ([NO_ORDER, 4], 4)],
)
def test_shift_is_that_of_the_second_solution(second: list[int], shift: int) -> None:
    rig = nearly_symmetric()
    task = task_of(rig, views_of(rig, PLANE), stride=(4, 4))
    assert made_up(task, [[0], second, [9]], [0.5, 0.3, 0.2]).shift() == shift


def test_one_solution_has_no_rival() -> None:
    rig = nearly_symmetric()
    task = task_of(rig, views_of(rig, PLANE), stride=(4, 4))
    rival = made_up(task, [[0]], [1.0])
    assert rival.shift() == 0
    assert (rival.agreement(rig.cameras[0].shape) == 1).all()


@pytest.mark.parametrize(("n_same", "resembles"), [(9, False), (1, True)])
def test_solutions_resemble_by_their_orders(n_same: int, resembles: bool) -> None:
    rig = nearly_symmetric()
    task = task_of(rig, views_of(rig, PLANE), stride=(4, 4))
    n = len(task.pixels)
    order = np.zeros(n, np.int32)
    other = (np.arange(n) < 0.001 * n_same * n).astype(np.int32)
    bias = [task.frame.constant((c, 0.0), scatter_px=0.1) for c in (0.0, 5.0)]
    first, second = Solution(bias[0], (order,), 0.0), Solution(bias[1], (other,), 9.0)
    assert first.resembles(second) == resembles


@pytest.mark.parametrize("gap", [4.0, 12.0, 18.0, 30.0])
def test_odds_are_those_of_a_quarter_of_the_evidence(gap: float) -> None:
    rig = nearly_symmetric()
    task = task_of(rig, views_of(rig, PLANE), stride=(4, 4))
    order = np.zeros(len(task.pixels), np.int32)
    bias = task.frame.constant((0.0, 0.0), scatter_px=0.1)
    found = weighed(
        [task], [Solution(bias, (order,), 7.0), Solution(bias, (order + 1,), 7.0 + gap)]
    )
    np.testing.assert_allclose(found.agreements(), 1 / (1 + np.exp(-gap / 4)))
