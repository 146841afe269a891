"""The point of equal phase close to where C2 sees the light sheet of a known order, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._curves import DEPTH_STEP, across, sheet_depth, turned
from fringe3d.correspond._phase import (
    INTERPOLATION_WEIGHT,
    TWO_PI,
    largest_sigma,
    phase_difference,
    wrap,
)
from fringe3d.correspond._search import (
    NO_VIEW,
    NONE,
    SEVERAL,
    STEP_PX,
    refine,
    scan,
    scratch,
    segment,
)
from fringe3d.geometry._lens import project_normalized
from fringe3d.kernels import HELPER
from fringe3d.model import Rejection

u2 = np.uint16

OUTSIDE_VOLUME, OUTSIDE_VIEW = u2(Rejection.OUTSIDE_VOLUME), u2(Rejection.OUTSIDE_VIEW)
NO_MATCH, AMBIGUOUS = u2(Rejection.NO_MATCH), u2(Rejection.AMBIGUOUS)

STEPS = 6
TOLERANCE_RAD = 1e-5
"""A thousandth of the noise."""

LEAST_SLOPE = 1e-3
"""rad / px; a phase that rises less may cross several times."""


@njit(**HELPER)
def _window(w, half, along_p, projector):  # type: ignore[no-untyped-def]
    """Return where a ray crosses the sheet w, mm, and how far off it does those `half` px off."""
    base, _, lens, axis = projector
    t = sheet_depth(base, along_p, w, lens, axis)
    step = DEPTH_STEP * t
    rise = across(base, along_p, t + step, lens, axis) - w
    return t, abs(half * step / rise)


@njit(**HELPER)
def _descend(part, line, ends, phi1, lens2, phase2):  # type: ignore[no-untyped-def]
    """Follow the phase from a part of the segment to where it is phi1.

    Returns the part, the pixel and the slope of the phase along the curve, rad / px; NaN where the
    way does not lead there.
    """
    ax, ay, bx, by = line
    dx, dy = ends[2] - ends[0], ends[3] - ends[1]
    length = math.sqrt(dx * dx + dy * dy)
    for _ in range(STEPS):
        if not 0 <= part <= 1:
            break
        x, y = project_normalized(ax + part * (bx - ax), ay + part * (by - ay), lens2)
        r, gx, gy = phase_difference(x, y, phi1, phase2)
        slope = (gx * dx + gy * dy) / length
        if not abs(slope) > LEAST_SLOPE:
            break
        if abs(r) < TOLERANCE_RAD:
            return part, x, y, slope
        part -= r / (slope * length)
    return np.nan, np.nan, np.nan, np.nan


@njit(**HELPER)
def _is_only_one(part, x, y, slope, ends, phi1, phase2):  # type: ignore[no-untyped-def]
    """Tell whether the phase lies on the right side of phi1 all along the segment, to the next
    pixel: then it crosses nowhere else."""
    n_rows, n_cols = phase2.shape
    dx, dy = ends[2] - ends[0], ends[3] - ends[1]
    length = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    for k in range(-int(part * length) - 1, int((1 - part) * length) + 2):
        if k == 0:
            continue
        col, row = int(x + k * dx + 0.5), int(y + k * dy + 0.5)
        if not (0 <= col < n_cols and 0 <= row < n_rows):
            return False
        if not wrap(phase2[row, col] - phi1) * slope * k > 0:  # NaN, too
            return False
    return True


@njit(**HELPER)
def _found(t, line, bounds, phi1, lens2, second, none, work):  # type: ignore[no-untyped-def]
    """Return x, y, slope of the only crossing of a segment, NaN without one, and the state.

    t: depth at which it is expected; line, bounds: see `segment`; second: phase of C2, spans.
    """
    near, far, z_t, z_far = bounds
    phase2, spans = second
    x0, y0 = project_normalized(line[0], line[1], lens2)
    x1, y1 = project_normalized(line[2], line[3], lens2)
    ends = x0, y0, x1, y1
    length = math.hypot(x1 - x0, y1 - y0)
    if not length < 1e9:
        return np.nan, np.nan, np.nan, NO_VIEW
    part = (t - near) / (far - near) * z_far / z_t
    at, x, y, slope = _descend(part, line, ends, phi1, lens2, phase2)
    if not math.isnan(at) and _is_only_one(at, x, y, slope, ends, phi1, phase2):
        return x, y, slope, 0
    n = max(2, int(length / STEP_PX) + 1)
    any_order, no_phase = none
    other = np.float32(np.nan), np.float32(np.nan), no_phase
    hits, where, rise = scan(
        line, n, length / n, phi1, np.int32(0), lens2, (phase2, spans, any_order), other, work
    )
    if hits != 1:
        return np.nan, np.nan, np.nan, NONE if hits == 0 else SEVERAL
    s, rise = refine(where, rise, line, n, phi1, lens2, phase2)
    x, y = project_normalized(
        line[0] + s * (line[2] - line[0]), line[1] + s * (line[3] - line[1]), lens2
    )
    return x, y, rise * n / length, 0


@njit(cache=True, nogil=True, error_model="numpy")
def search_near(first, half, rays, intervals, projector, camera2, second, none, todo, maps, rows):  # type: ignore[no-untyped-def]
    """Find the point with the phase of each pixel near the light sheet of its order.

    first = (phase, order, sigma (row, col), period px) of C1; half (row, col): px around the sheet;
    rays (row, col, 3): directions in the world; intervals (row, col, 4): mm, where they enter and
    leave the volume, and the part of it that C2 sees; projector = (base (3,), rotation (3, 3),
    lens, axis (2,)), camera2 = (base, rotation, lens): base is the centre of C1 there; second =
    (phase, its spans, sigma) of C2; none: two empty maps, of orders and of another direction; todo
    (row, col): the pixels that are asked for. maps = (pixels (row, col, 2), sigma (row, col), px,
    written, NaN where nothing is found, rejection, to which reasons are added); rows: first and
    last but one.
    """
    phase1, order1, sigma1, period = first
    phase2, spans, sigma2 = second
    base2, rotation2, lens2 = camera2
    pixels, sigma_px, rejection = maps
    work = scratch()
    for row in range(rows[0], rows[1]):
        for col in range(phase1.shape[1]):
            if not todo[row, col]:
                continue
            pixels[row, col, :], sigma_px[row, col] = np.nan, np.nan
            if rejection[row, col] != 0:
                continue
            phi1 = phase1[row, col]
            w = (order1[row, col] + phi1 / TWO_PI) * period
            along_p = turned(projector[1], rays[row, col])
            t, reach = _window(w, half[row, col], along_p, projector)
            enter, leave = intervals[row, col, 0], intervals[row, col, 1]
            near, far = np.float64(intervals[row, col, 2]), np.float64(intervals[row, col, 3])
            if not math.isnan(t + reach):
                enter, leave = max(enter, t - reach), min(leave, t + reach)
                near, far = max(near, t - reach), min(far, t + reach)
            if not enter < leave:
                rejection[row, col] = OUTSIDE_VOLUME
                continue
            along = turned(rotation2, rays[row, col])
            line = segment(base2, along, near, far)
            if math.isnan(line[0]):
                rejection[row, col] = OUTSIDE_VIEW
                continue
            bounds = near, far, base2[2] + t * along[2], base2[2] + far * along[2]
            x, y, slope, state = _found(t, line, bounds, phi1, lens2, (phase2, spans), none, work)
            if state != 0:
                rejection[row, col] = (
                    NO_MATCH if state == NONE else AMBIGUOUS if state == SEVERAL else OUTSIDE_VIEW
                )
                continue
            noise2 = largest_sigma(x, y, phase2, sigma2)
            variance = sigma1[row, col] ** 2 + INTERPOLATION_WEIGHT * noise2 * noise2
            pixels[row, col, 0], pixels[row, col, 1] = x, y
            sigma_px[row, col] = math.sqrt(variance) / abs(slope)
