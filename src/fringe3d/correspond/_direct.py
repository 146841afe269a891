"""Points of pixels whose fringe order is known, a part of a row at a time, compiled.

What most pixels need: the place in C2 that the order's light sheet demands, a few steps to where
the phase is that of C1, the last one on the exact curve, and the point. All numbers of a tile lie
in one scratch, whose parts the compiler sees apart: inner loops over the pixels, without a branch,
become vector instructions; what they read from maps is fetched beforehand. Pixels that need more
(holes, edges, several crossings) are left to `_single.confirm` and `_near.search_near`, which say
the same one pixel at a time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringe3d.correspond import _curves
from fringe3d.correspond._orders import MODEL_ERROR
from fringe3d.correspond._phase import INTERPOLATION_WEIGHT, MAX_JUMP
from fringe3d.geometry._lens import project_normalized
from fringe3d.model import Rejection

f4, i4, u4, u2 = np.float32, np.int32, np.uint32, np.uint16

TILE = 256
"""Pixels at once: their scratch stays in the processor's first two caches."""

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

# Parts of the scratch of a tile, float32, at distances that are no multiple of 4 KiB; see
# `decode._fused`. PHI to NOISE: C1; A to D: what is fetched from C2.
PART = TILE + 16
CURVE = 0
PHI, ORDER, NOISE, W, START, GUARD, NEAR, FAR = range(16 * PART, 24 * PART, PART)
LOW, HIGH, INNER_LOW, INNER_HIGH, T, X, Y, DT, DX, DY = range(24 * PART, 34 * PART, PART)
FX, FY, A, B, C, D, R, GX, GY, NOISE_2 = range(34 * PART, 44 * PART, PART)
HALF, LEFT, RIGHT, WAY_X, WAY_Y, SLOPE, HARD, REASON = range(44 * PART, 52 * PART, PART)
SIGMA, SIGMA_PX, NOTHING = range(52 * PART, 55 * PART, PART)
ORDER_A, ORDER_B, ORDER_C, ORDER_D = range(55 * PART, 59 * PART, PART)
N_WORK = 59 * PART
AT_X, AT_Y, AT_T, RAY_X, RAY_Y, RAY_Z = range(0, 6 * PART, PART)
"""The same in double precision."""

N_PLACES = 6 * PART

ZERO, HALF_PX, ONE, NAN = f4(0), f4(0.5), f4(1), f4(np.nan)
TURN, PER_TURN = f4(2 * np.pi), f4(1 / (2 * np.pi))
MODEL_VARIANCE = f4(MODEL_ERROR**2)
WEIGHT = f4(INTERPOLATION_WEIGHT)
OUTSIDE_VOLUME, NO_MATCH = f4(Rejection.OUTSIDE_VOLUME), f4(Rejection.NO_MATCH)

COMPILED: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "_nrt": False,
}  # fmt: skip


@njit(**COMPILED, inline="always")
def _wrap(angle):  # type: ignore[no-untyped-def]
    return angle - TURN * np.rint(angle * PER_TURN)


@njit(**COMPILED)
def _put(values, work, part):  # type: ignore[no-untyped-def]
    for i in range(len(values)):
        work[part + i] = values[i]


@njit(**COMPILED)
def load(n, first, spans, work):  # type: ignore[no-untyped-def]
    """Bring what is known of the pixels of a tile into the scratch."""
    phase, order, sigma = first
    ends, wide, inner = spans
    for i in range(n):
        work[PHI + i] = phase[i]
    for i in range(n):
        work[ORDER + i] = order[i]
    for i in range(n):
        work[NOISE + i] = sigma[i]
    for i in range(n):
        work[NEAR + i], work[FAR + i] = ends[i, 0], ends[i, 1]
    for i in range(n):
        work[LOW + i], work[HIGH + i] = wide[i, 0], wide[i, 1]
    for i in range(n):
        work[INNER_LOW + i], work[INNER_HIGH + i] = inner[i, 0], inner[i, 1]


