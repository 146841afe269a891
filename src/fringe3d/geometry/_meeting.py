"""Where the viewing rays of homologous points meet, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.geometry._lens import normalize_pixel, project_normalized
from fringe3d.model import Rejection

DEPTH_STEP = 1e-4
"""Part of the depth by which a point is moved to find its speed in the other image."""

u2 = np.uint16
BEHIND, UNCERTAIN = u2(Rejection.BEHIND_DEVICE), u2(Rejection.UNCERTAIN)
MISS, OUTSIDE = u2(Rejection.RAYS_MISS), u2(Rejection.OUTSIDE_VOLUME)


@njit(cache=True, error_model="numpy")
def _ray(x, y, device):  # type: ignore[no-untyped-def]
    """Return the unit direction of a pixel's ray in the world frame."""
    _, rotation, lens, safe = device
    u, v = normalize_pixel(x, y, lens, safe)
    scale = 1 / math.sqrt(u * u + v * v + 1)
    return (
        (rotation[0, 0] * u + rotation[1, 0] * v + rotation[2, 0]) * scale,
        (rotation[0, 1] * u + rotation[1, 1] * v + rotation[2, 1]) * scale,
        (rotation[0, 2] * u + rotation[1, 2] * v + rotation[2, 2]) * scale,
    )


@njit(cache=True, error_model="numpy")
def _seen(p, device):  # type: ignore[no-untyped-def]
    """Return the pixel of a point of the world; NaN behind the device."""
    origin, r, lens, _ = device
    x, y, z = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
    depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
    if not depth > 0:
        return np.nan, np.nan
    return project_normalized(
        (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z) / depth,
        (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z) / depth,
        lens,
    )


@njit(cache=True, error_model="numpy")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def _speed(point, direction, t, device):  # type: ignore[no-untyped-def]
    """Return how fast the image of a point moves as it moves along its ray, px / mm."""
    step = DEPTH_STEP * t
    moved = (
        point[0] + step * direction[0],
        point[1] + step * direction[1],
        point[2] + step * direction[2],
    )
    x0, y0 = _seen(point, device)
    x1, y1 = _seen(moved, device)
    return math.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2) / step


@njit(cache=True, error_model="numpy")
def _contains(point, normals, offsets):  # type: ignore[no-untyped-def]
    inside = not math.isnan(point[0] + point[1] + point[2])
    for j in range(len(offsets)):
        height = normals[j, 0] * point[0] + normals[j, 1] * point[1] + normals[j, 2] * point[2]
        inside &= height <= offsets[j]
    return inside


@njit(cache=True, error_model="numpy")
def _middle(o1, a, o2, b):  # type: ignore[no-untyped-def]
    """Return the middle of the shortest line between two rays, its length, and both depths."""
    base = (o2[0] - o1[0], o2[1] - o1[1], o2[2] - o1[2])
    cosine, along_a, along_b = _dot(a, b), _dot(a, base), _dot(b, base)
    t = (along_a - cosine * along_b) / (1 - cosine * cosine)
    t2 = (cosine * along_a - along_b) / (1 - cosine * cosine)
    way = (
        t * a[0] - t2 * b[0] - base[0], t * a[1] - t2 * b[1] - base[1],
        t * a[2] - t2 * b[2] - base[2],
    )  # fmt: skip
    point = (
        o1[0] + t * a[0] - way[0] / 2, o1[1] + t * a[1] - way[1] / 2, o1[2] + t * a[2] - way[2] / 2,
    )  # fmt: skip
    return point, math.sqrt(_dot(way, way)), t, t2


@njit(cache=True, nogil=True, error_model="numpy")
def meet_all(  # type: ignore[no-untyped-def]
    pixels1, pixels2, sigma_px, residual, rays1, devices, volume, limits, todo, maps, rows
):
    """Write the middle of the shortest line between two rays for each pixel that is not rejected.

    pixels1, pixels2 (row, col, 2), sigma_px, residual (row, col), px; rays1 (row, col, 3):
    directions of the rays of whole pixels, (0, 0, 3) if not known; devices = two of (origin (3,),
    rotation from the world (3, 3), lens, radius in which it does not fold); volume = (normals
    (m, 3), offsets (m,)); limits = largest residual, px, and sigma, part of the depth; todo (row,
    col): the pixels that are asked for; rows: first and last but one. maps = (points (row, col, 3),
    sigma, skew (row, col), mm, all written, NaN where there is no point, rejection, to which
    reasons are added).
    """
    device1, device2 = devices
    points, sigma, skew, rejection = maps
    n_cols = rejection.shape[1]
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            if not todo[row, col]:
                continue
            reason = rejection[row, col]
            if reason == 0:
                x, y = pixels1[row, col, 0], pixels1[row, col, 1]
                if x == col and y == row and len(rays1) > 0:
                    a = (rays1[row, col, 0], rays1[row, col, 1], rays1[row, col, 2])
                else:
                    a = _ray(x, y, device1)
                b = _ray(pixels2[row, col, 0], pixels2[row, col, 1], device2)
                point, gap, t, t2 = _middle(device1[0], a, device2[0], b)
                noise = sigma_px[row, col] / _speed(point, a, t, device2)
                in_front = t > 0 and t2 > 0
                reason |= u2(0) if in_front else BEHIND
                reason |= UNCERTAIN if in_front and not noise <= limits[1] * abs(t) else u2(0)
                reason |= MISS if abs(residual[row, col]) > limits[0] else u2(0)
                reason |= u2(0) if _contains(point, volume[0], volume[1]) else OUTSIDE
                points[row, col, 0], points[row, col, 1], points[row, col, 2] = point
                sigma[row, col], skew[row, col] = noise, gap
                rejection[row, col] = reason
            if reason != 0:
                points[row, col, :] = np.nan
                sigma[row, col] = skew[row, col] = np.nan
