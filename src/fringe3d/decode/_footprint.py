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
    return angle - TWO_PI * np.floor(angle * (1 / TWO_PI) + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_up_row(phase, modulation, row, line):  # type: ignore[no-untyped-def]
    """Write sums along five pixels of a row around each of its pixels, (6, col).

    Of the phase, counted from that of the pixel in the middle in steps of one pixel, which are
    unique: with 1, x, x^2 - 2, and squared; of the modulation with 1 and x.
    """
    for col in range(REACH, phase.shape[1] - REACH):
        left = wrapped(phase[row, col - 1] - phase[row, col])
        far_left = left + wrapped(phase[row, col - 2] - phase[row, col - 1])
        right = wrapped(phase[row, col + 1] - phase[row, col])
        far_right = right + wrapped(phase[row, col + 2] - phase[row, col + 1])
        line[0, col] = far_left + left + right + far_right
        line[1, col] = 2 * (far_right - far_left) + right - left
        line[2, col] = 2 * (far_left + far_right) - left - right
        square = far_left * far_left + left * left
        line[3, col] = square + right * right + far_right * far_right
        light, far_light = modulation[row, col - 1], modulation[row, col - 2]
        light2, far_light2 = modulation[row, col + 1], modulation[row, col + 2]
        line[4, col] = modulation[row, col] + (light + light2) + (far_light + far_light2)
        line[5, col] = 2 * (far_light2 - far_light) + light2 - light


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
def _centre_row(phase, sigma, row, lines, numbers, answer, sigma_answer):  # type: ignore[no-untyped-def]
    """Do what `centre` does for the pixels of one row that have all neighbours; NaN elsewhere.

    lines (6, col): what `_add_up_row` found for this row and two rows on both sides, from the first
    to the last. Along the middle column the phase is counted in steps of one pixel, too.
    """
    footprint, interpolation, doubt, remainder, misfit, _, growth = numbers
    p, q, r, t, u = lines
    for col in range(REACH, phase.shape[1] - REACH):
        here, noise = phase[row, col], sigma[row, col]
        up = wrapped(phase[row - 1, col] - here)
        far_up = up + wrapped(phase[row - 2, col] - phase[row - 1, col])
        down = wrapped(phase[row + 1, col] - here)
        far_down = down + wrapped(phase[row + 2, col] - phase[row + 1, col])
        a, b, c = p[0, col] + 5 * far_up, q[0, col] + 5 * up, r[0, col]
        d, e = t[0, col] + 5 * down, u[0, col] + 5 * far_down
        s, sy, syy = a + b + c + d + e, 2 * (e - a) + d - b, 2 * (a - c + e) - b - d
        sx = p[1, col] + q[1, col] + r[1, col] + t[1, col] + u[1, col]
        sxy = 2 * (u[1, col] - p[1, col]) + t[1, col] - q[1, col]
        sxx = p[2, col] + q[2, col] + r[2, col] + t[2, col] + u[2, col]
        square = p[3, col] + q[3, col] + r[3, col] + t[3, col] + u[3, col]
        square += far_up * (2 * p[0, col] + 5 * far_up) + up * (2 * q[0, col] + 5 * up)
        square += down * (2 * t[0, col] + 5 * down) + far_down * (2 * u[0, col] + 5 * far_down)
        light = p[4, col] + q[4, col] + r[4, col] + t[4, col] + u[4, col]
        light_x = p[5, col] + q[5, col] + r[5, col] + t[5, col] + u[5, col]
        light_y = 2 * (u[4, col] - p[4, col]) + t[4, col] - q[4, col]
        rest = square - s * s / 25 - (sx * sx + sy * sy) / 50 - sxy * sxy / 100
        rest -= (sxx * sxx + syy * syy) / 70
        bend_x, bend_y = sxx / 35, syy / 35
        shade = (sx * light_x + sy * light_y) / (2 * light) / 50
        excess = max(rest / N_FREE - noise * noise, 0.0) + 0 * rest  # NaN stays NaN
        fits = 1 / (1 + excess / (MOST_MISFIT_RAD * MOST_MISFIT_RAD))
        off = footprint * ((bend_x + bend_y) / 2 + shade)
        off_between = interpolation * (bend_x + bend_y)
        answer[row, col] = here - np.float32(fits * (off + off_between))
        variance = (doubt * off) ** 2 + remainder * (bend_x * bend_x + bend_y * bend_y)
        sigma_answer[row, col] = math.sqrt(growth * noise * noise + variance + misfit * excess)


@njit(cache=True, nogil=True, error_model="numpy")
def centre(phase, sigma, modulation, numbers, answer, sigma_answer, rows):  # type: ignore[no-untyped-def]
    """Write phases of pixel centres and their standard deviations.

    phase, sigma, modulation (row, col): rad, rad, DN; NaN where unknown; numbers = (footprint,
    interpolation, doubt, remainder, misfit, mixed, growth), see `footprint`; rows: first and last
    but one.
    """
    n_rows, n_cols = phase.shape
    n_around, mixed = 2 * REACH + 1, numbers[5]
    lines, known = np.empty((n_around, 6, n_cols)), max(rows[0] - REACH, 0)
    for row in range(rows[0], rows[1]):
        answer[row], sigma_answer[row] = np.nan, np.nan
        if REACH <= row < n_rows - REACH:
            for other in range(known, row + REACH + 1):
                _add_up_row(phase, modulation, other, lines[other % n_around])
            known = row + REACH + 1
            in_order = (
                lines[(row - 2) % n_around], lines[(row - 1) % n_around], lines[row % n_around],
                lines[(row + 1) % n_around], lines[(row + 2) % n_around],
            )  # fmt: skip
            _centre_row(phase, sigma, row, in_order, numbers, answer, sigma_answer)
        for col in range(n_cols):
            if math.isnan(answer[row, col]) or math.isnan(sigma_answer[row, col]):
                answer[row, col], sigma_answer[row, col] = phase[row, col], sigma[row, col]
                if not math.isnan(phase[row, col]):
                    off = mixed * _mixes(phase, row, col)
                    sigma_answer[row, col] = math.hypot(sigma[row, col], off)
