"""What C2 decided around the points of C1, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._curves import pixel, turned


@njit(cache=True, nogil=True, error_model="numpy")
def count(  # type: ignore[no-untyped-def]
    depths, rays, camera2, turns1, is_alone, decided2, apart, strict, n_certain, n_agree, rows
):
    """Count the pixels of C2, of the nine around a point, that are certain, and that agree.

    depths (n,): mm; rays = (where (n,): number of the pixel, directions (pixel, 3) in the world,
    rotation onto the frame of C2); camera2 = (base (3,), lens); turns1 (n,): absolute phase,
    periods; is_alone (n,): of certain pixels only that counts which sees the point; decided2 =
    (turns2, certain2), (row, col): what C2 decided, NaN for nothing; apart: periods between what
    agrees. If strict, only those count that are certain.
    """
    base, lens = camera2
    where, directions, rotation = rays
    turns2, certain2 = decided2
    n_rows, n_cols = turns2.shape
    for i in range(rows[0], rows[1]):
        n_certain[i], n_agree[i] = 0, 0
        x, y = pixel(base, turned(rotation, directions[where[i]]), depths[i], lens)
        if math.isnan(x + y) or not (-2 < x < n_cols + 1 and -2 < y < n_rows + 1):
            continue
        col, row = int(np.rint(x)), int(np.rint(y))
        for near_row in range(max(row - 1, 0), min(row + 2, n_rows)):
            for near_col in range(max(col - 1, 0), min(col + 2, n_cols)):
                certain = certain2[near_row, near_col]
                sees = near_row == row and near_col == col
                n_certain[i] += certain and (sees or not is_alone[i])
                if abs(turns2[near_row, near_col] - turns1[i]) < apart and (certain or not strict):
                    n_agree[i] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def claim(depths, rays, camera2, claimed, rows):  # type: ignore[no-untyped-def]
    """Mark the pixels of C2, (row, col), that see points: some of `count`'s."""
    base, lens = camera2
    where, directions, rotation = rays
    n_rows, n_cols = claimed.shape
    for i in range(rows[0], rows[1]):
        x, y = pixel(base, turned(rotation, directions[where[i]]), depths[i], lens)
        if -0.5 < x < n_cols - 0.5 and -0.5 < y < n_rows - 0.5:
            claimed[int(np.rint(y)), int(np.rint(x))] = True
