"""Poses left out: what a calibration is worth where it was not fitted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._adjusting import adjusted
from fringe3d.calibrate._bundle import (
    Batch,
    Problem,
    State,
    batches_of,
    loss_and_weight,
    residuals,
)
from fringe3d.calibrate._bundle import Group as View

Floats = NDArray[np.float64]

N_FOLDS = 5
FOLD_TOLERANCE = 1e-6
FOLD_POINTS = 200
"""Of the board at most: enough to tell, and quick."""


def views_of(batches: Iterable[Batch], /) -> list[View]:
    """Return the views in their order."""
    found = {
        number: View(b.device, pose, b.ids[rows], b.pixels[rows], b.sigma[rows])
        for b in batches
        for number, pose, rows in b.views
    }
    return [found[number] for number in sorted(found)]


def with_poses(problem: Problem, at: State, poses: list[int], /) -> tuple[Problem, State]:
    """Return problem and state with some of the poses."""
    views = [
        replace(v, pose=poses.index(v.pose)) for v in views_of(problem.batches) if v.pose in poses
    ]
    state = replace(at, pose_rotation=at.pose_rotation[poses], pose_shift=at.pose_shift[poses])
    return replace(problem, batches=batches_of(views)), state


def placed_only(problem: Problem, /) -> Problem:
    """Return the problem with nothing free but the poses."""
    return replace(
        problem,
        free=np.zeros_like(problem.free),
        shape_free=np.zeros_like(problem.shape_free),
    )


def held_out(problem: Problem, at: State, left_out: list[int], /) -> tuple[State, Problem, State]:
    """Return the calibration without some poses, and those poses fitted to it."""
    rest = [p for p in range(len(at.pose_shift)) if p not in left_out]
    inside, start = with_poses(problem, at, rest)
    fitted = adjusted(inside, start, tolerance=FOLD_TOLERANCE)
    outside, judged = with_poses(placed_only(problem), at, left_out)
    judged = replace(
        judged,
        lens=fitted.lens,
        device_rotation=fitted.device_rotation,
        device_shift=fitted.device_shift,
        shape=fitted.shape,
    )
    return fitted, outside, adjusted(outside, judged, tolerance=FOLD_TOLERANCE)


def losses_by_pose(problem: Problem, at: State, /) -> Floats:
    """Return the loss of each pose, (P,)."""
    found = np.zeros(len(at.pose_shift))
    for view, residual in zip(views_of(problem.batches), residuals(problem, at), strict=True):
        sigma = view.sigma * problem.noise[view.device]
        s = (residual**2).sum(axis=1) / sigma**2
        found[view.pose] += float(loss_and_weight(s, problem.loss)[0].sum())
    return found


def held_out_losses(problem: Problem, at: State, /) -> Floats:
    """Return the loss of each pose where a fifth of the poses was left out, (P,)."""
    n_poses = len(at.pose_shift)
    losses = np.zeros(n_poses)
    for fold in range(min(N_FOLDS, n_poses)):
        poses = list(range(fold, n_poses, N_FOLDS))
        _, outside, judged = held_out(problem, at, poses)
        losses[poses] = losses_by_pose(outside, judged)
    return losses


def thinned(problem: Problem, /) -> Problem:
    """Return the problem with some of the board's points, the same in all views."""
    every = max(1, -(-len(problem.points) // FOLD_POINTS))
    kept = np.arange(len(problem.points)) % every == 0
    views = []
    for view in views_of(problem.batches):
        own = kept[view.ids]
        views.append(
            replace(view, ids=view.ids[own], pixels=view.pixels[own], sigma=view.sigma[own])
        )
    return replace(problem, batches=batches_of(views))
