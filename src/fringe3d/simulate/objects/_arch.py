"""The curve along which lower teeth stand, and the gums and the base that follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree

from fringe3d.simulate.objects._implicit import Values, common, union

FRONT_MM = -31.0
"""mm; y of the curve between the first incisors."""

CURVE_MM, CURVE_Y_MM, CURVE_POWER = 24.3, 40.0, 2.9
"""The curve passes y = 40 mm at x = 24.3 mm; the power makes a wide front."""

TABLE_MM = 0.02
LOOKUP_MM = 0.5
LOOKUP_RADIUS_MM = 48.0

GUM_MM = 14.3
"""mm; height of the gum line above the table."""

BASE_MM = 7.0
"""mm; height of the plaster base below the gums."""

PAPILLA_MM = 1.9
"""mm; how far the gum rises between two teeth."""


@dataclass(frozen=True, slots=True, eq=False)
class Arch:
    """Teeth in a row: where each stands, how deep it is, how high its gum lies."""

    arcs_mm: Values
    depths_mm: Values
    lifts_mm: Values
    end_mm: float

    def gums(self, points: Values, along: Values, off: Values) -> Values:
        """Return the field of gums on their base."""
        z = points[2]
        place = np.interp(along, self.arcs_mm, np.arange(len(self.arcs_mm), dtype=np.float64))
        between = np.sin(np.pi * place) ** 2
        lift = np.interp(along, self.arcs_mm, self.lifts_mm)
        depth = np.interp(along, self.arcs_mm, self.depths_mm)
        inside = np.abs(along) < self.arcs_mm[-1]
        top = GUM_MM + lift - 0.35 + PAPILLA_MM * between**1.5 * inside
        down = np.maximum(top - z, 0.0)
        root = 0.28 * (1 - between) * np.exp(-(((down - 3.0) / 2.5) ** 2)) * (off > 0)
        half = 0.45 * depth + 0.55 + 1.3 * (1 - np.exp(-down / 2.5)) + root
        walls = np.abs(off) - half
        ridge = common(walls, 0.9 * (z - top), 1.1)
        ridge = common(ridge, np.abs(along) - self.end_mm, 3.0)
        base = common(np.abs(off - 0.2) - (4.1 + 0.33 * depth), z - BASE_MM, 0.8)
        base = common(base, np.abs(along) - self.end_mm - 0.8, 0.8)
        return union(ridge, base, 1.2)


class Curve:
    """The line of the teeth in the plane z = 0, with its arc length from the middle."""

    def __init__(self) -> None:
        x = np.linspace(0, 1.3 * CURVE_MM, 40_000)
        line = np.stack([x, FRONT_MM + CURVE_Y_MM * (x / CURVE_MM) ** CURVE_POWER])
        arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line)))])
        half = np.arange(0, arc[-1], TABLE_MM)
        right = np.stack([np.interp(half, arc, coordinate) for coordinate in line])
        self._arc = np.concatenate([-half[:0:-1], half])
        self._line = np.concatenate([right[:, :0:-1] * [[-1], [1]], right], axis=1)
        tangent = np.gradient(self._line, axis=1)
        self._tangent = tangent / np.hypot(*tangent)
        axis = np.arange(-LOOKUP_RADIUS_MM, LOOKUP_RADIUS_MM + LOOKUP_MM, LOOKUP_MM)
        grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
        self._nearest: NDArray[np.float64] = self._arc[KDTree(self._line.T).query(grid)[1]]

    def at(self, arc_mm: float) -> tuple[Values, Values]:
        """Return the point (2,) and the direction (2,) at an arc length."""
        point = [np.interp(arc_mm, self._arc, values) for values in self._line]
        tangent = [np.interp(arc_mm, self._arc, values) for values in self._tangent]
        return np.array(point), np.array(tangent)

    def coordinates(self, points: Values) -> tuple[Values, Values]:
        """Return arc length and distance outwards of points (3, n)."""
        index = (points[:2] + LOOKUP_RADIUS_MM) / LOOKUP_MM
        arc = map_coordinates(self._nearest, index, order=1, mode="nearest")
        # The table says about where; the tangent there gives both numbers to second order.
        x, y = (np.interp(arc, self._arc, values) for values in self._line)
        tx, ty = (np.interp(arc, self._arc, values) for values in self._tangent)
        dx, dy = points[0] - x, points[1] - y
        return arc + dx * tx + dy * ty, dx * ty - dy * tx