@njit(**COMPILED)
def load_rays(n, curve, ray, work, place):  # type: ignore[no-untyped-def]
    """Bring the curves of the pixels of a tile and their rays into the scratch."""
    for k in range(_curves.N_CURVE):
        for i in range(n):
            work[CURVE + k * PART + i] = curve[k, i]
    for i in range(n):
        place[RAY_X + i], place[RAY_Y + i], place[RAY_Z + i] = ray[i, 0], ray[i, 1], ray[i, 2]


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


@njit(**COMPILED)
def follow_curves(n, work):  # type: ignore[no-untyped-def]
    """Write depth and pixel of C2 of the points with these w, and their slopes over w."""
    for i in range(n):
        per_w = work[_curves.PER_W * PART + i]
        s = (work[W + i] - work[_curves.START * PART + i]) * per_w
        bend = work[_curves.DEPTH_BEND * PART + i]
        part = ONE / (ONE - s + bend * s)
        u, du = bend * s * part, bend * part * part * per_w
        rise, a = work[_curves.DEPTH_RISE * PART + i], work[_curves.DEPTH_A * PART + i]
        b = work[_curves.DEPTH_B * PART + i]
        work[T + i] = work[_curves.DEPTH_0 * PART + i] + u * (rise + (ONE - u) * (a + b * u))
        work[DT + i] = du * (rise + a * (ONE - u - u) + b * u * (ONE + ONE - u - u - u))
        bend = work[_curves.BEND * PART + i]
        part = ONE / (ONE - s + bend * s)
        u, du = bend * s * part, bend * part * part * per_w
        one, two = ONE - u - u, u * (ONE + ONE - u - u - u)
        rise, a = work[_curves.X_RISE * PART + i], work[_curves.X_A * PART + i]
        b = work[_curves.X_B * PART + i]
        work[X + i] = work[_curves.X_0 * PART + i] + u * (rise + (ONE - u) * (a + b * u))
        work[DX + i] = du * (rise + a * one + b * two)
        rise, a = work[_curves.Y_RISE * PART + i], work[_curves.Y_A * PART + i]
        b = work[_curves.Y_B * PART + i]
        work[Y + i] = work[_curves.Y_0 * PART + i] + u * (rise + (ONE - u) * (a + b * u))
        work[DY + i] = du * (rise + a * one + b * two)


@njit(**COMPILED)
def find_cells(n, numbers, at_x, at_y, shape, cell, work):  # type: ignore[no-untyped-def]
    """Write the number of the pixel of C2 left above each place, and the parts of a pixel beyond
    it; NaN outside. numbers[at_x:], numbers[at_y:]: the places."""
    right, bottom = numbers.dtype.type(shape[1] - 1), numbers.dtype.type(shape[0] - 1)
    zero, n_cols = numbers.dtype.type(0), i4(shape[1])
    for i in range(n):
        x, y = numbers[at_x + i], numbers[at_y + i]
        inside = (x >= zero) & (x < right) & (y >= zero) & (y < bottom)
        x, y = x if inside else zero, y if inside else zero
        col, row = np.floor(x), np.floor(y)
        cell[i] = i4(row) * n_cols + i4(col)
        work[FX + i] = f4(x - col) if inside else NAN
        work[FY + i] = f4(y - row)


@njit(**COMPILED)
def fetch(n, image, cell, n_cols, work):  # type: ignore[no-untyped-def]
    """Fetch the four neighbours of each place."""
    for i in range(n):
        k = np.int64(cell[i])
        work[A + i], work[B + i] = image[k], image[k + 1]
        work[C + i], work[D + i] = image[k + n_cols], image[k + n_cols + 1]


@njit(**COMPILED)
def compare(n, work):  # type: ignore[no-untyped-def]
    """Write the phase of C2 less that of C1, rad, and its gradient, from what is fetched; NaN where
    one of the four neighbours is missing, or next to a jump. See `_phase.phase_difference`."""
    most = f4(MAX_JUMP)
    for i in range(n):
        a = work[A + i]
        b, c, d = _wrap(work[B + i] - a), _wrap(work[C + i] - a), _wrap(work[D + i] - a)
        both = d - b - c
        fx, fy = work[FX + i], work[FY + i]
        value = b * fx + (c + both * fx) * fy
        spread = max(max(ZERO, b), max(c, d)) - min(min(ZERO, b), min(c, d))
        value += ZERO if spread <= most else NAN
        work[R + i] = _wrap(a + value - work[PHI + i])
        work[GX + i], work[GY + i] = b + both * fy, c + both * fx


