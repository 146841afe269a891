"""Views to blocks that hold together: of several fits of each pair those that nothing contradicts.

A fit of two views may be good and wrong, where a body repeats itself. So a fit joins two blocks of
views only if all pairs of both agree: no camera may look through what another one sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register.agreement import Agreement, Probes
from fringe3d.register.pairs import hypotheses_of, hypotheses_of_clouds

Step = Callable[[str, int, int], object]
Poses = dict[int, RigidTransform]

LEAST_OVERLAP = 0.1
"""Part of the probes of the best pair of two blocks that must lie on each other."""

CLOUD_POINTS = 40_000


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A possible fit of two views: where the second lies in the frame of the first."""

    first: int
    second: int
    first_from_second: RigidTransform


@dataclass(slots=True, eq=False)
class Blocks:
    """Views that are placed relative to each other, in blocks.

    Parameters
    ----------
    views : sequence of SurfaceView
    probes : Probes
    blocks : list of dict; of each block where its views lie
    """

    views: Sequence[SurfaceView]
    probes: Probes
    blocks: list[Poses]
    _judged: dict[tuple[int, int, int], float] = field(default_factory=dict)

    def join_by(self, links: Sequence[Link], /) -> None:
        """Join blocks by the fits of pairs, the best first, as long as nothing contradicts."""
        while len(self.blocks) > 1:
            best: tuple[float, Poses, Poses, RigidTransform] | None = None
            for number, link in enumerate(links):
                one, two = self._block_of(link.first), self._block_of(link.second)
                if one is None or two is None or one is two:
                    continue
                joined = one[link.first] @ link.first_from_second @ two[link.second].inverse()
                quality = self._judge(number, one, two, joined)
                if quality > 0 and (best is None or quality > best[0]):
                    best = quality, one, two, joined
            if best is None:
                return
            self.merge(*best[1:])

    def join_by_clouds(self, step: Step = lambda *_: None, /) -> None:
        """Join blocks by the shape of all their views together, which repeats itself less."""
        tried: set[tuple[tuple[int, ...], tuple[int, ...]]] = set()
        while len(self.blocks) > 1:
            step("joining blocks of views", len(self.views) - len(self.blocks), len(self.views))
            self.blocks.sort(key=len, reverse=True)
            for two in self.blocks[1:]:
                one = self.blocks[0]
                names = tuple(sorted(one)), tuple(sorted(two))
                if names in tried:
                    continue
                tried.add(names)
                joined = self.best_of(one, two, self._by_clouds(one, two))
                if joined is not None:
                    self.merge(one, two, joined)
                    break
            else:
                return

    def best_of(
        self, one: Poses, two: Poses, places: Iterable[RigidTransform], /
    ) -> RigidTransform | None:
        """Return which place of a block in the frame of another agrees best; None if none does."""
        best: tuple[float, RigidTransform] | None = None
        for joined in places:
            quality = self.quality(one, two, joined)
            if quality > 0 and (best is None or quality > best[0]):
                best = quality, joined
        return best[1] if best else None

    def quality(
        self, one: Poses, two: Poses, joined: RigidTransform, /, *, near_mm: float | None = None
    ) -> float:
        """Return how well two blocks agree; 0 where it contradicts or hardly overlaps."""
        moved = {k: joined @ pose for k, pose in two.items()}
        total, overlap = self._together(one, moved, near_mm)
        if not total.is_possible or overlap < LEAST_OVERLAP:
            return 0.0
        return max(total.score, 0.0) / (2 * min(len(one), len(two)))

    def score(self, one: Poses, two: Poses, /, *, near_mm: float) -> float:
        """Return how well views of two blocks agree where they lie, whatever contradicts."""
        return self._together(one, two, near_mm)[0].score

    def _together(self, one: Poses, two: Poses, near_mm: float | None) -> tuple[Agreement, float]:
        total, overlap = Agreement(), 0.0
        for a, pose in one.items():
            for b in two:
                found = self.probes.pair(a, b, pose.inverse() @ two[b], near_mm)
                overlap = max(overlap, found.near / max(found.n_probes, 1))
                total += found
        return total, overlap

    def _judge(self, link: int, one: Poses, two: Poses, joined: RigidTransform) -> float:
        key = link, hash(frozenset(one)), hash(frozenset(two))
        if key not in self._judged:
            self._judged[key] = self.quality(one, two, joined)
        return self._judged[key]

    def _block_of(self, view: int) -> Poses | None:
        return next((block for block in self.blocks if view in block), None)

    def merge(self, one: Poses, two: Poses, joined: RigidTransform, /) -> None:
        """Take the second block into the first."""
        self.blocks = [block for block in self.blocks if block is not two]
        one |= {k: joined @ pose for k, pose in two.items()}

    def _by_clouds(self, one: Poses, two: Poses) -> Iterable[RigidTransform]:
        return hypotheses_of_clouds(self.cloud(one), self.cloud(two))

    def cloud(self, block: Poses, /) -> NDArray[np.float64]:
        """Return points of all views of a block."""
        each = max(CLOUD_POINTS // len(block), 1)
        parts = []
        for k, pose in block.items():
            points = self.views[k].points_mm[self.views[k].is_valid]
            parts.append(pose.apply(points[:: -(-len(points) // each)]))
        return np.concatenate(parts)


def blocks_of(views: Sequence[SurfaceView], blocks: Sequence[Poses], /) -> Blocks:
    """Return blocks that may be joined."""
    return Blocks(views, Probes(views), [dict(block) for block in blocks])


def links_of(
    views: Sequence[SurfaceView], pairs: Sequence[tuple[int, int]], step: Step, /
) -> list[Link]:
    """Return all possible fits of pairs of views."""
    links = []
    for number, (a, b) in enumerate(pairs):
        step("matching views", number, len(pairs))
        links += [Link(a, b, fit.first_from_second) for fit in hypotheses_of(views[a], views[b])]
    return links
