"""The calibration's bias, learnt from made-up evidence, and what candidates are weighed with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from changed_rigs import turned
from closed_form import demo_rig
from closed_phases import Surface, phase_map, seen_points, small_rig
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import Task, TwoViews
from fringe3d.correspond._orders import expect, weigh
from fringe3d.correspond.bias import Evidence, Frame, frame_of, joined, learn_bias
from fringe3d.correspond.both_ways import swapped, swapped_bias
from fringe3d.model import CalibrationBias, Device, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

CAMERA = demo_rig().cameras[0]
DEPTHS_MM = (322.0, 350.0)
FRAME = frame_of(CAMERA, DEPTHS_MM, 0.3)

N_POINTS = 9000
NOISE_PX = 0.05
LEAST_SCATTER_PX = 0.04
PRIOR_PX = 0.25 * np.array([1.0] * 6 + [28 / 336] * 3)
"""Of the coefficients; the depth changes by 28 of 336 mm."""

PERIOD_PX = 5.0
"""Camera px; what 1 px is in turns."""


def places(seed: int = 0) -> tuple[Floats, Floats, np.random.Generator]:
    """Return pixels and depths of two mixed surfaces."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0, 0], [640, 512], (N_POINTS, 2))
    depth = 330 + 0.01 * pixels[:, 0] + 8.0 * (rng.random(N_POINTS) < 0.5)
    return pixels, depth, rng


def quadratic(pixels: Floats) -> Floats:
    """Return a displacement, px, quadratic in the pixel, in x; another in y."""
    x, y = (pixels[:, 0] - 300) / 320, (pixels[:, 1] - 200) / 240
    return np.stack([
        0.4 - 0.2 * x + 0.15 * y + 0.1 * x * x - 0.08 * x * y + 0.05 * y * y,
        -0.1 + 0.1 * x - 0.25 * y - 0.06 * x * x + 0.04 * x * y + 0.1 * y * y,
    ], axis=1)  # fmt: skip


def gradients(rng: np.random.Generator, n: int = N_POINTS, *, spread: float = np.pi) -> Floats:
    """Return gradients of the phase, turns / px, their directions spread around x."""
    towards = rng.uniform(-spread / 2, spread / 2, n)
    steepness = rng.uniform(0.8, 1.25, n) / PERIOD_PX
    return np.stack([np.cos(towards), np.sin(towards)], axis=1) * steepness[:, None]


def evidence_of(
    pixels: Floats,
    depth: Floats,
    displacement: Floats,
    gradient: Floats,
    added_px: Floats | float = 0.0,
    *,
    noise_px: float = NOISE_PX,
) -> Evidence:
    """Return residuals of a displacement and `added_px` along the gradient."""
    steepness = np.linalg.norm(gradient, axis=1)
    return Evidence(
        pixels=pixels,
        depths_mm=depth,
        difference=(gradient * displacement).sum(axis=1) + steepness * added_px,
        gradient=gradient,
        variance=(noise_px * steepness) ** 2,
    )


def error_px(bias: CalibrationBias, data: Evidence, displacement: Floats) -> Floats:
    return np.asarray(bias.displacement(data.pixels, data.depths_mm) - displacement)


# --- the function --------------------------------------------------------------------------------


def some_bias(seed: int = 3) -> CalibrationBias:
    rng = np.random.default_rng(seed)
    return CalibrationBias(
        coefficients_px=rng.uniform(-1, 1, (2, 9)),
        middle=np.array([319.5, 255.5, 336.0]),
        scale=np.array([320.0, 256.0, 14.0]),
        scatter_px=0.1,
    )


def test_displacement_is_the_sum_of_its_terms() -> None:
    bias, (pixels, depth, _) = some_bias(), places()
    for i in range(5):
        x = (pixels[i, 0] - 319.5) / 320
        y = (pixels[i, 1] - 255.5) / 256
        t = (depth[i] - 336.0) / 14
        for axis in range(2):
            c = bias.coefficients_px[axis]
            expected = c[0] + c[1] * x + c[2] * y + c[3] * x**2 + c[4] * x * y + c[5] * y**2
            expected += (c[6] + c[7] * x + c[8] * y) * t
            found = bias.displacement(pixels[i : i + 1], depth[i : i + 1])[0, axis]
            assert found == pytest.approx(expected, abs=1e-12)


