"""Surfaces: neighbours of continuous phase. Each has one fringe order, as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from fringe3d.correspond._joining import join_surfaces
from fringe3d.correspond.bias import PATCH_PX
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.weighing import CLEAR, LARGEST_EXTRA, Task
from fringe3d.model import NO_ORDER, Rejection

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

TWO_PI = 2 * np.pi

CONTINUOUS = 0.5
"""Turns of absolute phase between neighbours of one surface."""

LEAST_SEAM, SEAM_PART = 4, 0.5
"""Pixels of a border, and part of it, across which the phase is smooth. Where one thing stands in
front of another this happens to a few pixels in a hundred."""

LARGEST_REFUTATION = 36.0
"""Squared deviations of one pixel."""

REFUTED, REFUTED_PIXEL = 4.0, 1.0
"""Half squared deviations by which another order must fit worse to be refuted: in all, neighbours
within a patch counted once, and on the median pixel. What the bias leaves is not random; and up to
half of a surface may be hidden from C2 where it truly is, yet fit where it is not."""

ODDS_POWER = 3
"""Votes of neighbours are not independent: a surface has as few, however many its pixels. With 97 %
of them its order is certain, with 70 % the odds are 13 to 1."""

LEAST_DECIDED = 0.25
"""Part of a surface; less is a fragment."""

LEAST_VOTES = 0.2
"""Part of a surface that must be clear for the rest to follow."""


def absolute_turns(task: Task, order: NDArray[np.int32], where: Bools, /) -> NDArray[np.float64]:
    """Return the absolute phase on the task's grid, turns; NaN but where (n,) bool."""
    turns = np.full(task.valid.shape, np.nan)
    turns[task.valid] = np.where(where, order + task.first[0] / TWO_PI, np.nan)
    return turns


def surfaces(
    task: Task, order: NDArray[np.int32], claims: Bools, /, *, smooth: bool = False
) -> NDArray[np.intp]:
    """Return the number of the surface of each claiming pixel: neighbours of continuous phase.

    If `smooth`, they are not joined across bends, where phases may agree by chance.
    """
    turns = np.where(claims, order + task.first[0] / TWO_PI, np.nan)
    steps = task.rises[1] if smooth else np.zeros((2, 0, 0), bool)
    label = np.empty(len(turns), np.intp)
    join_surfaces(task.index, turns, CONTINUOUS, steps, label)
    return label[claims]


def made_whole(task: Task, chosen: Choice, /, *, doubts: bool = True) -> Choice:
    """Give parts of one surface that were given different orders the order of most of it.

    Evidence is gathered along lines, and systematic errors add up on them: where wrong orders fit
    nearly as well, a line may leave its order in the middle of a smooth surface. A depth edge does
    not go unseen along a border, unless the step is a whole number of periods: then C2 tells.

    Parameters
    ----------
    task : Task
    chosen : Choice
    doubts : bool; no pixel is more probable than the order of its surface, given the votes

    Returns
    -------
    Choice; parts that moved have the share of the votes for their order as probability. A part
        stays where it is if what C2 and all else show refutes the other order.
    """
    known = chosen.order != NO_ORDER
    if not known.any():
        return chosen
    part = surfaces(task, chosen.order, known, smooth=True)
    n = int(part.max()) + 1
    whole, level = _levels(*_seams(task, chosen.order, known, part), n)
    clear = (chosen.probability > CLEAR) & np.isfinite(chosen.cost)
    votes, sizes = np.bincount(part[clear[known]], minlength=n), np.bincount(part)
    wanted, share = _elected(whole, level, votes, sizes)
    number = np.full(len(known), -1)
    number[known] = part
    moved = np.flatnonzero(known)[(wanted != level)[part]]
    places, probability = chosen.place.copy(), chosen.probability.copy()
    if doubts:
        odds = (share / np.maximum(1 - share, 1e-9)) ** ODDS_POWER
        probability[known] = np.fmin(probability[known], (odds / (1 + odds))[part])
    if len(moved):
        of = number[moved]
        place, found = chosen.candidates.place_of(chosen.order[moved] + (wanted - level)[of], moved)
        worse = np.where(found, _against(chosen, moved, place) - _against(chosen, moved), 0.0)
        worse = np.nan_to_num(worse, nan=0.0)  # C2 sees only one of the two
        typical = ndimage.median(worse, of, np.arange(n))
        refuted = (typical > REFUTED_PIXEL) & (typical * sizes > REFUTED * PATCH_PX**2)
        goes = found & ~refuted[of]
        places[moved[goes]] = place[goes]
        probability[moved] = np.where(goes, share[of], chosen.probability[moved])
    return replace(chosen, place=places, probability=probability)


def is_fragment(task: Task, chosen: Choice, rejection: NDArray[np.uint16], /) -> Bools:
    """Tell which pixels belong to a smooth surface of which hardly any is left, (row, col).

    Chance agrees with a part of a wrong surface: with some patches, within which errors are alike.

    Parameters
    ----------
    task : Task
    chosen : Choice; orders (n,)
    rejection : (row, col) uint16; a surface outside the volume is not refused, it is elsewhere
    """
    alone = np.full(task.valid.shape, False)
    known = chosen.order != NO_ORDER
    if known.any():
        decided = (rejection == 0) | (rejection == np.uint16(Rejection.OUTSIDE_VOLUME))
        part = surfaces(task, chosen.order, known, smooth=True)
        share = np.bincount(part, decided[task.valid][known]) / np.bincount(part)
        own = known.copy()
        own[known] = share[part] < LEAST_DECIDED
        alone[task.valid] = own
    return alone


