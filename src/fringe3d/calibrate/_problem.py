"""A fit as data: its equations, what is likely beforehand, where to begin, how certain it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._camera import (
    INDEX,
    N_NUMBERS,
    NAMES,
    Rows,
    position_and_slopes,
    rotation_of,
)
from fringe3d.calibrate._solve import (
    CHI2_MEDIAN,
    LIKELY_FOCAL,
    Likely,
    Solution,
    information,
    solve,
)
from fringe3d.calibrate._start import CAUCHY, SQUARE, starts
from fringe3d.calibrate.lit_points import BLOCKS_ACROSS, LitPoints
from fringe3d.errors import CalibrationError

Floats = NDArray[np.float64]

START_SAMPLE = 2_000

ROUGH_PX = 0.05
"""Noise assumed where beginnings are compared."""

WORST_PX = 3.0
"""Median residual; such are no projector coordinates of these points."""

FILL = 0.9
"""Part of the image that the points may fill along fringes that do not show where they are."""

ROBUST_ENDS = (0.1, 99.9)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """The equations of a fit.

    Parameters
    ----------
    rows : Rows
    middle_mm : (3,); of all points, world frame
    shape : (n_rows, n_cols) of the projector
    likely : Likely
    n_directions : int; 1 or 2
    """

    rows: Rows
    middle_mm: Floats
    shape: tuple[int, int]
    likely: Likely
    n_directions: int

    def free(self, lens: str) -> NDArray[np.bool_]:
        """Return which of the 15 numbers are fitted for a lens with these terms."""
        terms = lens.split()
        free = np.array([i < INDEX["k1"] or name in terms for i, name in enumerate(NAMES)])
        # Fringes of one direction alone do not tell unequal focal lengths from a turn.
        free[INDEX["log_aspect"]] = self.n_directions > 1
        return free

    def solve(self, at: Solution, lens: str) -> Solution:
        """Fit with these terms of the lens; the others are zero."""
        free = self.free(lens)
        numbers = np.where(free | (np.arange(N_NUMBERS) < INDEX["k1"]), at.numbers, 0.0)
        return solve(self.rows, self.likely, replace(at, numbers=numbers), free)

    def covariance(self, at: Solution, lens: str) -> Floats:
        """Return the covariance of the numbers if these terms are free, (15, 15); 0 elsewhere."""
        free = self.free(lens)
        _, slopes = self.likely.equations(at.numbers)
        both = (information(self.rows, at) + slopes.T @ slopes)[np.ix_(free, free)]
        size = 1 / np.sqrt(np.diag(both))
        covariance = np.zeros((N_NUMBERS, N_NUMBERS))
        scaled = np.linalg.inv(both * size[:, None] * size)
        covariance[np.ix_(free, free)] = scaled * size[:, None] * size
        return covariance


def problem_of(scans: Sequence[LitPoints], shape: tuple[int, int], n_most: int, /) -> Problem:
    """Return the equations of scans, thinned to about `n_most`, spread over all blocks."""
    middle = np.concatenate([scan.points_mm for scan in scans]).mean(axis=0)
    parts = []
    for number, scan in enumerate(scans):
        for place, angle in enumerate(scan.angles):
            known = np.isfinite(scan.position_px[:, place])
            parts.append(
                Rows(
                    scan.points_mm[known] - middle,
                    np.full(int(known.sum()), angle),
                    scan.position_px[known, place],
                    scan.sigma_px[known, place],
                    scan.noise_mm[known],
                    scan.block[known] + number * BLOCKS_ACROSS**2,
                )
            )
    keys = ("points", "angle", "position", "sigma", "noise", "block")
    rows = Rows(*(np.concatenate([getattr(part, key) for part in parts]) for key in keys))
    rows = _thinned(rows, n_most)
    likely = Likely.of(shape, LIKELY_FOCAL * max(shape), rows.angle)
    apart = np.abs(np.sin(np.unique(rows.angle)[:, None] - np.unique(rows.angle)))
    return Problem(rows=rows, middle_mm=middle, shape=shape, likely=likely,
                   n_directions=1 + bool((apart > SQUARE).any()))  # fmt: skip


def _thinned(rows: Rows, n_most: int) -> Rows:
    """Keep equally many rows of each block and angle, evenly spaced; all of small ones."""
    _, group = np.unique(np.stack([rows.block.astype(float), rows.angle]), axis=1,
                         return_inverse=True)  # fmt: skip
    group = group.ravel()
    order = np.argsort(group, kind="stable")
    count = np.bincount(group)
    place = np.empty(len(rows), np.int64)
    place[order] = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    low, high = 1, max(int(count.max()), 1)
    while low < high:  # the largest share that keeps the total
        share = (low + high + 1) // 2
        low, high = (share, high) if np.minimum(count, share).sum() <= n_most else (low, share - 1)
    mine = np.minimum(count, low)[group]
    size = count[group]
    # Row i of n is kept where a step of its share begins.
    kept = (place * mine) // size != ((place - 1) * mine) // size
    return rows.take(kept)


def begin(problem: Problem, /) -> Solution:
    """Return the best of the fits without distortion that start from linear solutions.

    Raises
    ------
    CalibrationError
        If no projector shows the coordinates of the points.
    """
    found = _best_start(problem)
    if found is None:
        raise CalibrationError(no_projector(problem, float("inf")))
    return found


def _best_start(problem: Problem) -> Solution | None:
    few = replace(problem, rows=_thinned(problem.rows, START_SAMPLE))
    best, least = None, np.inf
    for numbers, rotation in starts(few.rows, few.shape):
        at = Solution(numbers, rotation, problem.free("pinhole"))
        residual, _, _ = at.predicted(few.rows)
        rough = float(np.median(residual**2)) / CHI2_MEDIAN
        if not np.isfinite(rough):
            continue
        found = few.solve(replace(at, extra_px=max(np.sqrt(rough), ROUGH_PX)), "pinhole")
        found = few.solve(replace(found, extra_px=ROUGH_PX), "pinhole")
        cost = _cost(few, found)
        if cost < least:
            best, least = found, cost
    return best


def no_projector(problem: Problem, typical_px: float, /) -> str:
    """Say why nothing fits: the directions contradict each other, or all is wrong."""
    rest = f": median residual {typical_px:.1f} px" if np.isfinite(typical_px) else ""
    angles = np.unique(problem.rows.angle)
    if problem.n_directions > 1 and all(_median_alone(problem, a) < WORST_PX for a in angles):
        return (
            f"the fringes of each direction fit a projector, but not the same{rest}. One direction "
            "is mirrored or shifted against the other: check shift_direction, first_coordinate "
            "and the code of both in the plan"
        )
    return (
        f"the coordinates of the points fit no projector{rest}. Check the plan (shift_direction, "
        "first_coordinate, cell_px), the calibration of the cameras, and that nothing moved "
        "between the scans"
    )


def _median_alone(problem: Problem, angle: float) -> float:
    """Return the median residual, px, of a fit to the fringes of one angle."""
    rows = problem.rows.take(problem.rows.angle == angle)
    found = _best_start(replace(problem, rows=rows, n_directions=1))
    if found is None:
        return float("inf")
    residual, _, _ = found.predicted(rows)
    return float(np.median(np.abs(residual)))


def _cost(problem: Problem, found: Solution) -> float:
    """Return how badly a fit fits; without bound if it looks at the scene from behind."""
    away = problem.rows.noise.mean(axis=0)
    if away @ rotation_of(found.numbers, found.start)[2] < 0 or found.numbers[5] <= 0:
        return float("inf")
    residual, _, sigma = found.predicted(problem.rows)
    prior, _ = problem.likely.equations(found.numbers)
    return float(CAUCHY**2 * np.log1p((residual / sigma / CAUCHY) ** 2).sum() + prior @ prior)


def axes_of(angle: float, /) -> Floats:
    """Return the directions across and along fringes, rows, (2, 2)."""
    across = np.array([np.cos(angle), np.sin(angle)])
    return np.stack([across, [-across[1], across[0]]])


def is_oblique(angle: float, /) -> bool:
    """Tell whether fringes follow neither the columns nor the rows."""
    return bool(abs(np.sin(2 * angle)) > SQUARE)


def by_convention(problem: Problem, at: Solution, /) -> Solution:
    """Let the image hold all points along fringes of one direction, which cannot show where.

    The principal point is moved along the fringes until the points lie in the middle. Where they
    reach beyond the image, the focal length in that direction is shortened, too. Neither has an
    influence on the coordinates across.
    """
    angle = float(problem.rows.angle[0])
    if problem.n_directions > 1 or (problem.rows.angle != angle).any():
        return at
    along = axes_of(angle)[1]
    position, _, _ = position_and_slopes(
        at.numbers, at.start, problem.rows.points, np.full(len(problem.rows), angle + np.pi / 2)
    )
    low, high = np.percentile(position, ROBUST_ENDS)
    size = np.array([problem.shape[1], problem.shape[0]])
    middle, room = float(along @ size) / 2, FILL * float(np.abs(along) @ size)
    numbers = at.numbers.copy()
    shrink = 1.0
    if high - low > room and not is_oblique(angle):
        hidden = int(np.argmax(np.abs(along)))
        shrink = room / float(high - low)
        numbers[7] += np.log(shrink) * (1 if hidden == 1 else -1)
        numbers[6] += np.log(shrink) * (hidden == 0)
        # The principal point stays; what it showed in the middle comes nearer to it.
        center = float(along @ (numbers[8:10] + 0.5))
        low, high = center + shrink * (np.array([low, high]) - center)
    numbers[8:10] += (middle - (low + high) / 2) * along
    return replace(at, numbers=numbers)
