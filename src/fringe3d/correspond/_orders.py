"""The fringe orders that fit a viewing ray, judged by what the second camera sees, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d import model
from fringe3d.correspond._curves import DEPTH_STEP, across, curve_point, exact_point, turned
from fringe3d.correspond._phase import TWO_PI, largest_sigma, phase_difference
from fringe3d.kernels import HELPER

MODEL_ERROR = 0.0015
"""Periods; what remains of harmonics and interpolation where everything else is perfect."""

OTHER_MODEL_ERROR = 0.005
"""The same between fringes of different periods, whose harmonics do not cancel."""

DEPTH, DIFFERENCE, GRADIENT_X, GRADIENT_Y, VARIANCE, RATIO = range(6)
"""What C2 shows of a candidate: distance along the ray, mm; phase there less that of C1, turns; its
gradient, turns / px; variance of the difference, turns**2, but for that of the calibration; phase
that C2 sees over that of the projector along the ray."""

N_SHOWN = 6

NO_ORDER = np.int32(model.NO_ORDER)


@njit(cache=True, error_model="numpy", inline="always")
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
            index = order - first_order + int(np.floor((phase - value) * (1 / TWO_PI) + 0.5))
            on_projector = 0 <= index < len(class_of_order)
            if on_projector and class2[row + i, col + j] == class_of_order[index]:
                return True
    return False


@njit(cache=True, error_model="numpy", inline="always")
def show(  # type: ignore[no-untyped-def]
    point, phi1, sigma1, order, period, phase2, sigma2, class2, class_of_order, first_order, shown
):
    """Write what C2 shows of a candidate; the difference is NaN where it sees nothing, or another
    class of orders."""
    t, x, y, _, dx, dy = point
    shown[:] = np.nan
    shown[DEPTH] = t
    difference, gx, gy = phase_difference(x, y, phi1, phase2)
    if math.isnan(difference) or not _same_class(
        x, y, phi1 + difference, order, phase2, class2, class_of_order, first_order
    ):
        return
    ratio = (gx * dx + gy * dy) * period / TWO_PI
    noise2 = largest_sigma(x, y, phase2, sigma2)
    variance = noise2 * noise2 + ((ratio - 1) * sigma1) ** 2
    shown[DIFFERENCE] = difference / TWO_PI
    shown[GRADIENT_X], shown[GRADIENT_Y] = gx / TWO_PI, gy / TWO_PI
    shown[VARIANCE] = variance / TWO_PI**2 + MODEL_ERROR**2
    shown[RATIO] = ratio


@njit(**HELPER)
def _other_costs(t, i, per_turn, sigma1, along_p, projector, period1, others):  # type: ignore[no-untyped-def]
    """Return what other fringes have against a point of a ray, squared deviations.

    Nothing hides from the projector what it lights: phases there must be those of C1.
    """
    base_p, lens_p, _ = projector
    phases, sigmas, axes, periods, calibrations = others
    total = 0.0
    for j in range(len(periods)):
        phase, period = phases[j, i], periods[j]
        if math.isnan(phase):
            continue
        w = across(base_p, along_p, t, lens_p, axes[j])
        w1 = across(base_p, along_p, t + DEPTH_STEP * t, lens_p, axes[j])
        drift = (w1 - w) / (DEPTH_STEP * t) * per_turn / period  # periods here for one of the first
        turns = w / period - phase / TWO_PI
        turns -= math.floor(turns + 0.5)
        noise = (sigmas[j, i] ** 2 + (drift * sigma1) ** 2) / TWO_PI**2
        calibration = calibrations[j] ** 2 * (1 / period**2 + (drift / period1) ** 2)
        total += turns * turns / (noise + calibration + OTHER_MODEL_ERROR**2)
    return total


@njit(cache=True, error_model="numpy")
def order_range(span, guard, period, turns):  # type: ignore[no-untyped-def]
    """Return the lowest and highest order whose phase lies on a part of the viewing ray."""
    if math.isnan(span[0] + span[1]):
        return 0, -1
    lowest = math.ceil((span[0] - guard) / period - turns)
    return lowest, math.floor((span[1] + guard) / period - turns)


@njit(cache=True, nogil=True, error_model="numpy")
def find_range(where, spans, guard, class1, period, first, found, inside, rows):  # type: ignore[no-untyped-def]
    """Write the lowest and highest order of each pixel's class on its part of the ray, (n, 2), and
    the same, of any class, for the part inside the volume.

    where (n,): number of the pixel in the image; spans = two (pixel, 2), px: least and largest w of
    both parts; guard = px for each rad of its phase's deviation, and px, by which a candidate may
    lie beyond; class1 (n,): its class of orders; first: as `list_candidates` takes it. The highest
    is less than the lowest where there is none.
    """
    wide, inner = spans
    phase1, sigma1, _, _, _, class_of_order, first_order = first
    for i in range(rows[0], rows[1]):
        turns = phase1[i] / TWO_PI
        beyond = guard[0] * sigma1[i] + guard[1]
        lowest, highest = order_range(wide[where[i]], beyond, period, turns)
        lowest = max(lowest, first_order)
        highest = min(highest, first_order + len(class_of_order) - 1)
        while lowest <= highest and class_of_order[lowest - first_order] != class1[i]:
            lowest += 1
        while lowest <= highest and class_of_order[highest - first_order] != class1[i]:
            highest -= 1
        found[i, 0], found[i, 1] = lowest, highest
        lowest, highest = order_range(inner[where[i]], beyond, period, turns)
        inside[i, 0] = max(lowest, first_order)
        inside[i, 1] = min(highest, first_order + len(class_of_order) - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def list_candidates(  # type: ignore[no-untyped-def]
    where, class1, ranges, label_step, tables, task, orders, shown, extras, is_inside, rows
):
    """Write the orders of its class on each pixel's segment, and what the devices show of them.

    where, class1 (n,): number of the pixel in the image, and its class of orders; ranges = two
    (n, 2): as `find_range` writes them; label_step: orders between the columns of what is written;
    tables = (curves (row, N_CURVE, col), see `_curves`, rays (pixel, 3), rotations from the world
    to projector and C2). task = (projector, camera2, period, first, others): devices as
    `_curves.trace` takes them; first = (phase1 (n,), sigma1 (n,), phase2, sigma2, class2 (maps),
    class_of_order, first_order); others = (phases, sigmas (q, n), axes (q, 2), periods,
    calibrations (q,) px) of other fringes, empty for none.

    Writes orders (rising), what C2 shows (n, m, N_SHOWN), the squared deviations of the other
    fringes and whether the candidate lies in the volume, (n, m); m bounds their number.
    """
    projector, camera2, period, first, others = task
    curves, rays, rotation_p, rotation_2 = tables
    found, inside = ranges
    phase1, sigma1, phase2, sigma2, class2, class_of_order, first_order = first
    for i in range(rows[0], rows[1]):
        turns, row = phase1[i] / TWO_PI, where[i] // curves.shape[2]
        curve = curves[row, :, where[i] - row * curves.shape[2]]
        is_curve = not math.isnan(curve[0])
        orders[i], shown[i], extras[i], is_inside[i] = NO_ORDER, np.nan, 0.0, False
        for place in range((found[i, 1] - found[i, 0]) // label_step + 1):
            order = found[i, 0] + place * label_step
            if class_of_order[order - first_order] != class1[i]:
                continue
            w = (order + turns) * period
            if is_curve:
                point = curve_point(w, curve)
            else:
                ray = rays[where[i]]
                along_p, along_2 = turned(rotation_p, ray), turned(rotation_2, ray)
                point = exact_point(w, along_p, along_2, projector, camera2)
            if point[0] > 0:
                show(
                    point, phase1[i], sigma1[i], order, period, phase2, sigma2, class2,
                    class_of_order, first_order, shown[i, place],
                )  # fmt: skip
                if len(others[3]) > 0:
                    extras[i, place] = _other_costs(
                        point[0], i, point[3] * period, sigma1[i],
                        turned(rotation_p, rays[where[i]]), projector, period, others,
                    )  # fmt: skip
                orders[i, place] = order
                is_inside[i, place] = inside[i, 0] <= order <= inside[i, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def weigh(shown, pixels, bias, scatter, most_sigma, costs, rows):  # type: ignore[no-untyped-def]
    """Write the squared deviation of each candidate from what C2 shows, (n, m); NaN if unseen.

    pixels (n, 2): of C1; bias = (coefficients_px (2, 9), middle (3,), scale (3,), covariance
    (9, 9), px**2, across the fringes) as in `CalibrationBias`; scatter: px that it leaves
    unexplained.
    """
    c, middle, scale, covariance = bias
    for i in range(rows[0], rows[1]):
        u, v = (pixels[i, 0] - middle[0]) / scale[0], (pixels[i, 1] - middle[1]) / scale[1]
        rise_x, rise_y = _rise(u, v, c[0]), _rise(u, v, c[1])
        still_x, still_y = _still(u, v, c[0]), _still(u, v, c[1])
        unsure = _variance(u, v, covariance)
        for a in range(shown.shape[1]):
            t = (shown[i, a, DEPTH] - middle[2]) / scale[2]
            gx, gy = shown[i, a, GRADIENT_X], shown[i, a, GRADIENT_Y]
            expected = gx * (still_x + rise_x * t) + gy * (still_y + rise_y * t)
            residual = shown[i, a, DIFFERENCE] - expected
            residual -= np.floor(residual + 0.5)
            missed = scatter * scatter + unsure[0] + t * (unsure[1] + t * unsure[2])
            variance = shown[i, a, VARIANCE] + (gx * gx + gy * gy) * missed
            fits = variance < most_sigma * most_sigma
            costs[i, a] = residual * residual / variance if fits else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def expect(shown, pixels, bias, scatter, expected, spread, sigma, rows):  # type: ignore[no-untyped-def]
    """Write what the bias lets expect of the residuals of chosen candidates, (n,) turns: the
    residual, what the bias leaves unknown, and the standard deviation in all.

    shown (n, N_SHOWN); the rest as `weigh` takes it.
    """
    c, middle, scale, covariance = bias
    for i in range(rows[0], rows[1]):
        u, v = (pixels[i, 0] - middle[0]) / scale[0], (pixels[i, 1] - middle[1]) / scale[1]
        t = (shown[i, DEPTH] - middle[2]) / scale[2]
        gx, gy = np.float64(shown[i, GRADIENT_X]), np.float64(shown[i, GRADIENT_Y])
        moved_x = _still(u, v, c[0]) + _rise(u, v, c[0]) * t
        expected[i] = gx * moved_x + gy * (_still(u, v, c[1]) + _rise(u, v, c[1]) * t)
        unsure = _variance(u, v, covariance)
        missed = scatter * scatter + unsure[0] + t * (unsure[1] + t * unsure[2])
        spread[i] = math.sqrt((gx * gx + gy * gy) * missed)
        sigma[i] = math.sqrt(shown[i, VARIANCE] + spread[i] * spread[i])


@njit(**HELPER)
def bias_at(x, y, t, c, middle, scale):  # type: ignore[no-untyped-def]
    """Return the displacement of the point of a pixel at a depth, px, in x and y."""
    u, v = (x - middle[0]) / scale[0], (y - middle[1]) / scale[1]
    s = (t - middle[2]) / scale[2]
    return (
        _still(u, v, c[0]) + _rise(u, v, c[0]) * s,
        _still(u, v, c[1]) + _rise(u, v, c[1]) * s,
    )


@njit(**HELPER)
def _still(u, v, c):  # type: ignore[no-untyped-def]
    """Return a displacement in the middle of the depths, px."""
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@njit(**HELPER)
def _rise(u, v, c):  # type: ignore[no-untyped-def]
    """Return its rise with the depth, px."""
    return c[6] + c[7] * u + c[8] * v


@njit(**HELPER)
def _variance(u, v, covariance):  # type: ignore[no-untyped-def]
    """Return the terms 1, t and t**2 of the displacement's variance along a ray, px**2."""
    still, rise = (1.0, u, v, u * u, u * v, v * v), (1.0, u, v)
    level, slope, bend = 0.0, 0.0, 0.0
    for a in range(6):
        for b in range(6):
            level += still[a] * still[b] * covariance[a, b]
        for b in range(3):
            slope += 2 * still[a] * rise[b] * covariance[a, 6 + b]
    for a in range(3):
        for b in range(3):
            bend += rise[a] * rise[b] * covariance[6 + a, 6 + b]
    return level, slope, bend
