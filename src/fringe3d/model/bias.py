"""The smooth error of a calibration, as a thing of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model._array import frozen, require_finite, require_shape

N_TERMS = 9
"""1, x, y, x², xy, y², t, tx, ty."""


SAME_ANGLE = 0.02
"""rad; light sheets that lie within a degree have the same bias."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationBias:
    """Where the calibration expects points in C2, less where C2 sees them.

    A point is placed by its pixel in C1 and by the light sheet of its phase; the calibration tells
    where C2 should see it. What is missed depends on the rig alone, and is smooth.

    Parameters
    ----------
    coefficients_px : (2, 9) float, px; of the displacement in C2 in x and y, for the terms 1, x, y,
        x², xy, y², t, tx, ty
    middle, scale : (3,) float; (x, y, t) are the pixel in C1 and the distance along its ray, mm,
        less `middle` and over `scale`: about -1 to 1 in image and volume
    scatter_px : float, px, >= 0; what the function leaves unexplained
    sigma_px : float, px; how well the displacement across the fringes is known, rms over image and
        volume
    covariance_px2 : (18, 18) float, px^2, or None; of the coefficients, those in x first
    angle : float, rad; of the fringes: the light sheets of another direction have another bias
    source : str; what it was learnt from

    Examples
    --------
    >>> bias = CalibrationBias(coefficients_px=[[0.2] + [0] * 8, [0.1] * 2 + [0] * 7],
    ...                        middle=[319.5, 255.5, 335.0], scale=[320.0, 256.0, 20.0])
    >>> bias.displacement([[319.5, 255.5], [639.5, 255.5]], [335.0, 330.0]).round(9).tolist()
    [[0.2, 0.1], [0.2, 0.2]]
    """

    coefficients_px: NDArray[np.float64]
    middle: NDArray[np.float64]
    scale: NDArray[np.float64]
    scatter_px: float = 0.0
    sigma_px: float = 0.0
    covariance_px2: NDArray[np.float64] | None = None
    angle: float = 0.0
    source: str = ""

    def __post_init__(self) -> None:
        for name, shape in (("coefficients_px", (2, N_TERMS)), ("middle", (3,)), ("scale", (3,))):
            array = np.asarray(getattr(self, name), np.float64)
            require_shape(f"bias: {name}", array, shape)
            require_finite(f"bias: {name}", array)
            object.__setattr__(self, name, frozen(array, np.float64))
        if self.covariance_px2 is not None:
            object.__setattr__(self, "covariance_px2", _covariance(self.covariance_px2))
        if not (self.scale > 0).all():
            raise ValueError(f"bias: scale: expected numbers > 0, found {self.scale.tolist()}")

    @property
    def rms_px(self) -> float:
        """Return the size of the displacement, rms over image and volume, px."""
        grid = [
            np.linspace(-0.8, 0.8, 5) * s + m for s, m in zip(self.scale, self.middle, strict=True)
        ]
        x, y, t = (a.ravel() for a in np.meshgrid(*grid))
        missed = self.displacement(np.stack([x, y], axis=1), t)
        return float(np.sqrt((missed**2).sum(axis=1).mean()))

    def covariance_along(self, axis: NDArray[np.float64], /) -> NDArray[np.float64]:
        """Return the covariance of the terms, (9, 9), px^2, along a unit vector (2,) of C2's image;
        0 where it is not known."""
        if self.covariance_px2 is None:
            return np.zeros((N_TERMS, N_TERMS))
        parts = self.covariance_px2.reshape(2, N_TERMS, 2, N_TERMS)
        return np.asarray(np.einsum("i,iajb,j->ab", axis, parts, axis))

    def fits(self, angle: float, /) -> bool:
        """Tell whether it belongs to fringes of an angle, rad."""
        return bool(abs(np.sin(angle - self.angle)) < SAME_ANGLE)

    def displacement(self, pixels: ArrayLike, depths_mm: ArrayLike, /) -> NDArray[np.float64]:
        """Return (n, 2), px in C2, for pixels (n, 2) of C1 and distances (n,) along their rays."""
        at = self.along(np.asarray(pixels, np.float64))
        depths = np.asarray(depths_mm, np.float64)
        return np.asarray(at[:, :2] + at[:, 2:] * depths[:, None])

    def along(self, pixels: NDArray[np.float64], /) -> NDArray[np.float64]:
        """Return (n, 4): displacement at depth 0, px, (x, y), and its rise with depth, px / mm."""
        terms = terms_of(pixels, np.zeros(len(pixels)), self.middle, self.scale)
        rise = terms[:, :3] @ self.coefficients_px[:, 6:].T / self.scale[2]
        at_middle = terms[:, :6] @ self.coefficients_px[:, :6].T
        return np.hstack([at_middle - rise * self.middle[2], rise])


def _covariance(matrix: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(matrix, np.float64)
    require_shape("bias: covariance_px2", array, (2 * N_TERMS, 2 * N_TERMS))
    require_finite("bias: covariance_px2", array)
    if not np.allclose(array, array.T) or np.linalg.eigvalsh(array).min() <= 0:
        raise ValueError("bias: covariance_px2: expected a symmetric positive definite matrix")
    return frozen(array, np.float64)


def terms_of(
    pixels: NDArray[np.float64],
    depths_mm: NDArray[np.float64],
    middle: NDArray[np.float64],
    scale: NDArray[np.float64],
    /,
) -> NDArray[np.float64]:
    """Return the terms of `CalibrationBias`, (n, 9)."""
    x, y = ((pixels - middle[:2]) / scale[:2]).T
    t = (depths_mm - middle[2]) / scale[2]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, t, t * x, t * y], axis=1)
