"""How far devices may contradict each other while the calibration is as good as it says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._pose_problem import State, left_over, problem_of_points
from fringe3d.calibrate._poses import viewed, with_number
from fringe3d.calibrate.homologous import Homologous
from fringe3d.model import Device, RigCovariance

Floats = NDArray[np.float64]

POINTS = 300


def expected_contradiction(
    points: Homologous, devices: Sequence[Device], covariance: RigCovariance, /
) -> float:
    """Return the median contradiction of homologous points that a calibration lets expect.

    Parameters
    ----------
    points : Homologous
    devices : sequence of Device; C1, further cameras, then the projector
    covariance : RigCovariance; of their numbers

    Returns
    -------
    float, projector px
        From calibration and noise; compare `contradiction`.

    Raises
    ------
    EmptyResultError
        If no points lie in front of the devices.
    """
    few = points.subset(np.arange(0, points.n_points, max(1, points.n_points // POINTS)))
    problem, before = problem_of_points([few], devices)
    scan = problem.scans[0]
    here, sigma = left_over(scan, before, before.depths[0])
    columns = []
    for name, step in zip(covariance.names, np.sqrt(np.diagonal(covariance.matrix)), strict=True):
        moved = [with_number(d, name.rpartition(".")[2], step)
                 if name.rpartition(".")[0] == d.name else d for d in devices]  # fmt: skip
        there, _ = left_over(
            viewed(scan.points, moved[0]), State(tuple(moved), before.depths), before.depths[0]
        )
        columns.append((there - here) / max(step, 1e-300))
    slopes = np.stack(columns, axis=-1)
    variance = np.einsum("nmp,pq,nmq->nm", slopes, covariance.matrix, slopes)
    n_equations = np.isfinite(here).sum(axis=1)
    noise = (n_equations - 1) / np.maximum(n_equations, 1)  # a depth is fitted to each point
    total = np.nansum((variance + noise[:, None]) * sigma**2, axis=1)
    many = n_equations > 1
    return float(np.median(np.sqrt(total[many] / n_equations[many])))
