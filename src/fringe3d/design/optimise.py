"""Where to put the projector, and how to turn the fringes, so that four images are enough.

Three ways lead there, and all are found by the same figure, the worst residual of a wrong order
over its standard deviation (`margin`), over the volume and over the slopes of surfaces:

- several periods on a segment, whose orders C2 tells apart by their residuals: the projector off
  the middle between the cameras, or the fringes turned;
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
from numpy.typing import NDArray

from fringe3d.design.counts import (
    angle_without_code,
    longest_reach,
    periods_on_projector,
    projector_of,
    spread_pixels,
    with_projector_at,
)
from fringe3d.design.gray import gray_needs
from fringe3d.design.margin import NEEDED_RATIO, AmbiguityMap, ambiguity_margins
from fringe3d.design.refine import CHEAPEST, Kind, Place, cheapen, refine
from fringe3d.design.residual import Quality
from fringe3d.design.screen import DEPTHS
from fringe3d.design.search import Landscape, Progress, silent, survey
from fringe3d.design.stand import Stand
from fringe3d.design.task import TOLERANCE, Limits, Task, coarse_pixels
from fringe3d.model import Rig

KINDS: tuple[Kind, ...] = ("turned", "moved", "moved and turned", "several periods", "one period")

PERIOD_COLUMNS = MARGIN_COLUMNS = 80
ANGLE_STEP = 8
"""Grids on which rigs are judged, the last row and column included. Margins vary slowly, but fall
fast where an order begins to fit: half as many columns find up to a sixth more."""

SLOPES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0)
"""Teeth and machined parts are no steeper than that over most of what two cameras see of them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A rig that could be built, and what it gives.

    Parameters
    ----------
    name : str; "given", "turned" (fringes alone), "moved" (projector alone), "moved and turned",
        "several periods", "one period" (no wrong order in the volume) or "next to C1" (the
        paper's M5)
    rig : Rig; with the projector where it stands
    tilt, azimuth : float, rad; of the projector, see `stand.Stand`
    angle : float, rad; of the fringes
    separation : float, rad; between the projector and the nearest camera
    is_allowed : bool; within the limits
    margins : AmbiguityMap
    periods : float; most periods on a projector segment
    is_single : bool; no wrong order fits anywhere: what surfaces beyond the volume add to the
        periods, and the guard at both ends, leave less than one
    sigma_mm : float, mm; median standard deviation of the points
    price : float; that over that of the given rig
    n_images : int; phase-shifted images and, where these are not enough for the steepest surfaces,
        an over-determined code of as many bits as the segments need, at least one
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
    is_single: bool
    sigma_mm: float
    price: float
    n_images: int

    @property
    def ratio(self) -> float:
        """Return the worst ratio of margin and standard deviation, for the steepest surfaces."""
        return float(self.margins.worst_ratio[-1])

    @property
    def most_wrong(self) -> int:
        """Return the largest wrong order that fits, less the right one; at least 1."""
        return int(np.abs(self.margins.orders).max(initial=1))

    @property
    def enough(self) -> NDArray[np.bool_]:
        """Tell, for each slope, whether the phase-shifted images alone tell all orders apart."""
        return _enough(self.margins, self.is_single)

    @property
    def is_enough(self) -> bool:
        """Tell the same of the steepest surfaces."""
        return bool(self.enough[-1])

    @property
    def enough_slope(self) -> float:
        """Return up to which of the slopes asked for, rad, they do; NaN if to none."""
        return float(max(self.margins.slopes[self.enough], default=math.nan))


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
        single = [c for c in enough if c.is_single]
        if enough:
            return min(single or enough, key=lambda c: c.price)
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
    grid are screened with all fringe angles, to first order in the wrong order. The best few of
    each kind are refined on the exact margins of a coarse grid of pixels; what comes out is judged
    on a fine one, like the given rig.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px, angle : float, projector px and rad; of the given fringes
    slopes_deg : float, deg, increasing; the steepest surfaces decide
    quality : Quality or None
    limits : Limits or None
    beyond : float; see `sampling.Sampling`; 0.4 keeps a table below the volume out of it, too
    progress : called as places are tried

    Raises
    ------
    RigError
        If a device or the volume is missing, or if the devices do not meet in the volume.
    """
    task = Task.of(rig, period_px=period_px, angle=angle, slopes_deg=tuple(slopes_deg),
                   quality=quality or Quality(), limits=limits or Limits(),
                   beyond=beyond)  # fmt: skip
    landscape = survey(task, progress)
    found = [_candidate(task, "given", rig, angle)]
    near: list[Place] = []
    for number, kind in enumerate(KINDS):
        progress("refining", number, len(KINDS) + 1)
        places, best = _refined(task, kind, landscape, near)
        near += places[:1]
        found += [best] if best else []
    progress("refining", len(KINDS), len(KINDS) + 1)
    found += _next_to_camera(task)
    progress("refining", len(KINDS) + 1, len(KINDS) + 1)
    return Optimisation(
        candidates=tuple(found), landscape=landscape, limits=task.limits, stand=task.stand
    )


def _refined(
    task: Task, kind: Kind, landscape: Landscape, near: Sequence[Place]
) -> tuple[list[Place], Candidate | None]:
    """Return the places to which a kind leads, and the best rig among them, judged on a fine grid.

    Where a kind that is to be cheap is not enough on the steepest surfaces, it is the cheapest that
    is so on as steep ones as can be, at least on those that face the rig.
    """
    places = refine(task, kind, landscape, near=near)
    found = [_candidate(task, kind, place.rig(task), place.angle) for place in places]
    if not found:
        return [], None
    if kind not in CHEAPEST:
        return places, max(found, key=lambda c: (c.is_allowed, c.ratio))
    best = max(found, key=_worth)
    if not best.is_enough:
        slope = math.degrees(best.enough_slope)
        good = [
            p for p, c in zip(places, found, strict=True) if c.enough_slope >= best.enough_slope
        ]
        flattest = task.slopes_deg[0]
        cheap = cheapen(task, kind, landscape, good, flattest if math.isnan(slope) else slope)
        found += [_candidate(task, kind, place.rig(task), place.angle) for place in cheap]
        best = max(found, key=_worth)
    return places, best


def _worth(c: Candidate) -> tuple[bool, float, float]:
    """Return what comes first: the limits, the slope up to which it is enough, price or ratio."""
    if math.isnan(c.enough_slope):
        return c.is_allowed, -1.0, float(c.margins.worst_ratio[0])
    return c.is_allowed, c.enough_slope, -c.price


def _candidate(task: Task, name: str, rig: Rig, angle: float) -> Candidate:
    """Judge a rig by its exact margins, on the whole grid and over all slopes."""
    period, quality = task.period_px, task.quality
    margins = ambiguity_margins(
        rig, period_px=period, angle=angle, slopes_deg=task.slopes_deg, quality=quality,
        facing=task.facing, depths=DEPTHS, beyond=task.beyond, guard=2 * task.guard,
        pixels=coarse_pixels(rig, MARGIN_COLUMNS),
    )  # fmt: skip
    step = max(1, rig.cameras[0].n_cols // PERIOD_COLUMNS)
    periods = periods_on_projector(rig, period_px=period, angle=angle, step=step, edges=True)
    pixels = spread_pixels(rig.cameras[0].shape, step)
    reach = longest_reach(rig, pixels, np.array([angle]), period_px=period, beyond=task.beyond)
    is_single = bool(reach[0] + 2 * task.guard < 1)
    sigma = task.sigma_of(rig, angle)
    needs = gray_needs(periods, guard=task.guard, beyond=task.beyond)
    bits = 0 if _enough(margins, is_single)[-1] else max(1, needs.bits_beyond)
    tilt, azimuth = task.stand.angles_of(projector_of(rig))
    price = sigma / task.sigma_mm
    return Candidate(
        name=name,
        rig=rig,
        tilt=tilt,
        azimuth=azimuth,
        angle=angle,
        separation=task.stand.separation(rig),
        is_allowed=_is_allowed(task, name, rig, price),
        margins=margins,
        periods=float(np.nanmax(periods)),
        is_single=is_single,
        sigma_mm=sigma,
        price=price,
        n_images=quality.n_shifts + (bits + 1 if bits else 0),
    )


def _enough(margins: AmbiguityMap, is_single: bool) -> NDArray[np.bool_]:
    """Tell, for each slope, whether no wrong order can be taken for the right one.

    The margins see fewer pixels than the periods are counted on. Where those find a wrong order
    that these do not, nothing is known of it.
    """
    is_known = is_single or len(margins.orders) > 0
    return np.asarray((margins.worst_ratio >= NEEDED_RATIO) & is_known)


def _is_allowed(task: Task, name: str, rig: Rig, price: float) -> bool:
    """Tell whether a candidate is within the limits; where the projector stands, it can stand."""
    if name in ("given", "turned"):
        return price <= task.limits.max_price + TOLERANCE
    return task.allows(rig, price)


def _next_to_camera(task: Task) -> list[Candidate]:
    """Return the paper's M5: the projector so near C1 that segments hold less than a period."""
    tau = angle_without_code(
        task.rig, period_px=task.period_px, angle=task.angle, guard=task.guard, step=ANGLE_STEP,
        beyond=task.beyond,
    )  # fmt: skip
    if not math.isfinite(tau):
        return []
    return [_candidate(task, "next to C1", with_projector_at(task.rig, tau), task.angle)]
