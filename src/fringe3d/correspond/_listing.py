"""What C2 shows of fringe orders, many pixels at a time, compiled.

What `_orders.list_candidates` says of one candidate after the other is said here of one order of
many pixels at once, in single precision: inner loops without a branch become vector instructions.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from fringe3d import model
from fringe3d.correspond import _curves
from fringe3d.correspond._aggregate import FAR, UNIT
from fringe3d.correspond._curves import exact_point, turned
from fringe3d.correspond._orders import DEPTH, DIFFERENCE, GRADIENT_X, GRADIENT_Y
from fringe3d.correspond._orders import RATIO as SHOWN_RATIO
from fringe3d.correspond._orders import VARIANCE as SHOWN_VARIANCE
from fringe3d.correspond._phase import MAX_JUMP
from fringe3d.correspond._tile import (
    COMPILED,
    CURVE,
    DT,
    DX,
    DY,
    FX,
    FY,
    GX,
    GY,
    HALF_PX,
    MODEL_VARIANCE,
    N_WORK,
    NAN,
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
    f4,
    fetch,
    fetch_orders,
    find_cells,
    follow_curves,
    i4,
    wrap,
)  # fmt: skip

LOWEST, HIGHEST, STILL_X, STILL_Y, RISE_X, RISE_Y = range(N_WORK, N_WORK + 6 * PART, PART)
LEVEL, PER_T, PER_T2, COST, VARIANCE, RATIO = range(N_WORK + 6 * PART, N_WORK + 12 * PART, PART)
COL, ROW = range(N_WORK + 12 * PART, N_WORK + 14 * PART, PART)
N_ALL = N_WORK + 14 * PART

NO_ORDER = np.int32(model.NO_ORDER)
U16, FAR_F, UNIT_F = np.uint16, f4(FAR), f4(UNIT)


@njit(**COMPILED)
def load_listed(n, where, first, curves, n_cols, starts, work):  # type: ignore[no-untyped-def]
    """Bring phase, noise and curve of pixels of a list into the scratch; return whether some have
    no curve.

    where (n,): number of the pixel in the image, rising; first = (phase, sigma (n,)); curves: flat.
    """
    phase, sigma = first
    for i in range(n):
        work[PHI + i], work[NOISE + i] = phase[i], sigma[i]
    row = where[0] // n_cols
    for i in range(n):
        while where[i] >= (row + 1) * n_cols:
            row += 1
        col = where[i] - row * n_cols
        starts[i] = row * (_curves.N_CURVE * n_cols) + col
        work[COL + i], work[ROW + i] = f4(col), f4(row)
    for k in range(_curves.N_CURVE):
        for i in range(n):
            work[CURVE + k * PART + i] = curves[starts[i] + k * n_cols]
    missing = 0
    for i in range(n):
        missing += work[CURVE + i] != work[CURVE + i]
    return missing > 0


@njit(**COMPILED, inline="always")
def _quartic(u, v, c):  # type: ignore[no-untyped-def]
    """Return a polynomial, c (5, 5): factor of u**i v**j, up to the fourth degree."""
    at_0 = c[0, 0] + u * (c[1, 0] + u * (c[2, 0] + u * (c[3, 0] + u * c[4, 0])))
    at_1 = c[0, 1] + u * (c[1, 1] + u * (c[2, 1] + u * c[3, 1]))
    at_2 = c[0, 2] + u * (c[1, 2] + u * c[2, 2])
    return at_0 + v * (at_1 + v * (at_2 + v * (c[0, 3] + u * c[1, 3] + v * c[0, 4])))


@njit(**COMPILED)
def load_field(n, frame, field, work):  # type: ignore[no-untyped-def]
    """Write the displacement that the bias lets expect of each pixel, and its variance, as
    functions of the depth. frame, field: see `weigh_listed`."""
    x0, y0, per_x, per_y = frame[0], frame[1], frame[3], frame[4]
    for part, number in ((STILL_X, 0), (STILL_Y, 1), (RISE_X, 2), (RISE_Y, 3),
                         (LEVEL, 4), (PER_T, 5), (PER_T2, 6)):  # fmt: skip
        for i in range(n):
            u, v = (work[COL + i] - x0) * per_x, (work[ROW + i] - y0) * per_y
            work[part + i] = _quartic(u, v, field[number])


@njit(**COMPILED)
def follow_exactly(n, where, rays, devices, work):  # type: ignore[no-untyped-def]
    """Write the points of the rays that have no curve, one after the other."""
    directions, rotation_p, rotation_2 = rays
    projector, camera2 = devices
    for i in range(n):
        if (work[CURVE + i] != work[CURVE + i]) & (work[W + i] == work[W + i]):
            ray = directions[where[i]]
            point = exact_point(
                np.float64(work[W + i]), turned(rotation_p, ray), turned(rotation_2, ray),
                projector, camera2,
            )  # fmt: skip
            work[T + i], work[X + i], work[Y + i] = point[0], point[1], point[2]
            work[DT + i], work[DX + i], work[DY + i] = point[3], point[4], point[5]


@njit(**COMPILED)
def find_known_noise(n, work):  # type: ignore[no-untyped-def]
    """Write the largest deviation, fetched as orders are, of the neighbours that have a phase."""
    for i in range(n):
        a = work[ORDER_A + i] if work[A + i] == work[A + i] else ZERO
        b = work[ORDER_B + i] if work[B + i] == work[B + i] else ZERO
        c = work[ORDER_C + i] if work[C + i] == work[C + i] else ZERO
        d = work[ORDER_D + i] if work[D + i] == work[D + i] else ZERO
        work[NOISE_2 + i] = max(max(a, b), max(c, d))


@njit(**COMPILED)
def compare_continued(n, work):  # type: ignore[no-untyped-def]
    """Do what `_tile.compare` does; a missing neighbour is continued from the other three."""
    most = f4(MAX_JUMP)
    for i in range(n):
        a, b, c, d = work[A + i], work[B + i], work[C + i], work[D + i]
        no_a, no_b, no_c, no_d = a != a, b != b, c != c, d != d
        origin = b if no_a else a
        a, b, c, d = wrap(a - origin), wrap(b - origin), wrap(c - origin), wrap(d - origin)
        a = b + c - d if no_a else a
        b = a + d - c if no_b else b
        c = a + d - b if no_c else c
        d = b + c - a if no_d else d
        fx, fy = work[FX + i], work[FY + i]
        both = d - c - (b - a)
        gx, gy = (b - a) + both * fy, (c - a) + both * fx
        value = a + (b - a) * fx + gy * fy
        spread = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d))
        value += ZERO if spread <= most else NAN
        work[R + i] = wrap(origin + value - work[PHI + i])
        work[GX + i], work[GY + i] = gx, gy


@njit(**COMPILED, inline="always")
def _demanded(i, phase, first, work):  # type: ignore[no-untyped-def]
    """Return the number of the order that a neighbour at the place must have, from the first."""
    turns = (work[PHI + i] + work[R + i] - work[phase + i]) * PER_TURN
    return work[ORDER + i] - first + np.floor(turns + HALF_PX)


@njit(**COMPILED, inline="always")
def _has_class(i, phase, order, names, first, work):  # type: ignore[no-untyped-def]
    index = _demanded(i, phase, first, work)
    there = (index >= ZERO) & (index <= f4(len(names) - 1))
    return there and names[int(index) if there else 0] == work[order + i]


@njit(**COMPILED)
def refute_foreign(n, names, first, coded, work):  # type: ignore[no-untyped-def]
    """Forget the phases where no neighbour has the class that the phase there demands of it.

    names: class of each order, float32, from the `first`; coded: whether there are several.
    """
    most = f4(len(names) - 1)
    if coded:
        for i in range(n):
            fits = _has_class(i, A, ORDER_A, names, first, work)
            fits = fits or _has_class(i, B, ORDER_B, names, first, work)
            fits = fits or _has_class(i, C, ORDER_C, names, first, work)
            fits = fits or _has_class(i, D, ORDER_D, names, first, work)
            work[R + i] += ZERO if fits else NAN
        return
    for i in range(n):
        a, b = _demanded(i, A, first, work), _demanded(i, B, first, work)
        c, d = _demanded(i, C, first, work), _demanded(i, D, first, work)
        fits = (a >= ZERO) & (a <= most) | (b >= ZERO) & (b <= most)  # NaN fits nowhere
        fits |= (c >= ZERO) & (c <= most) | (d >= ZERO) & (d <= most)
        work[R + i] += ZERO if fits else NAN


@njit(**COMPILED)
def look(n, where, exact, period, second, rays, devices, cell, work):  # type: ignore[no-untyped-def]
    """Write what C2 shows of the orders in the scratch: residual, gradient, noise; NaN where it
    sees nothing, or another class. exact: whether some have no curve; second: of `weigh_listed`."""
    phase2, sigma2, class2, shape, names, first_order, coded = second
    for i in range(n):
        work[W + i] = (work[ORDER + i] + work[PHI + i] * PER_TURN) * period
    follow_curves(n, work)
    if exact:
        follow_exactly(n, where, rays, devices, work)
    find_cells(n, work, X, Y, shape, cell, work)
    fetch(n, phase2, cell, shape[1], work)
    fetch_orders(n, sigma2, cell, shape[1], work)
    find_known_noise(n, work)
    compare_continued(n, work)
    if coded:
        fetch_orders(n, class2, cell, shape[1], work)
    refute_foreign(n, names, first_order, coded, work)
    for i in range(n):
        ratio = (work[GX + i] * work[DX + i] + work[GY + i] * work[DY + i]) * period * PER_TURN
        own = (ratio - ONE) * work[NOISE + i]
        variance = work[NOISE_2 + i] * work[NOISE_2 + i] + own * own
        work[VARIANCE + i] = variance * (PER_TURN * PER_TURN) + MODEL_VARIANCE
        work[RATIO + i] = ratio


@njit(**COMPILED)
def judge(n, depth, scatter, most_variance, work):  # type: ignore[no-untyped-def]
    """Write the squared deviations of the orders in the scratch over their variance; NaN where C2
    sees nothing, or is not certain enough.

    depth = (middle, 1 / scale) of the bias; scatter: px**2.
    """
    t0, per_t = depth
    for i in range(n):
        t = (work[T + i] - t0) * per_t
        gx, gy = work[GX + i] * PER_TURN, work[GY + i] * PER_TURN
        moved_x = work[STILL_X + i] + work[RISE_X + i] * t
        moved_y = work[STILL_Y + i] + work[RISE_Y + i] * t
        residual = work[R + i] * PER_TURN - (gx * moved_x + gy * moved_y)
        residual -= np.rint(residual)
        missed = scatter + work[LEVEL + i] + t * (work[PER_T + i] + t * work[PER_T2 + i])
        variance = work[VARIANCE + i] + (gx * gx + gy * gy) * missed
        work[COST + i] = residual * residual / variance if variance < most_variance else NAN


@njit(**COMPILED)
def count_cost(n, largest, hidden, work):  # type: ignore[no-untyped-def]
    """Write these costs in parts of `UNIT`; `FAR` where there is no order. largest, hidden: half
    squared deviations."""
    for i in range(n):
        cost = work[COST + i]
        cost = min(cost * HALF_PX, largest) if cost >= ZERO else hidden
        work[COST + i] = np.floor(cost * UNIT_F + HALF_PX) if work[T + i] > ZERO else FAR_F


@njit(cache=True, nogil=True, error_model="numpy")
def weigh_listed(where, first, ranges, second, tables, devices, field, limits, own, tiles):  # type: ignore[no-untyped-def]
    """Write what C2 has against each order of each pixel's class, (n, padded(m)), in parts of
    `_aggregate.UNIT`; `FAR` for none.

    where, first: as `load_listed` takes them; ranges = (lowest and highest order (n, 2), their
    distance in the columns); second = (phase, sigma, class of
    orders (pixel,) of C2, its shape, class of each order, float32, first order, whether there are
    several classes); tables = (curves (row, N_CURVE, col), period, (rays (pixel, 3), rotations from
    the world to projector and C2)); devices = (projector, camera2) as `_curves.trace` takes them;
    field = ((middle, 1 / scale (3,) each, scatter, px), polynomials (7, 5, 5): displacement in x
    and y, their rise with the depth, and the terms 1, t, t**2 of its variance) of the bias;
    limits = (largest variance that judges, turns**2, largest cost, price of what C2 does not see,
    half squared deviations); all numbers float32. tiles: first and last but one, of TILE pixels.
    """
    found, label_step = ranges
    curves, period, rays = tables
    frame, polynomials = field
    n_cols, flat, depth = curves.shape[2], curves.reshape(-1), (frame[2], frame[5])
    work, starts, cell = np.zeros(N_ALL, f4), np.empty(TILE, np.int64), np.empty(TILE, i4)
    for left in range(tiles[0] * TILE, min(tiles[1] * TILE, len(where)), TILE):
        tile = slice(left, min(left + TILE, len(where)))
        n, here = tile.stop - tile.start, where[tile]
        own[tile] = FAR
        most = 0
        for i in range(n):
            work[LOWEST + i], work[HIGHEST + i] = f4(found[left + i, 0]), f4(found[left + i, 1])
            most = max(most, (found[left + i, 1] - found[left + i, 0]) // label_step + 1)
        if most <= 0:
            continue
        exact = load_listed(n, here, (first[0][tile], first[1][tile]), flat, n_cols, starts, work)
        load_field(n, frame, polynomials, work)
        for place in range(most):
            for i in range(n):
                order = work[LOWEST + i] + f4(place * label_step)
                work[ORDER + i] = order if order <= work[HIGHEST + i] else NAN
            look(n, here, exact, period, second, rays, devices, cell, work)
            judge(n, depth, frame[6] * frame[6], limits[0], work)
            count_cost(n, limits[1], limits[2], work)
            for i in range(n):
                own[left + i, place] = U16(work[COST + i])


@njit(cache=True, nogil=True, error_model="numpy")
def show_listed(where, first, orders, second, tables, devices, field, most, maps, tiles):  # type: ignore[no-untyped-def]
    """Write what C2 shows of one order of each pixel, and what it has against it.

    orders (n,); most: largest variance that judges, turns**2; maps = (shown (n, N_SHOWN), as in
    `_orders`, squared deviations (n,)), NaN where there is none; the rest as `weigh_listed` takes
    it.
    """
    curves, period, rays = tables
    frame, polynomials = field
    shown, cost = maps
    n_cols, flat, depth = curves.shape[2], curves.reshape(-1), (frame[2], frame[5])
    work, starts, cell = np.zeros(N_ALL, f4), np.empty(TILE, np.int64), np.empty(TILE, i4)
    for left in range(tiles[0] * TILE, min(tiles[1] * TILE, len(where)), TILE):
        tile = slice(left, min(left + TILE, len(where)))
        n, here = tile.stop - tile.start, where[tile]
        exact = load_listed(n, here, (first[0][tile], first[1][tile]), flat, n_cols, starts, work)
        load_field(n, frame, polynomials, work)
        for i in range(n):
            work[ORDER + i] = f4(orders[left + i]) if orders[left + i] != NO_ORDER else NAN
        look(n, here, exact, period, second, rays, devices, cell, work)
        judge(n, depth, frame[6] * frame[6], most, work)
        for i in range(n):
            there = work[T + i] > ZERO
            nothing = ZERO if there & (work[R + i] == work[R + i]) else NAN
            shown[left + i, DEPTH] = work[T + i] if there else NAN
            shown[left + i, DIFFERENCE] = work[R + i] * PER_TURN + nothing
            shown[left + i, GRADIENT_X] = work[GX + i] * PER_TURN + nothing
            shown[left + i, GRADIENT_Y] = work[GY + i] * PER_TURN + nothing
            shown[left + i, SHOWN_VARIANCE] = work[VARIANCE + i] + nothing
            shown[left + i, SHOWN_RATIO] = work[RATIO + i] + nothing
            cost[left + i] = work[COST + i] + nothing
