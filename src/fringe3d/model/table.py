"""Rotary tables: where the object stood, and the axis about which it turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model._array import frozen, require_finite, require_shape
from fringe3d.model.pose import RigidTransform


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePosition:
    """Where a rotary table stood during a scan, as its controller or the user says.

    Parameters
    ----------
    angle : float, rad, or None where nobody knows; positive turns right-handed about the axis
    tilt : float, rad; scans of one tilt differ by a turn about the axis alone. Between tilts the
        object (or the table) may have moved in any way
    """

    angle: float | None = None
    tilt: float = 0.0

    def __post_init__(self) -> None:
        for name in ("angle", "tilt"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"table: {name}: expected a finite number, found {value}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxis:
    """The axis of a rotary table, in the world frame.

    Parameters
    ----------
    point_mm : (3,) float, mm; any point of the axis; the one nearest to the origin is kept
    direction : (3,) float; made unit length; positive angles turn right-handed about it

    Examples
    --------
    >>> axis = TableAxis(point_mm=[1, 0, 7], direction=[0, 0, 2])
    >>> axis.point_mm.tolist()
    [1.0, 0.0, 0.0]
    >>> axis.turn(np.pi / 2).apply([2, 0, 5]).round(9).tolist()
    [1.0, 1.0, 5.0]
    """

    point_mm: NDArray[np.float64]
    direction: NDArray[np.float64]

    def __init__(self, *, point_mm: ArrayLike, direction: ArrayLike) -> None:
        point, way = np.asarray(point_mm, np.float64), np.asarray(direction, np.float64)
        for name, value in (("point_mm", point), ("direction", way)):
            require_shape(f"table axis: {name}", value, (3,))
            require_finite(f"table axis: {name}", value)
        length = float(np.linalg.norm(way))
        if not length > 0:
            raise ValueError("table axis: direction: expected a vector, found zero")
        way = way / length
        object.__setattr__(self, "direction", frozen(way, np.float64))
        object.__setattr__(self, "point_mm", frozen(point - (point @ way) * way, np.float64))

    def turn(self, angle: float, /) -> RigidTransform:
        """Return how points of the world move as the table turns by an angle, rad."""
        x, y, z = self.direction
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
        return RigidTransform(
            rotation=rotation, translation=self.point_mm - rotation @ self.point_mm
        )

    def distance_mm(self, points_mm: ArrayLike, /) -> NDArray[np.float64]:
        """Return how far points (..., 3) lie from the axis, mm."""
        away = np.asarray(points_mm, np.float64) - self.point_mm
        return np.asarray(np.linalg.norm(np.cross(away, self.direction), axis=-1))
