"""The fringe orders that fit a viewing ray, judged by what the second camera sees, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from fringe3d.correspond._phase import TWO_PI, largest_sigma, phase_difference
from fringe3d.geometry._lens import project_normalized

SHEET_STEPS = 8
"""Upper bound; the pinhole's slope with the exact lens gains two digits a step."""

SHEET_TOLERANCE_PX = 1e-5

MODEL_ERROR = 0.0015
"""Periods; what remains of harmonics and interpolation where everything else is perfect."""

OTHER_MODEL_ERROR = 0.005
"""The same between fringes of different periods, whose harmonics do not cancel."""

DEPTH_STEP = 1e-4
"""Part of the depth by which a point is moved to find its speed in an image."""

DEPTH, DIFFERENCE, GRADIENT_X, GRADIENT_Y, VARIANCE, RATIO = range(6)
"""What C2 shows of a candidate: distance along the ray, mm; phase there less that of C1, turns; its
gradient, turns / px; variance of the difference, turns**2, but for that of the calibration; phase
that C2 sees over that of the projector along the ray."""

N_SHOWN = 6


@njit(cache=True, error_model="numpy")
def _pixel(base, along, t, lens):  # type: ignore[no-untyped-def]
    """Return the pixel of a point of a viewing ray, NaN behind the device."""
    z = base[2] + t * along[2]
    if not z > 0:
        return np.nan, np.nan
    return project_normalized((base[0] + t * along[0]) / z, (base[1] + t * along[1]) / z, lens)


@njit(cache=True, error_model="numpy")
def _across(base, along, t, lens, axis):  # type: ignore[no-untyped-def]
    """Return the coordinate w across the fringes that light a point of a viewing ray."""
    x, y = _pixel(base, along, t, lens)
    return axis[0] * (x + 0.5) + axis[1] * (y + 0.5)


@njit(cache=True, error_model="numpy")
def _sheet_depth(base, along, w, lens, axis):  # type: ignore[no-untyped-def]
    """Return where a viewing ray meets a light sheet; NaN where it does not.

    ``t(Phi) = (a - c Phi)/(e Phi - b)`` for the pinhole, then steps with its slope on the exact
    lens.
    """
    sx, sy = axis[0] * lens[0], axis[1] * lens[1]
    target = w - 0.5 * (axis[0] + axis[1]) - axis[0] * lens[2] - axis[1] * lens[3]
    upper = base[0] * sx + base[1] * sy - base[2] * target
    t = upper / (along[2] * target - along[0] * sx - along[1] * sy)
    for _ in range(SHEET_STEPS):
        error = _across(base, along, t, lens, axis) - w
        if abs(error) < SHEET_TOLERANCE_PX:
            return t
        z = base[2] + t * along[2]
        x, y = base[0] + t * along[0], base[1] + t * along[1]
        rise = (sx * along[0] + sy * along[1]) / z - (sx * x + sy * y) * along[2] / (z * z)
        t -= error / rise
    return np.nan


@njit(cache=True, error_model="numpy")
def _same_class(x, y, phase, order, phase2, class2, class_of_order, first_order):  # type: ignore[no-untyped-def]
    """Tell whether a neighbour of (x, y) has the class that the absolute phase there demands.

    phase : rad, that of the surface there, unwrapped from the period `order`.
    """
    col, row = int(x), int(y)
    for i in range(2):
        for j in range(2):
            value = phase2[row + i, col + j]
            if math.isnan(value):
                continue
            index = order - first_order + math.floor((phase - value) / TWO_PI + 0.5)
            on_projector = 0 <= index < len(class_of_order)
            if on_projector and class2[row + i, col + j] == class_of_order[index]:
                return True
    return False