def test_displacement_along_a_ray_is_a_straight_line() -> None:
    bias, (pixels, depth, _) = some_bias(), places()
    along = bias.along(pixels)
    assert along.shape == (N_POINTS, 4)
    np.testing.assert_allclose(
        along[:, :2], bias.displacement(pixels, np.zeros(N_POINTS)), atol=1e-12
    )
    further = bias.displacement(pixels, depth + 3.0) - bias.displacement(pixels, depth)
    np.testing.assert_allclose(further, 3 * along[:, 2:], atol=1e-9)


@pytest.mark.parametrize(
    ("deg", "fits"),
    [(0.0, True), (1.0, True), (1.3, False), (90, False), (180, True), (-179, True)],
)
def test_a_bias_belongs_to_fringes_of_one_direction(deg: float, fits: bool) -> None:
    assert some_bias().fits(np.radians(deg)) == fits
    other = replace(some_bias(), angle=np.radians(90 + deg))
    assert other.fits(np.pi / 2) == fits
    assert other.fits(0.0) == (deg == 90)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"coefficients_px": np.zeros((2, 8))}, "bias: coefficients_px"),
        ({"coefficients_px": np.full((2, 9), np.nan)}, "bias: coefficients_px"),
        ({"middle": [1.0, 2.0]}, "bias: middle"),
        ({"scale": [1.0, 0.0, 1.0]}, r"bias: scale: expected numbers > 0, found \[1.0, 0.0, 1.0\]"),
    ],
)
def test_a_bias_of_wrong_numbers_is_refused(changes: dict[str, NDArray[np.float64]], text: str
                                            ) -> None:  # fmt: skip
    with pytest.raises(ValueError, match=text):
        replace(some_bias(), **changes)  # type: ignore[arg-type]


def test_frame_spans_the_image_and_the_depths() -> None:
    np.testing.assert_array_equal(FRAME.middle, [319.5, 255.5, 336.0])
    np.testing.assert_array_equal(FRAME.scale, [320.0, 256.0, 14.0])
    constant = FRAME.constant((0.2, -0.1), scatter_px=0.3)
    pixels, depth, _ = places()
    np.testing.assert_allclose(
        constant.displacement(pixels, depth), np.tile([0.2, -0.1], (N_POINTS, 1)), atol=1e-12
    )
    assert constant.scatter_px == 0.3
    np.testing.assert_allclose(FRAME.prior_px(), PRIOR_PX)


# --- learning ------------------------------------------------------------------------------------


def test_bias_is_learnt_under_noise() -> None:
    pixels, depth, rng = places()
    displacement = quadratic(pixels)
    data = evidence_of(pixels, depth, displacement, gradients(rng),
                       NOISE_PX * rng.standard_normal(N_POINTS))  # fmt: skip
    bias = learn_bias(data, FRAME, n_alike=1)
    # 9 coefficients of 4500 data each: 0.05 sqrt(2 * 9 / 9000) = 0.002 px, 5 times in corners.
    error = error_px(bias, data, displacement)
    assert np.abs(error).max() < 0.01
    assert np.sqrt((error**2).mean()) < 0.003
    assert bias.scatter_px == LEAST_SCATTER_PX  # all is noise
    assert bias.angle == 0.3


def test_bias_is_linear_in_depth() -> None:
    pixels, depth, rng = places()
    rise = np.array([0.012, -0.02])  # px / mm; 0.1 px between the surfaces
    displacement = quadratic(pixels) + rise * (depth - 335)[:, None]
    data = evidence_of(pixels, depth, displacement, gradients(rng),
                       NOISE_PX * rng.standard_normal(N_POINTS))  # fmt: skip
    bias = learn_bias(data, FRAME, n_alike=1)
    assert np.abs(error_px(bias, data, displacement)).max() < 0.015
    np.testing.assert_allclose(bias.along(pixels)[:, 2:], np.tile(rise, (N_POINTS, 1)), atol=0.002)


