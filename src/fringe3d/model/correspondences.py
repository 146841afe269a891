"""Where the second device sees what a pixel of C1 sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correspondences:
    """Homologous points of C1 and another device, on the pixel grid of C1.

    Parameters
    ----------
    device_name : str; the other device
    pixels_c1 : (row, col, 2) float64, px; (x, y) in C1: the pixel itself or, where a code without
        fringes gives several pixels one projector pixel, the middle of them
    pixels : (row, col, 2) float64, px; (x, y) in the other device; NaN where rejected
    sigma_px : (row, col) float32, px; standard deviation along the epipolar curve
    epipolar_residual_px : (row, col) float32, px; signed distance from the epipolar curve in the
        other device; NaN where the point was searched on that curve
    fringe_order : (row, col) int32; the order (or class of orders) used; `NO_ORDER` where rejected
    rejection : (row, col) uint16; `Rejection` bits
    order_probability : (row, col) float32; of the order among all that were possible; 1 where
        the code decided (the default); NaN where rejected
    """

    device_name: str
    pixels_c1: NDArray[np.float64]
    pixels: NDArray[np.float64]
    sigma_px: NDArray[np.float32]
    epipolar_residual_px: NDArray[np.float32]
    fringe_order: NDArray[np.int32]
    rejection: NDArray[np.uint16]
    order_probability: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        for name, dtype in (
            ("pixels_c1", np.float64),
            ("pixels", np.float64),
            ("sigma_px", np.float32),
            ("epipolar_residual_px", np.float32),
            ("fringe_order", np.int32),
            ("rejection", np.uint16),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))
        certain = np.where(self.rejection == 0, np.float32(1), np.float32(np.nan))
        given = certain if self.order_probability is None else self.order_probability
        object.__setattr__(self, "order_probability", frozen(given, np.float32))
        if self.pixels.shape != (*self.rejection.shape, 2):
            raise ValueError(
                f"correspondences: expected pixels of shape {(*self.rejection.shape, 2)}, "
                f"found {self.pixels.shape}"
            )
