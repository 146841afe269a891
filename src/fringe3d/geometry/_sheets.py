"""Viewing rays and light sheets, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.geometry._lens import project_normalized

SHEET_ITERATIONS = 12
SHEET_TOLERANCE_PX = 1e-7
ACCEPTED_PX = 1e-4
"""Distance from the sheet at which a ray that did not converge further still meets it."""

SLOPE_STEP = 1e-4
"""Part of the distance over which the derivative is taken."""


@njit(cache=True, error_model="numpy")
def _across(base, along, t, lens, axis):  # type: ignore[no-untyped-def]
    z = base[2] + t * along[2]
    if not z > 0:
        return np.nan
    x, y = project_normalized((base[0] + t * along[0]) / z, (base[1] + t * along[1]) / z, lens)
    return axis[0] * (x + 0.5) + axis[1] * (y + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def cross_all(base, rotation, directions, position, lens, axis, depths, rows):  # type: ignore[no-untyped-def]
    """Write where rays meet light sheets, (n,) mm; NaN where they do not.

    base (3,): origin of the rays in the frame of the projector; rotation (3, 3): onto that frame;
    directions (n, 3): in the world frame; position (n,): w of the sheets, px; axis (2,).
    """
    sx, sy = axis[0] * lens[0], axis[1] * lens[1]
    beside = 0.5 * (axis[0] + axis[1]) + axis[0] * lens[2] + axis[1] * lens[3]
    for i in range(rows[0], rows[1]):
        d0, d1, d2 = directions[i, 0], directions[i, 1], directions[i, 2]
        along = (
            rotation[0, 0] * d0 + rotation[0, 1] * d1 + rotation[0, 2] * d2,
            rotation[1, 0] * d0 + rotation[1, 1] * d1 + rotation[1, 2] * d2,
            rotation[2, 0] * d0 + rotation[2, 1] * d1 + rotation[2, 2] * d2,
        )
        target = position[i] - beside
        t = (base[0] * sx + base[1] * sy - base[2] * target) / (
            along[2] * target - along[0] * sx - along[1] * sy
        )
        error = np.nan
        for _ in range(SHEET_ITERATIONS):
            error = _across(base, along, t, lens, axis) - position[i]
            if not abs(error) > SHEET_TOLERANCE_PX:
                break
            step = SLOPE_STEP * abs(t)
            after = _across(base, along, t + step, lens, axis)
            t -= error * 2 * step / (after - _across(base, along, t - step, lens, axis))
        met = abs(error) <= ACCEPTED_PX and t > 0 and not math.isinf(t)
        depths[i] = t if met else np.nan
