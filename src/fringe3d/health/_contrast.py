"""The fine structure of a surface's brightness, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

f4 = np.float32

REACH = 3
"""Pixels around one that must be lit."""

OUTER, INNER, MIDDLE = f4(1 / 16), f4(4 / 16), f4(6 / 16)
"""Binomial weights over five pixels: a Gaussian of 1 px."""


@njit(cache=True, error_model="numpy")
def _average_down(bright, row, average, n_lit):  # type: ignore[no-untyped-def]
    """Write the weighted mean of five rows, and how many of seven are lit, (col,)."""
    a, b, c, d, e = (bright[row - 2], bright[row - 1], bright[row], bright[row + 1],
                     bright[row + 2])  # fmt: skip
    for x in range(len(average)):
        average[x] = OUTER * (a[x] + e[x]) + INNER * (b[x] + d[x]) + MIDDLE * c[x]
    f, g = bright[row - REACH], bright[row + REACH]
    for x in range(len(average)):
        # NaN marks what is not lit, and stays NaN in a sum.
        n_lit[x] = average[x] + f[x] + g[x]


@njit(cache=True, error_model="numpy")
def _slow_part(blocks, row, block_px, line):  # type: ignore[no-untyped-def]
    """Write the slow part of the brightness in one row, (col,), linear between block centres."""
    n_rows, n_cols = blocks.shape
    at = min(max((row + f4(0.5)) / block_px - f4(0.5), f4(0)), f4(n_rows - 1))
    top = min(int(at), max(n_rows - 2, 0))
    part = f4(at - top)
    upper, lower = blocks[top], blocks[min(top + 1, n_rows - 1)]
    for x in range(len(line)):
        at = min(max((x + f4(0.5)) / block_px - f4(0.5), f4(0)), f4(n_cols - 1))
        left = min(int(at), max(n_cols - 2, 0))
        right = min(left + 1, n_cols - 1)
        here = upper[left] + part * (lower[left] - upper[left])
        there = upper[right] + part * (lower[right] - upper[right])
        line[x] = here + f4(at - left) * (there - here)


@njit(cache=True, nogil=True, error_model="numpy")
def fine_contrast(bright, blocks, block_px, contrast, rows):  # type: ignore[no-untyped-def]
    """Write the brightness, slightly smoothed, less its slow part, (row, col).

    bright (row, col): logarithm, NaN where the surface is not lit; blocks: the slow part at the
    centres of blocks of `block_px` pixels. NaN where not all of 7 x 7 pixels are lit.
    """
    n_rows, n_cols = bright.shape
    for row in range(rows[0], rows[1]):
        contrast[row] = np.nan
        if row < REACH or row >= n_rows - REACH:
            continue
        average, lit, slow = np.empty(n_cols, f4), np.empty(n_cols, f4), np.empty(n_cols, f4)
        _average_down(bright, row, average, lit)
        _slow_part(blocks, row, block_px, slow)
        for x in range(REACH, n_cols - REACH):
            fine = OUTER * (average[x - 2] + average[x + 2]) + MIDDLE * average[x]
            fine += INNER * (average[x - 1] + average[x + 1])
            known = lit[x - 3] + lit[x - 2] + lit[x - 1] + lit[x] + lit[x + 1] + lit[x + 2]
            contrast[row, x] = fine - slow[x] + f4(0) * (known + lit[x + 3])
