"""Union of nodes that edges join, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _first(parent, node):  # type: ignore[no-untyped-def]
    """Return the first node of a part, and shorten the way to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def join(start, end, label):  # type: ignore[no-untyped-def]
    """Write the number of each node's connected part (n,), in the order of their first nodes."""
    for node in range(len(label)):
        label[node] = node
    for k in range(len(start)):
        one, other = _first(label, start[k]), _first(label, end[k])
        label[max(one, other)] = min(one, other)
    n_parts = 0
    for node in range(len(label)):
        if label[node] == node:
            label[node] = n_parts
            n_parts += 1
        else:
            label[node] = label[label[node]]  # it comes before, and has its number by now


@njit(cache=True, nogil=True, error_model="numpy")
def measure_patches(points, max_gap, reach, sizes):  # type: ignore[no-untyped-def]
    """Write how many pixels the patch of each pixel has, (row, col); 0 where there is no point.

    points (row, col, 3): mm; neighbours within `reach` rows and columns, those of one side alone
    where it is 1, belong together if they are no further apart than max_gap.
    """
    n_rows, n_cols = sizes.shape
    label, flat = np.empty(n_rows * n_cols, np.int32), sizes.reshape(-1)
    for row in range(n_rows):
        for col in range(n_cols):
            node = row * n_cols + col
            label[node] = node
            if not abs(points[row, col, 0]) < np.inf:
                label[node] = -1
                continue
            for down in range(min(reach, row) + 1):
                for right in range(-reach, reach + 1):
                    is_former = down > 0 or right < 0
                    if not is_former or (reach == 1 and down * right != 0):
                        continue
                    if not 0 <= col + right < n_cols:
                        continue
                    gap = 0.0
                    for axis in range(3):
                        away = points[row, col, axis] - points[row - down, col + right, axis]
                        gap += away * away
                    if gap <= max_gap * max_gap:
                        one = _first(label, node)
                        other = _first(label, node - down * n_cols + right)
                        label[max(one, other)] = min(one, other)
    flat[:] = 0
    for node in range(len(label)):
        if label[node] >= 0:
            label[node] = _first(label, node)
            flat[label[node]] += 1
    for node in range(len(label)):  # the first pixel of a patch comes before all others
        flat[node] = flat[label[node]] if label[node] >= 0 else 0
