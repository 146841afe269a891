"""Many fringe angles of one rig at a time: quick, to first order in the wrong order.

`margin` is exact, and slower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.margin import LARGEST_RESIDUAL, room_between
from fringe3d.design.residual import Quality, Sight, phase_ratio, residual_sigma, sight_of
from fringe3d.design.sampling import meeting
from fringe3d.design.uncertainty import INTERPOLATION_WEIGHT
from fringe3d.geometry import project
from fringe3d.model import Rig
from fringe3d.patterns import across

Array = NDArray[np.float64]

MOST_ORDERS = 24
"""With more periods on a segment some order always fits; counting on would only take time."""

DEPTHS = (0.0, 0.5, 1.0)

SLACK = 0.04
"""Periods by which a wrong order may lie outside the volume and still counts: between the few
pixels of a screening, segments are longer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screening:
    """What each fringe angle of a rig gives, (n_angles,) float.

    Parameters
    ----------
    ratio : worst residual of a wrong order over its standard deviation; negative where residuals
        spread over a whole period: by how much, in standard deviations
    sigma_mm : median standard deviation of points along C1's rays, for the first of the normals
    reach : most periods between a point and another that counts as a wrong one
    lit_mm : float, mm; length of ray, summed over the pixels, on which all devices meet
    """

    ratio: Array
    sigma_mm: Array
    reach: Array
    lit_mm: float


def screen(
    rig: Rig,
    pixels: Array,
    angles: Array,
    normals: Array,
    quality: Quality,
    /,
    *,
    period_px: float,
    beyond: float = 0.0,
    guard: float = 0.0,
) -> Screening:
    """Judge fringe angles by the first-order residuals of wrong orders.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a volume
    pixels : (n, 2) float, px; of C1
    angles : (n_angles,) float, rad
    normals : (n_normals, 3) float; of surfaces, the first one facing the rig
    quality : Quality
    period_px : float, projector px
    beyond, guard : float; see `sampling.Sampling`

    Raises
    ------
    RigError
        If the devices do not meet in the volume.
    """
    met = meeting(rig, pixels, depths=DEPTHS, beyond=beyond)
    points = met.points.reshape(-1, 3)
    sight = sight_of(rig, points, period_px=period_px, angle=angles[:, None, None])
    rho = phase_ratio(sight, normals[:, None])  # (angle, normal, point)
    sigma = residual_sigma(sight, normals[:, None], quality, period_px=period_px)

    places = project(projector_of(rig), np.concatenate([met.first, met.last, points]))
    u, v = (across(angle, places[:, 0], places[:, 1]) for angle in (0.0, np.pi / 2))
    w = (np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v) / period_px
    first, last, own = np.split(w, np.cumsum([len(met.first), len(met.last)]), axis=1)
    low = np.repeat(np.minimum(first, last), len(DEPTHS), axis=1) - own
    high = np.repeat(np.maximum(first, last), len(DEPTHS), axis=1) - own
    reach, room = np.maximum(high, -low).max(axis=1), SLACK + guard
    ratio = np.asarray((LARGEST_RESIDUAL / sigma).min(axis=(1, 2)))
    for order in range(1, min(MOST_ORDERS, int(reach.max() + room)) + 1):
        for j in (order, -order):
            occurs = ((low - room <= j) & (j <= high + room))[:, None]
            ratio = np.minimum(ratio, _ratio_of(j * (1 - rho), sigma, occurs))
    return Screening(
        ratio=np.where(reach > MOST_ORDERS, -np.inf, ratio),
        sigma_mm=median_sigma(sight, rho, quality)[:, 0],
        reach=reach,
        lit_mm=float(np.linalg.norm(met.points[:, -1] - met.points[:, 0], axis=-1).sum()),
    )


def _ratio_of(seen: Array, sigma: Array, occurs: NDArray[np.bool_]) -> Array:
    """Return the worst ratio (n_angles,) of one order; infinite where it does not occur."""
    rest = np.where(occurs, np.abs(seen - np.rint(seen)) / sigma, np.inf).min(axis=(1, 2))
    lowest = np.where(occurs, seen, np.inf).min(axis=(1, 2))
    highest = np.where(occurs, seen, -np.inf).max(axis=(1, 2))
    there = lowest <= highest
    with np.errstate(invalid="ignore"):
        room = np.where(there, room_between(lowest, highest), LARGEST_RESIDUAL)
    return np.asarray(np.where(room > 0, rest, room / sigma.max(axis=(1, 2))))


def median_sigma(sight: Sight, rho: Array, quality: Quality, /) -> Array:
    """Return the median standard deviation of points, mm; see `uncertainty.point_sigma`.

    Parameters
    ----------
    sight : Sight; of points (..., n), with gradients (..., n, 3)
    rho : (..., n) float; see `phase_ratio`
    quality : Quality

    Returns
    -------
    (...) float64; over the n points
    """
    along = sight.d1 / np.linalg.norm(sight.d1, axis=-1, keepdims=True)
    slope = np.abs((sight.gradient * along).sum(axis=-1) * (1 - rho))
    noise = quality.phase_sigma * np.sqrt(1 + INTERPOLATION_WEIGHT)
    with np.errstate(divide="ignore"):  # fringes along the epipolar lines mark no point
        return np.asarray(noise / np.median(slope, axis=-1))
