"""Where a viewing ray meets light sheets, and where C2 sees these points, compiled.

Along the ray both are functions of the coordinate w across the fringes. For pinholes they are
quotients of linear functions, which the ends of the segment give; what distortion adds is smooth, a
polynomial through two exact points between. So each candidate costs two divisions instead of
several evaluations of the lens.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.geometry._lens import project_normalized
from fringe3d.kernels import HELPER

SHEET_STEPS = 8
"""Upper bound; the pinhole's slope with the exact lens gains two digits a step."""

SHEET_TOLERANCE_PX = 1e-5

DEPTH_STEP = 1e-4
"""Part of the depth by which a point is moved to find its speed in an image."""

LEAST_STEP, LEAST_RANGE_PX = 0.02, 4.0
"""Part of the way in w on each third of a ray, and the whole way: else the light sheets may turn
round, and candidates lie far beyond the ends."""

START, PER_W, DEPTH_0, DEPTH_RISE, DEPTH_BEND, DEPTH_A, DEPTH_B = range(7)
BEND, X_0, X_RISE, X_A, X_B, Y_0, Y_RISE, Y_A, Y_B = range(7, 16)
N_CURVE = 16
"""With s = (w - START) PER_W and u = r s / (1 - s + r s), r = DEPTH_BEND, the depth is
DEPTH_0 + DEPTH_RISE u + u (1 - u) (DEPTH_A + DEPTH_B u); x and y likewise, with r = BEND."""


