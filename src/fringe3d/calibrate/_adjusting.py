"""The least loss of a bundle adjustment (Levenberg and Marquardt), and the noise it shows.

No equation holds two points of the board, so they are eliminated (Schur complement); without them
the poses are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from fringe3d.calibrate._bundle import (
    LIMIT,
    N_LENS,
    N_POSE,
    Loss,
    Problem,
    State,
    System,
    cost_of,
    loss_and_weight,
    normal_equations,
    residuals,
)

Floats = NDArray[np.float64]

LEAST_NOISE = 1e-4
"""Of the sigma that was given: corners without any noise must not divide by zero."""

MAX_ITERATIONS = 100
COST_TOLERANCE = 1e-8
"""Part of the cost: of 10,000 corners a hundredth of a standard deviation of one number."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e12


def eliminated(matrix: Floats, coupling: Floats, blocks: Floats, /) -> tuple[Floats, Floats]:
    """Return the Schur complement, and the inverse of the blocks times the coupling.

    Parameters
    ----------
    matrix : (n, n); of what is kept
    coupling : (k, b, n); of k blocks of b unknowns with what is kept
    blocks : (k, b, b)
    """
    answer = np.linalg.solve(blocks, coupling)
    rows = (coupling.shape[0] * coupling.shape[1], len(matrix))
    complement = matrix - coupling.reshape(rows).T @ answer.reshape(rows)
    return np.asarray(complement), np.asarray(answer)


