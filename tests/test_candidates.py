"""Fringe orders by evidence: on exact phases, against brute force, and by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import (
    PLANE,
    Surface,
    choose,
    grid_of,
    moved,
    phase_map,
    seen_points,
    small_rig,
    true_turns,
    visible,
)
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import TwoViews
from fringe3d.correspond._aggregate import FAR, FAR_ENERGY, UNIT, aggregate, padded
from fringe3d.correspond._phase import largest_sigma
from fringe3d.model import NO_ORDER, MeasuringVolume, PhaseMap, Rejection, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCENE = Surface()
SEED = 4

STD_RAD = 0.01
"""Of the phases: 16 steps, 1 % noise."""

MODEL_PERIODS = 0.0015
LEAST_SCATTER_PX = 0.04
UNKNOWN_CALIBRATION_PX = 0.3
"""What choose_orders promises to allow for: imperfect phases, a learnt and an unknown bias."""

BILINEAR = 4 / 9
"""Mean of the squared weights of bilinear interpolation: (2/3)**2. Sigma leaves it out."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return a rig with the projector well off the middle: no order fits twice on a plane."""
    return small_rig(projector_azimuth_deg=-18.0)


@pytest.fixture(scope="module")
def symmetric() -> Rig:
    return small_rig(projector_azimuth_deg=0.0)


@cache
def views_of(
    rig: Rig,
    surface: Surface,
    *,
    n_classes: int | None = 1,
    std: float = STD_RAD,
    noisy: bool = True,
    second: bool = False,
) -> TwoViews:
    """Return the phases of both cameras, every n_classes-th order in one class."""
    assert rig.projector is not None
    rng = np.random.default_rng(SEED) if noisy else None
    c1, c2 = rig.cameras
    first = [phase_map(c, rig.projector, surface, n_classes=n_classes, std=std, rng=rng)
             for c in (c1, c2)]  # fmt: skip
    other = [phase_map(c, rig.projector, surface, n_classes=1, angle=np.pi / 2, std=std, rng=rng)
             for c in (c1, c2)]  # fmt: skip
    return TwoViews(
        camera1=c1, camera2=c2, phases1=first[0], phases2=first[1],
        second1=other[0] if second else None, second2=other[1] if second else None,
    )  # fmt: skip


def true_orders(rig: Rig, views: TwoViews, surface: Surface) -> NDArray[np.int64]:
    """Return the orders that belong to the (noisy) phases of C1: those of the nearest turns."""
    assert rig.projector is not None
    turns = true_turns(rig.cameras[0], rig.projector, surface, grid_of(rig.cameras[0]))
    own = np.nan_to_num(views.phases1.phase / (2 * np.pi))
    return np.asarray(np.rint(turns - own), np.int64)


# --- orders -----------------------------------------------------------------------------------


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("n_classes", [1, 2, 4, None])
def test_orders_are_right(rig: Rig, n_classes: int | None, together: bool) -> None:
    views = views_of(rig, SCENE, n_classes=n_classes)
    result = choose(rig, views, together=together)
    good, seen = result.phases.rejection == 0, visible(rig, SCENE)
    right = result.phases.order_class == true_orders(rig, views, SCENE)
    assert seen.sum() > 10_000
    # Without a code single pixels err on the lines where the residual of a wrong order crosses 0.
    assert good[seen].mean() > (0.995 if together else 0.985)
    assert (~right[good & seen]).mean() <= (0 if together or n_classes != 1 else 2e-3)
    assert (result.probability[good] >= 0.9).all()
    assert np.isnan(result.probability[~good]).all()
    assert np.isnan(result.residual[~good]).all()
    assert (result.phases.order_class[~good] == NO_ORDER).all()
    assert result.phases.is_absolute


