"""Fringe orders from code words and wrapped phase."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fringe3d.decode import _fused
from fringe3d.decode.gray import CodeWords, expected_words
from fringe3d.model import NO_ORDER, PhaseMap, Rejection, WrappedPhaseMap
from fringe3d.model.plan import GraySet
from fringe3d.model.rejection import reject
from fringe3d.patterns import EDGE_TOLERANCE

PHASE_BINS = _fused.PHASE_BINS
"""Parts of a period in which the code is looked up; a cell of half a period holds eight."""

MAX_MISREAD = 0.25
"""Periods by which a code edge may seem to be displaced: half the smallest cell."""

CLEAR_BIT = 0.5
"""Part of the fringe modulation that a bit must differ from its threshold by to count as clear;
bits swing as far as the fringes, except on the blurred edges of their cells."""

EDGE_REACH = 0.25
"""Part of a cell (at most a period) around its edges in which a bit may be misread."""

TWO_PI = 2 * np.pi


@dataclass(frozen=True, slots=True)
class OrderClasses:
    """The fringe orders on a projector, and which of them a code cannot tell apart.

    See `PhaseMap` for `first_order` and `class_of_order`.
    """

    first_order: int
    class_of_order: NDArray[np.int32]

    @property
    def is_absolute(self) -> bool:
        """Tell whether every class is a single order."""
        return len(np.unique(self.class_of_order)) == len(self.class_of_order)


def all_orders(period_px: float, extent_px: tuple[float, float], /) -> OrderClasses:
    """Return the orders of the periods between two coordinates w (px), each its own class."""
    first = math.floor(extent_px[0] / period_px + EDGE_TOLERANCE)
    last = math.ceil(extent_px[1] / period_px - EDGE_TOLERANCE)
    return OrderClasses(first, np.arange(first, last, dtype=np.int32))


@dataclass(frozen=True, slots=True)
class OrderTable:
    """Which class of fringe orders a word means, for each part of the period.

    Parameters
    ----------
    by_word : (2**n, PHASE_BINS) int32; class, or `NO_ORDER` where word and phase contradict
    alternatives : (2**n, PHASE_BINS, 2) int32
        Other classes that would show this word if one bit was misread at its edge nearby;
        `NO_ORDER` where there are fewer than two.
    naive : (2**n,) int32; class that the word alone would give; `NO_ORDER` for none or several
    classes : OrderClasses
    following, preceding : (n_orders,) int32
        Class of the next and of the previous order, for the class named ``first_order + i``;
        `NO_ORDER` where its members disagree.
    packed : (2**n * PHASE_BINS,) int32; all that a pixel needs, as the compiled decoder reads it
    """

    by_word: NDArray[np.int32]
    alternatives: NDArray[np.int32]
    naive: NDArray[np.int32]
    classes: OrderClasses
    following: NDArray[np.int32]
    preceding: NDArray[np.int32]
    packed: NDArray[np.int32]

    @property
    def has_alternative(self) -> NDArray[np.bool_]:
        """Tell where a word has an alternative, (2**n * PHASE_BINS,)."""
        return np.asarray((self.packed & _fused.UNSAFE) != 0)


@lru_cache(maxsize=8)
def order_table(
    gray_set: GraySet, period_px: float, extent_px: tuple[float, float], /
) -> OrderTable:
    """Tabulate the meaning of every code word for fringes of one period.

    Any code fits that is a function of the projector coordinate: full, over-determined
    (complementary), reduced cyclic, or with bits left out. Orders that show the same word
    in some part of the period form one class. Where the phase says that an edge of the code is
    near, the word from across that edge is accepted, too: so a bit that was misread at its edge
    does no harm.
    Where that word has a meaning of its own (a plain code has its edges where the phase wraps;
    the low bits of a reflected code repeat mirrored, so that both neighbours of a class may come
    into question) it is kept as an alternative.

    Parameters
    ----------
    gray_set : GraySet
    period_px : float, projector px
    extent_px : smallest and largest w of the projector, px
    """
    orders = all_orders(period_px, extent_px).class_of_order
    parts = (np.arange(PHASE_BINS) + 0.5) / PHASE_BINS
    w = (orders[:, None] + parts) * period_px
    words = expected_words(gray_set, w)

    class_of_order = _classes(orders, words)
    by_word = np.full((1 << len(gray_set.bits), PHASE_BINS), NO_ORDER, np.int32)
    alternatives = np.repeat(by_word[..., None], 2, axis=-1)
    all_bins = np.arange(PHASE_BINS)
    reach = EDGE_REACH * min(gray_set.cell_px / period_px, 1.0)
    for shift in _nearest_first():
        # Beyond the projector's border there is nothing to see; a cyclic code starts anew there.
        moved = w + shift * period_px
        on_projector = (moved > extent_px[0]) & (moved < extent_px[1])
        seen = expected_words(gray_set, moved)
        for name, all_words, inside in zip(class_of_order, seen, on_projector, strict=True):
            row, bins = all_words[inside], all_bins[inside]
            empty = by_word[row, bins] == NO_ORDER
            by_word[row[empty], bins[empty]] = name
            if abs(shift) <= reach:
                _add_alternative(alternatives, row, bins, name, by_word)
    naive = _naive(words, class_of_order, len(by_word))
    classes = OrderClasses(int(orders[0]), class_of_order)
    following, preceding = _neighbour_classes(classes, 1), _neighbour_classes(classes, -1)
    packed = _packed(by_word, alternatives, naive, classes.first_order)
    for array in (by_word, alternatives, naive, following, preceding, packed, class_of_order):
        array.setflags(write=False)
    return OrderTable(by_word, alternatives, naive, classes, following, preceding, packed)


def _packed(
    by_word: NDArray[np.int32],
    alternatives: NDArray[np.int32],
    naive: NDArray[np.int32],
    first_order: int,
) -> NDArray[np.int32]:
    unsafe = (alternatives != NO_ORDER).any(axis=-1)
    corrected = (naive != NO_ORDER)[:, None] & (naive[:, None] != by_word) & ~unsafe
    place = np.where(by_word == NO_ORDER, 0, by_word.astype(np.int64) - first_order + 1)
    packed = 4 * place + _fused.UNSAFE * unsafe + _fused.CORRECTED * corrected
    return np.asarray(packed.ravel(), np.int32)


def _classes(orders: NDArray[np.int32], words: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the class of each order: all that share a word in some part of the period.

    Where the code's cycle is no multiple of the period, orders share words in parts only; they are
    one class, too, for the pixels there cannot tell them apart.
    """
    rows, cols = [], []
    for part in words.T:
        _, first, group = np.unique(part, return_index=True, return_inverse=True)
        rows.append(np.arange(len(part)))
        cols.append(first[group])
    edges = np.concatenate(rows), np.concatenate(cols)
    graph = coo_array((np.ones(len(edges[0]), bool), edges), shape=(len(orders),) * 2)
    _, label = connected_components(graph, directed=False)
    _, smallest = np.unique(label, return_index=True)
    return np.asarray(orders[smallest[label]], np.int32)


