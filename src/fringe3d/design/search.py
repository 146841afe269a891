"""The search behind `optimise`: places and fringe angles, screened and refined."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fringe3d.design.counts import projector_of
from fringe3d.design.gray import guard_periods
from fringe3d.design.margin import NEEDED_RATIO, meeting, sloping_normals
from fringe3d.design.reference import reference_of
from fringe3d.design.residual import Quality
from fringe3d.design.screen import Screening, screen
from fringe3d.design.stand import Stand, stand_of
from fringe3d.design.uncertainty import phase_noise, predict_uncertainty
from fringe3d.errors import RigError
from fringe3d.geometry import pixel_grid
from fringe3d.model import Rig

Array = NDArray[np.float64]
Kind = Literal["turned", "moved", "moved and turned", "one period"]
Progress = Callable[[str, int, int], None]

N_ANGLES = 36
"""Fringe angles that are screened: every 5 degrees."""

GRID_COLUMNS = 7
"""Columns of the grid of C1's pixels on which places are compared; margins vary slowly."""

STEPS_REFINED = 60
APART = 1.6
"""Spacings between places that are refined."""

NOTHING_LIT = 1e6
"""Loss where the devices do not meet in the volume; finite, for optimisers subtract."""

N_AZIMUTHS = 8
SIGMA_COLUMNS = 16
TOLERANCE = 1e-3
"""Rad, and parts; by so much limits may be exceeded."""

PENALTY = 200.0
"""Ratio lost for each unit by which a limit is exceeded (rad, parts)."""

ONE_PERIOD = 0.97
"""Periods; segments in the corners of the image are a little longer than those of the grid."""


