"""Candidates of every pixel, listed and weighed: the work behind `choose_orders`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _aggregate, _orders
from fringe3d.correspond.bias import Bias, learn_bias, no_bias
from fringe3d.correspond.projector import OUTSIDE_PART, guard_px
from fringe3d.geometry import depth_interval, pixel_grid, project, rays
from fringe3d.geometry.projection import lens_of
from fringe3d.model import NO_ORDER, Device, MeasuringVolume, PhaseMap

TWO_PI = 2 * np.pi

OUTSIDE_COST = 6.0
"""Half squared deviations by which a surface outside the volume must fit better (3.5 of them). A
whole surface has far more evidence than that, a few stray pixels have not."""

LARGEST_COST = HIDDEN_COST = 1.2
"""Half squared deviations of one pixel, among its neighbours: more is an edge or a reflection.
Something that hides one pixel from C2 hides its neighbours, too: it must not cost more."""

LARGEST_EXTRA = 6.0
"""The same for the second direction, which nothing hides from the projector."""

SAME_ORDER = 0.5
"""Periods between what C1 and C2 decide for one point."""

CLEAR = 0.99
"""Probability of the decisions from which the bias is learnt."""

EXPECTED_CALIBRATION_PX = 0.3
"""Of C2; what a good rig's calibration may be wrong by before its bias is known."""

PROJECTOR_CALIBRATION_PX = 0.5
"""Projector px, in the second fringe direction."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoViews:
    """What two cameras see of the same fringes.

    Parameters
    ----------
    camera1, camera2 : Device
    phases1, phases2 : PhaseMap of the fringes that mark the points
    second1, second2 : PhaseMap or None; of fringes of another direction
    """

    camera1: Device
    camera2: Device
    phases1: PhaseMap
    phases2: PhaseMap
    second1: PhaseMap | None = None
    second2: PhaseMap | None = None

    @property
    def second(self) -> tuple[PhaseMap, PhaseMap] | None:
        """Return both maps of the other direction, if there are any."""
        if self.second1 is None or self.second2 is None:
            return None
        return self.second1, self.second2


def _evidence_of_bias(chosen: Choice, limit: float) -> dict[str, Any]:
    """Return the residuals of clear decisions as displacements in C2, px along the curve."""
    per_period = TWO_PI / np.where(chosen.slope == 0, np.nan, chosen.slope)  # px
    of_calibration = EXPECTED_CALIBRATION_PX * chosen.gradient / TWO_PI
    own = np.sqrt(np.maximum(chosen.sigma**2 - of_calibration**2, 0))
    return {
        "residual": chosen.residual * per_period,
        "noise": own * np.abs(per_period),
        "obliqueness": np.abs(chosen.slope)
        / np.where(chosen.gradient > 0, chosen.gradient, np.nan),
        "is_clear": (chosen.probability > CLEAR) & (chosen.cost < limit),
        "expected_px": EXPECTED_CALIBRATION_PX,
    }


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The order chosen for each valid pixel, (n,) each, and how well C2 fits it."""

    order: NDArray[np.int32]
    probability: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    cost: NDArray[np.float64]
    is_inside: NDArray[np.bool_]
    residual: NDArray[np.float64]
    sigma: NDArray[np.float64]
    slope: NDArray[np.float64]
    ratio: NDArray[np.float64]
    gradient: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """The orders on each pixel's segment, (n, m), and what speaks against them (squared sigmas)."""

    orders: NDArray[np.int32]
    costs: NDArray[np.float32]
    extras: NDArray[np.float32]
    is_seen: NDArray[np.bool_]
    is_inside: NDArray[np.bool_]


