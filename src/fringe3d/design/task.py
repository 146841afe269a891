"""What the optimiser is asked for, and how it judges a place of the projector."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.design.counts import longest_reach, projector_of, spread_pixels
from fringe3d.design.gray import guard_periods
from fringe3d.design.margin import worst_map
from fringe3d.design.reference import reference_of, require_volume
from fringe3d.design.residual import Quality, phase_at, phase_ratio, sight_of
from fringe3d.design.sampling import Meeting, Samples, Sampling, meeting, sloping_normals
from fringe3d.design.screen import DEPTHS, Screening, median_sigma, screen
from fringe3d.design.stand import Stand, stand_of
from fringe3d.design.uncertainty import phase_noise, predict_uncertainty
from fringe3d.errors import RigError
from fringe3d.geometry import depth_interval, pixel_grid, rays
from fringe3d.model import Rig

Array = NDArray[np.float64]

GRID_COLUMNS = 7
"""Columns of the grid of C1's pixels on which places are compared; margins vary slowly."""

RIM_PIXELS = 24
RIM_SCALES = (1.0, 0.96)
"""And rings of pixels near the rim of the volume, seen from C1: there lie the worst of them."""

RIM_STEP = 4

REACH_COLUMNS = 24
"""Columns on which periods are counted: they change faster next to the border of the volume."""

BETWEEN = 0.01
"""Periods by which segments may be longer between the pixels of that grid."""

