"""More evidence for fringe orders: further cameras, and the frame before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond._orders import DIFFERENCE
from fringe3d.correspond.choice import Candidates, Choice, Weighed
from fringe3d.correspond.limits import LARGEST_COST
from fringe3d.correspond.solving import learnt_from, nothing_known, solve
from fringe3d.correspond.weighing import Task
from fringe3d.model import CalibrationBias, Device, MeasuringVolume, PhaseMap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Witnesses:
    """What else is known of the orders in C1.

    Parameters
    ----------
    cameras : tuple of (Device, PhaseMap); further cameras, and the phases of the same fringes there
    previous_turns : (row, col) float or None, periods; absolute phase of C1 in the frame before,
        NaN where it is not known
    """

    cameras: tuple[tuple[Device, PhaseMap], ...] = ()
    previous_turns: NDArray[np.float64] | None = None


def ask(task: Task, witnesses: Witnesses, projector: Device, volume: MeasuringVolume, /) -> Panel:
    """Let further cameras speak for the candidates of a task, and the frame before for solutions.

    Of the calibration of further cameras nothing is known as yet: see `Panel.asked_again`.
    """
    if witnesses.previous_turns is not None:
        task.before = witnesses.previous_turns[task.grid][task.valid]
    panel = Panel(task, task.listed if task.keeps else None, tuple(
        Task(replace(task.views, camera2=camera, phases2=phases, second1=None, second2=None,
                     periods1=(), periods2=()),
             projector, volume, task.limit, task.together, task.stride)
        for camera, phases in witnesses.cameras
    ))  # fmt: skip
    panel.hear([nothing_known(other) for other in panel.others])
    return panel


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A task, its candidates before further cameras were heard, and what these show of them."""

    task: Task
    before: Candidates | None
    others: tuple[Task, ...]

    def hear(self, biases: Sequence[CalibrationBias]) -> None:
        """Let further cameras speak, each after its bias."""
        if self.before is not None:
            self.task.listed = self.before
        for other, bias in zip(self.others, biases, strict=True):
            costs = np.fmin(other.costs(bias), 2 * LARGEST_COST)
            self.task.hear(np.nan_to_num(costs, nan=2 * LARGEST_COST))

    def asked_again(
        self, chosen: Choice, bias: CalibrationBias, *, is_known: bool
    ) -> tuple[Choice, CalibrationBias]:
        """Choose again, now that the clear decisions show the bias in further cameras, too."""
        if not self.others:
            return chosen, bias
        biases = []
        for other in self.others:
            assert isinstance(chosen.table, Weighed)
            unseen = np.isnan(other.listed.shown[..., DIFFERENCE])
            costs = np.where(unseen, np.float32(np.nan), chosen.table.cost)
            biases.append(learnt_from(other, replace(chosen, table=Weighed(other.listed, costs))))
        self.hear(biases)
        return solve(self.task, bias if is_known else None)