def silent(_work: str, _done: int, _total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a place of the projector must respect.

    Parameters
    ----------
    max_tilt : float, rad; between the projector and the upright of the volume
    min_separation : float, rad; between the projector and any camera, at the reference point: the
        housings must not collide
    max_price : float; standard deviation of the points over that of the given rig
    min_lit : float; part of the volume that projector and both cameras share, over that of the
        given rig
    spacing : float, rad; of the places that are tried
    n_starts : int; so many of the best places of each kind are refined
    """

    max_tilt: float = math.radians(35.0)
    min_separation: float = math.radians(8.0)
    max_price: float = 1.5
    min_lit: float = 0.98
    spacing: float = math.radians(4.0)
    n_starts: int = 3

    def __post_init__(self) -> None:
        angles = 0 < self.spacing <= self.max_tilt < math.pi / 2 and self.min_separation >= 0
        parts = self.max_price >= 1 and 0 <= self.min_lit <= 1
        if not (angles and parts and self.n_starts >= 1):
            raise ValueError(
                "limits: expected angles below 90 deg, a price of at least 1, a part from 0 to 1 "
                f"and at least one start, found {self}"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Landscape:
    """What was tried: places (n,) with the best fringe angle of each, and every angle (n, m).

    Parameters
    ----------
    tilts, azimuths : (n,) float, rad
    allowed : (n,) bool; within the limits of tilt, separation and light
    angles : (m,) float, rad
    ratio, sigma_mm, reach : (n, m) float; as in `screen.Screening`; NaN where the devices do not
        meet in the volume
    max_sigma_mm : float, mm; the highest price
    """

    tilts: Array
    azimuths: Array
    allowed: NDArray[np.bool_]
    angles: Array
    ratio: Array
    sigma_mm: Array
    reach: Array
    max_sigma_mm: float

    @property
    def best_angle(self) -> NDArray[np.int64]:
        """Return (n,), the number of the angle with the highest ratio within the price."""
        affordable = np.where(self.sigma_mm <= self.max_sigma_mm, self.ratio, -np.inf)
        return np.asarray(np.nan_to_num(affordable, nan=-np.inf).argmax(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the projector and an angle of the fringes, rad; `is_moved` if not the given."""

    tilt: float
    azimuth: float
    angle: float
    is_moved: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """The given rig, what is asked of it, and what stays as it is while the projector moves.

    Parameters
    ----------
    rig : Rig
    period_px : float, projector px
    angle : float, rad; of the given fringes
    slopes_deg : tuple of float, deg
    quality : Quality
    limits : Limits
    stand : Stand
    guard : float, periods; see `guard_periods`
    pixels : (n, 2) float, px; of C1, on which places are compared
    facing : (3,) float; normal of surfaces without slope
    normals : (n, 3) float; it, and those of the steepest surfaces
    beyond : float; part of a ray's depth beyond the volume in which surfaces are expected
    lit_mm : float, mm; length of ray, summed over the pixels, on which all devices meet
    sigma_mm : float, mm; median standard deviation of the points
    """

    rig: Rig
    period_px: float
    angle: float
    slopes_deg: tuple[float, ...]
    quality: Quality
    limits: Limits
    stand: Stand
    guard: float
    pixels: Array
    facing: Array
    normals: Array
    beyond: float
    lit_mm: float
    sigma_mm: float

    @staticmethod
    def of(
        rig: Rig,
        *,
        period_px: float,
        angle: float,
        slopes_deg: tuple[float, ...],
        quality: Quality,
        limits: Limits,
        beyond: float,
    ) -> Task:
        """Return the task, with what follows from the given rig."""
        stand = stand_of(rig)
        facing = reference_of(rig).facing
        steepest = math.radians(slopes_deg[-1])
        normals = sloping_normals(rig, facing, steepest, N_AZIMUTHS)
        step = max(1, rig.cameras[0].n_cols // GRID_COLUMNS)
        grid = pixel_grid(rig.cameras[0].shape)[step // 2 :: step, step // 2 :: step]
        pixels = grid.reshape(-1, 2)
        sigma_phase = phase_noise(quality.n_shifts, quality.noise)
        return Task(
            rig=rig,
            period_px=period_px,
            angle=angle,
            slopes_deg=slopes_deg,
            quality=quality,
            limits=limits,
            stand=stand,
            guard=guard_periods(sigma_phase, quality.calibration_px, period_px),
            pixels=pixels,
            facing=facing,
            normals=np.vstack([facing[None], normals]),
            beyond=beyond,
            lit_mm=_lit(rig, pixels),
            sigma_mm=_sigma(rig, period_px, angle, quality),
        )

    def sigma_of(self, rig: Rig, angle: float) -> float:
        """Return the median standard deviation of points that a rig measures, mm."""
        return _sigma(rig, self.period_px, angle, self.quality)

    def screened(self, rig: Rig, angles: Array) -> Screening:
        """Judge fringe angles of a rig, to first order."""
        return screen(
            rig, self.pixels, angles, self.normals, self.quality, period_px=self.period_px,
            beyond=self.beyond,
        )  # fmt: skip

    def excess(self, rig: Rig, lit_mm: float) -> float:
        """Return by how much a place of the projector exceeds the limits, rad and parts."""
        tilt, _ = self.stand.angles_of(projector_of(rig))
        lacking = self.limits.min_lit - lit_mm / self.lit_mm
        near = self.limits.min_separation - self.stand.separation(rig)
        return max(0.0, tilt - self.limits.max_tilt) + max(0.0, near) + max(0.0, lacking)

    def allows(self, rig: Rig, price: float) -> bool:
        """Tell whether a rig is within the limits."""
        return (
            self.excess(rig, _lit(rig, self.pixels)) <= TOLERANCE
            and price <= self.limits.max_price + TOLERANCE
        )


def _lit(rig: Rig, pixels: Array) -> float:
    met = meeting(rig, pixels, depths=(0.0, 1.0))
    return float(np.linalg.norm(met.points[:, 1] - met.points[:, 0], axis=-1).sum())


def _sigma(rig: Rig, period_px: float, angle: float, quality: Quality) -> float:
    return predict_uncertainty(
        rig,
        period_px=period_px,
        sigma_phase=phase_noise(quality.n_shifts, quality.noise),
        angle=angle,
        step=max(1, rig.cameras[0].n_cols // SIGMA_COLUMNS),
    ).median_mm


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
        allowed[number] = task.excess(rig, found.lit_mm) <= TOLERANCE
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


def refine(task: Task, kind: Kind, landscape: Landscape, /) -> Place | None:
    """Improve the best of a kind in the landscape, within the limits; None if there is none.

    Parameters
    ----------
    task : Task
    kind : "turned" (the projector stays), "moved" (the fringes stay), "moved and turned" or
        "one period" (both, with segments below one period)
    landscape : Landscape

    Notes
    -----
    Nelder-Mead on the first-order ratio; what exceeds a limit costs `PENALTY`. Of rigs with
    segments below one period, nothing is to be told apart, and the cheapest is taken whose ratio
    is enough.
    """
    value = -_loss_of(kind, landscape.ratio, landscape.sigma_mm / task.sigma_mm)
    value[landscape.sigma_mm > landscape.max_sigma_mm] = np.nan
    if kind == "turned":
        value[1:] = np.nan
    else:
        value[~landscape.allowed] = np.nan
    if kind == "moved":
        value[:, 1:] = np.nan
    if kind == "one period":
        value[landscape.reach + 2 * task.guard >= ONE_PERIOD] = np.nan
    free = {"turned": [2], "moved": [0, 1]}.get(kind, [0, 1, 2])
    found = [_descend(task, kind, start, free) for start in _starts(value, landscape, task.limits)]
    if not found:
        return None
    _, best = min(found, key=lambda result: result[0])
    tilt, azimuth = float(np.hypot(best[0], best[1])), float(np.arctan2(best[1], best[0]))
    return Place(tilt=tilt, azimuth=azimuth, angle=float(best[2]), is_moved=kind != "turned")


def _starts(value: Array, landscape: Landscape, limits: Limits) -> list[Array]:
    """Return the best places of a landscape that lie apart: tilts along two axes, fringe angle."""
    tilts, azimuths = landscape.tilts, landscape.azimuths
    spots = np.stack([tilts * np.cos(azimuths), tilts * np.sin(azimuths)], axis=-1)
    value = value.copy()
    starts: list[Array] = []
    while len(starts) < limits.n_starts and np.isfinite(value).any():
        at, turned = np.unravel_index(np.nanargmax(value), value.shape)
        starts.append(np.array([*spots[at], landscape.angles[turned]]))
        near = np.linalg.norm(spots - spots[at], axis=-1) < APART * limits.spacing
        value[near] = np.nan
    return starts


def _descend(task: Task, kind: Kind, start: Array, free: list[int]) -> tuple[float, Array]:
    """Return the loss and the place, as `_starts` gives it, in which Nelder-Mead ends."""

    def place(step: Array) -> Array:
        trial = start.copy()
        trial[free] += step
        return trial

    def loss(step: Array) -> float:
        return _loss(task, kind, place(step), is_moved=kind != "turned")

    first = task.limits.spacing / 2 * np.eye(len(free))
    simplex = np.vstack([np.zeros(len(free)), first])
    best = minimize(
        loss, np.zeros(len(free)), method="Nelder-Mead",
        options={
            "initial_simplex": simplex, "maxfev": STEPS_REFINED, "xatol": 1e-3, "fatol": 0.005,
        },
    )  # fmt: skip
    return float(best.fun), place(best.x)


def _loss(task: Task, kind: Kind, trial: Array, *, is_moved: bool) -> float:
    rig = task.rig
    if is_moved:
        tilt = min(float(np.hypot(trial[0], trial[1])), math.radians(80.0))
        rig = task.stand.placed(rig, tilt, float(np.arctan2(trial[1], trial[0])))
    try:
        found = task.screened(rig, trial[2:])
    except RigError:
        return NOTHING_LIT
    excess = task.excess(rig, found.lit_mm) if is_moved else 0.0
    # A little inside the limits, for the exact figures differ by a hundredth.
    price = found.sigma_mm / task.sigma_mm
    excess += max(0.0, float(price[0]) - 0.99 * task.limits.max_price)
    if kind == "one period":
        excess += max(0.0, float(found.reach[0]) + 2 * task.guard - ONE_PERIOD)
    return PENALTY * excess + float(_loss_of(kind, found.ratio, price)[0])


def _loss_of(kind: Kind, ratio: Array, price: Array) -> Array:
    """Return what is to be as small as possible: the price, once the ratio is enough, or -ratio."""
    if kind != "one period":
        return -ratio
    return np.asarray(price + np.maximum(0.0, 1.05 * NEEDED_RATIO - ratio))
