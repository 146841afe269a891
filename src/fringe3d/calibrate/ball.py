"""A ball in a cloud of points: its centre is a mark that no pixel has to hit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import EmptyResultError
from fringe3d.evaluate import algebraic_sphere, settled

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
        sphere = settled(algebraic_sphere(points[own]), points[own])
        off, radius = sphere.distances(points), sphere.radius_mm
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
    return sphere.center_mm
