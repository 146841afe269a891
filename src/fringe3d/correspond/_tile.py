"""A part of a row of pixels at a time, compiled: where C2 sees their points, and what it shows.

All numbers of a tile lie in one scratch, whose parts the compiler sees apart: inner loops over the
pixels, without a branch, become vector instructions; what they read from maps is fetched
beforehand.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringe3d.correspond import _curves
from fringe3d.correspond._orders import MODEL_ERROR
from fringe3d.correspond._phase import MAX_JUMP

f4, i4 = np.float32, np.int32

TILE = 256
"""Pixels at once: their scratch stays in the processor's first two caches."""

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

COMPILED: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "_nrt": False,
}  # fmt: skip


@njit(**COMPILED, inline="always")
def wrap(angle):  # type: ignore[no-untyped-def]
    """Return an angle, rad, as -pi to pi."""
    return angle - TURN * np.rint(angle * PER_TURN)


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
        b, c, d = wrap(work[B + i] - a), wrap(work[C + i] - a), wrap(work[D + i] - a)
        both = d - b - c
        fx, fy = work[FX + i], work[FY + i]
        value = b * fx + (c + both * fx) * fy
        spread = max(max(ZERO, b), max(c, d)) - min(min(ZERO, b), min(c, d))
        value += ZERO if spread <= most else NAN
        work[R + i] = wrap(a + value - work[PHI + i])
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
def along_row(row, field):  # type: ignore[no-untyped-def]
    """Return what a row makes of the bias: terms of the displacement that are left, see `expect`.

    field (24,) = middle, 1 / scale and coefficients of the bias.
    """
    x0, y0, t0, xx, yx, tx = field[0], field[1], field[2], field[3], field[4], field[5]
    c, d = 6, 15  # where the coefficients in x and y begin
    v = (f4(row) - y0) * yx
    x_0, x_1 = field[c] + v * (field[c + 2] + field[c + 5] * v), field[c + 1] + field[c + 4] * v
    y_0, y_1 = field[d] + v * (field[d + 2] + field[d + 5] * v), field[d + 1] + field[d + 4] * v
    rise_x, rise_y = field[c + 6] + field[c + 8] * v, field[d + 6] + field[d + 8] * v
    in_x = x_0, x_1, field[c + 3], rise_x, field[c + 7]
    in_y = y_0, y_1, field[d + 3], rise_y, field[d + 7]
    return x0, xx, t0, tx, in_x, in_y


@njit(**COMPILED, inline="always")
def expect(i, left, period, terms, scatter, work):  # type: ignore[no-untyped-def]
    """Return the residual at a place in C2, turns, what the bias lets expect of it, its variance
    and the part that the bias leaves unknown, turns**2; and the phase of C2 over that of the
    projector along the ray. terms: of `along_row`; scatter: px."""
    x0, xx, t0, tx, in_x, in_y = terms
    x_0, x_1, x_2, rise_x, rise_xu = in_x
    y_0, y_1, y_2, rise_y, rise_yu = in_y
    u, s = (f4(left + i) - x0) * xx, (work[T + i] - t0) * tx
    moved_x = x_0 + u * (x_1 + x_2 * u) + (rise_x + rise_xu * u) * s
    moved_y = y_0 + u * (y_1 + y_2 * u) + (rise_y + rise_yu * u) * s
    gx, gy = work[GX + i] * PER_TURN, work[GY + i] * PER_TURN
    expected = gx * moved_x + gy * moved_y
    residual = work[R + i] * PER_TURN - expected
    residual -= np.rint(residual)
    ratio = (gx * work[DX + i] + gy * work[DY + i]) * period
    own = (ratio - ONE) * work[NOISE + i]
    unknown = (gx * gx + gy * gy) * (scatter * scatter)
    variance = (work[NOISE_2 + i] * work[NOISE_2 + i] + own * own) * (PER_TURN * PER_TURN)
    return residual, expected, variance + (MODEL_VARIANCE + unknown), unknown, ratio


@njit(**COMPILED, inline="always")
def reach_of(i, variance, ratio, search, period, work):  # type: ignore[no-untyped-def]
    """Return how far around its sheet C2 sees a point, projector px; search: turns of C2, least and
    most, and the least ratio."""
    reach = abs(work[R + i] * PER_TURN) + f4(4) * np.sqrt(variance)
    reach = min(max(reach, search[0]), search[1]) / max(abs(ratio), search[2])
    return min(reach, HALF_PX) * period


@njit(**COMPILED, inline="always")
def is_in_volume(i, work):  # type: ignore[no-untyped-def]
    """Tell whether a light sheet meets its ray inside the volume."""
    low, high = work[INNER_LOW + i] - work[GUARD + i], work[INNER_HIGH + i] + work[GUARD + i]
    return (work[W + i] >= low) & (work[W + i] <= high)
