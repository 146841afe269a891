"""What a rotary table adds to the adjustment: poses are turns about one axis, nearly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import FoundTable, RigidTransform, SurfaceView, TableAxis
from fringe3d.register.axis import axis_of_motions
from fringe3d.register.small_motion import vector_of

Floats = NDArray[np.float64]

STEP_MM, STEP_RAD = 1e-4, 1e-6
"""Of the derivatives."""

SAME_AXIS_MM, SAME_AXIS_RAD = 1.0, math.radians(0.5)
"""Axes of several tilts that agree so well are one: the object was tilted, not the table."""

LEAST_VIEWS = 3

DOUBT = 6.0
"""Standard deviations (of six numbers together) beside the table at which a view is believed a
quarter as much to stand on it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePrior:
    """What is known of a table beforehand.

    Parameters
    ----------
    angle_sigma : float, rad; of the nominal angles; infinite where they mean nothing
    wobble_rad, wobble_mm : float; how far a position lies beside a pure turn about the axis
    """

    angle_sigma: float = math.radians(0.01)
    wobble_rad: float = 50e-6
    wobble_mm: float = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class TableFit:
    """The table at some step of the adjustment.

    Parameters
    ----------
    prior : TablePrior
    groups : tuple of tuples of int; views of one tilt each; the first of each is its reference
    axis_of : tuple of int; which axis each group has
    axes : tuple of TableAxis
    nominal, angles : (n,) float, rad; of each view relative to the reference of its group
    covariance : (m, m) float; of 4 numbers for each axis and 1 for each view
    """

    prior: TablePrior
    groups: tuple[tuple[int, ...], ...]
    axis_of: tuple[int, ...]
    axes: tuple[TableAxis, ...]
    nominal: Floats
    angles: Floats
    middle_mm: Floats
    covariance: Floats

    @property
    def n_numbers(self) -> int:
        """Return the number of unknowns: four for each axis, one for each view."""
        return 4 * len(self.axes) + len(self.angles)

    def equations(
        self, poses: Sequence[RigidTransform], middle_mm: Floats, /, *, slack: float = 1.0
    ) -> tuple[Floats, Floats]:
        """Return what the table adds to the normal equations of views and its own numbers.

        With a `slack` poses may lie that much farther beside. A view that lies beside all the same
        (a scan whose calibration had moved) is drawn less.
        """
        n_views = len(poses)
        size = 6 * n_views + self.n_numbers
        matrix, vector = np.zeros((size, size)), np.zeros(size)
        strict = np.repeat([self.prior.wobble_rad**-2, self.prior.wobble_mm**-2], 3) / slack**2
        first = 6 * n_views
        angle_weight = self.prior.angle_sigma**-2 if np.isfinite(self.prior.angle_sigma) else 0.0
        for group, which in zip(self.groups, self.axis_of, strict=True):
            own = self.axes[which]
            for view in group:
                place = first + 4 * len(self.axes) + view
                if view == group[0]:
                    matrix[place, place] += STEP_RAD**-2  # its angle is zero by convention
                    continue
                error = self._error(poses, group[0], view, own, self.angles[view], middle_mm)
                weight = strict / (1 + float(error @ (strict * error)) / DOUBT**2) ** 2
                jacobian = np.zeros((6, size))
                jacobian[:, 6 * view : 6 * view + 6] = np.eye(6)
                jacobian[:, 6 * group[0] : 6 * group[0] + 6] -= np.eye(6)
                columns = [*range(first + 4 * which, first + 4 * which + 4), place]
                for column, (axis, angle, step) in zip(
                    columns, self._varied(own, self.angles[view]), strict=True
                ):
                    moved = self._error(poses, group[0], view, axis, angle, middle_mm)
                    jacobian[:, column] = (moved - error) / step
                matrix += jacobian.T @ (weight[:, None] * jacobian)
                vector += jacobian.T @ (weight * error)
                away = self.angles[view] - self.nominal[view]
                matrix[place, place] += angle_weight
                vector[place] += angle_weight * (away if angle_weight else 0.0)
        return matrix, vector

    def _error(
        self, poses: Sequence[RigidTransform], reference: int, view: int, axis: TableAxis,
        angle: float, middle_mm: Floats,
    ) -> Floats:  # fmt: skip
        """Return how far a pose lies beside the table's, (6,)."""
        expected = poses[reference] @ axis.turn(-angle)
        return vector_of(poses[view] @ expected.inverse(), middle_mm)

    def _varied(self, axis: TableAxis, angle: float) -> list[tuple[TableAxis, float, float]]:
        basis = np.eye(4)
        changed = [
            (changed_axis(axis, s * basis[k], self.middle_mm), angle, s)
            for k, s in enumerate((STEP_MM, STEP_MM, STEP_RAD, STEP_RAD))
        ]
        return [*changed, (axis, angle + STEP_RAD, STEP_RAD)]

    def moved(self, numbers: Floats, covariance: Floats, /) -> TableFit:
        """Return the table after its numbers changed."""
        n = 4 * len(self.axes)
        axes = tuple(
            changed_axis(axis, numbers[4 * k : 4 * k + 4], self.middle_mm)
            for k, axis in enumerate(self.axes)
        )
        return replace(self, axes=axes, angles=self.angles + numbers[n:], covariance=covariance)

    def found(
        self, views: Sequence[SurfaceView], poses: Sequence[RigidTransform], middle_mm: Floats, /
    ) -> FoundTable:
        """Return the first axis, the angles of all views, and how far poses lie beside."""
        n, angles, sigma = 4 * len(self.axes), np.full(len(views), np.nan), np.sqrt(
            np.maximum(np.diagonal(self.covariance), 0))  # fmt: skip
        off = np.full((len(views), 6), np.nan)
        for group, which in zip(self.groups, self.axis_of, strict=True):
            own = views[group[0]].position
            begin = 0.0 if own is None or own.angle is None else own.angle
            for view in group:
                angles[view] = begin + self.angles[view]
                off[view] = self._error(poses, group[0], view, self.axes[which],
                                        self.angles[view], middle_mm)  # fmt: skip
        shifts, turns = np.linalg.norm(off[:, 3:], axis=1), np.linalg.norm(off[:, :3], axis=1)
        axis = self.axes[0]
        return FoundTable(
            axis=axis,
            axis_covariance=self.covariance[:4, :4],
            middle_mm=near_point(axis, self.middle_mm),
            across=across_of(axis.direction),
            angles=angles,
            angle_sigma=np.where(np.isfinite(angles), sigma[n : n + len(views)], np.nan),
            off_mm=shifts,
            off_rad=turns,
        )


