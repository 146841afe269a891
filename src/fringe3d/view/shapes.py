"""Surfaces between pixels, and sheets of light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import rays
from fringe3d.model import Device

GAP_FACTOR = 8.0
"""Of the median distance of neighbours: surfaces that slope by up to 83 degrees hang together."""

SHEET_PARTS = 33


def grid_triangles(points_mm: NDArray[np.float64], /) -> NDArray[np.int64]:
    """Return triangles (n, 3) between neighbouring pixels with points; none across gaps.

    Parameters
    ----------
    points_mm : (row, col, 3) float, mm; NaN where there are none

    Returns
    -------
    (n, 3) int
        Flat places, ``row * n_cols + col``. An edge longer than `GAP_FACTOR` typical ones is none.

    Examples
    --------
    >>> y, x = np.mgrid[:2, :3].astype(float)
    >>> points = np.stack([x, y, np.where(x == 2, 500.0, 0.0)], axis=-1)
    >>> grid_triangles(points).tolist()
    [[0, 3, 1], [1, 3, 4]]
    """
    n_rows, n_cols = points_mm.shape[:2]
    places = np.arange(n_rows * n_cols).reshape(n_rows, n_cols)
    corners = [places[:-1, :-1], places[1:, :-1], places[:-1, 1:], places[1:, 1:]]
    a, b, c, d = (part.ravel() for part in corners)
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    flat = points_mm.reshape(-1, 3)
    sides = np.linalg.norm(flat[triangles] - flat[np.roll(triangles, 1, axis=1)], axis=-1)
    longest = sides.max(axis=1)  # NaN where a corner is missing
    if not np.isfinite(longest).any():
        return np.empty((0, 3), np.int64)
    kept: NDArray[np.int64] = triangles[longest <= GAP_FACTOR * np.nanmedian(sides)]
    return kept


def light_sheet(
    projector: Device, position_px: float, angle: float, length_mm: float, /
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sheet that the projector throws with one coordinate across the fringes.

    Parameters
    ----------
    projector : Device
    position_px : float, projector px; w, see `fringe3d.model.Fringe`
    angle : float, rad; of the fringes
    length_mm : float; how far it is drawn

    Returns
    -------
    (n, 3) float, mm, and (n - 2, 3) int
        A fan of triangles from the centre of projection.
    """
    along = np.linspace(-1, 1, SHEET_PARTS) * np.hypot(*projector.shape)
    across, length = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    middle = (np.array([projector.n_cols, projector.n_rows]) / 2) @ length
    pixels = position_px * across + (middle + along / 2)[:, None] * length - 0.5
    low, high = -0.5, np.array([projector.n_cols, projector.n_rows]) - 0.5
    pixels = pixels[((pixels >= low - 1) & (pixels <= high + 1)).all(axis=1)]
    if len(pixels) < 2:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    origin, directions = rays(projector, pixels)
    tips = origin + length_mm * directions
    fan = [[0, i, i + 1] for i in range(1, len(tips))]
    return np.vstack([origin, tips]), np.array(fan, np.int64).reshape(-1, 3)
