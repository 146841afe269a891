"""The ambiguity margin: how well C2 tells a wrong fringe order from the right one.

The physics of a single point is in `residual`; here it is carried over the measuring volume and
over the slopes that surfaces may have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.reference import reference_of, require_volume
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

NEEDED_RATIO = 6.0
"""A margin is enough from so many standard deviations of the residual on: three for the right
order and three for the wrong one."""

LARGEST_RESIDUAL = 0.5
"""Periods. Where no other order lies in the volume, C2 still has to find its own period: the next
one is a whole period away, and half of that is the limit."""

FLATTEST_INCIDENCE = np.cos(np.radians(75.0))
"""Surfaces that a device sees flatter than that give no phase worth the name."""

MAP_COLUMNS = 40
"""Columns of a map; margins vary slowly over the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AmbiguityMap:
    """Margins over the pixels of C1 and for surfaces that slope up to some angles.

    Each entry tells of that depth, direction of slope and wrong order which is hardest to tell
    from the right one, by the ratio of residual and standard deviation.

    Parameters
    ----------
    pixels : (row, col, 2) float, px; (x, y) in C1: the grid of the maps
    slopes : (n_slopes,) float, rad; surfaces slope against `facing` by up to that, in any direction
    margin : (n_slopes, row, col) float, periods; the residual, 0 to 1/2. It is 0 where the residual
        changes its sign between two samples, and 1/2 where no other order lies in the volume. NaN
        where C1, C2 and projector do not meet in the volume.
    sigma : (n_slopes, row, col) float, periods; standard deviation of that residual
    order : (n_slopes, row, col) int; the wrong order less the right one; 0 if there is none
    orders : (n_orders,) int; all wrong orders that occur, relative to the right one
    lowest, highest : (n_slopes, n_orders) float, periods
        Range of the phase that C2 shows less that of C1, over the whole volume.
    facing : (3,) float; the direction (world frame) against which slopes are counted
    """

    pixels: Array
    slopes: Array
    margin: Array
    sigma: Array
    order: NDArray[np.int64]
    orders: NDArray[np.int64]
    lowest: Array
    highest: Array
    facing: Array

    @property
    def ratio(self) -> Array:
        """Return (n_slopes, row, col), margin over its standard deviation; 6 is enough."""
        return np.asarray(self.margin / self.sigma)

    @property
    def worst_margin(self) -> Array:
        """Return (n_slopes,) periods, the smallest margin of the volume; 0 with a zero line.

        A zero line is where the residual of a wrong order changes its sign. If it runs between
        two pixels of the map, neither shows it, but there it is.
        """
        smallest = np.nanmin(self.margin, axis=(1, 2))
        return np.asarray(np.where(self.clearance <= 0, 0.0, smallest))

    @property
    def worst_ratio(self) -> Array:
        """Return (n_slopes,), the smallest ratio of the volume; 0 with a zero line."""
        smallest = np.nanmin(self.ratio, axis=(1, 2))
        return np.asarray(np.where(self.clearance <= 0, 0.0, smallest))

    @property
    def worst_order(self) -> NDArray[np.int64]:
        """Return (n_slopes,), the wrong order that is hardest to tell; 0 if there is none."""
        n_slopes = len(self.slopes)
        places = np.nanargmin(self.ratio.reshape(n_slopes, -1), axis=1)
        order = np.take_along_axis(self.order.reshape(n_slopes, -1), places[:, None], axis=1)[:, 0]
        if not len(self.orders):
            return order
        crossed = self.orders[np.argmin(room_between(self.lowest, self.highest), axis=1)]
        return np.where(self.clearance <= 0, crossed, order)

    @property
    def clearance(self) -> Array:
        """Return (n_slopes,) periods, room between the residuals and the nearest integer.

        Positive: as the smallest margin. Negative: residuals of an order spread over an integer,
        by so much. It is continuous in the geometry, for optimisers.
        """
        room = room_between(self.lowest, self.highest)
        return np.asarray(room.min(axis=1, initial=LARGEST_RESIDUAL))

    @property
    def share_unsafe(self) -> Array:
        """Return (n_slopes,), the part of the pixels whose ratio is below 6."""
        known = np.isfinite(self.margin)
        unsafe = (self.ratio < NEEDED_RATIO) & known
        return np.asarray(unsafe.sum(axis=(1, 2)) / known.sum(axis=(1, 2)))


def room_between(lowest: Array, highest: Array, /) -> Array:
    """Return the room between a range and the integers around it; negative if it holds one."""
    middle = np.floor((lowest + highest) / 2)
    return np.asarray(np.minimum(lowest - middle, middle + 1 - highest))


