"""Search for equal phase along epipolar curves, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._phase import MAX_JUMP, TWO_PI, phase_difference, wrap
from fringe3d.geometry._lens import project_normalized
from fringe3d.kernels import HELPER

STEP_PX = 0.5
"""Steps of one pixel lose 0.7 % of the points on steep surfaces."""

MAX_STEPS = 16384
SAME_POINT_PX = 2.0
"""Crossings closer than this are one crossing, split by noise."""

REFINEMENTS = 6

LENS_STEPS = 16
"""Steps between exact evaluations of the lens while scanning; linear between them (error below
0.005 px for strong lenses). The point found is refined on the exact curve."""

PHASE_TOLERANCE = 1e-7
MIN_RISE = 1e-9
MAX_REFINEMENT_STEPS = 2.0
MIN_DEPTH = 1e-6

FOUND, NONE, SEVERAL, NO_VIEW = 0, 1, 2, 3


@njit(**HELPER)
def _difference(x, y, phi1, order1, phase2, order2):  # type: ignore[no-untyped-def]
    """Return phase2 - phi1 at (x, y), rad, wrapped, and whether the order there is order1."""
    difference, _, _ = phase_difference(x, y, phi1, phase2)
    if math.isnan(difference):
        return np.nan, False
    if len(order2) == 0:
        return difference, True
    row, col = int(y), int(x)
    # A neighbour whose phase differs from phi1 by less than half a turn without wrapping lies
    # in the same period as phi1: its order must be order1.
    same = False
    for i in range(2):
        for j in range(2):
            value = phase2[row + i, col + j]
            if abs(value - phi1) < math.pi and order2[row + i, col + j] == order1:
                same = True
    return difference, same


@njit(**HELPER)
def _second_fits(x, y, second):  # type: ignore[no-untyped-def]
    """Tell whether the phase of a second direction agrees, too, as far as it is known."""
    phi1, limit, phase2 = second
    if len(phase2) == 0:
        return True
    residual, _, _ = phase_difference(x, y, phi1, phase2)
    return not abs(residual) > limit


@njit(**HELPER)
def segment(base, along, near, far):  # type: ignore[no-untyped-def]
    """Return the ends of the segment on the undistorted plane of C2, where it is straight.

    NaN where it is not wholly in front of C2.
    """
    z0 = base[2] + near * along[2]
    z1 = along[2] if math.isinf(far) else base[2] + far * along[2]
    if not (near < far and z0 > MIN_DEPTH and z1 > MIN_DEPTH):
        return np.nan, np.nan, np.nan, np.nan
    ax, ay = (base[0] + near * along[0]) / z0, (base[1] + near * along[1]) / z0
    if math.isinf(far):
        return ax, ay, along[0] / z1, along[1] / z1
    return ax, ay, (base[0] + far * along[0]) / z1, (base[1] + far * along[1]) / z1


@njit(**HELPER)
def _point(s, line, lens2):  # type: ignore[no-untyped-def]
    """Return the pixel of C2 at part s of the segment."""
    ax, ay, bx, by = line
    return project_normalized(ax + s * (bx - ax), ay + s * (by - ay), lens2)


@njit(**HELPER)
def _find_near(ends, phi1, spans, work):  # type: ignore[no-untyped-def]
    """Mark the steps between two places, on a straight line, where C2 may show a phase.

    work = (cells (LENS_STEPS,) int32, near (LENS_STEPS,) bool), written. Returns whether any may.
    """
    x0, y0, x1, y1 = ends
    cells, near = work
    n_rows, n_cols, _ = spans.shape
    dx, dy = (x1 - x0) / LENS_STEPS, (y1 - y0) / LENS_STEPS
    nowhere = np.int32(n_rows * n_cols - 1)
    for i in range(LENS_STEPS):
        x, y = x0 + i * dx, y0 + i * dy
        inside = (x >= 0) & (x < n_cols - 1) & (y >= 0) & (y < n_rows - 1)
        x, y = x if inside else 0.0, y if inside else 0.0
        cell = np.int32(y) * np.int32(n_cols) + np.int32(x)
        cells[i] = cell if inside else nowhere
    flat, some = spans.reshape(-1, 2), False
    for i in range(LENS_STEPS):
        near[i] = abs(wrap(flat[cells[i], 0] - phi1)) <= flat[cells[i], 1]
        some |= near[i]
    return some


@njit(**HELPER)
def _has_order(cell, class1, order2):  # type: ignore[no-untyped-def]
    """Tell whether one of the four neighbours has a class of orders."""
    if len(order2) == 0:
        return True
    row, col = divmod(cell, order2.shape[1])
    same = (order2[row, col] == class1) | (order2[row, col + 1] == class1)
    return same | (order2[row + 1, col] == class1) | (order2[row + 1, col + 1] == class1)


@njit(**HELPER)
def _difference_near(x, y, phi1, class1, phase2, order2):  # type: ignore[no-untyped-def]
    """Return phase2 - phi1 at (x, y), rad, wrapped; NaN where the nearest pixel tells that no
    crossing can be within one step: it shows another surface."""
    col, row = int(x + 0.5), int(y + 0.5)
    if not (0 <= col < phase2.shape[1] and 0 <= row < phase2.shape[0]):
        return np.nan
    away = abs(phase2[row, col] - phi1)  # NaN: a hole of one pixel may hide a crossing
    # In the same period, or in the next of the same class; else in the neighbouring one.
    if len(order2) == 0 or order2[row, col] == class1:
        if min(away, TWO_PI - away) > MAX_JUMP:
            return np.nan
    elif TWO_PI - away > MAX_JUMP:
        return np.nan
    return phase_difference(x, y, phi1, phase2)[0]


@njit(**HELPER)
def scan(line, n, step_px, phi1, class1, lens2, maps, second, work):  # type: ignore[no-untyped-def]
    """Follow the segment in n steps; return crossings, and place and rise of the first.

    phi1, class1: of C1; maps = (phase, spans, order) of C2: only where the spans hold phi1, see
    `_phase.write_spans`, the phase is looked at closely; order: empty where any will do; second =
    (phase, rad, how far that of C2 may differ, map of C2, empty for none) of another direction;
    work: see `_find_near`.
    """
    phase2, spans, order2 = maps
    cells, near = work
    hits, where, rise, last_hit = 0, 0.0, 0.0, -1e9
    r_before, is_known, was_near = np.nan, False, False
    x_before, y_before = np.nan, np.nan
    x1, y1 = _point(0.0, line, lens2)
    for first in range(0, n + 1, LENS_STEPS):
        x0, y0 = x1, y1
        x1, y1 = _point((first + LENS_STEPS) / n, line, lens2)
        if not (_find_near((x0, y0, x1, y1), phi1, spans, work) or was_near):
            part = (LENS_STEPS - 1) / LENS_STEPS
            x_before, y_before, is_known = x0 + part * (x1 - x0), y0 + part * (y1 - y0), False
            continue
        for k in range(first, min(first + LENS_STEPS, n + 1)):
            part = (k - first) / LENS_STEPS
            x, y = x0 + part * (x1 - x0), y0 + part * (y1 - y0)
            is_near = near[k - first] and _has_order(cells[k - first], class1, order2)
            if is_near or was_near:
                if not is_known:
                    r_before = _difference_near(x_before, y_before, phi1, class1, phase2, order2)
                r = _difference_near(x, y, phi1, class1, phase2, order2)
                if r_before * r <= 0 and abs(r - r_before) < MAX_JUMP and r != 0:
                    at = (k - 1 + r_before / (r_before - r)) / n
                    x_hit, y_hit = _point(at, line, lens2)
                    _, same = _difference(x_hit, y_hit, phi1, class1, phase2, order2)
                    if same and _second_fits(x_hit, y_hit, second):
                        if hits == 0 or (k - last_hit) * step_px > SAME_POINT_PX:
                            hits += 1
                            where, rise = at, r - r_before
                        last_hit = k
                r_before = r
            is_known, was_near = is_near or was_near, is_near
            x_before, y_before = x, y
    return hits, where, rise


@njit(cache=True)
def scratch():  # type: ignore[no-untyped-def]
    """Return what `scan` needs to work."""
    return np.empty(LENS_STEPS, np.int32), np.empty(LENS_STEPS, np.bool_)


@njit(**HELPER)
def refine(where, rise, line, n, phi1, lens2, phase2):  # type: ignore[no-untyped-def]
    """Return the crossing on the exact curve, and the rise of the phase over one step."""
    x, y = _point(where - 0.5 / n, line, lens2)
    r0, _, _ = phase_difference(x, y, phi1, phase2)
    x, y = _point(where + 0.5 / n, line, lens2)
    r1, _, _ = phase_difference(x, y, phi1, phase2)
    if not math.isnan(r1 - r0):
        rise = r1 - r0
    s, r = where, np.nan
    for _ in range(REFINEMENTS):
        x, y = _point(s, line, lens2)
        r, _, _ = phase_difference(x, y, phi1, phase2)
        if math.isnan(r) or abs(rise) < MIN_RISE or abs(r) < PHASE_TOLERANCE:
            break
        s = s - r / (rise * n)
    if math.isnan(r) or abs(s - where) * n > MAX_REFINEMENT_STEPS:
        s = where  # the linear interpolation of the scan
    return s, rise


@njit(cache=True, nogil=True, error_model="numpy")
def search(  # type: ignore[no-untyped-def]
    phase1, order1, base, along, near, far, lens2, maps, second, found, state, rows
):
    """Find the point with equal phase and order on each epipolar curve.

    phase1 (n,) rad, order1 (n,): pixels of C1; base (3,), along (n, 3): their rays in the frame
    of C2, mm; near, far (n,): the segment, mm; maps = (phase, spans, order) of C2, see `scan`;
    second = (phase1 (n,), limit (n,), phase2): another direction, rad, empty for none. Writes
    found (n, 3): x, y, phase gradient along the curve (rad / px); state (n,): FOUND, NONE,
    SEVERAL or NO_VIEW. rows: first of the n and last but one.
    """
    work = scratch()
    for i in range(rows[0], rows[1]):
        state[i] = NO_VIEW
        found[i, :] = np.nan
        line = segment(base, along[i], near[i], far[i])
        x0, y0 = _point(0.0, line, lens2)
        x1, y1 = _point(1.0, line, lens2)
        length = math.hypot(x1 - x0, y1 - y0)
        if not length < MAX_STEPS * STEP_PX:
            continue
        n = max(2, int(length / STEP_PX) + 1)
        seconds = (np.nan, np.nan, second[2])
        if len(second[0]) > 0:
            seconds = (second[0][i], second[1][i], second[2])
        hits, where, rise = scan(
            line, n, length / n, phase1[i], order1[i], lens2, maps, seconds, work
        )
        if hits != 1:
            state[i] = NONE if hits == 0 else SEVERAL
            continue
        s, rise = refine(where, rise, line, n, phase1[i], lens2, maps[0])
        found[i, 0], found[i, 1] = _point(s, line, lens2)
        found[i, 2] = rise * n / length
        state[i] = FOUND
