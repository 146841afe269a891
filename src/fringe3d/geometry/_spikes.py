"""Points off the surface of their neighbours, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""(rows, columns) of the lines through a pixel."""

REACHES = (1, 2)
"""Pixels between neighbours on a line: what is three pixels wide is told from its surroundings."""

LEAST_WAYS = 3

UNEVEN = 1 / 3
"""Of the limit for a point: unevenness of neighbours beyond it is no noise. Noise makes the slopes
between them differ by 5 of their sigma at most, a sixth of the smallest limit."""


@njit(cache=True, nogil=True, error_model="numpy")
def _deviation(depth, sigma, row, col, down, right, gap, most):  # type: ignore[no-untyped-def]
    """Return the fourth difference along a line over its standard deviation; NaN where the
    neighbours on it are missing, not of one surface, or less even than the point is off them and
    than noise explains."""
    n_rows, n_cols = depth.shape
    low_row, high_row = row - 2 * down, row + 2 * down
    low_col, high_col = min(col - 2 * right, col + 2 * right), max(col - 2 * right, col + 2 * right)
    if low_row < 0 or high_row >= n_rows or low_col < 0 or high_col >= n_cols:
        return np.nan
    a, b = depth[row - 2 * down, col - 2 * right], depth[row - down, col - right]
    c, d = depth[row + down, col + right], depth[row + 2 * down, col + 2 * right]
    if not (abs(a - b) < gap and abs(b - c) < 2 * gap and abs(c - d) < gap):
        return np.nan
    variance = 36 * sigma[row, col] ** 2
    variance += 16 * (sigma[row - down, col - right] ** 2 + sigma[row + down, col + right] ** 2)
    variance += sigma[row - 2 * down, col - 2 * right] ** 2
    variance += sigma[row + 2 * down, col + 2 * right] ** 2
    off, noise = 6 * depth[row, col] - 4 * (b + c) + a + d, math.sqrt(variance)
    slopes = (b - a, (c - b) / 2, d - c)
    if max(slopes) - min(slopes) > max(abs(off) / 6, UNEVEN * most * noise):
        return np.nan
    return off / noise


@njit(cache=True, nogil=True, error_model="numpy")
def find_spikes(depth, sigma, most, gap, found, rows):  # type: ignore[no-untyped-def]
    """Tell which points stand out of the surface along all lines through them, to the same side.

    depth, sigma (row, col): mm, NaN where there is no point; most: standard deviations; gap: mm
    between neighbours of one surface, a pixel apart; rows: first and last but one.
    """
    for row in range(rows[0], rows[1]):
        for col in range(depth.shape[1]):
            found[row, col] = False
            if math.isnan(depth[row, col]):
                continue
            for reach in REACHES:
                n, above, below = 0, 0, 0
                for down, right in WAYS:
                    away = _deviation(
                        depth, sigma, row, col, reach * down, reach * right, reach * gap, most
                    )
                    n += not math.isnan(away)
                    above += away > most
                    below += away < -most
                if n >= LEAST_WAYS and (above == n or below == n):
                    found[row, col] = True
