"""Parts of one surface that were given different orders, made whole."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.correspond import _orders, _whole
from fringe3d.correspond.bias import PATCH_PX
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.limits import CLEAR, LARGEST_EXTRA, TWO_PI
from fringe3d.correspond.occlusion import hidden_from
from fringe3d.correspond.pieces import cut_apart
from fringe3d.correspond.surfaces import surfaces
from fringe3d.correspond.weighing import Task
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

LEAST_SEAM, SEAM_PART = 4, 0.5
"""Pixels of a border, and part of it, across which the phase is smooth. Where one thing stands in
front of another this happens to a few pixels in a hundred."""

BOND = 4
"""Pixels of a smooth border that outweigh one across which the orders agree already."""

LEAST_HEALED = 0.5
"""Part of its border that a surface must heal where it moves, less what it tears. That of a
tooth before a table is smooth by chance here and there; that of a patch of the table itself is
smooth but where something stands before it."""

LARGEST_REFUTATION = 36.0
"""Squared deviations of one pixel."""

REFUTED, REFUTED_PIXEL = 4.0, 1.0
"""Half squared deviations by which another order must fit worse to be refuted: in all, neighbours
within a patch counted once, and on the median pixel. What the bias leaves is not random; and up to
half of a surface may be hidden from C2 where it truly is, yet fit where it is not."""

ODDS_POWER = 3
"""Votes of neighbours are not independent: a surface has as few, however many its pixels. With 97 %
of them its order is certain, with 70 % the odds are 13 to 1."""

LEAST_VOTES = 0.2
"""Part of a surface that must be clear for the rest to follow."""


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
        stays where it is if the other order does not heal its border, or what C2 and all else show
        refutes it.
    """
    known = chosen.order != NO_ORDER
    if not known.any():
        return chosen
    higher = _higher(task, chosen.order, known)
    parts = _parts(task, chosen.order, known)
    pieces = cut_apart(parts, higher, task.rises[1])
    part = pieces[task.valid][known]
    n = int(part.max()) + 1
    whole, level = _levels(*_seams(pieces, parts, higher, task.rises[1]), n)
    clear = (chosen.probability > CLEAR) & np.isfinite(chosen.cost)
    votes, sizes = np.bincount(part[clear[known]], minlength=n), np.bincount(part)
    wanted, share = _elected(whole, level, votes, sizes)
    number = np.full(len(known), -1)
    number[known] = part
    moved = np.flatnonzero(known)[(wanted != level)[part]]
    probability = chosen.probability.copy()
    if doubts:
        odds = (share / np.maximum(1 - share, 1e-9)) ** ODDS_POWER
        probability[known] = np.fmin(probability[known], (odds / (1 + odds))[part])
    place, goes = np.zeros(len(moved), np.intp), np.zeros(len(moved), bool)
    if len(moved):
        of = number[moved]
        place, found = chosen.table.place_of(chosen.order[moved] + (wanted - level)[of], moved)
        there = chosen.moved(moved[found], place[found], chosen.probability)
        goes = found & ~_refuted(task, chosen, there, moved, of)[of]
        probability[moved] = np.where(goes, share[of], chosen.probability[moved])
    return chosen.moved(moved[goes], place[goes], probability)


def _refuted(
    task: Task, chosen: Choice, wanted: Choice, moved: NDArray[np.intp], of: Ints
) -> Bools:
    """Tell of which parts the border, or C2 and all else, refute the orders they should have.

    moved, of (n,): the pixels that should move, and the part of each. Most of its border must be
    healed. What C2 does not see of it where it would be refutes nothing: it sees what stands before
    it. (A coarse grid does not tell what is hidden.)
    """
    number = np.full(len(chosen.place), -1)
    number[moved] = of
    torn = _healed(task, chosen, wanted, number) < LEAST_HEALED
    worse = np.nan_to_num(_against(wanted, moved) - _against(chosen, moved), nan=0.0)
    refuted = ~torn & _typically(worse, of)
    if task.stride == (1, 1) and refuted.any():
        seen = ~_hidden_from_c2(task, wanted)[moved]
        # What is hidden acquits; nothing that happens to another part makes this one worse.
        refuted &= _typically(worse[seen], of[seen], n=len(refuted))
    return torn | refuted


def _typically(worse: NDArray[np.float64], of: Ints, n: int = 0) -> Bools:
    """Tell of which parts most pixels, and all in all, are so much worse; of (m,): their part."""
    if not len(of):
        return np.zeros(n, bool)
    sizes = np.bincount(of, minlength=n)
    typical = np.where(sizes > 0, ndimage.median(worse, of, np.arange(len(sizes))), 0.0)
    return np.asarray((typical > REFUTED_PIXEL) & (typical * sizes > REFUTED * PATCH_PX**2))


def _healed(task: Task, chosen: Choice, wanted: Choice, of: Ints) -> NDArray[np.float64]:
    """Return of which part of the border of each part the wanted orders make a smooth surface, less
    what they tear; of (n,): part of each pixel, -1 for what stays. Where something was not measured
    there is a border, too, unless the part is all around it."""
    known = chosen.order != NO_ORDER
    number, is_known = np.full(task.valid.shape, -1), np.zeros(task.valid.shape, bool)
    number[task.valid], is_known[task.valid] = of, known
    number = _filled(number, is_known)
    former, later = (_higher(task, which.order, known) for which in (chosen, wanted))
    gain, border = np.empty((2, int(of.max()) + 1), np.int64)
    _whole.heal(number, task.rises[1], former, later, gain, border)
    return np.asarray(gain / np.maximum(border, 1))


