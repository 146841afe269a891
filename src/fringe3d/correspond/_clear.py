"""Pixels that decide alone: of the orders of their class one is seen by C2, all others are refuted;
compiled. It uses the parts of `_direct`."""

from __future__ import annotations

import numpy as np
from numba import njit

from fringe3d.correspond._direct import (
    COMPILED,
    DX,
    DY,
    FAR,
    FX,
    GUARD,
    GX,
    GY,
    HALF_PX,
    HIGH,
    INNER_HIGH,
    INNER_LOW,
    LOW,
    MODEL_VARIANCE,
    N_PLACES,
    N_WORK,
    NAN,
    NEAR,
    NOISE,
    NOISE_2,
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
    compare,
    fetch,
    fetch_orders,
    find_cells,
    find_noise,
    follow_curves,
    load,
    load_rays,
)  # fmt: skip

f4, i4, u1 = np.float32, np.int32, np.uint8

NO_PHASE, NOTHING, DECIDED, OUTSIDE, OPEN = range(5)
"""No phase; no order that C2 sees; decided, in the volume or outside it; left to the neighbours."""

CLASS, LOWEST, HIGHEST, N_FIT, N_OTHER, INSIDE, BEST = range(N_WORK, N_WORK + 7 * PART, PART)
HALF_WAY, PLACE, PLACE_SIGMA, DEPTH, BEST_X, BEST_Y = range(
    N_WORK + 7 * PART, N_WORK + 13 * PART, PART
)
N_ALL = N_WORK + 13 * PART

LEAST_RATE = f4(0.1)
"""See `candidates.LEAST_PLACING_RATIO`."""


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
    x0, y0, t0, xx, yx, tx = field[0], field[1], field[2], field[3], field[4], field[5]
    c0, c1, c2, c3, c4, c5 = field[6], field[7], field[8], field[9], field[10], field[11]
    c6, c7, c8, d0, d1, d2 = field[12], field[13], field[14], field[15], field[16], field[17]
    d3, d4, d5, d6, d7, d8 = field[18], field[19], field[20], field[21], field[22], field[23]
    scatter, most_cost, most_variance = limits[0], limits[1], limits[2]
    least_search, most_search, least_ratio = limits[3], limits[4], limits[5]
    v = (f4(row) - y0) * yx
    x_0, x_1, y_0, y_1 = c0 + v * (c2 + c5 * v), c1 + c4 * v, d0 + v * (d2 + d5 * v), d1 + d4 * v
    rise_x, rise_y = c6 + c8 * v, d6 + d8 * v
    for i in range(n):
        same = _has_class(i, A, ORDER_A, code, work) | _has_class(i, B, ORDER_B, code, work)
        same |= _has_class(i, C, ORDER_C, code, work) | _has_class(i, D, ORDER_D, code, work)
        u, s = (f4(left + i) - x0) * xx, (work[T + i] - t0) * tx
        moved_x = x_0 + u * (x_1 + c3 * u) + (rise_x + c7 * u) * s
        moved_y = y_0 + u * (y_1 + d3 * u) + (rise_y + d7 * u) * s
        gx, gy = work[GX + i] * PER_TURN, work[GY + i] * PER_TURN
        difference = work[R + i] * PER_TURN
        expected = gx * moved_x + gy * moved_y
        residual = difference - expected
        residual -= np.rint(residual)
        ratio = (gx * work[DX + i] + gy * work[DY + i]) * period
        own = (ratio - ONE) * work[NOISE + i]
        spread = (gx * gx + gy * gy) * (scatter * scatter)
        variance = (work[NOISE_2 + i] * work[NOISE_2 + i] + own * own) * (PER_TURN * PER_TURN)
        variance += MODEL_VARIANCE + spread
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
        reach = abs(difference) + f4(4) * np.sqrt(variance)
        reach = min(max(reach, least_search), most_search) / max(abs(ratio), least_ratio)
        rate = ratio if abs(ratio) > LEAST_RATE else NAN
        noise = work[NOISE + i] * PER_TURN
        low, high = work[INNER_LOW + i] - work[GUARD + i], work[INNER_HIGH + i] + work[GUARD + i]
        inside = (work[W + i] >= low) & (work[W + i] <= high)
        sigma = np.sqrt(noise * noise + spread / (rate * rate)) * period
        work[INSIDE + i] = (ONE if inside else ZERO) if fits else work[INSIDE + i]
        work[BEST + i] = work[ORDER + i] if fits else work[BEST + i]
        work[HALF_WAY + i] = min(reach, HALF_PX) * period if fits else work[HALF_WAY + i]
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
