"""Points of pixels whose fringe order is known, a part of a row at a time, compiled.

What most pixels need: the place in C2 that the order's light sheet demands, a few steps to where
the phase is that of C1, the last one on the exact curve, and the point. Pixels that need more
(holes, edges, several crossings) are left to `_single.confirm` and `_near.search_near`, which say
the same one pixel at a time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from fringe3d.correspond._phase import INTERPOLATION_WEIGHT
from fringe3d.correspond._tile import (
    AT_T,
    AT_X,
    AT_Y,
    COMPILED,
    DT,
    DX,
    DY,
    FAR,
    FX,
    GUARD,
    GX,
    GY,
    HALF,
    HALF_PX,
    HARD,
    HIGH,
    LEFT,
    LOW,
    N_PLACES,
    N_WORK,
    NAN,
    NEAR,
    NOISE,
    NOISE_2,
    NOTHING,
    ONE,
    ORDER,
    ORDER_A,
    ORDER_B,
    ORDER_C,
    ORDER_D,
    PER_TURN,
    PHI,
    RAY_X,
    RAY_Y,
    RAY_Z,
    REASON,
    RIGHT,
    SIGMA,
    SIGMA_PX,
    SLOPE,
    START,
    TILE,
    WAY_X,
    WAY_Y,
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
    f4,
    fetch,
    fetch_orders,
    find_cells,
    find_noise,
    follow_curves,
    i4,
    is_in_volume,
    load,
    load_rays,
    reach_of,
    wrap,
)  # fmt: skip
from fringe3d.geometry._lens import project_normalized
from fringe3d.model import Rejection

u4, u2 = np.uint32, np.uint16

CURVE_STEPS = 2
"""Steps with the curve of the pixel, which is exact to a thousandth of a pixel, before the exact
one."""

MOST_LEFT_RAD = f4(0.02)
"""Phase that the last, linear step may leave to take: a twentieth of a pixel, within which its
error is a thousandth of the noise."""

LEAST_SLOPE = f4(1e-3)
"""rad / px; see `_near`."""

MOST_PIXELS = f4(8)
"""Of C2, on each side of a point, along which the phase may have to be looked at."""

MOST_PART_OF_DEPTH = f4(0.01)
"""Standard deviation of a point; what is less certain is judged by `triangulate`."""

WEIGHT = f4(INTERPOLATION_WEIGHT)
OUTSIDE_VOLUME, NO_MATCH = f4(Rejection.OUTSIDE_VOLUME), f4(Rejection.NO_MATCH)


@njit(**COMPILED)
def _put(values, work, part):  # type: ignore[no-untyped-def]
    for i in range(len(values)):
        work[part + i] = values[i]


@njit(**COMPILED)
def begin(n, period, guard, judges, work):  # type: ignore[no-untyped-def]
    """Write the light sheets, and reasons of pixels whose order lies nowhere on their ray."""
    per_rad, more = guard
    for i in range(n):
        w = (work[ORDER + i] + work[PHI + i] * PER_TURN) * period
        beyond = per_rad * work[NOISE + i] + more
        misses = not (work[NEAR + i] < work[FAR + i])
        on_ray = (w >= work[LOW + i] - beyond) & (w <= work[HIGH + i] + beyond) | (not judges)
        work[W + i], work[START + i], work[GUARD + i], work[HARD + i] = w, w, beyond, ZERO
        work[REASON + i] = OUTSIDE_VOLUME if misses else ZERO if on_ray else NO_MATCH


@njit(**COMPILED, inline="always")
def _has_order(i, phase, order, work):  # type: ignore[no-untyped-def]
    """Tell whether a neighbour has the order that the phase at the place demands of it."""
    turns = np.floor((work[PHI + i] + work[R + i] - work[phase + i]) * PER_TURN + HALF_PX)
    return work[order + i] == work[ORDER + i] + turns


@njit(**COMPILED)
def judge(n, row, left, period, field, limits, work):  # type: ignore[no-untyped-def]
    """Write how far around its sheet C2 sees a point, and reasons of those that it refutes.

    What `_single.confirm` does, but for places with a hole beside them. field: see
    `_tile.along_row`; limits (6,) = scatter of the bias, px, largest squared deviation and variance
    that judges, search in C2, turns, least and most, least ratio.
    """
    scatter, most_cost, most_variance = limits[0], limits[1], limits[2]
    search, terms = (limits[3], limits[4], limits[5]), along_row(row, field)
    for i in range(n):
        same = _has_order(i, A, ORDER_A, work) | _has_order(i, B, ORDER_B, work)
        same |= _has_order(i, C, ORDER_C, work) | _has_order(i, D, ORDER_D, work)
        residual, _, variance, _, ratio = expect(i, left, period, terms, scatter, work)
        refuted = (variance < most_variance) & (residual * residual > most_cost * variance)
        hard = not (variance + abs(residual) < f4(1e9))  # what is not a number has a hole beside it
        beyond = (work[X + i] == work[X + i]) & (not work[FX + i] >= ZERO)
        refuted = beyond | ((not hard) & (refuted | (not same)))
        hard &= not beyond
        work[HALF + i] = reach_of(i, variance, ratio, search, period, work)
        reason = NO_MATCH if refuted else ZERO if is_in_volume(i, work) else OUTSIDE_VOLUME
        reason = ZERO if hard else reason
        work[HARD + i] = ONE if hard else ZERO
        work[REASON + i] = work[REASON + i] if work[REASON + i] != ZERO else reason


@njit(**COMPILED)
def step(n, work):  # type: ignore[no-untyped-def]
    """Take a step along the curve to where the phase is that of C1."""
    for i in range(n):
        slope = work[GX + i] * work[DX + i] + work[GY + i] * work[DY + i]
        work[W + i] -= work[R + i] / slope


@njit(**COMPILED)
def on_exact_curve(n, camera2, work, place):  # type: ignore[no-untyped-def]
    """Write where C2 sees the points of the rays at their depths, with the lens itself."""
    x0, y0, z0, xx, xy, xz, yx, yy, yz, zx, zy, zz = camera2[:12]
    lens = camera2[12:]
    for i in range(n):
        t, a, b, c = work[T + i], place[RAY_X + i], place[RAY_Y + i], place[RAY_Z + i]
        x = x0 + t * (xx * a + xy * b + xz * c)
        y = y0 + t * (yx * a + yy * b + yz * c)
        z = z0 + t * (zx * a + zy * b + zz * c)
        z = z if z > 0.0 else np.nan
        place[AT_X + i], place[AT_Y + i] = project_normalized(x / z, y / z, lens)


@njit(**COMPILED)
def last_step(n, work, place):  # type: ignore[no-untyped-def]
    """Take the last step, and mark what it does not bring to the point."""
    for i in range(n):
        slope = work[GX + i] * work[DX + i] + work[GY + i] * work[DY + i]
        per_w = np.sqrt(work[DX + i] * work[DX + i] + work[DY + i] * work[DY + i])
        step = -work[R + i] / slope
        away, half = work[W + i] + step - work[START + i], work[HALF + i]
        near = (abs(work[R + i]) <= MOST_LEFT_RAD) & (abs(away) <= half)
        good = near & (abs(slope) > LEAST_SLOPE * per_w)
        work[HARD + i] += ZERO if good else ONE
        place[AT_X + i] += step * work[DX + i]
        place[AT_Y + i] += step * work[DY + i]
        place[AT_T + i] = np.float64(work[T + i]) + np.float64(step * work[DT + i])
        work[SLOPE + i] = slope
        work[WAY_X + i], work[WAY_Y + i] = work[DX + i] / per_w, work[DY + i] / per_w
        # Pixels to either end of the window, in the direction of rising w, and one beyond.
        work[LEFT + i] = np.floor((half + away) * per_w) + ONE
        work[RIGHT + i] = np.floor((half - away) * per_w) + ONE


@njit(**COMPILED)
def most_steps(n, rejection, work):  # type: ignore[no-untyped-def]
    """Return how many pixels beside its points are to be looked at; mark what is too far."""
    most = ZERO
    for i in range(n):
        work[A + i] = f4(rejection[i])
    for i in range(n):
        needed = max(work[LEFT + i], work[RIGHT + i])
        work[HARD + i] += ZERO if needed <= MOST_PIXELS else ONE
        is_easy = (work[HARD + i] + work[REASON + i] + work[A + i]) == ZERO
        most = max(most, needed if is_easy else ZERO)
    return int(most)


@njit(**COMPILED)
def look_beside(n, away, phase2, shape, cell, work, place):  # type: ignore[no-untyped-def]
    """Mark points where the phase so many pixels away lies on the wrong side of that of C1, as it
    does when it crosses it again; see `_near._is_only_one`."""
    n_rows, n_cols = i4(shape[0]), i4(shape[1])
    asked, step = RIGHT if away > 0 else LEFT, f4(away)
    for i in range(n):
        x = f4(place[AT_X + i]) + (work[WAY_X + i] * step + HALF_PX)
        y = f4(place[AT_Y + i]) + (work[WAY_Y + i] * step + HALF_PX)
        inside = (x >= ZERO) & (x < f4(n_cols)) & (y >= ZERO) & (y < f4(n_rows))
        x, y = x if inside else ZERO, y if inside else ZERO
        cell[i] = i4(y) * n_cols + i4(x)
        work[B + i] = ZERO if inside else NAN
    for i in range(n):
        work[A + i] = phase2[cell[i]]
    for i in range(n):
        rise = wrap(work[A + i] - work[PHI + i]) * (work[SLOPE + i] * step) + work[B + i]
        fine = (rise > ZERO) | (work[asked + i] < abs(step))
        work[HARD + i] += ZERO if fine else ONE


@njit(**COMPILED)
def finish(n, rejection, work, place):  # type: ignore[no-untyped-def]
    """Write uncertainties, reasons, and whether a point is found: `NOTHING` is NaN where not."""
    for i in range(n):
        work[A + i] = f4(rejection[i])
    for i in range(n):
        t = f4(place[AT_T + i])
        variance = work[NOISE + i] * work[NOISE + i]
        variance += WEIGHT * work[NOISE_2 + i] * work[NOISE_2 + i]
        noise = np.sqrt(variance) / abs(work[SLOPE + i])
        sigma = noise * abs(work[DT + i])
        fine = (t > work[NEAR + i]) & (t < work[FAR + i]) & (sigma < MOST_PART_OF_DEPTH * t)
        fine &= work[HARD + i] == ZERO
        reason = work[A + i] if work[A + i] != ZERO else work[REASON + i]
        nothing = ZERO if fine & (reason == ZERO) else NAN
        work[NOTHING + i], work[REASON + i] = nothing, reason
        per_w = np.sqrt(work[DX + i] * work[DX + i] + work[DY + i] * work[DY + i])
        work[SIGMA + i], work[SIGMA_PX + i] = sigma + nothing, noise * per_w + nothing


@njit(**COMPILED)
def store(n, origin, work, place, maps):  # type: ignore[no-untyped-def]
    """Write the points of a tile, its reasons, and what is left to do."""
    pixels, sigma_px, points, sigma_mm, skew, rejection, todo = maps
    x0, y0, z0 = origin
    for i in range(n):
        nothing = np.float64(work[NOTHING + i])
        pixels[i, 0], pixels[i, 1] = place[AT_X + i] + nothing, place[AT_Y + i] + nothing
    for i in range(n):
        t = place[AT_T + i] + np.float64(work[NOTHING + i])
        points[i, 0] = x0 + t * place[RAY_X + i]
        points[i, 1] = y0 + t * place[RAY_Y + i]
        points[i, 2] = z0 + t * place[RAY_Z + i]
    for i in range(n):
        sigma_px[i] = work[SIGMA_PX + i]
    for i in range(n):
        sigma_mm[i] = work[SIGMA + i]
    for i in range(n):
        skew[i] = work[NOTHING + i]
    for i in range(n):
        rejection[i] = u2(work[REASON + i])
    for i in range(n):
        todo[i] = (work[REASON + i] == ZERO) & (work[NOTHING + i] != ZERO)


@njit(**COMPILED)
def is_anything_left(n, rejection, work):  # type: ignore[no-untyped-def]
    """Tell whether any pixel of a tile has neither a reason nor had one before."""
    left = 0
    for i in range(n):
        left += (rejection[i] == 0) & (work[REASON + i] == ZERO)
    return left > 0


@njit(cache=True, nogil=True, error_model="numpy")
def locate(first, half, tables, origin, camera2, second, guard, field, limits, maps, rows):  # type: ignore[no-untyped-def]
    """Find the points of the pixels whose way to them is an easy one.

    first = (phase, order, sigma (row, col), period, px) of C1; half (row, col): px around the light
    sheet in which C2 sees the point, (0, 0): as C2 shows it, which then confirms the order, too;
    tables = (ends (row, col, 2), curves (row, N_CURVE, col), wide, inner (row, col, 2), rays (row,
    col, 3)), see `curves.RayCurves`; origin: of the rays; camera2: the same as C2 sees it, rotation
    from the world and lens, 37 numbers; second = (phase, sigma, order) of C2; guard = px for each
    rad of a phase's deviation, and px, by which a point may lie beyond; field, limits: see `judge`.
    maps = (pixels (row, col, 2), sigma_px, points (row, col, 3), sigma_mm, skew_mm, rejection, to
    which reasons are added, todo: pixels that are left, (row, col)); rows: first and last but one.
    """
    phase1, order1, sigma1, period = first
    ends, curves, wide, inner, rays = tables
    shape = second[0].shape
    phase2, sigma2, order2 = second[0].reshape(-1), second[1].reshape(-1), second[2].reshape(-1)
    pixels, sigma_px, points, sigma_mm, skew, rejection, todo = maps
    n_cols, judges = phase1.shape[1], half.shape[0] == 0
    work, place, cell = np.zeros(N_WORK, f4), np.zeros(N_PLACES), np.empty(TILE, i4)
    for row in range(rows[0], rows[1]):
        for left in range(0, n_cols, TILE):
            tile = slice(left, min(left + TILE, n_cols))
            n = tile.stop - tile.start
            own = (phase1[row, tile], order1[row, tile], sigma1[row, tile])
            spans = ends[row, tile], wide[row, tile], inner[row, tile]
            load(n, own, spans, work)
            begin(n, period, guard, judges, work)
            is_left = is_anything_left(n, rejection[row, tile], work)
            if is_left:
                load_rays(n, curves[row, :, tile], rays[row, tile], work, place)
                follow_curves(n, work)
                find_cells(n, work, X, Y, shape, cell, work)
                if judges:
                    fetch(n, sigma2, cell, shape[1], work)
                    find_noise(n, work)
                fetch(n, phase2, cell, shape[1], work)
                compare(n, work)
                if judges:
                    fetch_orders(n, order2, cell, shape[1], work)
                    judge(n, row, left, period, field, limits, work)
                    is_left = is_anything_left(n, rejection[row, tile], work)
                else:
                    _put(half[row, tile], work, HALF)
            if is_left:
                for _ in range(CURVE_STEPS - 1):
                    step(n, work)
                    follow_curves(n, work)
                    find_cells(n, work, X, Y, shape, cell, work)
                    fetch(n, phase2, cell, shape[1], work)
                    compare(n, work)
                step(n, work)
                follow_curves(n, work)
                on_exact_curve(n, camera2, work, place)
                find_cells(n, place, AT_X, AT_Y, shape, cell, work)
                fetch(n, sigma2, cell, shape[1], work)
                find_noise(n, work)
                fetch(n, phase2, cell, shape[1], work)
                compare(n, work)
                last_step(n, work, place)
                for away in range(1, most_steps(n, rejection[row, tile], work) + 1):
                    look_beside(n, away, phase2, shape, cell, work, place)
                    look_beside(n, -away, phase2, shape, cell, work, place)
            finish(n, rejection[row, tile], work, place)
            store(n, origin, work, place, (
                pixels[row, tile], sigma_px[row, tile], points[row, tile], sigma_mm[row, tile],
                skew[row, tile], rejection[row, tile], todo[row, tile],
            ))  # fmt: skip
