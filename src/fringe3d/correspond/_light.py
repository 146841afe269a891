"""Which light points of a surface stand in, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fringe3d.correspond._curves import pixel, turned


@njit(cache=True, nogil=True, error_model="numpy")
def write_light(index, depths, rays, projector, distance, light, rows):  # type: ignore[no-untyped-def]
    """Write how far points are from the projector, (m,) mm, and its pixels that light them, (m, 2).

    index (m,): which of n viewing rays; depths (n,): mm along them; rays = (where (n,): number of
    the pixel, directions (pixel, 3) in the world, rotation onto the frame of the projector);
    projector = (base (3,), lens); rows: first of the m and last but one.
    """
    where, directions, rotation = rays
    base, lens = projector
    for k in range(rows[0], rows[1]):
        along = turned(rotation, directions[where[index[k]]])
        t = np.float64(depths[index[k]])
        x, y, z = base[0] + t * along[0], base[1] + t * along[1], base[2] + t * along[2]
        distance[k] = math.sqrt(x * x + y * y + z * z)
        light[k, 0], light[k, 1] = pixel(base, along, t, lens)


@njit(cache=True, nogil=True, error_model="numpy")
def find_owners(cell, size, owner):  # type: ignore[no-untyped-def]
    """Write which point owns each cell of light, (cell,): the last one of the largest surface.

    cell, size (m,): of each point, the cell it stands in and the size of its surface.
    """
    owner[:] = -1
    for k in range(len(cell)):
        former = owner[cell[k]]
        if former < 0 or size[k] >= size[former]:
            owner[cell[k]] = k
