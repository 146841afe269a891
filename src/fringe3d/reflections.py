"""Points whose light came by a second path, too: the projector disagrees with both cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.combining import disagreement
from fringe3d.decode import CameraPhases
from fringe3d.model import Correspondences, Device, PointMap, Rejection
from fringe3d.triangulate import without

Floats = NDArray[np.float64]

MOST_APART = {"light": 9.0, "medium": 7.0, "strong": 5.5}
"""Robust standard deviations over the whole scan, beyond which a point, or the mean around it, is
off. Noise does not reach 5.5; what calibration and edges leave is not normally distributed."""

MEAN_PX, LEAST_IN_MEAN = 5, 0.4
"""A reflection moves neighbours alike: the means of so many pixels show it through the noise. Part
of them that must be known."""

MAD_TO_SIGMA = 1.4826

NEXT_TO = 0.5
"""Part of that limit, from which on pixels next to such a point go with it: a reflection is a
patch, and at its rim, and where both paths' phases are alike, it does little."""


def without_reflections(
    points: PointMap,
    matches: Correspondences,
    phases: Sequence[CameraPhases],
    cameras: tuple[Device, Device],
    projector: Device,
    strength: str,
    /,
) -> PointMap:
    """Reject points on whose place the projector and both cameras do not agree, as REFLECTION.

    Parameters
    ----------
    points : PointMap; of C1 and C2 alone
    matches : Correspondences from which they were made
    phases : CameraPhases of C1 and C2; the first direction is the one that was matched
    cameras : (C1, C2)
    projector : Device
    strength : "light", "medium" or "strong"

    Notes
    -----
    Light that came by way of another, glossy surface adds its own fringes. Two sinusoids of one
    period are one sinusoid again: no step shows it, and the phase is off by up to q radians, q the
    part of the second light. But C1 and C2 see other reflections, so their point is not where the
    projector lights it with that phase: ``r = e1 (f_P / f_2 - 1) - e2 f_P / f_2``, f the slopes of
    the phases along the ray of C1, e the errors of C1 and C2. It is divided by the deviation that
    noise explains (`fringe3d.combining.disagreement`), and compared with that of the whole scan.
    Where ``f_P = f_2`` (a projector in the middle between the cameras, on surfaces that face them)
    an error of C1 does not show.
    """
    main = phases[0].directions[0].main
    second = phases[1].directions[0].like(main)
    apart = disagreement(points, matches, main, second, cameras, projector)
    limit = MOST_APART[strength]
    out = _patches(np.abs(_in_sigmas(apart)), limit)
    out |= _patches(np.abs(_in_sigmas(_mean(apart))), limit)
    return without(points, out, Rejection.REFLECTION)


def _in_sigmas(apart: Floats) -> Floats:
    """Return values over their robust standard deviation, if that is known."""
    known = np.abs(apart[np.isfinite(apart)])
    spread = MAD_TO_SIGMA * float(np.median(known)) if len(known) else 0.0
    return apart / spread if spread > 0 else np.full_like(apart, np.nan)


def _mean(apart: Floats) -> Floats:
    """Return means over squares; NaN where a pixel, or most around it, is not known."""
    known = np.isfinite(apart)
    share = ndimage.uniform_filter(known.astype(float), MEAN_PX)
    total = ndimage.uniform_filter(np.where(known, apart, 0.0), MEAN_PX)
    enough = known & (share > LEAST_IN_MEAN)
    return np.where(enough, total / np.where(enough, share, 1.0), np.nan)


def _patches(apart: Floats, limit: float) -> NDArray[np.bool_]:
    """Return what is beyond the limit, and what hangs on it beyond a part of it.

    Examples
    --------
    >>> _patches(np.array([[0.0, 3.0, 9.0, 3.0, 0.0, 3.0]]), 5.0).astype(int).tolist()
    [[0, 1, 1, 1, 0, 0]]
    """
    far = np.nan_to_num(apart, nan=0.0)
    found = ndimage.binary_propagation(far > limit, np.ones((3, 3), bool), far > NEXT_TO * limit)
    return np.asarray(found)
