"""Fringe orders from several periods: hierarchical, heterodyne, or behind a code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode.order import OrderClasses, all_orders, phase_map, positive_phase
from fringe3d.model import NO_ORDER, PhaseMap, Rejection, WrappedPhaseMap
from fringe3d.model.rejection import reject
from fringe3d.patterns import unambiguous_px

TWO_PI = 2 * np.pi

MIN_EVIDENCE = 9.0
"""Difference of chi-square between the best and the second order: odds of 90 to 1."""

MAX_RESIDUAL_SIGMA = 6.0
SYSTEMATIC_RAD = 0.03
"""Phase error that gamma and defocus leave in real fringes, added to the noise."""

EXACTLY_ALIKE = SYSTEMATIC_RAD / TWO_PI
"""Periods; what differs more may be told apart, if the noise of the pixel allows."""

MAX_UNWRAP_RESIDUAL = 0.35
"""Periods; an order from a coarser phase is right below 0.5, and worth nothing close to it."""

CHUNK_PIXELS = 1 << 18


def order_from_coarser(wrapped: WrappedPhaseMap, coarse: PhaseMap, /) -> PhaseMap:
    """Unwrap one phase by another whose absolute phase is known.

    ``k = round(w_coarse / period - phase / 2 pi)``; pixels where the two disagree by more
    than `MAX_UNWRAP_RESIDUAL` periods are rejected as INCONSISTENT_CODE.
    """
    phase = positive_phase(wrapped.phase)
    turns = coarse.position_px / wrapped.period_px - phase / TWO_PI
    nearest = np.rint(turns)
    rejection = wrapped.rejection | coarse.rejection
    undecided = ~(np.abs(turns - nearest) <= MAX_UNWRAP_RESIDUAL)
    reject(rejection, undecided & (rejection == 0), Rejection.INCONSISTENT_CODE)
    order = np.where(rejection == 0, nearest, NO_ORDER).astype(np.int32)
    w_first = coarse.first_order * coarse.period_px
    w_last = (coarse.first_order + len(coarse.class_of_order)) * coarse.period_px
    orders = all_orders(wrapped.period_px, (w_first, w_last))
    return phase_map(wrapped, phase, order, orders, rejection)


def order_from_periods(
    maps: Sequence[WrappedPhaseMap], extent_px: tuple[float, float], /
) -> PhaseMap:
    """Find the order of the finest of several phases by the agreement of all.

    Every order k of the finest period is a hypothesis for the position w; the other phases
    must then be ``2 pi w / period_j``. The order with the smallest chi-square wins, provided
    that the second is clearly worse. One period as wide as the projector (hierarchical) or a
    beat of two close ones (heterodyne) are special cases. Where all phases repeat within the
    projector, the orders that look alike form one class (`PhaseMap`).

    Parameters
    ----------
    maps : WrappedPhaseMap of one direction, at least two
    extent_px : smallest and largest w of the projector, px

    Returns
    -------
    PhaseMap
        Of the finest period. INCONSISTENT_CODE where no order fits, AMBIGUOUS where two do.
    """
    finest, *others = sorted(maps, key=lambda m: m.period_px)
    orders = _alike(all_orders(finest.period_px, extent_px), maps)
    rejection = np.bitwise_or.reduce([m.rejection for m in maps])
    phase = positive_phase(finest.phase)
    order = np.full(phase.shape, NO_ORDER, np.int32)
    valid = np.flatnonzero(rejection.ravel() == 0)
    for start in range(0, len(valid), CHUNK_PIXELS):
        part = valid[start : start + CHUNK_PIXELS]
        best, reason = _search(part, finest, others, orders)
        order.ravel()[part] = best
        rejection.ravel()[part] |= reason
    return phase_map(finest, phase, order, orders, rejection)


def _alike(orders: OrderClasses, maps: Sequence[WrappedPhaseMap]) -> OrderClasses:
    """Put orders of the finest period into one class where all periods repeat between them."""
    first, classes = orders.first_order, orders.class_of_order
    finest = min(m.period_px for m in maps)
    periods = [m.period_px for m in maps]
    range_px = unambiguous_px(periods, len(classes) * finest, alike=EXACTLY_ALIKE)
    cycle = round(range_px / finest)
    return OrderClasses(first, np.asarray(first + (classes - first) % cycle, np.int32))


def _search(
    part: NDArray[np.intp],
    finest: WrappedPhaseMap,
    others: Sequence[WrappedPhaseMap],
    orders: OrderClasses,
) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    fine = positive_phase(finest.phase).ravel()[part]
    fine_variance = finest.phase_std.ravel()[part] ** 2
    best = np.full(len(part), np.inf, np.float32)
    second = best.copy()
    winner = np.zeros(len(part), np.int32)
    terms = []
    for other in others:
        ratio = np.float32(finest.period_px / other.period_px)
        variance = other.phase_std.ravel()[part] ** 2 + ratio**2 * fine_variance
        terms.append((ratio, other.phase.ravel()[part], variance + np.float32(SYSTEMATIC_RAD**2)))
    for order in np.unique(orders.class_of_order):
        cost = np.zeros(len(part), np.float32)
        for ratio, phase, variance in terms:
            # The whole turns of the hypothesis go first, in double precision.
            start = np.float32(float(ratio) * TWO_PI * float(order) % TWO_PI)
            residual = start + ratio * fine - phase
            residual -= np.float32(TWO_PI) * np.rint(residual / np.float32(TWO_PI))
            cost += residual**2 / variance
        better = cost < best
        second = np.where(better, best, np.minimum(second, cost))
        best = np.where(better, cost, best)
        winner[better] = order
    reason = np.zeros(len(part), np.uint16)
    reject(reason, best > len(others) * MAX_RESIDUAL_SIGMA**2, Rejection.INCONSISTENT_CODE)
    reject(reason, second - best < MIN_EVIDENCE, Rejection.AMBIGUOUS)
    return winner, reason
