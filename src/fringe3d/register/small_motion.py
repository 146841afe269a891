"""Small turns and shifts about a middle, as vectors of six numbers: turn (rad), shift (mm)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import RigidTransform

Floats = NDArray[np.float64]


def motion_of(vector: Floats, middle_mm: Floats, /) -> RigidTransform:
    """Return the motion that turns about a middle by a rotation vector, then shifts.

    Examples
    --------
    >>> motion = motion_of(np.array([0, 0, np.pi / 2, 0, 0, 1.0]), np.array([1.0, 0, 0]))
    >>> motion.apply([2.0, 0, 0]).round(9).tolist()
    [1.0, 1.0, 1.0]
    """
    rotation = Rotation.from_rotvec(vector[:3]).as_matrix()
    return RigidTransform(
        rotation=rotation, translation=middle_mm - rotation @ middle_mm + vector[3:]
    )


def vector_of(motion: RigidTransform, middle_mm: Floats, /) -> Floats:
    """Return the six numbers of a motion; the inverse of `motion_of`."""
    shift = motion.apply(middle_mm) - middle_mm
    return np.concatenate([Rotation.from_matrix(motion.rotation).as_rotvec(), shift])


def nearest_rotation(matrix: Floats, /) -> Floats:
    """Return the rotation next to a matrix: rounding errors of many products do not grow."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)


def tidy(transform: RigidTransform, /) -> RigidTransform:
    """Return the transform with an exact rotation."""
    return RigidTransform(
        rotation=nearest_rotation(transform.rotation), translation=transform.translation
    )


def mean_rotation(rotations: Floats, /) -> Floats:
    """Return the rotation nearest to several, (n, 3, 3)."""
    return nearest_rotation(np.asarray(rotations).sum(axis=0))
