"""Learning the calibration's bias from the residuals of points whose fringe order is clear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _robust
from fringe3d.model import CalibrationBias, Device
from fringe3d.model.bias import N_TERMS, terms_of

Floats = NDArray[np.float64]

PRIOR_PX = 0.25
"""What a good calibration misses by, as a displacement in C2."""

LEAST_PART, LEAST_PIXELS = 0.2, 2000
"""Fewer clear decisions tell nothing about the rest."""

LEAST_SCATTER_PX = 0.04
SAMPLE = 8_000
ROUNDS = 8
MAD_TO_SIGMA = 1.4826

PATCH_PX = 16
"""Width of the patches within which errors are alike."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Over what the displacement is a function: `middle` and `scale` of `CalibrationBias`."""

    middle: Floats
    scale: Floats
    angle: float

    def prior_px(self) -> Floats:
        """Return the expected size of each coefficient, (9,).

        What changes with the depth is smaller in the measure in which the depth changes.
        """
        of_depth = min(1.0, 2 * self.scale[2] / self.middle[2])
        return PRIOR_PX * np.array([1.0] * 6 + [of_depth] * 3)

    def bias(
        self, coefficients: Floats, *, scatter_px: float, covariance_px2: Floats | None = None
    ) -> CalibrationBias:
        """Return a bias with these coefficients, (18,)."""
        return CalibrationBias(
            coefficients_px=coefficients.reshape(2, N_TERMS),
            middle=self.middle,
            scale=self.scale,
            scatter_px=scatter_px,
            covariance_px2=covariance_px2,
            angle=self.angle,
        )

    def constant(self, displacement: tuple[float, ...], *, scatter_px: float) -> CalibrationBias:
        """Return the same displacement (2,), px, everywhere."""
        coefficients = np.zeros((2, N_TERMS))
        coefficients[:, 0] = displacement
        return self.bias(coefficients, scatter_px=scatter_px)


def frame_of(camera: Device, depths_mm: tuple[float, float], angle: float, /) -> Frame:
    """Return the frame of an image of C1 and a range of distances along its rays."""
    near, far = depths_mm
    size = np.array([camera.n_cols, camera.n_rows])
    return Frame(
        middle=np.r_[(size - 1) / 2, (near + far) / 2],
        scale=np.r_[size / 2, max((far - near) / 2, 1e-6)],
        angle=angle,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Residuals of points whose order is clear, (n, ...).

    Parameters
    ----------
    pixels : (n, 2) float, px; of C1
    depths_mm : (n,) float
    difference : (n,) float, turns; phase that C2 shows less that of C1
    gradient : (n, 2) float, turns / px; of the phase in C2
    variance : (n,) float, turns**2; of the difference, but for the calibration
    """

    pixels: Floats
    depths_mm: Floats
    difference: Floats
    gradient: Floats
    variance: Floats

    def __len__(self) -> int:
        return len(self.difference)

    def part(self, index: NDArray[np.intp] | slice) -> Evidence:
        """Return some of the points."""
        return Evidence(
            pixels=self.pixels[index],
            depths_mm=self.depths_mm[index],
            difference=self.difference[index],
            gradient=self.gradient[index],
            variance=self.variance[index],
        )


def joined(parts: Sequence[Evidence], /) -> Evidence:
    """Return the points of several measurements together."""
    return Evidence(
        **{f.name: np.concatenate([getattr(part, f.name) for part in parts])
           for f in fields(Evidence)}
    )  # fmt: skip


def learn_bias(
    evidence: Evidence,
    frame: Frame,
    /,
    *,
    start: CalibrationBias | None = None,
    known: CalibrationBias | None = None,
    n_alike: float = PATCH_PX**2,
) -> CalibrationBias:
    """Fit a smooth displacement to residuals.

    Parameters
    ----------
    evidence : Evidence
    frame : Frame
    start : CalibrationBias or None; where the residuals are unwrapped around, and the fit begins
    known : CalibrationBias or None; what other measurements have shown, with its covariance; in the
        same frame. None expects no more than that a calibration is good
    n_alike : float; neighbours whose errors are alike: harmonics, interpolation, reflections. They
        are one datum against the prior

    Returns
    -------
    CalibrationBias

    Notes
    -----
    A displacement ``d`` in C2 shows as ``gradient . d``. Robust least squares (Cauchy weights) with
    a ridge prior.
    """
    part = evidence.part(slice(None, None, max(1, len(evidence) // SAMPLE)))
    terms = terms_of(part.pixels, part.depths_mm, frame.middle, frame.scale)
    design = np.hstack([part.gradient[:, :1] * terms, part.gradient[:, 1:] * terms])
    mean, prior = expected(frame, known)
    data = np.column_stack([part.difference, part.variance, (part.gradient**2).sum(axis=1)])
    noise_px = _noise_px(data)
    share = len(evidence) / max(len(part), 1) / n_alike  # patches for each datum
    coefficients: Floats = np.zeros(2 * N_TERMS)
    if start is not None:
        coefficients = start.coefficients_px.ravel()
    scatter = 0.3 if start is None else max(start.scatter_px, LEAST_SCATTER_PX)
    normal, right = np.empty(prior.shape), np.empty(len(prior))
    unwrapped, misfit = np.empty(len(part)), np.empty(len(part))
    for _ in range(ROUNDS):
        _robust.normal_equations(
            design, data, coefficients, scatter, share, normal, right, unwrapped
        )
        coefficients = np.asarray(np.linalg.solve(normal + prior, right + prior @ mean), np.float64)
        _robust.misfit_per_px(design, unwrapped, data, coefficients, misfit)
        spread = MAD_TO_SIGMA * _median(misfit)
        scatter = max(float(np.sqrt(max(spread**2 - noise_px**2, 0))), LEAST_SCATTER_PX)
    covariance = np.linalg.inv(normal + prior)
    found = frame.bias(
        coefficients, scatter_px=scatter, covariance_px2=(covariance + covariance.T) / 2
    )
    return replace(found, sigma_px=_uncertainty(found, part.gradient))


def expected(frame: Frame, known: CalibrationBias | None, /) -> tuple[Floats, Floats]:
    """Return the coefficients that are expected, (18,), and how surely: the inverse covariance."""
    if known is None or known.covariance_px2 is None:
        return np.zeros(2 * N_TERMS), np.diag(np.tile(frame.prior_px(), 2) ** -2.0)
    return known.coefficients_px.ravel(), np.asarray(np.linalg.inv(known.covariance_px2))


def _noise_px(data: Floats) -> float:
    """Return what noise alone displaces a point by, px; see `_robust` for the data."""
    usable = data[:, 2] > 0
    return _median(np.sqrt(data[usable, 1] / data[usable, 2]))


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _uncertainty(bias: CalibrationBias, gradient: Floats) -> float:
    """Return the standard deviation of the displacement across the fringes, rms over image and
    volume, px. Along them nothing shows it, and nothing depends on it."""
    across = np.linalg.eigh(gradient.T @ gradient)[1][:, -1]
    x, y, t = (a.ravel() for a in np.meshgrid(*[np.linspace(-0.8, 0.8, 5)] * 3))
    terms = terms_of(np.stack([x, y], axis=1), t, np.zeros(3), np.ones(3))
    variance = np.einsum("ij,jk,ik->i", terms, bias.covariance_along(across), terms)
    return float(np.sqrt(np.mean(variance)))