def test_bias_withstands_outliers() -> None:
    pixels, depth, rng = places()
    displacement = quadratic(pixels)
    added = NOISE_PX * rng.standard_normal(N_POINTS)
    stray = rng.random(N_POINTS) < 0.2
    added[stray] += rng.uniform(0.5, 4.0, stray.sum())  # all to one side
    data = evidence_of(pixels, depth, displacement, gradients(rng), added)
    error = np.abs(error_px(learn_bias(data, FRAME, n_alike=1), data, displacement))
    assert np.median(error) < 0.02
    assert error.max() < 0.05


def test_residuals_of_whole_turns_are_those_nearest_to_the_start() -> None:
    """From a start within half a period the fit finds what it would find without wrapping."""
    pixels, depth, rng = places()
    displacement = quadratic(pixels) + np.array([1.8, 0.0])  # up to 0.6 of a period
    data = evidence_of(pixels, depth, displacement, gradients(rng, spread=0.5))
    wrapped = replace(data, difference=data.difference - np.rint(data.difference))
    assert (wrapped.difference != data.difference).mean() > 0.2
    start = FRAME.constant((2.0, 0.0), scatter_px=0.15)
    bias = learn_bias(wrapped, FRAME, start=start, n_alike=1)
    assert np.abs(((bias.displacement(pixels, depth) - displacement) * data.gradient).sum(axis=1)
                  ).max() < 0.01 / PERIOD_PX  # fmt: skip


@pytest.mark.parametrize("towards_deg", [0.0, 90.0])
def test_what_the_fringes_do_not_show_stays_zero(towards_deg: float) -> None:
    pixels, depth, rng = places()
    towards = np.radians(towards_deg)
    unit = np.array([np.cos(towards), np.sin(towards)])
    gradient = np.tile(unit / PERIOD_PX, (N_POINTS, 1))
    displacement = quadratic(pixels)
    data = evidence_of(pixels, depth, displacement, gradient,
                       NOISE_PX * rng.standard_normal(N_POINTS))  # fmt: skip
    found = learn_bias(data, FRAME, n_alike=1).displacement(pixels, depth)
    shown, hidden = found @ unit, found @ [-unit[1], unit[0]]
    assert np.abs(shown - displacement @ unit).max() < 0.01
    assert np.abs(hidden).max() < 1e-9


def test_scatter_is_what_noise_leaves_unexplained() -> None:
    pixels, depth, rng = places()
    displacement = quadratic(pixels)
    rough = 0.15 * rng.standard_normal(N_POINTS) + 0.1 * rng.standard_normal(N_POINTS)
    for steeper in (1.0, 2.0):  # px are px, however dense the fringes
        gradient = gradients(np.random.default_rng(1)) * steeper
        data = evidence_of(pixels, depth, displacement, gradient, rough, noise_px=0.1)
        bias = learn_bias(data, FRAME, n_alike=1)
        assert bias.scatter_px == pytest.approx(0.15, abs=0.01)
        assert np.abs(error_px(bias, data, displacement)).max() < 0.03