def across_of(direction: Floats, /) -> Floats:
    """Return two unit vectors (2, 3) square to a direction and to each other, right-handed."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(direction, least)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def near_point(axis: TableAxis, point_mm: Floats, /) -> Floats:
    """Return the point of an axis that is nearest to another."""
    return np.asarray(axis.point_mm + (axis.direction @ point_mm) * axis.direction)


def changed_axis(axis: TableAxis, numbers: Floats, middle_mm: Floats, /) -> TableAxis:
    """Return the axis shifted along the two vectors across it, and turned about them."""
    across = across_of(axis.direction)
    turn = Rotation.from_rotvec(numbers[2:] @ across).as_matrix()
    return TableAxis(
        point_mm=near_point(axis, middle_mm) + numbers[:2] @ across,
        direction=turn @ axis.direction,
    )


def start_of_table(
    views: Sequence[SurfaceView],
    poses: Sequence[RigidTransform],
    middle_mm: Floats,
    prior: TablePrior | None,
    /,
) -> TableFit | None:
    """Find the table roughly from poses; None where no three views stood on it."""
    groups = [g for g in groups_of(views) if len(g) >= LEAST_VIEWS] if prior is not None else []
    if prior is None or not groups:
        return None
    told = _told(views, groups) if np.isfinite(prior.angle_sigma) else None
    if told is None:
        prior = replace(prior, angle_sigma=math.inf)
    axes = [_rough_axis(poses, group, told) for group in groups]
    is_one = all(_same(axes[0], axis, middle_mm) for axis in axes)
    nominal, angles = np.zeros(len(views)), np.zeros(len(views))
    for group, axis in zip(groups, axes, strict=True):
        for k in group:
            motion = poses[k].inverse() @ poses[group[0]]
            spun = float(Rotation.from_matrix(motion.rotation).as_rotvec() @ axis.direction)
            nominal[k] = spun % (2 * np.pi) if told is None else told[k] - told[group[0]]
            angles[k] = nominal[k] + math.remainder(spun - nominal[k], 2 * math.pi)
    n_axes = 1 if is_one else len(axes)
    size = 4 * n_axes + len(views)
    return TableFit(
        prior, tuple(map(tuple, groups)), tuple([0] * len(groups) if is_one else range(n_axes)),
        tuple(axes[:n_axes]), nominal, angles, middle_mm, np.zeros((size, size)),
    )  # fmt: skip


def groups_of(views: Sequence[SurfaceView], /) -> list[list[int]]:
    """Return the numbers of the views of each tilt; without a table all belong together."""
    tilts: dict[float, list[int]] = {}
    for number, view in enumerate(views):
        tilts.setdefault(round(view.position.tilt, 6) if view.position else 0.0, []).append(number)
    return list(tilts.values())


def _rough_axis(
    poses: Sequence[RigidTransform], group: Sequence[int], told: dict[int, float] | None
) -> TableAxis:
    pairs = list(itertools.combinations(group, 2))
    motions = [poses[b].inverse() @ poses[a] for a, b in pairs]
    return axis_of_motions(motions, angles=[told[b] - told[a] for a, b in pairs] if told else None)


def _told(views: Sequence[SurfaceView], groups: Sequence[Sequence[int]]) -> dict[int, float] | None:
    """Return the nominal angles; None unless all are known."""
    positions = {k: views[k].position for group in groups for k in group}
    angles = {k: p.angle for k, p in positions.items() if p is not None and p.angle is not None}
    return angles if len(angles) == len(positions) else None


def _same(a: TableAxis, b: TableAxis, middle_mm: Floats) -> bool:
    apart = float(np.linalg.norm(near_point(a, middle_mm) - near_point(b, middle_mm)))
    lean = float(np.linalg.norm(np.cross(a.direction, b.direction)))
    return apart < SAME_AXIS_MM and lean < SAME_AXIS_RAD and float(a.direction @ b.direction) > 0
