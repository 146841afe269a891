"""Overlaps of all views where what made the views may be wrong, too: equations of both together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import EmptyResultError
from fringe3d.geometry import project
from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register._normal import TUKEY, Overlaps
from fringe3d.register.adjust import LIMIT_OF_NOISE, SEED
from fringe3d.register.overlap import sample_of
from fringe3d.register.small_motion import motion_of, tidy
from fringe3d.register.table_model import TableFit, TablePrior, start_of_table

Floats = NDArray[np.float64]
Shifter = Callable[[Floats, Floats], Floats]
"""From pixels (n, 2), (x, y), of a view's camera, and by how much farther than its points, (n,) mm
along the rays, to the change of points there with each number of what made the view, (n, 3, q), mm,
frame of the view; NaN where it is not known."""

REACH_OF_SPACING = 2.0
"""Typical distances of points by which registered views may lie apart at the start."""

BLOCKS_ACROSS, LEAST_BLOCK = 8, 5


@dataclass(frozen=True, slots=True, eq=False)
class _Meeting:
    """Points of one view's sample on another view: which of the sample; places about the middle and
    normals (body frame), distances and their sigmas; for both views pixels, and how much farther
    along their rays the weighted mean lies."""

    which: NDArray[np.intp]
    places: Floats
    normals: Floats
    distance: Floats
    sigma: Floats
    pixels: tuple[Floats, ...]
    ahead: tuple[Floats, ...]


@dataclass(slots=True, eq=False)
class OverlapSystem:
    """Overlaps, and the least squares problem of views, table and further numbers.

    Parameters
    ----------
    middle_mm : (3,) float, mm; of the body
    prior : TablePrior or None; how good the table is; None where views are free
    n_samples : int; points of each view
    """

    middle_mm: Floats
    prior: TablePrior | None
    n_samples: int
    overlaps: Overlaps | None = None
    table: TableFit | None = None
    limit_mm: float = field(default=float("nan"))

    def land(self, views: Sequence[SurfaceView], poses: Sequence[RigidTransform], /) -> None:
        """Find where samples of all views land.

        Raises
        ------
        EmptyResultError
            If views do not overlap.
        """
        samples = [sample_of(v, self.n_samples, seed=SEED + k) for k, v in enumerate(views)]
        if self.overlaps is None:
            self.table = start_of_table(views, poses, self.middle_mm, self.prior)
            self.limit_mm = REACH_OF_SPACING * max(view.spacing_mm for view in views)
        self.overlaps = Overlaps(views, samples, self.middle_mm)
        self.overlaps.land(poses, self.limit_mm)
        if not self.overlaps.pairs:
            raise EmptyResultError("recalibrate: expected views that overlap, found none that do")
        self.limit_mm = min(self.limit_mm, LIMIT_OF_NOISE * self.residual_mm)

    @property
    def residual_mm(self) -> float:
        """Return the median of the residuals of all pairs, mm."""
        assert self.overlaps is not None
        return float(np.median([pair.rms_mm for pair in self.overlaps.residuals()]))

    @property
    def n_points(self) -> int:
        """Return the number of points on another view."""
        assert self.overlaps is not None
        return sum(int(pair.is_near.sum()) for pair in self.overlaps.pairs.values())

    def solve(
        self,
        poses: Sequence[RigidTransform],
        shifts: Sequence[Shifter],
        matrix: Floats,
        vector: Floats,
        /,
    ) -> tuple[tuple[RigidTransform, ...], Floats, Floats]:
        """Return new poses, the change of the further numbers (q,) and their covariance (q, q).

        Parameters
        ----------
        poses : sequence of RigidTransform; ``body_from_view``
        shifts : sequence of Shifter; of each view
        matrix, vector : (q, q), (q,) float; what else tells of the further numbers
        """
        assert self.overlaps is not None
        n_views, n_more = len(poses), 0 if self.table is None else self.table.n_numbers
        first = 6 * n_views + n_more
        whole, right = self._equations(poses, shifts, first, len(vector))
        if self.table is not None:
            add, pull = self.table.equations(poses, self.middle_mm)
            whole[:first, :first] += add
            right[:first] += pull
        whole[first:, first:] += matrix
        right[first:] += vector
        free = slice(6, None)  # the first view stays
        spread = np.sqrt(np.maximum(np.diagonal(whole)[free], 1e-12))
        scaled = whole[free, free] / np.outer(spread, spread)
        inverse = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) / np.outer(spread, spread)
        found, covariance = np.zeros(len(right)), np.zeros(whole.shape)
        found[free], covariance[free, free] = -inverse @ right[free], inverse
        if self.table is not None:
            own = slice(6 * n_views, first)
            self.table = self.table.moved(found[own], covariance[own, own])
        steps = found[: 6 * n_views].reshape(-1, 6)
        moved = tuple(tidy(motion_of(s, self.middle_mm) @ p)
                      for s, p in zip(steps, poses, strict=True))  # fmt: skip
        return moved, found[first:], covariance[first:, first:]

    def _equations(
        self, poses: Sequence[RigidTransform], shifts: Sequence[Shifter], first: int, n_more: int
    ) -> tuple[Floats, Floats]:
        """Return matrix and vector of the overlaps; the further numbers come last."""
        assert self.overlaps is not None
        noise = max(self.overlaps.scaled_size(), 1.0)
        meetings = {key: self._meeting(*key, poses) for key in self.overlaps.pairs}
        changes = _changes(meetings, shifts)
        size = first + n_more
        matrix, vector = np.zeros((size, size)), np.zeros(size)
        ratios = []
        for (i, j), meeting in meetings.items():
            own, other = (np.einsum("na,ab,nbq->nq", meeting.normals, poses[k].rotation, part)
                          for k, part in zip((i, j), changes[i, j], strict=True))  # fmt: skip
            motion = np.column_stack([np.cross(meeting.places, meeting.normals), meeting.normals])
            rows = np.column_stack([motion, -motion, own - other])
            in_sigmas = meeting.distance / meeting.sigma
            tukey = np.maximum(1 - (in_sigmas / (TUKEY * noise)) ** 2, 0.0) ** 2
            weight = self.overlaps.weights[i][meeting.which] * tukey / (meeting.sigma * noise) ** 2
            good = np.isfinite(rows).all(axis=1) & (weight > 0)
            rows, weight = rows[good], weight[good]
            place = [*range(6 * i, 6 * i + 6), *range(6 * j, 6 * j + 6), *range(first, size)]
            matrix[np.ix_(place, place)] += rows.T @ (weight[:, None] * rows)
            vector[place] += rows.T @ (weight * meeting.distance[good])
            ratios.append(_crowding(meeting.pixels[0][good], in_sigmas[good]))
        known = [ratio for ratio in ratios if np.isfinite(ratio)]
        crowding = max(float(np.mean(known)) if known else 1.0, 1.0)
        return matrix / crowding, vector / crowding

    def _meeting(self, i: int, j: int, poses: Sequence[RigidTransform]) -> _Meeting:
        """Return what a view's sample and another view saw of the same places."""
        assert self.overlaps is not None
        sample, views, pair = (
            self.overlaps.samples[i], self.overlaps.views, self.overlaps.pairs[i, j]
        )  # fmt: skip
        near = pair.is_near
        body, normals = poses[i].apply(sample.points_mm[near]), pair.normals[near]
        distance = pair.landed.distance_mm[near]
        own, other = sample.sigma_mm[near] ** 2, pair.landed.sigma_mm[near] ** 2
        both = np.maximum(own + other, 1e-18)
        # Slopes are taken at the weighted mean of both, whose noise is not that of their distance:
        # else what makes all distances smaller, as a smaller scale, would seem to fit better.
        moves = (-distance * own / both, distance * other / both)
        pixels, ahead = [], []
        for k, move in zip((i, j), moves, strict=True):
            inside = poses[k].inverse().apply(body)
            pixels.append(project(views[k].camera, inside))
            rays = poses[k].rotate(inside - views[k].camera.center_world)
            along = (rays * normals).sum(axis=1) / np.linalg.norm(rays, axis=1)
            ahead.append(move / along)
        return _Meeting(np.flatnonzero(near), body - self.middle_mm, normals, distance,
                        np.sqrt(both), tuple(pixels), tuple(ahead))  # fmt: skip