@njit(cache=True, error_model="numpy")
def _show(t, i, order, ray1, ray2, axis, period, first, shown):  # type: ignore[no-untyped-def]
    """Write what C2 shows of a candidate, and return how far the ray goes in one period, mm.

    The difference is NaN where C2 sees nothing, or another class of orders.
    """
    base_p, along_p, lens_p = ray1
    base_2, along_2, lens_2 = ray2
    phase1, sigma1, phase2, sigma2, class2, class_of_order, first_order = first
    step = DEPTH_STEP * t
    w0 = _across(base_p, along_p[i], t, lens_p, axis)
    w1 = _across(base_p, along_p[i], t + step, lens_p, axis)
    per_turn = step * period / (w1 - w0)
    shown[:] = np.nan
    shown[DEPTH] = t
    x, y = _pixel(base_2, along_2[i], t, lens_2)
    difference, gx, gy = phase_difference(x, y, phase1[i], phase2)
    if math.isnan(difference) or not _same_class(
        x, y, phase1[i] + difference, order, phase2, class2, class_of_order, first_order
    ):
        return per_turn
    x1, y1 = _pixel(base_2, along_2[i], t + step, lens_2)
    ratio = (gx * (x1 - x) + gy * (y1 - y)) / step * per_turn / TWO_PI
    noise2 = largest_sigma(x, y, phase2, sigma2)
    variance = noise2 * noise2 + ((ratio - 1) * sigma1[i]) ** 2
    shown[DIFFERENCE] = difference / TWO_PI
    shown[GRADIENT_X], shown[GRADIENT_Y] = gx / TWO_PI, gy / TWO_PI
    shown[VARIANCE] = variance / TWO_PI**2 + MODEL_ERROR**2
    shown[RATIO] = ratio
    return per_turn


@njit(cache=True, error_model="numpy")
def _other_costs(t, i, per_turn, sigma1, ray1, period1, others):  # type: ignore[no-untyped-def]
    """Return what other fringes have against a point of a ray, squared deviations.

    Nothing hides from the projector what it lights: phases there must be those of C1.
    """
    base_p, along_p, lens_p = ray1
    phases, sigmas, axes, periods, calibrations = others
    total = 0.0
    for j in range(len(periods)):
        phase, period = phases[j, i], periods[j]
        if math.isnan(phase):
            continue
        w = _across(base_p, along_p[i], t, lens_p, axes[j])
        w1 = _across(base_p, along_p[i], t + DEPTH_STEP * t, lens_p, axes[j])
        drift = (w1 - w) / (DEPTH_STEP * t) * per_turn / period  # periods here for one of the first
        turns = w / period - phase / TWO_PI
        turns -= math.floor(turns + 0.5)
        noise = (sigmas[j, i] ** 2 + (drift * sigma1) ** 2) / TWO_PI**2
        calibration = calibrations[j] ** 2 * (1 / period**2 + (drift / period1) ** 2)
        total += turns * turns / (noise + calibration + OTHER_MODEL_ERROR**2)
    return total


@njit(cache=True, error_model="numpy")
def _order_range(ends, i, guard, turns, ray1, axis, period):  # type: ignore[no-untyped-def]
    """Return the lowest and highest order whose phase lies on a part of the viewing ray."""
    base_p, along_p, lens_p = ray1
    w0 = _across(base_p, along_p[i], ends[i, 0], lens_p, axis)
    w1 = _across(base_p, along_p[i], ends[i, 1], lens_p, axis)
    # Fringes that nearly follow the epipolar lines may turn round on the segment.
    middle = _across(base_p, along_p[i], 0.5 * (ends[i, 0] + ends[i, 1]), lens_p, axis)
    if math.isnan(w0 + w1 + middle):
        return 0, -1
    lowest = math.ceil((min(w0, w1, middle) - guard[i]) / period - turns)
    return lowest, math.floor((max(w0, w1, middle) + guard[i]) / period - turns)


@njit(cache=True, error_model="numpy")
def _of_class(ends, i, guard, turns, ray1, axis, period, name, class_of_order, first_order):  # type: ignore[no-untyped-def]
    """Return the lowest and highest order of a class on a part of the viewing ray."""
    lowest, highest = _order_range(ends, i, guard, turns, ray1, axis, period)
    lowest = max(lowest, first_order)
    highest = min(highest, first_order + len(class_of_order) - 1)
    while lowest <= highest and class_of_order[lowest - first_order] != name:
        lowest += 1
    while lowest <= highest and class_of_order[highest - first_order] != name:
        highest -= 1
    return lowest, highest


