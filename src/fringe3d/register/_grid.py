"""Surfaces on the grid of a camera, compiled: normals, and where other points lie on them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.kernels import HELPER

RADIUS = 2
"""Normals are those of planes through windows of 5 x 5 pixels."""

LEAST = 6
"""Points of a window that must belong to the surface."""


@njit(**HELPER)
def _across_plane(n, steps, p, x, y):  # type: ignore[no-untyped-def]
    """Return a vector across the plane through n neighbours, zero where they lie on a line.

    steps: sums of dx, dy, dx dx, dx dy and dy dy over the neighbours; p, x, y (3,): sums of their
    places, and of dx and dy times these.
    """
    sx, sy, sxx, sxy, syy = steps
    cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    if not cxx * cyy - cxy * cxy > 0.5 * n:
        return 0.0, 0.0, 0.0
    x0, x1, x2 = x[0] - sx * p[0] / n, x[1] - sx * p[1] / n, x[2] - sx * p[2] / n
    y0, y1, y2 = y[0] - sy * p[0] / n, y[1] - sy * p[1] / n, y[2] - sy * p[2] / n
    u0, u1, u2 = cyy * x0 - cxy * y0, cyy * x1 - cxy * y1, cyy * x2 - cxy * y2
    v0, v1, v2 = cxx * y0 - cxy * x0, cxx * y1 - cxy * x1, cxx * y2 - cxy * x2
    return u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0


@njit(cache=True, nogil=True, error_model="numpy")
def grid_normals(points, center, reach, normals, rows):  # type: ignore[no-untyped-def]
    """Write unit normals towards `center`; NaN where too few neighbours lie within `reach`.

    `reach` is the largest distance for each pixel of distance.
    """
    n_rows, n_cols = points.shape[:2]
    for row in range(rows[0], rows[1]):
        for col in range(n_cols):
            normals[row, col, 0] = normals[row, col, 1] = normals[row, col, 2] = np.nan
            if math.isnan(points[row, col, 0]):
                continue
            n = 0
            sx = sy = sxx = sxy = syy = 0.0
            p0 = p1 = p2 = x0 = x1 = x2 = y0 = y1 = y2 = 0.0
            for dy in range(-RADIUS, RADIUS + 1):
                for dx in range(-RADIUS, RADIUS + 1):
                    r, c = row + dy, col + dx
                    if r < 0 or c < 0 or r >= n_rows or c >= n_cols:
                        continue
                    a = points[r, c, 0] - points[row, col, 0]
                    b = points[r, c, 1] - points[row, col, 1]
                    d = points[r, c, 2] - points[row, col, 2]
                    far = reach * max(abs(dx), abs(dy), 1)
                    if not a * a + b * b + d * d <= far * far:
                        continue
                    n += 1
                    sx += dx
                    sy += dy
                    sxx += dx * dx
                    sxy += dx * dy
                    syy += dy * dy
                    p0 += a
                    p1 += b
                    p2 += d
                    x0 += dx * a
                    x1 += dx * b
                    x2 += dx * d
                    y0 += dy * a
                    y1 += dy * b
                    y2 += dy * d
            if n < LEAST:
                continue
            n0, n1, n2 = _across_plane(
                n, (sx, sy, sxx, sxy, syy), (p0, p1, p2), (x0, x1, x2), (y0, y1, y2)
            )
            length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            if not length > 0:
                continue
            towards = (
                n0 * (center[0] - points[row, col, 0])
                + n1 * (center[1] - points[row, col, 1])
                + n2 * (center[2] - points[row, col, 2])
            )
            length = length if towards > 0 else -length
            normals[row, col, 0] = n0 / length
            normals[row, col, 1] = n1 / length
            normals[row, col, 2] = n2 / length


@njit(cache=True, nogil=True, error_model="numpy")
def land(points, pixels, grid, normals, sigma, center, reach, out, rows):  # type: ignore[no-untyped-def]
    """Find the surface on which points land, seen from the camera of the grid.

    `out` (n, 8) gets, where the four pixels around have a point and belong together: the distance
    of the point along the surface's normal, this normal, the standard deviation of the surface
    along it, how much farther the point lies on the ray than the surface, the cosine between ray
    and normal, and the length of the mean of the four normals: less than 1 where the surface bends.
    Else all are NaN, but how much farther it lies: where a pixel next to it has a nearer point,
    and where all four lie behind it. One alone that lies behind is what is seen past an outline.
    """
    n_rows, n_cols = grid.shape[:2]
    for k in range(rows[0], rows[1]):
        for i in range(8):
            out[k, i] = np.nan
        x, y = pixels[k, 0], pixels[k, 1]
        if not (x >= 0 and y >= 0 and x < n_cols - 1 and y < n_rows - 1):
            continue
        c, r = int(x), int(y)
        fx, fy = x - c, y - r
        p0 = p1 = p2 = m0 = m1 = m2 = variance = planes = 0.0
        d0, d1, d2 = points[k, 0] - center[0], points[k, 1] - center[1], points[k, 2] - center[2]
        range_ = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        d0, d1, d2 = d0 / range_, d1 / range_, d2 / range_
        is_whole = has_all = True
        nearest = np.nan
        for corner in range(4):
            rr, cc = r + corner // 2, c + corner % 2
            w = (fy if corner // 2 else 1 - fy) * (fx if corner % 2 else 1 - fx)
            a, b, d = grid[rr, cc, 0], grid[rr, cc, 1], grid[rr, cc, 2]
            if math.isnan(a):
                is_whole = has_all = False
                continue
            depth = (a - center[0]) * d0 + (b - center[1]) * d1 + (d - center[2]) * d2
            if math.isnan(nearest) or abs(range_ - depth) < abs(nearest):
                nearest = range_ - depth
            e0, e1, e2 = a - grid[r, c, 0], b - grid[r, c, 1], d - grid[r, c, 2]
            is_near = e0 * e0 + e1 * e1 + e2 * e2 <= 2 * reach * reach
            if not is_near or math.isnan(normals[rr, cc, 0]):
                is_whole = False
                continue
            p0 += w * a
            p1 += w * b
            p2 += w * d
            m0 += w * normals[rr, cc, 0]
            m1 += w * normals[rr, cc, 1]
            m2 += w * normals[rr, cc, 2]
            planes += w * (
                normals[rr, cc, 0] * (points[k, 0] - a)
                + normals[rr, cc, 1] * (points[k, 1] - b)
                + normals[rr, cc, 2] * (points[k, 2] - d)
            )
            variance += w * w * sigma[rr, cc] * sigma[rr, cc]
        if has_all or nearest >= 0:
            out[k, 5] = nearest
        if not is_whole:
            continue
        length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        m0, m1, m2 = m0 / length, m1 / length, m2 / length
        cosine = abs(m0 * d0 + m1 * d1 + m2 * d2)
        chord = (points[k, 0] - p0) * m0 + (points[k, 1] - p1) * m1 + (points[k, 2] - p2) * m2
        # Chords lie below a curved surface by as much as tangent planes lie above it.
        out[k, 0] = (chord + planes) / 2
        out[k, 1], out[k, 2], out[k, 3] = m0, m1, m2
        out[k, 4] = math.sqrt(variance) * cosine
        out[k, 6] = cosine
        out[k, 7] = length


@njit(cache=True, nogil=True, error_model="numpy")
def gather(found, places, own_sigma, weight, scale, limit, floor, sums):  # type: ignore[no-untyped-def]
    """Add up the normal equations of a pair: 21 of the matrix, 6 of the vector, 3 of the cost.

    `found` is what `land` wrote, with normals in the body frame; `places` (n, 3) are the points
    there, less the body's middle. Tukey's weights of `scale` times the standard deviation.
    """
    row = np.empty(6)
    for k in range(len(found)):
        r = found[k, 0]
        if not abs(r) <= limit:
            continue
        variance = own_sigma[k] * own_sigma[k] + found[k, 4] * found[k, 4] + floor * floor
        part = r * r / (variance * scale * scale)
        if not part < 1.0:
            continue
        robust = (1 - part) * (1 - part)
        w = weight[k] * robust / variance
        n0, n1, n2 = found[k, 1], found[k, 2], found[k, 3]
        x, y, z = places[k, 0], places[k, 1], places[k, 2]
        row[0], row[1], row[2] = y * n2 - z * n1, z * n0 - x * n2, x * n1 - y * n0
        row[3], row[4], row[5] = n0, n1, n2
        m = 0
        for i in range(6):
            for j in range(i, 6):
                sums[m] += w * row[i] * row[j]
                m += 1
        for i in range(6):
            sums[21 + i] += w * row[i] * r
        sums[27] += w * r * r
        sums[28] += weight[k] * robust
        sums[29] += 1