def _filled(number: Ints, is_known: Bools) -> Ints:
    """Give holes the number, (row, col), that is all around them; other gaps keep theirs."""
    gaps, n = ndimage.label(~is_known, np.ones((3, 3)))
    low, high = np.full(n + 1, np.iinfo(np.int64).max), np.full(n + 1, -1)
    _whole.bound_gaps(gaps, number, is_known, low, high)
    is_hole = low == high
    return np.where(is_hole[gaps], low[gaps], number)


def _hidden_from_c2(task: Task, chosen: Choice) -> Bools:
    """Tell which points, (n,), something that was chosen for other pixels hides from C2."""
    ways = np.abs(np.diff(task.sample[:, :, _orders.DEPTH], axis=1))
    step = task.ranges.label_step
    way = float(np.nanmedian(ways)) / step if np.isfinite(ways).any() else 0.0
    depth, noise = np.full((2, *task.valid.shape), np.nan)
    depth[task.valid] = np.where(chosen.order != NO_ORDER, chosen.depth_mm, np.nan)
    noise[task.valid] = task.first[1] / TWO_PI * way
    hidden = hidden_from([task.views.camera2], task.views.camera1, depth, noise)
    return np.asarray(hidden[task.valid])


def _against(chosen: Choice, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return what speaks against the chosen candidates of some pixels, half squares; NaN where C2
    does not see them."""
    costs, extras = chosen.against(index)
    return np.asarray(
        np.minimum(costs, LARGEST_REFUTATION) / 2 + np.minimum(extras / 2, LARGEST_EXTRA)
    )


def _parts(task: Task, order: NDArray[np.int32], known: Bools) -> Ints:
    """Return the number of the surface of each pixel, (row, col), -1 for none."""
    numbers = np.full(len(known), -1, np.int64)
    numbers[known] = surfaces(task, order, known, smooth=True)
    parts = np.full(task.valid.shape, -1, np.int64)
    parts[task.valid] = numbers
    return parts


def _higher(task: Task, order: NDArray[np.int32], known: Bools) -> NDArray[np.int32]:
    """Return by how many orders the next row and column are higher than the phase goes on to,
    (2, row, col); 0 where nothing is known."""
    turns = np.where(known, order + task.first[0] / TWO_PI, np.nan)
    higher = np.empty((2, *task.valid.shape), np.int32)
    over_rows(_whole.write_higher, len(task.index), task.index, turns, task.rises[0], higher)
    return higher


def _seams(
    pieces: Ints, parts: Ints, higher: NDArray[np.integer[Any]], is_smooth: Bools
) -> tuple[Ints, Ints, Ints, Ints]:
    """Return pairs of pieces with a smooth border, how many orders the second one is higher than
    the first would continue into it, and the weight of the border, px; (n,) each, a pair once."""
    n = int(pieces.max(initial=0)) + 1
    borders = _whole.list_borders(pieces, parts, higher, is_smooth, n)
    kinds, length = np.unique(borders, return_counts=True)
    smooth, bond = kinds & 2 > 0, kinds & 1 > 0
    pair, jump = np.divmod(kinds >> 2, 2 * _whole.MOST_JUMP)
    place = np.unique(pair, return_inverse=True)[1]
    long = (length >= LEAST_SEAM) & (length > SEAM_PART * np.bincount(place, length)[place])
    weight = length * np.where(bond, BOND, 1)
    taken = np.flatnonzero(smooth & (long | bond))
    taken = taken[np.argsort(-weight[taken], kind="stable")]
    # Pieces of one part may have a seam and a bond between them: the heavier one holds.
    taken = taken[np.unique(pair[taken], return_index=True)[1]]
    first, second = np.divmod(pair[taken], n)
    return first, second, jump[taken] - _whole.MOST_JUMP, weight[taken]


def _levels(first: Ints, second: Ints, higher: Ints, length: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the surface of each of n parts, and by how many orders it is off the surface's first.

    Where borders contradict each other the longest hold.
    """
    longest = np.argsort(-length, kind="stable")
    whole, level = np.empty((2, n), np.int64)
    _whole.hold_together(first[longest], second[longest], higher[longest], whole, level)
    return whole, level


def _elected(
    whole: Ints, level: Ints, votes: Ints, sizes: Ints
) -> tuple[Ints, NDArray[np.float64]]:
    """Return the level that most clear pixels of each part's surface have, and their share.

    Parts stay on their level, and nothing is shared, where too few pixels are clear.
    """
    n_levels = int(np.ptp(level)) + 1
    kinds, kind = np.unique(whole * n_levels + level - level.min(), return_inverse=True)
    kinds = np.stack(np.divmod(kinds, n_levels)) + np.array([[0], [level.min()]])
    votes_of = np.bincount(kind, votes)
    order = np.argsort(votes_of, kind="stable")
    wanted = np.zeros(int(whole.max()) + 1, np.int64)
    most = np.zeros(len(wanted))
    wanted[kinds[0, order]] = kinds[1, order]
    most[kinds[0, order]] = votes_of[order]
    total = np.bincount(whole, votes)
    settled = (total > 0) & (total >= LEAST_VOTES * np.bincount(whole, sizes))
    share = np.where(settled, most / np.maximum(total, 1), 1.0)
    return np.where(settled[whole], wanted[whole], level), share[whole]
