"""Points that stand out of the surface of their neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import _spikes
from fringe3d.kernels import over_rows


def stands_out(
    depth_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.floating[Any]],
    /,
    *,
    most_sigma: float,
    max_gap_mm: float,
) -> NDArray[np.bool_]:
    """Tell which points stand out of their surface along all lines through them, to the same side.

    Parameters
    ----------
    depth_mm : (row, col) float, mm; NaN where there is no point
    sigma_mm : (row, col) float, mm; their standard deviation
    most_sigma : float; standard deviations of the fourth difference along a line
    max_gap_mm : float, mm; neighbours of one surface are no further apart

    Examples
    --------
    >>> depth = np.zeros((9, 9))
    >>> depth[4, 4] = 1.0
    >>> np.argwhere(stands_out(depth, 0 * depth + 0.01, most_sigma=6, max_gap_mm=3)).tolist()
    [[4, 4]]
    """
    found = np.empty(depth_mm.shape, np.bool_)
    over_rows(_spikes.find_spikes, len(depth_mm), depth_mm, sigma_mm, most_sigma, max_gap_mm, found)
    return found
