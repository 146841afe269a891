"""How certain the numbers of a calibrated rig are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen, require_finite, require_shape

LENS_NUMBERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
POSE_NUMBERS = ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")
DEVICE_NUMBERS = LENS_NUMBERS + POSE_NUMBERS
"""Of each device. Its pose may be off by a small turn (a vector, rad) and a shift (mm), both in the
device frame: X_device is turned first, then shifted. So they do not depend on the world frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigCovariance:
    """Covariance of the numbers that a calibration determined.

    Parameters
    ----------
    names : tuple of str; DEVICE.NUMBER, as "c1.fx"; see `DEVICE_NUMBERS`; all others are taken as
        exact: those of the reference device's pose by convention
    matrix : (n, n) float; px, rad, mm
    """

    names: tuple[str, ...]
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, np.float64)
        require_shape("covariance: matrix", matrix, (len(self.names), len(self.names)))
        require_finite("covariance: matrix", matrix)
        if len(set(self.names)) < len(self.names):
            raise ValueError("covariance: expected each name once, found one again")
        for name in self.names:
            if name.rpartition(".")[2] not in DEVICE_NUMBERS:
                raise ValueError(f"covariance: expected DEVICE.NUMBER, found '{name}'")
        if (np.diagonal(matrix) < 0).any():
            raise ValueError("covariance: expected variances of at least 0")
        object.__setattr__(self, "matrix", frozen((matrix + matrix.T) / 2, np.float64))

    def sigma(self, name: str, /) -> float:
        """Return the standard deviation of a number; 0 where it is taken as exact."""
        if name not in self.names:
            return 0.0
        place = self.names.index(name)
        return float(np.sqrt(self.matrix[place, place]))