def _split(system: System, n_free: int) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return what is kept and what is eliminated: the points, or without them the poses."""
    if len(system.blocks):
        return (system.matrix, system.gradient, system.coupling, system.blocks,
                system.point_gradient)  # fmt: skip
    n_poses = (len(system.matrix) - n_free) // N_POSE
    poses = system.matrix[n_free:, n_free:].reshape(n_poses, N_POSE, n_poses, N_POSE)
    blocks = poses[np.arange(n_poses), :, np.arange(n_poses)]
    coupling = system.matrix[n_free:, :n_free].reshape(n_poses, N_POSE, n_free)
    return (system.matrix[:n_free, :n_free], system.gradient[:n_free], coupling, blocks,
            system.gradient[n_free:].reshape(n_poses, N_POSE))  # fmt: skip


def _step(system: System, n_free: int, damping: float) -> tuple[Floats, Floats]:
    """Return the damped step of devices and poses, and that of the points."""
    matrix, gradient, coupling, blocks, own = _split(system, n_free)
    matrix, blocks = _damped(matrix, damping), _damped(blocks, damping)
    complement, answer = eliminated(matrix, coupling, blocks)
    solved = np.linalg.solve(blocks, own[..., None])[..., 0]
    reduced = gradient - coupling.reshape(solved.size, len(matrix)).T @ solved.ravel()
    kept = -cho_solve(cho_factor(complement), reduced) if len(matrix) else reduced
    rest = -solved - answer @ kept
    if len(system.blocks):
        return kept, rest
    return np.r_[kept, rest.ravel()], np.zeros((0, 3))


def _damped(matrix: Floats, damping: float) -> Floats:
    damped = matrix.copy()
    place = np.arange(matrix.shape[-1])
    diagonal = matrix[..., place, place]
    top = diagonal.max(initial=1.0)
    damped[..., place, place] = diagonal * (1 + damping) + 1e-15 * top * damping
    return damped


def moved(problem: Problem, at: State, step: Floats, points: Floats, /) -> State:
    """Return the state after a step of devices and poses, and of the points."""
    change = np.zeros(problem.free.shape)
    change[problem.free] = step[: problem.n_free]
    poses = step[problem.n_free :].reshape(-1, N_POSE)
    turn = _turns(change[:, N_LENS : N_LENS + 3])
    pose_turn = _turns(poses[:, :3])
    shift = (turn @ at.device_shift[..., None])[..., 0] + change[:, N_LENS + 3 :]
    return State(
        lens=at.lens + change[:, :N_LENS],
        device_rotation=turn @ at.device_rotation,
        device_shift=shift,
        pose_rotation=pose_turn @ at.pose_rotation,
        pose_shift=at.pose_shift + poses[:, 3:],
        shape=at.shape + points if len(points) else at.shape,
    )


def _turns(vectors: Floats) -> Floats:
    return np.asarray(Rotation.from_rotvec(vectors).as_matrix()).reshape(-1, 3, 3)


def adjusted(
    problem: Problem,
    start: State,
    /,
    *,
    iterations: int = MAX_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> State:
    """Return the state with the least loss (Levenberg and Marquardt).

    Parameters
    ----------
    problem : Problem
    start : State; all points in front of the devices
    iterations : int; at most
    tolerance : float; part of the cost that is no gain any more
    """
    at, damping, growth = start, FIRST_DAMPING, 2.0
    system = normal_equations(problem, at)
    for _ in range(iterations):
        try:
            step, points = _step(system, problem.n_free, damping)
            tried = moved(problem, at, step, points)
            cost = cost_of(problem, tried)
        except np.linalg.LinAlgError:
            cost = float("inf")
        if cost <= system.cost:
            gain = system.cost - cost
            at, damping, growth = tried, max(damping / 5, LEAST_DAMPING), 2.0
            if gain <= tolerance * cost:
                break
            system = normal_equations(problem, at)
        else:
            damping, growth = damping * growth, 2 * growth
            if damping > MOST_DAMPING:
                break
    return at


def _squares(problem: Problem, at: State) -> dict[int, Floats]:
    """Return the squared distances of the corners of each device, in units of their sigma."""
    found = residuals(problem, at)
    return {
        batch.device: (np.concatenate([found[n] for n, _, _ in batch.views]) ** 2).sum(axis=1)
        / batch.sigma**2
        for batch in problem.batches
    }


def with_noise(problem: Problem, at: State, /) -> Problem:
    """Return the problem with the noise that the residuals of each device show.

    The scale of an M-estimator: so large that the weighted squares have the sum that normal noise
    would have, less what the fitted numbers take.
    """
    squares = _squares(problem, at)
    total = 2 * sum(len(s) for s in squares.values())
    shared = N_POSE * len(at.pose_shift) + int(problem.shape_free.sum())
    noise = problem.noise.copy()
    for device, s in squares.items():
        # A free number of the board that hardly any corner tells of is held by what is likely.
        left = 2 * len(s) * (1 - shared / total) - int(problem.free[device].sum())
        noise[device] = _scale(s, max(left, 0.1 * len(s)), problem.loss)
    return replace(problem, noise=noise)


def _scale(s: Floats, left: float, loss: Loss) -> float:
    """Return the factor of the sigma for squared distances `s` and that many degrees of freedom."""
    wanted = expected_square(loss) * left / 2
    scale = float(np.median(s)) / 1.386 + 1e-30
    for _ in range(100):
        _, weight = loss_and_weight(s / scale, loss)
        ratio = float((weight * s).sum()) / scale / wanted
        scale *= ratio
        if abs(ratio - 1) < 1e-6:
            break
    return max(float(np.sqrt(scale)), LEAST_NOISE)


def expected_square(loss: Loss, /) -> float:
    """Return the mean of weight times squared distance of normal noise in two coordinates."""
    s = -2 * np.log((np.arange(20_000) + 0.5) / 20_000)
    return float((loss_and_weight(s, loss)[1] * s).mean())


def efficiencies(problem: Problem, at: State, /) -> Floats:
    """Return by how much the loss changes the information of each device, (D,).

    Notes
    -----
    That of an M-estimator in two coordinates: ``(E (w + w' s))^2 / (E w^2 s / 2)``.
    """
    result = np.ones(len(problem.noise))
    for device, squares in _squares(problem, at).items():
        s = squares / problem.noise[device] ** 2
        _, weight = loss_and_weight(s, problem.loss)
        if problem.loss == "squared":
            continue
        if problem.loss == "cauchy":
            slope = -(weight**2) / LIMIT[problem.loss] ** 2
        else:
            slope = np.where(weight < 1, -weight / (2 * np.maximum(s, 1e-30)), 0.0)
        spread = float((weight**2 * s).mean()) / 2
        result[device] = float((weight + slope * s).mean()) ** 2 / max(spread, 1e-12)
    return result
