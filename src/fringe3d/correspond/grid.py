"""Valid pixels of an image or of a part of it: their numbers, and the phase between neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _joining
from fringe3d.kernels import over_rows

SMOOTH_RAD, SMOOTH_SIGMA = 0.1, 3.0
"""Second difference of the phase on a surface: curvature, and noise."""

STEEPEST_RAD = 2.0
"""Between neighbours; beyond, the phase may as well fall as rise."""


def numbers_of(
    valid: NDArray[np.bool_], stride: tuple[int, int], n_cols: int, /
) -> NDArray[np.int32]:
    """Return the numbers in the whole image, (n,), of the valid pixels of a part of it."""
    where = np.flatnonzero(valid).astype(np.int32)
    if stride == (1, 1):
        return where
    rows, cols = np.divmod(where, np.int32(valid.shape[1]))
    return np.asarray(rows * (stride[0] * n_cols) + cols * stride[1], np.int32)


def index_of(valid: NDArray[np.bool_], /) -> NDArray[np.int32]:
    """Return the number of each valid pixel of a grid, -1 for the others."""
    index = np.full(valid.shape, -1, np.int32)
    index[valid] = np.arange(int(valid.sum()), dtype=np.int32)
    return index


def rises_of(
    phase: NDArray[np.float32], valid: NDArray[np.bool_], sigma: NDArray[np.float32], /
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the phase from each pixel to the next row and column, wrapped, and where it is smooth.

    Parameters
    ----------
    phase : (row, col) float32, rad; NaN where not valid
    valid : (row, col) bool
    sigma : (n,) float32, rad; standard deviation of the phase of the valid pixels

    Returns
    -------
    rises : (2, row, col) float32, rad; NaN where there is none
    smooth : (2, row, col) bool; whether it is that of one surface
    """
    noise = np.full(valid.shape, np.nan, np.float32)
    noise[valid] = sigma
    shape = (2, *valid.shape)
    rises, smooth = np.empty(shape, np.float32), np.empty(shape, np.bool_)
    limits = SMOOTH_RAD, SMOOTH_SIGMA * np.sqrt(6), STEEPEST_RAD
    over_rows(_joining.write_rises, len(phase), phase, noise, limits, rises, smooth)
    return rises, smooth


def spread(where: NDArray[np.bool_], reach_px: int, /) -> NDArray[np.bool_]:
    """Return the pixels within so many rows and columns of some.

    Examples
    --------
    >>> spread(np.array([[False, False, False, True]]), 2).tolist()
    [[False, True, True, True]]
    """
    for axis in (0, 1):
        source = np.moveaxis(where, axis, 0)
        image = source.copy()
        for step in range(1, min(reach_px, len(image) - 1) + 1):
            image[step:] |= source[:-step]
            image[:-step] |= source[step:]
        where = np.moveaxis(image, 0, axis)
    return where