@njit(cache=True, error_model="numpy", inline="always")
def turned(rotation, ray):  # type: ignore[no-untyped-def]
    """Return a direction, three numbers, in the frame that a rotation leads to."""
    x, y, z = ray[0], ray[1], ray[2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@njit(cache=True, error_model="numpy", inline="always")
def pixel(base, along, t, lens):  # type: ignore[no-untyped-def]
    """Return the pixel of a point of a viewing ray, NaN behind the device."""
    z = base[2] + t * along[2]
    if not z > 0:
        return np.nan, np.nan
    return project_normalized((base[0] + t * along[0]) / z, (base[1] + t * along[1]) / z, lens)


@njit(**HELPER)
def across(base, along, t, lens, axis):  # type: ignore[no-untyped-def]
    """Return the coordinate w across the fringes that light a point of a viewing ray."""
    x, y = pixel(base, along, t, lens)
    return axis[0] * (x + 0.5) + axis[1] * (y + 0.5)


@njit(**HELPER)
def sheet_depth(base, along, w, lens, axis):  # type: ignore[no-untyped-def]
    """Return where a viewing ray meets a light sheet; NaN where it does not.

    ``t(Phi) = (a - c Phi)/(e Phi - b)`` for the pinhole, then steps with its slope on the exact
    lens.
    """
    sx, sy = axis[0] * lens[0], axis[1] * lens[1]
    target = w - 0.5 * (axis[0] + axis[1]) - axis[0] * lens[2] - axis[1] * lens[3]
    upper = base[0] * sx + base[1] * sy - base[2] * target
    t = upper / (along[2] * target - along[0] * sx - along[1] * sy)
    for _ in range(SHEET_STEPS):
        error = across(base, along, t, lens, axis) - w
        if abs(error) < SHEET_TOLERANCE_PX:
            return t
        z = base[2] + t * along[2]
        x, y = base[0] + t * along[0], base[1] + t * along[1]
        rise = (sx * along[0] + sy * along[1]) / z - (sx * x + sy * y) * along[2] / (z * z)
        t -= error / rise
    return np.nan


@njit(**HELPER)
def exact_point(w, along_p, along_2, projector, camera2):  # type: ignore[no-untyped-def]
    """Return t, x, y of the point of a ray that the sheet w lights, and their slopes over w."""
    base_p, lens_p, axis = projector
    base_2, lens_2 = camera2
    t = sheet_depth(base_p, along_p, w, lens_p, axis)
    step = DEPTH_STEP * t
    per_w = step / (across(base_p, along_p, t + step, lens_p, axis) - w)
    x, y = pixel(base_2, along_2, t, lens_2)
    x1, y1 = pixel(base_2, along_2, t + step, lens_2)
    return t, x, y, per_w, (x1 - x) / step * per_w, (y1 - y) / step * per_w


@njit(cache=True, error_model="numpy")
def _projective(s, bend):  # type: ignore[no-untyped-def]
    """Return where the part s of one picture of a line lies in another one, and its slope."""
    part = 1 / (1 - s + bend * s)
    return bend * s * part, bend * part * part


@njit(cache=True, error_model="numpy")
def _value(u, at_0, rise, a, b):  # type: ignore[no-untyped-def]
    return at_0 + u * (rise + (1 - u) * (a + b * u))


@njit(cache=True, error_model="numpy")
def _slope(u, rise, a, b):  # type: ignore[no-untyped-def]
    return rise + a * (1 - 2 * u) + b * u * (2 - 3 * u)


@njit(cache=True, error_model="numpy", inline="always")
def curve_point(w, c):  # type: ignore[no-untyped-def]
    """Return the same from a curve."""
    s = (w - c[START]) * c[PER_W]
    u, du = _projective(s, c[DEPTH_BEND])
    v, dv = _projective(s, c[BEND])
    dv *= c[PER_W]
    return (
        _value(u, c[DEPTH_0], c[DEPTH_RISE], c[DEPTH_A], c[DEPTH_B]),
        _value(v, c[X_0], c[X_RISE], c[X_A], c[X_B]),
        _value(v, c[Y_0], c[Y_RISE], c[Y_A], c[Y_B]),
        du * c[PER_W] * _slope(u, c[DEPTH_RISE], c[DEPTH_A], c[DEPTH_B]),
        dv * _slope(v, c[X_RISE], c[X_A], c[X_B]),
        dv * _slope(v, c[Y_RISE], c[Y_A], c[Y_B]),
    )


@njit(cache=True, error_model="numpy")
def _through(u, v, at_0, at_u, at_v, at_1):  # type: ignore[no-untyped-def]
    """Return rise, a and b of the curve with these values at 0, u, v and 1."""
    rise = at_1 - at_0
    first = (at_u - at_0 - rise * u) / (u * (1 - u))
    second = (at_v - at_0 - rise * v) / (v * (1 - v))
    b = (second - first) / (v - u)
    return rise, first - b * u, b


@njit(**HELPER)
def _fit(w, depths, along_p, along_2, projector, camera2, c):  # type: ignore[no-untyped-def]
    """Write the curve through four points of a ray, with these w and depths."""
    base_p, base_2, lens_2 = projector[0], camera2[0], camera2[1]
    s_u, s_v = (w[1] - w[0]) / (w[3] - w[0]), (w[2] - w[0]) / (w[3] - w[0])
    z0, z1 = base_2[2] + depths[0] * along_2[2], base_2[2] + depths[3] * along_2[2]
    rises = s_u > LEAST_STEP and s_v - s_u > LEAST_STEP and 1 - s_v > LEAST_STEP
    if not (rises and abs(w[3] - w[0]) > LEAST_RANGE_PX and z0 > 0 and z1 > 0):
        c[:] = np.nan  # or C2 does not see all of it
        return
    bend = (base_p[2] + depths[0] * along_p[2]) / (base_p[2] + depths[3] * along_p[2])
    c[START], c[PER_W], c[DEPTH_0], c[DEPTH_BEND] = w[0], 1 / (w[3] - w[0]), depths[0], bend
    u, v = _projective(s_u, bend)[0], _projective(s_v, bend)[0]
    c[DEPTH_RISE], c[DEPTH_A], c[DEPTH_B] = _through(
        u, v, depths[0], depths[1], depths[2], depths[3]
    )
    c[BEND] = bend * z1 / z0
    u, v = _projective(s_u, c[BEND])[0], _projective(s_v, c[BEND])[0]
    x0, y0 = pixel(base_2, along_2, depths[0], lens_2)
    xu, yu = pixel(base_2, along_2, depths[1], lens_2)
    xv, yv = pixel(base_2, along_2, depths[2], lens_2)
    x1, y1 = pixel(base_2, along_2, depths[3], lens_2)
    c[X_0], c[Y_0] = x0, y0
    c[X_RISE], c[X_A], c[X_B] = _through(u, v, x0, xu, xv, x1)
    c[Y_RISE], c[Y_A], c[Y_B] = _through(u, v, y0, yu, yv, y1)


@njit(cache=True, error_model="numpy")
def _span(w, span):  # type: ignore[no-untyped-def]
    """Write the least and the largest w of points of a ray; NaN where one is not known.

    Fringes that nearly follow the epipolar lines may turn round on the segment.
    """
    span[0], span[1] = w[0], w[0]
    for value in w:
        span[0], span[1] = min(span[0], value), max(span[1], value)
        if math.isnan(value):
            span[:] = np.nan
            return


@njit(cache=True, nogil=True, error_model="numpy")
def span_of(ends, along_p, projector, span, rows):  # type: ignore[no-untyped-def]
    """Write the least and the largest w, (n, 2) px, on parts of viewing rays; see `trace`."""
    base_p, lens_p, axis = projector
    for i in range(rows[0], rows[1]):
        least, largest, total = np.inf, -np.inf, 0.0
        for k in range(3):
            t = ends[i, 0] + 0.5 * k * (ends[i, 1] - ends[i, 0])
            w = across(base_p, along_p[i], t, lens_p, axis)
            least, largest, total = min(least, w), max(largest, w), total + w
        known = not math.isnan(total)
        span[i, 0], span[i, 1] = least if known else np.nan, largest if known else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def trace(ends, along_p, along_2, projector, camera2, curves, span, rows):  # type: ignore[no-untyped-def]
    """Write the curves (n, N_CURVE) of parts of viewing rays, NaN where they are no such curves.

    ends (n, 2): mm; along_p, along_2 (n, 3): the rays in the frames of projector and C2; projector
    = (base (3,), lens, axis (2,)), camera2 = (base (3,), lens). Writes span (n, 2): least and
    largest w on the part; NaN where the projector does not light all of it.
    """
    base_p, lens_p, axis = projector
    for i in range(rows[0], rows[1]):
        near, third = ends[i, 0], (ends[i, 1] - ends[i, 0]) / 3
        depths = (near, near + third, near + 2 * third, ends[i, 1])
        w = (
            across(base_p, along_p[i], depths[0], lens_p, axis),
            across(base_p, along_p[i], depths[1], lens_p, axis),
            across(base_p, along_p[i], depths[2], lens_p, axis),
            across(base_p, along_p[i], depths[3], lens_p, axis),
        )
        _span(w, span[i])
        _fit(w, depths, along_p[i], along_2[i], projector, camera2, curves[i])