def test_what_is_alike_is_one_datum_against_the_prior() -> None:
    """All points alike: nine coefficients of 0.25 px, less for depth, share one residual."""
    pixels, depth, rng = places()
    displacement = np.tile([0.1, 0.0], (N_POINTS, 1))
    gradient = np.tile([1 / PERIOD_PX, 0.0], (N_POINTS, 1))
    half = rng.standard_normal(N_POINTS // 2)
    data = evidence_of(pixels, depth, displacement, gradient,
                       0.5 * np.concatenate([half, -half]), noise_px=0.5)  # fmt: skip
    x, y, t = ((np.column_stack([pixels, depth]) - FRAME.middle) / FRAME.scale).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, t, t * x, t * y], axis=1)
    for n_alike in (float(N_POINTS), float(N_POINTS) / 20):
        found = learn_bias(data, FRAME, n_alike=n_alike).displacement(pixels, depth)
        robust = 0.629  # mean slope of r / (1 + (r / 2)**2) over normal residuals
        weight = robust / (0.5**2 + LEAST_SCATTER_PX**2) / n_alike
        normal = weight * terms.T @ terms
        ridge = np.diag(PRIOR_PX**-2.0)
        expected = np.linalg.solve(normal + ridge, normal[:, 0] * 0.1)
        assert 0.005 < np.mean(terms @ expected) < 0.09  # both have a say
        np.testing.assert_allclose(found[:, 0].mean(), np.mean(terms @ expected), rtol=0.08)


