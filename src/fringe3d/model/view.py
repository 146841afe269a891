"""One view of a body: its points on the grid of a camera, with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen, require_shape
from fringe3d.model.device import Device
from fringe3d.model.pose import RigidTransform
from fringe3d.model.table import TableAxis, TablePosition


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceView:
    """What one scan saw of a body.

    Parameters
    ----------
    name : str
    camera : Device; C1, on whose pixels the points lie
    points_mm : (row, col, 3) float64, mm, world frame of the rig; NaN where there are none
    normals : (row, col, 3) float32; unit length, towards the camera; NaN where nothing tells
    sigma_mm : (row, col) float32, mm; standard deviation along the viewing ray
    grey : (row, col) uint8; brightness of the surface
    spacing_mm : float, mm; typical distance of neighbouring points
    position : TablePosition or None; where the rotary table stood
    """

    name: str
    camera: Device
    points_mm: NDArray[np.float64]
    normals: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]
    spacing_mm: float
    position: TablePosition | None = None

    def __post_init__(self) -> None:
        shape = self.camera.shape
        for name, dtype, own in (
            ("points_mm", np.float64, (*shape, 3)),
            ("normals", np.float32, (*shape, 3)),
            ("sigma_mm", np.float32, shape),
            ("grey", np.uint8, shape),
        ):
            array = frozen(getattr(self, name), dtype)
            require_shape(f"view {self.name}: {name}", array, own)
            object.__setattr__(self, name, array)

    @property
    def is_valid(self) -> NDArray[np.bool_]:
        """Return (row, col); True where there is a point."""
        return np.asarray(np.isfinite(self.points_mm[..., 0]))

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        return int(self.is_valid.sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class PairResidual:
    """How two views agree where they overlap.

    Parameters
    ----------
    first, second : int; numbers of the views
    n_points : int; sampled points of either on the surface of the other
    rms_mm : float, mm; robust: 1.48 times the median size of the distances
    in_sigmas : float; the same over the expected standard deviation
    mean_mm : float, mm; mean distance of the first from the second, along the normals
    """

    first: int
    second: int
    n_points: int
    rms_mm: float
    in_sigmas: float
    mean_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundTable:
    """A rotary table as the views show it.

    Parameters
    ----------
    axis : TableAxis; world frame
    axis_covariance : (4, 4) float; of shifts (mm) along two directions across the axis, at the
        middle of the body, and of turns (rad) about them; see `across`
    middle_mm : (3,) float, mm; where the shifts are meant: the axis point nearest to the body
    across : (2, 3) float; these directions
    angles : (n,) float, rad; as found, of all views; NaN for views without a table
    angle_sigma : (n,) float, rad
    off_mm, off_rad : (n,) float; how far the pose of each view lies beside the table's; NaN for
        views without one
    """

    axis: TableAxis
    axis_covariance: NDArray[np.float64]
    middle_mm: NDArray[np.float64]
    across: NDArray[np.float64]
    angles: NDArray[np.float64]
    angle_sigma: NDArray[np.float64]
    off_mm: NDArray[np.float64]
    off_rad: NDArray[np.float64]

    @property
    def shift_sigma_mm(self) -> float:
        """Return the standard deviation of the axis across itself, mm (the larger one)."""
        return float(np.sqrt(np.linalg.eigvalsh(self.axis_covariance[:2, :2])[-1]))

    @property
    def lean_sigma(self) -> float:
        """Return the standard deviation of its direction, rad (the larger one)."""
        return float(np.sqrt(np.linalg.eigvalsh(self.axis_covariance[2:, 2:])[-1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """Views in one frame, and how far that is to be trusted.

    Parameters
    ----------
    body_from_view : tuple of RigidTransform; the body frame is the world frame of the first view
    covariance : (6 n, 6 n) float; turn (rad, about the body's middle) and shift (mm) of each view
    middle_mm : (3,) float, mm; of the body
    before, after : tuple of PairResidual; of the overlaps at the start, and as adjusted
    noise_factor : float; size of the residuals over what the sigmas of the points explain
    closure_mm, closure_rad : float; what is left when pairs are registered one by one around the
        table and back; NaN where there is no way round
    table : FoundTable or None
    n_iterations : int
    """

    body_from_view: tuple[RigidTransform, ...]
    covariance: NDArray[np.float64]
    middle_mm: NDArray[np.float64]
    before: tuple[PairResidual, ...]
    after: tuple[PairResidual, ...]
    noise_factor: float
    closure_mm: float
    closure_rad: float
    table: FoundTable | None
    n_iterations: int

    def sigma_mm(self, view: int, /) -> float:
        """Return the standard deviation of a view's place at the middle of the body, mm."""
        part = self.covariance[6 * view + 3 : 6 * view + 6, 6 * view + 3 : 6 * view + 6]
        return float(np.sqrt(np.trace(part)))

    def sigma_rad(self, view: int, /) -> float:
        """Return the standard deviation of its turn, rad."""
        part = self.covariance[6 * view : 6 * view + 3, 6 * view : 6 * view + 3]
        return float(np.sqrt(np.trace(part)))
