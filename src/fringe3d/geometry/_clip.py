"""Viewing rays cut off by half-spaces, compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def clip_all(directions, normals, room, near, far, rows):  # type: ignore[no-untyped-def]
    """Write where rays (n, 3) enter and leave a convex volume; ``near > far`` where they miss it.

    normals (m, 3); room (m,): ``offset - normal . origin``, mm, of each half-space.
    """
    for i in range(rows[0], rows[1]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        first, last = 0.0, np.inf
        for j in range(len(room)):
            slope = normals[j, 0] * x + normals[j, 1] * y + normals[j, 2] * z
            if slope > 0:
                last = min(last, room[j] / slope)
            elif slope < 0:
                first = max(first, room[j] / slope)
            elif math.isnan(slope) or room[j] < 0:
                last = -np.inf
        near[i], far[i] = first, last
