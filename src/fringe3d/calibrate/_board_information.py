"""What the corners tell of each number: covariance, and what they leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._adjusting import efficiencies, eliminated
from fringe3d.calibrate._bundle import (
    N_POSE,
    Problem,
    State,
    normal_equations,
)
from fringe3d.model.covariance import DEVICE_NUMBERS

Floats = NDArray[np.float64]

OPEN = 1e-10
"""Least part of the largest eigenvalue of the scaled information; below, nothing is known."""


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """What the corners tell.

    Parameters
    ----------
    covariance : (n, n); of the free numbers of the devices
    names : tuple of str; of these numbers, DEVICE.NUMBER
    shape_sigma : (N, 3), mm; of the board's points; 0 where they are not free
    condition : float; ratio of the largest to the smallest eigenvalue of the information, each
        number in units of its own
    weakest : tuple of (str, float); the numbers in the combination that is known least, with their
        parts, the largest first
    is_open : bool; a combination of numbers is not known at all
    """

    covariance: Floats
    names: tuple[str, ...]
    shape_sigma: Floats
    condition: float
    weakest: tuple[tuple[str, float], ...]
    is_open: bool


def information(problem: Problem, at: State, devices: tuple[str, ...], /) -> Information:
    """Return what the corners tell of the free numbers."""
    system = normal_equations(problem, at, efficiency=efficiencies(problem, at))
    n, matrix, answer = problem.n_free, system.matrix, None
    if problem.has_shape:
        matrix, answer = eliminated(matrix, system.coupling, system.blocks)
    n_poses = (len(matrix) - n) // N_POSE
    if answer is None:
        poses = matrix[n:, n:].reshape(n_poses, N_POSE, n_poses, N_POSE)
        blocks = poses[np.arange(n_poses), :, np.arange(n_poses)]
        coupling = matrix[n:, :n].reshape(n_poses, N_POSE, n)
        reduced, _ = eliminated(matrix[:n, :n], coupling, blocks)
    else:  # with the points eliminated the poses depend on each other
        reduced = matrix[:n, :n] - matrix[:n, n:] @ np.linalg.solve(matrix[n:, n:], matrix[n:, :n])
    names = tuple(
        f"{device}.{DEVICE_NUMBERS[k]}"
        for device, row in zip(devices, problem.free, strict=True)
        for k in np.flatnonzero(row)
    )
    covariance, values, vectors = _inverse(reduced)
    sigma = np.zeros(problem.shape_free.shape)
    if answer is not None:
        full = np.linalg.pinv(matrix, hermitian=True)
        spread = np.linalg.inv(system.blocks) + answer @ full @ np.swapaxes(answer, 1, 2)
        variance = np.diagonal(spread, axis1=1, axis2=2)
        sigma = np.where(problem.shape_free, np.sqrt(np.maximum(variance, 0)), 0.0)
    part = vectors[:, 0] ** 2 if n else np.zeros(0)
    order = np.argsort(-part)[:4]
    return Information(
        covariance=covariance,
        names=names,
        shape_sigma=sigma,
        condition=float(values[-1] / max(values[0], 1e-300)) if n else 1.0,
        weakest=tuple((names[k], float(part[k])) for k in order),
        is_open=bool(n and values[0] < OPEN * values[-1]),
    )


def _inverse(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the inverse, and the eigenvalues and vectors of the matrix scaled to ones."""
    if not len(matrix):
        return matrix, np.ones(0), matrix
    scale = 1 / np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    kept = np.maximum(values, OPEN * 1e-3 * values[-1])
    inverse = (vectors / kept) @ vectors.T * np.outer(scale, scale)
    return inverse, values, vectors
