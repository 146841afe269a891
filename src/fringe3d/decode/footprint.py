"""Phases of pixel centres: a pixel and its lens average the light of an area."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringe3d.decode import _footprint
from fringe3d.decode.camera import CameraPhases
from fringe3d.kernels import over_rows
from fringe3d.model import PhaseMap

PIXEL_VARIANCE = 1 / 12
"""px**2; of a square pixel, along each axis."""

INTERPOLATION = 1 / 12
"""Bilinear interpolation adds ``f (1 - f) / 2`` of the second differences, on average this."""

REMAINDER = (1 / 30 - 1 / 36) / 4
"""Mean square of what ``f (1 - f) / 2`` differs from that by."""

DOUBT = 0.25
"""Part of the correction that stays uncertain: a lens blurs by 0.3 to 0.45 px rather than 0.4."""

MISFIT, MISFIT_BETWEEN = 0.065, 2.5
"""Part of the variance that the neighbours leave of a parabola, beyond their noise, which reaches
the pixel: detail finer than five pixels, and light of a surface beside it; and how much more it is
between pixels. Chosen for scans of teeth and a ball: errors there are fewer and larger than those
of a normal distribution, so that the middle half of them is smaller than sigma says."""

SHARED = 9 / 4
"""Neighbours share these errors; the mean weights of an interpolation are those of errors that are
their own."""

MIXED_PX = 0.15
"""Standard deviation of where a pixel beside one without a phase has its light from."""


def centred_camera(phases: CameraPhases, /, *, blur_px: float, is_first: bool) -> CameraPhases:
    """Return the phases of a camera at the centres of its pixels.

    Parameters
    ----------
    phases : CameraPhases
    blur_px : float, px, >= 0; standard deviation of the lens blur
    is_first : bool; False for cameras whose phases are interpolated between pixels

    Returns
    -------
    CameraPhases; the main phase map of each direction corrected
    """
    directions = tuple(
        replace(d, main=centred(d.main, blur_px=blur_px, is_first=is_first))
        for d in phases.directions
    )
    return replace(phases, directions=directions)


def centred(phases: PhaseMap, /, *, blur_px: float = 0.4, is_first: bool = True) -> PhaseMap:
    """Return the phase at the centre of each pixel; the orders stay, the phase may leave [0, 2 pi).

    Parameters
    ----------
    phases : PhaseMap; a map known to whole code cells only stays as it is; of a filtered one, what
        its `detailed_std` counts stays
    blur_px : float, px, >= 0; standard deviation of the lens blur
    is_first : bool; see `centred_camera`

    Returns
    -------
    PhaseMap; `detailed_std` with what stays uncertain

    Notes
    -----
    A pixel adds up the phasors ``B exp(i phi)`` of an area of variance ``s = 1/12 + blur**2`` along
    each axis. To the second order their mean has the phase ``phi + s (laplace phi / 2 + grad phi .
    grad ln B)``: a bent surface seems farther away, and where its brightness changes the pixel sees
    its brighter part. Both derivatives are those of a parabola through 5 x 5 pixels, whose noise is
    a hundredth of the pixel's. Where phases are interpolated, ``laplace phi / 12`` is added, by
    which straight lines between pixels miss a curve on average.

    Examples
    --------
    >>> import math
    >>> from fringe3d.model import NO_ORDER
    >>> x = np.arange(9.0)
    >>> bent = np.broadcast_to(0.1 * x**2, (9, 9))
    >>> one = np.ones((9, 9))
    >>> phases = PhaseMap(phase=bent, order_class=0 * one, class_of_order=[0], phase_std=one / 100,
    ...     offset=100 * one, modulation=90 * one, rejection=0 * one, period_px=16.0, angle=0.0,
    ...     device_name="c1")
    >>> found = centred(phases, blur_px=0.0)
    >>> round(float(phases.phase[4, 4] - found.phase[4, 4]), 5), round(0.2 / 24, 5)
    (0.00833, 0.00833)
    """
    if phases.is_quantised:
        return phases
    answer, sigma = np.empty_like(phases.phase), np.empty_like(phases.phase)
    footprint = PIXEL_VARIANCE + blur_px**2
    interpolation = 0.0 if is_first else INTERPOLATION
    growth, alike = _growth(footprint / 2 + interpolation)
    if phases.detailed_std is not None:  # filtered: bends have hardly any noise
        growth, alike = 1.0, phases.alike
    elif not is_first:  # see `PhaseMap.alike`
        growth *= (alike + (1 - alike) * 4 / 9) / (4 / 9)
    numbers = (
        footprint,
        interpolation,
        DOUBT * (1.0 if is_first else SHARED**0.5),
        0.0 if is_first else REMAINDER * SHARED,
        MISFIT * (1.0 if is_first else MISFIT_BETWEEN * SHARED),
        MIXED_PX,
        growth,
    )
    over_rows(_footprint.centre, len(answer), phases.phase, phases.phase_std, phases.modulation,
              tuple(map(np.float32, numbers)), answer, sigma)  # fmt: skip
    if phases.detailed_std is not None:
        with np.errstate(invalid="ignore"):  # infinite where there is no modulation
            flattened = phases.detailed_std**2 - phases.phase_std**2
        sigma = np.sqrt(sigma**2 + np.maximum(np.nan_to_num(flattened), 0))
    return replace(phases, phase=answer, detailed_std=sigma, alike=0.0 if is_first else alike)


def _growth(part: float) -> tuple[float, float]:
    """Return by how much a correction by a part of the second differences raises the variance, and
    how alike it makes the errors of neighbours.

    The second differences of a parabola weigh the pixel by -4 / 35, the next by -3 and -2 / 35.
    """
    variance = 1 + 8 * part / 35 + 4 * part**2 / 35
    return variance, (6 + 4) / 2 * part / 35 / variance
