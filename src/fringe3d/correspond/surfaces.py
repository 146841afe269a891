"""Surfaces: neighbours of continuous phase. Each has one fringe order, as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.correspond._joining import join_surfaces
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.weighing import Task
from fringe3d.model import NO_ORDER, Rejection

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

TWO_PI = 2 * np.pi

CONTINUOUS = 0.5
"""Turns of absolute phase between neighbours of one surface."""

LEAST_DECIDED = 0.25
"""Part of a surface; less is a fragment."""


def absolute_turns(task: Task, order: NDArray[np.int32], where: Bools, /) -> NDArray[np.float64]:
    """Return the absolute phase on the task's grid, turns; NaN but where (n,) bool."""
    turns = np.full(task.valid.shape, np.nan)
    turns[task.valid] = np.where(where, order + task.first[0] / TWO_PI, np.nan)
    return turns


def surfaces(
    task: Task, order: NDArray[np.int32], claims: Bools, /, *, smooth: bool = False
) -> NDArray[np.intp]:
    """Return the number of the surface of each claiming pixel: neighbours of continuous phase.

    If `smooth`, they are not joined across bends, where phases may agree by chance.
    """
    turns = np.where(claims, order + task.first[0] / TWO_PI, np.nan)
    steps = task.rises[1] if smooth else np.zeros((2, 0, 0), bool)
    label = np.empty(len(turns), np.intp)
    join_surfaces(task.index, turns, CONTINUOUS, steps, label)
    return label[claims]


def is_fragment(task: Task, chosen: Choice, rejection: NDArray[np.uint16], /) -> Bools:
    """Tell which pixels belong to a smooth surface of which hardly any is left, (row, col).

    Chance agrees with a part of a wrong surface: with some patches, within which errors are alike.

    Parameters
    ----------
    task : Task
    chosen : Choice; orders (n,)
    rejection : (row, col) uint16; a surface outside the volume is not refused, it is elsewhere
    """
    alone = np.full(task.valid.shape, False)
    known = chosen.order != NO_ORDER
    if known.any():
        decided = (rejection == 0) | (rejection == np.uint16(Rejection.OUTSIDE_VOLUME))
        part = surfaces(task, chosen.order, known, smooth=True)
        share = np.bincount(part, decided[task.valid][known]) / np.bincount(part)
        own = known.copy()
        own[known] = share[part] < LEAST_DECIDED
        alone[task.valid] = own
    return alone


def no_surer_than_most(
    task: Task, chosen: Choice, certainty: NDArray[np.float64], /
) -> NDArray[np.float64]:
    """Return certainties (n,) that are no higher than that of most of the pixel's surface.

    Solutions differ by whole surfaces: where two of them agree on a patch of one of which they
    leave most open, both may be wrong there.
    """
    known = chosen.order != NO_ORDER
    whole = certainty.copy()
    if known.any():
        part = surfaces(task, chosen.order, known, smooth=True)
        typical = ndimage.median(certainty[known], part, np.arange(int(part.max()) + 1))
        whole[known] = np.fmin(certainty[known], typical[part])
    return whole
