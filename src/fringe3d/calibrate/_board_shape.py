"""Whether the board is the plane that it should be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fringe3d.calibrate._board_folds import held_out_losses, thinned
from fringe3d.calibrate._board_start import settled
from fringe3d.calibrate._bundle import (
    Problem,
    State,
    cost_of,
)

BoardShape = Literal["flat", "bent", "free"]

SHAPES: tuple[BoardShape, ...] = ("flat", "bent", "free")
"""From simple to complex. Bent: points leave the plane. Free: they are also printed unevenly."""

LIKELY = 0.01
"""Part of the board's diagonal by which points may be off at first; then what is found."""

LEAST = 1e-5

WORTH_A_LOOK = 2.0
"""Noise alone lets the loss fall by one for each free coordinate."""

CONVINCING = 30.0
MOST_POSES = 0.5

ENOUGH_POSES = 4


@dataclass(frozen=True, slots=True)
class ShapeTrial:
    """How well a shape of the board fits poses that it was not fitted to.

    Parameters
    ----------
    shape : "flat", "bent" or "free"
    gain : float; loss of the poses left out below that of the shape kept until then; NaN where
        already the poses fitted hardly gain
    """

    shape: BoardShape
    gain: float


def with_shape(problem: Problem, shape: BoardShape, /) -> Problem:
    """Return the problem with the coordinates of the board's points free or not.

    No point is held: of all boards that the corners cannot tell apart (turned, shifted, larger)
    the one nearest to the board as it should be is found.
    """
    free = np.zeros_like(problem.shape_free)
    seen = np.unique(np.concatenate([b.ids for b in problem.batches]))
    free[seen] = (shape == "free", shape == "free", shape != "flat")
    diagonal = float(np.linalg.norm(np.ptp(problem.points, axis=0)))
    return replace(problem, shape_free=free, shape_sigma=np.full(3, LIKELY * diagonal))


def settled_shape(problem: Problem, at: State, /) -> tuple[Problem, State]:
    """Adjust with the shape free; how far points are off follows from what is found."""
    problem, at = settled(problem, at)
    if not problem.has_shape:
        return problem, at
    diagonal = float(np.linalg.norm(np.ptp(problem.points, axis=0)))
    seen = problem.shape_free.any(axis=1)
    sigma = np.sqrt((at.shape[seen] ** 2).mean(axis=0))
    return settled(replace(problem, shape_sigma=np.maximum(sigma, LEAST * diagonal)), at)


def choose_shape(
    problem: Problem, at: State, /
) -> tuple[Problem, State, tuple[ShapeTrial, ...], BoardShape]:
    """Let the board bend where that makes poses fit better that were left out.

    Parameters
    ----------
    problem : Problem with a flat board
    at : State; its solution
    """
    kept: BoardShape = "flat"
    trials = [ShapeTrial("flat", 0.0)]
    for shape in SHAPES[1:]:
        if len(at.pose_shift) < ENOUGH_POSES:
            break
        tried, found = settled_shape(with_shape(problem, shape), at)
        same_noise = replace(problem, noise=tried.noise)
        gain = cost_of(same_noise, at) - cost_of(tried, found)
        more = int(tried.shape_free.sum() - problem.shape_free.sum())
        if gain < WORTH_A_LOOK * more:
            trials.append(ShapeTrial(shape, float("nan")))
            break
        few = thinned(tried)
        few_before = replace(few, shape_free=problem.shape_free, shape_sigma=problem.shape_sigma)
        gains = held_out_losses(few_before, at) - held_out_losses(few, found)
        trials.append(ShapeTrial(shape, float(gains.sum())))
        if gains.sum() < CONVINCING or (gains > 0).mean() <= MOST_POSES:
            break
        problem, at, kept = tried, found, shape
    return problem, at, tuple(trials), kept
