"""Fetch the projector's light for every ray of every pixel, compiled."""

from __future__ import annotations

from numba import njit, prange

OVERSAMPLING = 2
"""Samples per projector pixel and axis: a pixel is a square, not a point."""


@njit(cache=True, parallel=True, error_model="numpy")
def collect(levels, first, step, u, v, blur, direct, shift_u, shift_v, out):  # type: ignore[no-untyped-def]
    """Average over the rays of each pixel: brightness times projected light.

    levels (level, row, col) float32: the projector's light, `OVERSAMPLING` samples per pixel,
    blurred with variance ``first + level step`` (px**2); u, v, blur, direct (pixel, ray) as in
    `Footprint`; shift_u, shift_v: displacement of the projected image, px. Writes out (pixel,).
    """
    n_levels, n_rows, n_cols = levels.shape
    n_rays = u.shape[1]
    for p in prange(len(out)):
        total = 0.0
        for i in range(n_rays):
            weight = direct[p, i]
            if not weight > 0:
                continue
            x = (u[p, i] + shift_u + 0.5) * OVERSAMPLING - 0.5
            y = (v[p, i] + shift_v + 0.5) * OVERSAMPLING - 0.5
            z = (blur[p, i] - first) / step
            x = min(max(x, 0.0), n_cols - 1.001)
            y = min(max(y, 0.0), n_rows - 1.001)
            z = min(max(z, 0.0), n_levels - 1.001)
            c, r, k = int(x), int(y), int(z)
            fx, fy, fz = x - c, y - r, z - k
            value = 0.0
            for j in range(2):
                part = fz if j else 1.0 - fz
                if part > 0:
                    upper = levels[k + j, r, c] * (1 - fx) + levels[k + j, r, c + 1] * fx
                    lower = levels[k + j, r + 1, c] * (1 - fx) + levels[k + j, r + 1, c + 1] * fx
                    value += part * (upper * (1 - fy) + lower * fy)
            total += weight * value
        out[p] = total / n_rays
