"""The axis of a rotary table from poses: of views, of a calibration board, or from a ball."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from fringe3d.errors import EmptyResultError
from fringe3d.model import RigidTransform, TableAxis

Floats = NDArray[np.float64]

LEAST_TURN = np.radians(3.0)
"""A pair of poses turned by less says little of the axis."""

LEAST_ARC_MM = 1.0
"""A ball that moves by less on its circle says nothing of it."""


def axis_of_motions(
    motions: Sequence[RigidTransform], /, *, angles: Sequence[float] | None = None
) -> TableAxis:
    """Return the axis about which a body made several motions, by least squares.

    Parameters
    ----------
    motions : sequence of RigidTransform; each maps the body's points from before to after, in the
        world frame: of views ``i`` and ``j`` it is ``view_j_from_body @ body_from_view_i``; of
        board poses ``world_from_board_j @ board_i_from_world``
    angles : sequence of float or None, rad; by which the table turned, where that is known: they
        give the direction its sign. Without them the axis points so that most turns are positive

    Raises
    ------
    EmptyResultError
        If no motion turns by more than 3 degrees.

    Notes
    -----
    The direction is the mean of the rotation vectors, weighted by the sine of half the turn; the
    point that for which ``(I - R) p = t`` holds best.

    Examples
    --------
    >>> true = TableAxis(point_mm=[3, 4, 0], direction=[0, 0, 1])
    >>> found = axis_of_motions([true.turn(0.5), true.turn(1.5)])
    >>> found.point_mm.round(9).tolist(), found.direction.round(9).tolist()
    ([3.0, 4.0, 0.0], [0.0, 0.0, 1.0])
    """
    scatter, equations, right = np.zeros((3, 3)), [], []
    sense = np.zeros(3)
    for number, motion in enumerate(motions):
        vector = Rotation.from_matrix(motion.rotation).as_rotvec()
        turn = float(np.linalg.norm(vector))
        if turn < LEAST_TURN:
            continue
        way = vector / turn
        scatter += np.sin(turn / 2) ** 2 * np.outer(way, way)
        told = 1.0 if angles is None else np.sin(angles[number])
        sense += np.sign(told) * np.sin(turn) * way
        equations.append(np.eye(3) - motion.rotation)
        right.append(motion.translation)
    if not equations:
        raise EmptyResultError(
            f"table axis: expected poses turned by more than {np.degrees(LEAST_TURN):.0f} deg, "
            "found none. Turn the table further between scans"
        )
    direction = np.linalg.eigh(scatter)[1][:, -1]
    if direction @ sense < 0:
        direction = -direction
    across = np.linalg.svd(direction[None])[2][1:]
    matrix = np.concatenate([e @ across.T for e in equations])
    point = np.linalg.lstsq(matrix, np.concatenate(right))[0] @ across
    return TableAxis(point_mm=point, direction=direction)


def axis_of_points(centers_mm: ArrayLike, /, *, angles: ArrayLike | None = None) -> TableAxis:
    """Return the axis of the circle on which a point, as the centre of a ball, went around.

    Parameters
    ----------
    centers_mm : (n, 3) float, mm, n >= 3; in the order in which the table turned
    angles : (n,) float or None, rad; where they are known, they sharpen the fit and tell the sense

    Raises
    ------
    EmptyResultError
        If the points are too few, or do not lie on a circle.

    Examples
    --------
    >>> turns = np.radians([0, 40, 90, 200])
    >>> ball = np.stack([2 + 30 * np.cos(turns), 30 * np.sin(turns), 0 * turns + 5], axis=1)
    >>> found = axis_of_points(ball)
    >>> (found.point_mm.round(6) + 0.0).tolist(), (found.direction.round(6) + 0.0).tolist()
    ([2.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    """
    centers = np.asarray(centers_mm, np.float64)
    spread = np.linalg.svd(centers - centers.mean(axis=0))[1] if len(centers) >= 3 else np.zeros(3)
    if len(centers) < 3 or spread[1] < LEAST_ARC_MM:
        raise EmptyResultError(
            "table axis: expected at least 3 places of a ball on a circle, found "
            f"{len(centers)} that lie within {spread[1]:.2g} mm of a line. Put the ball beside the "
            "axis and turn further"
        )
    if angles is not None:
        return _axis_of_known_turns(centers, np.asarray(angles, np.float64))
    middle = centers.mean(axis=0)
    _, _, rows = np.linalg.svd(centers - middle)
    flat = (centers - middle) @ rows[:2].T
    # |p|^2 = 2 p.c + r^2 - |c|^2 is linear in the centre; then refined square to the circle.
    start = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(flat))]),
                            (flat**2).sum(axis=1))[0]  # fmt: skip
    center = middle + _circle(flat, start[:2]) @ rows[:2]
    arms = centers - center
    sense = np.cross(arms[:-1], arms[1:]).sum(axis=0)
    direction = rows[2] if rows[2] @ sense >= 0 else -rows[2]
    return TableAxis(point_mm=center, direction=direction)


def _circle(flat: Floats, center: Floats) -> Floats:
    for _ in range(20):
        arms = flat - center
        radii = np.linalg.norm(arms, axis=1)
        jacobian = np.column_stack([-arms / radii[:, None], -np.ones(len(flat))])
        step = np.linalg.lstsq(jacobian, radii.mean() - radii)[0]
        center = center + step[:2]
        if np.abs(step[:2]).max() < 1e-12:
            break
    return center


def _axis_of_known_turns(centers: Floats, angles: Floats) -> TableAxis:
    """Fit center + cos(angle) u + sin(angle) v, linear in all three; the axis is u x v."""
    design = np.column_stack([np.ones(len(angles)), np.cos(angles), np.sin(angles)])
    center, u, v = np.linalg.lstsq(design, centers)[0]
    return TableAxis(point_mm=center, direction=np.cross(u, v))
