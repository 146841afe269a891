"""Candidates of every pixel, listed and weighed: the work behind `choose_orders`."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _aggregate, _listing, _orders
from fringe3d.correspond.bias import Frame, frame_of
from fringe3d.correspond.choice import Candidates, Choice, Index, Shown, Weighed
from fringe3d.correspond.curves import ray_curves
from fringe3d.correspond.grid import index_of, numbers_of, rises_of
from fringe3d.correspond.limits import (
    HIDDEN_COST,
    LARGEST_COST,
    LARGEST_EXTRA,
    MOST_SIGMA,
    OUTSIDE_COST,
    PROJECTOR_CALIBRATION_PX,
    SAMPLE,
    TWO_PI,
    UNSEEN_COST,
)
from fringe3d.correspond.projector import GUARD_PX, GUARD_SIGMA
from fringe3d.correspond.unlisted import (
    Ranges,
    Unlisted,
    field_of,
    has_one_class_a_column,
    over_tiles,
)
from fringe3d.correspond.views import TwoViews as TwoViews
from fringe3d.correspond.views import label_step_of as label_step_of
from fringe3d.geometry import grid_rays
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import over_rows
from fringe3d.model import (
    NO_ORDER,
    CalibrationBias,
    Device,
    MeasuringVolume,
    PhaseMap,
    WrappedPhaseMap,
)

f4 = np.float32


class Task:
    """The candidates of the pixels of one measurement; they do not depend on the bias.

    With a `stride` (rows, columns) it takes a part of the pixels. What C2 shows of the candidates
    is kept, for many weighings; without `keeps` it is looked up again where it is asked for, if
    nothing but C2 and all pixels together judge them.
    """

    def __init__(
        self,
        views: TwoViews,
        projector: Device,
        volume: MeasuringVolume,
        limit: float,
        together: bool,
        stride: tuple[int, int] = (1, 1),
        *,
        keeps: bool = True,
    ) -> None:
        phases1, phases2 = views.phases1, views.phases2
        self.views, self.limit, self.together = views, limit, together
        self.stride = stride
        self.grid = (slice(None, None, stride[0]), slice(None, None, stride[1]))
        self.phase = np.ascontiguousarray(phases1.phase[self.grid])
        self.valid = phases1.rejection[self.grid] == 0
        self.where = numbers_of(self.valid, stride, phases1.phase.shape[1])
        self.tables = ray_curves(views.camera1, views.camera2, projector, volume, phases1.angle)
        near, far = self._at(self.tables.ends).T
        self.misses = ~(near < far)
        self.origin, self._directions = grid_rays(views.camera1)
        self._rotations = (
            projector.device_from_world.rotation,
            views.camera2.device_from_world.rotation,
        )
        base_p, base_2 = (
            device.device_from_world.apply(self.origin) for device in (projector, views.camera2)
        )
        axis = np.array([np.cos(phases1.angle), np.sin(phases1.angle)])
        self.projector = (base_p, lens_of(projector), axis)
        self.camera2 = (base_2, lens_of(views.camera2))
        self.first = (
            self._of(phases1.phase),
            self._of(phases1.phase_std),
            phases2.phase,
            phases2.phase_std,
            phases2.order_class,
            phases1.class_of_order,
            phases1.first_order,
        )
        self.ranges = self._ranges()
        self.keeps = keeps or not self._may_be_unlisted()
        if self.keeps:
            self.listed = self._listed()
        # absolute phase in the frame before, turns
        self.before: NDArray[np.float64] = np.broadcast_to(np.nan, self.where.shape)

    @cached_property
    def frame(self) -> Frame:
        """Return over what the bias is a function; an empty volume has any."""
        first = np.flatnonzero(~self.misses)[:1]
        ends = self.tables.depths_mm.reshape(-1, 2)[self.where[first]]
        depths = (float(ends[0, 0]), float(ends[0, 1])) if len(ends) else (1.0, 2.0)
        return frame_of(self.views.camera1, depths, self.views.phases1.angle)

    @cached_property
    def pixels(self) -> NDArray[np.float64]:
        """Return the pixels, (n, 2), px."""
        rows, cols = np.divmod(self.where, np.int32(self.views.phases1.phase.shape[1]))
        return np.stack([cols, rows], axis=1).astype(np.float64)

    def directions(self, index: NDArray[Any] | None = None, /) -> NDArray[np.float64]:
        """Return the directions of the viewing rays in the world, (n, 3), or of some of them."""
        where = self.where if index is None else self.where[index]
        return np.asarray(self._directions.reshape(-1, 3)[where])

    @property
    def rays_p(self) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return which pixels they are, (n,), the rays of all, (pixel, 3), and the way to the
        projector's frame."""
        return self.where, self._directions.reshape(-1, 3), self._rotations[0]

    @property
    def rays_2(self) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return the same, and the way to the frame of C2."""
        return self.where, self._directions.reshape(-1, 3), self._rotations[1]

    def wide_ends(self, index: NDArray[Any], /) -> NDArray[np.float64]:
        """Return the depths, (m, 2), mm, in which surfaces are expected on some of the rays; NaN
        where they miss the volume."""
        ends = np.array(self.tables.depths_mm.reshape(-1, 2)[self.where[index]], np.float64)
        ends[self.misses[index]] = np.nan
        return ends

    def _at(self, table: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of a table (row, col, k) for the pixels, (n, k)."""
        return np.asarray(table.reshape(-1, table.shape[-1])[self.where])

    def _of(self, image: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(image[self.grid][self.valid])

    def _others(self) -> tuple[NDArray[Any], ...]:
        """Return the other phases of C1 and their sigma (q, n), and of each the direction (q, 2),
        the period and the projector's calibration error, px (q,)."""
        second, periods = self.views.second1, self.views.periods1
        # The same sheet lies where it lies in every period: only other directions are calibrated.
        maps: list[tuple[WrappedPhaseMap | PhaseMap, float]] = [(m, 0.0) for m in periods]
        maps += [] if second is None else [(second, PROJECTOR_CALIBRATION_PX)]
        shape = len(maps), len(self.where)
        return (
            np.array([self._of(m.phase) for m, _ in maps], np.float32).reshape(shape),
            np.array([self._of(m.phase_std) for m, _ in maps], np.float32).reshape(shape),
            np.array([(np.cos(m.angle), np.sin(m.angle)) for m, _ in maps]).reshape(-1, 2),
            np.array([m.period_px for m, _ in maps]),
            np.array([error for _, error in maps]),
        )

    def _may_be_unlisted(self) -> bool:
        views, step = self.views, self.ranges.label_step
        alone = views.second is None and not views.periods1
        return self.together and alone and has_one_class_a_column(views.phases1, step)

    def _ranges(self) -> Ranges:
        phases1, n = self.views.phases1, len(self.where)
        found, inside = np.empty((n, 2), np.int32), np.empty((n, 2), np.int32)
        over_rows(
            _orders.find_range,
            n,
            self.where,
            (self.tables.wide.reshape(-1, 2), self.tables.inner.reshape(-1, 2)),
            (GUARD_SIGMA * phases1.period_px / TWO_PI, GUARD_PX),
            self._of(phases1.order_class),
            phases1.period_px,
            self.first,
            found,
            inside,
        )
        return Ranges(found, inside, label_step_of(phases1))

    def _listed(self) -> Candidates:
        phases1, n, ranges = self.views.phases1, len(self.where), self.ranges
        shape = n, max(1, ranges.n_most)
        listed = Candidates(
            first=np.ascontiguousarray(ranges.found[:, 0]),
            label_step=ranges.label_step,
            orders=np.empty(shape, np.int32),
            shown=np.empty((*shape, _orders.N_SHOWN), np.float32),
            extras=np.empty(shape, np.float32),
            is_inside=np.empty(shape, np.bool_),
        )
        task = (self.projector, self.camera2, phases1.period_px, self.first, self._others())
        over_rows(
            _orders.list_candidates, n, self.where, self._of(phases1.order_class),
            (ranges.found, ranges.inside), ranges.label_step,
            (self.tables.curves, self._directions.reshape(-1, 3), *self._rotations), task,
            listed.orders, listed.shown, listed.extras, listed.is_inside,
        )  # fmt: skip
        return listed

    def n_inside(self) -> NDArray[Any]:
        """Return how many candidates lie in the volume, (n,)."""
        return self.listed.is_inside.sum(axis=1) if self.keeps else self.ranges.n_inside()

    def n_labels(self) -> NDArray[Any]:
        """Return how many candidates there are, (n,)."""
        return self.is_label.sum(axis=1) if self.keeps else self.ranges.counts()

    def _looking(self) -> tuple[Any, ...]:
        """Return C2's phases, tables and devices as `_listing` takes them."""
        phases1, phases2 = self.views.phases1, self.views.phases2
        names = phases1.class_of_order
        second = (
            phases2.phase.reshape(-1), phases2.phase_std.reshape(-1),
            phases2.order_class.reshape(-1), phases2.phase.shape, names.astype(np.float32),
            f4(phases1.first_order), len(np.unique(names)) > 1,
        )  # fmt: skip
        rays = self._directions.reshape(-1, 3), *self._rotations
        tables = self.tables.curves, f4(phases1.period_px), rays
        return second, tables, (self.projector, self.camera2)

    def _look(
        self, field: tuple[NDArray[Any], ...], orders: NDArray[np.int32], index: Index, /
    ) -> tuple[Shown, NDArray[np.float32]]:
        """Return what C2 shows of one order of each pixel, or of some, (n, N_SHOWN), and the
        squared deviations, (n,), with a bias as `field_of` returns it."""
        maps = np.empty((len(orders), _orders.N_SHOWN), np.float32), np.empty(len(orders), f4)
        first = self.first[0][index], self.first[1][index]
        over_tiles(_listing.show_listed, len(orders), self.where[index], first, orders,
                   *self._looking(), field, f4(MOST_SIGMA**2), maps)  # fmt: skip
        return maps

    def hear(self, costs: NDArray[np.float64]) -> None:
        """Add what other evidence has against the candidates, (n, m) squared deviations."""
        self.listed = replace(self.listed, extras=(self.listed.extras + costs).astype(np.float32))

    def settle(self, orders: NDArray[np.int32]) -> None:
        """Leave pixels whose order is settled, (n,), no other candidate; `NO_ORDER` for none."""
        if not self.keeps:
            self.ranges = self.ranges.settled(orders)
            return
        listed = self.listed.orders
        other = (orders != NO_ORDER)[:, None] & (listed != orders[:, None])
        self.listed = replace(self.listed, orders=np.where(other, np.int32(NO_ORDER), listed))

    def costs(
        self, bias: CalibrationBias, *, scatter_px: float | None = None
    ) -> NDArray[np.float32]:
        """Return the squared deviations in C2, (n, m); NaN where it does not see the point.

        A `scatter_px` stands for all that is unknown of the bias.
        """
        costs = np.empty(self.listed.orders.shape, np.float32)
        scatter = bias.scatter_px if scatter_px is None else scatter_px
        field = self._field(bias if scatter_px is None else replace(bias, covariance_px2=None))
        over_rows(
            _orders.weigh,
            len(costs),
            self.listed.shown,
            self.pixels,
            field,
            scatter,
            MOST_SIGMA,
            costs,
        )
        return costs

    def _field(self, bias: CalibrationBias) -> tuple[NDArray[np.float64], ...]:
        covariance = bias.covariance_along(self._across_fringes)
        return bias.coefficients_px, bias.middle, bias.scale, covariance

    @cached_property
    def sample(self) -> Shown:
        """Return what C2 shows of all candidates of some pixels, (k, m, N_SHOWN)."""
        every = slice(None, None, max(1, len(self.where) // SAMPLE))
        if self.keeps:
            return self.listed.shown[every]
        ranges, nothing = self.ranges, field_of(self.frame.constant((0, 0), scatter_px=0.0), None)
        part = Ranges(ranges.found[every], ranges.inside[every], ranges.label_step)
        places = range(max(1, part.n_most))
        return np.stack([self._look(nothing, part.orders(a), every)[0] for a in places], axis=1)

    @cached_property
    def _across_fringes(self) -> NDArray[np.float64]:
        """Return the direction, (2,), in which the phase rises in C2: the bias shows along it."""
        gradient = self.sample[..., [_orders.GRADIENT_X, _orders.GRADIENT_Y]]
        steepest = np.nansum(gradient, axis=(0, 1))
        return np.asarray(steepest / max(float(np.linalg.norm(steepest)), 1e-30), np.float64)

    def decide(self, bias: CalibrationBias, *, scatter_px: float | None = None) -> Choice:
        """Weigh the candidates, and choose; `scatter_px` as in `costs`."""
        if not self.keeps:
            return self._decided_unlisted(bias, scatter_px)
        costs, n = self.costs(bias, scatter_px=scatter_px), len(self.where)
        place, probability, outside = np.empty(n, np.intp), np.empty(n), np.empty(n)
        over_rows(
            _aggregate.choose, n, self._energy(costs), self.is_label, self.listed.is_inside,
            int(_aggregate.UNIT * OUTSIDE_COST), place, probability, outside,
        )  # fmt: skip
        return Choice(Weighed(self.listed, costs), place, probability, outside)

    def _decided_unlisted(self, bias: CalibrationBias, scatter_px: float | None) -> Choice:
        ranges, n = self.ranges, len(self.where)
        n_most = max(1, ranges.n_most)
        own = np.empty((n, _aggregate.padded(n_most)), np.uint16)
        if scatter_px is not None:
            bias = replace(bias, scatter_px=scatter_px, covariance_px2=None)
        field = field_of(bias, self._field(bias)[3])
        over_tiles(
            _listing.weigh_listed, n, self.where, self.first[:2],
            (ranges.found, ranges.label_step), *self._looking(), field,
            (f4(MOST_SIGMA**2), f4(LARGEST_COST), f4(HIDDEN_COST)), own,
        )  # fmt: skip
        totals = np.empty((0, 0, 0), np.uint16)
        if n_most > 1:
            totals = _aggregate.paths(
                self.phase, self.index, np.ascontiguousarray(ranges.found[:, 0]),
                ranges.label_step, own, self._jumps,
            )  # fmt: skip
        chosen = np.empty(n, np.intp), np.empty(n), np.empty(n)
        over_rows(
            _aggregate.choose_from_paths, n, totals, own, ranges.found, ranges.label_step,
            ranges.inside, int(_aggregate.UNIT * OUTSIDE_COST), chosen,
        )  # fmt: skip
        return Choice(Unlisted(ranges, partial(self._look, field)), *chosen)

    def expected(
        self, chosen: Choice, bias: CalibrationBias
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the residuals that the bias lets expect, its scatter, and the standard deviation
        of the residuals, (n,) each, turns."""
        n = len(self.where)
        expected, scatter, sigma = np.empty(n), np.empty(n), np.empty(n)
        field = self._field(bias)
        over_rows(
            _orders.expect,
            n,
            chosen.shown,
            self.pixels,
            field,
            bias.scatter_px,
            expected,
            scatter,
            sigma,
        )
        return expected, scatter, sigma

    def _energy(self, costs: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return what speaks against each candidate, see `_aggregate`, (n, m or more)."""
        is_label, extras = self.is_label, self.listed.extras
        own = np.empty((len(costs), _aggregate.padded(costs.shape[1])), np.uint16)
        if not self.together:
            limits = (self.limit / 2, self.limit / 2, self.limit / 2, UNSEEN_COST / 2)
            over_rows(_aggregate.write_own_costs, len(own), costs, extras, is_label, limits, own)
            return own
        limits = (LARGEST_COST, LARGEST_EXTRA, LARGEST_COST + LARGEST_EXTRA, HIDDEN_COST)
        over_rows(_aggregate.write_own_costs, len(own), costs, extras, is_label, limits, own)
        if costs.shape[1] == 1:
            return own  # nothing to choose
        return _aggregate.aggregate(
            self.phase, self.index, self.listed.first, self.listed.label_step, own, self._jumps
        )

    @cached_property
    def is_label(self) -> NDArray[np.bool_]:
        """Tell which columns of the candidates hold one, (n, m)."""
        return np.asarray(self.listed.orders != NO_ORDER)

    @cached_property
    def index(self) -> NDArray[np.int32]:
        """Return the number of each pixel of the grid, -1 where it has no phase."""
        return index_of(self.valid)

    @cached_property
    def rises(self) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return `rises_of` the phase."""
        return rises_of(self.phase, self.valid, self.first[1])

    @cached_property
    def _jumps(self) -> NDArray[np.uint16]:
        jumps = np.empty((len(self.where), len(_aggregate.WAYS)), np.uint16)
        over_rows(_aggregate.write_jumps, len(self.phase), self.phase, self.index, jumps)
        return jumps
