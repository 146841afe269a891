"""Fringe orders from the frame before: while things move, it stands for a code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _following
from fringe3d.correspond.grid import rises_of
from fringe3d.geometry import project
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, Device, PhaseMap, Rejection
from fringe3d.patterns import across

MOST_MOTION = 0.35
"""Periods by which the phase of a pixel may move from one frame to the next, what all pixels have
in common left aside."""

COMMON = 0.5
"""From here on (0 to 1) the mean motion of the phases is one of most of them."""

REACH_PX, LEAST_CLASSES = 24, 4
"""How far orders are carried on to what was not seen before, along a smooth phase, and classes that
a code must tell apart for that. Without one they would run into the table behind: here and there
its phase joins that of an object smoothly, whole periods away."""


def lit_before(
    phases: PhaseMap, projector: Device, points_mm: NDArray[np.float64], /
) -> NDArray[np.float64]:
    """Return the absolute phase, turns, at which the projector lights points, (row, col).

    Parameters
    ----------
    phases : PhaseMap; of the fringes in question
    projector : Device
    points_mm : (row, col, 3) float, mm; of the frame before, NaN for none
    """
    x, y = np.moveaxis(project(projector, points_mm), -1, 0)
    return across(phases.angle, x, y) / phases.period_px


def seen_before(
    turns: NDArray[np.float64], points_mm: NDArray[np.float64], device: Device, /
) -> NDArray[np.float64]:
    """Return the absolute phase, turns, of points in the image of a device, (row, col).

    Of several points that one of its pixels sees it is that of the nearest; NaN where there is
    none.

    Parameters
    ----------
    turns : (...,) float; absolute phases of the points
    points_mm : (..., 3) float, mm
    device : Device
    """
    points, pose = points_mm.reshape(-1, 3), device.device_from_world
    depths = points @ pose.rotation[2] + pose.translation[2]
    before, nearest = np.empty((2, *device.shape))
    _following.enter(project(device, points), depths, turns.ravel(), nearest, before)
    return before


def orders_of_before(phases: PhaseMap, before: NDArray[np.float64], /) -> PhaseMap:
    """Give each pixel of a camera the fringe order that goes on from the frame before.

    The order of a pixel is the one that comes nearest to the absolute phase that it saw, unless the
    phase has moved by more than a third of a period, or its neighbours on the same surface demand
    another one. With a code, which must not contradict them, orders are carried on along a smooth
    phase to pixels that saw nothing before; without one holes of a pixel are closed, and no more.

    Parameters
    ----------
    phases : PhaseMap; of a camera, whatever it knows of the orders
    before : (row, col) float, turns; absolute phases of the frame before, NaN for none

    Returns
    -------
    PhaseMap
        Absolute; pixels without an order are AMBIGUOUS.
    """
    order = _continued(phases, before)
    first, n_orders = phases.first_order, len(phases.class_of_order)
    classes = np.take(phases.class_of_order, order - first, mode="clip")
    order[(order < first) | (order >= first + n_orders) | (classes != phases.order_class)] = (
        NO_ORDER
    )
    lost = (order == NO_ORDER) & (phases.rejection == 0)
    return replace(
        phases,
        order_class=order,
        class_of_order=np.arange(first, first + n_orders, dtype=np.int32),
    ).rejecting(np.where(lost, np.uint16(Rejection.AMBIGUOUS), np.uint16(0)))


def _continued(phases: PhaseMap, before: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the orders, (row, col), that go on from absolute phases before, turns."""
    valid, n_rows = phases.rejection == 0, len(before)
    rises, smooth = rises_of(phases.phase, valid, phases.phase_std[valid])
    moved, how_common = _following.common_motion(phases.phase, before)
    near, order = np.empty(before.shape, np.int32), np.empty(before.shape, np.int32)
    over_rows(_following.go_on, n_rows, phases.phase, before, moved if how_common > COMMON else 0.0,
              MOST_MOTION, near)  # fmt: skip
    over_rows(_following.by_neighbours, n_rows, phases.phase, rises, smooth, near, order)
    if len(np.unique(phases.class_of_order)) >= LEAST_CLASSES:
        _following.carry_on(phases.phase, rises, smooth, REACH_PX, order)
    return order
