"""Where ambiguity margins are taken: pixels, depths and slopes; and what counts as a wrong point.

The margins themselves are in `margin`, the physics of a single point in `residual`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.reference import require_volume
from fringe3d.design.residual import (
    Quality,
    Sight,
    cameras_of,
    phase_at,
    residual_sigma,
    seen_phase,
    sight_of,
    unit,
    wrong_points,
)
from fringe3d.errors import RigError
from fringe3d.geometry import depth_interval, frustum, pixel_grid, rays
from fringe3d.model import Device, Rig

Array = NDArray[np.float64]

MAP_COLUMNS = 40
"""Columns of a map; margins vary slowly over the image."""

FLATTEST_INCIDENCE = np.cos(np.radians(75.0))
"""Surfaces that a device sees flatter than that give no phase worth the name."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sampling:
    """Which pixels, depths and slopes are judged, and which wrong points count.

    Parameters
    ----------
    slopes_deg : float, deg, increasing; an entry of the result for each: surfaces up to it
    depths : float, 0 to 1; places along each viewing ray, from where it enters the part of the
        volume that all see to where it leaves; ``(0.5,)`` gives a map at mid depth
    beyond : float; wrong points count up to this part of a ray's depth beyond the volume
    guard : float, periods; and up to this beyond that: what noise and calibration may add
    step_px : int or None; grid of the maps, px of C1; a fortieth of the image if None
    pixels : (row, col, 2) float or None, px; (x, y) in C1: a grid of one's own instead
    n_azimuths : int; directions of slope, the first along the line from C1 to C2
    """

    slopes_deg: Sequence[float]
    depths: Sequence[float]
    beyond: float
    guard: float
    step_px: int | None
    pixels: ArrayLike | None
    n_azimuths: int

    def __post_init__(self) -> None:
        slopes, depths = self.slopes, self.depths
        if not (len(slopes) and (np.diff(slopes) > 0).all() and 0 <= slopes[0] <= slopes[-1] < 1.5):
            raise ValueError(
                "slopes_deg: expected increasing angles from 0 to 85 deg, found "
                f"{list(self.slopes_deg)}"
            )
        if not (len(depths) and 0 <= min(depths) <= max(depths) <= 1):
            raise ValueError(f"depths: expected parts from 0 to 1, found {list(depths)}")

    @property
    def slopes(self) -> Array:
        """Return the slopes in rad, (n_slopes,)."""
        return np.radians(np.asarray(self.slopes_deg, np.float64))

    def grid(self, camera: Device) -> Array:
        """Return the pixels of C1 that are judged, (row, col, 2) px."""
        if self.pixels is not None:
            return np.asarray(self.pixels, np.float64)
        step = self.step_px or max(1, camera.n_cols // MAP_COLUMNS)
        return pixel_grid(camera.shape)[step // 2 :: step, step // 2 :: step]


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """Where the views of both cameras and the light of the projector meet in the volume.

    Parameters
    ----------
    index : (p,) int; the pixels that have a part of it
    points : (p, d, 3) float, mm; samples along each ray
    first, last : (p, 3) float, mm; ends of the part of the ray on which points count as wrong ones
    """

    index: NDArray[np.int64]
    points: Array
    first: Array
    last: Array


def meeting(rig: Rig, pixels: Array, /, *, depths: Sequence[float], beyond: float = 0.0) -> Meeting:
    """Return samples of the volume for pixels (n, 2) of C1; see `Sampling`.

    Raises
    ------
    RigError
        If there are none.
    """
    camera1, camera2 = cameras_of(rig)
    origin, directions = rays(camera1, pixels)
    near, far = depth_interval(origin, directions, require_volume(rig))
    seen = frustum(camera2).intersection(frustum(projector_of(rig)))
    enter, leave = depth_interval(origin, directions, seen)
    room = beyond * (far - near)
    lower, upper = np.fmax(near - room, enter), np.fmin(far + room, leave)
    near, far = np.fmax(near, enter), np.fmin(far, leave)
    index = np.flatnonzero((near < far) & np.isfinite(far))
    if not index.size:
        raise RigError(
            "rig: expected that both cameras and the projector meet in the measuring volume, "
            "found no pixel of C1 for which they do. Correct poses, volume or depth range"
        )
    directions = directions[index]
    t = near[index, None] + np.asarray(depths, np.float64) * (far - near)[index, None]
    return Meeting(
        index=index,
        points=origin + t[..., None] * directions[:, None],
        first=origin + lower[index, None] * directions,
        last=origin + upper[index, None] * directions,
    )


def sloping_normals(rig: Rig, axis: Array, slope: float, n_azimuths: int, /) -> Array:
    """Return the normals (n, 3) of surfaces of that slope, rad; the first leans towards C2."""
    if slope == 0:
        return axis[None]
    camera1, camera2 = cameras_of(rig)
    base = camera2.center_world - camera1.center_world
    along = unit(base - (base @ axis) * axis)
    turn = 2 * np.pi * np.arange(n_azimuths)[:, None] / n_azimuths
    sideways = np.cos(turn) * along + np.sin(turn) * np.cross(axis, along)
    return np.asarray(np.cos(slope) * axis + np.sin(slope) * sideways)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points of the volume and where wrong orders put them.

    Parameters
    ----------
    rig : Rig
    period_px, angle : float, projector px and rad; of the fringes
    index : (p,) int; the pixels that have any
    points : (p * d, 3) float, mm
    phase : (p * d,) float, periods
    sight : Sight; of the points
    orders : (m,) int; the wrong orders that occur, less the right one
    wrong : (p * d, m, 3) float, mm; NaN where it does not count
    """

    rig: Rig
    period_px: float
    angle: float
    index: NDArray[np.int64]
    points: Array
    phase: Array
    sight: Sight
    orders: NDArray[np.int64]
    wrong: Array

    @staticmethod
    def of(rig: Rig, met: Meeting, period_px: float, angle: float, guard: float) -> Samples:
        """Return the samples of a meeting; `guard` as in `Sampling`."""
        projector, points = projector_of(rig), met.points.reshape(-1, 3)
        first, last = (phase_at(projector, p, period_px, angle) for p in (met.first, met.last))
        phase = phase_at(projector, points, period_px, angle)
        most = max(0, int(np.ceil(np.nanmax(np.abs(last - first)) + guard)))
        orders = np.array([j for size in range(1, most + 1) for j in (size, -size)], np.int64)
        wrong = wrong_points(rig, points, orders, period_px=period_px, angle=angle)
        seen = (phase[:, None] + orders).reshape(*met.points.shape[:2], len(orders))
        low, high = np.sort([first, last], axis=0)[..., None, None]
        near = (seen >= low - guard) & (seen <= high + guard)
        counts = _is_between(rig, met, wrong) | near.reshape(len(points), len(orders))
        wrong = np.where(counts[..., None], wrong, np.nan)
        occurs = np.isfinite(wrong[..., 0]).any(axis=0)
        sight = sight_of(rig, points, period_px=period_px, angle=angle)
        return Samples(
            rig, period_px, angle, met.index, points, phase, sight, orders[occurs], wrong[:, occurs]
        )

    def judged(self, normal: Array, quality: Quality) -> tuple[Array, Array]:
        """Return residuals (p * d, m), whole periods included, and their sigma (p * d,), periods.

        NaN where a device sees the surface too flatly, or not at all.
        """
        points = self.points
        normals = np.broadcast_to(normal, points.shape)
        sigma = residual_sigma(self.sight, normal, quality, period_px=self.period_px)
        devices: tuple[Device, ...] = (*cameras_of(self.rig), projector_of(self.rig))
        for device in devices:
            cosine = (unit(device.center_world - points) * normal).sum(axis=-1)
            flat = cosine < FLATTEST_INCIDENCE
            sigma = np.where(flat, np.nan, sigma)
        seen = seen_phase(self.rig, points, normals, self.wrong, self.period_px, self.angle)
        seen -= self.phase[:, None]
        return np.where(np.isnan(sigma)[:, None], np.nan, seen), sigma


def _is_between(rig: Rig, met: Meeting, wrong: Array) -> NDArray[np.bool_]:
    """Tell which wrong points (p * d, m, 3) lie between the ends of their ray, (p * d, m)."""
    eye = cameras_of(rig)[0].center_world
    reach = np.linalg.norm(wrong - eye, axis=-1).reshape(*met.points.shape[:2], wrong.shape[1])
    lower, upper = (np.linalg.norm(p - eye, axis=-1)[:, None, None] for p in (met.first, met.last))
    return np.asarray((reach >= lower) & (reach <= upper)).reshape(wrong.shape[:2])