def test_second_direction_tells_orders_apart() -> None:
    """Out of the plane of the cameras, fringes of the other direction see the wrong orders."""
    rig = small_rig(projector_azimuth_deg=0.0, projector_tilt_deg=40.0)
    views = views_of(rig, PLANE, second=True)
    result = choose(rig, views, together=False)
    alone = choose(rig, views_of(rig, PLANE), together=False)
    good, seen = result.phases.rejection == 0, visible(rig, PLANE)
    right = result.phases.order_class == true_orders(rig, views, PLANE)
    assert good[seen].mean() > 0.98
    assert right[good].all()
    assert (alone.phases.rejection == 0)[seen].mean() < good[seen].mean() - 0.3


def test_second_direction_has_its_say_among_neighbours() -> None:
    rig = small_rig(projector_azimuth_deg=0.0, projector_tilt_deg=40.0)
    views, seen = views_of(rig, PLANE, second=True), visible(rig, PLANE)
    result = choose(rig, views)
    good, truth = result.phases.rejection == 0, true_orders(rig, views, PLANE)
    assert good[seen].mean() > 0.995
    assert (result.phases.order_class == truth)[good].all()
    alone = choose(rig, views_of(rig, PLANE))
    right = (alone.phases.rejection == 0) & (alone.phases.order_class == truth)
    assert right[seen].mean() < 0.9


def test_second_direction_off_by_half_a_period_fits_nowhere(rig: Rig) -> None:
    views = views_of(rig, PLANE, n_classes=None, second=True)
    assert views.second1 is not None
    turned = np.mod(views.second1.phase + np.pi, 2 * np.pi)
    wrong = replace(views, second1=replace(views.second1, phase=turned))
    small = choose(rig, replace(views_of(rig, PLANE), second1=wrong.second1,
                                second2=views.second2), together=False)  # fmt: skip
    right = small.phases.order_class == true_orders(rig, views, PLANE)
    assert (right & (small.phases.rejection == 0)).mean() < 0.01


def test_together_heals_what_single_pixels_leave_open() -> None:
    """With the projector less far off the middle, only neighbours settle the orders."""
    rig = small_rig(projector_azimuth_deg=-12.0)
    views = views_of(rig, SCENE)
    seen, truth = visible(rig, SCENE), true_orders(rig, views, SCENE)
    alone, all_of_them = (choose(rig, views, together=t) for t in (False, True))
    found = [(r.phases.rejection == 0) & (r.phases.order_class == truth)
             for r in (alone, all_of_them)]  # fmt: skip
    assert found[0][seen].mean() < 0.5
    assert found[1][seen].mean() > 0.9
    wrong = (all_of_them.phases.rejection == 0) & (all_of_them.phases.order_class != truth)
    assert not wrong[seen].any()


# --- residual, its sigma, the bias -------------------------------------------------------------


@cache
def curve(rig: Rig, surface: Surface) -> dict[str, Floats]:
    """Return by finite differences what a step along the ray of C1 does in C2 and in P."""
    c1, c2 = rig.cameras
    assert rig.projector is not None
    points, depth, _ = seen_points(c1, grid_of(c1), surface)
    _, directions = cv_rays(c1, grid_of(c1))
    step, projector = 0.01 * directions, rig.projector  # mm
    places = cv_project(c2, points)
    tangent = cv_project(c2, points + step) - cv_project(c2, points - step)
    speed = np.linalg.norm(tangent, axis=-1) / 0.02
    unit = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    in_p = (cv_project(rig.projector, points + step) - cv_project(rig.projector, points - step))[
        ..., 0
    ] / 16.0 / 0.02  # fmt: skip

    def rise(offset: Floats) -> Floats:
        ahead = true_turns(c2, projector, surface, places + 0.01 * offset)
        behind = true_turns(c2, projector, surface, places - 0.01 * offset)
        return np.asarray((ahead - behind) / 0.02)

    gradient = np.stack([rise(np.array([1.0, 0.0])), rise(np.array([0.0, 1.0]))], axis=-1)
    slope = (gradient * unit).sum(-1)  # periods / px
    return {"places": places, "depth": depth, "unit": unit, "slope": slope, "gradient": gradient,
            "ratio": slope * speed / in_p}  # fmt: skip


