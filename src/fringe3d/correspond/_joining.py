"""Neighbours of continuous phase joined to surfaces, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._phase import TWO_PI

f4 = np.float32


@njit(cache=True, error_model="numpy", inline="always")
def _wrapped(angle):  # type: ignore[no-untyped-def]
    return f4(angle - f4(TWO_PI) * np.rint(angle * f4(1 / TWO_PI)))


@njit(cache=True, nogil=True, error_model="numpy")
def write_rises(phase, sigma, limits, rises, smooth, rows):  # type: ignore[no-untyped-def]
    """Write the phase from each pixel to the next in both axes, wrapped, rad, and whether it is
    that of one surface, (2, row, col).

    phase, sigma (row, col): rad, NaN where unknown; limits = (second difference on a surface,
    rad; the same in standard deviations; largest rise, rad). Axis 0 leads to the next row; the last
    row and column have no next one. rows: first and last but one.
    """
    n_rows, n_cols = phase.shape
    most_bend, most_sigma, steepest = limits
    for row in range(rows[0], rows[1]):
        for axis in range(2):
            down, right = 1 - axis, axis
            for col in range(n_cols):
                rises[axis, row, col], smooth[axis, row, col] = np.nan, False
                if row + down >= n_rows or col + right >= n_cols:
                    continue
                here, there = phase[row, col], phase[row + down, col + right]
                rise = _wrapped(there - here)
                rises[axis, row, col] = rise
                if not abs(rise) < steepest:
                    continue
                bend = f4(-1.0)  # where there is no third pixel, nothing is known
                if row - down >= 0 and col - right >= 0:
                    before = _wrapped(rise - _wrapped(here - phase[row - down, col - right]))
                    if not math.isnan(before):
                        bend = abs(before)
                if row + 2 * down < n_rows and col + 2 * right < n_cols:
                    after = phase[row + 2 * down, col + 2 * right]
                    after = _wrapped(_wrapped(after - there) - rise)
                    if not math.isnan(after):
                        bend = max(bend, abs(after))
                noise = most_sigma * max(sigma[row, col], sigma[row + down, col + right])
                limit = most_bend * most_bend + noise * noise
                smooth[axis, row, col] = bend >= 0 and bend * bend < limit


@njit(cache=True, error_model="numpy")
def first_of(parent, node):  # type: ignore[no-untyped-def]
    """Return the first node of a part, and shorten the way to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True, nogil=True, error_model="numpy")
def join_surfaces(index, turns, most, smooth, label):  # type: ignore[no-untyped-def]
    """Write the number of the surface of each pixel, (n,), in the order of their first pixels, -1
    where it has no phase.

    index (row, col): number of the pixel, -1 for none; turns (n,): absolute phase, NaN for none;
    neighbours that differ by less than `most` are joined, those that are not `smooth`, (2, row,
    col), left out; (2, 0, 0) leaves out none.
    """
    n_rows, n_cols = index.shape
    everywhere = smooth.shape[1] == 0
    parent = np.arange(len(turns)).astype(np.int32)
    for row in range(n_rows):
        for col in range(n_cols):
            i = index[row, col]
            if i < 0:
                continue
            if col > 0 and (everywhere or smooth[1, row, col - 1]):
                j = index[row, col - 1]
                if j >= 0 and abs(turns[i] - turns[j]) < most:
                    one, other = first_of(parent, i), first_of(parent, j)
                    parent[max(one, other)] = min(one, other)
            if row > 0 and (everywhere or smooth[0, row - 1, col]):
                j = index[row - 1, col]
                if j >= 0 and abs(turns[i] - turns[j]) < most:
                    one, other = first_of(parent, i), first_of(parent, j)
                    parent[max(one, other)] = min(one, other)
    n_parts = 0
    for i in range(len(turns)):
        if math.isnan(turns[i]):
            label[i] = -1
        elif parent[i] == i:
            label[i] = n_parts
            n_parts += 1
        else:
            label[i] = label[first_of(parent, i)]