def ambiguity_margins(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
    slopes_deg: Sequence[float] = (0.0, 10.0, 20.0),
    quality: Quality | None = None,
    depths: Sequence[float] = (0.0, 0.25, 0.5, 0.75, 1.0),
    beyond: float = 0.0,
    step_px: int | None = None,
    n_azimuths: int = 8,
    facing: ArrayLike | None = None,
) -> AmbiguityMap:
    """Return how well C2 tells wrong fringe orders from the right one, over the volume.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    slopes_deg : float, deg, increasing; an entry of the result for each: surfaces up to it
    quality : Quality or None (1 % noise, four images, 0.1 px)
    depths : float, 0 to 1; places along each viewing ray, from where it enters the part of the
        volume that all see to where it leaves; ``(0.5,)`` gives a map at mid depth
    beyond : float; wrong points count up to this part of a ray's depth beyond the volume
    step_px : int or None; grid of the maps, px of C1; a fortieth of the image if None
    n_azimuths : int; directions of slope, the first along the line from C1 to C2
    facing : (3,) float or None; normal of surfaces without slope; the middle between the
        directions to the cameras if None

    Raises
    ------
    RigError
        If the rig lacks a volume, a second camera or a projector, or if no pixel of C1 sees a
        part of the volume that the others see, too.
    ValueError
        If slopes or depths are not as above.

    Notes
    -----
    Wrong points count where they lie in the volume and in the views of C2 and projector.
    """
    quality = quality or Quality()
    slopes = np.radians(np.asarray(slopes_deg, np.float64))
    if not (len(slopes) and (np.diff(slopes) > 0).all() and 0 <= slopes[0] <= slopes[-1] < 1.5):
        raise ValueError(
            f"slopes_deg: expected increasing angles from 0 to 85 deg, found {list(slopes_deg)}"
        )
    if not (len(depths) and 0 <= min(depths) <= max(depths) <= 1):
        raise ValueError(f"depths: expected parts from 0 to 1, found {list(depths)}")
    axis = reference_of(rig).facing if facing is None else unit(np.asarray(facing, np.float64))
    step = step_px or max(1, rig.cameras[0].n_cols // MAP_COLUMNS)
    pixels = pixel_grid(rig.cameras[0].shape)[step // 2 :: step, step // 2 :: step]
    met = meeting(rig, pixels.reshape(-1, 2), depths=depths, beyond=beyond)
    samples = _samples(rig, met, period_px, angle)
    worst = _Worst.nothing(len(samples.index), len(depths), len(samples.orders))
    maps = [np.full((len(slopes), pixels.shape[0] * pixels.shape[1]), np.nan) for _ in range(3)]
    ends = np.full((2, len(slopes), len(samples.orders)), np.nan)
    for number, slope in enumerate(slopes):
        for normal in sloping_normals(rig, axis, float(slope), n_azimuths):
            worst.add(samples, *_judge(rig, samples, normal, quality, period_px, angle))
        for values, found in zip(maps, worst.found(samples.orders), strict=True):
            values[number, samples.index] = found
        ends[0, number], ends[1, number] = worst.range_of_all()
    margin, sigma, order = (values.reshape(-1, *pixels.shape[:2]) for values in maps)
    return AmbiguityMap(
        pixels=pixels,
        slopes=slopes,
        margin=margin,
        sigma=sigma,
        order=np.nan_to_num(order).astype(np.int64),
        orders=samples.orders,
        lowest=ends[0],
        highest=ends[1],
        facing=axis,
    )


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
    """Return samples of the volume for pixels (n, 2) of C1; see `ambiguity_margins`.

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


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Points of the volume and where wrong orders put them.

    index (p,): the pixels that have any; points (p * d, 3), mm, their phase (p * d,), periods, and
    sight; orders (m,); wrong (p * d, m, 3), mm, NaN where it does not count.
    """

    index: NDArray[np.int64]
    points: Array
    phase: Array
    sight: Sight
    orders: NDArray[np.int64]
    wrong: Array


def _samples(rig: Rig, met: Meeting, period_px: float, angle: float) -> _Samples:
    eye, projector = cameras_of(rig)[0].center_world, projector_of(rig)
    first, last = (phase_at(projector, p, period_px, angle) for p in (met.first, met.last))
    most = int(np.ceil(np.nanmax(np.abs(last - first))))
    orders = np.array([j for size in range(1, most + 1) for j in (size, -size)], np.int64)
    points = met.points.reshape(-1, 3)
    wrong = wrong_points(rig, points, orders, period_px=period_px, angle=angle)
    reach = np.linalg.norm(wrong - eye, axis=-1).reshape(*met.points.shape[:2], len(orders))
    lower, upper = (np.linalg.norm(p - eye, axis=-1)[:, None, None] for p in (met.first, met.last))
    counts = ((reach >= lower) & (reach <= upper)).reshape(len(points), len(orders), 1)
    wrong = np.where(counts, wrong, np.nan)
    occurs = np.isfinite(wrong[..., 0]).any(axis=0)
    sight = sight_of(rig, points, period_px=period_px, angle=angle)
    phase = phase_at(projector, points, period_px, angle)
    return _Samples(met.index, points, phase, sight, orders[occurs], wrong[:, occurs])


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


def _judge(
    rig: Rig, samples: _Samples, normal: Array, quality: Quality, period_px: float, angle: float
) -> tuple[Array, Array]:
    """Return residuals (p * d, m), whole periods included, and their standard deviation (p * d,).

    NaN where a device sees the surface too flatly, or not at all.
    """
    points = samples.points
    normals = np.broadcast_to(normal, points.shape)
    sigma = residual_sigma(samples.sight, normal, quality, period_px=period_px)
    devices: tuple[Device, ...] = (*cameras_of(rig), projector_of(rig))
    for device in devices:
        flat = unit(device.center_world - points) @ normal < FLATTEST_INCIDENCE
        sigma = np.where(flat, np.nan, sigma)
    seen = seen_phase(rig, points, normals, samples.wrong, period_px, angle)
    seen -= samples.phase[:, None]
    return np.where(np.isnan(sigma)[:, None], np.nan, seen), sigma


@dataclass(slots=True, eq=False)
class _Worst:
    """What is hardest to tell so far, for each pixel; it grows normal by normal."""

    n_depths: int
    margin: Array
    sigma: Array
    place: NDArray[np.int64]
    lowest: Array
    highest: Array

    @staticmethod
    def nothing(n_pixels: int, n_depths: int, n_orders: int) -> _Worst:
        return _Worst(
            n_depths=n_depths,
            margin=np.full(n_pixels, np.nan),
            sigma=np.full(n_pixels, np.nan),
            place=np.full(n_pixels, -1),
            lowest=np.full((n_pixels, n_orders), np.inf),
            highest=np.full((n_pixels, n_orders), -np.inf),
        )

    def add(self, samples: _Samples, seen: Array, sigma: Array) -> None:
        """Take the residuals and standard deviations of one normal into account."""
        rest = np.abs(seen - np.rint(seen))
        none = np.full((len(sigma), 1), LARGEST_RESIDUAL)
        rest = np.concatenate([none, np.where(np.isnan(rest), np.inf, rest)], axis=1)
        place = np.argmin(rest, axis=1)
        margin = rest.min(axis=1)
        ratio = np.where(np.isnan(sigma), np.inf, margin / sigma).reshape(-1, self.n_depths)
        depth = np.argmin(ratio, axis=1) + self.n_depths * np.arange(len(ratio))
        with np.errstate(invalid="ignore"):
            worse = ~(ratio.min(axis=1) >= self.margin / self.sigma) & np.isfinite(sigma[depth])
        self.margin = np.where(worse, margin[depth], self.margin)
        self.sigma = np.where(worse, sigma[depth], self.sigma)
        self.place = np.where(worse, place[depth] - 1, self.place)
        by_pixel = seen.reshape(len(ratio), self.n_depths, len(samples.orders))
        self.lowest = np.fmin(self.lowest, np.fmin.reduce(by_pixel, axis=1))
        self.highest = np.fmax(self.highest, np.fmax.reduce(by_pixel, axis=1))

    def found(self, orders: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return margin, sigma and order (p,): 0 where residuals lie on both sides of an integer.

        The residual is continuous in depth and normal, so somewhere between it is zero.
        """
        order = np.concatenate([orders, [0]])[self.place].astype(np.float64)
        if not len(orders):
            return self.margin, self.sigma, order
        room = self._room()
        crossed = room.min(axis=1) <= 0
        order = np.where(crossed, orders[np.argmin(room, axis=1)], order)
        return np.where(crossed, 0.0, self.margin), self.sigma, order

    def _room(self) -> Array:
        known = self.lowest <= self.highest
        with np.errstate(invalid="ignore"):
            return np.where(known, room_between(self.lowest, self.highest), LARGEST_RESIDUAL)

    def range_of_all(self) -> tuple[Array, Array]:
        """Return the range (m,) of each order's residual over all pixels."""
        lowest = np.where(np.isfinite(self.lowest), self.lowest, np.nan)
        highest = np.where(np.isfinite(self.highest), self.highest, np.nan)
        return np.fmin.reduce(lowest, axis=0), np.fmax.reduce(highest, axis=0)
