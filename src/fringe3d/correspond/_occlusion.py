"""What stands before a surface, along the epipolar lines of the device that looks; compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.kernels import HELPER

CELLS = 8
"""For each pixel of the device: its edges of surfaces are known to a tenth of a pixel."""


@njit(cache=True, nogil=True, error_model="numpy")
def write_sights(directions, depths, to_c1, baseline, focal, place, distance, rows):  # type: ignore[no-untyped-def]
    """Write where a device sees points, px along its epipolar lines, and how far away, mm.

    directions (row, col, 3): of the rays of C1, depths (row, col): mm along them, NaN for none;
    to_c1 (3,): mm, from the device to C1; baseline (3,): unit vector; focal: px; rows: first and
    last but one.
    """
    for row in range(rows[0], rows[1]):
        for col in range(depths.shape[1]):
            square, along = 0.0, 0.0
            for axis in range(3):
                away = to_c1[axis] + depths[row, col] * directions[row, col, axis]
                square += away * away
                along += away * baseline[axis]
            distance[row, col] = math.sqrt(square)
            place[row, col] = focal * math.acos(along / distance[row, col])


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(line, behind, found, rows):  # type: ignore[no-untyped-def]
    """Write what was found on the line that is nearest to each pixel, (row, col).

    line (row, col): its number; behind (n_lines, col); rows: first and last but one.
    """
    for row in range(rows[0], rows[1]):
        for col in range(line.shape[1]):
            k = 0 if math.isnan(line[row, col]) else int(np.rint(line[row, col]))
            found[row, col] = behind[k, col]


@njit(**HELPER)
def _sample(k, line, place, distance, join_mm, along, across):  # type: ignore[no-untyped-def]
    """Sample one line, number k: where the device sees its points, and how far away they are."""
    n_rows, n_cols = line.shape
    y = 0
    for x in range(n_cols):
        while y < n_rows - 2 and line[y + 1, x] <= k:
            y += 1
        while y > 0 and line[y, x] > k:
            y -= 1
        rise = line[y + 1, x] - line[y, x]
        part = (k - line[y, x]) / rise
        along[x], across[x] = np.nan, np.nan
        if not -0.5 <= part <= 1.5:
            continue
        near = y if part < 0.5 else y + 1
        along[x], across[x] = place[near, x], distance[near, x]
        if abs(distance[y, x] - distance[y + 1, x]) < join_mm:
            along[x] = place[y, x] + part * (place[y + 1, x] - place[y, x])
            across[x] = distance[y, x] + part * (distance[y + 1, x] - distance[y, x])


@njit(**HELPER)
def _fill(p, q, at_p, at_q, first, nearest):  # type: ignore[no-untyped-def]
    """Enter a piece of a surface, from place p to q, into the cells that it covers."""
    if p > q:
        p, q, at_p, at_q = q, p, at_q, at_p
    low = max(0, math.ceil((p - first) * CELLS))
    high = min(len(nearest) - 1, math.floor((q - first) * CELLS))
    slope = (at_q - at_p) / max(q - p, 1e-12)
    for cell in range(low, high + 1):
        nearest[cell] = min(nearest[cell], at_p + slope * (first + cell / CELLS - p))


@njit(**HELPER)
def _enter(along, across, join_mm, first, nearest):  # type: ignore[no-untyped-def]
    """Enter all surfaces of a line; they reach half a pixel of C1 beyond their last sample."""
    nearest[:] = np.inf
    n = len(along)
    for i in range(n):
        left = i > 0 and abs(across[i] - across[i - 1]) < join_mm
        right = i < n - 1 and abs(across[i + 1] - across[i]) < join_mm
        for step, own, other in ((-1, left, right), (1, right, left)):
            if own:
                there, far = along[i + step], across[i + step]
            elif other:
                there, far = 2 * along[i] - along[i - step], 2 * across[i] - across[i - step]
            else:
                continue
            _fill(along[i], (along[i] + there) / 2, across[i], (across[i] + far) / 2,
                  first, nearest)  # fmt: skip


@njit(**HELPER)
def _faces_away(i, along, across, join_mm):  # type: ignore[no-untyped-def]
    """Tell whether the device sees the surface at a sample run backwards: it sees its back."""
    before, after = along[i], along[i]
    if i > 0 and abs(across[i] - across[i - 1]) < join_mm:
        before = along[i - 1]
    if i < len(along) - 1 and abs(across[i + 1] - across[i]) < join_mm:
        after = along[i + 1]
    return after < before


@njit(**HELPER)
def _way_behind(at, own, first, nearest, margin_px):  # type: ignore[no-untyped-def]
    """Return by how much a sample lies behind what is nearest there, or within the margin."""
    cell = (at - first) * CELLS
    if not 0 <= cell <= len(nearest) - 1:
        return -np.inf  # continued beyond the border of what C1 sees: nothing stands there
    low, high = math.floor(cell), math.ceil(cell)
    if margin_px == 0:
        return own - max(nearest[low], nearest[high])
    more = round(margin_px * CELLS)
    best = np.inf
    for other in range(max(0, low - more), min(len(nearest) - 1, high + more) + 1):
        best = min(best, nearest[other])
    return own - best


@njit(cache=True, nogil=True, error_model="numpy")
def find_behind(  # type: ignore[no-untyped-def]
    line, place, distance, ends, join_mm, margin_px, behind, lines
):
    """Find how far the surface at each sample lies behind another, or another part of itself.

    line (row, col): number of the epipolar line, rising with the row; place, distance (row, col):
    where along its line the device sees the surface, px, rising with the column where it faces
    the device, and how far from the device it is, mm; NaN where there is none; ends: least and
    largest place. Neighbours are joined where their distances differ by less than join_mm. Writes
    behind (n_lines, col), mm: infinite where the surface faces away from the device. lines: first
    and last but one.
    """
    first = np.floor(ends[0]) - 1
    n_cells = int((np.ceil(ends[1]) + 1 - first) * CELLS) + 1
    n_cols = behind.shape[1]
    along, across, nearest = np.empty(n_cols), np.empty(n_cols), np.empty(n_cells)
    for k in range(lines[0], lines[1]):
        _sample(k, line, place, distance, join_mm, along, across)
        _enter(along, across, join_mm, first, nearest)
        for i in range(n_cols):
            behind[k, i] = np.nan
            if math.isnan(along[i]):
                continue
            behind[k, i] = _way_behind(along[i], across[i], first, nearest, margin_px)
            if _faces_away(i, along, across, join_mm):
                behind[k, i] = np.inf
