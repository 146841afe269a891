"""Noise of correspondences: what the place between four pixels makes of theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _noise
from fringe3d.correspond.direct import Located
from fringe3d.geometry.projection import readable
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import Correspondences, PhaseMap


def variance_between(phases: PhaseMap, places: NDArray[np.float64], /) -> NDArray[np.float64]:
    """Return the variance of the phase at places between pixels, (n,), rad**2.

    Parameters
    ----------
    phases : PhaseMap
    places : (n, 2) float64, px; (x, y)

    Notes
    -----
    ``sum(w**2 sigma**2)`` over the weights w of the bilinear interpolation: 1 at a pixel, 1/4 in
    the middle of four, 4/9 on average. Where rows of both cameras run alike it is the same along
    them, and the average is true of none.
    """
    variance = np.zeros(len(places))
    over_rows(_noise.between, len(places), np.ascontiguousarray(places), phases.phase,
              phases.point_std, phases.alike, variance, least=POINTS)  # fmt: skip
    return variance


def with_true_sigma(
    matches: Correspondences, phases1: PhaseMap, phases2: PhaseMap, located: Located | None, /
) -> tuple[Correspondences, Located | None]:
    """Return correspondences and points with the noise of their own place between pixels.

    Parameters
    ----------
    matches : Correspondences, whose `sigma_px` counts with the mean weights of an interpolation
    phases1, phases2 : PhaseMap of C1 and C2
    located : Located or None; points that are known already
    """
    sigma_px = matches.sigma_px.copy()
    sigma_mm = np.zeros_like(sigma_px) if located is None else located.met.sigma_mm.copy()
    todo = np.ones(sigma_px.shape, np.bool_) if located is None else located.todo
    over_rows(
        _noise.correct, len(sigma_px), readable(matches.pixels),
        (phases1.phase_std, phases1.point_std), phases2.phase,
        (phases2.phase_std, phases2.point_std), phases2.alike, readable(todo),
        (sigma_px, sigma_mm),
    )  # fmt: skip
    if located is not None:
        located = replace(located, met=located.met._replace(sigma_mm=sigma_mm))
    return replace(matches, sigma_px=sigma_px), located
