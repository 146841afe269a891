"""Points that stand out of their surface, on surfaces in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.model import PointMap, Rejection
from fringe3d.triangulate import remove_outliers

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

SIGMA_MM, PITCH_MM, AWAY_MM, GAP_MM = 0.01, 0.1, 400.0, 1.0
ORIGIN = np.array([0.0, 0.0, AWAY_MM])
SHAPE = (60, 80)
Y, X = PITCH_MM * np.mgrid[: SHAPE[0], : SHAPE[1]]


def ball(radius_mm: float) -> Floats:
    """Return the height of a ball in the middle of a plane, which it leaves steeply."""
    away = np.hypot(X - X.mean(), Y - Y.mean())
    return np.asarray(np.sqrt(np.maximum(radius_mm**2 - away**2, 0)))


def point_map(height: Floats, seed: int | None = None, sigma: float = SIGMA_MM) -> PointMap:
    points = np.stack([X, Y, height], axis=-1)
    if seed is not None:
        away = points - ORIGIN
        unit = away / np.linalg.norm(away, axis=-1, keepdims=True)
        points = points + np.random.default_rng(seed).normal(0, sigma, (*SHAPE, 1)) * unit
    missing = ~np.isfinite(height)
    points[missing] = np.nan
    full = np.where(missing, np.nan, sigma)
    return PointMap(points_mm=points, sigma_mm=full, skew_mm=0 * full,
                    rejection=np.where(missing, np.uint16(Rejection.NO_MATCH), 0))  # fmt: skip


def found(points: PointMap, most_sigma: float = 6.0) -> NDArray[np.bool_]:
    left = remove_outliers(points, ORIGIN, max_gap_mm=GAP_MM, most_sigma=most_sigma)
    return np.asarray((left.rejection & np.uint16(Rejection.OUTLIER)) != 0)


@pytest.mark.parametrize(("radius_mm", "most"), [(0.0, 0), (1.0, 2), (2.5, 2)])
def test_noise_bends_and_edges_stay(radius_mm: float, most: int) -> None:
    """4,800 points with noise as sigma says. The rim of a ball on a plane is a vertical wall of one
    pixel; a point or two of it stand out as an outlier would."""
    for seed in range(3):
        assert found(point_map(ball(radius_mm), seed), 3.5).sum() <= most


def test_a_step_and_a_wire_stay() -> None:
    step = np.where(X > 4.0, 5.0, 0.0)
    wire = np.where(np.abs(X - 4.0) < PITCH_MM / 2, 0.8, 0.0)
    for height in (step, wire):
        assert not found(point_map(height, 1), 3.5).any()


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("most", "sigmas"), [(6.0, 8.37), (3.5, 4.88)])
def test_a_point_goes_where_it_is_off_by_so_many_sigma(
    most: float, sigmas: float, sign: int
) -> None:
    """Six times a single error, over sqrt(36 + 2 16 + 2) = 8.37 sigma: without noise, exactly."""
    for factor, is_out in ((0.98, False), (1.02, True)):
        height = np.zeros(SHAPE)
        height[30, 40] = sign * factor * sigmas * SIGMA_MM
        out = found(point_map(height), most)
        assert out[30, 40] == is_out
        assert out.sum() == is_out


def test_three_pixels_in_a_cross_go_and_their_neighbours_stay() -> None:
    height = np.zeros(SHAPE)
    cross = [(30, 40), (30, 41), (30, 39), (29, 40), (31, 40)]
    for place in cross:
        height[place] = 0.4
    out = found(point_map(height, 2))
    assert out[30, 40]
    wanted = np.zeros(SHAPE, bool)
    wanted[tuple(np.transpose(cross))] = True
    assert not (out & ~wanted).any()


def test_all_points_are_accounted_for() -> None:
    height = ball(2.5)
    height[5:8, 5:30] = np.nan
    height[30, 70] = 0.5
    before = point_map(height, 3)
    after = remove_outliers(before, ORIGIN, max_gap_mm=GAP_MM, most_sigma=6.0)
    assert np.array_equal(np.isfinite(after.points_mm).all(axis=-1), after.rejection == 0)
    gone = before.is_valid & ~after.is_valid
    assert np.argwhere(gone).tolist() == [[30, 70]]