def no_surer_than_most(
    task: Task, chosen: Choice, certainty: NDArray[np.float64], /
) -> NDArray[np.float64]:
    """Return certainties (n,) that are no higher than that of most of the pixel's surface.

    Solutions differ by whole surfaces: where two of them agree on a patch of one of which they
    leave most open, both may be wrong there.
    """
    known = chosen.order != NO_ORDER
    whole = certainty.copy()
    if known.any():
        part = surfaces(task, chosen.order, known, smooth=True)
        typical = ndimage.median(certainty[known], part, np.arange(int(part.max()) + 1))
        whole[known] = np.fmin(certainty[known], typical[part])
    return whole


def _against(
    chosen: Choice, index: NDArray[np.intp], place: NDArray[np.intp] | None = None
) -> NDArray[np.float64]:
    """Return what speaks against the candidates at a place (or those chosen), half squares; NaN
    where C2 does not see them."""
    place = chosen.place[index] if place is None else place
    costs, extras = chosen.costs[index, place], chosen.candidates.extras[index, place]
    return np.asarray(
        np.minimum(costs, LARGEST_REFUTATION) / 2 + np.minimum(extras / 2, LARGEST_EXTRA)
    )


def _neighbours() -> tuple[tuple[tuple[slice, ...], tuple[slice, ...]], ...]:
    """Return where the left and right, and the upper and lower of two neighbours are."""
    return (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :])


def _seams(
    task: Task, order: NDArray[np.int32], known: Bools, part: NDArray[np.intp]
) -> tuple[Ints, Ints, Ints, Ints]:
    """Return pairs of parts with a smooth border, how many orders the second one is higher than
    the first would continue into it, and the length of the border, px; (n,) each."""
    parts = np.full(task.valid.shape, -1, np.int64)
    numbers = np.full(len(known), -1, np.int64)
    numbers[known] = part
    parts[task.valid] = numbers
    turns = absolute_turns(task, order, known)
    found = []
    for axis, (here, there) in zip((1, 0), _neighbours(), strict=True):
        rise, smooth = (steps[axis][here] for steps in task.rises)
        border = (parts[here] >= 0) & (parts[there] >= 0) & (parts[here] != parts[there])
        higher = np.rint((turns[there] - turns[here] - rise / TWO_PI)[border]).astype(np.int64)
        first, second = parts[here][border], parts[there][border]
        sign = np.where(first < second, 1, -1)
        found.append(np.stack([np.minimum(first, second), np.maximum(first, second),
                               sign * higher, smooth[border]]))  # fmt: skip
    first, second, higher, smooth_ = np.concatenate(found, axis=1)
    pairs, pair = np.unique(np.stack([first, second]), axis=1, return_inverse=True)
    in_all = np.bincount(pair.ravel())
    kinds, length = np.unique(
        np.stack([pair.ravel(), higher])[:, smooth_ == 1], axis=1, return_counts=True
    )
    long = (length >= LEAST_SEAM) & (length > SEAM_PART * in_all[kinds[0]])
    first, second = pairs[:, kinds[0, long]]
    return first, second, kinds[1, long], length[long]


def _levels(first: Ints, second: Ints, higher: Ints, length: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the surface of each of n parts, and by how many orders it is off the surface's first.

    Where borders contradict each other the longest hold: they make up the spanning tree.
    """
    ends = (first, second)
    tree = minimum_spanning_tree(coo_array((1.0 / length, ends), shape=(n, n)))
    _, whole = connected_components(tree, directed=False)
    steps = coo_array((higher, ends), shape=(n, n)).tocsr()
    steps = steps - steps.T
    # One more node holds all surfaces together.
    roots = np.unique(whole, return_index=True)[1]
    edges = tree.tocoo()
    start = np.concatenate([edges.row, np.full(len(roots), n)])
    end = np.concatenate([edges.col, roots])
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(n + 1, n + 1)).tocsr()
    order, former = breadth_first_order(graph, n, directed=False)
    level = np.zeros(n, np.int64)
    for node in order[1:]:
        if former[node] != n:
            level[node] = level[former[node]] + steps[former[node], node]
    return np.asarray(whole, np.int64), level


def _elected(
    whole: Ints, level: Ints, votes: Ints, sizes: Ints
) -> tuple[Ints, NDArray[np.float64]]:
    """Return the level that most clear pixels of each part's surface have, and their share.

    Parts stay on their level, and nothing is shared, where too few pixels are clear.
    """
    kinds, kind = np.unique(np.stack([whole, level]), axis=1, return_inverse=True)
    votes_of = np.bincount(kind.ravel(), votes)
    order = np.argsort(votes_of, kind="stable")
    wanted = np.zeros(int(whole.max()) + 1, np.int64)
    most = np.zeros(len(wanted))
    wanted[kinds[0, order]] = kinds[1, order]
    most[kinds[0, order]] = votes_of[order]
    total = np.bincount(whole, votes)
    settled = (total > 0) & (total >= LEAST_VOTES * np.bincount(whole, sizes))
    share = np.where(settled, most / np.maximum(total, 1), 1.0)
    return np.where(settled[whole], wanted[whole], level), share[whole]
