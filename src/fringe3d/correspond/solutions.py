"""Solutions that go with the images, and how probable each is.

A wrong bias goes with wrong orders that fit nearly as well: an iteration finds the solution that is
nearest to its start. So it starts at several places, and what comes out is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.correspond._aggregate import STEP_PENALTY
from fringe3d.correspond.bias import Frame, expected, learn_bias
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.limits import LARGEST_COST, LARGEST_EXTRA
from fringe3d.correspond.solving import (
    REFINEMENTS,
    clear_ones,
    learnt_together,
    n_alike,
    refined,
)
from fringe3d.correspond.surfaces import CONTINUOUS, absolute_turns, surfaces
from fringe3d.correspond.weighing import Task
from fringe3d.correspond.whole import made_whole
from fringe3d.geometry import project, rays
from fringe3d.model import NO_ORDER, CalibrationBias, Device
from fringe3d.model.bias import N_TERMS, terms_of

STARTS_PX = tuple(0.2 * step for step in range(-4, 5))
"""Along the epipolar lines; a nearly symmetric rig has another solution every quarter pixel."""

START_SCATTER_PX, JUDGED_SCATTER_PX = 0.15, 0.08
"""Calibration error that a start leaves to be learnt, and the one by which solutions are judged."""

NOISE_THAT_JUMPS_RAD = 0.02
"""Standard deviation of the phase, beyond which it adds jumps along paths: solutions are judged by
whole surfaces then."""

N_REFINED, ROUNDS = 3, 2
"""Solutions that are refined, and how often."""

SPREAD, LEAST_SHIFT_PX = 3.0, 0.15
"""Standard deviations of a stored bias within which there may be another solution, and how far away
it is at least."""

N_LOOKS, NUDGE_PX = 3, 0.3
"""How often better solutions are sought around the best one, and how far away."""


N_SURFACES, LEAST_SURFACE = 2, 0.03
"""Surfaces that may be right where others are not: the largest, of so many of the pixels. What one
of them tells of the bias is then carried to all."""

DOUBT = 4.0
"""By which the evidence between solutions is divided before it becomes odds. Thousands of residuals
share the errors of optics and calibration: a wrong solution has been seen to win by 4 half squared
deviations."""

LEAST_WEIGHT = 1e-4

EDGE_PX = 64
"""Length of a depth edge along which its jumps are alike, and count once."""

MEMORY, MOTION_TURNS = 3.0 * DOUBT, 0.5
"""Weight of the frame before: it settles what else is nearly as likely, odds of 20 to 1, and no
more; and the periods by which a pixel's phase typically changes between two frames."""