def _add_alternative(
    alternatives: NDArray[np.int32],
    row: NDArray[np.int32],
    bins: NDArray[np.intp],
    name: np.int32,
    by_word: NDArray[np.int32],
) -> None:
    """Put a class into the first empty place, unless it is known there already."""
    new = (by_word[row, bins] != name) & (alternatives[row, bins] != name).all(axis=-1)
    for place in range(alternatives.shape[-1]):
        here = new & (alternatives[row, bins, place] == NO_ORDER)
        alternatives[row[here], bins[here], place] = name
        new &= ~here


def _naive(
    words: NDArray[np.int32], class_of_order: NDArray[np.int32], n_words: int
) -> NDArray[np.int32]:
    """Return the class that a word alone means; `NO_ORDER` where it means several."""
    lowest = np.full(n_words, np.iinfo(np.int32).max, np.int32)
    highest = np.full(n_words, np.iinfo(np.int32).min, np.int32)
    names = np.repeat(class_of_order, PHASE_BINS)
    np.minimum.at(lowest, words.ravel(), names)
    np.maximum.at(highest, words.ravel(), names)
    return np.where(lowest == highest, lowest, np.int32(NO_ORDER))


def _nearest_first() -> list[float]:
    steps = np.arange(1, round(MAX_MISREAD * PHASE_BINS) + 1) / PHASE_BINS
    return [0.0, *(sign * step for step in steps for sign in (-1.0, 1.0))]


def order_from_code(wrapped: WrappedPhaseMap, words: CodeWords, table: OrderTable, /) -> PhaseMap:
    """Combine wrapped phase and code words.

    Next to code edges that leave an alternative, the nearest pixel without one decides: the
    absolute phase is continuous. Where that pixel lies on another surface, the word counts only
    if all its bits are clear.

    Parameters
    ----------
    wrapped : WrappedPhaseMap
    words : CodeWords
    table : OrderTable

    Returns
    -------
    PhaseMap
        `n_mended` counts the pixels whose word alone would have given another order.
    """
    phase = positive_phase(wrapped.phase)
    valid = wrapped.rejection == 0
    part = phase * _fused.BINS_PER_RAD + _fused.EDGE
    bins = np.minimum(np.where(valid, part, 0).astype(np.int32), PHASE_BINS - 1)
    place = words.word * PHASE_BINS + bins
    looked_up = np.where(valid, table.by_word.ravel()[place], np.int32(NO_ORDER))
    unsafe = valid & table.has_alternative[place]
    alternatives = table.alternatives.reshape(-1, 2)[place[unsafe]]
    is_clear = (words.contrast_dn >= np.float32(CLEAR_BIT) * wrapped.modulation)[unsafe]
    order = looked_up.copy()
    order[unsafe] = mended_orders(looked_up, phase, unsafe, alternatives, is_clear, table)
    known = order != NO_ORDER
    rejection = wrapped.rejection.copy()
    reject(rejection, valid & ~known, Rejection.INCONSISTENT_CODE)
    naive = table.naive[words.word]
    corrected = ((naive != NO_ORDER) & (naive != order)) | (order != looked_up)
    n_mended = int((known & corrected).sum())
    return phase_map(wrapped, phase, order, table.classes, rejection, n_mended=n_mended)