def _changes(
    meetings: dict[tuple[int, int], _Meeting], shifts: Sequence[Shifter]
) -> dict[tuple[int, int], list[Floats]]:
    """Return how both sides of all meetings change; each view is asked once."""
    asked: dict[int, list[tuple[tuple[int, int], int]]] = {}
    for key in meetings:
        for side, view in enumerate(key):
            asked.setdefault(view, []).append((key, side))
    found: dict[tuple[int, int], list[Floats]] = {key: [np.empty(0)] * 2 for key in meetings}
    for view, wanted in asked.items():
        pixels = np.concatenate([meetings[key].pixels[side] for key, side in wanted])
        ahead = np.concatenate([meetings[key].ahead[side] for key, side in wanted])
        cuts = np.cumsum([len(meetings[key].pixels[side]) for key, side in wanted])[:-1]
        for (key, side), part in zip(wanted, np.split(shifts[view](pixels, ahead), cuts),
                                     strict=True):  # fmt: skip
            found[key][side] = part
    return found


def _crowding(pixels: Floats, in_sigmas: Floats) -> float:
    """Return by how much means over blocks of neighbours vary more than noise alone would do."""
    if len(pixels) < LEAST_BLOCK:
        return float("nan")
    side = max(float(np.ptp(pixels, axis=0).max()) / BLOCKS_ACROSS, 1.0)
    cells = ((pixels - pixels.min(axis=0)) // side).astype(int) @ [1, 1000]
    block = np.unique(cells, return_inverse=True)[1].ravel()
    counts = np.bincount(block)
    means = np.bincount(block, in_sigmas) / counts
    full = counts >= LEAST_BLOCK
    if not full.any():
        return float("nan")
    return float(
        (means[full] ** 2 * counts[full]).mean() / max(float((in_sigmas**2).mean()), 1e-12)
    )
