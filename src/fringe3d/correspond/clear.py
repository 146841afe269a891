"""Methods M2 alike, fast: pixels that decide alone are decided at once, the others by all around.

With a code hardly an order of a class but one fits what C2 shows. Only where several fit, or where
C2 does not see all of them, neighbours have to be heard: there `Task` weighs them, among neighbours
whose order is settled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _around, _clear
from fringe3d.correspond.bias import frame_of
from fringe3d.correspond.both_ways import SAME_ORDER, swapped, swapped_bias
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.curves import ray_curves
from fringe3d.correspond.direct import Judging, numbers_of_judging
from fringe3d.correspond.grid import spread
from fringe3d.correspond.limits import CLEAR, TWO_PI
from fringe3d.correspond.projector import GUARD_PX, GUARD_SIGMA
from fringe3d.correspond.solving import solve
from fringe3d.correspond.surfaces import CONTINUOUS
from fringe3d.correspond.visibility import takes_foreign_light
from fringe3d.correspond.weighing import Task, TwoViews, label_step_of
from fringe3d.geometry import grid_rays
from fringe3d.kernels import over_rows
from fringe3d.model import (
    NO_ORDER,
    CalibrationBias,
    Device,
    MeasuringVolume,
    PhaseMap,
    Rejection,
)

f4 = np.float32
Bools = NDArray[np.bool_]

AROUND_PX = 3
"""Pixels around the open ones that are weighed with them: their order is settled, so that the paths
that begin there need no more of them."""


class Decided(NamedTuple):
    """What pixels decide alone, (row, col): `_clear`'s states, the order, and of the point half the
    window, its place across the fringes, and the standard deviation of that, projector px, as in
    `ChosenOrders`; its depth, mm, and the number of the pixel of C2 that sees it."""

    state: NDArray[np.uint8]
    order: NDArray[np.int32]
    half_px: NDArray[np.float32]
    place_px: NDArray[np.float32]
    place_sigma_px: NDArray[np.float32]
    depth_mm: NDArray[np.float32]
    seen_at: NDArray[np.int32]

    @property
    def is_settled(self) -> Bools:
        """Tell which pixels have an order, inside the volume or outside it."""
        return np.asarray((self.state == _clear.DECIDED) | (self.state == _clear.OUTSIDE))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Orders and depths of the pixels of a task, as far as they are known; see `Choice`."""

    order: NDArray[np.int32]
    depth_mm: NDArray[np.float64]


def is_regular(phases: PhaseMap, /) -> bool:
    """Tell whether the orders of each class follow each other at one distance, as in a cyclic code
    that is no full one."""
    step, names = label_step_of(phases), phases.class_of_order
    numbers = np.arange(len(names)) % step + phases.first_order
    return 1 < step < len(names) and bool((names == numbers).all())


def decide_alone(
    views: TwoViews, projector: Device, volume: MeasuringVolume, judging: Judging, /
) -> Decided:
    """Find the pixels of C1 that decide alone.

    Parameters
    ----------
    views : TwoViews; the code regular, see `is_regular`
    projector : Device
    volume : MeasuringVolume
    judging : Judging; what fits, and what is refuted
    """
    phases1, phases2 = views.phases1, views.phases2
    tables = ray_curves(views.camera1, views.camera2, projector, volume, phases1.angle)
    shape, first = phases1.phase.shape, phases1.first_order
    found = Decided(
        state=np.empty(shape, np.uint8),
        order=np.empty(shape, np.int32),
        half_px=np.empty(shape, f4),
        place_px=np.empty(shape, f4),
        place_sigma_px=np.empty(shape, f4),
        depth_mm=np.empty(shape, f4),
        seen_at=np.empty(shape, np.int32),
    )
    over_rows(
        _clear.decide,
        shape[0],
        (phases1.phase, phases1.order_class, phases1.phase_std, phases1.rejection,
         f4(phases1.period_px)),
        (tables.ends, tables.curves, tables.wide, tables.inner, grid_rays(views.camera1)[1]),
        (phases2.phase, phases2.phase_std, phases2.order_class),
        (f4(GUARD_SIGMA * phases1.period_px / TWO_PI), f4(GUARD_PX)),
        (f4(first), f4(first + len(phases1.class_of_order) - 1), f4(label_step_of(phases1))),
        *numbers_of_judging(judging),
        tuple(found),
    )  # fmt: skip
    return found


def _open_task(
    views: TwoViews, found: Decided, projector: Device, volume: MeasuringVolume, limit: float
) -> Task:
    """Return the task of the open pixels, among neighbours that are settled."""
    kept = spread(found.state == _clear.OPEN, AROUND_PX) & (found.state > _clear.NOTHING)
    left_out = np.where(kept, np.uint16(0), np.uint16(Rejection.NO_MATCH))
    part = replace(views, phases1=views.phases1.rejecting(left_out))
    task = Task(part, projector, volume, limit, together=True, keeps=False)
    settled = np.where(found.is_settled, found.order, np.int32(NO_ORDER)).ravel()[task.where]
    task.settle(settled)
    return task