def positive_phase(phase: NDArray[np.float32], /) -> NDArray[np.float32]:
    """Map a phase of (-pi, pi] to [0, 2 pi), so that ``Phi = phase + 2 pi floor(w / period)``."""
    moved = np.where(phase < 0, phase + np.float32(TWO_PI), phase)
    return np.where(moved >= np.float32(TWO_PI), np.float32(0), moved).astype(np.float32)


def phase_map(
    wrapped: WrappedPhaseMap,
    phase: NDArray[np.float32],
    order: NDArray[np.int32],
    classes: OrderClasses,
    rejection: NDArray[np.uint16],
    /,
    *,
    n_mended: int = 0,
) -> PhaseMap:
    """Compose a `PhaseMap`; phase and order are masked where a pixel is rejected."""
    good = rejection == 0
    return PhaseMap(
        phase=np.where(good, phase, np.nan),
        order_class=np.where(good, order, NO_ORDER),
        class_of_order=classes.class_of_order,
        first_order=classes.first_order,
        phase_std=wrapped.phase_std,
        offset=wrapped.offset,
        modulation=wrapped.modulation,
        rejection=rejection,
        period_px=wrapped.period_px,
        angle=wrapped.angle,
        device_name=wrapped.device_name,
        n_mended=n_mended,
    )


def mended_orders(
    order: NDArray[np.int32],
    phase: NDArray[np.float32],
    unsafe: NDArray[np.bool_],
    alternatives: NDArray[np.int32],
    is_clear: NDArray[np.bool_],
    table: OrderTable,
    /,
) -> NDArray[np.int32]:
    """Take what continues the phase of the nearest safe pixel; else only clear words.

    Parameters
    ----------
    order : (row, col) int32; classes as looked up, `NO_ORDER` where there is none
    phase : (row, col) float32, rad, [0, 2 pi)
    unsafe : (row, col) bool; n pixels whose word has alternatives
    alternatives : (n, 2) int32; see `OrderTable`
    is_clear : (n,) bool; no bit of the word is close to its threshold
    table : OrderTable

    Returns
    -------
    (n,) int32
        Classes of the unsafe pixels.
    """
    looked_up = order[unsafe]
    by_word = np.where(is_clear, looked_up, np.int32(NO_ORDER))
    safe = (order != NO_ORDER) & ~unsafe
    if not len(looked_up) or not safe.any():
        return by_word
    rows, cols = ndimage.distance_transform_edt(~safe, return_distances=False, return_indices=True)
    rows, cols = rows[unsafe], cols[unsafe]
    turns = np.rint((phase[rows, cols] - phase[unsafe]) / TWO_PI).astype(np.int32)
    expected = order[rows, cols]
    index = expected - table.classes.first_order
    expected = np.where(turns == 1, table.following[index], expected)
    expected = np.where(turns == -1, table.preceding[index], expected)
    possible = np.column_stack([looked_up, alternatives])
    continues = (expected != NO_ORDER) & (possible == expected[:, None]).any(axis=1)
    return np.where(continues, expected, by_word)


def _neighbour_classes(orders: OrderClasses, step: int) -> NDArray[np.int32]:
    """Return the class of order ``k + step`` for each class, where all its members agree."""
    classes = orders.class_of_order
    result = np.full(len(classes), NO_ORDER, np.int32)
    for name in np.unique(classes):
        members = np.flatnonzero(classes == name) + step
        members = members[(members >= 0) & (members < len(classes))]
        if len(members) and (classes[members] == classes[members[0]]).all():
            result[name - orders.first_order] = classes[members[0]]
    return result


def has_mirrored_neighbours(phases: PhaseMap, /) -> bool:
    """Tell whether a code leaves neighbouring periods in one class, as a plain one cut short."""
    classes = phases.class_of_order
    return bool(classes.min() < classes.max() and (np.diff(classes) == 0).any())


def one_class(period_px: float, extent_px: tuple[float, float], /) -> OrderClasses:
    """Return the orders of the periods between two coordinates w (px), all in one class."""
    orders = all_orders(period_px, extent_px)
    first = orders.first_order
    return OrderClasses(first, np.full_like(orders.class_of_order, first))


def order_unknown(wrapped: WrappedPhaseMap, classes: OrderClasses, /) -> PhaseMap:
    """Return a phase map of which nothing is known but the wrapped phase; see `one_class`."""
    order = np.where(wrapped.rejection == 0, np.int32(classes.first_order), np.int32(NO_ORDER))
    return phase_map(wrapped, positive_phase(wrapped.phase), order, classes, wrapped.rejection)
