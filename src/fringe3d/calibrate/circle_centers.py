"""Where the centres of circles are seen: not in the middle of their images.

A tilted circle is seen as an ellipse, and the nearer half of it larger: the middle of the ellipse
lies beside the image of the circle's centre, to the nearer side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._homography import homography
from fringe3d.model import Board

Floats = NDArray[np.float64]

MIN_CIRCLES = 6
"""For the homography; and as many areas for a median."""

LARGEST_PART = 0.5
"""Of the pitch: larger radii would touch."""


def circle_centers(
    board: Board, ids: NDArray[np.int64], middles: Floats, areas: Floats, /
) -> Floats:
    """Return where the centres of circles are seen.

    Parameters
    ----------
    board : Board; of circles
    ids : (n,) int; numbers of the circles
    middles : (n, 2), px; middles of their images
    areas : (n,), px^2; of their images, NaN where not known

    Returns
    -------
    (n, 2), px
        The middles, less the shift that perspective gives to each; as they are, where there are
        too few circles to tell.

    Notes
    -----
    The homography H of the plane maps a circle with the matrix C to the conic ``H^-T C H^-1``. Its
    middle is the pole of the line at infinity, ``H C^-1 H^T (0, 0, 1)``; Heikkilae and Silven
    (1997) for the effect. All circles are as large; their radius follows from the areas.
    """
    if int(np.isfinite(areas).sum()) < MIN_CIRCLES:
        return middles
    places = board.points_mm[ids, :2] / board.pitch_mm
    plane = homography(places, middles)
    depth = np.c_[places, np.ones(len(places))] @ plane[2]
    enlarged = np.abs(np.linalg.det(plane) / depth**3)
    radius = float(np.sqrt(np.nanmedian(areas / enlarged) / np.pi))
    if not radius < LARGEST_PART * _gap(board):
        return middles
    return np.asarray(middles - _shifts(plane, places, radius))


def _gap(board: Board) -> float:
    """Return the distance of neighbouring circles, pitches."""
    return float(np.sqrt(2)) if board.kind == "asymmetric-circles" else 1.0


def _shifts(plane: Floats, places: Floats, radius: float) -> Floats:
    """Return the middles of the ellipses less the images of the centres, (n, 2), px."""
    inverse = np.zeros((len(places), 3, 3))  # of the circles' matrices, times radius squared
    inverse[:, :2, :2] = radius**2 * np.eye(2) - places[:, :, None] * places[:, None, :]
    inverse[:, :2, 2] = inverse[:, 2, :2] = -places
    inverse[:, 2, 2] = -1.0
    pole = inverse @ plane[2] @ plane.T
    center = np.c_[places, np.ones(len(places))] @ plane.T
    return np.asarray(pole[:, :2] / pole[:, 2:] - center[:, :2] / center[:, 2:])