@njit(**COMPILED)
def find_noise(n, work):  # type: ignore[no-untyped-def]
    """Write the largest standard deviation of the four neighbours that are fetched."""
    for i in range(n):
        most = max(max(work[A + i], work[B + i]), max(work[C + i], work[D + i]))
        work[NOISE_2 + i] = most


@njit(**COMPILED)
def fetch_orders(n, order2, cell, n_cols, work):  # type: ignore[no-untyped-def]
    """Fetch the orders of the four neighbours of each place."""
    for i in range(n):
        k = np.int64(cell[i])
        work[ORDER_A + i], work[ORDER_B + i] = order2[k], order2[k + 1]
        work[ORDER_C + i], work[ORDER_D + i] = order2[k + n_cols], order2[k + n_cols + 1]


@njit(**COMPILED, inline="always")
def _has_order(i, phase, order, work):  # type: ignore[no-untyped-def]
    """Tell whether a neighbour has the order that the phase at the place demands of it."""
    turns = np.floor((work[PHI + i] + work[R + i] - work[phase + i]) * PER_TURN + HALF_PX)
    return work[order + i] == work[ORDER + i] + turns


@njit(**COMPILED)
def judge(n, row, left, period, field, limits, work):  # type: ignore[no-untyped-def]
    """Write how far around its sheet C2 sees a point, and reasons of those that it refutes.

    What `_single.confirm` does, but for places with a hole beside them. field (24,) = middle,
    1 / scale and coefficients of the bias; limits (6,) = its scatter, px, largest squared deviation
    and variance that judges, search in C2, turns, least and most, least ratio.
    """
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
        same = _has_order(i, A, ORDER_A, work) | _has_order(i, B, ORDER_B, work)
        same |= _has_order(i, C, ORDER_C, work) | _has_order(i, D, ORDER_D, work)
        u = (f4(left + i) - x0) * xx
        s = (work[T + i] - t0) * tx
        moved_x = x_0 + u * (x_1 + c3 * u) + (rise_x + c7 * u) * s
        moved_y = y_0 + u * (y_1 + d3 * u) + (rise_y + d7 * u) * s
        gx, gy = work[GX + i] * PER_TURN, work[GY + i] * PER_TURN
        difference = work[R + i] * PER_TURN
        residual = difference - (gx * moved_x + gy * moved_y)
        residual -= np.rint(residual)
        ratio = (gx * work[DX + i] + gy * work[DY + i]) * period
        own = (ratio - ONE) * work[NOISE + i]
        variance = (work[NOISE_2 + i] * work[NOISE_2 + i] + own * own) * (PER_TURN * PER_TURN)
        variance += MODEL_VARIANCE + (gx * gx + gy * gy) * (scatter * scatter)
        refuted = (variance < most_variance) & (residual * residual > most_cost * variance)
        hard = not (variance + abs(residual) < f4(1e9))  # what is not a number has a hole beside it
        beyond = (work[X + i] == work[X + i]) & (not work[FX + i] >= ZERO)
        refuted = beyond | ((not hard) & (refuted | (not same)))
        hard &= not beyond
        reach = abs(difference) + f4(4) * np.sqrt(variance)
        reach = min(max(reach, least_search), most_search) / max(abs(ratio), least_ratio)
        work[HALF + i] = min(reach, HALF_PX) * period
        low, high = work[INNER_LOW + i] - work[GUARD + i], work[INNER_HIGH + i] + work[GUARD + i]
        is_inside = (work[W + i] >= low) & (work[W + i] <= high)
        reason = NO_MATCH if refuted else ZERO if is_inside else OUTSIDE_VOLUME
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
        rise = _wrap(work[A + i] - work[PHI + i]) * (work[SLOPE + i] * step) + work[B + i]
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
