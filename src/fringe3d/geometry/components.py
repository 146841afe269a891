"""Neighbours joined to connected parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry._union import join, measure_patches


def connected(
    start: NDArray[np.integer[Any]], end: NDArray[np.integer[Any]], n: int, /
) -> NDArray[np.intp]:
    """Return the number of the connected part of each of n nodes.

    Parameters
    ----------
    start, end : (m,) int; the nodes at both ends of each edge
    n : int

    Returns
    -------
    (n,) int; parts are numbered in the order of their first nodes

    Examples
    --------
    >>> connected(np.array([0, 3]), np.array([2, 4]), 5).tolist()
    [0, 1, 0, 2, 2]
    """
    label = np.empty(n, np.intp)
    join(np.asarray(start, np.intp), np.asarray(end, np.intp), label)
    return label


def patch_sizes(
    points_mm: NDArray[np.float64], max_gap_mm: float, reach_px: int, /
) -> NDArray[np.int32]:
    """Return how many pixels the surface patch of each pixel has.

    Parameters
    ----------
    points_mm : (row, col, 3) float, mm; NaN where there is no point
    max_gap_mm : float, mm; neighbours that are further apart are not joined
    reach_px : int, >= 1; how far apart, in rows and columns, neighbours may be; with 1 the four
        that share a side

    Returns
    -------
    (row, col) int32; 0 where there is no point

    Examples
    --------
    >>> row = np.array([[[0.0, 0, 9], [1.0, 0, 9], [5.0, 0, 9], [np.nan] * 3]])
    >>> patch_sizes(row, 2.0, 1).tolist()
    [[2, 2, 1, 0]]
    """
    sizes = np.empty(points_mm.shape[:2], np.int32)
    measure_patches(np.ascontiguousarray(points_mm), max_gap_mm, reach_px, sizes)
    return sizes
