"""Saturated steps found, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def find_incomplete(images, steps, saturation, least, found, rows):  # type: ignore[no-untyped-def]
    """Tell which pixels, (row, col), have saturated steps, and at least `least` others.

    images (n, row, col): grey values; steps: numbers of the images; rows: first and last but one.
    """
    n_cols = images.shape[2]
    n_lost = np.empty(n_cols, np.uint8)
    most = len(steps) - least
    for row in range(rows[0], rows[1]):
        n_lost[:] = 0
        for step in steps:
            line = images[step, row]
            for col in range(n_cols):
                n_lost[col] += line[col] >= saturation
        for col in range(n_cols):
            found[row, col] = 0 < n_lost[col] <= most
