"""Orders by a bias, and the bias by orders: each tells the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond.bias import (
    LEAST_PART,
    LEAST_PIXELS,
    PATCH_PX,
    Frame,
    joined,
    learn_bias,
)
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.limits import CLEAR, EXPECTED_CALIBRATION_PX
from fringe3d.correspond.weighing import Task
from fringe3d.correspond.whole import made_whole
from fringe3d.model import NO_ORDER, CalibrationBias

REFINEMENTS = 3
"""How often a stored bias is refined, and decided with."""

MOST_PHASE_STEP = 1.5
"""rad; between the pixels of the coarse grid, along which the phase is continued."""

COARSE_STEPS, STEP_LINES = (4, 3, 2), 256
"""Steps that are tried, and lines on which the phase is looked at."""


def solve(
    task: Task, bias: CalibrationBias | None, /, *, doubts: bool = True
) -> tuple[Choice, CalibrationBias]:
    """Choose with a given bias; else choose, learn the bias from what is clear, and choose again.

    One start: for codes and segments that leave little choice. `doubts` as in `made_whole`.
    """
    if bias is None:
        bias = _learnt_once(task)
    chosen = task.decide(bias)
    return (made_whole(task, chosen, doubts=doubts) if task.together else chosen), bias


def refined(
    task: Task, known: CalibrationBias, /, *, start: CalibrationBias | None = None
) -> CalibrationBias:
    """Return a stored bias with what the measurement itself adds to it.

    Where no surface was when it was learnt it is not known well enough to choose by: what is clear
    elsewhere on a surface tells it there. `start` is where to begin, the bias itself if None.
    """
    bias, frame = start or known, Frame(known.middle, known.scale, known.angle)
    if known.covariance_px2 is None:
        return known
    for _ in range(REFINEMENTS):
        chosen = made_whole(task, task.decide(bias))
        clear = clear_ones(task, chosen)
        if not clear.any():
            return bias
        evidence = chosen.clear(task.pixels, clear)
        learnt = learn_bias(evidence, frame, start=bias, known=known, n_alike=n_alike(task))
        # What one scene follows smoothly another need not.
        bias = replace(learnt, scatter_px=max(learnt.scatter_px, known.scatter_px))
    return bias


def _learnt_once(task: Task) -> CalibrationBias:
    return learnt_from(task, task.decide(nothing_known(task)))


def learnt_from(task: Task, chosen: Choice, /) -> CalibrationBias:
    """Return the bias that the clear ones of given decisions show; unknown if they are too few."""
    if not tells_enough([task], [chosen]):
        return nothing_known(task)
    learnt = learnt_together([task], [chosen], None)
    # It serves the pixels that show it: what is unknown of it elsewhere does not matter.
    return nothing_known(task) if learnt is None else replace(learnt, covariance_px2=None)


def nothing_known(task: Task, /) -> CalibrationBias:
    """Return a bias of 0 that may be wrong by as much as calibrations are."""
    return task.frame.constant((0.0, 0.0), scatter_px=EXPECTED_CALIBRATION_PX)


def coarse_stride(phase: NDArray[np.float32], /) -> tuple[int, int]:
    """Return the steps (rows, columns) over which a phase map can be continued without doubt."""
    return _step_along(phase), _step_along(phase.T)


def _step_along(phase: NDArray[np.float32]) -> int:
    rise = np.diff(phase[:, :: max(1, phase.shape[1] // STEP_LINES)], axis=0)
    rise = np.abs(rise - 2 * np.pi * np.rint(rise / (2 * np.pi)))
    typical = float(np.nanpercentile(rise, 75)) if np.isfinite(rise).any() else np.pi
    return next((s for s in COARSE_STEPS if s * typical < MOST_PHASE_STEP), 1)


def clear_ones(task: Task, chosen: Choice, /) -> NDArray[np.bool_]:
    """Tell which decisions, (n,), are clear enough to learn from."""
    return np.asarray((chosen.probability > CLEAR) & (chosen.cost < task.limit))


def tells_enough(tasks: Sequence[Task], chosen: Sequence[Choice], /) -> bool:
    """Tell whether so many decisions are clear that they tell something about the rest."""
    n_clear = sum(int(clear_ones(t, c).sum()) for t, c in zip(tasks, chosen, strict=True))
    least = LEAST_PIXELS / PATCH_PX**2 * n_alike(tasks[0])
    n = sum(int((c.order != NO_ORDER).sum()) for c in chosen)
    return n_clear >= max(least, LEAST_PART * n)


def learnt_together(
    tasks: Sequence[Task], chosen: Sequence[Choice], start: CalibrationBias | None, /
) -> CalibrationBias | None:
    """Return the bias that the clear decisions of all tasks show; None where none is clear."""
    clear = [clear_ones(task, c) for task, c in zip(tasks, chosen, strict=True)]
    if not any(where.any() for where in clear):
        return None
    evidence = joined(
        [c.clear(t.pixels, where) for t, c, where in zip(tasks, chosen, clear, strict=True)]
    )
    return learn_bias(evidence, tasks[0].frame, start=start, n_alike=n_alike(tasks[0]))


def n_alike(task: Task, /) -> float:
    """Return how many pixels of a task's grid are alike, as a patch is."""
    return max(1.0, PATCH_PX**2 / (task.grid[0].step * task.grid[1].step))
