"""Pieces of a surface that hang together by a few pixels alone, though phases say they differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

NEIGHBOURS = (np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])
"""The upper and lower, and the left and right of two neighbours."""

LEAST_SELF_SEAM = 8
"""Pixels of smooth phase across which one and the same part jumps by whole orders."""

CORE_PX = 2
"""What is no wider than twice this joins nothing."""


def cut_apart(parts: Ints, higher: Ints, is_smooth: Bools, /) -> Ints:
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
    same = np.zeros_like(is_smooth)
    for axis, (here, there) in enumerate(NEIGHBOURS):
        same[axis][here] = (parts[here] == parts[there]) & (parts[here] >= 0)
    jumps = same & is_smooth & (higher != 0)
    length = np.zeros(int(parts.max(initial=-1)) + 2, np.int64)  # the last one is for no part
    for jump in jumps:
        length += np.bincount(parts[jump], minlength=len(length))
    torn = (length >= LEAST_SELF_SEAM)[parts]
    if not torn.any():
        return parts
    bonds = same & is_smooth & (higher == 0) & torn
    core = _core(bonds)
    piece = _grown(_components(bonds, core), bonds)
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
    number = np.full(where.shape, -1, np.int64)
    n = int(where.sum())
    number[where] = np.arange(n)
    ends = []
    for axis, (here, there) in enumerate(NEIGHBOURS):
        joined = bonds[axis][here] & where[here] & where[there]
        ends.append((number[here][joined], number[there][joined]))
    first, second = np.concatenate(ends, axis=1)
    graph = coo_array((np.ones(len(first), bool), (first, second)), shape=(n, n))
    number[where] = connected_components(graph, directed=False)[1]
    return number


def _grown(piece: Ints, bonds: Bools) -> Ints:
    """Give pixels without a piece that of a bonded neighbour, as far as cores shrank."""
    for _ in range(2 * CORE_PX):
        for axis, (here, there) in enumerate(NEIGHBOURS):
            former = piece.copy()
            for one, other in ((here, there), (there, here)):
                gains = bonds[axis][here] & (former[one] < 0) & (former[other] >= 0)
                piece[one][gains] = former[other][gains]
    return piece
