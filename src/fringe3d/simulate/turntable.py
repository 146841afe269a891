"""A rotary table: the object leans, and then turns about an axis, position after position."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.model import RigidTransform, TableAxis, TablePosition
from fringe3d.simulate.scene import Scene

WORLD_Z = TableAxis(point_mm=[0, 0, 0], direction=[0, 0, 1])


def table_positions(
    n_positions: int, tilts_deg: tuple[float, ...] = (0.0,), /
) -> tuple[TablePosition, ...]:
    """Return what the table's controller says: equal steps, once for each tilt.

    Examples
    --------
    >>> [round(math.degrees(p.angle)) for p in table_positions(4)]
    [0, 90, 180, 270]
    """
    return tuple(
        TablePosition(angle=2 * math.pi * number / n_positions, tilt=math.radians(tilt))
        for tilt in tilts_deg
        for number in range(n_positions)
    )


def table_axis(*, off_mm: float = 0.0, lean_deg: float = 0.0, seed: int = 0) -> TableAxis:
    """Return the world's z axis, moved sideways and leaned in random directions.

    Examples
    --------
    >>> axis = table_axis(off_mm=3.0, lean_deg=2.0, seed=1)
    >>> round(float(np.degrees(np.arccos(axis.direction[2]))), 9)
    2.0
    >>> bool(2.99 < axis.distance_mm([0, 0, 0]) <= 3.0)
    True
    """
    towards, leaning = np.random.default_rng(seed).uniform(0, 2 * np.pi, 2)
    lean = math.radians(lean_deg)
    return TableAxis(
        point_mm=[off_mm * math.cos(towards), off_mm * math.sin(towards), 0.0],
        direction=[math.sin(lean) * math.cos(leaning), math.sin(lean) * math.sin(leaning),
                   math.cos(lean)],
    )  # fmt: skip


def turntable(
    scene: Scene,
    /,
    *,
    n_positions: int,
    tilts_deg: tuple[float, ...] = (0.0,),
    axis: TableAxis = WORLD_Z,
    angle_error_deg: float = 0.0,
    seed: int = 0,
) -> Iterator[Scene]:
    """Yield the scene with its object turned about an axis, for each tilt.

    Parameters
    ----------
    scene : Scene
    n_positions : int, >= 1; equal steps of the table
    tilts_deg : float, deg; the object leans about the x direction, through the z axis at half
        its height, before it turns
    axis : TableAxis; the world's z axis by default
    angle_error_deg : float, deg; standard deviation of the angles from their equal steps
    seed : int; of these errors
    """
    vertices = scene.thing.vertices_mm
    middle = scene.world_from_object.apply((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
    errors = np.random.default_rng([seed, 1]).normal(0, math.radians(angle_error_deg), 10_000)
    for number, position in enumerate(table_positions(n_positions, tilts_deg)):
        lean = Rotation.from_euler("x", position.tilt).as_matrix()
        about = RigidTransform(
            rotation=lean, translation=middle * [0, 0, 1] - lean @ (middle * [0, 0, 1])
        )
        assert position.angle is not None
        turn = axis.turn(position.angle + errors[number])
        yield scene.placed(turn @ about @ scene.world_from_object)
