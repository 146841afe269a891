"""Local planes through a quantised map, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def local_planes(values, radius, gate, step, smooth, sigma, rows):  # type: ignore[no-untyped-def]
    """Fit a plane to the window around each pixel and take its value at the centre.

    values : (row, col) float32 with steps of `step`, NaN where invalid. Neighbours count while
    they differ from the centre by less than `gate` and, in a second pass, from the plane by
    less than `step`. Writes `smooth` and `sigma` (row, col) float32.
    """
    n_rows, n_cols = values.shape
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            center = values[row, col]
            smooth[row, col], sigma[row, col] = np.nan, np.nan
            if math.isnan(center):
                continue
            a, b, c = 0.0, 0.0, 0.0  # plane a + b dx + c dy, relative to the centre
            limit = gate
            n = 0.0
            for _ in range(2):
                n, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                sz, sxz, syz = 0.0, 0.0, 0.0
                for i in range(max(row - radius, 0), min(row + radius + 1, n_rows)):
                    for j in range(max(col - radius, 0), min(col + radius + 1, n_cols)):
                        x, y = float(j - col), float(i - row)
                        z = values[i, j] - center
                        if abs(z - (a + b * x + c * y)) <= limit:
                            n += 1.0
                            sx += x
                            sy += y
                            sxx += x * x
                            sxy += x * y
                            syy += y * y
                            sz += z
                            sxz += x * z
                            syz += y * z
                sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
                sxz, syz = sxz - sx * sz / n, syz - sy * sz / n
                det = sxx * syy - sxy * sxy
                if n < 6 or det < 1e-6:
                    n = 0.0
                    break
                b, c = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
                a = (sz - b * sx - c * sy) / n
                limit = step
            if n > 0:
                smooth[row, col] = center + a
                # Pixels within one step carry one quantisation error.
                independent = min(max(1.0, n * math.hypot(b, c) / step), n)
                sigma[row, col] = step / math.sqrt(12.0 * independent)
