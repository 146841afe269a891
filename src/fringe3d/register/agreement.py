"""How well placed views agree: what lies on each other, and what was looked through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register.overlap import Sample, land_sample, sample_of

N_PROBES = 300
"""Points of a view by which places are compared: conflicts of wrong places are far above 1 %."""

NEAR = 4.0
"""Typical distances of points: views that agree lie so near each other."""

COST_OF_CONFLICT = 4.0
"""Points on each other that one point weighs up which another camera looked through."""

MOST_CONFLICT, LEAST_CONFLICTS = 0.05, 6
"""Part of the points that lie on another view or before it which that view may have looked
through, and the number of which it may always: with true places of simulated bodies there are
none, with wrong ones 3 to 100 %."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Counts of probes: on another surface (each 1 where it fits well), looked through, and all."""

    near: float = 0.0
    front: int = 0
    n_probes: int = 0

    def __add__(self, other: Agreement, /) -> Agreement:
        """Return the counts of both together."""
        return Agreement(
            self.near + other.near, self.front + other.front, self.n_probes + other.n_probes
        )

    @property
    def score(self) -> float:
        """Return one number to compare places by."""
        return self.near - COST_OF_CONFLICT * self.front

    @property
    def conflict(self) -> float:
        """Return the part of what could be compared that contradicts, 0 to 1."""
        return self.front / max(self.near + self.front, 1.0)

    @property
    def is_possible(self) -> bool:
        """Tell whether nothing contradicts."""
        return self.front <= LEAST_CONFLICTS or self.conflict < MOST_CONFLICT


@dataclass(slots=True, eq=False)
class Probes:
    """A few points of each view.

    Parameters
    ----------
    views : sequence of SurfaceView
    near_mm : float, mm; how far surfaces that agree may lie apart
    """

    views: Sequence[SurfaceView]
    near_mm: float = 0.0
    samples: list[Sample] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Take the points, and the typical distance of them."""
        self.samples = [sample_of(v, N_PROBES, seed=k) for k, v in enumerate(self.views)]
        self.near_mm = max(self.near_mm, NEAR * max(v.spacing_mm for v in self.views))

    def pair(
        self, a: int, b: int, a_from_b: RigidTransform, near_mm: float | None = None, /
    ) -> Agreement:
        """Tell how two views agree, both ways; they may be told to lie less near."""
        identity, near = RigidTransform.identity(), near_mm or self.near_mm
        return (self._one_way(b, a_from_b, a, identity, near)
                + self._one_way(a, identity, b, a_from_b, near))  # fmt: skip

    def _one_way(
        self, own: int, pose: RigidTransform, other: int, at: RigidTransform, near_mm: float
    ) -> Agreement:
        landed = land_sample(self.samples[own], pose, self.views[other], at)
        with np.errstate(invalid="ignore"):
            parts = 1 - (landed.distance_mm / near_mm) ** 2
            front = (landed.behind_mm < -2 * max(near_mm, self.near_mm)) & ~(parts > 0)
        return Agreement(float(parts[parts > 0].sum()), int(front.sum()),
                         len(self.samples[own].points_mm))  # fmt: skip
