"""Phase of C2 between its pixels, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.kernels import HELPER

TWO_PI = 2.0 * math.pi

INTERPOLATION_WEIGHT = 4.0 / 9.0
"""Mean sum of squared weights of a bilinear interpolation at a random place, (2/3)**2."""

MAX_JUMP = 2.0
"""rad between neighbouring pixels; more is a depth edge or noise, not a surface."""

SPAN_ROUNDING = 1e-5
"""rad; more than single precision makes of a phase."""


@njit(cache=True, error_model="numpy", inline="always")
def wrap(angle):  # type: ignore[no-untyped-def]
    """Return an angle, rad, as -pi to pi."""
    return angle - TWO_PI * np.floor(angle * (1 / TWO_PI) + 0.5)


@njit(**HELPER)
def phase_difference(x, y, phase1, phase2):  # type: ignore[no-untyped-def]
    """Return phase2 - phase1 at (x, y), rad, wrapped, and the gradient of phase2, rad / px.

    Bilinear between the four neighbours, relative to one of them; a missing one is continued
    from the other three. NaN where fewer are valid.
    """
    n_rows, n_cols = phase2.shape
    if not (0 <= x < n_cols - 1 and 0 <= y < n_rows - 1):
        return np.nan, 0.0, 0.0
    col, row = int(x), int(y)
    a, b = phase2[row, col], phase2[row, col + 1]
    c, d = phase2[row + 1, col], phase2[row + 1, col + 1]
    missing = math.isnan(a) + math.isnan(b) + math.isnan(c) + math.isnan(d)
    if missing > 1:
        return np.nan, 0.0, 0.0
    origin = b if math.isnan(a) else a
    a, b, c, d = wrap(a - origin), wrap(b - origin), wrap(c - origin), wrap(d - origin)
    if missing == 1:
        if math.isnan(a):
            a = b + c - d
        elif math.isnan(b):
            b = a + d - c
        elif math.isnan(c):
            c = a + d - b
        else:
            d = b + c - a
    if max(a, b, c, d) - min(a, b, c, d) > MAX_JUMP:
        return np.nan, 0.0, 0.0
    fx, fy = x - col, y - row
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    gx = (b - a) * (1 - fy) + (d - c) * fy
    gy = (c - a) * (1 - fx) + (d - b) * fx
    return wrap(origin + value - phase1), gx, gy


@njit(cache=True, nogil=True, error_model="numpy")
def write_spans(phase2, spans, rows):  # type: ignore[no-untyped-def]
    """Write the phases that C2 shows between four neighbours, as `phase_difference` tells them.

    spans (row, col, 2): middle, rad, and half of the width, for the cell right below each pixel;
    negative where no phase is told, infinite where one of the four is missing: what is continued
    does not go on in the next cell. rows: first and last but one.
    """
    n_rows, n_cols = phase2.shape
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            spans[row, col, 0], spans[row, col, 1] = 0.0, -1.0
            if row == n_rows - 1 or col == n_cols - 1:
                continue
            a, b = phase2[row, col], phase2[row, col + 1]
            c, d = phase2[row + 1, col], phase2[row + 1, col + 1]
            missing = math.isnan(a) + math.isnan(b) + math.isnan(c) + math.isnan(d)
            if missing == 1:
                spans[row, col, 1] = np.inf
            elif missing == 0:
                b, c, d = wrap(b - a), wrap(c - a), wrap(d - a)
                low, high = min(0.0, b, c, d), max(0.0, b, c, d)
                if high - low <= MAX_JUMP:
                    spans[row, col, 0] = a + (low + high) / 2
                    spans[row, col, 1] = (high - low) / 2 + SPAN_ROUNDING


@njit(cache=True, error_model="numpy", inline="always")
def largest_sigma(x, y, phase, sigma):  # type: ignore[no-untyped-def]
    """Return the largest standard deviation of the four neighbours that have a phase."""
    row, col = int(y), int(x)
    largest = 0.0
    for i in range(2):
        for j in range(2):
            if not math.isnan(phase[row + i, col + j]):
                largest = max(largest, sigma[row + i, col + j])
    return largest
