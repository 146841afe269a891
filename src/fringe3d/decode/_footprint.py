"""The phase at the centre of a pixel from what its area and the lens average, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TWO_PI = 2 * math.pi

REACH = 2
"""px; the phase around a pixel is looked at in 5 x 5 pixels."""

MOST_MISFIT_RAD = 0.03
"""Where the neighbours leave a parabola by more, there is an edge, and it tells nothing."""

N_FREE = 19.0
"""25 phases less the six numbers of a parabola."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return an angle within (-pi, pi], rad."""
    return angle - TWO_PI * math.floor(angle * (1 / TWO_PI) + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(phase, modulation, row, col, sums):  # type: ignore[no-untyped-def]
    """Write products of phase and modulation around a pixel with a parabola's orthogonal terms.

    sums (8,): of phase with x, y, x^2 - 2, y^2 - 2; what a parabola leaves of it, squared; of the
    modulation with 1, x, y. Returns False where the pixel lacks one of its neighbours.

    The phase is counted from that of the pixel, in steps of one pixel, which are unique: along the
    middle column, and from there along each row.
    """
    here = phase[row, col]
    s, sx, sy, sxy, sxx, syy, square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b, bx, by = 0.0, 0.0, 0.0
    for y in range(-REACH, REACH + 1):
        column = 0.0
        last = here
        for k in range(1, abs(y) + 1):
            value = phase[row + (k if y > 0 else -k), col]
            column += wrapped(value - last)
            last = value
        for side in (0, 1, -1):
            rise, before = column, last
            for k in range(1, (1 if side == 0 else REACH) + 1):
                x = side * k
                value = phase[row + y, col + x]
                if side != 0:
                    rise += wrapped(value - before)
                    before = value
                light = modulation[row + y, col + x]
                s += rise
                sx += x * rise
                sy += y * rise
                sxy += x * y * rise
                sxx += (x * x - 2) * rise
                syy += (y * y - 2) * rise
                square += rise * rise
                b += light
                bx += x * light
                by += y * light
    rest = square - s * s / 25 - (sx * sx + sy * sy) / 50 - sxy * sxy / 100
    rest -= (sxx * sxx + syy * syy) / 70
    sums[0], sums[1], sums[2], sums[3], sums[4] = sx, sy, sxx, syy, rest
    sums[5], sums[6], sums[7] = b, bx, by
    return not math.isnan(rest + b)


@njit(cache=True, nogil=True, error_model="numpy")
def _mixes(phase, row, col):  # type: ignore[no-untyped-def]
    """Return the steepest rise of the phase to a neighbour, rad / px, where one of the eight
    neighbours is missing, and 0 where none is."""
    n_rows, n_cols = phase.shape
    steepest, complete = 0.0, True
    for y in range(-1, 2):
        for x in range(-1, 2):
            if not (0 <= row + y < n_rows and 0 <= col + x < n_cols):
                continue
            rise = abs(wrapped(phase[row + y, col + x] - phase[row, col]))
            complete &= not math.isnan(rise)
            if rise > steepest and x * y == 0:
                steepest = rise
    return 0.0 if complete else steepest


@njit(cache=True, nogil=True, error_model="numpy")
def centre(phase, sigma, modulation, numbers, answer, sigma_answer, rows):  # type: ignore[no-untyped-def]
    """Write phases of pixel centres and their standard deviations.

    phase, sigma, modulation (row, col): rad, rad, DN; NaN where unknown; numbers = (footprint,
    interpolation, doubt, remainder, misfit, mixed, growth), see `footprint`; rows: first and last
    but one.
    """
    footprint, interpolation, doubt, remainder, misfit, mixed, growth = numbers
    n_rows, n_cols = phase.shape
    sums = np.empty(8)
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            here, noise = phase[row, col], sigma[row, col]
            answer[row, col], sigma_answer[row, col] = here, noise
            if math.isnan(here):
                continue
            inside = REACH <= row < n_rows - REACH and REACH <= col < n_cols - REACH
            if not inside or not _sums(phase, modulation, row, col, sums):
                sigma_answer[row, col] = math.hypot(noise, mixed * _mixes(phase, row, col))
                continue
            bend_x, bend_y = sums[2] / 35, sums[3] / 35
            shade = (sums[0] * sums[6] + sums[1] * sums[7]) / (2 * sums[5]) / 50
            excess = max(sums[4] / N_FREE - noise * noise, 0.0)
            fits = 1 / (1 + excess / (MOST_MISFIT_RAD * MOST_MISFIT_RAD))
            off = footprint * ((bend_x + bend_y) / 2 + shade)
            off_between = interpolation * (bend_x + bend_y)
            answer[row, col] = here - np.float32(fits * (off + off_between))
            variance = (doubt * off) ** 2 + remainder * (bend_x * bend_x + bend_y * bend_y)
            variance += misfit * excess
            sigma_answer[row, col] = math.sqrt(growth * noise * noise + variance)
