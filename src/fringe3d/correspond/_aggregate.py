"""Semi-global aggregation of evidence for fringe orders, compiled.

After H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information" (2008),
with fringe orders in place of disparities: what moves freely is the *absolute* phase.
"""

from __future__ import annotations

import math

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

TWO_PI = 2.0 * math.pi

STEP_PENALTY, JUMP_PENALTY = 5.0, 14.0
"""For one order between neighbours, and for any other number. Too weak ones cost most: the second
should be ten times the largest cost of a pixel."""

BEND_RAD = 0.3
"""Second difference of the phase between neighbours at which a depth edge becomes likely."""

LEAST_PENALTY = 0.05
"""Part of the penalty that is left on an edge."""

FAR = np.float32(1e9)

MOST_TOTALS = 4
"""Threads that hold a sum of their own: memory."""

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


@njit(cache=True, error_model="numpy")
def _step(here, there, before, phase, index, orders, costs, paths, result):  # type: ignore[no-untyped-def]
    """Carry the evidence from pixel `there` to its neighbour `here`, (row, col) each."""
    i = index[here]
    n = orders.shape[1]
    j = index[there] if there[0] >= 0 else -1
    if j < 0:
        for a in range(n):
            result[a] = costs[i, a]
        return
    rise = phase[here] - phase[there]
    turns = math.floor(rise / TWO_PI + 0.5)
    weight = 1.0
    if before[0] >= 0 and index[before] >= 0:
        former = phase[there] - phase[before]
        bend = (rise - TWO_PI * turns) - (former - TWO_PI * math.floor(former / TWO_PI + 0.5))
        bend /= BEND_RAD
        weight = max(math.exp(-bend * bend), LEAST_PENALTY)
    least = FAR
    for b in range(n):
        least = min(least, paths[b])
    b = 0
    for a in range(n):
        if costs[i, a] >= FAR:
            result[a] = FAR
            continue
        wanted = orders[i, a] + turns
        best = least + weight * JUMP_PENALTY
        while b < n and costs[j, b] < FAR and orders[j, b] < wanted - 1:
            b += 1
        c = b
        while c < n and costs[j, c] < FAR and orders[j, c] <= wanted + 1:
            penalty = 0.0 if orders[j, c] == wanted else weight * STEP_PENALTY
            best = min(best, paths[c] + penalty)
            c += 1
        result[a] = costs[i, a] + best - least


@njit(cache=True, error_model="numpy")
def _advance(step, line, dy, dx, phase, index, orders, costs, paths, total):  # type: ignore[no-untyped-def]
    """Move one line of a sweep on by one pixel, and add what it carries to `total`."""
    n_rows, n_cols = phase.shape
    row = line if dy == 0 else (step if dy > 0 else n_rows - 1 - step)
    col = line if dy != 0 else (step if dx > 0 else n_cols - 1 - step)
    i = index[row, col]
    if i < 0:
        return
    there, before = (-1, -1), (-1, -1)
    if 0 <= row - dy < n_rows and 0 <= col - dx < n_cols:
        there = (row - dy, col - dx)
        if 0 <= row - 2 * dy < n_rows and 0 <= col - 2 * dx < n_cols:
            before = (row - 2 * dy, col - 2 * dx)
    former = line if dy == 0 else max(there[1], 0)
    result = paths[step % 2, line]
    _step((row, col), there, before, phase, index, orders, costs, paths[(step + 1) % 2, former],
          result)  # fmt: skip
    for a in range(len(result)):
        if costs[i, a] < FAR:
            total[i, a] += result[a]


@njit(cache=True, error_model="numpy")
def _sweep(dy, dx, phase, index, orders, costs, total):  # type: ignore[no-untyped-def]
    """Add the path costs of one direction to `total`."""
    n_rows, n_cols = phase.shape
    n_steps, n_lines = (n_cols, n_rows) if dy == 0 else (n_rows, n_cols)
    paths = np.empty((2, n_lines, costs.shape[1]), np.float32)
    for step in range(n_steps):
        for line in range(n_lines):
            _advance(step, line, dy, dx, phase, index, orders, costs, paths, total)


@njit(cache=True, parallel=True, error_model="numpy")
def _all_sweeps(directions, phase, index, orders, costs, totals):  # type: ignore[no-untyped-def]
    """Sweep in all directions; each thread has a total of its own and its share of them."""
    n_threads = len(totals)
    for thread in prange(n_threads):
        for number in range(thread, len(directions), n_threads):
            _sweep(directions[number, 0], directions[number, 1], phase, index, orders, costs,
                   totals[thread])  # fmt: skip


def aggregate(
    phase: NDArray[np.float32],
    index: NDArray[np.int32],
    orders: NDArray[np.int32],
    costs: NDArray[np.float32],
    /,
) -> NDArray[np.float32]:
    """Return the evidence against each candidate, (n, m), all pixels of the image considered.

    phase (row, col): rad; index (row, col): number of the pixel in the lists, -1 for none; orders,
    costs (n, m): candidates, rising, and their own costs (half squared deviations), `FAR` for none.

    The sum of the eight path costs counts the pixel's own cost eight times; all but one are taken
    off, which makes it the least cost of any assignment along the paths that has this order.
    """
    n_threads = min(get_num_threads(), MOST_TOTALS)
    totals = np.zeros((n_threads, *costs.shape), np.float32)
    _all_sweeps(np.array(DIRECTIONS), phase, index, orders, costs, totals)
    total = totals.sum(axis=0)
    return np.where(costs < FAR, total - (len(DIRECTIONS) - 1) * costs, FAR).astype(np.float32)
