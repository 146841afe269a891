"""The phase averaged over neighbours of one surface, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._phase import wrap

f4 = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def average(phase, sigma, radius, limits, averaged, sigma_averaged, rows):  # type: ignore[no-untyped-def]
    """Write the phase averaged over pairs of pixels that lie opposite each other, (row, col) rad.

    phase, sigma (row, col): rad, NaN where unknown; radius: px; limits = (second difference of a
    pair and the pixel between, rad; the same in standard deviations of the pixel); rows = (first,
    last but one). A pair is left out where it deviates by more, or one of it is unknown. Averages
    are not wrapped again.
    """
    n_rows, n_cols = phase.shape
    most, most_sigma = limits
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            here, noise = phase[row, col], sigma[row, col]
            averaged[row, col], sigma_averaged[row, col] = here, noise
            if math.isnan(here):
                continue
            limit = most * most + (most_sigma * noise) ** 2
            total, n = f4(0.0), 1
            for dy in range(radius + 1):
                for dx in range(-radius if dy > 0 else 1, radius + 1):
                    up, down = row - dy, row + dy
                    left, right = col - dx, col + dx
                    if up < 0 or down >= n_rows or min(left, right) < 0:
                        continue
                    if max(left, right) >= n_cols:
                        continue
                    rise = wrap(phase[down, right] - here)
                    bend = wrap(rise + wrap(phase[up, left] - here))
                    if bend * bend < limit:  # not where one is NaN
                        total += bend
                        n += 2
            averaged[row, col] = here + total / n
            sigma_averaged[row, col] = noise / math.sqrt(n)