class Task:
    """Everything about the pixels of one measurement that does not change with the bias."""

    def __init__(
        self,
        views: TwoViews,
        projector: Device,
        volume: MeasuringVolume,
        limit: float,
        together: bool,
    ) -> None:
        phases1, phases2 = views.phases1, views.phases2
        self.views, self.limit, self.together = views, limit, together
        self.valid = phases1.rejection == 0
        self.pixels = pixel_grid(self.valid.shape)[self.valid]
        origin, directions = rays(views.camera1, self.pixels)
        near, far = depth_interval(origin, directions, volume)
        inside = near < far
        self.ends = np.column_stack([near, far])
        self.wide_ends = _wide_ends(near, far)
        self.misses = ~inside
        self.guard = guard_px(phases1)[self.valid]
        self.axis = np.array([np.cos(phases1.angle), np.sin(phases1.angle)])
        self.ray_p, self.ray_2 = (
            (
                device.device_from_world.apply(origin),
                np.ascontiguousarray(device.device_from_world.rotate(directions)),
                lens_of(device),
            )
            for device in (projector, views.camera2)
        )
        self.first = (
            phases1.phase[self.valid],
            phases1.phase_std[self.valid],
            phases2.phase,
            phases2.phase_std,
            phases2.order_class,
            phases1.class_of_order,
            phases1.first_order,
        )
        self.n_labels = self._most_labels()

    def _most_labels(self) -> int:
        """Return the largest number of orders of one class between the wide ends."""
        phases1, count = self.views.phases1, np.zeros(len(self.pixels), np.int32)
        _orders.count_candidates(
            self.wide_ends, self.guard, phases1.order_class[self.valid], self.ray_p, self.axis,
            phases1.period_px, self.first[0], phases1.class_of_order, phases1.first_order, count,
        )  # fmt: skip
        return max(1, int(count.max(initial=1)))

    def _second(self) -> tuple[object, ...]:
        one = self.views.second1
        if one is None:
            none = np.empty(0, np.float32)
            return none, none, np.zeros(2), 1.0
        return (
            one.phase[self.valid],
            one.phase_std[self.valid],
            np.array([np.cos(one.angle), np.sin(one.angle)]),
            one.period_px,
        )

    def solve(self) -> tuple[Choice, Bias]:
        """Choose, learn the calibration's bias from what is clear, and choose again."""
        chosen = self.decide(no_bias(EXPECTED_CALIBRATION_PX))
        bias = learn_bias(self.pixels, chosen.depth_mm, **_evidence_of_bias(chosen, self.limit))
        return (self.decide(bias) if bias.is_known else chosen), bias

    def decide(self, bias: Bias) -> Choice:
        """List the candidates, weigh them, and choose."""
        task = (
            self.ray_p,
            self.ray_2,
            self.axis,
            self.views.phases1.period_px,
            self.first,
            self._second(),
            (bias.scatter_px, PROJECTOR_CALIBRATION_PX),
            bias.along(self.pixels),
        )
        shape = (len(self.pixels), self.n_labels)
        listed = _Candidates(
            orders=np.full(shape, NO_ORDER, np.int32),
            costs=np.zeros(shape, np.float32),
            extras=np.zeros(shape, np.float32),
            is_seen=np.zeros(shape, bool),
            is_inside=np.zeros(shape, bool),
        )
        classes = self.views.phases1.order_class[self.valid]
        _orders.list_candidates(
            (self.wide_ends, self.ends), self.guard, classes, task, listed.orders, listed.costs,
            listed.extras, listed.is_seen, listed.is_inside,
        )  # fmt: skip
        order, probability = self._most_probable(listed)
        result = np.empty((len(order), _orders.N_COLUMNS))
        _orders.describe(order, NO_ORDER, self.ends, self.guard, task, result)
        depth, cost, inside, residual, sigma, slope, ratio, gradient = result.T
        return Choice(order, probability, depth, cost, inside > 0, residual, sigma, slope, ratio,
                      gradient)  # fmt: skip

    def _most_probable(self, listed: _Candidates) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the most probable candidate of each pixel, (n,), and its probability."""
        orders = listed.orders
        if self.together:
            index = np.full(self.valid.shape, -1, np.int32)
            index[self.valid] = np.arange(len(orders), dtype=np.int32)
            own = np.where(listed.is_seen, np.minimum(listed.costs / 2, LARGEST_COST), HIDDEN_COST)
            own += np.minimum(listed.extras / 2, LARGEST_EXTRA)
            own = np.where(orders == NO_ORDER, _aggregate.FAR, own).astype(np.float32)
            energy = _aggregate.aggregate(self.views.phases1.phase, index, orders, own)
        else:
            energy = np.minimum(listed.costs + listed.extras, self.limit) / 2
            energy = np.where(orders == NO_ORDER, _aggregate.FAR, energy)
        energy += OUTSIDE_COST * ~listed.is_inside
        best = energy.argmin(axis=1)
        weights = np.exp(-(energy - energy.min(axis=1, keepdims=True)).astype(np.float64))
        weights[orders == NO_ORDER] = 0
        total = weights.sum(axis=1)
        probability = np.divide(1, total, out=np.full(len(total), np.nan), where=total > 0)
        return orders[np.arange(len(orders)), best], probability


def _wide_ends(near: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depths, (n, 2), mm, in which surfaces are expected: the volume's and more.

    A ray that leaves the volume through its side meets the table below it further on: so all rays
    share the depths of all others.
    """
    inside = near < far
    ends = np.full((len(near), 2), np.nan)
    if inside.any():
        more = OUTSIDE_PART * (far - near)[inside].max()
        nearest, farthest = near[inside].min(), far[inside].max()
        ends[inside] = max(nearest - more, nearest / 2), farthest + more
    return ends


