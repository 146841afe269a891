"""The phase at the centre of a pixel from what its area and the lens average, compiled.

A part of a row at a time, all its numbers in one scratch: see `correspond._tile`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

f4 = np.float32

REACH = 2
"""px; the phase around a pixel is looked at in 5 x 5 pixels."""

MOST_MISFIT_RAD = 0.03
"""Where the neighbours leave a parabola by more, there is an edge, and it tells nothing."""

N_FREE = 19.0
"""25 phases less the six numbers of a parabola."""

TILE = 256
PART = TILE + 2 * REACH + 12
"""A part of the scratch: at distances that are no multiple of 4 KiB; see `decode._fused`."""

PHASE = FAR_UP, UP, HERE, DOWN, FAR_DOWN = tuple(range(0, 5 * PART, PART))
LIGHT = LIGHT_FAR_UP, LIGHT_UP, LIGHT_HERE, LIGHT_DOWN, LIGHT_FAR_DOWN = tuple(
    range(5 * PART, 10 * PART, PART)
)
"""Of the five rows around that of the pixels, from the first to the last."""

NOISE, SUM, SUM_Y, SUM_YY, SQUARES, SUM_LIGHT, LIGHT_Y, ANSWER, SIGMA = range(
    10 * PART, 19 * PART, PART
)
N_WORK = 19 * PART

TURN, PER_TURN = f4(2 * math.pi), f4(1 / (2 * math.pi))
ZERO, ONE, TWO, FIVE, HALF = f4(0), f4(1), f4(2), f4(5), f4(0.5)
PER_FREE, PER_MISFIT = f4(1 / N_FREE), f4(1 / MOST_MISFIT_RAD**2)
PER_25, PER_35, PER_50, PER_70, PER_100 = f4(1 / 25), f4(1 / 35), f4(1 / 50), f4(1 / 70), f4(0.01)

COMPILED: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}, "_nrt": False,
}  # fmt: skip


@njit(**COMPILED, inline="always")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return an angle as -pi to pi, rad."""
    return angle - TURN * np.rint(angle * PER_TURN)


@njit(**COMPILED)
def _load(values, part, work):  # type: ignore[no-untyped-def]
    for i in range(len(values)):
        work[part + i] = values[i]


@njit(**COMPILED)
def _add_up_columns(n, work):  # type: ignore[no-untyped-def]
    """Write sums over the five rows of each column.

    Of the phase, counted from that of the middle row in steps of one pixel, which are unique: with
    1, y, y^2 - 2, and squared; of the modulation with 1 and y.
    """
    for i in range(n):
        up = wrapped(work[UP + i] - work[HERE + i])
        far_up = up + wrapped(work[FAR_UP + i] - work[UP + i])
        down = wrapped(work[DOWN + i] - work[HERE + i])
        far_down = down + wrapped(work[FAR_DOWN + i] - work[DOWN + i])
        work[SUM + i] = far_up + up + down + far_down
        work[SUM_Y + i] = TWO * (far_down - far_up) + down - up
        work[SUM_YY + i] = TWO * (far_up + far_down) - up - down
        work[SQUARES + i] = far_up * far_up + up * up + (down * down + far_down * far_down)
        light, light2 = work[LIGHT_UP + i], work[LIGHT_DOWN + i]
        far_light, far_light2 = work[LIGHT_FAR_UP + i], work[LIGHT_FAR_DOWN + i]
        work[SUM_LIGHT + i] = work[LIGHT_HERE + i] + (light + light2) + (far_light + far_light2)
        work[LIGHT_Y + i] = TWO * (far_light2 - far_light) + light2 - light


