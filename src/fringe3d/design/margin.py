"""The ambiguity margin: how well C2 tells a wrong fringe order from the right one.

The physics of a single point is in `residual`, where points are taken in `sampling`; here the
residuals are gathered over the measuring volume and over the slopes that surfaces may have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.reference import reference_of
from fringe3d.design.residual import Quality, unit
from fringe3d.design.sampling import Samples, Sampling, meeting, sloping_normals
from fringe3d.model import Rig

Array = NDArray[np.float64]

NEEDED_RATIO = 6.0
"""A margin is enough from so many standard deviations of the residual on: three for the right
order and three for the wrong one."""

LARGEST_RESIDUAL = 0.5
"""Periods. Where no other order lies in the volume, C2 still has to find its own period: the next
one is a whole period away, and half of that is the limit."""


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
    def steady_ratio(self) -> Array:
        """Return (n_slopes,), the smallest ratio; negative with a zero line, by its clearance.

        It is continuous in the geometry, for optimisers.
        """
        smallest, sigma = np.nanmin(self.ratio, axis=(1, 2)), np.nanmax(self.sigma, axis=(1, 2))
        return np.asarray(np.where(self.clearance <= 0, self.clearance / sigma, smallest))

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
        by so much.
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
    guard: float = 0.0,
    step_px: int | None = None,
    pixels: ArrayLike | None = None,
    n_azimuths: int = 8,
    facing: ArrayLike | None = None,
) -> AmbiguityMap:
    """Return how well C2 tells wrong fringe orders from the right one, over the volume.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px, angle : float, projector px and rad; of the fringes
    quality : Quality or None (1 % noise, four images, 0.1 px)
    slopes_deg, depths, beyond, guard, step_px, pixels, n_azimuths : see `sampling.Sampling`
    facing : (3,) float or None; normal of surfaces without slope; the middle between the
        directions to the cameras if None

    Raises
    ------
    RigError
        If the rig lacks a volume, a second camera or a projector, or if no pixel of C1 sees a
        part of the volume that the others see, too.
    ValueError
        If slopes or depths are not as in `sampling.Sampling`.

    Notes
    -----
    Wrong points count where they lie in the volume and in the views of C2 and projector.
    """
    sampling = Sampling(slopes_deg=slopes_deg, depths=depths, beyond=beyond, guard=guard,
                        step_px=step_px, pixels=pixels, n_azimuths=n_azimuths)  # fmt: skip
    axis = reference_of(rig).facing if facing is None else unit(np.asarray(facing, np.float64))
    grid = sampling.grid(rig.cameras[0])
    met = meeting(rig, grid.reshape(-1, 2), depths=depths, beyond=beyond)
    samples = Samples.of(rig, met, period_px, angle, guard)
    return worst_map(samples, sampling, grid, axis, quality or Quality())


def worst_map(
    samples: Samples, sampling: Sampling, grid: Array, axis: Array, quality: Quality, /
) -> AmbiguityMap:
    """Return what is hardest to tell, slope by slope: steeper ones add to what came before.

    Parameters
    ----------
    samples : Samples; of the pixels of the grid
    sampling : Sampling; the slopes
    grid : (row, col, 2) float, px
    axis : (3,) float; unit normal of surfaces without slope
    quality : Quality
    """
    slopes, n_orders = sampling.slopes, len(samples.orders)
    worst = _Worst.nothing(len(samples.index), len(sampling.depths), n_orders)
    maps = [np.full((len(slopes), grid.shape[0] * grid.shape[1]), np.nan) for _ in range(3)]
    ends = np.full((2, len(slopes), n_orders), np.nan)
    for number, slope in enumerate(slopes):
        for normal in sloping_normals(samples.rig, axis, float(slope), sampling.n_azimuths):
            worst.add(samples, *samples.judged(normal, quality))
        for values, found in zip(maps, worst.found(samples.orders), strict=True):
            values[number, samples.index] = found
        ends[0, number], ends[1, number] = worst.range_of_all()
    margin, sigma, order = (values.reshape(-1, *grid.shape[:2]) for values in maps)
    return AmbiguityMap(
        pixels=grid,
        slopes=slopes,
        margin=margin,
        sigma=sigma,
        order=np.nan_to_num(order).astype(np.int64),
        orders=samples.orders,
        lowest=ends[0],
        highest=ends[1],
        facing=axis,
    )


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

    def add(self, samples: Samples, seen: Array, sigma: Array) -> None:
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
