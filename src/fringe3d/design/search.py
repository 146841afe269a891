"""The survey behind `optimise`: places of the projector, each with all fringe angles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.task import TOLERANCE, Limits, Task
from fringe3d.errors import RigError

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

N_ANGLES = 36
"""Fringe angles that are screened: every 5 degrees."""


def silent(_work: str, _done: int, _total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Landscape:
    """What was tried: places (n,) with the best fringe angle of each, and every angle (n, m).

    All to first order in the wrong order, see `screen`.

    Parameters
    ----------
    tilts, azimuths : (n,) float, rad
    allowed : (n,) bool; within the limits of tilt, separation and light
    angles : (m,) float, rad
    ratio, sigma_mm, reach : (n, m) float; as in `screen.Screening`; NaN where the devices do not
        meet in the volume
    max_sigma_mm : float, mm; the highest price
    max_reach : float, periods; below it no wrong order fits
    """

    tilts: Array
    azimuths: Array
    allowed: NDArray[np.bool_]
    angles: Array
    ratio: Array
    sigma_mm: Array
    reach: Array
    max_sigma_mm: float
    max_reach: float

    @property
    def best_angle(self) -> NDArray[np.int64]:
        """Return (n,), the number of the angle with the highest ratio within the price."""
        affordable = np.where(self.sigma_mm <= self.max_sigma_mm, self.ratio, -np.inf)
        return np.asarray(np.nan_to_num(affordable, nan=-np.inf).argmax(axis=1))


def survey(task: Task, progress: Progress = silent, /) -> Landscape:
    """Screen places all around the reference point with all fringe angles.

    Parameters
    ----------
    task : Task
    progress : called as places are tried

    Returns
    -------
    Landscape
        The given place is its first one, the given angle its first angle.
    """
    places = [task.stand.angles_of(projector_of(task.rig)), *_places(task.limits)]
    angles: Array = task.angle + np.pi / N_ANGLES * np.arange(N_ANGLES, dtype=np.float64)
    angles = angles - np.pi * (angles > np.pi / 2)
    shape = len(places), N_ANGLES
    ratio, sigma, reach = (np.full(shape, np.nan) for _ in range(3))
    allowed = np.zeros(len(places), bool)
    for number, (tilt, azimuth) in enumerate(places):
        progress("trying places", number, len(places))
        rig = task.stand.placed(task.rig, tilt, azimuth)
        try:
            found = task.screened(rig, angles)
        except RigError:
            continue  # nothing is lit there
        allowed[number] = task.rooms(rig, found.lit_mm).min() >= -TOLERANCE
        ratio[number], sigma[number] = found.ratio, found.sigma_mm
        reach[number] = found.reach
    progress("trying places", len(places), len(places))
    tilts, azimuths = np.array(places).T
    return Landscape(
        tilts=tilts,
        azimuths=azimuths,
        allowed=allowed,
        angles=angles,
        ratio=ratio,
        sigma_mm=sigma,
        reach=reach,
        max_sigma_mm=task.limits.max_price * task.sigma_mm,
        max_reach=1 - 2 * task.guard,
    )


def _places(limits: Limits) -> list[tuple[float, float]]:
    """Return tilts and azimuths of places about `spacing` apart, rings around the upright."""
    rings = round(limits.max_tilt / limits.spacing)
    places = [(0.0, 0.0)]
    for tilt in limits.max_tilt * np.arange(1, rings + 1) / rings:
        count = max(6, round(2 * math.pi * math.sin(tilt) / limits.spacing))
        turn = 2 * math.pi / count
        places += [(float(tilt), float(turn * n - math.pi + turn / 2)) for n in range(count)]
    return places