@njit(**COMPILED)
def _fit(n, numbers, work):  # type: ignore[no-untyped-def]
    """Write the answers for pixels that have all neighbours, from the sums of five columns each;
    NaN for others. Along the middle row the phase is counted in steps of one pixel, too."""
    footprint, interpolation, doubt, remainder, misfit, _, growth = numbers
    for i in range(n):
        here, noise = work[HERE + i + 2], work[NOISE + i]
        left = wrapped(work[HERE + i + 1] - here)
        far_left = left + wrapped(work[HERE + i] - work[HERE + i + 1])
        right = wrapped(work[HERE + i + 3] - here)
        far_right = right + wrapped(work[HERE + i + 4] - work[HERE + i + 3])
        p, q, r = work[SUM + i], work[SUM + i + 1], work[SUM + i + 2]
        t, u = work[SUM + i + 3], work[SUM + i + 4]
        a, b, d, e = p + FIVE * far_left, q + FIVE * left, t + FIVE * right, u + FIVE * far_right
        s, sx, sxx = a + b + r + d + e, TWO * (e - a) + d - b, TWO * (a - r + e) - b - d
        square = far_left * (p + a) + left * (q + b) + right * (t + d) + far_right * (u + e)
        square += work[SQUARES + i] + work[SQUARES + i + 1] + work[SQUARES + i + 2]
        square += work[SQUARES + i + 3] + work[SQUARES + i + 4]
        a, b, d, e = (
            work[SUM_Y + i], work[SUM_Y + i + 1], work[SUM_Y + i + 3], work[SUM_Y + i + 4]
        )  # fmt: skip
        sy, sxy = a + b + work[SUM_Y + i + 2] + d + e, TWO * (e - a) + d - b
        syy = work[SUM_YY + i] + work[SUM_YY + i + 1] + work[SUM_YY + i + 2]
        syy += work[SUM_YY + i + 3] + work[SUM_YY + i + 4]
        a, b, d, e = (
            work[SUM_LIGHT + i], work[SUM_LIGHT + i + 1],
            work[SUM_LIGHT + i + 3], work[SUM_LIGHT + i + 4],
        )  # fmt: skip
        light, light_x = a + b + work[SUM_LIGHT + i + 2] + d + e, TWO * (e - a) + d - b
        light_y = work[LIGHT_Y + i] + work[LIGHT_Y + i + 1] + work[LIGHT_Y + i + 2]
        light_y += work[LIGHT_Y + i + 3] + work[LIGHT_Y + i + 4]
        rest = square - s * s * PER_25 - (sx * sx + sy * sy) * PER_50 - sxy * sxy * PER_100
        rest -= (sxx * sxx + syy * syy) * PER_70
        bend_x, bend_y = sxx * PER_35, syy * PER_35
        shade = (sx * light_x + sy * light_y) / (TWO * light) * PER_50
        excess = rest * PER_FREE - noise * noise
        excess = excess if excess > ZERO else ZERO * excess  # NaN stays NaN
        fits = ONE / (ONE + excess * PER_MISFIT)
        off = footprint * ((bend_x + bend_y) * HALF + shade)
        work[ANSWER + i] = here - fits * (off + interpolation * (bend_x + bend_y))
        variance = (doubt * off) ** 2 + remainder * (bend_x * bend_x + bend_y * bend_y)
        work[SIGMA + i] = np.sqrt(growth * noise * noise + variance + misfit * excess)


@njit(cache=True, nogil=True, error_model="numpy")
def _mixes(phase, row, col):  # type: ignore[no-untyped-def]
    """Return the steepest rise of the phase to a neighbour, rad / px, where one of the eight
    neighbours is missing, and 0 where none is."""
    n_rows, n_cols = phase.shape
    steepest, complete = ZERO, True
    for y in range(-1, 2):
        for x in range(-1, 2):
            if not (0 <= row + y < n_rows and 0 <= col + x < n_cols):
                continue
            rise = abs(wrapped(phase[row + y, col + x] - phase[row, col]))
            complete &= not math.isnan(rise)
            if rise > steepest and x * y == 0:
                steepest = rise
    return ZERO if complete else steepest


@njit(cache=True, nogil=True, error_model="numpy")
def centre(phase, sigma, modulation, numbers, answer, sigma_answer, rows):  # type: ignore[no-untyped-def]
    """Write phases of pixel centres and their standard deviations.

    phase, sigma, modulation (row, col): rad, rad, DN; NaN where unknown; numbers = (footprint,
    interpolation, doubt, remainder, misfit, mixed, growth), float32, see `footprint`; rows: first
    and last but one.
    """
    n_rows, n_cols = phase.shape
    work, mixed = np.empty(N_WORK, f4), numbers[5]
    for row in range(rows[0], rows[1]):
        answer[row], sigma_answer[row] = np.nan, np.nan
        if REACH <= row < n_rows - REACH:
            for left in range(0, n_cols - 2 * REACH, TILE):
                n = min(TILE, n_cols - 2 * REACH - left)
                around, own = (
                    slice(left, left + n + 2 * REACH),
                    slice(left + REACH, left + REACH + n),
                )
                for k in range(2 * REACH + 1):
                    _load(phase[row + k - REACH, around], PHASE[k], work)
                    _load(modulation[row + k - REACH, around], LIGHT[k], work)
                _load(sigma[row, own], NOISE, work)
                _add_up_columns(n + 2 * REACH, work)
                _fit(n, numbers, work)
                answer[row, own], sigma_answer[row, own] = (
                    work[ANSWER : ANSWER + n], work[SIGMA : SIGMA + n]
                )  # fmt: skip
        for col in range(n_cols):
            if math.isnan(answer[row, col]) or math.isnan(sigma_answer[row, col]):
                answer[row, col], sigma_answer[row, col] = phase[row, col], sigma[row, col]
                if not math.isnan(phase[row, col]):
                    off = mixed * _mixes(phase, row, col)
                    sigma_answer[row, col] = math.hypot(sigma[row, col], off)
