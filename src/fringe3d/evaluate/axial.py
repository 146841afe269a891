"""Cylinders and cones through points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fringe3d.evaluate.fitting import Fit, Floats, checked_points, settled, square_to, trimmed

N_DIRECTIONS = 400
"""Axes tried, 8 degrees apart: a fit finds its way from there."""

N_TRIED = 6
"""Of these, those that are refined."""

MAX_SAMPLE = 1500
"""Points by which the axes are tried."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cone:
    """A cone; a cylinder is one with a half angle of 0.

    Its numbers are two turns of the axis (rad) and two shifts (mm), along the two directions
    `square_to(axis)`, the radius (mm) and, of a cone, the half angle (rad).

    Parameters
    ----------
    point_mm : (3,) float, mm; on the axis, in the middle of the points
    axis : (3,) float, unit length; a cone widens along it
    radius_mm : float, mm; at `point_mm`, square to the axis
    half_angle : float, rad; between axis and surface
    is_cylinder : bool; the half angle stays 0
    """

    point_mm: Floats
    axis: Floats
    radius_mm: float
    half_angle: float = 0.0
    is_cylinder: bool = False

    @property
    def n_parameters(self) -> int:
        """Return 5 for a cylinder, 6 for a cone."""
        return 5 if self.is_cylinder else 6

    def distances(self, points_mm: Floats, /) -> Floats:
        """Return signed distances, positive outside, mm."""
        along, across, _ = self._split(points_mm)
        cosine, tangent = np.cos(self.half_angle), np.tan(self.half_angle)
        return np.asarray((across - self.radius_mm - along * tangent) * cosine)

    def slopes(self, points_mm: Floats, /) -> Floats:
        """Return the derivatives of the distances, (n, 5) or (n, 6)."""
        along, across, outward = self._split(points_mm)
        cosine, sine = np.cos(self.half_angle), np.sin(self.half_angle)
        sides = square_to(self.axis)
        towards = outward @ sides.T
        aside = (points_mm - self.point_mm) @ sides.T
        turns = -along[:, None] * towards * cosine - aside * sine
        columns = [turns, -towards * cosine, np.full((len(along), 1), -cosine)]
        if not self.is_cylinder:
            bend = -(across - self.radius_mm) * sine - along * cosine
            columns.append(bend[:, None])
        return np.column_stack(columns)

    def moved(self, step: Floats, /) -> Self:
        """Return the cone turned, shifted and widened."""
        sides = square_to(self.axis)
        axis = self.axis + step[:2] @ sides
        return type(self)(
            point_mm=self.point_mm + step[2:4] @ sides,
            axis=axis / np.linalg.norm(axis),
            radius_mm=self.radius_mm + float(step[4]),
            half_angle=0.0 if self.is_cylinder else self.half_angle + float(step[5]),
            is_cylinder=self.is_cylinder,
        )

    def _split(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Return coordinates along the axis, distances from it, and directions away from it."""
        near = points_mm - self.point_mm
        along = near @ self.axis
        away = near - along[:, None] * self.axis
        across = np.linalg.norm(away, axis=1)
        return along, across, away / np.maximum(across, 1e-300)[:, None]


def fit_cylinder(points_mm: ArrayLike, /, *, rejected_part: float = 0.0) -> Fit[Cone]:
    """Fit the cylinder with the smallest sum of squared distances.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite, n >= 5
    rejected_part : float, 0 <= part < 0.5; see `fit_plane`

    Returns
    -------
    Fit of a Cone whose half angle is 0

    Raises
    ------
    ValueError
        If the points are too few, not finite, or lie on no cylinder at all.

    Examples
    --------
    >>> turn, up = (a.ravel() for a in np.meshgrid(np.linspace(0, 2, 15), [0.0, 1.0, 2.0]))
    >>> fit = fit_cylinder(np.column_stack([3 * np.cos(turn), 3 * np.sin(turn), up]))
    >>> round(fit.surface.radius_mm, 6), np.abs(fit.surface.axis).round(6).tolist()
    (3.0, [0.0, 0.0, 1.0])
    """
    points = checked_points(points_mm, "cylinder", 5)
    return trimmed(points, lambda own: _best(own, is_cylinder=True), rejected_part, kind="cylinder")


def fit_cone(points_mm: ArrayLike, /, *, rejected_part: float = 0.0) -> Fit[Cone]:
    """Fit the cone with the smallest sum of squared distances.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite, n >= 6
    rejected_part : float, 0 <= part < 0.5; see `fit_plane`

    Returns
    -------
    Fit of a Cone; its half angle is at least 0

    Raises
    ------
    ValueError
        If the points are too few, not finite, or lie on no cone at all.

    Examples
    --------
    >>> turn, up = (a.ravel() for a in np.meshgrid(np.linspace(0, 2, 15), [1.0, 2.0, 3.0]))
    >>> fit = fit_cone(np.column_stack([up * np.cos(turn), up * np.sin(turn), up]))
    >>> round(float(np.degrees(fit.surface.half_angle)), 6)
    45.0
    """
    points = checked_points(points_mm, "cone", 6)
    return trimmed(points, lambda own: _best(own, is_cylinder=False), rejected_part, kind="cone")


def _best(points: Floats, *, is_cylinder: bool) -> Cone:
    """Return the best of what fits from several axes."""
    sample = points[:: max(1, len(points) // MAX_SAMPLE)]
    starts = sorted(
        (start for axis in _half_sphere() if (start := _start(sample, axis, is_cylinder))),
        key=lambda cone: _squares(cone, sample),
    )
    tried = [settled(start, sample) for start in starts[:N_TRIED]]
    if not tried:
        kind = "cylinder" if is_cylinder else "cone"
        raise ValueError(f"{kind}: expected points on one, found none that they lie on")
    return _widening(settled(min(tried, key=lambda cone: _squares(cone, sample)), points))


def _squares(cone: Cone, points: Floats) -> float:
    return float((cone.distances(points) ** 2).sum())


def _half_sphere() -> Floats:
    """Return directions spread evenly over half a sphere, (n, 3): a spiral."""
    up = (np.arange(N_DIRECTIONS) + 0.5) / N_DIRECTIONS
    turn = np.pi * (1 + 5**0.5) * np.arange(N_DIRECTIONS)
    flat = np.sqrt(1 - up**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up])


def _start(points: Floats, axis: Floats, is_cylinder: bool) -> Cone | None:
    """Return the cone about a given axis by a linear fit: its square is x^2 + y^2 = (r + k z)^2."""
    middle = points.mean(axis=0)
    sides = square_to(axis)
    (x, y), z = ((points - middle) @ sides.T).T, (points - middle) @ axis
    columns = [2 * x, 2 * y, np.ones(len(x))] + ([] if is_cylinder else [2 * z, z**2])
    linear, *_ = np.linalg.lstsq(np.column_stack(columns), x**2 + y**2, rcond=None)
    squared = float(linear[2] + linear[:2] @ linear[:2])
    if not squared > 0:
        return None
    radius = float(np.sqrt(squared))
    slope = 0.0 if is_cylinder else float(linear[3]) / radius
    return Cone(
        point_mm=middle + linear[:2] @ sides,
        axis=axis,
        radius_mm=radius,
        half_angle=float(np.arctan(slope)),
        is_cylinder=is_cylinder,
    )


def _widening(cone: Cone) -> Cone:
    """Return the same cone with its axis towards where it widens."""
    if cone.half_angle >= 0:
        return cone
    return Cone(
        point_mm=cone.point_mm,
        axis=-cone.axis,
        radius_mm=cone.radius_mm,
        half_angle=-cone.half_angle,
    )