def test_the_part_that_is_sampled_counts_for_all() -> None:
    """Of 60 000 points every third is used, and stands for three."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform([0, 0], [640, 512], (60_000, 2))
    depth, gradient = rng.uniform(*DEPTHS_MM, 60_000), gradients(rng, 60_000)
    noise = NOISE_PX * rng.standard_normal(60_000)
    data = evidence_of(pixels, depth, quadratic(pixels), gradient, noise)
    whole, third = (learn_bias(part, FRAME, n_alike=256.0)
                    for part in (data, data.part(slice(None, None, 3))))  # fmt: skip
    assert third.sigma_px == pytest.approx(np.sqrt(3) * whole.sigma_px, rel=0.1)


def test_joined_evidence_is_all_of_it() -> None:
    pixels, depth, rng = places()
    data = evidence_of(pixels, depth, quadratic(pixels), gradients(rng),
                       NOISE_PX * rng.standard_normal(N_POINTS))  # fmt: skip
    together = joined([data.part(slice(0, 4000)), data.part(slice(4000, None))])
    assert len(together) == len(data)
    np.testing.assert_array_equal(
        learn_bias(together, FRAME).coefficients_px, learn_bias(data, FRAME).coefficients_px
    )


TURNS = np.linspace(0, np.pi, 1801)
"""rad; of lines, a tenth of a degree apart."""


@pytest.mark.parametrize("spread", [1.0, 0.02])
@pytest.mark.parametrize("noise_px", [0.05, 0.2])
def test_sigma_is_the_true_error_of_repeated_draws(noise_px: float, spread: float) -> None:
    """Biases drawn from the prior, noise from its law; errors at a grid that reaches the borders.

    There the error is largest: with all pixels alike it is 0.7 of sigma.
    """
    rng = np.random.default_rng(11)
    n = 3000
    pixels = rng.uniform([-0.5, -0.5], [639.5, 511.5], (n, 2))
    depth, gradient = rng.uniform(*DEPTHS_MM, n), gradients(rng, n)
    gradient *= [1.0, spread]
    # Of the lines through the origin the one that keeps most of the gradients.
    lines = np.stack([np.cos(TURNS), np.sin(TURNS)])
    steepest = lines[:, np.argmax(((gradient @ lines) ** 2).sum(axis=0))]
    at = np.linspace(-0.8, 0.8, 5)
    grid = np.stack([a.ravel() for a in np.meshgrid(at, at, at)], axis=1)
    grid = FRAME.middle + grid * FRAME.scale
    # The fit adds the least scatter to the noise that it is told: tell it the rest.
    told = np.sqrt(noise_px**2 - LEAST_SCATTER_PX**2)
    squared, sigmas = [], []
    for _ in range(60):
        true = FRAME.bias((rng.standard_normal((2, 9)) * PRIOR_PX).ravel(), scatter_px=0.0)
        data = evidence_of(pixels, depth, true.displacement(pixels, depth), gradient,
                           noise_px * rng.standard_normal(n), noise_px=told)  # fmt: skip
        bias = learn_bias(data, FRAME, n_alike=1)
        error = (bias.displacement(grid[:, :2], grid[:, 2])
                 - true.displacement(grid[:, :2], grid[:, 2]))  # fmt: skip
        squared.append(((error @ steepest) ** 2).mean())
        sigmas.append(bias.sigma_px)
    # 5 % careful: the weights are those of a robust fit.
    assert np.sqrt(np.mean(squared)) == pytest.approx(np.mean(sigmas), rel=0.12)


def test_what_is_known_counts_as_the_data_that_showed_it() -> None:
    """Half of the points after the other half tell what all of them tell together."""
    pixels, depth, rng = places()
    data = evidence_of(pixels, depth, quadratic(pixels), gradients(rng),
                       NOISE_PX * rng.standard_normal(N_POINTS))  # fmt: skip
    first, second = data.part(slice(None, None, 2)), data.part(slice(1, None, 2))
    before = learn_bias(first, FRAME, n_alike=1)
    after = learn_bias(second, FRAME, known=before, n_alike=1)
    together = learn_bias(data, FRAME, n_alike=1)
    assert before.covariance_px2 is not None
    assert after.covariance_px2 is not None
    assert together.covariance_px2 is not None
    sigma = np.sqrt(np.diag(before.covariance_px2)).reshape(2, 9)
    moved = np.abs(after.coefficients_px - before.coefficients_px) / sigma
    assert moved.max() > 0.5  # there is something to learn
    np.testing.assert_array_less(
        np.abs(after.coefficients_px - together.coefficients_px), 0.1 * sigma
    )
    # Correlations count: so does each element of the covariance.
    scale = np.sqrt(np.outer(*2 * [np.diag(together.covariance_px2)]))
    difference = (after.covariance_px2 - together.covariance_px2) / scale
    assert np.abs(difference).max() < 0.1


def test_covariance_along_a_slanting_direction() -> None:
    """Of n drawn biases the displacement along an axis scatters as the covariance says."""
    rng = np.random.default_rng(3)
    root = rng.uniform(-0.1, 0.1, (18, 18))
    covariance = root @ root.T + 1e-4 * np.eye(18)
    bias = FRAME.bias(np.zeros(18), scatter_px=0.0, covariance_px2=covariance)
    axis = np.array([0.8, -0.6])
    drawn = rng.multivariate_normal(np.zeros(18), covariance, 40_000).reshape(-1, 2, 9)
    along = axis[0] * drawn[:, 0] + axis[1] * drawn[:, 1]
    terms = rng.uniform(-1, 1, (20, 9))
    expected = np.einsum("ia,ab,ib->i", terms, bias.covariance_along(axis), terms)
    np.testing.assert_allclose((along @ terms.T).var(axis=0), expected, rtol=0.04)  # 5 sigma


# --- weighing ------------------------------------------------------------------------------------


@pytest.mark.parametrize("scatter", [0.0, 0.1])
def test_candidates_are_weighed_as_the_formula_says(scatter: float) -> None:
    """r = difference - gradient . (d0 + d1 t), wrapped; over variance + |gradient|**2 (scatter**2 +
    terms . covariance . terms)."""
    rng = np.random.default_rng(7)
    n, m = 400, 3
    depth = rng.uniform(320, 350, (n, m))
    gradient = rng.uniform(-0.2, 0.2, (n, m, 2))
    gradient[..., 1] *= 0.5  # the axes differ
    difference = rng.uniform(-0.5, 0.5, (n, m))
    variance = rng.uniform(0.005, 0.1, (n, m)) ** 2
    shown = np.stack([depth, difference, gradient[..., 0], gradient[..., 1], variance,
                      np.full((n, m), 2.0)], axis=-1).astype(np.float32)  # fmt: skip
    shown[::7, 1] = np.nan  # not seen by C2
    middle, scale = np.array([319.5, 255.5, 335.0]), np.array([320.0, 256.0, 15.0])
    pixels = rng.uniform(0, 1, (n, 2)) * [639, 511]
    coefficients = rng.uniform(0.2, 0.5, (2, 9)) * rng.choice([-1, 1], (2, 9))
    costs = np.empty((n, m), np.float32)
    root = scatter * rng.uniform(-1, 1, (9, 9))
    covariance = root @ root.T
    weigh(shown, pixels, (coefficients, middle, scale, covariance), scatter, 1 / 12, costs, (0, n))

    u, v = ((pixels - middle[:2]) / scale[:2]).T[:, :, None]
    t = (depth - middle[2]) / scale[2]
    one = np.ones_like(t)
    terms = [one, u * one, v * one, u * u * one, u * v * one, v * v * one, t, t * u, t * v]
    stacked = np.stack(terms, axis=-1)
    displacement = stacked @ coefficients.T
    unsure = ((stacked @ root) ** 2).sum(axis=-1)
    residual = difference - (gradient * displacement).sum(axis=-1)
    residual -= np.rint(residual)
    total = variance + (gradient**2).sum(axis=-1) * (scatter**2 + unsure)
    expected = np.where(total < 1 / 144, residual**2 / total, np.nan)
    expected[::7, 1] = np.nan
    known = np.isfinite(expected)
    assert 0.2 < known.mean() < 0.9  # some are too uncertain to tell
    np.testing.assert_array_equal(np.isfinite(costs), known)
    np.testing.assert_allclose(costs[known], expected[known], rtol=1e-4, atol=1e-3)
    # Each part of the bias has its say.
    for left_out in np.ndindex(2, 9):
        less = coefficients.copy()
        less[left_out] = 0
        weigh(shown, pixels, (less, middle, scale, covariance), scatter, 1 / 12, costs, (0, n))
        assert np.abs(costs[known] - expected[known]).max() > 1


def test_expected_residuals_are_the_bias_along_the_gradient() -> None:
    rng, bias = np.random.default_rng(8), some_bias()
    n = 300
    pixels = rng.uniform(0, 1, (n, 2)) * [639, 511]
    shown = np.empty((n, 6), np.float32)
    shown[:, 0], shown[:, 2:4] = rng.uniform(320, 350, n), rng.uniform(-0.2, 0.2, (n, 2))
    shown[:, 4] = rng.uniform(0.005, 0.1, n) ** 2
    expected, spread, sigma = np.empty(n), np.empty(n), np.empty(n)
    root = rng.uniform(-0.05, 0.05, (9, 9))
    field = bias.coefficients_px, bias.middle, bias.scale, root @ root.T
    expect(shown, pixels, field, 0.07, expected, spread, sigma, (0, n))
    gradient = shown[:, 2:4].astype(np.float64)
    moved = bias.displacement(pixels, shown[:, 0])
    np.testing.assert_allclose(expected, (gradient * moved).sum(axis=1), atol=1e-12)
    u, v = ((pixels - bias.middle[:2]) / bias.scale[:2]).T
    t = (shown[:, 0] - bias.middle[2]) / bias.scale[2]
    terms = np.stack([np.ones(n), u, v, u * u, u * v, v * v, t, t * u, t * v], axis=1)
    missed = np.sqrt(0.07**2 + ((terms @ root) ** 2).sum(axis=1))
    scatter = missed * np.linalg.norm(gradient, axis=1)
    np.testing.assert_allclose(spread, scatter, atol=1e-12)
    np.testing.assert_allclose(sigma, np.sqrt(shown[:, 4] + scatter**2), atol=1e-12)


# --- the other camera's view ---------------------------------------------------------------------


def depth_on_sheet(camera: Device, projector: Device, pixels: Floats, turns: Floats, period: float
                   ) -> Floats:  # fmt: skip
    """Return where rays of a camera meet light sheets, mm, by bisection on OpenCV's projection."""
    origin, directions = cv_rays(camera, pixels)

    def ahead(depth: Floats) -> Floats:
        place = cv_project(projector, origin + depth[:, None] * directions)
        return np.asarray((place[:, 0] + 0.5) / period - turns, np.float64)

    low, high = np.full(len(turns), 250.0), np.full(len(turns), 450.0)
    rising = ahead(high) > ahead(low)
    for _ in range(50):
        middle = (low + high) / 2
        is_low = (ahead(middle) < 0) == rising
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return np.asarray((low + high) / 2)