N_AZIMUTHS = 8
SIGMA_COLUMNS = 16
TOLERANCE = 1e-3
"""Rad, and parts; by so much limits may be exceeded."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What a place and a fringe angle give, on the grids of the search.

    Parameters
    ----------
    ratio : float; see `AmbiguityMap.steady_ratio`
    price : float; standard deviation of the points over that of the given rig
    reach : float; see `longest_reach`
    rooms : (3,) float, rad and parts; see `Task.rooms`
    """

    ratio: float
    price: float
    reach: float
    rooms: Array


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
    beyond : float; part of a ray's depth beyond the volume in which surfaces are expected
    stand : Stand
    guard : float, periods; see `guard_periods`
    pixels : (1, n, 2) float, px; of C1, on which places are compared
    facing : (3,) float; normal of surfaces without slope
    lit_mm : float, mm; length of ray, summed over the pixels, on which all devices meet
    sigma_mm : float, mm; median standard deviation of the points
    coarse_sigma_mm : float, mm; the same of the few points of the search
    """

    rig: Rig
    period_px: float
    angle: float
    slopes_deg: tuple[float, ...]
    quality: Quality
    limits: Limits
    beyond: float
    stand: Stand
    guard: float
    pixels: Array
    facing: Array
    lit_mm: float
    sigma_mm: float
    coarse_sigma_mm: float

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
        grid = coarse_pixels(rig, GRID_COLUMNS).reshape(-1, 2)
        pixels = np.concatenate([grid, _rim(rig)])[None]
        stand = stand_of(rig)
        sigma_phase = phase_noise(quality.n_shifts, quality.noise)
        met = meeting(rig, pixels.reshape(-1, 2), depths=DEPTHS)
        facing = reference_of(rig).facing
        sight = sight_of(rig, met.points.reshape(-1, 3), period_px=period_px, angle=angle)
        return Task(
            rig=rig,
            period_px=period_px,
            angle=angle,
            slopes_deg=slopes_deg,
            quality=quality,
            limits=limits,
            beyond=beyond,
            stand=stand,
            guard=guard_periods(sigma_phase, quality.calibration_px, period_px),
            pixels=pixels,
            facing=facing,
            lit_mm=_lit(met),
            sigma_mm=_sigma(rig, period_px, angle, quality),
            coarse_sigma_mm=float(median_sigma(sight, phase_ratio(sight, facing), quality)),
        )

    def sigma_of(self, rig: Rig, angle: float) -> float:
        """Return the median standard deviation of points that a rig measures, mm."""
        return _sigma(rig, self.period_px, angle, self.quality)

    def lit_of(self, rig: Rig) -> float:
        """Return the length of ray on which all devices meet, mm; see `lit_mm`."""
        return _lit(meeting(rig, self.pixels.reshape(-1, 2), depths=DEPTHS))

    def reach_of(self, rig: Rig, angles: Array) -> Array:
        """Return the most periods, (n_angles,), between a point and another that counts."""
        pixels = coarse_pixels(rig, REACH_COLUMNS)
        return longest_reach(rig, pixels, angles, period_px=self.period_px, beyond=self.beyond)

    def screened(self, rig: Rig, angles: Array) -> Screening:
        """Judge fringe angles of a rig on the steepest surfaces, to first order."""
        steepest = math.radians(self.slopes_deg[-1])
        normals = sloping_normals(rig, self.facing, steepest, N_AZIMUTHS)
        found = screen(
            rig, self.pixels.reshape(-1, 2), angles, np.vstack([self.facing[None], normals]),
            self.quality, period_px=self.period_px, beyond=self.beyond, guard=2 * self.guard,
        )  # fmt: skip
        return replace(found, reach=self.reach_of(rig, angles))

    def judged(
        self, rig: Rig, angle: float, slope_deg: float, *, with_orders: bool = True
    ) -> Figures:
        """Judge a rig on surfaces that slope up to an angle, by its exact margins.

        On the few pixels of the search segments are shorter than the longest one. Wrong orders
        count there as soon as they fit that; without `with_orders` none counts.
        """
        reach = float(self.reach_of(rig, np.array([angle]))[0])
        met = meeting(rig, self.pixels.reshape(-1, 2), depths=DEPTHS, beyond=self.beyond)
        missing = reach - self._reach_of(rig, met, angle)
        sampling = Sampling(
            slopes_deg=(0.0, slope_deg) if slope_deg else (0.0,), depths=DEPTHS, step_px=None,
            beyond=self.beyond, pixels=self.pixels, n_azimuths=N_AZIMUTHS,
            guard=2 * self.guard + missing + BETWEEN if with_orders else -2 * reach - 1,
        )  # fmt: skip
        samples = Samples.of(rig, met, self.period_px, angle, sampling.guard)
        margins = worst_map(samples, sampling, self.pixels, self.facing, self.quality)
        return Figures(
            ratio=float(margins.steady_ratio[-1]),
            price=self._sigma_of_samples(samples) / self.coarse_sigma_mm,
            reach=reach,
            rooms=self.rooms(rig, _lit(met)),
        )

    def _reach_of(self, rig: Rig, met: Meeting, angle: float) -> float:
        """Return the same as `reach_of`, of the pixels of a meeting."""
        own, ends = (
            phase_at(projector_of(rig), np.stack(points), self.period_px, angle)
            for points in ((met.points[:, 0], met.points[:, -1]), (met.first, met.last))
        )
        return float(np.abs(own[:, None] - ends).max())

    def _sigma_of_samples(self, samples: Samples) -> float:
        rho = phase_ratio(samples.sight, self.facing)
        return float(median_sigma(samples.sight, rho, self.quality))

    def rooms(self, rig: Rig, lit_mm: float) -> Array:
        """Return the room to the limits of tilt, separation and light, (3,) rad and parts.

        It is negative where a place of the projector exceeds them.
        """
        tilt, _ = self.stand.angles_of(projector_of(rig))
        room = (
            self.limits.max_tilt - tilt,
            self.stand.separation(rig) - self.limits.min_separation,
            lit_mm / self.lit_mm - self.limits.min_lit,
        )
        return np.array(room)

    def allows(self, rig: Rig, price: float) -> bool:
        """Tell whether a rig is within the limits."""
        try:
            rooms = self.rooms(rig, self.lit_of(rig))
        except RigError:
            return False
        return bool(rooms.min() >= -TOLERANCE) and price <= self.limits.max_price + TOLERANCE


def coarse_pixels(rig: Rig, n_columns: int, /) -> Array:
    """Return a grid of C1's pixels, the last row and column included, (row, col, 2) px."""
    camera = rig.cameras[0]
    return spread_pixels(camera.shape, max(1, camera.n_cols // n_columns))


def _rim(rig: Rig) -> Array:
    """Return pixels (n, 2) of C1 on rings along the rim of the volume.

    The volume is convex, and so is what C1 sees of it, but for its lens.
    """
    camera = rig.cameras[0]
    pixels = pixel_grid(camera.shape)[::RIM_STEP, ::RIM_STEP].reshape(-1, 2)
    near, far = depth_interval(*rays(camera, pixels), require_volume(rig))
    seen = pixels[near < far]
    if not len(seen):
        return np.empty((0, 2))
    middle = seen.mean(axis=0)
    turn = 2 * np.pi * np.arange(RIM_PIXELS) / RIM_PIXELS
    along = np.stack([np.cos(turn), np.sin(turn)])
    outermost = seen[np.argmax((seen - middle) @ along, axis=0)]
    return np.concatenate([middle + scale * (outermost - middle) for scale in RIM_SCALES])


def _lit(met: Meeting) -> float:
    """Return the length of ray, mm, summed over the pixels, on which all devices meet."""
    return float(np.linalg.norm(met.points[:, -1] - met.points[:, 0], axis=-1).sum())


def _sigma(rig: Rig, period_px: float, angle: float, quality: Quality) -> float:
    return predict_uncertainty(
        rig,
        period_px=period_px,
        sigma_phase=phase_noise(quality.n_shifts, quality.noise),
        angle=angle,
        step=max(1, rig.cameras[0].n_cols // SIGMA_COLUMNS),
    ).median_mm
