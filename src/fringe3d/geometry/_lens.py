"""OpenCV's lens model and its inverse, compiled, for one point at a time.

Equations: OpenCV documentation, "Camera Calibration and 3D Reconstruction": radial (k1-k6),
tangential (p1, p2), thin prism (s1-s4) and tilted sensor (tau_x, tau_y).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CONTINUATION_STEPS = 8
"""Steps in which the inverse walks from the image centre out to the pixel, so that it stays on
the branch on which the lens maps one to one."""

NEWTON_STEPS = 12
"""Upper bound; quadratic convergence needs 3-5."""

STEP_TOLERANCE = 1e-13
"""Normalised units: 1e-9 px or less for any focal length below 10 000 px."""

SCAN_RADIUS = 2.0
"""Normalised units, 63 deg off the axis: how far folds of the lens are searched beforehand."""

SCAN_STEPS = 256
SCAN_DIRECTIONS = 32

PATH_STEPS = 64
"""Points between the centre and a solution beyond the scanned radius that must be one to one."""


@njit(cache=True)
def lens_vector(focal, center, distortion):  # type: ignore[no-untyped-def]
    """Pack fx fy cx cy, 12 polynomial coefficients and the 3 x 3 tilt into one vector."""
    lens = np.zeros(25)
    lens[0:2], lens[2:4], lens[4:16] = focal, center, distortion[:12]
    ca, sa = math.cos(distortion[12]), math.sin(distortion[12])
    cb, sb = math.cos(distortion[13]), math.sin(distortion[13])
    rotation = np.array([[cb, 0.0, -sb], [0.0, 1.0, 0.0], [sb, 0.0, cb]]) @ np.array(
        [[1.0, 0.0, 0.0], [0.0, ca, sa], [0.0, -sa, ca]]
    )
    onto_sensor = np.array(
        [
            [rotation[2, 2], 0.0, -rotation[0, 2]],
            [0.0, rotation[2, 2], -rotation[1, 2]],
            [0.0, 0.0, 1.0],
        ]
    )
    lens[16:25] = (onto_sensor @ rotation).ravel()
    return lens


@njit(cache=True, error_model="numpy", inline="always")
def distort(x, y, lens):  # type: ignore[no-untyped-def]
    """Map undistorted to distorted normalised coordinates (before the tilt), with Jacobian."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (
        lens[4], lens[5], lens[6], lens[7], lens[8], lens[9], lens[10], lens[11],
    )  # fmt: skip
    r2 = x * x + y * y
    upper = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    lower = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    d_upper = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    d_lower = k4 + r2 * (2 * k5 + 3 * r2 * k6)
    radial = upper / lower
    slope = (d_upper - radial * d_lower) / lower  # d radial / d r2
    prism_x, prism_y = r2 * (lens[12] + r2 * lens[13]), r2 * (lens[14] + r2 * lens[15])
    d_prism_x, d_prism_y = lens[12] + 2 * r2 * lens[13], lens[14] + 2 * r2 * lens[15]
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + prism_x
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + prism_y
    jxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + 2 * x * d_prism_x
    jxy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y + 2 * y * d_prism_x
    jyx = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y + 2 * x * d_prism_y
    jyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + 2 * y * d_prism_y
    return xd, yd, jxx, jxy, jyx, jyy


@njit(cache=True, error_model="numpy", inline="always")
def project_normalized(x, y, lens):  # type: ignore[no-untyped-def]
    """Map undistorted normalised coordinates to a pixel (x, y)."""
    xd, yd, _, _, _, _ = distort(x, y, lens)
    w = lens[22] * xd + lens[23] * yd + lens[24]
    xt = (lens[16] * xd + lens[17] * yd + lens[18]) / w
    yt = (lens[19] * xd + lens[20] * yd + lens[21]) / w
    return lens[0] * xt + lens[2], lens[1] * yt + lens[3]


@njit(cache=True, error_model="numpy")
def _newton(x, y, target_x, target_y, lens):  # type: ignore[no-untyped-def]
    for _ in range(NEWTON_STEPS):
        xd, yd, jxx, jxy, jyx, jyy = distort(x, y, lens)
        det = jxx * jyy - jxy * jyx
        if not det > 0:  # beyond the fold of the lens, or NaN: no one-to-one inverse here
            return np.nan, np.nan
        ex, ey = target_x - xd, target_y - yd
        dx, dy = (jyy * ex - jxy * ey) / det, (jxx * ey - jyx * ex) / det
        x, y = x + dx, y + dy
        if abs(dx) + abs(dy) < STEP_TOLERANCE:
            return x, y
    return np.nan, np.nan


