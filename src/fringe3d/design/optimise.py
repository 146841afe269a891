"""Where to put the projector, and how to turn the fringes, so that four images are enough.

Three ways lead there, and all are found by the same figure, the worst residual of a wrong order
over its standard deviation (`margin`), over the volume and over the slopes of surfaces:

- orders that C2 tells apart by their residuals: the projector off the middle between the cameras;
- no wrong order in the volume at all, for the projector stands next to C1 (the paper's M5);
- the same, for the fringes run nearly along the epipolar lines between C1 and the projector, which
  stands out of the plane of the cameras: a segment then crosses less than a period although the
  projector is nowhere near C1, and C2, for which the fringes run across, places the point.

Each has a price in the standard deviation of the points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringe3d.design.counts import (
    angle_without_code,
    periods_on_projector,
    projector_of,
    with_projector_at,
)
from fringe3d.design.gray import gray_needs
from fringe3d.design.margin import NEEDED_RATIO, AmbiguityMap, ambiguity_margins
from fringe3d.design.residual import Quality
from fringe3d.design.search import (
    TOLERANCE,
    Kind,
    Landscape,
    Limits,
    Progress,
    Task,
    refine,
    silent,
    survey,
)
from fringe3d.design.stand import Stand
from fringe3d.model import Rig

KINDS: tuple[Kind, ...] = ("turned", "moved", "moved and turned", "one period")

DEPTHS = (0.0, 0.5, 1.0)

PERIOD_COLUMNS = 80
ANGLE_STEP = 8
"""Grids on which periods are counted; they vary slowly over the image."""

SLOPES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0)
"""Teeth and machined parts are no steeper than that over most of what two cameras see of them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A rig that could be built, and what it gives.

    Parameters
    ----------
    name : str; "given", "turned" (fringes alone), "moved" (projector alone), "moved and turned",
        "one period" (no wrong order in the volume) or "next to C1" (the paper's M5)
    rig : Rig; with the projector where it stands
    tilt, azimuth : float, rad; of the projector, see `stand.Stand`
    angle : float, rad; of the fringes
    separation : float, rad; between the projector and the nearest camera
    is_allowed : bool; within the limits
    margins : AmbiguityMap
    periods : float; most periods on a projector segment
    sigma_mm : float, mm; median standard deviation of the points
    price : float; that over that of the given rig
    n_images : int; phase-shifted images and, where the ratio is below 6, an over-determined code of
        as many bits as the segments need, at least one
    """

    name: str
    rig: Rig
    tilt: float
    azimuth: float
    angle: float
    separation: float
    is_allowed: bool
    margins: AmbiguityMap
    periods: float
    sigma_mm: float
    price: float
    n_images: int

    @property
    def ratio(self) -> float:
        """Return the worst ratio of margin and standard deviation, for the steepest surfaces."""
        return float(self.margins.worst_ratio[-1])

    @property
    def is_enough(self) -> bool:
        """Tell whether the phase-shifted images alone tell all orders apart."""
        return self.ratio >= NEEDED_RATIO


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimisation:
    """Candidates, the given rig first, and the landscape in which they were found.

    Parameters
    ----------
    candidates : tuple of Candidate
    landscape : Landscape
    limits : Limits
    stand : Stand; the directions of tilt and azimuth
    """

    candidates: tuple[Candidate, ...]
    landscape: Landscape
    limits: Limits
    stand: Stand

    @property
    def given(self) -> Candidate:
        """Return the rig as it was given."""
        return self.candidates[0]

    @property
    def best(self) -> Candidate:
        """Return what is recommended.

        Of the candidates within the limits that need no code the cheapest, but first those without
        wrong orders in the volume: there nothing depends on slopes, bends and edges of the surface.
        If none is enough, that with the highest ratio.
        """
        allowed = [c for c in self.candidates if c.is_allowed]
        enough = [c for c in allowed if c.is_enough]
        free = [c for c in enough if not len(c.margins.orders)]
        if free or enough:
            return min(free or enough, key=lambda c: c.price)
        return max(allowed, key=lambda c: c.ratio)


def optimise(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
    slopes_deg: Sequence[float] = SLOPES_DEG,
    quality: Quality | None = None,
    limits: Limits | None = None,
    beyond: float = 0.0,
    progress: Progress = silent,
) -> Optimisation:
    """Look for the place of the projector and the fringe angle with the largest ambiguity margin.

    The projector keeps its distance from the reference point, its aim and its roll. Places on a
    grid are screened with all fringe angles, to first order; the best of each kind is refined with
    the exact margins (Nelder-Mead) and judged like the given rig.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px : float, projector px
    angle : float, rad; of the given fringes
    slopes_deg : float, deg, increasing; the steepest surfaces decide
    quality : Quality or None
    limits : Limits or None
    beyond : float; see `ambiguity_margins`; 0.4 keeps a table below the volume out of it, too
    progress : called as places are tried

    Returns
    -------
    Optimisation

    Raises
    ------
    RigError
        If a device or the volume is missing, or if the devices do not meet in the volume.
    """
    task = Task.of(
        rig,
        period_px=period_px,
        angle=angle,
        slopes_deg=tuple(slopes_deg),
        quality=quality or Quality(),
        limits=limits or Limits(),
        beyond=beyond,
    )
    landscape = survey(task, progress)
    found = [_candidate(task, "given", rig, angle)]
    for number, kind in enumerate(KINDS):
        progress("refining", number, len(KINDS) + 1)
        place = refine(task, kind, landscape)
        if place is not None:
            moved = task.stand.placed(rig, place.tilt, place.azimuth) if place.is_moved else rig
            found.append(_candidate(task, kind, moved, place.angle))
    progress("refining", len(KINDS), len(KINDS) + 1)
    found += _next_to_camera(task)
    progress("refining", len(KINDS) + 1, len(KINDS) + 1)
    return Optimisation(
        candidates=tuple(found), landscape=landscape, limits=task.limits, stand=task.stand
    )


def _candidate(task: Task, name: str, rig: Rig, angle: float) -> Candidate:
    """Judge a rig exactly, on the whole grid of margins."""
    period, quality = task.period_px, task.quality
    margins = ambiguity_margins(
        rig, period_px=period, angle=angle, slopes_deg=task.slopes_deg, quality=quality,
        facing=task.facing, depths=DEPTHS, beyond=task.beyond,
    )  # fmt: skip
    step = max(1, rig.cameras[0].n_cols // PERIOD_COLUMNS)
    periods = periods_on_projector(rig, period_px=period, angle=angle, step=step)
    sigma = task.sigma_of(rig, angle)
    enough = float(margins.worst_ratio[-1]) >= NEEDED_RATIO
    bits = 0 if enough else max(1, gray_needs(periods, guard=task.guard).bits)
    tilt, azimuth = task.stand.angles_of(projector_of(rig))
    separation = task.stand.separation(rig)
    price = sigma / task.sigma_mm
    return Candidate(
        name=name,
        rig=rig,
        tilt=tilt,
        azimuth=azimuth,
        angle=angle,
        separation=separation,
        is_allowed=_is_allowed(task, name, rig, price),
        margins=margins,
        periods=float(np.nanmax(periods)),
        sigma_mm=sigma,
        price=price,
        n_images=quality.n_shifts + (bits + 1 if bits else 0),
    )


def _is_allowed(task: Task, name: str, rig: Rig, price: float) -> bool:
    """Tell whether a candidate is within the limits; where the projector stands, it can stand."""
    if name in ("given", "turned"):
        return price <= task.limits.max_price + TOLERANCE
    return task.allows(rig, price)


def _next_to_camera(task: Task) -> list[Candidate]:
    """Return the paper's M5: the projector so near C1 that segments hold less than a period."""
    tau = angle_without_code(
        task.rig, period_px=task.period_px, angle=task.angle, guard=task.guard, step=ANGLE_STEP
    )
    if not math.isfinite(tau):
        return []
    return [_candidate(task, "next to C1", with_projector_at(task.rig, tau), task.angle)]
