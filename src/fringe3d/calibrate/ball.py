"""A ball in a cloud of points: its centre is a mark that no pixel has to hit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import EmptyResultError

Floats = NDArray[np.float64]

SEED_PX = 12.0
"""Around the pixel that was named: points that belong to the ball."""

LEAST_POINTS = 60
ROUNDS = 30
FAR = 4.0
"""Robust standard deviations from the sphere: a point beyond is another surface's."""

LARGEST_SIGMA = 0.02
"""Part of the radius: what leaves its sphere by more is no ball."""

LEAST_WIDTH = 0.7
"""Of the radius: less of a sphere might be any surface."""

MAD_TO_SIGMA = 1.4826


def ball_center(points_mm: Floats, pixels: Floats, at_px: tuple[float, float], /) -> Floats:
    """Return the centre of the ball that is seen at a pixel.

    Parameters
    ----------
    points_mm : (n, 3) float, mm
    pixels : (n, 2) float, px; where they are seen, (x, y)
    at_px : (x, y), px; on the ball, at least 12 px inside its rim

    Returns
    -------
    (3,) float64, mm

    Raises
    ------
    EmptyResultError
        If there are too few points, or they do not lie on a sphere.

    Notes
    -----
    The sphere of the points around the pixel grows: those near it are added, and it is fitted anew,
    until nothing changes.
    """
    known = np.isfinite(points_mm).all(axis=1)
    points, places = points_mm[known], pixels[known]
    own = np.linalg.norm(places - np.asarray(at_px), axis=1) < SEED_PX
    where = f"ball at pixel {at_px} (x, y) of C1"
    for _ in range(ROUNDS):
        if int(own.sum()) < LEAST_POINTS:
            raise EmptyResultError(
                f"{where}: expected {LEAST_POINTS} points on it at least, found {int(own.sum())}"
            )
        center, radius = _sphere(points[own])
        off = np.linalg.norm(points - center, axis=1) - radius
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(off[own])))
        before, own = own, np.abs(off) < FAR * max(sigma, 1e-6 * radius)
        if np.array_equal(before, own):
            break
    wide = float(np.ptp(points[before], axis=0).max())
    if not (sigma < LARGEST_SIGMA * radius and wide > LEAST_WIDTH * radius):
        raise EmptyResultError(
            f"{where}: expected a sphere, found {wide:.3g} mm of points {sigma:.2g} mm off one "
            f"with a radius of {radius:.3g} mm. Name a pixel in the middle of a ball"
        )
    return center


def _sphere(points: Floats) -> tuple[Floats, float]:
    """Return centre and radius of the sphere through points (n, 3), least squares of distances."""
    middle = points.mean(axis=0)
    near = points - middle
    linear, *_ = np.linalg.lstsq(
        np.column_stack([2 * near, np.ones(len(near))]), (near**2).sum(axis=1), rcond=None
    )
    center, radius = linear[:3], float(np.sqrt(max(linear[3] + linear[:3] @ linear[:3], 1e-12)))
    for _ in range(5):
        away = near - center
        distance = np.linalg.norm(away, axis=1)
        slopes = np.column_stack([-away / distance[:, None], -np.ones(len(near))])
        step, *_ = np.linalg.lstsq(slopes, radius - distance, rcond=None)
        center, radius = center + step[:3], radius + float(step[3])
    return np.asarray(middle + center), radius