def shifted(rig: Rig, xy: tuple[float, float]) -> Rig:
    """Return the rig as calibrated wrongly: the principal point of C2 displaced by (x, y) px."""
    c1, c2 = rig.cameras
    wrong = moved(c2, center_px=np.asarray(c2.center_px) + np.array(xy))
    return replace(rig, cameras=(c1, wrong))


@pytest.mark.parametrize("shift", [(0.25, 0.0), (-0.15, 0.1), (0.1, 0.3)])
def test_residual_and_bias_of_a_displaced_camera(rig: Rig, shift: tuple[float, float]) -> None:
    """Where a wrong calibration looks, C2 has another phase: exactly that is the residual."""
    views = views_of(rig, PLANE, n_classes=4, noisy=False)
    bad = shifted(rig, shift)
    assert rig.projector is not None
    result = choose(bad, replace(views, camera2=bad.cameras[1]), together=False)
    good, exact = (result.phases.rejection == 0) & visible(rig, PLANE), curve(rig, PLANE)
    c2 = rig.cameras[1]
    looked, meant = (true_turns(c2, rig.projector, PLANE, exact["places"] + np.array(offset))
                     for offset in (shift, (0.0, 0.0)))  # fmt: skip
    assert good.sum() > 10_000
    # Bilinear interpolation of a phase that is all but linear; float32 phases.
    np.testing.assert_allclose(result.residual[good], (looked - meant)[good], atol=5e-4)

    gradient, depth = exact["gradient"][good], exact["depth"][good]
    displacement = result.bias.displacement(grid_of(c2)[good], depth)
    shown = (gradient * displacement).sum(axis=-1)
    steepness = np.linalg.norm(gradient, axis=-1)
    assert np.abs((looked - meant)[good] / steepness).max() > 0.05  # px; else nothing is tested
    np.testing.assert_allclose(shown / steepness, (looked - meant)[good] / steepness, atol=0.02)
    assert result.bias.scatter_px == LEAST_SCATTER_PX
    assert result.bias.angle == 0.0


def test_sigma_is_that_of_the_formula(rig: Rig) -> None:
    views = views_of(rig, PLANE, n_classes=4, std=0.05, noisy=False)
    exact = curve(rig, PLANE)
    ratio, steepness = exact["ratio"], np.linalg.norm(exact["gradient"], axis=-1)
    assert np.abs(ratio - 1).min() > 0.2  # else the noise of C1 has no part in it
    for part, scatter in ((slice(None), LEAST_SCATTER_PX), (slice(0, 1), UNKNOWN_CALIBRATION_PX)):
        phases1 = views.phases1
        if part != slice(None):  # too few pixels to learn a bias from
            out = np.full(phases1.rejection.shape, np.uint16(Rejection.LOW_MODULATION))
            out[::4, ::4] = 0
            phases1 = phases1.rejecting(out)
        result = choose(rig, replace(views, phases1=phases1), together=False)
        good = (result.phases.rejection == 0) & visible(rig, PLANE)
        noise = 0.05 / (2 * np.pi)
        expected = np.sqrt(
            noise**2 * (1 + (ratio - 1) ** 2) + (scatter * steepness) ** 2 + MODEL_PERIODS**2
        )
        assert good.sum() > 500
        # Differences of neighbours in place of the exact gradient: 1 %.
        np.testing.assert_allclose(result.sigma[good], expected[good], rtol=0.01)


def test_residual_scatters_as_sigma_says(rig: Rig) -> None:
    std = 0.05
    views = views_of(rig, PLANE, n_classes=4, std=std)
    result = choose(rig, views, together=False)
    good, exact = (result.phases.rejection == 0) & visible(rig, PLANE), curve(rig, PLANE)
    from_c1 = (exact["ratio"] - 1) ** 2
    scatter = std / (2 * np.pi) * np.sqrt(BILINEAR + from_c1)
    # 16 000 residuals: their spread is known to 1 %; neighbours share pixels of C2.
    assert np.std(result.residual[good] / scatter[good]) == pytest.approx(1, abs=0.03)
    assert np.mean(result.residual[good] / scatter[good]) == pytest.approx(0, abs=0.05)
    # Sigma is careful by what interpolation averages, and by a calibration that here is exact.
    steep = 2 * np.pi * np.linalg.norm(exact["gradient"], axis=-1)
    careful = np.sqrt((BILINEAR + from_c1) / (1 + from_c1 + (LEAST_SCATTER_PX * steep / std) ** 2))
    pull = np.std(result.residual[good] / result.sigma[good])
    assert pull == pytest.approx(np.median(careful[good]), abs=0.03)