@njit(cache=True, error_model="numpy")
def _keeps_order(x, y, lens):  # type: ignore[no-untyped-def]
    """Tell whether the lens neither folds nor mirrors at a point, nor lies it beyond a pole."""
    _, _, jxx, jxy, jyx, jyy = distort(x, y, lens)
    r2 = x * x + y * y
    lower = 1 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11]))
    return lower > 0 and jxx * jyy - jxy * jyx > 0 and jxx + jyy > 0


@njit(cache=True, error_model="numpy")
def safe_radius(lens):  # type: ignore[no-untyped-def]
    """Return the normalised radius inside which the lens folds in no direction."""
    step = SCAN_RADIUS / SCAN_STEPS
    for i in range(1, SCAN_STEPS + 1):
        for j in range(SCAN_DIRECTIONS):
            azimuth = 2 * math.pi * j / SCAN_DIRECTIONS
            if not _keeps_order(i * step * math.cos(azimuth), i * step * math.sin(azimuth), lens):
                return (i - 1) * step
    return SCAN_RADIUS


@njit(cache=True, error_model="numpy")
def _on_branch(x, y, lens, safe):  # type: ignore[no-untyped-def]
    """Tell whether no fold of the lens lies between the image centre and a solution."""
    radius = math.sqrt(x * x + y * y)
    if radius <= safe:
        return True
    for i in range(1, PATH_STEPS + 1):
        part = i / PATH_STEPS
        if part * radius > safe and not _keeps_order(part * x, part * y, lens):
            return False
    return not math.isnan(radius)


@njit(cache=True, error_model="numpy")
def normalize_pixel(u, v, lens, safe):  # type: ignore[no-untyped-def]
    """Invert `project_normalized`; NaN where the lens model has no one-to-one inverse."""
    # Undo the tilt: an exact homography, solved by Cramer's rule.
    xt, yt = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
    a, b = lens[16] - xt * lens[22], lens[17] - xt * lens[23]
    c, d = lens[19] - yt * lens[22], lens[20] - yt * lens[23]
    e, f = xt * lens[24] - lens[18], yt * lens[24] - lens[21]
    det = a * d - b * c
    xd, yd = (e * d - b * f) / det, (a * f - c * e) / det
    x, y = _newton(xd, yd, xd, yd, lens)
    # A start at the distorted point may land beyond a fold: then walk there from the centre.
    if not _on_branch(x, y, lens, safe):
        x, y = 0.0, 0.0
        for step in range(1, CONTINUATION_STEPS + 1):
            part = step / CONTINUATION_STEPS
            x, y = _newton(x, y, part * xd, part * yd, lens)
        if not _on_branch(x, y, lens, safe):
            x, y = np.nan, np.nan
    return x, y


@njit(cache=True, nogil=True, error_model="numpy")
def project_all(points, pose, lens, pixels, rows):  # type: ignore[no-untyped-def]
    """Project (n, 3) points of the world; NaN behind the device. pose (12,): its translation and
    rotation, of the device from the world."""
    x0, y0, z0, xx, xy, xz, yx, yy, yz, zx, zy, zz = pose
    for i in range(rows[0], rows[1]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        z = zx * a + zy * b + zz * c + z0
        if z > 0:
            x, y = xx * a + xy * b + xz * c + x0, yx * a + yy * b + yz * c + y0
            pixels[i, 0], pixels[i, 1] = project_normalized(x / z, y / z, lens)
        else:
            pixels[i, 0], pixels[i, 1] = np.nan, np.nan


@njit(cache=True, nogil=True)
def normalize_all(pixels, lens, normalized, rows):  # type: ignore[no-untyped-def]
    """Undistort (n, 2) pixels to normalised coordinates."""
    safe = safe_radius(lens)
    for i in range(rows[0], rows[1]):
        x, y = normalize_pixel(pixels[i, 0], pixels[i, 1], lens, safe)
        normalized[i, 0], normalized[i, 1] = x, y
