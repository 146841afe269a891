"""Other ways to use the neighbours: unwrap the phase in the image, then let each region vote."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from fringe3d.correspond.choice import Choice, Weighed
from fringe3d.correspond.limits import LARGEST_COST
from fringe3d.correspond.weighing import Task
from fringe3d.model import NO_ORDER

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TWO_PI = 2 * np.pi

MOST_BEND, MOST_RISE = 0.3, 2.0
"""rad; second difference and difference of the wrapped phase on one surface."""

EDGE_PX = 1
"""Regions are grown so far from edges, where a step of about a whole period would join them, and
carried back to the edge."""

Unwrapping = Callable[[Floats, Bools], tuple[Ints, Ints]]
"""From wrapped phases, rad, and which of them are valid, (row, col), to whole turns within each
region and the numbers of the regions, (n,) each, of the valid pixels."""


def deciding_by_vote(unwrapping: Unwrapping, /) -> AbstractContextManager[Any]:
    """Choose orders by regions instead of along paths; all checks stay as they are."""
    decide = Task.decide

    def by_vote(task: Task, *given: Any, **more: Any) -> Choice:
        chosen = decide(task, *given, **more)
        turns, region = unwrapping(task.phase.astype(np.float64), task.valid)
        return _voted(task, chosen, turns, region) if len(turns) else chosen

    return patch.object(Task, "decide", by_vote)


def _voted(task: Task, chosen: Choice, turns: Ints, region: Ints) -> Choice:
    assert isinstance(chosen.table, Weighed)
    orders = task.listed.orders
    there = orders != NO_ORDER
    saved = np.maximum(LARGEST_COST - np.nan_to_num(chosen.table.cost / 2, nan=LARGEST_COST), 0)
    shift, certainty = winners(
        np.repeat(region, there.sum(axis=1)),
        (orders - turns[:, None])[there],
        saved[there].astype(np.float64),
        n_regions=int(region.max()) + 1,
    )
    wanted = (orders == (turns + shift[region])[:, None]) & there
    found = wanted.any(axis=1)
    return replace(
        chosen,
        place=np.where(found, wanted.argmax(axis=1), chosen.place),
        probability=np.where(found, certainty[region], 0.0),
    )


def winners(region: Ints, shift: Ints, votes: Floats, /, *, n_regions: int) -> tuple[Ints, Floats]:
    """Return the shift that most votes of each region are for, and its probability.

    Parameters
    ----------
    region, shift : (n,) int
    votes : (n,) float; what speaks for a shift, in half squared deviations
    n_regions : int

    Examples
    --------
    >>> shift, certainty = winners(
    ...     np.array([0, 0, 0, 1]), np.array([2, 3, 3, 7]), np.array([1.0, 0.5, 0.5, 1.0]),
    ...     n_regions=2)
    >>> shift.tolist(), certainty.tolist()
    ([2, 7], [0.5, 1.0])
    """
    pairs, place = np.unique(np.stack([region, shift], axis=1), axis=0, return_inverse=True)
    support = np.bincount(place.ravel(), votes)
    order = np.lexsort((-support, pairs[:, 0]))
    owners, first = np.unique(pairs[order, 0], return_index=True)
    best, most = np.zeros(n_regions, np.int64), np.zeros(n_regions)
    best[owners], most[owners] = pairs[order[first], 1], support[order[first]]
    weights = np.bincount(pairs[:, 0], np.exp(support - most[pairs[:, 0]]), minlength=n_regions)
    return best, 1 / np.maximum(weights, 1)


def grown(phase: Floats, valid: Bools, /) -> tuple[Ints, Ints]:
    """Unwrap along the smoothest ways through each region of continuous phase."""
    core = _core(phase, valid)
    start, end, bend = _joints(phase, core)
    n = int(core.sum())
    graph = coo_array((bend + 1e-6, (start, end)), shape=(n, n)).tocsr()
    region = np.asarray(connected_components(graph, directed=False)[1], np.int64)
    turns = _turns_along(minimum_spanning_tree(graph), phase[core], region)
    return _carried(phase, valid, core, turns, region)


def by_library(phase: Floats, valid: Bools, /) -> tuple[Ints, Ints]:
    """Unwrap with scikit-image (sorting by reliability); regions end where the phase jumps."""
    from skimage import restoration

    unwrap: Any = restoration.unwrap_phase
    core = _core(phase, valid)
    if not core.any():
        return _carried(phase, valid, core, np.zeros(0, np.int64), np.zeros(0, np.int64))
    unwrapped = unwrap(np.ma.masked_array(np.where(core, phase, 0), ~core), rng=0)
    turns = np.rint((np.asarray(unwrapped) - phase)[core] / TWO_PI).astype(np.int64)
    absolute = phase[core] + TWO_PI * turns
    start, end, _ = _joints(phase, core)
    joined = np.abs(absolute[start] - absolute[end]) < MOST_RISE
    n = len(turns)
    graph = coo_array(
        (np.ones(int(joined.sum()), bool), (start[joined], end[joined])), shape=(n, n)
    )
    region = np.asarray(connected_components(graph, directed=False)[1], np.int64)
    return _carried(phase, valid, core, turns, region)


def _core(phase: Floats, valid: Bools) -> Bools:
    """Return the pixels that lie so far from edges of the phase that no region leaks there."""
    smooth = valid.copy()
    for axis in (0, 1):
        here, there = _neighbours(axis)
        bent = ~(_bends(phase, valid, axis) < MOST_BEND)
        smooth[here] &= ~bent
        smooth[there] &= ~bent
    return np.asarray(binary_erosion(smooth, np.ones((3, 3), bool), iterations=EDGE_PX))


def _joints(phase: Floats, core: Bools) -> tuple[Ints, Ints, Floats]:
    """Return the pairs of neighbours in the core, and how much the phase bends there."""
    number = np.full(core.shape, -1, np.int64)
    number[core] = np.arange(int(core.sum()))
    starts, ends, bends = [], [], []
    for axis in (0, 1):
        here, there = _neighbours(axis)
        bend = _bends(phase, core, axis)
        joined = bend < MOST_BEND
        starts.append(number[here][joined])
        ends.append(number[there][joined])
        bends.append(bend[joined])
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(bends)


def _carried(
    phase: Floats, valid: Bools, core: Bools, turns: Ints, region: Ints
) -> tuple[Ints, Ints]:
    """Carry turns and regions from the core to the pixels around it; others are on their own."""
    distance, (rows, cols) = distance_transform_edt(~core, return_indices=True)
    all_turns, regions = np.zeros(valid.shape, np.int64), np.zeros(valid.shape, np.int64)
    all_turns[core], regions[core] = turns, region
    steps = np.rint((phase[rows, cols] - phase) / TWO_PI, where=valid, out=np.zeros(valid.shape))
    near = valid & (distance <= 2 * EDGE_PX + 1)
    all_turns = np.where(near, all_turns[rows, cols] + steps.astype(np.int64), 0)
    alone = np.cumsum((valid & ~near).ravel()).reshape(valid.shape) + int(region.max(initial=-1))
    regions = np.where(near, regions[rows, cols], alone)
    return all_turns[valid], regions[valid]


def _neighbours(axis: int) -> tuple[Any, Any]:
    if axis == 0:
        return np.s_[:-1], np.s_[1:]
    return np.s_[:, :-1], np.s_[:, 1:]


def _wrapped(angle: Floats) -> Floats:
    return np.asarray(angle - TWO_PI * np.rint(angle / TWO_PI))


def _bends(phase: Floats, valid: Bools, axis: int) -> Floats:
    """Return how much the slope changes at each pair of neighbours; infinite where too steep."""
    known = np.where(valid, phase, np.nan)
    rise = _wrapped(np.diff(known, axis=axis))
    bend = np.abs(_wrapped(np.diff(rise, axis=axis)))
    before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
    before[axis], after[axis] = (1, 0), (0, 1)
    worst = np.fmax(*(np.pad(bend, pad, constant_values=np.nan) for pad in (before, after)))
    return np.asarray(np.where(np.abs(rise) < MOST_RISE, np.nan_to_num(worst, nan=0.0), np.inf))


def _turns_along(tree: Any, phase: Floats, region: Ints) -> Ints:
    """Sum up the turns along a tree within each region, from its first pixel on."""
    n = len(phase)
    if not n:
        return np.zeros(0, np.int64)
    heads = np.unique(region, return_index=True)[1]
    edges = tree.tocoo()
    start = np.concatenate([edges.row, np.full(len(heads), n)])
    end = np.concatenate([edges.col, heads])
    rooted = coo_array((np.ones(len(start)), (start, end)), shape=(n + 1, n + 1)).tocsr()
    parent = breadth_first_order(rooted, n, directed=False)[1].astype(np.int64)
    parent[n] = n
    values = np.append(phase, 0.0)
    turns = np.rint((values[parent] - values) / TWO_PI).astype(np.int64)
    turns[heads] = turns[n] = 0
    while (parent != n).any():
        turns += turns[parent]
        parent = parent[parent]
    return np.asarray(turns[:n], np.int64)
