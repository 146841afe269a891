"""Once around: what is left when pairs of views are registered one by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import RigidTransform
from fringe3d.register._normal import Overlaps
from fringe3d.register.table_model import groups_of

Floats = NDArray[np.float64]

LOOSE = np.repeat([0.05, 5.0], 3)
"""rad, mm; directions in which a pair does not hold together do not count."""


def closure(
    overlaps: Overlaps, poses: Sequence[RigidTransform], noise: float, limit_mm: float, /
) -> tuple[float, float]:
    """Return shift (mm) and turn (rad) that remain after the longest way round and back.

    Parameters
    ----------
    overlaps : Overlaps; landed with `poses`
    poses : sequence of RigidTransform
    noise : float; size of the residuals over the sigmas
    limit_mm : float, mm

    Returns
    -------
    float, float
        NaN where two neighbours in the order of recording do not overlap.
    """
    groups = [group for group in groups_of(overlaps.views) if len(group) > 2]
    rounds = [_sum_around(overlaps, poses, noise, limit_mm, group) for group in groups]
    known = [vector for vector in rounds if np.isfinite(vector).all()]
    if not known:
        return float("nan"), float("nan")
    sizes = [(float(np.linalg.norm(v[3:])), float(np.linalg.norm(v[:3]))) for v in known]
    return max(sizes)


def _sum_around(
    overlaps: Overlaps, poses: Sequence[RigidTransform], noise: float, limit_mm: float,
    group: Sequence[int],
) -> Floats:  # fmt: skip
    total = np.zeros(6)
    for a, b in zip(group, [*group[1:], group[0]], strict=True):
        matrix, vector, number = overlaps.of_pair(a, b, poses, noise, limit_mm)
        if not number:
            return np.full(6, np.nan)
        # Motions are small: they add up.
        total += -np.linalg.solve(matrix / noise**2 + np.diag(LOOSE**-2.0), vector / noise**2)
    return total