def choose_clearly(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    bias: CalibrationBias,
    coarse: Task,
    /,
    *,
    judging: Judging,
) -> tuple[Decided, Task, Choice, Bools]:
    """Choose the orders: at once where pixels decide alone, and by `Task` where they do not.

    Parameters
    ----------
    views, projector, volume : as `fringe3d.correspond.choose_orders`
    bias : CalibrationBias
    coarse : Task of a part of the pixels
    judging : Judging; with the same bias

    Returns
    -------
    found : Decided
    task, chosen : of the open pixels and some around them
    agrees : (row, col) bool; what C2, asked in its turn, and the light confirm
    """
    found = decide_alone(views, projector, volume, judging)
    task = _open_task(views, found, projector, volume, judging.most_cost)
    chosen, _ = solve(task, bias)
    is_open = found.state.ravel()[task.where] == _clear.OPEN
    order, depth = np.where(found.is_settled, found.order, NO_ORDER), found.depth_mm
    order.ravel()[task.where[is_open]] = chosen.order[is_open]
    depth.ravel()[task.where[is_open]] = chosen.depth_mm[is_open]

    back = swapped(views)
    seen = _Seen(order.ravel()[coarse.where], depth.ravel()[coarse.where].astype(np.float64))
    tables = ray_curves(back.camera1, back.camera2, projector, volume, back.phases1.angle)
    near, far = np.nan_to_num(tables.depths_mm[0, 0], nan=1.0).tolist()
    frame = frame_of(back.camera1, (near, max(far, near + 1.0)), back.phases1.angle)
    bias_back = swapped_bias(bias, coarse, seen, projector, frame)
    decided2 = _decided_by_c2(back, projector, volume, replace(judging, bias=bias_back))
    phase = views.phases1.phase
    turns = np.where(order == NO_ORDER, np.float32(np.nan), order + phase * np.float32(1 / TWO_PI))
    agrees = np.abs(turns - decided2[0].ravel()[found.seen_at]) < SAME_ORDER
    agrees.ravel()[task.where[is_open]] = False
    where = np.flatnonzero(np.isfinite(turns) & ~agrees).astype(np.int32)
    is_alone = np.ones(turns.shape, np.bool_)
    is_alone.ravel()[task.where[is_open]] = task.n_inside()[is_open] < 2
    n_certain, n_agree = np.empty(len(where), np.int8), np.empty(len(where), np.int8)
    over_rows(
        _around.count, len(where), depth.ravel()[where].astype(np.float64),
        (where, *coarse.rays_2[1:]), coarse.camera2,
        turns.ravel()[where].astype(np.float64), is_alone.ravel()[where], decided2, SAME_ORDER,
        False, n_certain, n_agree,
    )  # fmt: skip
    agrees.ravel()[where] = (n_agree > 0) | (n_certain == 0)
    agrees &= ~_stands_in_foreign_light(coarse, seen, turns, agrees, projector)
    return found, task, chosen, agrees


def _decided_by_c2(
    back: TwoViews, projector: Device, volume: MeasuringVolume, judging: Judging
) -> tuple[NDArray[np.float32], Bools]:
    """Return the absolute phase that C2 decides for, turns, NaN for none, and where it is certain,
    (row, col)."""
    found = decide_alone(back, projector, volume, judging)
    task = _open_task(back, found, projector, volume, judging.most_cost)
    chosen, _ = solve(task, judging.bias, doubts=False)
    order, certain = np.where(found.is_settled, found.order, NO_ORDER), found.is_settled
    is_open = found.state.ravel()[task.where] == _clear.OPEN
    where = task.where[is_open]
    order.ravel()[where] = chosen.order[is_open]
    sure = (chosen.probability > CLEAR) & (chosen.cost <= task.limit) & (chosen.order != NO_ORDER)
    certain.ravel()[where] = sure[is_open]
    phase = back.phases1.phase
    turns = np.where(order == NO_ORDER, np.float32(np.nan), order + phase * np.float32(1 / TWO_PI))
    return turns, certain


def _stands_in_foreign_light(
    coarse: Task, seen: _Seen, turns: NDArray[np.float32], agrees: Bools, projector: Device
) -> Bools:
    """Return `takes_foreign_light` of all pixels, (row, col): that of the coarse pixel of whose
    surface they are. turns: absolute phase."""
    trusted = agrees.ravel()[coarse.where]
    wrong = np.zeros(coarse.valid.shape, np.bool_)
    wrong[coarse.valid] = takes_foreign_light(coarse, seen, trusted, projector)
    if not wrong.any():
        return wrong[:1, :1]
    rows, cols = (np.arange(n) // s.step for n, s in zip(agrees.shape, coarse.grid, strict=True))
    around = np.where(wrong, turns[coarse.grid], np.nan)[np.ix_(rows, cols)]
    return np.asarray(np.abs(turns - around) < CONTINUOUS)