@pytest.mark.parametrize("n_classes", [4, None, 1])
def test_a_residual_of_more_than_a_twelfth_period_tells_nothing(
    rig: Rig, n_classes: int | None
) -> None:
    """Exact phases whose noise is said to leave 0.066 periods on the left, 0.1 on the right.

    Where the code leaves one order it stays, for C2 sees a point there; where there are several
    they are left open. C2 off by nearly half a period refutes the left side alone.
    """
    views = views_of(rig, PLANE, n_classes=n_classes, noisy=False)
    exact, seen = curve(rig, PLANE), visible(rig, PLANE)
    right = grid_of(rig.cameras[0])[..., 0] > 80
    std = 2 * np.pi * np.where(right, 0.095, 0.055) / np.abs(exact["ratio"] - 1)
    views = replace(views, phases1=replace(views.phases1, phase_std=std.astype(np.float32)))
    # Before a bias is learnt 0.3 px of 0.13 periods / px are added: both figures hold with them.
    from_c2 = UNKNOWN_CALIBRATION_PX * np.linalg.norm(exact["gradient"], axis=-1)
    sigma = np.hypot(np.where(right, 0.095, 0.055), from_c2)
    assert sigma[seen & ~right].max() < 0.072
    assert sigma[seen & right].min() > 0.1
    assert (seen & right).sum() > 5000
    result = choose(rig, views, together=False)
    if n_classes == 1:
        assert (result.phases.rejection[seen & right] == Rejection.AMBIGUOUS).all()
        return
    truth = true_orders(rig, views, PLANE)
    good = (result.phases.rejection == 0) & (result.phases.order_class == truth)
    assert good[seen].mean() > 0.99
    # C2 0.46 periods on, its classes of orders with it.
    turns = views.phases2.phase / (2 * np.pi) + 0.46
    carry = np.nan_to_num(np.rint(turns)).astype(np.int32)
    moved = views.phases2.order_class + carry
    moved = np.where(views.phases2.order_class == NO_ORDER, NO_ORDER,
                     moved if n_classes is None else moved % n_classes)  # fmt: skip
    off = (2 * np.pi * (turns - carry)).astype(np.float32)
    wrong = replace(views, phases2=replace(views.phases2, phase=off, order_class=moved))
    result = choose(rig, wrong, together=False)
    refuted = result.phases.rejection == Rejection.NO_MATCH
    assert refuted[seen & ~right].mean() > 0.99
    assert not refuted[seen & right].any()


@pytest.mark.parametrize(("x", "y"), [(0.2, 1.7), (1.9, 0.1), (2.0, 1.0)])
def test_the_least_certain_neighbour_in_c2_counts(x: float, y: float) -> None:
    """Of the four around a place; one without a phase has no say, however uncertain."""
    rng = np.random.default_rng(SEED)
    sigma = rng.uniform(0.1, 1.0, (4, 5)).astype(np.float32)
    phase = np.ones((4, 5), np.float32)
    around = [(int(y) + i, int(x) + j) for i in (0, 1) for j in (0, 1)]
    for _ in range(4):
        known = [float(sigma[place]) for place in around if np.isfinite(phase[place])]
        assert largest_sigma(x, y, phase, sigma) == max(known)
        phase[max((p for p in around if np.isfinite(phase[p])), key=lambda p: sigma[p])] = np.nan
    assert largest_sigma(x, y, phase, sigma) == 0.0


# --- reasons -----------------------------------------------------------------------------------


