"""The one order that a full code leaves each pixel, judged by what C2 sees, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._curves import curve_point, exact_point, turned
from fringe3d.correspond._orders import (
    DIFFERENCE,
    GRADIENT_X,
    GRADIENT_Y,
    N_SHOWN,
    RATIO,
    VARIANCE,
    bias_at,
    order_range,
    show,
)
from fringe3d.correspond._phase import TWO_PI
from fringe3d.kernels import HELPER
from fringe3d.model import Rejection

u2 = np.uint16

NOTHING = u2(0)
OUTSIDE_VOLUME, NO_MATCH = u2(Rejection.OUTSIDE_VOLUME), u2(Rejection.NO_MATCH)


@njit(**HELPER)
def _judged(shown, moved, scatter, limits):  # type: ignore[no-untyped-def]
    """Return whether C2 sees the phase of C1, and how far around it is searched, periods.

    moved: what the bias lets expect, px; limits = (largest squared deviation, largest deviation,
    turns, that judges, search in C2, periods, least and most, least ratio).
    """
    most_cost, most_sigma, least_search, most_search, least_ratio = limits
    gx, gy = np.float64(shown[GRADIENT_X]), np.float64(shown[GRADIENT_Y])
    difference = np.float64(shown[DIFFERENCE])
    residual = difference - (gx * moved[0] + gy * moved[1])
    residual -= np.floor(residual + 0.5)
    variance = shown[VARIANCE] + (gx * gx + gy * gy) * scatter * scatter
    judges = variance < most_sigma * most_sigma
    refuted = judges and residual * residual > most_cost * variance
    fits = not (refuted or math.isnan(difference))
    reach = min(max(abs(difference) + 4 * math.sqrt(variance), least_search), most_search)
    return fits, min(reach / max(abs(shown[RATIO]), least_ratio), 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def confirm(  # type: ignore[no-untyped-def]
    first, tables, projector, camera2, second, code, field, limits, todo, rejection, half, rows
):
    """Reject the pixels whose order puts them outside the volume, or where C2 sees other phases.

    first = (phase, order, sigma (row, col), period, px) of C1; tables = (ends, curves, wide, inner,
    rays, rotations from the world to projector and C2), see `curves.RayCurves`;
    projector, camera2: as `_curves.trace` takes them; second = (phase, sigma, class of
    orders) of C2; code = (class_of_order, first_order, px for each rad of a phase's deviation, and
    px, by which a point may lie beyond); field = (coefficients, middle, scale, scatter, px) of the
    bias; limits: see `_judged`; todo (row, col): the pixels that are asked for; rows:
    first and last but one. Adds reasons to
    rejection and writes half, px around the light sheet in which C2 sees the point, NaN where there
    is none, (row, col).
    """
    phase1, order1, sigma1, period = first
    ends, curves, wide, inner, rays, rotation_p, rotation_2 = tables
    phase2, sigma2, class2 = second
    class_of_order, first_order, guard_per_rad, guard = code
    coefficients, middle, scale, scatter = field
    shown = np.empty(N_SHOWN, np.float32)
    for row in range(rows[0], rows[1]):
        for col in range(phase1.shape[1]):
            half[row, col] = np.nan
            if rejection[row, col] != 0 or not todo[row, col]:
                continue
            if not ends[row, col, 0] < ends[row, col, 1]:
                rejection[row, col] = OUTSIDE_VOLUME
                continue
            phi1, order, noise = phase1[row, col], order1[row, col], sigma1[row, col]
            turns, beyond = phi1 / TWO_PI, guard_per_rad * noise + guard
            lowest, highest = order_range(wide[row, col], beyond, period, turns)
            if not lowest <= order <= highest:
                rejection[row, col] = NO_MATCH
                continue
            w, curve = (order + turns) * period, curves[row, :, col]
            if math.isnan(curve[0]):
                ray = rays[row, col]
                along_p, along_2 = turned(rotation_p, ray), turned(rotation_2, ray)
                point = exact_point(w, along_p, along_2, projector, camera2)
            else:
                point = curve_point(w, curve)
            if not point[0] > 0:
                rejection[row, col] = NO_MATCH
                continue
            show(point, phi1, noise, order, period, phase2, sigma2, class2, class_of_order,
                 first_order, shown)  # fmt: skip
            moved = bias_at(col, row, point[0], coefficients, middle, scale)
            fits, reach = _judged(shown, moved, scatter, limits)
            lowest, highest = order_range(inner[row, col], beyond, period, turns)
            if not fits:
                rejection[row, col] = NO_MATCH
            elif not lowest <= order <= highest:
                rejection[row, col] = OUTSIDE_VOLUME
            else:
                half[row, col] = reach * period
