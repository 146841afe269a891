"""All views at once: poses that agree best over all overlaps, and the table that they stood on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import PairResidual, Registration, RigidTransform, SurfaceView
from fringe3d.register._normal import Overlaps
from fringe3d.register.closing import closure
from fringe3d.register.overlap import Sample, sample_of
from fringe3d.register.small_motion import motion_of, tidy
from fringe3d.register.table_model import TableFit, TablePrior, start_of_table

Floats = NDArray[np.float64]

N_SAMPLES = 6000
"""Points of each view that the adjustment rests on."""

FIRST_SAMPLES = 1500
"""While views still lie far apart."""

LOOSE = 200.0
"""How much farther poses may lie beside the table's until they have settled: so a view that does
not stand on it is seen, and cannot pull at the axis."""

MOST_ROUNDS = 30
CONVERGED = 0.02
"""Part of a pose's sigma by which no pose moves any more."""

SHRINK = 0.5
LIMIT_OF_NOISE = 12.0
"""Distances up to so many robust sizes belong to an overlap."""

SEED = 20261201


@dataclass(frozen=True, slots=True, kw_only=True)
class AdjustOptions:
    """How views are adjusted.

    Parameters
    ----------
    n_samples : int; points of each view
    reach_mm : float, mm; how far views may lie apart at the start
    table : TablePrior or None; None where the views are free
    """

    n_samples: int = N_SAMPLES
    reach_mm: float = 1.0
    table: TablePrior | None = None


def adjust(
    views: Sequence[SurfaceView],
    start: Sequence[RigidTransform],
    options: AdjustOptions | None = None,
    /,
    *,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> Registration:
    """Move all views until they agree over all overlaps, by least squares.

    Parameters
    ----------
    views : sequence of SurfaceView
    start : sequence of RigidTransform; ``body_from_view`` of each, roughly; the first stays
    options : AdjustOptions or None
    step : called with the work, what is done and what there is to do

    Returns
    -------
    Registration

    Notes
    -----
    Residuals are the distances of sampled points of each view from the surfaces of all others that
    see the place, along their normals, over what the sigmas of both say; Gauss and Newton with
    Tukey's weights. Of a place that m views see each distance counts 1 / m: so the covariance
    is that of the independent points. It is scaled by the size of the residuals. On a rotary table
    each pose is also drawn to a turn about the common axis, as far as the table's own
    accuracy goes; its axis, and angles that are not known, are found at once.
    """
    options = options or AdjustOptions()
    samples = [sample_of(v, options.n_samples, seed=SEED + k) for k, v in enumerate(views)]
    few = [sample_of(v, min(FIRST_SAMPLES, options.n_samples), seed=SEED + k)
           for k, v in enumerate(views)]  # fmt: skip
    overlaps = Overlaps(views, few, _middle(samples, start))
    poses = [tidy(pose) for pose in start]
    table = start_of_table(views, poses, overlaps.middle_mm, options.table)
    limit, is_tight = options.reach_mm, False
    before: tuple[PairResidual, ...] | None = None
    for number in range(MOST_ROUNDS):
        step("adjusting", number, MOST_ROUNDS)
        if is_tight:
            overlaps.samples = samples
        overlaps.land(poses, limit, among=list(overlaps.pairs) if number > 2 else None)
        before = overlaps.residuals() if before is None else before
        noise = max(overlaps.scaled_size(), 1.0)
        slack = 1.0 if is_tight else LOOSE
        moved, covariance, table = _moved(overlaps, poses, noise, limit, table, slack)
        poses = [tidy(motion_of(v, overlaps.middle_mm) @ p) for v, p in zip(moved, poses,
                 strict=True)]  # fmt: skip
        least = max(LIMIT_OF_NOISE * _typical_mm(overlaps), 1e-6)
        was_tight, is_tight = is_tight, limit <= 1.5 * least
        limit = max(SHRINK * limit, least)
        sigma = np.sqrt(np.maximum(np.diagonal(covariance), 1e-18)).reshape(-1, 6)
        if was_tight and (np.abs(moved) <= CONVERGED * sigma + 1e-9).all():
            break
    step("adjusting", MOST_ROUNDS, MOST_ROUNDS)
    overlaps.land(poses, limit)
    noise = overlaps.scaled_size()
    closed = closure(overlaps, poses, max(noise, 1.0), limit)
    return Registration(
        body_from_view=tuple(poses),
        covariance=covariance,
        middle_mm=overlaps.middle_mm,
        before=before or (),
        after=overlaps.residuals(),
        noise_factor=noise,
        closure_mm=closed[0],
        closure_rad=closed[1],
        table=None if table is None else table.found(views, poses, overlaps.middle_mm),
        n_iterations=number + 1,
    )


def _middle(samples: Sequence[Sample], poses: Sequence[RigidTransform]) -> Floats:
    means = [p.apply(s.points_mm.mean(axis=0)) for s, p in zip(samples, poses, strict=True)]
    return np.asarray(np.mean(means, axis=0))


def _typical_mm(overlaps: Overlaps) -> float:
    sizes = [r.rms_mm for r in overlaps.residuals()]
    return float(np.median(sizes)) if sizes else np.nan


def _moved(
    overlaps: Overlaps,
    poses: Sequence[RigidTransform],
    noise: float,
    limit_mm: float,
    table: TableFit | None,
    slack: float,
) -> tuple[Floats, Floats, TableFit | None]:
    """Return how each view should move, (n, 6), the covariance (6 n, 6 n), and the table."""
    matrix, vector, _ = overlaps.equations(poses, noise, limit_mm)
    size, n_more = len(vector), 0 if table is None else table.n_numbers
    whole, right = np.zeros((size + n_more, size + n_more)), np.zeros(size + n_more)
    # In units of what the residuals are: so noise and the table's accuracy are weighed rightly.
    whole[:size, :size], right[:size] = matrix / noise**2, vector / noise**2
    if table is not None:
        add, pull = table.equations(poses, overlaps.middle_mm, slack=slack)
        whole, right = whole + add, right + pull
    free = slice(6, size + n_more)  # the first view stays
    spread = np.sqrt(np.maximum(np.diagonal(whole)[free], 1e-12))
    scaled = whole[free, free] / np.outer(spread, spread)
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(spread, spread)
    found = np.zeros(size + n_more)
    found[free] = -inverse @ right[free]
    covariance = np.zeros((size + n_more, size + n_more))
    covariance[free, free] = inverse
    if table is not None:
        table = table.moved(found[size:], covariance[size:, size:])
    return found[:size].reshape(-1, 6), covariance[:size, :size], table
