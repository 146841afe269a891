"""Local parabolas through a phase map, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

f4 = np.float32
TERMS = 6
TWO_PI = 2 * math.pi


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return an angle within (-pi, pi], rad."""
    return angle - TWO_PI * math.floor(angle / TWO_PI + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def solved(normal, right, answer):  # type: ignore[no-untyped-def]
    """Solve a positive system in place (Cholesky); return whether it could be."""
    for i in range(TERMS):
        for j in range(i + 1):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            if i == j:
                if not total > 1e-7:
                    return False
                normal[i, i] = math.sqrt(total)
            else:
                normal[i, j] = total / normal[j, j]
    for i in range(TERMS):
        total = right[i]
        for k in range(i):
            total -= normal[i, k] * answer[k]
        answer[i] = total / normal[i, i]
    for i in range(TERMS - 1, -1, -1):
        total = answer[i]
        for k in range(i + 1, TERMS):
            total -= normal[k, i] * answer[k]
        answer[i] = total / normal[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def slope(phase, row, col, down, right):  # type: ignore[no-untyped-def]
    """Return the mean of the wrapped differences to two opposite neighbours, 0 without, rad/px."""
    total, n = 0.0, 0
    for sign in (-1, 1):
        i, j = row + sign * down, col + sign * right
        if 0 <= i < phase.shape[0] and 0 <= j < phase.shape[1]:
            rise = wrapped(phase[i, j] - phase[row, col])
            if not math.isnan(rise):
                total, n = total + sign * rise, n + 1
    return total / max(n, 1)


@njit(cache=True, error_model="numpy")
def first_variance(lower, work):  # type: ignore[no-untyped-def]
    """Return the first number on the diagonal of the inverse of L L^T, as `solved` leaves L."""
    variance = 0.0
    for i in range(TERMS):
        total = 1.0 if i == 0 else 0.0
        for k in range(i):
            total -= lower[i, k] * work[k]
        work[i] = total / lower[i, i]
        variance += work[i] * work[i]
    return variance


@njit(cache=True, nogil=True, error_model="numpy")
def smooth(phase, sigma, radii, gate, least, filtered, sigma_filtered, rows):  # type: ignore[no-untyped-def]
    """Write the value of a parabola through the neighbours of each pixel, (row, col) rad.

    phase, sigma (row, col): rad, NaN where unknown; radii (m,): px, of the discs that are fitted
    one after the other, each about the parabola before; gate = (standard deviations of the pixel,
    rad): neighbours that lie farther from the parabola belong to another surface; least: neighbours
    that are needed; rows = (first, last but one). Where they are too few, or nothing is won, the
    pixel stays as it is.
    """
    n_rows, n_cols = phase.shape
    normal, right = np.empty((TERMS, TERMS)), np.empty(TERMS)
    value, weight, term = np.empty(TERMS), np.empty(TERMS), np.empty(TERMS)
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            here, noise = phase[row, col], sigma[row, col]
            filtered[row, col], sigma_filtered[row, col] = here, noise
            if math.isnan(here):
                continue
            limit = gate[0] * noise + gate[1]
            value[:] = 0.0
            value[1] = slope(phase, row, col, 0, 1)
            value[2] = slope(phase, row, col, 1, 0)
            good = True
            for step in range(len(radii)):
                radius = radii[step]
                normal[:], right[:], n = 0.0, 0.0, 0
                scale = 1.0 / radius
                wide = 2.0 * limit if step == 0 else limit
                for i in range(max(row - radius, 0), min(row + radius + 1, n_rows)):
                    y = i - row
                    for j in range(max(col - radius, 0), min(col + radius + 1, n_cols)):
                        x = j - col
                        if x * x + y * y > radius * (radius + 1):
                            continue
                        known = (
                            value[0] + value[1] * x + value[2] * y
                            + value[3] * x * x + value[4] * x * y + value[5] * y * y
                        )  # fmt: skip
                        rest = wrapped(phase[i, j] - here - known)
                        if not abs(rest) <= wide:  # nor NaN
                            continue
                        n += 1
                        u, v = x * scale, y * scale
                        term[0], term[1], term[2] = 1.0, u, v
                        term[3], term[4], term[5] = u * u, u * v, v * v
                        for a in range(TERMS):
                            right[a] += term[a] * rest
                            for b in range(a + 1):
                                normal[a, b] += term[a] * term[b]
                good = n >= least and solved(normal, right, weight)
                if not good:
                    break
                value[0] += weight[0]
                value[1] += weight[1] * scale
                value[2] += weight[2] * scale
                value[3] += weight[3] * scale * scale
                value[4] += weight[4] * scale * scale
                value[5] += weight[5] * scale * scale
            if not good or abs(value[0]) > limit:
                continue
            variance = first_variance(normal, right)
            if variance < 1.0:
                filtered[row, col] = here + f4(value[0])
                sigma_filtered[row, col] = noise * math.sqrt(variance)
