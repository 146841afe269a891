"""Fringe orders that go on from the frame before, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._phase import TWO_PI
from fringe3d.model import NO_ORDER

NONE = np.int32(NO_ORDER)

LEAST_AROUND = 3
"""Neighbours of four that close a hole, or two that face each other: the border of what is known
does not grow by them."""

ROWS_APART = 4
"""Of the rows that tell by how much all phases have moved."""


@njit(cache=True, nogil=True, error_model="numpy")
def enter(places, depths, turns, nearest, before):  # type: ignore[no-untyped-def]
    """Enter the absolute phase of points, turns, into the image of a device, nearer before farther.

    places (n, 2): px; depths (n,): mm; nearest, before (row, col): depth and phase, infinite and
    NaN where there is no point.
    """
    n_rows, n_cols = before.shape
    nearest[:], before[:] = np.inf, np.nan
    for i in range(len(depths)):
        x, y = places[i, 0], places[i, 1]
        if not (-0.5 < x < n_cols - 0.5 and -0.5 < y < n_rows - 0.5):
            continue
        row, col = int(np.rint(y)), int(np.rint(x))
        if depths[i] < nearest[row, col]:
            nearest[row, col], before[row, col] = depths[i], turns[i]


@njit(cache=True, nogil=True, error_model="numpy")
def common_motion(phase, before):  # type: ignore[no-untyped-def]
    """Return by how many turns most phases have moved since, within half a turn, and how common
    that is, 0 to 1.

    phase, before (row, col): rad, wrapped, and turns; NaN where there is none. Some rows are asked.
    """
    c, s, n = 0.0, 0.0, 0
    for row in range(0, phase.shape[0], ROWS_APART):
        for col in range(phase.shape[1]):
            moved = phase[row, col] - TWO_PI * before[row, col]
            if not math.isnan(moved):
                c += math.cos(moved)
                s += math.sin(moved)
                n += 1
    return math.atan2(s, c) / TWO_PI, math.hypot(c, s) / max(n, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def go_on(phase, before, moved, most, order, rows):  # type: ignore[no-untyped-def]
    """Write the order nearest to the phase before, (row, col), none where it is off by more than
    `most` turns; moved: turns that all phases have moved; rows: first and last but one."""
    for row in range(rows[0], rows[1]):
        for col in range(phase.shape[1]):
            ahead = before[row, col] + moved - phase[row, col] / TWO_PI
            whole = np.rint(ahead)
            order[row, col] = np.int32(whole) if abs(ahead - whole) <= most else NONE


@njit(cache=True, error_model="numpy", inline="always")
def _demanded(order, phase, rise, other_phase):  # type: ignore[no-untyped-def]
    """Return the order that a neighbour has, to which the phase rises."""
    return order + np.int32(np.rint((phase + rise - other_phase) / TWO_PI))


@njit(cache=True, nogil=True, error_model="numpy")
def by_neighbours(phase, rises, smooth, order, kept, rows):  # type: ignore[no-untyped-def]
    """Write the orders, (row, col), but those that as many smooth neighbours contradict as confirm;
    and that of its neighbours where there is none, see `LEAST_AROUND`.

    rises, smooth (2, row, col): see `grid.rises_of`; rows: first and last but one.
    """
    n_rows, n_cols = order.shape
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            kept[row, col] = own = order[row, col]
            if math.isnan(phase[row, col]):
                continue
            wanted, same, others, faces = own, 0, 0, False
            for axis in range(2):
                down, right, before = 1 - axis, axis, same
                for sign in (-1, 1):
                    y, x = row + sign * down, col + sign * right
                    if not (0 <= y < n_rows and 0 <= x < n_cols) or order[y, x] == NONE:
                        continue
                    first_row, first_col = min(row, y), min(col, x)
                    if not smooth[axis, first_row, first_col]:
                        continue
                    rise = -sign * rises[axis, first_row, first_col]
                    demanded = _demanded(order[y, x], phase[y, x], rise, phase[row, col])
                    wanted = demanded if wanted == NONE else wanted
                    same += demanded == wanted
                    others += demanded != wanted
                faces |= same == before + 2
            if own == NONE and (same >= LEAST_AROUND or faces) and others == 0:
                kept[row, col] = wanted
            elif own != NONE and others > 0 and others >= same:
                kept[row, col] = NONE


@njit(cache=True, nogil=True, error_model="numpy")
def carry_on(phase, rises, smooth, reach, order):  # type: ignore[no-untyped-def]
    """Give pixels without an order that of a smooth neighbour, `reach` pixels far, (row, col)."""
    n_rows, n_cols = order.shape
    away = np.zeros(order.shape, np.uint8)
    n_given = np.zeros(4, np.int64)
    for sweep in range(4):
        if sweep >= 2 and n_given[sweep - 1] + n_given[sweep - 2] == 0:
            break  # both ways nothing was given
        sign = 1 if sweep % 2 == 0 else -1
        for line in range(n_rows):
            row = line if sign > 0 else n_rows - 1 - line
            for along in range(n_cols):
                col = along if sign > 0 else n_cols - 1 - along
                if order[row, col] != NONE or math.isnan(phase[row, col]):
                    continue
                for axis in range(2):
                    y, x = row - sign * (1 - axis), col - sign * axis
                    if not (0 <= y < n_rows and 0 <= x < n_cols):
                        continue
                    if order[y, x] == NONE or away[y, x] >= reach:
                        continue
                    first_row, first_col = min(row, y), min(col, x)
                    if smooth[axis, first_row, first_col]:
                        rise = sign * rises[axis, first_row, first_col]
                        order[row, col] = _demanded(order[y, x], phase[y, x], rise, phase[row, col])
                        away[row, col] = away[y, x] + 1
                        n_given[sweep] += 1
                        break
