"""Pieces of a surface that hang together by a few pixels alone, though phases say they differ."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.correspond import _whole
from fringe3d.kernels import over_rows

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

LEAST_SELF_SEAM = 8
"""Pixels of smooth phase across which one and the same part jumps by whole orders."""

CORE_PX = 2
"""What is no wider than twice this joins nothing."""


def cut_apart(parts: Ints, higher: NDArray[np.integer[Any]], is_smooth: Bools, /) -> Ints:
    """Cut parts that contradict themselves where they are thin.

    A surface cannot jump by a whole number of orders along a smooth line and be continuous around
    its end. If it seems to, a chain of pixels whose orders are neither one's joins two things.

    Parameters
    ----------
    parts : (row, col) int; number of the part of each pixel, -1 for none
    higher : (2, row, col) int; by how many orders the next row (column) is higher than the phase
        goes on
    is_smooth : (2, row, col) bool; whether the phase does so

    Returns
    -------
    (row, col) int; parts numbered anew, only those cut in which there is such a seam

    Examples
    --------
    >>> parts, higher = np.zeros((12, 31), int), np.zeros((2, 12, 31), int)
    >>> higher[1, :-1, 15] = 2  # between columns 15 and 16, but for the last row
    >>> smooth = np.ones((2, 12, 31), bool)
    >>> [int(n) for n in np.bincount(cut_apart(parts, higher, smooth).ravel())]
    [192, 180]
    """
    length = np.empty(int(parts.max(initial=-1)) + 1, np.int64)
    _whole.count_jumps(parts, higher, is_smooth, length)
    is_torn = length >= LEAST_SELF_SEAM
    if not is_torn.any():
        return parts
    bonds = np.empty_like(is_smooth)
    over_rows(_whole.write_bonds, len(parts), parts, higher, is_smooth, is_torn, bonds)
    torn = np.append(is_torn, False)[parts]  # the last one is for no part
    piece = _grown(_components(bonds, _core(bonds)), bonds)
    rest = _components(bonds, torn & (piece < 0))
    whole = np.where(torn, np.where(piece < 0, rest + piece.max(initial=-1) + 1, piece), parts)
    whole[torn] += len(length)
    known = whole >= 0
    whole[known] = np.unique(whole[known], return_inverse=True)[1]
    return whole


def _core(bonds: Bools) -> Bools:
    """Tell which pixels, (row, col), all neighbours around are bonded to each other."""
    window = 2 * CORE_PX + 1
    # An even window reaches one further back, and a bond leads to the next pixel.
    down = ndimage.minimum_filter(bonds[0], (window - 1, window), cval=False, mode="constant")
    right = ndimage.minimum_filter(bonds[1], (window, window - 1), cval=False, mode="constant")
    return np.asarray(down & right)


def _components(bonds: Bools, where: Bools) -> Ints:
    """Return the number of the component of each pixel of some, (row, col), -1 for others."""
    number = np.empty(where.shape, np.int64)
    _whole.join_bonded(bonds, where, number)
    return number


def _grown(piece: Ints, bonds: Bools) -> Ints:
    """Give pixels without a piece that of a bonded neighbour, as far as cores shrank."""
    for _ in range(2 * CORE_PX):
        for axis in range(2):
            former, piece = piece, np.empty_like(piece)
            over_rows(_whole.grow, len(piece), bonds, axis, former, piece)
    return piece
