"""Where devices stand: places and poses from angles and distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model import RigidTransform

ALONG_X = 1e-6
"""Sine of the angle to the x axis below which a line of sight has no rows along x."""


def above(tilt_deg: float, azimuth_deg: float, distance_mm: float, /) -> NDArray[np.float64]:
    """Return the place at a tilt from the vertical (z) and an azimuth from -y, (3,), mm.

    Degrees, for places are read and written that way; a positive azimuth leads towards x.

    Examples
    --------
    >>> (above(90.0, 90.0, 300.0).round(9) + 0.0).tolist()
    [300.0, 0.0, 0.0]
    """
    tilt, azimuth = np.radians([tilt_deg, azimuth_deg])
    direction = np.array(
        [np.sin(tilt) * np.sin(azimuth), -np.sin(tilt) * np.cos(azimuth), np.cos(tilt)]
    )
    return distance_mm * direction


def looking_at(place_mm: ArrayLike, target_mm: ArrayLike, /) -> RigidTransform:
    """Return ``device_from_world`` of a device that looks from a place at a target.

    Its rows run along the world's x (along y where it looks along x itself).

    Parameters
    ----------
    place_mm, target_mm : (3,) float, mm

    Raises
    ------
    ValueError
        If both are the same point.

    Examples
    --------
    >>> pose = looking_at([0.0, 0.0, 300.0], [0.0, 0.0, 0.0])
    >>> pose.apply([10.0, 0.0, 100.0]).tolist()
    [10.0, 0.0, 200.0]
    """
    place, target = np.asarray(place_mm, np.float64), np.asarray(target_mm, np.float64)
    distance = float(np.linalg.norm(target - place))
    if not distance > 0:
        raise ValueError(f"expected a device apart from the point {target.tolist()} it looks at")
    forward = (target - place) / distance
    across = np.array([1.0, 0.0, 0.0])
    if np.linalg.norm(np.cross(forward, across)) < ALONG_X:
        across = np.array([0.0, 1.0, 0.0])
    right = across - (across @ forward) * forward
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return RigidTransform(rotation=rotation, translation=-rotation @ place)


def looking_at_origin(place_mm: ArrayLike, /) -> RigidTransform:
    """Return the pose of a device that looks from a place at the origin, its rows along x."""
    return looking_at(place_mm, np.zeros(3))
