"""Pixels that decide alone: of the orders of their class one is seen by C2, all others are refuted;
compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from fringe3d.correspond._tile import (
    COMPILED,
    FAR,
    FX,
    GUARD,
    HALF_PX,
    HIGH,
    LOW,
    N_PLACES,
    N_WORK,
    NAN,
    NEAR,
    NOISE,
    ONE,
    ORDER,
    ORDER_A,
    ORDER_B,
    ORDER_C,
    ORDER_D,
    PART,
    PER_TURN,
    PHI,
    TILE,
    ZERO,
    A,
    B,
    C,
    D,
    R,
    T,
    W,
    X,
    Y,
    along_row,
    compare,
    expect,
    fetch,
    fetch_orders,
    find_cells,
    find_noise,
    follow_curves,
    is_in_volume,
    load,
    load_rays,
    reach_of,
)  # fmt: skip

f4, i4, u1 = np.float32, np.int32, np.uint8

NO_PHASE, NOTHING, DECIDED, OUTSIDE, OPEN = range(5)
"""No phase; no order that C2 sees; decided, in the volume or outside it; left to the neighbours."""

CLASS, LOWEST, HIGHEST, N_FIT, N_OTHER, INSIDE, BEST = range(N_WORK, N_WORK + 7 * PART, PART)
HALF_WAY, PLACE, PLACE_SIGMA, DEPTH, BEST_X, BEST_Y = range(
    N_WORK + 7 * PART, N_WORK + 13 * PART, PART
)
N_ALL = N_WORK + 13 * PART

LEAST_PLACING_RATIO = 0.1
"""Of the phases that C2 and the projector see along a ray; with less C2 tells no place on it."""

LEAST_RATE = f4(LEAST_PLACING_RATIO)


@njit(**COMPILED)
def list_orders(n, period, guard, code, work):  # type: ignore[no-untyped-def]
    """Write the lowest and highest order on each ray; return how many there are at most."""
    per_rad, more = guard
    first, last, step = code
    most = ZERO
    for i in range(n):
        work[CLASS + i] = work[ORDER + i]
        turns, beyond = work[PHI + i] * PER_TURN, per_rad * work[NOISE + i] + more
        work[GUARD + i] = beyond
        low, high = work[LOW + i], work[HIGH + i]
        known = (low <= high) & (turns == turns)
        low = np.ceil(((low if known else ZERO) - beyond) / period - (turns if known else ZERO))
        high = np.floor(((high if known else ZERO) + beyond) / period - (turns if known else ZERO))
        low, high = low if low > first else first, high if high < last else last
        way = work[CLASS + i] - low
        low += way - step * np.floor(way / step)
        high = high if known else -ONE + low
        work[LOWEST + i], work[HIGHEST + i] = low, high
        work[N_FIT + i], work[N_OTHER + i], work[INSIDE + i], work[BEST + i] = (
            ZERO,
            ZERO,
            ZERO,
            ZERO,
        )
        count = np.floor((high - low) / step) + ONE
        most = count if count > most else most
    return int(most)


@njit(**COMPILED)
def take_order(n, place, period, step, work):  # type: ignore[no-untyped-def]
    """Write the light sheets of the orders in one place of the lists."""
    for i in range(n):
        work[ORDER + i] = work[LOWEST + i] + f4(place) * step
        work[W + i] = (work[ORDER + i] + work[PHI + i] * PER_TURN) * period


@njit(**COMPILED, inline="always")
def _has_class(i, phase, there, code, work):  # type: ignore[no-untyped-def]
    """Tell whether a neighbour has the class that the phase at the place demands of it."""
    first, last, step = code
    order = np.floor((work[PHI + i] + work[R + i] - work[phase + i]) * PER_TURN + HALF_PX)
    order += work[ORDER + i]
    demanded = order - step * np.floor((order - first) / step)
    return (order >= first) & (order <= last) & (work[there + i] == demanded)


@njit(**COMPILED)
def weigh(n, row, left, period, code, field, limits, work):  # type: ignore[no-untyped-def]
    """Judge the orders in one place of the lists, see `_direct.judge`, and keep what fits."""
    scatter, most_cost, most_variance = limits[0], limits[1], limits[2]
    search, terms = (limits[3], limits[4], limits[5]), along_row(row, field)
    for i in range(n):
        same = _has_class(i, A, ORDER_A, code, work) | _has_class(i, B, ORDER_B, code, work)
        same |= _has_class(i, C, ORDER_C, code, work) | _has_class(i, D, ORDER_D, code, work)
        residual, expected, variance, unknown, ratio = expect(i, left, period, terms, scatter, work)
        listed = work[ORDER + i] <= work[HIGHEST + i]
        beyond = (work[X + i] == work[X + i]) & (not work[FX + i] >= ZERO)  # of what C2 sees
        judged = variance + abs(residual) < most_variance + ONE
        judged &= (variance < most_variance) & (work[T + i] > ZERO)
        unseen = beyond | ((variance + abs(residual) < f4(1e9)) & (not same))
        fits = listed & judged & (not unseen) & (residual * residual <= most_cost * variance)
        refuted = judged & (not unseen) & (residual * residual > most_cost * variance)
        # What has a hole beside it, or is too uncertain, may be; so may what C2 does not see be,
        # if something else fits.
        work[N_OTHER + i] += ZERO if (not listed) | fits | refuted else ONE if unseen else f4(100)
        work[N_FIT + i] += ONE if fits else ZERO
        rate = ratio if abs(ratio) > LEAST_RATE else NAN
        noise = work[NOISE + i] * PER_TURN
        sigma = np.sqrt(noise * noise + unknown / (rate * rate)) * period
        inside = ONE if is_in_volume(i, work) else ZERO
        half = reach_of(i, variance, ratio, search, period, work)
        work[INSIDE + i] = inside if fits else work[INSIDE + i]
        work[BEST + i] = work[ORDER + i] if fits else work[BEST + i]
        work[HALF_WAY + i] = half if fits else work[HALF_WAY + i]
        work[PLACE + i] = -expected / rate * period if fits else work[PLACE + i]
        work[PLACE_SIGMA + i] = sigma if fits else work[PLACE_SIGMA + i]
        work[DEPTH + i] = work[T + i] if fits else work[DEPTH + i]
        work[BEST_X + i] = work[X + i] if fits else work[BEST_X + i]
        work[BEST_Y + i] = work[Y + i] if fits else work[BEST_Y + i]


@njit(**COMPILED)
def store(n, rejection, n_cols2, work, maps):  # type: ignore[no-untyped-def]
    """Write what is decided of a tile."""
    state, order, half, place, place_sigma, depth, seen_at = maps
    for i in range(n):
        is_open = (work[N_OTHER + i] >= f4(100)) | (work[N_FIT + i] > ONE)
        is_open |= (work[N_FIT + i] == ONE) & (work[N_OTHER + i] > ZERO)
        where = f4(DECIDED) if work[INSIDE + i] > ZERO else f4(OUTSIDE)
        found = f4(NOTHING) if work[N_FIT + i] == ZERO else where
        misses = not (work[NEAR + i] < work[FAR + i])
        work[A + i] = f4(NOTHING) if misses else f4(OPEN) if is_open else found
    for i in range(n):
        state[i] = u1(work[A + i]) if rejection[i] == 0 else u1(NO_PHASE)
    for i in range(n):
        order[i] = i4(work[BEST + i])
    for i in range(n):
        half[i] = work[HALF_WAY + i]
    for i in range(n):
        place[i] = work[PLACE + i]
    for i in range(n):
        place_sigma[i] = work[PLACE_SIGMA + i]
    for i in range(n):
        depth[i] = work[DEPTH + i]
    for i in range(n):
        fits = work[N_FIT + i] > ZERO
        x, y = work[BEST_X + i] if fits else ZERO, work[BEST_Y + i] if fits else ZERO
        seen_at[i] = i4(np.rint(y)) * i4(n_cols2) + i4(np.rint(x))


@njit(cache=True, nogil=True, error_model="numpy")
def decide(first, tables, second, guard, code, field, limits, maps, rows):  # type: ignore[no-untyped-def]
    """Find the pixels that decide alone.

    first = (phase, class of orders, sigma, rejection (row, col), period, px) of C1; tables, guard,
    field, limits: as `_direct.locate` takes them; second = (phase, sigma, class) of C2; code =
    (first, last order, distance of the orders of a class), float32. maps = (state, order, half,
    place and its sigma, depth, seen_at (row, col)), see `fringe3d.correspond.clear`; rows: first
    and last but one.
    """
    phase1, class1, sigma1, rejection, period = first
    ends, curves, wide, inner, rays = tables
    shape = second[0].shape
    phase2, sigma2, class2 = second[0].reshape(-1), second[1].reshape(-1), second[2].reshape(-1)
    state, order, half, where, where_sigma, depth, seen_at = maps
    n_cols, step = phase1.shape[1], code[2]
    work, place, cell = np.zeros(N_ALL, f4), np.zeros(N_PLACES), np.empty(TILE, i4)
    for row in range(rows[0], rows[1]):
        for left in range(0, n_cols, TILE):
            tile = slice(left, min(left + TILE, n_cols))
            n = tile.stop - tile.start
            own = (phase1[row, tile], class1[row, tile], sigma1[row, tile])
            load(n, own, (ends[row, tile], wide[row, tile], inner[row, tile]), work)
            most = list_orders(n, period, guard, code, work)
            if most > 0:
                load_rays(n, curves[row, :, tile], rays[row, tile], work, place)
            for number in range(most):
                take_order(n, number, period, step, work)
                follow_curves(n, work)
                find_cells(n, work, X, Y, shape, cell, work)
                fetch(n, sigma2, cell, shape[1], work)
                find_noise(n, work)
                fetch(n, phase2, cell, shape[1], work)
                compare(n, work)
                fetch_orders(n, class2, cell, shape[1], work)
                weigh(n, row, left, period, code, field, limits, work)
            store(n, rejection[row, tile], shape[1], work, (
                state[row, tile], order[row, tile], half[row, tile], where[row, tile],
                where_sigma[row, tile], depth[row, tile], seen_at[row, tile],
            ))  # fmt: skip