@njit(cache=True, parallel=True, error_model="numpy")
def find_range(ends, guard, class1, ray1, axis, period, phase1, class_of_order, first_order, found):  # type: ignore[no-untyped-def]
    """Write the lowest and highest order (n, 2) of its class on each pixel's part of the ray; see
    below. The highest is less than the lowest where there is none."""
    for i in prange(len(class1)):
        found[i, 0], found[i, 1] = _of_class(
            ends, i, guard, phase1[i] / TWO_PI, ray1, axis, period, class1[i], class_of_order,
            first_order,
        )  # fmt: skip


@njit(cache=True, parallel=True, error_model="numpy")
def list_candidates(  # type: ignore[no-untyped-def]
    inner_ends, guard, class1, found, label_step, task, orders, shown, extras, is_inside
):
    """Write the orders of its class on each pixel's segment, and what the devices show of them.

    inner_ends (n, 2) mm: part of the viewing rays inside the volume; guard (n,): projector px by
    which a candidate may lie beyond; class1 (n,): its class of orders; found (n, 2): as
    `find_range` writes it; label_step: orders between the columns of what is written. task =
    (ray1, ray2, axis, period, first, others): ray1 = (base (3,), along (n, 3), lens) in the
    projector's frame, ray2 in that of C2; axis (2,), period: of the fringes; first = (phase1 (n,),
    sigma1 (n,), phase2, sigma2, class2 (maps), class_of_order, first_order); others = (phases,
    sigmas (q, n), axes (q, 2), periods, calibrations (q,) px) of other fringes, empty for none.

    Writes orders (rising), what C2 shows (n, m, N_SHOWN), the squared deviations of the other
    fringes and whether the candidate lies in the volume, (n, m); m bounds their number.
    """
    ray1, ray2, axis, period, first, others = task
    class_of_order, first_order = first[5], first[6]
    for i in prange(len(class1)):
        turns = first[0][i] / TWO_PI
        first_inside, last_inside = _order_range(inner_ends, i, guard, turns, ray1, axis, period)
        for place in range((found[i, 1] - found[i, 0]) // label_step + 1):
            order = found[i, 0] + place * label_step
            if class_of_order[order - first_order] != class1[i]:
                continue
            t = _sheet_depth(ray1[0], ray1[1][i], (order + turns) * period, ray1[2], axis)
            if t > 0:
                per_turn = _show(t, i, order, ray1, ray2, axis, period, first, shown[i, place])
                extras[i, place] = _other_costs(t, i, per_turn, first[1][i], ray1, period, others)
                orders[i, place] = order
                is_inside[i, place] = first_inside <= order <= last_inside


@njit(cache=True, parallel=True, error_model="numpy")
def weigh(shown, pixels, bias, scatter, most_sigma, costs):  # type: ignore[no-untyped-def]
    """Write the squared deviation of each candidate from what C2 shows, (n, m); NaN if unseen.

    pixels (n, 2): of C1; bias = (coefficients_px (2, 9), middle (3,), scale (3,)) as in
    `CalibrationBias`; scatter: px that it leaves unexplained.
    """
    c, middle, scale = bias
    for i in prange(shown.shape[0]):
        u, v = (pixels[i, 0] - middle[0]) / scale[0], (pixels[i, 1] - middle[1]) / scale[1]
        rise_x, rise_y = _rise(u, v, c[0]), _rise(u, v, c[1])
        still_x, still_y = _still(u, v, c[0]), _still(u, v, c[1])
        for a in range(shown.shape[1]):
            t = (shown[i, a, DEPTH] - middle[2]) / scale[2]
            gx, gy = shown[i, a, GRADIENT_X], shown[i, a, GRADIENT_Y]
            expected = gx * (still_x + rise_x * t) + gy * (still_y + rise_y * t)
            residual = shown[i, a, DIFFERENCE] - expected
            residual -= math.floor(residual + 0.5)
            variance = shown[i, a, VARIANCE] + (gx * gx + gy * gy) * scatter * scatter
            fits = variance < most_sigma * most_sigma
            costs[i, a] = residual * residual / variance if fits else np.nan


@njit(cache=True, error_model="numpy")
def _still(u, v, c):  # type: ignore[no-untyped-def]
    """Return a displacement in the middle of the depths, px."""
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@njit(cache=True, error_model="numpy")
def _rise(u, v, c):  # type: ignore[no-untyped-def]
    """Return its rise with the depth, px."""
    return c[6] + c[7] * u + c[8] * v
