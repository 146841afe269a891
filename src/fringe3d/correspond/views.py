"""What two cameras see of the same fringes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringe3d.model import Device, PhaseMap, WrappedPhaseMap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoViews:
    """What two cameras see of the same fringes.

    Parameters
    ----------
    camera1, camera2 : Device
    phases1, phases2 : PhaseMap of the fringes that mark the points
    second1, second2 : PhaseMap or None; of fringes of another direction
    periods1, periods2 : tuple of WrappedPhaseMap; of other periods of the first direction
    """

    camera1: Device
    camera2: Device
    phases1: PhaseMap
    phases2: PhaseMap
    second1: PhaseMap | None = None
    second2: PhaseMap | None = None
    periods1: tuple[WrappedPhaseMap, ...] = ()
    periods2: tuple[WrappedPhaseMap, ...] = ()

    @property
    def second(self) -> tuple[PhaseMap, PhaseMap] | None:
        """Return both maps of the other direction, if there are any."""
        if self.second1 is None or self.second2 is None:
            return None
        return self.second1, self.second2


def label_step_of(phases: PhaseMap, /) -> int:
    """Return the number that divides the distances of all orders of the same class."""
    order = np.argsort(phases.class_of_order, kind="stable")
    names = phases.class_of_order[order]
    gaps = np.diff(order)[names[1:] == names[:-1]]
    return int(np.gcd.reduce(gaps)) if len(gaps) else len(order)
