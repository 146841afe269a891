"""What the errors of a former calibration become where its poses are found again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._pose_problem import PoseProblem, State, left_over, without_scale
from fringe3d.calibrate._poses import (
    equations,
    pose_change,
    reduced,
    scale_slope,
    scaled,
    viewed,
    with_number,
)
from fringe3d.model import Device, RigCovariance
from fringe3d.model.covariance import LENS_NUMBERS, POSE_NUMBERS

Floats = NDArray[np.float64]

SMALL = 1e-6


def joint_covariance(
    problem: PoseProblem, at: State, noise: float, crowding: float, former: RigCovariance, /
) -> RigCovariance:
    """Return the covariance of former lenses and the poses that were found with them.

    Notes
    -----
    With A the normal matrix of the poses, B that of poses and lenses, S what was likely beforehand,
    the errors of the new poses are ``(A + S)^-1 (noise - B lens + S (former pose - motion))``, and
    along the scale that of the former distance. So they undo what the lenses do to the points.
    """
    devices, spread = at.devices, problem.prior.spread
    poses = [f"{d.name}.{number}" for d in devices[1:] for number in POSE_NUMBERS]
    lenses = [n for n in former.names if n.rpartition(".")[2] in LENS_NUMBERS
              and n.rpartition(".")[0] in {d.name for d in devices}]  # fmt: skip
    names = (*former.names, *(name for name in poses if name not in former.names))
    known = np.zeros((len(names), len(names)))
    known[: len(former.names), : len(former.names)] = former.matrix

    matrix, _ = problem.information(at, noise, crowding)
    basis = without_scale(devices, spread)
    told = basis.T @ (matrix * np.outer(spread, spread)) @ basis
    gain = basis @ np.linalg.inv(told + np.eye(len(told))) @ basis.T * spread[:, None]
    slope, along = scale_slope(devices, 1), _growth(devices)

    own, others = ([names.index(name) for name in part] for part in (poses, lenses))
    becomes = np.eye(len(names))
    becomes[own] = 0.0
    kept = np.eye(len(spread)) - np.outer(along, slope)
    becomes[np.ix_(own, own)] = gain / spread @ kept + np.outer(along, slope)
    steps = [former.sigma(name) for name in lenses]
    becomes[np.ix_(own, others)] = (
        -gain * spread @ _by_lens(problem, at, noise, lenses, steps) / crowding
    )
    found = becomes @ known @ becomes.T
    found[np.ix_(own, own)] += gain * spread
    return RigCovariance(names=names, matrix=(found + found.T) / 2)


def _growth(devices: Sequence[Device]) -> Floats:
    """Return how poses change where the distance of C1 and the next grows by 1 mm, and all with
    it: no phase changes."""
    distance = float(np.linalg.norm(devices[1].center_world - devices[0].center_world))
    grown = scaled(devices, 1 + SMALL)[1:]
    parts = [pose_change(now, before) for now, before in zip(grown, devices[1:], strict=True)]
    return np.asarray(np.concatenate(parts) / (SMALL * distance))


def _by_lens(
    problem: PoseProblem, at: State, noise: float, names: Sequence[str], steps: Sequence[float]
) -> Floats:
    """Return the normal matrix of poses and numbers of lenses, (p, lenses)."""
    total = np.zeros((len(problem.prior.spread), len(names)))
    for scan, depths in zip(problem.scans, at.depths, strict=True):
        parts = reduced(equations(scan, at.devices, depths), noise)
        here, _ = left_over(scan, at, depths)
        for column, (name, step) in enumerate(zip(names, steps, strict=True)):
            if step <= 0:
                continue
            device, _, number = name.rpartition(".")
            moved = [with_number(d, number, step) if d.name == device else d for d in at.devices]
            there, _ = left_over(
                viewed(scan.points, moved[0]), State(tuple(moved), at.depths), depths
            )
            slopes = np.nan_to_num((there - here) / step) * parts.root[:, None]
            total[:, column] += parts.by_pose.reshape(-1, len(total)).T @ slopes.ravel()
    return total