def neighbour_z(rig: Rig, by: int) -> float:
    """Return the z at which an order `by` from the truth puts the middle of the plane, mm."""
    c1, p = rig.cameras[0], rig.projector
    assert p is not None
    middle = np.array([[c1.n_cols / 2, c1.n_rows / 2]])
    origin, directions = cv_rays(c1, middle)
    points, depth, _ = seen_points(c1, middle, PLANE)
    along = origin + (depth[0] + np.linspace(-25, 25, 5001))[:, None] * directions
    w = cv_project(p, along)[:, 0]
    wanted = cv_project(p, points)[0, 0] + 16.0 * by
    return float(along[np.argmin(np.abs(w - wanted)), 2])


@pytest.mark.parametrize("side", [1, -1])
def test_surface_outside_the_volume_is_not_folded_into_it(rig: Rig, side: int) -> None:
    """Its twins lie inside; the wider segment holds the truth, and that fits better."""
    z = PLANE.plane_z_mm
    lowest, highest = sorted((z + side * 1.5, z + side * 18.5))
    assert any(lowest < neighbour_z(rig, by) < highest for by in (-1, 1))
    volume = MeasuringVolume.box([-40, -40, lowest], [40, 40, highest])
    result = choose(rig, views_of(rig, PLANE), volume)
    seen = visible(rig, PLANE)
    outside = (result.phases.rejection & Rejection.OUTSIDE_VOLUME) > 0
    assert (result.phases.rejection == 0)[seen].mean() < 0.005
    assert outside[seen].mean() > 0.5


def test_symmetric_rig_leaves_a_plane_open(symmetric: Rig) -> None:
    """All orders fit a plane nearly as well: no single pixel may claim to know."""
    views = views_of(symmetric, PLANE)
    result = choose(symmetric, views, together=False, min_probability=0.9)
    ambiguous = (result.phases.rejection & Rejection.AMBIGUOUS) > 0
    assert ambiguous[visible(symmetric, PLANE)].mean() > 0.95
    best = choose(symmetric, views, together=False, min_probability=0.0)
    assert (best.phases.rejection == 0)[visible(symmetric, PLANE)].mean() > 0.95


def test_rays_that_miss_the_volume_are_outside(rig: Rig) -> None:
    volume = MeasuringVolume.box([-40, -40, -12], [0, 40, 5])
    result = choose(rig, views_of(rig, PLANE, n_classes=4), volume)
    points, _, _ = seen_points(rig.cameras[0], grid_of(rig.cameras[0]), PLANE)
    beyond = points[..., 0] > 0.5
    assert beyond.sum() > 3000
    assert not (result.phases.rejection == 0)[beyond].any()
    seen = visible(rig, PLANE) & (points[..., 0] < -0.5)
    assert (result.phases.rejection == 0)[seen].mean() > 0.99


@pytest.mark.parametrize("n_classes", [4, 1])
def test_what_c2_does_not_see_has_no_match(rig: Rig, n_classes: int) -> None:
    views = views_of(rig, PLANE, n_classes=n_classes)
    hole = np.zeros(rig.cameras[1].shape, np.uint16)
    hole[40:80, 60:100] = Rejection.LOW_MODULATION
    views = replace(views, phases2=views.phases2.rejecting(hole))
    result = choose(rig, views, together=n_classes == 4)
    points, _, _ = seen_points(rig.cameras[0], grid_of(rig.cameras[0]), PLANE)
    x, y = np.moveaxis(cv_project(rig.cameras[1], points), -1, 0)
    hidden = (x > 62) & (x < 97) & (y > 42) & (y < 77)
    near = (x > 57) & (x < 102) & (y > 37) & (y < 82)
    good = result.phases.rejection == 0
    assert hidden.sum() > 800
    if n_classes == 4:
        assert ((result.phases.rejection & Rejection.NO_MATCH) > 0)[hidden].mean() > 0.99
    truth = true_orders(rig, views, PLANE)
    assert not (good & (result.phases.order_class == truth))[hidden].any()
    assert good[visible(rig, PLANE) & ~near].mean() > 0.98


