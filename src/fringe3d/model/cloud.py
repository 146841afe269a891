"""Points: organised on the grid of C1, and as a plain cloud."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen, require_shape
from fringe3d.model.html import picture, table
from fringe3d.model.rejection import count_by_reason


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointMap:
    """Points on the pixel grid of C1.

    Parameters
    ----------
    points_mm : (row, col, 3) float64, mm, world frame; NaN where rejected
    sigma_mm : (row, col) float32, mm; standard deviation along the viewing ray of C1
    skew_mm : (row, col) float32, mm; shortest distance of the two rays
    rejection : (row, col) uint32; `Rejection` bits; 0 exactly where there is a point
    """

    points_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float32]
    skew_mm: NDArray[np.float32]
    rejection: NDArray[np.unsignedinteger[Any]]

    def __post_init__(self) -> None:
        for name, dtype in (
            ("points_mm", np.float64),
            ("sigma_mm", np.float32),
            ("skew_mm", np.float32),
            ("rejection", np.uint32),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))
        sums = self.points_mm @ np.ones(3)  # finite where all three are
        if not np.array_equal(np.isfinite(sums), self.rejection == 0):
            raise ValueError("point map: every pixel must have a point or a reason, and not both")

    @property
    def is_valid(self) -> NDArray[np.bool_]:
        """Return (row, col); True where there is a point."""
        return np.asarray(self.rejection == 0)

    @property
    def n_points(self) -> int:
        """Return the number of pixels with a point."""
        return int(self.is_valid.sum())

    def _repr_html_(self) -> str:
        n_pixels = self.rejection.size
        rows: list[tuple[str, object]] = [("points", f"{self.n_points:,} of {n_pixels:,} pixels")]
        if self.n_points:
            good = self.is_valid
            z, sigma = self.points_mm[..., 2][good], 1000 * np.median(self.sigma_mm[good])
            rows.append(("z", f"{z.min():.2f} to {z.max():.2f} mm"))
            rows.append(("sigma along the ray", f"median {sigma:.1f} um"))
        rows += [
            (name.replace("_", " ").lower(), f"{count:,} px")
            for name, count in count_by_reason(self.rejection).items()
        ]
        return table("points on the pixels of C1", rows, more=picture(self.points_mm[..., 2]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointCloud:
    """A plain list of points.

    Parameters
    ----------
    points_mm : (n, 3) float64, mm
    sigma_mm : (n,) float32, mm; standard deviation along the viewing ray
    grey : (n,) uint8; brightness of the surface
    source_index : (n, 2) int32; (row, col) of the pixel of C1
    """

    points_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]
    source_index: NDArray[np.int32]

    def __post_init__(self) -> None:
        n = len(self.points_mm)
        for name, dtype, shape in (
            ("points_mm", np.float64, (n, 3)),
            ("sigma_mm", np.float32, (n,)),
            ("grey", np.uint8, (n,)),
            ("source_index", np.int32, (n, 2)),
        ):
            array = frozen(getattr(self, name), dtype)
            require_shape(f"cloud: {name}", array, shape)
            object.__setattr__(self, name, array)
