"""Fringe orders next to edges of a code from the nearest safe pixel, compiled.

`order.mended_orders` with ``plain=True`` says the same in words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fringe3d.decode._fused import CLEAR, CONTRADICTS, NAN, NONE, PHASE_BINS, TWO_PI, UNSAFE
from fringe3d.kernels import HELPER

f4, i4 = np.float32, np.int32

COLUMNS_AT_ONCE = 64
FAR = i4(1 << 20)
"""Rows; farther than any image is high."""

HALF = f4(0.5)


class Meaning(NamedTuple):
    """What words and classes mean: see `order.OrderTable`.

    `following` and `preceding` (n,) are the classes of the next and the previous order, for the
    class named ``first_order + i``.
    """

    alternatives: NDArray[np.int32]
    naive: NDArray[np.int32]
    following: NDArray[np.int32]
    preceding: NDArray[np.int32]
    first_order: np.int32


@njit(cache=True)
def nearest_rows(order, cells, left, right, nearest):  # type: ignore[no-untyped-def]
    """Write the row of the nearest safe pixel of each pixel's own column; the upper of two.

    Beyond the image where the column has none.
    """
    n_rows = order.shape[0]
    last = np.full(right - left, -FAR, i4)
    for row in range(n_rows):
        for x in range(right - left):
            is_safe = (order[row, left + x] != NONE) & (cells[row, left + x] & i4(UNSAFE) == 0)
            last[x] = i4(row) if is_safe else last[x]
            nearest[row, left + x] = last[x]
    last[:] = FAR
    for row in range(n_rows - 1, -1, -1):
        for x in range(right - left):
            above = nearest[row, left + x]
            last[x] = i4(row) if above == i4(row) else last[x]
            nearest[row, left + x] = last[x] if last[x] - i4(row) < i4(row) - above else above


@njit(**HELPER)
def nearest_column(nearest, row, col):  # type: ignore[no-untyped-def]
    """Return the column that holds the nearest safe pixel; the left one of two.

    -1 where there is none. With the upper of two rows these are the pixels that
    `scipy.ndimage.distance_transform_edt` names.
    """
    n_cols = nearest.shape[1]
    best, found, step = np.int64(FAR) * np.int64(FAR) // 4, -1, 0
    while step * step <= best and step < n_cols:
        if col >= step:
            away = np.int64(nearest[row, col - step]) - row
            if away * away + step * step <= best:
                best, found = away * away + step * step, col - step
        if col + step < n_cols:
            away = np.int64(nearest[row, col + step]) - row
            if away * away + step * step < best:
                best, found = away * away + step * step, col + step
        step += 1
    return found


@njit(**HELPER)
def _continued(maps, meaning, row, col, near_row, near_col):  # type: ignore[no-untyped-def]
    """Return the class that continues the phase of a safe pixel."""
    index = maps.order[near_row, near_col] - meaning.first_order
    turns = (maps.phase[near_row, near_col] - maps.phase[row, col]) / TWO_PI
    if turns > HALF:
        return meaning.following[index]
    if turns < -HALF:
        return meaning.preceding[index]
    return maps.order[near_row, near_col]


@njit(**HELPER)
def _mend_row(maps, meaning, nearest, any_safe, row):  # type: ignore[no-untyped-def]
    """Decide the unsafe pixels of a row; return how many have another order than their word."""
    n_corrected = 0
    for col in range(maps.order.shape[1]):
        cell = maps.cells[row, col]
        if not cell & UNSAFE:
            continue
        looked_up, place = maps.order[row, col], cell >> 3
        order = looked_up if cell & CLEAR else NONE
        if any_safe:
            near_col = nearest_column(nearest, row, col)
            near_row = nearest[row, near_col]
            expected = _continued(maps, meaning, row, col, near_row, near_col)
            one, two = meaning.alternatives[place, 0], meaning.alternatives[place, 1]
            possible = expected in (looked_up, one, two)
            order = expected if possible and expected != NONE else order
        maps.order[row, col] = order
        naive = meaning.naive[place // PHASE_BINS]
        if order == NONE:
            maps.phase[row, col] = NAN
            maps.rejection[row, col] = CONTRADICTS
        elif order != looked_up or (naive != NONE and naive != order):
            n_corrected += 1
    return n_corrected


@njit(cache=True, nogil=True)
def find_nearest(maps, nearest, blocks):  # type: ignore[no-untyped-def]
    """Write the rows of the nearest safe pixels, see `nearest_rows`; blocks: first and last but one
    of COLUMNS_AT_ONCE columns."""
    for block in range(blocks[0], blocks[1]):
        left = block * COLUMNS_AT_ONCE
        right = min(left + COLUMNS_AT_ONCE, maps.order.shape[1])
        nearest_rows(maps.order, maps.cells, left, right, nearest)


@njit(cache=True, nogil=True)
def mend_rows(maps, meaning, nearest, n_corrected, rows):  # type: ignore[no-untyped-def]
    """Decide all unsafe pixels of the maps (row, col) in place.

    nearest (row, col): see `find_nearest`. `n_corrected` (row,) are those with another order than
    their word; rows: first and last but one.
    """
    any_safe = False
    for col in range(maps.order.shape[1]):
        any_safe |= nearest[0, col] >= 0 and nearest[0, col] < maps.order.shape[0]
    for row in range(rows[0], rows[1]):
        n_corrected[row] = _mend_row(maps, meaning, nearest, any_safe, row)
