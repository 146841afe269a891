"""Less noise for the choice of fringe orders: the phase averaged over neighbours of one surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond._smoothing import average
from fringe3d.correspond.weighing import TwoViews
from fringe3d.kernels import over_rows
from fringe3d.model import PhaseMap

NOISY_RAD = (0.035, 0.06)
"""Standard deviations of the phase beyond which orders are chosen by averages over three by three,
and over five by five pixels. Little noise harms less than what averaging takes from steep walls."""

LEAST_RAD = 0.02
"""Of an average: what neighbours have in common (harmonics, interpolation, mixed light) stays."""

PAIR_RAD, PAIR_SIGMA = 0.05, 2.0
"""Second difference of a pair and the pixel between: curvature, and noise. A steep wall is a few
pixels wide, and hardly rises above it."""


def quiet(views: TwoViews, /) -> TwoViews:
    """Return the views with phases averaged over as many neighbours as their noise demands.

    Parameters
    ----------
    views : TwoViews

    Returns
    -------
    TwoViews; the same where the noise is low. The phases may lie a little beyond 0 and 2 pi: they
        belong to the same fringe orders as before
    """
    return replace(views, phases1=_quiet(views.phases1), phases2=_quiet(views.phases2))


def averaged_phase(
    phase: NDArray[np.float32], sigma: NDArray[np.float32], radius: int, /
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Average the phase over neighbours of one surface.

    Parameters
    ----------
    phase : (row, col) float32, rad; NaN where unknown
    sigma : (row, col) float32, rad; standard deviation of each
    radius : int, px; averages are taken over 2 radius + 1 rows and columns

    Returns
    -------
    phase : (row, col) float32, rad; not wrapped again
    sigma : (row, col) float32, rad; of the average, as if the neighbours' were alike

    Notes
    -----
    Pixels are taken in pairs that lie opposite each other: on a plane wave the mean of a pair is
    the phase in the middle, however steep it is, so that the carrier need not be known. A pair
    across an edge or a bend deviates, and is left out.

    Examples
    --------
    >>> x = np.arange(8, dtype=np.float32)
    >>> wave = np.broadcast_to((2.5 * x) % (2 * np.pi), (5, 8))
    >>> phase, sigma = averaged_phase(wave, np.full((5, 8), 0.1, np.float32), 1)
    >>> bool(np.allclose(phase, wave, atol=1e-5)), round(float(sigma[2, 3]), 3)
    (True, 0.033)
    """
    averaged, sigma_averaged = np.empty_like(phase), np.empty_like(sigma)
    # A pair less twice the middle has six times the variance of a pixel.
    limits = np.float32(PAIR_RAD), np.float32(PAIR_SIGMA * np.sqrt(6))
    over_rows(average, len(phase), phase, sigma, radius, limits, averaged, sigma_averaged)
    return averaged, sigma_averaged


def _quiet(phases: PhaseMap) -> PhaseMap:
    known = np.isfinite(phases.phase)
    noise = float(np.median(phases.phase_std[known])) if known.any() else 0.0
    radius = int(np.searchsorted(NOISY_RAD, noise))
    if radius == 0:
        return phases
    phase, sigma = averaged_phase(phases.phase, phases.phase_std, radius)
    return replace(phases, phase=phase, phase_std=np.maximum(sigma, np.float32(LEAST_RAD)))
