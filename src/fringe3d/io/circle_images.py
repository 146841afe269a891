"""Centres and areas of the circles of a board in an image, to a hundredth of a pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

REACH = 0.5
"""Of the gap to the nearest circle: half of the window around one."""

ROUNDS = 3

WIDEST = 1.2
"""Half of the longer axis over the radius of a circle as large: tilted by 45 degrees."""

BEYOND_PX = 2.0
"""Beside the rim, where blur mixes circle and background."""

CORE = 0.6
"""Part of the radius within which the circle has its own brightness."""

MIN_PIXELS = 12


def measured_circles(
    image: NDArray[np.unsignedinteger[Any]], pixels: Floats, /
) -> tuple[Floats, Floats]:
    """Return the centres of mass of circles, and their areas.

    Parameters
    ----------
    image : (row, col) uint8 or uint16
    pixels : (n, 2), px, (x, y); about where the circles lie, three at least

    Returns
    -------
    (n, 2), px, and (n,), px^2
        Where a circle cannot be measured: the place that was given, and NaN.

    Notes
    -----
    Each pixel counts by its brightness between that of the background, a plane through what lies
    around the circle, and that of the middle of the circle.
    """
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=2)
    np.fill_diagonal(apart, np.inf)
    found = [
        _measured(np.asarray(image, np.float64), place, REACH * gap)
        for place, gap in zip(pixels, apart.min(axis=1), strict=True)
    ]
    return np.array([place for place, _ in found]), np.array([area for _, area in found])


def _measured(image: Floats, place: Floats, reach: float) -> tuple[Floats, float]:
    """Return the centre and the area of one circle."""
    rows, cols = image.shape
    x0, y0 = np.maximum(np.ceil(place - reach), 0).astype(int)
    x1, y1 = np.minimum(np.floor(place + reach), [cols - 1, rows - 1]).astype(int)
    y, x = np.mgrid[y0 : y1 + 1, x0 : x1 + 1]
    grey = image[y0 : y1 + 1, x0 : x1 + 1].ravel()
    at = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    radius, center, area = 0.5 * reach, place, np.nan
    for _ in range(ROUNDS):
        away = np.linalg.norm(at - center, axis=1)
        core = away < max(CORE * radius, 1.0)
        around = (away > min(WIDEST * radius + BEYOND_PX, 0.85 * reach)) & (away < 1.2 * reach)
        if min(core.sum(), around.sum()) < MIN_PIXELS // 4:
            return place, np.nan
        inner = float(np.median(grey[core]))
        part = _part(grey, at, around, inner)
        own = away < WIDEST * radius + BEYOND_PX if np.isfinite(area) else part > 0.5
        weight = np.where(own, part, 0.0)
        area = float(weight.sum())
        if not area > MIN_PIXELS / 2:
            return place, np.nan
        center = (weight[:, None] * at).sum(axis=0) / area
        radius = float(np.sqrt(area / np.pi))
    if np.linalg.norm(center - place) > reach:
        return place, np.nan
    return center, area


def _part(grey: Floats, at: Floats, around: NDArray[np.bool_], inner: float) -> Floats:
    """Return how much of the way from the background to the circle each pixel is."""
    terms = np.column_stack([np.ones(len(at)), at - at.mean(axis=0)])
    plane, *_ = np.linalg.lstsq(terms[around], grey[around], rcond=None)
    background = terms @ plane
    circle = np.full(len(at), inner)
    if inner < background.mean():
        # The light on a dark circle varies as that on the background; what little a dark
        # background shows, strays.
        circle *= background / background.mean()
    between = background - circle
    return np.asarray((background - grey) / np.where(np.abs(between) < 1e-9, np.inf, between))