def task_of(rig: Rig, views: TwoViews) -> Task:
    assert rig.projector is not None
    assert rig.volume is not None
    return Task(views, rig.projector, rig.volume, 36.0, together=True, stride=(4, 4))


@pytest.mark.parametrize(("axis", "deg"), [("x", 0.01), ("y", 0.009), ("z", 0.15)])
def test_a_bias_seen_from_the_other_camera(axis: str, deg: float) -> None:
    """C2 is turned against its calibration; what both cameras miss follows from the projections.

    C1 and a light sheet place points on which C2 errs; C2 and the sheet others, on which C1 errs.
    """
    true = small_rig()
    c1, c2 = true.cameras
    assert true.projector is not None
    wrong = turned(c2, axis, deg)
    phases = [phase_map(c, true.projector, Surface(), n_classes=1) for c in (c1, c2)]
    views = TwoViews(camera1=c1, camera2=wrong, phases1=phases[0], phases2=phases[1])
    task = task_of(true, views)
    back = task_of(true, swapped(views))

    pixels = np.random.default_rng(2).uniform([-0.5, -0.5], [159.5, 127.5], (4000, 2))
    origin, directions = cv_rays(c1, pixels)
    frame, middle = task.frame, seen_points(c1, pixels, Surface())[0] - origin
    depth = frame.middle[2] + frame.scale[2] * np.linspace(-1, 1, len(pixels))
    bias = fitted(frame, pixels, depth, _missed_in_c2(c1, c2, wrong, pixels, depth))
    found = swapped_bias(bias, task, task.decide(bias), true.projector, back.frame)
    assert found.angle == bias.angle
    assert found.scatter_px == bias.scatter_px

    at_points = np.einsum("ij,ij->i", middle, directions)
    for where, off_px in ((depth, 0.012), (at_points, 0.012)):
        missed2 = _missed_in_c2(c1, c2, wrong, pixels, where)
        assert 0.1 < np.linalg.norm(missed2, axis=1).mean() < 0.5
        np.testing.assert_allclose(bias.displacement(pixels, where), missed2, atol=0.03)
        points = origin + where[:, None] * directions
        seen, period = cv_project(c2, points), phases[0].period_px
        turns = (cv_project(true.projector, points)[:, 0] + 0.5) / period
        inside = ((seen > -0.5) & (seen < [159.5, 127.5])).all(axis=1)
        depth2 = depth_on_sheet(wrong, true.projector, seen[inside], turns[inside], period)
        origin2, directions2 = cv_rays(wrong, seen[inside])
        missed = cv_project(c1, origin2 + depth2[:, None] * directions2) - pixels[inside]
        assert np.linalg.norm(missed, axis=1).mean() > 0.1
        shown = found.displacement(seen[inside], depth2)
        np.testing.assert_allclose(shown, missed, atol=off_px)


def _missed_in_c2(c1: Device, c2: Device, wrong: Device, pixels: Floats, depth: Floats) -> Floats:
    """Return where its calibration expects points in C2, less where C2 sees them."""
    origin, directions = cv_rays(c1, pixels)
    points = origin + depth[:, None] * directions
    return np.asarray(cv_project(wrong, points) - cv_project(c2, points))


def fitted(frame: Frame, pixels: Floats, depth: Floats, displacement: Floats) -> CalibrationBias:
    """Return the bias with the given displacements, by plain least squares."""
    x, y, t = ((np.column_stack([pixels, depth]) - frame.middle) / frame.scale).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, t, t * x, t * y], axis=1)
    coefficients = np.linalg.lstsq(terms, displacement)[0].T
    return frame.bias(coefficients.ravel(), scatter_px=0.07)
