"""A camera, or a projector: a camera with the arrow reversed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model._array import frozen, require_finite, require_shape
from fringe3d.model.pose import RigidTransform

Role = Literal["camera", "projector"]

DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV knows: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1-s4 [tx ty]]]]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Device:
    """Size, lens and pose of a camera or projector (OpenCV lens model).

    Parameters
    ----------
    name : str
    role : "camera" or "projector"
    n_rows, n_cols : int, > 0
    focal_px : (2,) float, px, > 0; principal distances along x and y
    center_px : (2,) float, px; principal point (x, y); it may lie outside the image (lens shift)
    distortion : float sequence of length 0, 4, 5, 8, 12 or 14
        OpenCV's order; stored padded with zeros to 14.
    device_from_world : RigidTransform, mm

    Raises
    ------
    ValueError
        If a number is outside its domain; the message names the device.
    """

    name: str
    role: Role
    n_rows: int
    n_cols: int
    focal_px: NDArray[np.float64]
    center_px: NDArray[np.float64]
    distortion: NDArray[np.float64]
    device_from_world: RigidTransform

    def __init__(
        self,
        *,
        name: str,
        role: Role,
        n_rows: int,
        n_cols: int,
        focal_px: ArrayLike,
        center_px: ArrayLike,
        distortion: ArrayLike = (),
        device_from_world: RigidTransform | None = None,
    ) -> None:
        coefficients = np.atleast_1d(np.asarray(distortion, np.float64)).ravel()
        if len(coefficients) not in DISTORTION_LENGTHS:
            raise ValueError(
                f"device '{name}': distortion: expected {DISTORTION_LENGTHS} coefficients, "
                f"found {len(coefficients)}"
            )
        padded = np.zeros(14)
        padded[: len(coefficients)] = coefficients
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "role", role)
        object.__setattr__(self, "n_rows", int(n_rows))
        object.__setattr__(self, "n_cols", int(n_cols))
        object.__setattr__(self, "focal_px", frozen(focal_px, np.float64))
        object.__setattr__(self, "center_px", frozen(center_px, np.float64))
        object.__setattr__(self, "distortion", frozen(padded, np.float64))
        object.__setattr__(
            self, "device_from_world", device_from_world or RigidTransform.identity()
        )
        self._check()

    def _check(self) -> None:
        where = f"device '{self.name}'"
        if self.role not in ("camera", "projector"):
            raise ValueError(f"{where}: role: expected 'camera' or 'projector', found {self.role}")
        if self.n_rows < 1 or self.n_cols < 1:
            raise ValueError(
                f"{where}: size: expected positive numbers of pixels, "
                f"found {self.n_cols} x {self.n_rows}"
            )
        for key, array in (
            ("focal_px", self.focal_px),
            ("center_px", self.center_px),
        ):
            require_shape(f"{where}: {key}", array, (2,))
            require_finite(f"{where}: {key}", array)
        require_finite(f"{where}: distortion", self.distortion)
        if (self.focal_px <= 0).any():
            raise ValueError(
                f"{where}: focal_px: expected positive numbers, found {self.focal_px.tolist()}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Return (n_rows, n_cols)."""
        return self.n_rows, self.n_cols

    @property
    def center_world(self) -> NDArray[np.float64]:
        """Return the projection centre in the world frame, (3,), mm."""
        return self.device_from_world.inverse().translation

    @property
    def camera_matrix(self) -> NDArray[np.float64]:
        """Return the 3 x 3 matrix of OpenCV, px."""
        (fx, fy), (cx, cy) = self.focal_px, self.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
