"""A bust on its back: head, neck and shoulders of nobody in particular, the face up."""

from __future__ import annotations

from functools import partial

import numpy as np

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects._face import face
from fringe3d.simulate.objects._implicit import (
    Values,
    capsule,
    carved,
    common,
    ellipsoid,
    mesh_of,
    rotation,
    union,
)

LENGTH_MM = 77.75
"""mm; from the crown to the lower edge of the chest where the head is 40 mm high."""

MIDDLE_MM = (0.0, 3.45, -5.2)
"""mm; y of the middle and z of the table; y = 0 is the chin, z = 0 the canal of the ear."""

NOD_DEG, PIVOT_MM = 11.0, (0.0, 14.0, 2.0)
"""The head bends forward about the joint with the neck, and so looks at the cameras."""


def bust(*, length_mm: float = 70.0, resolution_mm: float = 0.22) -> Mesh:
    """Return a bust that lies on its back, crown towards +y, the face up.

    Parameters
    ----------
    length_mm : from the crown to the lower edge of the chest, mm
    resolution_mm : size of the triangles, mm

    Returns
    -------
    Mesh
        Closed, symmetric about x = 0, bottom at z = 0; 70 mm long it fits a cylinder 76 mm wide
        and 24 mm high.

    Raises
    ------
    ValueError
        If the resolution is not positive or too coarse for the face.

    Examples
    --------
    >>> vertices = bust(resolution_mm=1.2).vertices_mm
    >>> [round(float(v)) for v in vertices.max(axis=0) - vertices.min(axis=0)]
    [61, 70, 23]
    """
    if not 0 < resolution_mm <= length_mm / 40:
        raise ValueError(
            f"bust: expected 0 < resolution_mm <= length_mm / 40 = {length_mm / 40:g} mm,"
            f" found {resolution_mm:g} mm"
        )
    half = 0.56 * length_mm
    solid = partial(_scaled, scale=length_mm / LENGTH_MM)
    return mesh_of(solid, (-half, -half, 0), (half, half, 0.38 * length_mm), resolution_mm)


def _scaled(points: Values, *, scale: float) -> Values:
    return scale * _bust(points / scale + np.array([MIDDLE_MM]).T)


def _bust(points: Values) -> Values:
    """Return the field, mm, where the head is 40 mm high."""
    # One half is modelled; x rounded at the middle leaves no crease there.
    half = points.copy()
    half[0] = np.sqrt(points[0] ** 2 + 0.04) - 0.2
    pivot = np.array([PIVOT_MM]).T
    nodded = rotation(0, -NOD_DEG) @ (half - pivot) + pivot
    body = union(_neck(half), _shoulders(half), 4.0)
    return union(face(nodded), body, 3.5)


def _neck(half: Values) -> Values:
    body = capsule(half, (0, 15, -2.5), (0, -16, -3.0), 8.4, 9.2)
    muscle = capsule(half, (9.3, 11, -1.5), (1.7, -13.2, 5.6), 1.7, 1.2)
    body = union(body, muscle, 3.0)
    throat = ellipsoid(half, (0, -5.5, 5.3), (1.3, 2.8, 1.1))
    return union(body, throat, 2.5)


def _shoulders(half: Values) -> Values:
    """Return chest, collar bones and the upper arms, cut off below in an arc."""
    chest = ellipsoid(half, (0, -30, -4), (27, 19, 13))
    trapezius = capsule(half, (3, -2, -5), (27, -19, -4.5), 5.5, 5.5)
    body = union(chest, trapezius, 6.0)
    body = union(body, ellipsoid(half, (28, -24, -4), (7.5, 11, 8)), 5.0)
    for start, end in (((2.4, -14.9, 6.1), (11, -15.8, 5.6)), ((11, -15.8, 5.6), (24, -15, 1.6))):
        body = union(body, capsule(half, start, end, 1.0, 0.9), 4.5)
    body = carved(body, ellipsoid(half, (0, -13.6, 8.4), (1.7, 2.0, 3.0)), 2.5)
    breast = ellipsoid(half, (10.5, -29, 3), (10, 8, 5.3))
    body = union(body, breast, 6.0)
    below = np.hypot(half[0], half[1] - 4.0) - 39.4
    return common(body, below, 1.5)
