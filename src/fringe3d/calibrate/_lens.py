"""How many distortion terms the data hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._problem import Problem
from fringe3d.calibrate._solve import Solution, fields_of
from fringe3d.calibrate._start import CAUCHY

Floats = NDArray[np.float64]
Lens = Literal["pinhole", "k1", "k1 p1 p2", "k1 k2 p1 p2", "k1 k2 p1 p2 k3"]

LENSES: tuple[Lens, ...] = ("pinhole", "k1", "k1 p1 p2", "k1 k2 p1 p2", "k1 k2 p1 p2 k3")
"""From simple to complex; each holds those before it."""

CONVINCING = 30.0
"""By so much chi^2 must fall where a more complex lens was not fitted. Terms that are not there
let it rise by one each, give or take; what the cameras bend may let it fall by ten."""

MOST_FIELDS = 0.6
"""Part of the fields that must gain; errors that are not the lens's help some and harm others."""

OUTLIER_SIGMA = 6.0


@dataclass(frozen=True, slots=True)
class LensTrial:
    """How well a lens model fits points that it was not fitted to.

    Parameters
    ----------
    lens : str; its terms
    held_out_rms_px : float, px; without outliers
    gain : float; chi^2 of the held-out points below that of the lens kept until then
    gaining : float; part of the image fields in which it fits better
    """

    lens: Lens
    held_out_rms_px: float
    gain: float
    gaining: float


def choose_lens(
    problem: Problem, begun: Solution, wanted: Sequence[Lens], /
) -> tuple[tuple[LensTrial, ...], Lens]:
    """Fit each lens to half of the fields, judge it on the other half, and the other way round.

    Parameters
    ----------
    problem : Problem
    begun : Solution; where to begin, and the noise to assume
    wanted : sequence of str; the lenses to try, from simple to complex; the simplest is kept that
        no other surpasses

    Returns
    -------
    trials, lens
    """
    field = fields_of(problem.rows.block)
    trials: list[LensTrial] = []
    kept = wanted[0]
    kept_score = np.empty(0)
    for lens in wanted:
        residual, sigma = _held_out(problem, begun, lens, field)
        z = residual / sigma
        score = CAUCHY**2 * np.log1p((z / CAUCHY) ** 2) / begun.crowding
        gains = np.bincount(field, (kept_score - score) if trials else None)
        gain = float(gains.sum()) if trials else 0.0
        gaining = float((gains > 0).sum() / (np.bincount(field) > 0).sum()) if trials else 0.0
        kept_in = np.abs(z) < OUTLIER_SIGMA
        rms = float(np.sqrt(np.mean(residual[kept_in] ** 2))) if kept_in.any() else float("nan")
        trials.append(LensTrial(lens, rms, gain, gaining))
        if len(trials) == 1 or (gain > CONVINCING and gaining > MOST_FIELDS):
            kept, kept_score = lens, score
    return tuple(trials), kept


def _held_out(
    problem: Problem, begun: Solution, lens: Lens, field: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return residuals of each half by the fit to the other, and their sigma, px."""
    residual, sigma = np.empty(len(field)), np.empty(len(field))
    for part in (0, 1):
        mine = field % 2 == part
        if not mine.any() or mine.all():
            mine = np.arange(len(field)) % 2 == part
        fitted = replace(problem, rows=problem.rows.take(~mine)).solve(begun, lens)
        residual[mine], _, sigma[mine] = fitted.predicted(problem.rows.take(mine))
    return residual, sigma
