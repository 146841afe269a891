"""Robust least squares of a projector's numbers, with what is likely beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fringe3d.calibrate._camera import INDEX, N_NUMBERS, Rows, focal_of, position_and_slopes
from fringe3d.calibrate._start import CAUCHY, MAD_TO_SIGMA
from fringe3d.calibrate.lit_points import BLOCKS_ACROSS

Floats = NDArray[np.float64]

LIKELY_FOCAL, FOCAL_SPREAD = 1.4, 0.7
"""Of the longer side; factor e^0.7 = 2 either way."""

ASPECT_SPREAD = 0.5
"""Logarithm; projectors whose mirrors stand on their corner have a ratio of 2."""

CENTER_SPREAD, SHIFT_SPREAD = 0.1, 0.5
"""Principal point beside the middle, parts of width and height: projectors shift up, not aside."""

PLACE_SPREAD = 0.25
"""The middle of the points beside the middle of the image, parts of width and height."""

BEND_AT_CORNER = {"k1": 0.05, "k2": 0.03, "k3": 0.03, "p1": 0.003, "p2": 0.003}
"""Distortion at the corner of the image, parts of its distance from the middle; p1 and p2 count
three times there."""

POWERS = {"k1": 2, "k2": 4, "k3": 6, "p1": 1, "p2": 1}

CHI2_MEDIAN = 0.4549
"""Of the square of a normal variable."""

MAX_EVALUATIONS = 20
REWEIGHTINGS = 10
COST_TOLERANCE = 1e-5
"""Part of the cost; a thousandth of a standard error."""

FIELD = 5
"""Blocks along a side of a field."""

LEAST_SCALE = 1e-3
"""Of the predicted noise: points without any must not divide by zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Likely:
    """What is likely before the fit: mean and spread of each number; an infinite spread is none.

    `place` is where the middle of the points is expected in the image, with its spread, px.
    """

    mean: Floats
    spread: Floats
    place: Floats
    place_spread: Floats

    @staticmethod
    def of(shape: tuple[int, int], focal: float, angles: Floats, /) -> Likely:
        """Return what is likely for a projector.

        Parameters
        ----------
        shape : (n_rows, n_cols)
        focal : float, px; about its focal length
        angles : (m,) float, rad; of the fringes: a shift that they do not show is taken as none
        """
        size = np.array([shape[1], shape[0]], np.float64)
        middle = (size - 1) / 2
        mean, spread = np.zeros(N_NUMBERS), np.full(N_NUMBERS, np.inf)
        mean[INDEX["log_focal"]] = np.log(LIKELY_FOCAL * size.max())
        spread[INDEX["log_focal"]] = FOCAL_SPREAD
        spread[INDEX["log_aspect"]] = ASPECT_SPREAD
        seen = float(np.abs(np.sin(angles)).max())
        up = CENTER_SPREAD + (SHIFT_SPREAD - CENTER_SPREAD) * seen
        mean[8:10], spread[8:10] = middle, size * [CENTER_SPREAD, up]
        corner = float(np.hypot(*size)) / 2 / focal
        for name, bend in BEND_AT_CORNER.items():
            spread[INDEX[name]] = bend / corner ** POWERS[name]
        return Likely(mean, spread, middle, PLACE_SPREAD * size)

    def equations(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Return residuals over their spread, (17,), and their derivatives, (17, 15)."""
        residual = np.empty(N_NUMBERS + 2)
        slopes = np.zeros((N_NUMBERS + 2, N_NUMBERS))
        residual[:N_NUMBERS] = (numbers - self.mean) / self.spread
        slopes[:N_NUMBERS] = np.diag(1 / self.spread)
        # The image of the middle; the distortion is too small to matter here.
        x, y, z = numbers[3:6]
        focal = focal_of(numbers)
        flat = focal * np.array([x, y]) / z
        residual[N_NUMBERS:] = (flat + numbers[8:10] - self.place) / self.place_spread
        for i in range(2):
            row = slopes[N_NUMBERS + i]
            row[3 + i], row[5], row[6], row[8 + i] = focal[i] / z, -flat[i] / z, flat[i], 1
            row[7] = flat[1] if i == 1 else 0.0
            row /= self.place_spread[i]
        return residual, slopes


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Numbers of a projector that fit rows of measurements.

    Parameters
    ----------
    numbers : (15,)
    start : (3, 3); rotation to which the rotation vector is relative
    free : (15,) bool; numbers that were fitted
    extra_px : float, px; noise besides the predicted one: calibration of the cameras, ...
    scale : float; factor of the predicted noise
    crowding : float, >= 1; how many neighbouring points count as one, for their errors agree
    """

    numbers: Floats
    start: Floats
    free: NDArray[np.bool_]
    extra_px: float = 0.0
    scale: float = 1.0
    crowding: float = 1.0

    def predicted(self, rows: Rows) -> tuple[Floats, Floats, Floats]:
        """Return the residual, px, its derivatives (m, 15), and its standard deviation, px."""
        position, slopes, by_point = position_and_slopes(
            self.numbers, self.start, rows.points, rows.angle
        )
        through_point = (by_point * rows.noise).sum(axis=1)
        sigma = self.scale * np.hypot(rows.sigma, through_point)
        return position - rows.position, slopes, np.hypot(sigma, self.extra_px)


def solve(rows: Rows, likely: Likely, at: Solution, free: NDArray[np.bool_], /) -> Solution:
    """Fit the free numbers; the others stay as they are.

    Parameters
    ----------
    rows : Rows
    likely : Likely
    at : Solution; where to begin, and the noise to assume
    free : (15,) bool
    """
    _, _, sigma = at.predicted(rows)
    stress = np.sqrt(at.crowding)
    found = replace(at, free=free)
    before = np.inf
    for _ in range(REWEIGHTINGS):
        residual, _, _ = found.predicted(rows)
        z = residual / sigma
        # Far from the solution all residuals are large: what sticks out is told by the typical.
        limit = CAUCHY * max(1.0, MAD_TO_SIGMA * float(np.median(np.abs(z))))
        prior, _ = likely.equations(found.numbers)
        cost = float(limit**2 * np.log1p((z / limit) ** 2).sum() + stress**2 * (prior @ prior))
        if cost > (1 - COST_TOLERANCE) * before:
            break
        weight = 1 / np.sqrt(1 + (z / limit) ** 2) / sigma
        found, before = _weighted(rows, likely, found, weight, stress), cost
    return found


def _weighted(rows: Rows, likely: Likely, at: Solution, weight: Floats, stress: float) -> Solution:
    """Solve with given weights of the rows."""

    def numbers_of(part: Floats) -> Floats:
        numbers = at.numbers.copy()
        numbers[at.free] = part
        return numbers

    def both(part: Floats) -> tuple[Floats, Floats]:
        if not np.array_equal(part, last[0]):
            numbers = numbers_of(part)
            position, by_number, _ = position_and_slopes(numbers, at.start, rows.points, rows.angle)
            prior, prior_slopes = likely.equations(numbers)
            last[0] = part.copy()
            last[1] = np.r_[(position - rows.position) * weight, stress * prior]
            last[2] = np.vstack([by_number * weight[:, None], stress * prior_slopes])[:, at.free]
        return last[1], last[2]

    last = [np.empty(0), np.empty(0), np.empty((0, 0))]

    def residuals(part: Floats) -> Floats:
        return both(part)[0]

    def slopes(part: Floats) -> Floats:
        return both(part)[1]

    found = least_squares(residuals, at.numbers[at.free], jac=slopes, method="lm", x_scale="jac",
                          ftol=COST_TOLERANCE / 10, max_nfev=MAX_EVALUATIONS)  # fmt: skip
    return replace(at, numbers=numbers_of(found.x))


def with_noise(rows: Rows, at: Solution, /) -> Solution:
    """Return the solution with the noise that its residuals show.

    Where they exceed the prediction, a constant part is added to all; where they fall short, the
    prediction is scaled. Neighbours whose errors agree count less: for independent errors the mean
    of a block of n has the n-th part of the variance.
    """
    plain = Solution(at.numbers, at.start, at.free)
    residual, _, sigma = plain.predicted(rows)
    found = float(np.median((residual / sigma) ** 2)) / CHI2_MEDIAN
    extra = 0.0
    if found > 1:
        lacking = float(np.median(residual**2)) / CHI2_MEDIAN - float(np.median(sigma**2))
        extra = np.sqrt(max(lacking, 0.0))
    scale = float(np.clip(np.sqrt(found), LEAST_SCALE, 1.0))
    noisy = Solution(at.numbers, at.start, at.free, extra, scale)
    _, _, sigma = noisy.predicted(rows)
    score = np.clip(residual / sigma, -CAUCHY, CAUCHY)
    crowding = max(_crowding(score, group, int(at.free.sum()))
                   for group in (rows.block, fields_of(rows.block)))  # fmt: skip
    return Solution(at.numbers, at.start, at.free, extra, scale, crowding)


def fields_of(block: NDArray[np.int64], /) -> NDArray[np.int64]:
    """Return the field of each block, 5 x 5 blocks; even and odd fields alternate in the image."""
    scan, place = np.divmod(block, BLOCKS_ACROSS**2)
    row, col = np.divmod(place, BLOCKS_ACROSS)
    across = -(-BLOCKS_ACROSS // FIELD)
    return np.asarray((scan * across + row // FIELD) * across + col // FIELD)


def _crowding(score: Floats, group: NDArray[np.int64], n_free: int) -> float:
    """Return by how much the means of groups scatter more than those of independent errors."""
    _, where = np.unique(group, return_inverse=True)
    count = np.bincount(where)
    if len(count) <= 2 * n_free or not score.any():  # the fit follows so few groups
        return 1.0
    means = np.bincount(where, score) / count
    left = 1 - n_free / len(count)
    return max(1.0, float((count * means**2).mean() / left / (score**2).mean()))


def information(rows: Rows, at: Solution, /) -> Floats:
    """Return the information that the measurements hold on all 15 numbers, (15, 15).

    Notes
    -----
    That of an M-estimator, ``(E psi')^2 / E psi^2 * sum J J^T``, over the crowding.
    """
    residual, slopes, sigma = at.predicted(rows)
    z = residual / sigma
    ratio = 1 + (z / CAUCHY) ** 2
    efficiency = float(np.mean((2 - ratio) / ratio**2)) ** 2 / float(np.mean((z / ratio) ** 2))
    weighted = slopes / sigma[:, None]
    return np.asarray(weighted.T @ weighted * efficiency / at.crowding)
