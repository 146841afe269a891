"""Noise of a phase between pixels, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._phase import INTERPOLATION_WEIGHT
from fringe3d.kernels import HELPER


@njit(**HELPER)
def interpolated(x, y, phase, sigma, alike):  # type: ignore[no-untyped-def]
    """Return the variance of the phase at a place, rad**2, as `phase_difference` interpolates it.

    alike: correlation of neighbours, of which `sigma` is counted as if they had none, on average
    over all places.
    """
    n_rows, n_cols = phase.shape
    row, col = min(int(y), n_rows - 2), min(int(x), n_cols - 2)
    fx, fy = x - col, y - row
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    a, b = sigma[row, col], sigma[row, col + 1]
    c, d = sigma[row + 1, col], sigma[row + 1, col + 1]
    # A missing one is continued from the other three.
    if math.isnan(phase[row, col]):
        wa, wb, wc, wd, a = 0.0, wb + wa, wc + wa, wd - wa, np.float32(0)
    elif math.isnan(phase[row, col + 1]):
        wa, wb, wc, wd, b = wa + wb, 0.0, wc - wb, wd + wb, np.float32(0)
    elif math.isnan(phase[row + 1, col]):
        wa, wb, wc, wd, c = wa + wc, wb - wc, 0.0, wd + wc, np.float32(0)
    elif math.isnan(phase[row + 1, col + 1]):
        wa, wb, wc, wd, d = wa - wd, wb + wd, wc + wd, 0.0, np.float32(0)
    apart = (wa * a) ** 2 + (wb * b) ** 2 + (wc * c) ** 2 + (wd * d) ** 2
    if alike == 0:
        return apart
    together = (wa * a + wb * b + wc * c + wd * d) ** 2
    counted = INTERPOLATION_WEIGHT / (alike + (1 - alike) * INTERPOLATION_WEIGHT)
    return counted * (alike * together + (1 - alike) * apart)


@njit(cache=True, nogil=True, error_model="numpy")
def between(pixels, phase, sigma, alike, variance, rows):  # type: ignore[no-untyped-def]
    """Write `interpolated` for places (n, 2), px; 0 where they are outside the map."""
    n_rows, n_cols = phase.shape
    for i in range(rows[0], rows[1]):
        x, y = pixels[i, 0], pixels[i, 1]
        inside = 0 <= x <= n_cols - 1 and 0 <= y <= n_rows - 1
        variance[i] = interpolated(x, y, phase, sigma, alike) if inside else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def correct(pixels, sigmas1, phase2, sigmas2, alike, todo, maps, rows):  # type: ignore[no-untyped-def]
    """Multiply standard deviations that rest on the mean weight of neighbours by what is true.

    pixels (row, col, 2): places in C2, px; todo (row, col) bool: pixels whose point is not known
    yet; sigmas1, sigmas2 = (noise that was counted with, that of points (row, col)), rad; maps =
    (sigma_px, sigma_mm (row, col)), the latter of the points that are known.
    """
    n_rows, n_cols = phase2.shape
    sigma_px, sigma_mm = maps
    (noise1, sigma1), (noise2, sigma2) = sigmas1, sigmas2
    for row in range(rows[0], rows[1]):
        for col in range(sigma_px.shape[1]):
            x, y = pixels[row, col, 0], pixels[row, col, 1]
            if not (0 <= x < n_cols - 1 and 0 <= y < n_rows - 1):  # nor NaN
                continue
            i, j = int(y), int(x)
            largest = np.float32(0)
            for k in range(2):
                for m in range(2):
                    if not math.isnan(phase2[i + k, j + m]):
                        largest = max(largest, noise2[i + k, j + m])
            counted = noise1[row, col] * noise1[row, col]
            counted += INTERPOLATION_WEIGHT * largest * largest
            true = sigma1[row, col] * sigma1[row, col]
            true += interpolated(x, y, phase2, sigma2, alike)
            factor = np.float32(math.sqrt(true / counted)) if counted > 0 else np.float32(1)
            sigma_px[row, col] *= factor
            if not todo[row, col]:
                sigma_mm[row, col] *= factor
