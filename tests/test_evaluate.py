"""Comparison with truth, and planes, against closed forms and hand counts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.evaluate import (
    Verdict,
    errors_along_rays,
    false_share,
    fit_plane,
    score,
    sigma_without_bend,
    verdicts,
    verdicts_of_orders,
)

Floats = NDArray[np.float64]

RNG_SEED = 20261123


def test_errors_are_counted_along_the_ray_and_positive_behind_the_true_point() -> None:
    """Points set off along and across their rays by known lengths."""
    rng = np.random.default_rng(RNG_SEED)
    origin = np.array([10.0, -20.0, 300.0])
    rays = rng.normal(size=(4, 5, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    across = np.cross(rays, [0.3, 0.4, -0.5])
    behind = rng.uniform(-5, 5, (4, 5))
    true = origin + 200 * rays
    points = true + behind[..., None] * rays + 3 * across
    np.testing.assert_allclose(errors_along_rays(points, true, origin), behind, atol=1e-10)


def test_missing_points_have_no_error() -> None:
    points = np.array([[0.0, 0.0, 9.0], [np.nan] * 3, [0.0, 0.0, 9.0]])
    true = np.array([[0.0, 0.0, 10.0], [0.0, 0.0, 10.0], [np.nan] * 3])
    error = errors_along_rays(points, true, [0.0, 0.0, 0.0])
    assert error[0] == -1.0
    assert np.isnan(error[1:]).all()


def test_half_a_step_of_the_order_tells_right_from_wrong() -> None:
    """Steps of 6 and 8 mm; the limit belongs to the pixel, on both sides."""
    errors = [2.9, 3.1, -2.9, -3.1, 3.9, -4.1]
    half_step = np.array([6, 6, 6, 6, 8, 8]) / 2
    found = verdicts(errors, [True] * 6, half_step)
    assert found.tolist() == [1, 2, 1, 2, 1, 2]
    assert found.dtype == np.int8


def test_a_point_where_nothing_is_seen_or_nothing_is_known_is_wrong() -> None:
    errors, limits = [np.nan, np.nan, 0.1], [1.0, 1.0, np.nan]
    assert verdicts(errors, [True, False, True], limits).tolist() == [
        Verdict.WRONG, Verdict.MISSING, Verdict.WRONG,
    ]  # fmt: skip


def test_orders_are_judged_as_integers() -> None:
    found = verdicts_of_orders([[7, 8], [9, -1]], [[7, 7], [9, -1]], [[True, True], [False, True]])
    assert found.tolist() == [[1, 2], [0, 1]]


def test_scores_are_counts_by_hand() -> None:
    """10 pixels; the reference are the first 8: 5 right, 1 wrong, 2 missing; besides 2 wrong."""
    verdict = np.array([[1, 1, 1, 1, 1], [2, 0, 0, 2, 2]])
    reference = np.array([[True] * 5, [True, True, True, False, False]])
    found = score(verdict, reference)
    assert (found.n_reference, found.n_right, found.n_wrong) == (8, 5, 1)
    assert (found.n_accepted_anywhere, found.n_wrong_anywhere) == (8, 3)
    assert found.completeness == 5 / 8
    assert found.error_rate == 1 / 6
    assert found.error_rate_anywhere == 3 / 8


def test_a_method_is_complete_against_itself() -> None:
    verdict = np.array([1, 2, 0, 1, 1])
    itself = score(verdict, verdict == Verdict.RIGHT)
    assert (itself.completeness, itself.error_rate) == (1.0, 0.0)
    assert itself.error_rate_anywhere == 1 / 4


def test_without_pixels_a_score_is_not_a_number() -> None:
    nothing = score(np.zeros(3, int), np.zeros(3, bool))
    assert math.isnan(nothing.completeness)
    assert math.isnan(nothing.error_rate)
    assert math.isnan(nothing.error_rate_anywhere)
    with pytest.raises(ValueError, match=r"reference of shape \(3,\), found \(4,\)"):
        score(np.zeros(3, int), np.zeros(4, bool))


def test_false_points_count_against_those_of_the_object() -> None:
    """Four points on the object, two beside it, one of them on its border; more than 100 % fits."""
    accepted = np.array([1, 1, 1, 1, 0, 1, 1, 0], bool)
    on_object = np.array([1, 1, 1, 1, 1, 0, 0, 0], bool)
    border = np.array([0, 0, 0, 0, 0, 1, 0, 1], bool)
    assert false_share(accepted, on_object, border) == 1 / 4
    assert false_share(accepted, ~on_object, np.zeros(8, bool)) == 4 / 2
    assert math.isnan(false_share(accepted, np.zeros(8, bool), border))


def rippled(amplitude_mm: float = 0.02, n: int = 60) -> Floats:
    """Return points of z = a cos(2 pi x) on 10 whole waves, even about the middle, (10 n^2, 3)."""
    x, y = np.meshgrid((np.arange(10 * n) + 0.5) / n, np.arange(n) / n, indexing="ij")
    return np.stack([x, y, amplitude_mm * np.cos(2 * np.pi * x)], axis=-1).reshape(-1, 3)


def test_the_sigma_and_flatness_of_a_ripple_are_those_of_a_cosine() -> None:
    """Sigma a / sqrt 2, flatness 2 a cos(pi / 60): the samples next to the crests."""
    points = rippled()
    fit = fit_plane(points)
    assert fit.sigma_mm == pytest.approx(0.02 / math.sqrt(2), rel=1e-4)
    assert fit.form_mm == pytest.approx(0.04 * math.cos(math.pi / 60), rel=1e-9)
    np.testing.assert_allclose(fit.surface.normal, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(fit.surface.center_mm, points.mean(axis=0), atol=1e-12)
    assert (fit.n_used, fit.n_rejected) == (len(points), 0)


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, 80.0, 90.0])
def test_distances_are_square_to_the_plane_however_it_stands(tilt_deg: float) -> None:
    """A height above x and y would have no meaning at 90 degrees."""
    rng = np.random.default_rng(RNG_SEED)
    heights = rng.normal(0, 0.01, 4000)
    flat = np.column_stack([rng.uniform(-20, 20, (4000, 2)), heights])
    turn = Rotation.from_euler("zxz", [20, tilt_deg, -50], degrees=True)
    fit = fit_plane(turn.apply(flat) + np.array([100.0, 50.0, -300.0]))
    normal = turn.apply([0.0, 0.0, 1.0])
    assert abs(float(fit.surface.normal @ normal)) > 1 - 1e-8
    assert fit.surface.normal[np.argmax(np.abs(fit.surface.normal))] > 0
    # 3 of 4000 degrees of freedom go into the plane; it moves by sigma / sqrt(n).
    assert fit.sigma_mm == pytest.approx(float(heights.std()), rel=2e-3)
    sign = np.sign(fit.surface.normal @ normal)
    np.testing.assert_allclose(fit.distances_mm * sign, heights, atol=1.5e-3)


def test_sigma_divides_by_the_degrees_of_freedom() -> None:
    """Four corners, up and down by h: the plane is level, the squares 4 h^2, one degree left."""
    h = 0.05
    fit = fit_plane(np.array([[0, 0, h], [1, 0, -h], [1, 1, h], [0, 1, -h]]))
    assert fit.sigma_mm == pytest.approx(2 * h, rel=1e-12)
    assert math.isnan(fit_plane(np.eye(3)).sigma_mm)


def test_three_per_mille_are_left_out_and_not_a_point_more() -> None:
    """A thousand points of a ripple of 0.01 mm, three (then four) of them 6 mm off.

    One outlier left moves the plane by 6 mm / 1000, and stands 6 mm from it.
    """
    points = rippled(0.01, 10)
    assert len(points) == 1000
    points[[17, 500, 901], 2] += [6.0, -6.0, 6.0]
    fit = fit_plane(points, rejected_part=0.003)
    assert (fit.n_used, fit.n_rejected) == (997, 3)
    assert np.flatnonzero(~fit.is_used).tolist() == [17, 500, 901]
    assert fit.sigma_mm == pytest.approx(0.01 / math.sqrt(2), rel=0.01)
    assert fit.form_mm == pytest.approx(0.02 * math.cos(math.pi / 10), rel=0.01)
    np.testing.assert_allclose(fit.distances_mm[[17, 500, 901]], [6.0, -6.0, 6.0], atol=0.02)
    points[333, 2] -= 6.0
    fit = fit_plane(points, rejected_part=0.003)
    assert fit.n_rejected == 3
    assert fit.form_mm > 5.9
    assert fit_plane(points).n_rejected == 0


def test_a_bend_is_taken_off_and_a_ripple_is_not() -> None:
    """z = a cos + bends of second and third degree; a cubic fits only 0.2 % of ten waves."""
    points = rippled()
    x, y = points[:, 0] - 5, points[:, 1] - 0.5
    bent = points.copy()
    bent[:, 2] += 4e-3 * x**2 + 1e-3 * x * y - 5e-4 * x**3
    fit = fit_plane(bent)
    assert fit.sigma_mm > 0.03
    assert sigma_without_bend(bent, fit) == pytest.approx(0.02 / math.sqrt(2), rel=0.01)
    # The cubic's part that no parabola takes: 5e-4 * 5^3 * 2/5 of the Legendre polynomial P3.
    left = math.hypot(0.02 / math.sqrt(2), 0.025 / math.sqrt(7))
    assert sigma_without_bend(bent, fit, degree=2) == pytest.approx(left, rel=0.01)
    assert sigma_without_bend(bent, fit, degree=1) == pytest.approx(fit.sigma_mm, rel=1e-6)


def test_the_sigma_without_bend_does_not_depend_on_where_the_plane_stands() -> None:
    rng = np.random.default_rng(RNG_SEED)
    flat = np.column_stack([rng.uniform(-30, 30, (3000, 2)), rng.normal(0, 0.004, 3000)])
    flat[:, 2] += 2e-5 * flat[:, 0] ** 2 - 1e-5 * flat[:, 0] * flat[:, 1]
    turn = Rotation.from_euler("xyz", [70, -20, 140], degrees=True)
    moved = turn.apply(flat) + np.array([200.0, 0.0, 700.0])
    here, there = (sigma_without_bend(p, fit_plane(p)) for p in (flat, moved))
    assert here == pytest.approx(there, rel=1e-6)
    # The standard deviation of the standard deviation of 3000 samples is 1.3 %: three of them.
    assert here == pytest.approx(0.004, rel=0.04)


def test_points_left_out_do_not_count_after_the_bend_is_taken_off() -> None:
    points = rippled(0.01, 10)
    points[[17, 500, 901], 2] += [6.0, -6.0, 6.0]
    fit = fit_plane(points, rejected_part=0.003)
    assert sigma_without_bend(points, fit) < 0.0075
    assert math.isnan(sigma_without_bend(points[:4], fit_plane(rippled()[[0, 1, 70, 200]])))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((2, 3)), r"at least 3 points of shape \(n, 3\), found shape \(2, 3\)"),
        (np.zeros((5, 2)), r"found shape \(5, 2\)"),
        (np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2.0], [5, 5, 5]]), "all on one line"),
        (np.full((4, 3), 7.0), "all on one line"),
        (np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0.0]]), "found NaN"),
    ],
)
def test_what_is_no_plane_is_said(points: Floats, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_plane(points)


def test_options_of_a_plane_outside_their_domain_are_said() -> None:
    with pytest.raises(ValueError, match=r"rejected_part: expected 0 to 0\.5, found 0\.5"):
        fit_plane(rippled(), rejected_part=0.5)
    with pytest.raises(ValueError, match="degree: expected a whole number of at least 1, found 0"):
        sigma_without_bend(rippled(), fit_plane(rippled()), degree=0)
