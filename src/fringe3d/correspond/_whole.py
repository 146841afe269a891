"""Pieces of surfaces, their borders, and what joins them; compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._joining import first_of
from fringe3d.correspond._phase import TWO_PI

MOST_JUMP = 2**15
"""Orders; more than any pattern has."""


@njit(cache=True, nogil=True, error_model="numpy")
def write_higher(index, turns, rises, higher, rows):  # type: ignore[no-untyped-def]
    """Write by how many orders the next row and column are higher than the phase goes on to,
    (2, row, col); 0 where nothing is known.

    index (row, col): number of the pixel, -1 for none; turns (n,): absolute phase, NaN for none;
    rises (2, row, col): rad, to the next row and column; rows: first and last but one.
    """
    n_rows, n_cols = index.shape
    for row in range(rows[0], rows[1]):
        for axis in range(2):
            down, right = 1 - axis, axis
            for col in range(n_cols):
                higher[axis, row, col] = 0
                if row + down >= n_rows or col + right >= n_cols:
                    continue
                i, j = index[row, col], index[row + down, col + right]
                if i < 0 or j < 0:
                    continue
                apart = np.rint(turns[j] - turns[i] - rises[axis, row, col] / TWO_PI)
                if not math.isnan(apart):
                    higher[axis, row, col] = int(apart)


@njit(cache=True, nogil=True, error_model="numpy")
def count_jumps(parts, higher, smooth, length):  # type: ignore[no-untyped-def]
    """Count the smooth places, (n,), at which each part jumps by whole orders within itself."""
    n_rows, n_cols = parts.shape
    length[:] = 0
    for axis in range(2):
        down, right = 1 - axis, axis
        for row in range(n_rows - down):
            for col in range(n_cols - right):
                part = parts[row, col]
                same = part >= 0 and part == parts[row + down, col + right]
                if same and smooth[axis, row, col] and higher[axis, row, col] != 0:
                    length[part] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def write_bonds(parts, higher, smooth, torn, bonds, rows):  # type: ignore[no-untyped-def]
    """Write which neighbours in a part that is torn, (n,), go on smoothly, (2, row, col).

    rows: first and last but one.
    """
    n_rows, n_cols = parts.shape
    for axis in range(2):
        down, right = 1 - axis, axis
        for row in range(rows[0], rows[1]):
            for col in range(n_cols):
                bonds[axis, row, col] = False
                if row + down >= n_rows or col + right >= n_cols:
                    continue
                part = parts[row, col]
                if part >= 0 and part == parts[row + down, col + right] and torn[part]:
                    is_smooth = smooth[axis, row, col]
                    bonds[axis, row, col] = is_smooth and higher[axis, row, col] == 0


@njit(cache=True, nogil=True, error_model="numpy")
def join_bonded(bonds, where, number):  # type: ignore[no-untyped-def]
    """Write the number of the component of bonded pixels, (row, col), in the order of their first
    ones; -1 but `where`."""
    n_rows, n_cols = where.shape
    parent = np.arange(n_rows * n_cols)
    for row in range(n_rows):
        for col in range(n_cols):
            if not where[row, col]:
                continue
            node = row * n_cols + col
            if col > 0 and where[row, col - 1] and bonds[1, row, col - 1]:
                one, other = first_of(parent, node), first_of(parent, node - 1)
                parent[max(one, other)] = min(one, other)
            if row > 0 and where[row - 1, col] and bonds[0, row - 1, col]:
                one, other = first_of(parent, node), first_of(parent, node - n_cols)
                parent[max(one, other)] = min(one, other)
    n_parts, flat, chosen = 0, number.reshape(-1), where.reshape(-1)
    for node in range(len(parent)):
        flat[node] = -1
        if not chosen[node]:
            continue
        if parent[node] == node:
            flat[node] = n_parts
            n_parts += 1
        else:
            flat[node] = flat[first_of(parent, node)]


@njit(cache=True, nogil=True, error_model="numpy")
def grow(bonds, axis, former, piece, rows):  # type: ignore[no-untyped-def]
    """Give pixels without a piece, (row, col), that of a bonded neighbour before or after them.

    rows: first and last but one.
    """
    n_rows, n_cols = former.shape
    down, right = 1 - axis, axis
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            piece[row, col] = former[row, col]
            if former[row, col] >= 0:
                continue
            if row + down < n_rows and col + right < n_cols and bonds[axis, row, col]:
                piece[row, col] = former[row + down, col + right]
            y, x = row - down, col - right
            if y >= 0 and x >= 0 and bonds[axis, y, x] and former[y, x] >= 0:
                piece[row, col] = former[y, x]


@njit(cache=True, nogil=True, error_model="numpy")
def list_borders(pieces, parts, higher, smooth, n_pieces):  # type: ignore[no-untyped-def]
    """Return a number for each place of a border between pieces, which holds in turn: the pair of
    pieces, the jump from the first to the second, whether the phase is smooth there, and whether it
    goes on smoothly within a part."""
    n_rows, n_cols = pieces.shape
    found = np.empty(2 * pieces.size, np.int64)
    n = 0
    for axis in range(2):
        down, right = 1 - axis, axis
        for row in range(n_rows - down):
            for col in range(n_cols - right):
                first, second = pieces[row, col], pieces[row + down, col + right]
                if first < 0 or second < 0 or first == second:
                    continue
                jump, is_smooth = higher[axis, row, col], smooth[axis, row, col]
                within = parts[row, col] == parts[row + down, col + right]
                if first > second:
                    first, second, jump = second, first, -jump
                pair = np.int64(first) * n_pieces + second
                number = pair * (2 * MOST_JUMP) + jump + MOST_JUMP
                found[n] = number * 4 + 2 * is_smooth + (is_smooth and within and jump == 0)
                n += 1
    return found[:n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def hold_together(first, second, higher, whole, level):  # type: ignore[no-untyped-def]
    """Write the surface of each piece, (n,), and by how many orders it is off its first piece.

    first, second, higher (m,): pairs, those that hold the best first, and by how many orders the
    second one is off the first. A pair that closes a circle is left out.
    """
    parent = whole
    for node in range(len(parent)):
        parent[node], level[node] = node, 0
    for k in range(len(first)):
        one, off_one = _root(parent, level, first[k])
        other, off_other = _root(parent, level, second[k])
        if one == other:
            continue
        apart = off_one + higher[k] - off_other  # of the other root against the one
        if one < other:
            parent[other], level[other] = one, apart
        else:
            parent[one], level[one] = other, -apart
    for node in range(len(parent)):
        root, off = _root(parent, level, node)
        parent[node], level[node] = root, off


@njit(cache=True, error_model="numpy")
def _root(parent, level, node):  # type: ignore[no-untyped-def]
    """Return the first of those that hold together, and the level of a node against it."""
    off = 0
    while parent[node] != node:
        before = parent[node]
        level[node] += 0 if parent[before] == before else level[before]
        off += level[node]
        parent[node] = parent[before]
        node = parent[node]
    return node, off


@njit(cache=True, nogil=True, error_model="numpy")
def bound_gaps(gaps, number, is_known, low, high):  # type: ignore[no-untyped-def]
    """Write the least and largest number of the known pixels beside each gap, (n,).

    gaps (row, col): 1 to n - 1, 0 where there is none.
    """
    n_rows, n_cols = gaps.shape
    for row in range(n_rows):
        for col in range(n_cols):
            for axis in range(2):
                y, x = row + 1 - axis, col + axis
                if y >= n_rows or x >= n_cols:
                    continue
                if gaps[row, col] > 0 and is_known[y, x]:
                    gap, value = gaps[row, col], number[y, x]
                elif gaps[y, x] > 0 and is_known[row, col]:
                    gap, value = gaps[y, x], number[row, col]
                else:
                    continue
                low[gap], high[gap] = min(low[gap], value), max(high[gap], value)


@njit(cache=True, nogil=True, error_model="numpy")
def heal(number, smooth, former, later, gain, border):  # type: ignore[no-untyped-def]
    """Count the places on the border of each part, (n,), and how many more of them a change makes
    go on smoothly.

    number (row, col): of the part, -1 for none; smooth (2, row, col): of the phase; former, later
    (2, row, col): by how many orders the next pixel is off before the change, and after it. What is
    smooth in both is no border.
    """
    n_rows, n_cols = number.shape
    gain[:], border[:] = 0, 0
    for axis in range(2):
        down, right = 1 - axis, axis
        for row in range(n_rows - down):
            for col in range(n_cols - right):
                one, other = number[row, col], number[row + down, col + right]
                if one == other:
                    continue
                better = 0
                if smooth[axis, row, col]:
                    was, becomes = former[axis, row, col] != 0, later[axis, row, col] != 0
                    if not was and not becomes:
                        continue
                    better = int(was) - int(becomes)
                for part in (one, other):
                    if part >= 0:
                        gain[part] += better
                        border[part] += 1