def test_strict_asks_for_certainty(rig: Rig) -> None:
    views = views_of(rig, SCENE, n_classes=2)
    loose, strict = (choose(rig, views, strict=s) for s in (False, True))
    good, certain = loose.phases.rejection == 0, strict.phases.rejection == 0
    assert not (certain & ~good).any()
    assert certain[visible(rig, SCENE)].mean() > 0.995
    truth = true_orders(rig, views, SCENE)
    assert (strict.phases.order_class == truth)[certain].all()


def test_classes_of_c2_must_agree(rig: Rig) -> None:
    """With another class in C2 than the phase demands, no order fits, however good the phase."""
    views = views_of(rig, PLANE, n_classes=4)
    phases2 = views.phases2
    other = np.where(phases2.rejection == 0, (phases2.order_class + 1) % 4, NO_ORDER)
    result = choose(rig, replace(views, phases2=replace(phases2, order_class=other)),
                    together=False)  # fmt: skip
    assert not (result.phases.rejection == 0)[visible(rig, PLANE)].any()


def test_orders_may_begin_below_zero(rig: Rig) -> None:
    """Numbering the periods from elsewhere (a turned fringe) changes names and nothing else."""
    assert rig.projector is not None
    views = views_of(rig, SCENE, n_classes=4)
    columns = moved(rig.projector, center_px=np.asarray(rig.projector.center_px) - [640.0, 0.0])

    def renamed(phases: PhaseMap) -> PhaseMap:
        name = np.where(phases.order_class == NO_ORDER, NO_ORDER, phases.order_class - 40)
        return replace(phases, first_order=-40, class_of_order=phases.class_of_order - 40,
                       order_class=name)  # fmt: skip

    plain = choose(rig, views)
    turned = choose(replace(rig, projector=columns), replace(
        views, phases1=renamed(views.phases1), phases2=renamed(views.phases2)))  # fmt: skip
    np.testing.assert_array_equal(turned.phases.rejection, plain.phases.rejection)
    good = plain.phases.rejection == 0
    np.testing.assert_array_equal(turned.phases.order_class[good],
                                  plain.phases.order_class[good] - 40)  # fmt: skip


# --- aggregation against brute force -------------------------------------------------------------

ONE_ORDER, MANY_ORDERS, BEND_RAD, LEAST_PART = 5.0, 14.0, 0.3, 0.05
"""Penalties of the design: they fall with the bend of the phase, to a twentieth at most."""

COUNTED = 0.5 / UNIT
"""Costs and penalties are rounded to whole parts."""

ALL_WAYS = [d for d in itertools.product((-1, 0, 1), repeat=2) if d != (0, 0)]