def swapped(views: TwoViews, /) -> TwoViews:
    """Return the views with C1 and C2 exchanged."""
    return TwoViews(
        camera1=views.camera2,
        camera2=views.camera1,
        phases1=views.phases2,
        phases2=views.phases1,
        second1=views.second2,
        second2=views.second1,
    )


def agrees_with_c2(
    task: Task, chosen: Choice, back: Task, chosen_back: Choice, *, strict: bool
) -> NDArray[np.bool_]:
    """Tell whether C2, asked in its turn, found the same order where it sees the point.

    A point that something hides from C2 fits what C2 sees there by chance. One pixel around it
    that agrees is enough, and so is that none is certain of its order; if strict, one that is
    certain must agree.
    """
    camera2, phases1, phases2 = task.views.camera2, task.views.phases1, task.views.phases2
    origin, directions = rays(task.views.camera1, task.pixels)
    places = project(camera2, origin + chosen.depth_mm[:, None] * directions)
    turns1 = chosen.order + phases1.phase[task.valid] / TWO_PI
    decided = chosen_back.order != NO_ORDER
    certain = decided & (chosen_back.probability > CLEAR) & (chosen_back.cost <= task.limit)
    turns2, certain2 = np.full(camera2.shape, np.nan), np.zeros(camera2.shape, bool)
    turns2[back.valid] = np.where(
        decided, chosen_back.order + phases2.phase[back.valid] / TWO_PI, np.nan
    )
    certain2[back.valid] = certain
    col, row = np.rint(np.nan_to_num(places, nan=-9)).astype(np.int64).T
    n_certain, n_agree = np.zeros(len(row), np.int64), np.zeros(len(row), np.int64)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            y, x = row + down, col + right
            inside = (y >= 0) & (x >= 0) & (y < camera2.n_rows) & (x < camera2.n_cols)
            y, x = np.where(inside, y, 0), np.where(inside, x, 0)
            n_certain += inside & certain2[y, x]
            agrees = inside & (np.abs(turns2[y, x] - turns1) < SAME_ORDER)
            n_agree += agrees & (certain2[y, x] | (not strict))
    return np.asarray((n_agree > 0) | ((n_certain == 0) & (not strict)))
