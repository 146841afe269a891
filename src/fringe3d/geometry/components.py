"""Neighbours joined to connected parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry._union import join


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
