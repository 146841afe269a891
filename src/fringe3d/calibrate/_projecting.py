"""The image of a point in the device frame, with its derivatives, for many points at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def image_and_slopes(points: Floats, lens: Floats, /) -> tuple[Floats, Floats, Floats]:
    """Return pixels and their derivatives.

    Parameters
    ----------
    points : (m, 3), mm, device frame, z > 0
    lens : (12,); fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6

    Returns
    -------
    (m, 2) px; (m, 2, 3) by the point, px / mm; (m, 2, 12) by the lens
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = lens
    z = points[:, 2]
    x, y = points[:, 0] / z, points[:, 1] / z
    r2 = x * x + y * y
    upper = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    lower = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = upper / lower
    slope = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / lower
    xy2, xx, yy = 2 * x * y, r2 + 2 * x * x, r2 + 2 * y * y
    bent_x, bent_y = x * radial + p1 * xy2 + p2 * xx, y * radial + p1 * yy + p2 * xy2
    cross = xy2 * slope + 2 * p1 * x + 2 * p2 * y
    by_x = np.stack([radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x, cross], axis=1)
    by_y = np.stack([cross, radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x], axis=1)
    focal = np.array([fx, fy])
    by_point = np.empty((len(z), 2, 3))
    by_point[:, :, 0], by_point[:, :, 1] = focal * by_x / z[:, None], focal * by_y / z[:, None]
    by_point[:, :, 2] = -(by_point[:, :, 0] * x[:, None] + by_point[:, :, 1] * y[:, None])

    by_lens = np.zeros((len(z), 2, 12))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = bent_x, bent_y
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1
    power = r2 / lower
    for number, ratio in ((4, power), (5, power * r2), (8, power * r2 * r2)):
        by_lens[:, 0, number], by_lens[:, 1, number] = fx * x * ratio, fy * y * ratio
    for number in range(3):
        ratio = -radial * power * r2**number
        by_lens[:, 0, 9 + number], by_lens[:, 1, 9 + number] = fx * x * ratio, fy * y * ratio
    by_lens[:, 0, 6], by_lens[:, 1, 6] = fx * xy2, fy * yy
    by_lens[:, 0, 7], by_lens[:, 1, 7] = fx * xx, fy * xy2
    pixels = np.stack([fx * bent_x + cx, fy * bent_y + cy], axis=1)
    return pixels, by_point, by_lens


def image(points: Floats, lens: Floats, /) -> Floats:
    """Return the pixels alone; see `image_and_slopes`."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = lens
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bent_x = x * radial + p1 * 2 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + p2 * 2 * x * y
    return np.stack([fx * bent_x + cx, fy * bent_y + cy], axis=1)


def skew(vectors: Floats, /) -> Floats:
    """Return the matrices of cross products, (m, 3, 3): ``skew(a) @ b`` is ``a x b``."""
    x, y, z = vectors.T
    matrix = np.zeros((len(vectors), 3, 3))
    matrix[:, 2, 1], matrix[:, 0, 2], matrix[:, 1, 0] = x, y, z
    matrix[:, 1, 2], matrix[:, 2, 0], matrix[:, 0, 1] = -x, -y, -z
    return matrix
