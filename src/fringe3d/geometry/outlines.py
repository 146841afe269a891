"""Devices and volumes as lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection, QhullError

from fringe3d.geometry.projection import rays
from fringe3d.model import Device, MeasuringVolume

LEAST_RADIUS_MM = 1e-6


def frustum_lines(device: Device, length_mm: float, /) -> NDArray[np.float64]:
    """Return the pyramid that a device sees, as segments (8, 2, 3), mm, world."""
    right, bottom = device.n_cols - 0.5, device.n_rows - 0.5
    corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)]
    origin, directions = rays(device, corners)
    tips = origin + length_mm * directions
    sides = np.stack([np.broadcast_to(origin, tips.shape), tips], axis=1)
    return np.concatenate([sides, np.stack([tips, np.roll(tips, -1, axis=0)], axis=1)])


def volume_lines(volume: MeasuringVolume, /) -> NDArray[np.float64]:
    """Return the edges of a volume, segments (n, 2, 3), mm, world; none if it is open or empty.

    Examples
    --------
    >>> volume_lines(MeasuringVolume.box([0, 0, 0], [1, 1, 1])).shape
    (12, 2, 3)
    """
    normals, offsets = volume.normals, volume.offsets_mm
    # The largest ball inside: its middle lies well within.
    found = linprog([0, 0, 0, -1], A_ub=np.column_stack([normals, np.ones(len(normals))]),
                    b_ub=offsets, bounds=[(None, None)] * 3 + [(0, 1e6)])  # fmt: skip
    if found.x is None or not LEAST_RADIUS_MM < found.x[3] < 1e6:
        return np.empty((0, 2, 3))
    try:
        corners = HalfspaceIntersection(np.column_stack([normals, -offsets]), found.x[:3])
    except QhullError:  # open on several sides
        return np.empty((0, 2, 3))
    places = corners.intersections
    if not np.isfinite(places).all():
        return np.empty((0, 2, 3))
    faces = [set(facet) for facet in corners.dual_facets]
    edges = [
        (places[i], places[j])
        for i in range(len(faces))
        for j in range(i)
        if len(faces[i] & faces[j]) == 2
    ]
    return np.array(edges).reshape(-1, 2, 3)
