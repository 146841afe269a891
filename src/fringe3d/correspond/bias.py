"""The calibration's smooth error, as displacement of points along their curves in C2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PRIOR_PX, DEPTH_PRIOR_PX = 0.25, 0.05
"""Displacements that are not seen are taken to be of this size; those that change with the depth
are smaller, and a single surface does not tell them from those that change with the pixel."""

LEAST_PART, LEAST_PIXELS = 0.2, 2000
"""Fewer clear decisions tell nothing about the rest."""

LEAST_SCATTER_PX = 0.04
SAMPLE = 20_000
ROUNDS = 8
MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bias:
    """Displacement in C2, px along the epipolar curve, as a smooth function of pixel and depth.

    Parameters
    ----------
    coefficients : (12,) float64, px; quadratic in the pixel, linear in the depth
    middle, scale : (3,) float64; of (x, y, depth), that map the data to about -1 to 1
    scatter_px : float, px; what the function leaves unexplained
    is_known : bool; False where nothing was learnt and all coefficients are 0
    """

    coefficients: NDArray[np.float64]
    middle: NDArray[np.float64]
    scale: NDArray[np.float64]
    scatter_px: float
    is_known: bool

    def along(self, pixels: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (n,) px and (n,) px / mm: the displacement at depth 0 and its rise with depth.

        Parameters
        ----------
        pixels : (n, 2) float, px; of C1
        """
        terms = _terms(pixels, self.middle[:2], self.scale[:2])
        rise = terms @ self.coefficients[6:] / self.scale[2]
        return terms @ self.coefficients[:6] - rise * self.middle[2], rise


def no_bias(scatter_px: float, /) -> Bias:
    """Return a bias of which nothing is known but its size, px."""
    return Bias(coefficients=np.zeros(12), middle=np.zeros(3), scale=np.ones(3),
                scatter_px=scatter_px, is_known=False)  # fmt: skip


def learn_bias(
    pixels: NDArray[np.float64],
    depths_mm: NDArray[np.float64],
    /,
    *,
    residual: NDArray[np.float64],
    noise: NDArray[np.float64],
    obliqueness: NDArray[np.float64],
    is_clear: NDArray[np.bool_],
    expected_px: float,
) -> Bias:
    """Fit a smooth displacement to the residuals of the pixels whose order is clear.

    Parameters
    ----------
    pixels : (n, 2) float, px; of C1
    depths_mm : (n,) float, mm
    residual, noise : (n,) float, px in C2 along the curve; noise is without the calibration's
    obliqueness : (n,) float; phase gradient of C2 along the curve over the whole one: what
        displaces points in any direction shows so much larger along the curve
    is_clear : (n,) bool
    expected_px : float, px; the scatter where nothing can be learnt

    Returns
    -------
    Bias

    Notes
    -----
    Robust least squares (Cauchy weights) with a ridge prior.
    """
    known = np.isfinite(residual) & np.isfinite(noise) & np.isfinite(obliqueness)
    usable = np.flatnonzero(is_clear & known)
    if len(usable) < max(LEAST_PIXELS, LEAST_PART * len(pixels)):
        return no_bias(expected_px)
    usable = usable[:: max(1, len(usable) // SAMPLE)]
    data = np.column_stack([pixels[usable], depths_mm[usable]])
    middle, scale = data.mean(axis=0), np.maximum(2 * data.std(axis=0), 1e-9)
    terms = _terms(pixels[usable], middle[:2], scale[:2])
    terms = np.hstack([terms, terms * ((depths_mm[usable] - middle[2]) / scale[2])[:, None]])
    prior = np.diag(np.repeat([PRIOR_PX, DEPTH_PRIOR_PX], 6) ** -2.0)
    y = residual[usable]
    coefficients: NDArray[np.float64] = np.zeros(terms.shape[1])
    scatter = max(MAD_TO_SIGMA * float(np.median(np.abs(y - np.median(y)))), LEAST_SCATTER_PX)
    for _ in range(ROUNDS):
        left = y - terms @ coefficients
        weight = 1 / (1 + (left / (2 * scatter)) ** 2) / scatter**2
        normal = (terms * weight[:, None]).T @ terms + prior
        coefficients = np.asarray(np.linalg.solve(normal, (terms * weight[:, None]).T @ y))
        left = y - terms @ coefficients
        scatter = max(MAD_TO_SIGMA * float(np.median(np.abs(left))), LEAST_SCATTER_PX)
    oblique = obliqueness[usable]
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(y - terms @ coefficients) * oblique))
    own = float(np.median(noise[usable] * oblique))
    scatter = max(float(np.sqrt(max(scatter**2 - own**2, 0))), LEAST_SCATTER_PX)
    return Bias(coefficients=coefficients, middle=middle, scale=scale, scatter_px=scatter,
                is_known=True)  # fmt: skip


def _terms(
    pixels: NDArray[np.float64], middle: NDArray[np.float64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    x, y = ((pixels - middle) / scale).T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
