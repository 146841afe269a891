"""Correlation of textures over a shift, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def profile(values, pixels, texture, normal, shifts, least, found, rows):  # type: ignore[no-untyped-def]
    """Write the correlation of values with an image at shifted places, for each shift (m,).

    values (n,): zero on average, about; pixels (n, 2): (x, y) in the image; texture (row, col): NaN
    where it is not known; normal (2,): direction of the shift; least: pairs needed, else 0.
    """
    n_rows, n_cols = texture.shape
    for k in range(rows[0], rows[1]):
        n, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(values)):
            x, y = pixels[i, 0] + shifts[k] * normal[0], pixels[i, 1] + shifts[k] * normal[1]
            if not (-0.5 <= x < n_cols and -0.5 <= y < n_rows):
                continue
            col, row = int(np.rint(x)), int(np.rint(y))
            if col >= n_cols or row >= n_rows:
                continue
            one, other = values[i], texture[row, col]
            if math.isnan(one + other):
                continue
            n += 1
            a, b = a + one, b + other
            aa, bb, ab = aa + one * one, bb + other * other, ab + one * other
        found[k] = 0.0
        if n >= least:
            spread = math.sqrt(max((aa - a * a / n) * (bb - b * b / n), 0.0))
            found[k] = (ab - a * b / n) / max(spread, 1e-30)