class Problem:
    """A small image with candidates, and its path costs by recursion in plain Python."""

    def __init__(
        self,
        shape: tuple[int, int],
        n_labels: int,
        seed: int,
        *,
        holes: int = 0,
        label_step: int = 1,
        without_orders: int = 0,
    ) -> None:
        rng = np.random.default_rng(seed)
        # A slope of 1.9 rad a pixel with a few bends: the phase wraps every third pixel.
        rows, cols = np.indices(shape)
        absolute = 1.9 * cols + 0.8 * rows + 0.25 * rng.standard_normal(shape)
        absolute += 2.5 * (rng.random(shape) < 0.15)
        self.phase = np.mod(absolute, 2 * np.pi).astype(np.float32)
        hidden = rng.choice(rows.size, holes, replace=False)
        valid = np.ones(rows.size, bool)
        valid[hidden] = False
        self.index = np.full(shape, -1, np.int32)
        self.index[valid.reshape(shape)] = np.arange(valid.sum())
        self.phase[self.index < 0] = np.nan
        n = int(valid.sum())
        columns = np.sort(rng.permuted(np.tile(np.arange(10), (n, 1)), axis=1)[:, :n_labels])
        self.first, self.label_step = rng.integers(-3, 3, n).astype(np.int32), label_step
        self.orders = (self.first[:, None] + label_step * columns).astype(np.int32)
        self.costs = (rng.integers(0, 6 * UNIT, (n, n_labels)) / UNIT).astype(np.float32)
        short = rng.random(n) < 0.3
        self.costs[short, -1], self.orders[short, -1] = FAR, NO_ORDER
        bare = rng.choice(n, without_orders, replace=False)
        self.costs[bare], self.orders[bare], self.first[bare] = FAR, NO_ORDER, 0
        self.shape = shape

    def aggregated(self) -> NDArray[np.float64]:
        """Return what is found for the orders, half squared deviations."""
        known = self.orders != NO_ORDER
        column = np.where(known, (self.orders - self.first[:, None]) // self.label_step, 0)
        dense = np.full((len(self.orders), padded(10)), FAR, np.uint16)
        pixel = np.arange(len(dense))[:, None] + 0 * column
        dense[pixel[known], column[known]] = np.rint(UNIT * self.costs[known])
        found = aggregate(self.phase, self.index, self.first, self.label_step, dense)
        assert (found[dense == FAR] == FAR_ENERGY).all()
        return np.where(known, found[pixel, column] / UNIT, np.inf)

    def pixel(self, place: tuple[int, int]) -> int:
        inside = 0 <= place[0] < self.shape[0] and 0 <= place[1] < self.shape[1]
        return int(self.index[place]) if inside else -1

    def labels(self, i: int) -> list[int]:
        return [a for a in range(self.costs.shape[1]) if self.costs[i, a] < FAR]

    def penalty(self, here: tuple[int, int], step: tuple[int, int], a: int, b: int) -> float:
        """Return the price of order a here after order b one step before."""
        there = (here[0] - step[0], here[1] - step[1])
        before = (there[0] - step[0], there[1] - step[1])
        i, j = self.pixel(here), self.pixel(there)
        absolute = [float(self.phase[q]) + 2 * np.pi * int(self.orders[n, c])
                    for q, n, c in ((here, i, a), (there, j, b))]  # fmt: skip
        jump = abs(round((absolute[0] - absolute[1]) / (2 * np.pi)))
        if jump == 0:
            return 0.0
        weight = 1.0
        if self.pixel(before) >= 0:
            turn = [np.exp(1j * (float(self.phase[p]) - float(self.phase[q])))
                    for p, q in ((here, there), (there, before))]  # fmt: skip
            bend = float(np.angle(turn[0]) - np.angle(turn[1]))
            weight = max(float(np.exp(-((bend / BEND_RAD) ** 2))), LEAST_PART)
        return weight * (ONE_ORDER if jump == 1 else MANY_ORDERS)

    def path(self, here: tuple[int, int], step: tuple[int, int]) -> dict[int, float]:
        """Return the least cost of a path that ends here with each order, not normalised."""
        i, there = self.pixel(here), (here[0] - step[0], here[1] - step[1])
        own = {a: float(self.costs[i, a]) for a in self.labels(i)}
        if self.pixel(there) < 0 or not self.labels(self.pixel(there)):
            return own
        former = self.path(there, step)
        least = min(former.values())
        # A jump by many orders is open to every pair, whatever their distance.
        far = min(least + MANY_ORDERS * self.far_weight(here, step), np.inf)
        return {a: cost + min(far, *(former[b] + self.penalty(here, step, a, b) for b in former))
                for a, cost in own.items()}  # fmt: skip

    def far_weight(self, here: tuple[int, int], step: tuple[int, int]) -> float:
        """Return the part of the penalty that the bend leaves."""
        there = (here[0] - step[0], here[1] - step[1])
        before = (there[0] - step[0], there[1] - step[1])
        if self.pixel(before) < 0:
            return 1.0
        p, q, r = (float(self.phase[k]) for k in (here, there, before))
        bend = float(np.angle(np.exp(1j * (p - q))) - np.angle(np.exp(1j * (q - r))))
        return max(float(np.exp(-((bend / BEND_RAD) ** 2))), LEAST_PART)


@pytest.mark.parametrize(
    ("shape", "holes", "without_orders"),
    [((3, 3), 0, 0), ((3, 4), 1, 0), ((4, 5), 3, 0), ((3, 5), 0, 2), ((1, 6), 0, 1)],
)
@pytest.mark.parametrize(("seed", "label_step"), [(0, 1), (1, 1), (2, 1), (3, 2), (4, 3)])
def test_path_costs_equal_the_recursion(
    shape: tuple[int, int], holes: int, without_orders: int, seed: int, label_step: int
) -> None:
    """A pixel that lists no order at all ends a path, as a hole does."""
    problem = Problem(
        shape, 3, seed, holes=holes, label_step=label_step, without_orders=without_orders
    )
    result = problem.aggregated()
    for here in ((y, x) for y in range(shape[0]) for x in range(shape[1])):
        i = problem.pixel(here)
        if i < 0 or not problem.labels(i):
            continue
        paths = [problem.path(here, (y, x)) for y, x in ALL_WAYS]
        expected = np.array([
            sum(p[a] for p in paths) - 7 * float(problem.costs[i, a]) for a in problem.labels(i)
        ])  # fmt: skip
        found = result[i, problem.labels(i)].astype(float)
        # The compiled paths leave out a constant of each pixel. Up to four penalties on each path.
        most = 2 * len(ALL_WAYS) * 4 * COUNTED
        np.testing.assert_allclose(found - found.min(), expected - expected.min(), atol=most)
        missing = [a for a in range(3) if a not in problem.labels(i)]
        assert np.isinf(result[i, missing]).all()


@pytest.mark.parametrize("seed", range(4))
def test_energy_of_a_row_is_the_exact_least(seed: int) -> None:
    """Of all assignments that give a pixel this order the cheapest, by trying all of them."""
    problem = Problem((1, 6), 3, seed)
    result = problem.aggregated()
    right, left = (0, 1), (0, -1)
    for at in range(6):
        i = problem.pixel((0, at))
        least = dict.fromkeys(problem.labels(i), np.inf)
        for labels in itertools.product(*(problem.labels(q) for q in range(6))):
            energy = sum(float(problem.costs[q, a]) for q, a in enumerate(labels))
            for q in range(1, 6):  # each edge as a path towards the pixel passes it
                if q <= at:
                    energy += problem.penalty((0, q), right, labels[q], labels[q - 1])
                else:
                    energy += problem.penalty((0, q - 1), left, labels[q - 1], labels[q])
            least[labels[at]] = min(least[labels[at]], energy)
        expected, found = np.array(list(least.values())), result[i, problem.labels(i)]
        most = 2 * 5 * COUNTED
        np.testing.assert_allclose(found - found.min(), expected - expected.min(), atol=most)


def test_energy_does_not_depend_on_the_number_of_threads() -> None:
    """Bit for bit."""
    if numba.config.NUMBA_NUM_THREADS < 2:  # type: ignore[attr-defined]
        pytest.skip("one processor")
    problem = Problem((60, 80), 5, 1, holes=300)
    before, found = numba.get_num_threads(), []
    try:
        for n_threads in (1, 2):
            numba.set_num_threads(n_threads)
            found.append(problem.aggregated())
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0], found[1])


def test_phase_that_wraps_is_continuous() -> None:
    """On a steep ramp the free move keeps the absolute phase, not the order."""
    turns = 0.3 * np.arange(12) + 0.05
    costs = np.full((12, 8), FAR, np.uint16)
    costs[:, :6] = 0.4 * UNIT
    costs[5, 1], costs[5, 2:6] = 0, 6 * UNIT  # one pixel knows: 1.55 turns
    phase = (2 * np.pi * (turns % 1)).astype(np.float32)[None]
    index = np.arange(12, dtype=np.int32)[None]
    found = aggregate(phase, index, np.zeros(12, np.int32), 1, costs).argmin(axis=1)
    np.testing.assert_array_equal(found, np.floor(turns))