SAME_PART = 0.995


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A bias, the orders (n,) that go with it in each task, and what speaks against both (half
    squared deviations, the size of the bias included)."""

    bias: CalibrationBias
    orders: tuple[NDArray[np.int32], ...]
    energy: float

    def resembles(self, other: Solution) -> bool:
        """Tell whether nearly all orders are the same."""
        same = [a == b for a, b in zip(self.orders, other.orders, strict=True)]
        return float(np.concatenate(same).mean()) > SAME_PART


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """Solutions that the images leave possible, the best first, and their weights (sum 1)."""

    tasks: tuple[Task, ...]
    solutions: tuple[Solution, ...]
    weights: NDArray[np.float64]

    @property
    def best(self) -> CalibrationBias:
        """Return the bias of the best solution."""
        return self.solutions[0].bias

    def agreements(self) -> NDArray[np.float64]:
        """Return `agreement` for the pixels of all tasks, (n,)."""
        parts = [
            self.agreement(task.views.phases1.phase.shape, number=number)[task.grid]
            for number, task in enumerate(self.tasks)
        ]
        return np.concatenate([p[t.valid] for p, t in zip(parts, self.tasks, strict=True)])

    def shift(self) -> int:
        """Return by how many orders the second solution differs from the best where it does."""
        if len(self.solutions) < 2:
            return 0
        best, second = (np.concatenate(s.orders) for s in self.solutions[:2])
        apart = np.abs(best - second)[(best != second) & (best != NO_ORDER) & (second != NO_ORDER)]
        return int(np.median(apart)) if len(apart) else 0

    def agreement(self, shape: tuple[int, int], /, *, number: int = 0) -> NDArray[np.float64]:
        """Return the weight of the solutions whose order is that of the best one, (row, col)."""
        task, best = self.tasks[number], self.solutions[0].orders[number]
        coarse = np.ones(task.valid.shape)
        coarse[task.valid] = sum(
            weight * (solution.orders[number] == best)
            for weight, solution in zip(self.weights, self.solutions, strict=True)
        )
        if task.valid.any():  # a cell whose sampled pixel is rejected follows the nearest one
            steps = [s.step for s in task.grid]
            nearest = ndimage.distance_transform_edt(
                ~task.valid, sampling=steps, return_distances=False, return_indices=True
            )
            coarse = coarse[tuple(nearest)]
        rows, cols = (np.arange(n) // s.step for n, s in zip(shape, task.grid, strict=True))
        return np.asarray(coarse[np.ix_(rows, cols)])


def rivals_around(task: Task, known: CalibrationBias, /) -> Rivals | None:
    """Find the biases around a stored one that go with the images, and how probable each is.

    Where it is not known to a part of the distance of two solutions, the images tell which it is.

    Returns
    -------
    Rivals or None where there is nothing to learn, or nobody knows how well the bias is known

    Notes
    -----
    Weights as in `rivals`, with the stored bias and its covariance for what is expected.
    """
    if known.covariance_px2 is None or not len(task.where):
        return None
    found: list[Solution] = []
    for start in _starts_around(task, known):
        _keep(found, _judged([task], refined(task, known, start=start), known))
    found.sort(key=lambda s: s.energy)
    return weighed([task], found)


def _starts_around(task: Task, known: CalibrationBias) -> Iterator[CalibrationBias]:
    """Yield a stored bias, and what it may be instead: moved along the epipolar lines where the
    surfaces are, with all its terms as its covariance lets them follow."""
    yield known
    assert known.covariance_px2 is not None
    way, coefficients = _epipolar_way(task), known.coefficients_px.ravel()
    for terms in _typical_terms(task, known):
        together = known.covariance_px2 @ np.kron(way, terms)
        variance = float(np.kron(way, terms) @ together)
        for shift in STARTS_PX:
            if LEAST_SHIFT_PX < abs(shift) < SPREAD * np.sqrt(variance):
                moved = coefficients + shift / variance * together
                yield replace(known, coefficients_px=moved.reshape(2, N_TERMS))


def _typical_terms(task: Task, known: CalibrationBias) -> Iterator[NDArray[np.float64]]:
    """Yield the mean terms of the bias, (9,), on all pixels, and on each large surface."""
    chosen = task.decide(known)
    ordered = chosen.order != NO_ORDER
    clear = clear_ones(task, chosen)
    for index in (np.flatnonzero(ordered), *_large_surfaces(task, chosen, clear)):
        if len(index):
            depths = chosen.depth_mm[index]
            yield terms_of(task.pixels[index], depths, known.middle, known.scale).mean(axis=0)


def rivals(tasks: Sequence[Task], /) -> Rivals | None:
    """Find the biases that go with the images, and how probable each is.

    Parameters
    ----------
    tasks : Task of each measurement with the same rig, on a coarse grid; empty ones are left out

    Returns
    -------
    Rivals or None where nothing is clear, and nothing can be learnt

    Notes
    -----
    The weight is ``exp(-E / 4)``, ``E = n_patches * mean(min(r^2 / 2 sigma^2, 1.2) + others)
    + 5 edges + |c / prior|^2 / 2 + 12 change``, others being the costs of further fringes and
    cameras, edges the length of depth edges over 64 px, change the part of the pixels whose phase
    is not that of the frame before.
    Neighbours within a patch share their errors and count once; a jump of the absolute phase
    between neighbours is a depth edge, of which all solutions see the true ones.
    """
    tasks = [task for task in tasks if len(task.where)]
    if not tasks:
        return None
    way, frame = _epipolar_way(tasks[0]), tasks[0].frame
    starts = [frame.constant(tuple(s * way), scatter_px=START_SCATTER_PX) for s in STARTS_PX]
    begun = [s for start in starts if (s := _improved(tasks, start)) is not None]
    found: list[Solution] = []
    for first in sorted(begun, key=lambda s: s.energy)[:N_REFINED]:
        for one in (first, *_from_surfaces(tasks, first)):
            refined = one
            for _ in range(ROUNDS):
                refined = _improved(tasks, refined.bias) or refined
            _keep(found, refined)
    if not found:
        return None
    _look_around(tasks, found, way)
    rest = weighed(tasks, found)
    return replace(rest, solutions=tuple(_of_whole_surfaces(tasks, s) for s in rest.solutions))


def weighed(tasks: Sequence[Task], found: Sequence[Solution]) -> Rivals:
    """Return the solutions, the best first, that are not ruled out by it."""
    weights = np.exp([(found[0].energy - s.energy) / DOUBT for s in found])
    n = int((weights > LEAST_WEIGHT).sum())
    return Rivals(tuple(tasks), tuple(found[:n]), weights[:n] / weights[:n].sum())


def _of_whole_surfaces(tasks: Sequence[Task], solution: Solution) -> Solution:
    """Return a solution with the bias that its surfaces show, each as a whole.

    Where C2 does not see a surface any more, orders that it sees may fit by chance, and bend the
    bias. (To look for solutions so would miss some: a surface goes all the way or not at all.)
    """
    bias = solution.bias
    for _ in range(REFINEMENTS):
        whole = [made_whole(task, task.decide(bias)) for task in tasks]
        bias = learnt_together(tasks, whole, bias) or bias
    return replace(_judged(tasks, bias), energy=solution.energy)


def _keep(found: list[Solution], other: Solution) -> None:
    """Add a solution; of those that resemble each other the best stays."""
    alike = [number for number, known in enumerate(found) if other.resembles(known)]
    if all(other.energy < found[number].energy for number in alike):
        found[:] = [known for number, known in enumerate(found) if number not in alike]
        found.append(other)


def _look_around(tasks: Sequence[Task], found: list[Solution], way: NDArray[np.float64]) -> None:
    """Add the solutions around the best one as long as there are better ones, and sort all.

    A start in the wrong valley shows itself by this: one term of the bias, moved by as much as
    calibrations are wrong by, leads to a better one.
    """
    found.sort(key=lambda s: s.energy)
    for _ in range(N_LOOKS):
        best = found[0]
        for other in _around(tasks, best, way):
            _keep(found, other)
        found.sort(key=lambda s: s.energy)
        if found[0] is best:
            return


def _around(
    tasks: Sequence[Task], solution: Solution, way: NDArray[np.float64]
) -> Iterator[Solution]:
    """Yield what comes out where one term of the bias is moved, along the epipolar lines."""
    for term in range(N_TERMS):
        for nudge in (NUDGE_PX, -NUDGE_PX):
            coefficients = solution.bias.coefficients_px.copy()
            coefficients[:, term] += nudge * way
            moved = _improved(tasks, replace(
                solution.bias, coefficients_px=coefficients, scatter_px=START_SCATTER_PX
            ))  # fmt: skip
            if moved is not None:
                yield moved


def _improved(tasks: Sequence[Task], bias: CalibrationBias) -> Solution | None:
    """Choose, learn and choose again; None where nothing can be learnt."""
    chosen = [task.decide(bias) for task in tasks]
    learnt = learnt_together(tasks, chosen, bias)
    return None if learnt is None else _judged(tasks, learnt)


def _judged(
    tasks: Sequence[Task], bias: CalibrationBias, known: CalibrationBias | None = None
) -> Solution:
    energy, orders = _surprise(tasks[0].frame, bias, known), []
    for task in tasks:
        chosen = task.decide(bias, scatter_px=JUDGED_SCATTER_PX)
        if len(task.where) and np.median(task.first[1]) >= NOISE_THAT_JUMPS_RAD:
            chosen = made_whole(task, chosen)
        seen = np.isfinite(chosen.cost)  # what lies beyond the border of C2 tells nothing
        cost = np.fmin(chosen.cost[seen] / 2, LARGEST_COST) * (len(seen) / max(1, seen.sum()))
        turns = absolute_turns(task, chosen.order, chosen.order != NO_ORDER)
        others = np.minimum(chosen.extra / 2, LARGEST_EXTRA)
        energy += (float(cost.sum()) + float(others.sum())) / n_alike(task)
        energy += STEP_PENALTY * edges_px(turns, task.grid) / EDGE_PX
        energy += MEMORY * _change(task, chosen)
        orders.append(chosen.order)
    return Solution(bias, tuple(orders), energy)


def edges_px(turns: NDArray[np.float64], grid: tuple[slice, slice]) -> int:
    """Return the length of the jumps of an absolute phase on a grid of pixels, px."""
    return sum(
        int((np.abs(np.diff(turns, axis=axis)) > CONTINUOUS).sum()) * grid[1 - axis].step
        for axis in (0, 1)
    )


def _surprise(frame: Frame, bias: CalibrationBias, known: CalibrationBias | None) -> float:
    """Return half the squared deviation of a bias from what is expected."""
    mean, precision = expected(frame, known)
    apart = bias.coefficients_px.ravel() - mean
    return 0.5 * float(apart @ precision @ apart)


def _change(task: Task, chosen: Choice) -> float:
    """Return how much has changed since the frame before, 0 to 1."""
    known = np.isfinite(task.before) & (chosen.order != NO_ORDER)
    if not known.any():
        return 0.0
    turns = chosen.order[known] + task.first[0][known] / (2 * np.pi)
    return float(np.fmin(((turns - task.before[known]) / MOTION_TURNS) ** 2, 1).mean())


def _from_surfaces(tasks: Sequence[Task], solution: Solution) -> Iterator[Solution]:
    """Yield the solutions that one surface alone leads to."""
    chosen = [task.decide(solution.bias) for task in tasks]
    clear = [clear_ones(task, c) for task, c in zip(tasks, chosen, strict=True)]
    found = [
        (number, index)
        for number, (task, c, where) in enumerate(zip(tasks, chosen, clear, strict=True))
        for index in _large_surfaces(task, c, where, of=sum(map(len, clear)))
    ]
    for number, index in sorted(found, key=lambda one: -len(one[1]))[:N_SURFACES]:
        task = tasks[number]
        learnt = learn_bias(chosen[number].clear(task.pixels, index), tasks[0].frame,
                            start=solution.bias, n_alike=n_alike(task))  # fmt: skip
        yield _judged(tasks, learnt)


def _large_surfaces(
    task: Task, chosen: Choice, clear: NDArray[np.bool_], /, *, of: int | None = None
) -> Iterator[NDArray[np.intp]]:
    """Yield the pixels of the largest surfaces, if they are a part of all pixels or of so many."""
    label = surfaces(task, chosen.order, clear)
    sizes = np.bincount(label) if len(label) else np.zeros(0, int)
    for number in np.argsort(sizes)[::-1][:N_SURFACES]:
        if sizes[number] >= LEAST_SURFACE * (len(clear) if of is None else of):
            yield np.flatnonzero(clear)[label == number]


def epipolar_direction(
    camera1: Device, camera2: Device, pixels: NDArray[np.float64], depth_mm: float, /
) -> NDArray[np.float64]:
    """Return the mean direction, (2,), in which C2 sees the points of pixels (n, 2) move away from
    C1, at a depth along their rays."""
    origin, directions = rays(camera1, pixels)
    moved = project(camera2, origin + 1.001 * depth_mm * directions)
    way = np.nanmean(moved - project(camera2, origin + depth_mm * directions), axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _epipolar_way(task: Task) -> NDArray[np.float64]:
    views = task.views
    return epipolar_direction(
        views.camera1, views.camera2, task.pixels, float(task.frame.middle[2])
    )
