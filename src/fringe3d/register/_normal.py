"""Normal equations of all overlaps: how views should move to meet each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import PairResidual, RigidTransform, SurfaceView
from fringe3d.register._grid import gather
from fringe3d.register.overlap import Landed, Sample, land_sample

Floats = NDArray[np.float64]

TUKEY = 4.685
"""Residuals beyond so many of their scale count nothing; 95 % efficiency for normal noise."""

MAD_TO_SIGMA = 1.4826
LEAST_OVERLAP = 50
"""Sampled points of a view on another: fewer are no overlap."""

UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True, eq=False)
class PairLanding:
    """What a view's sample found on another view."""

    landed: Landed
    normals: Floats  # body frame
    is_near: NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class Overlaps:
    """Samples of all views and where they land, for given poses.

    Parameters
    ----------
    views : sequence of SurfaceView
    samples : sequence of Sample
    middle_mm : (3,) float, mm; of the body
    """

    views: Sequence[SurfaceView]
    samples: Sequence[Sample]
    middle_mm: Floats
    pairs: dict[tuple[int, int], PairLanding] = field(default_factory=dict)
    weights: list[Floats] = field(default_factory=list)

    def land(
        self,
        poses: Sequence[RigidTransform],
        limit_mm: float,
        /,
        *,
        among: Sequence[tuple[int, int]] | None = None,
        step: Callable[[int, int], object] = lambda *_: None,
    ) -> None:
        """Find again where all samples land; distances beyond the limit are none."""
        n = len(self.views)
        every = [(i, j) for i in range(n) for j in range(n) if i != j]
        self.pairs = {}
        counts = [np.ones(len(s.points_mm)) for s in self.samples]
        for number, (i, j) in enumerate(every if among is None else among):
            step(number, n * (n - 1))
            landed = land_sample(self.samples[i], poses[i], self.views[j], poses[j])
            with np.errstate(invalid="ignore"):
                is_near = landed.is_smooth & (np.abs(landed.distance_mm) <= limit_mm)
            if is_near.sum() < LEAST_OVERLAP:
                continue
            counts[i] += is_near
            self.pairs[i, j] = PairLanding(landed, poses[j].rotate(landed.normals), is_near)
        # A place that m views see gives m (m - 1) distances of m independent points.
        self.weights = [1 / count for count in counts]

    def scaled_size(self) -> float:
        """Return the robust size of all distances over what the points' sigmas explain."""
        ratios = [np.abs(self._in_sigmas(i, pair)) for (i, _), pair in self.pairs.items()]
        return MAD_TO_SIGMA * float(np.median(np.concatenate(ratios))) if ratios else np.nan

    def _in_sigmas(self, first: int, pair: PairLanding) -> Floats:
        near = pair.is_near
        sigma = np.hypot(self.samples[first].sigma_mm[near], pair.landed.sigma_mm[near])
        return np.asarray(pair.landed.distance_mm[near] / np.maximum(sigma, 1e-9))

    def equations(
        self, poses: Sequence[RigidTransform], scale: float, limit_mm: float, /
    ) -> tuple[Floats, Floats, float]:
        """Return matrix (6 n, 6 n), vector (6 n,) and the number of distances that count.

        Unknown are small motions of the views about the middle, in the body frame.
        """
        size = 6 * len(self.views)
        matrix, vector, counted = np.zeros((size, size)), np.zeros(size), 0.0
        for (i, j), pair in self.pairs.items():
            part, pull, n = self._of_pair(i, pair, poses, scale, limit_mm)
            a, b = slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6)
            matrix[a, a] += part
            matrix[b, b] += part
            matrix[a, b] -= part
            matrix[b, a] -= part
            vector[a] += pull
            vector[b] -= pull
            counted += n
        return matrix, vector, counted

    def _of_pair(
        self,
        i: int,
        pair: PairLanding,
        poses: Sequence[RigidTransform],
        scale: float,
        limit_mm: float,
    ) -> tuple[Floats, Floats, float]:
        sample = self.samples[i]
        places = poses[i].apply(sample.points_mm) - self.middle_mm
        distance = np.where(pair.is_near, pair.landed.distance_mm, np.nan)
        found = np.column_stack([distance, pair.normals, pair.landed.sigma_mm])
        sums = np.zeros(30)
        gather(found, places, sample.sigma_mm, self.weights[i], TUKEY * scale, limit_mm, 0.0, sums)
        part = np.zeros((6, 6))
        part[UPPER] = sums[:21]
        part += np.triu(part, 1).T
        return part, sums[21:27], float(sums[28])

    def of_pair(
        self, i: int, j: int, poses: Sequence[RigidTransform], scale: float, limit_mm: float, /
    ) -> tuple[Floats, Floats, int]:
        """Return the normal equations (6, 6), (6,) of two views alone, both ways, and the number.

        Unknown is the motion of the first.
        """
        matrix, vector, number = np.zeros((6, 6)), np.zeros(6), 0.0
        for first, second, sign in ((i, j, 1.0), (j, i, -1.0)):
            if (first, second) in self.pairs:
                pair = self.pairs[first, second]
                part, pull, n = self._of_pair(first, pair, poses, scale, limit_mm)
                matrix, vector, number = matrix + part, vector + sign * pull, number + n
        return matrix, vector, int(number)

    def residuals(self) -> tuple[PairResidual, ...]:
        """Return how each pair of views agrees."""
        found = []
        for i, j in sorted({(min(pair), max(pair)) for pair in self.pairs}):
            sides = [(a, b, s) for a, b, s in ((i, j, 1.0), (j, i, -1.0)) if (a, b) in self.pairs]
            parts = [(a, self.pairs[a, b], s) for a, b, s in sides]
            distances = np.concatenate(
                [s * pair.landed.distance_mm[pair.is_near] for _, pair, s in parts])  # fmt: skip
            ratios = np.concatenate([self._in_sigmas(a, pair) for a, pair, _ in parts])
            found.append(PairResidual(
                first=i, second=j, n_points=len(distances),
                rms_mm=MAD_TO_SIGMA * float(np.median(np.abs(distances))),
                in_sigmas=MAD_TO_SIGMA * float(np.median(np.abs(ratios))),
                mean_mm=float(np.median(distances)),
            ))  # fmt: skip
        return tuple(found)
