"""Rigid transforms, named after the frames that they join."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model._array import frozen, require_finite, require_shape

ORTHONORMAL_TOLERANCE = 1e-5
"""Allowed deviation of R R^T from the identity: files with 6 digits pass, a scaled R does not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigidTransform:
    """Rotation and translation that map coordinates in frame a to frame b.

    Variables are named ``b_from_a``; inner names cancel:
    ``c2_from_world @ world_from_c1`` is ``c2_from_c1``.

    Parameters
    ----------
    rotation : (3, 3) float, orthonormal, determinant +1
    translation : (3,) float, mm

    Raises
    ------
    ValueError
        If a number is not finite or the matrix is not a rotation.

    Examples
    --------
    >>> b_from_a = RigidTransform(rotation=np.eye(3), translation=[0.0, 0.0, 5.0])
    >>> b_from_a.inverse().apply([0.0, 0.0, 7.0]).tolist()
    [0.0, 0.0, 2.0]
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __init__(self, *, rotation: ArrayLike, translation: ArrayLike) -> None:
        object.__setattr__(self, "rotation", frozen(rotation, np.float64))
        object.__setattr__(self, "translation", frozen(translation, np.float64))
        require_shape("rotation", self.rotation, (3, 3))
        require_shape("translation", self.translation, (3,))
        require_finite("rotation", self.rotation)
        require_finite("translation", self.translation)
        deviation = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
        determinant = float(np.linalg.det(self.rotation))
        if deviation > ORTHONORMAL_TOLERANCE or determinant < 0:
            raise ValueError(
                "rotation: expected an orthonormal matrix with determinant +1, found "
                f"a deviation of {deviation:.2g} and a determinant of {determinant:.3g}"
            )

    @staticmethod
    def identity() -> RigidTransform:
        """Return the transform that changes nothing."""
        return RigidTransform(rotation=np.eye(3), translation=np.zeros(3))

    def inverse(self) -> RigidTransform:
        """Return ``a_from_b``."""
        return RigidTransform(
            rotation=self.rotation.T, translation=-self.rotation.T @ self.translation
        )

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        return RigidTransform(
            rotation=self.rotation @ other.rotation,
            translation=self.rotation @ other.translation + self.translation,
        )

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """Map points of shape (..., 3), mm, from a to b."""
        return np.asarray(points, np.float64) @ self.rotation.T + self.translation

    def rotate(self, directions: ArrayLike) -> NDArray[np.float64]:
        """Map directions of shape (..., 3) from a to b (no translation)."""
        return np.asarray(directions, np.float64) @ self.rotation.T
