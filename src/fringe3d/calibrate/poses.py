"""Poses of all devices from homologous points: self-calibration without any target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._pose_covariance import joint_covariance
from fringe3d.calibrate._pose_problem import (
    PoseProblem,
    State,
    contradiction_px,
    crowding_of,
    first_depths,
    problem_of_points,
    without_scale,
)
from fringe3d.calibrate._poses import best_depths, equations, noise_of, scaled, viewed
from fringe3d.calibrate._projecting import skew
from fringe3d.calibrate.homologous import Homologous
from fringe3d.errors import EmptyResultError
from fringe3d.model import Device, RigCovariance
from fringe3d.model.covariance import POSE_NUMBERS

Floats = NDArray[np.float64]

MIN_POINTS = 500

HELD_PART = 0.5
"""A number whose spread the data did not halve is held by the former calibration."""

NOISE_ROUNDS = 3

N_WEAKEST = 3
FORM_SAMPLE = 500


@dataclass(frozen=True, slots=True)
class PoseChange:
    """By how much a number of a device's pose differs from the former calibration.

    Parameters
    ----------
    device : str
    number : str; "turn_x" ... "shift_z", in the device frame, see `RigCovariance`
    value, sigma : float; rad or mm
    held_by : "data", or "former" where the data did not halve what was likely beforehand
    """

    device: str
    number: str
    value: float
    sigma: float
    held_by: Literal["data", "former"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedPoses:
    """Devices with their new poses, and the evidence for them.

    Parameters
    ----------
    devices : tuple of Device; the first, C1, as it was
    changes : tuple of PoseChange
    covariance : RigCovariance; of the poses, lenses taken as exact
    joint : RigCovariance or None
        Of poses and lenses together, where that of the former calibration is known: new poses undo
        much of what the lenses do to the points.
    n_numbers, n_determined : int
        Numbers of the poses without the scale, and how many combinations of them the data hold.
    weakest : tuple of (str, float)
        The shares, that add to 1, of the numbers in the combination that is known least.
    residual_before_px, residual_px : float, projector px
        Median of what the homologous points contradict each other by.
    noise_factor : float; noise of the residuals over that predicted from the images
    crowding : float
        By how much residuals of neighbours agree: points tell that many times less (1: not at all).
    form_sigma_mm : float, mm
        Rms over the points, from the uncertainty of the poses: by how much their form may be wrong,
        whatever their place and size.
    n_points : int; used
    distance_kept : str; "c1-c2": what sets the scale
    """

    devices: tuple[Device, ...]
    changes: tuple[PoseChange, ...]
    covariance: RigCovariance
    joint: RigCovariance | None
    n_numbers: int
    n_determined: int
    weakest: tuple[tuple[str, float], ...]
    residual_before_px: float
    residual_px: float
    noise_factor: float
    crowding: float
    form_sigma_mm: float
    n_points: int
    distance_kept: str

    @property
    def is_determined(self) -> bool:
        """Tell whether the data hold all numbers of the poses."""
        return self.n_determined == self.n_numbers

    def scaled(self, factor: float, /) -> tuple[Device, ...]:
        """Return the devices after the distances of all from C1 grew by a factor."""
        return scaled(self.devices, factor)


def fit_poses(
    scans: Sequence[Homologous],
    devices: Sequence[Device],
    /,
    *,
    near: Sequence[Device] | None = None,
    known: RigCovariance | None = None,
) -> FittedPoses:
    """Find the poses of further cameras and projector that homologous points agree with.

    Parameters
    ----------
    scans : sequence of Homologous; of the same rig
    devices : sequence of Device, two at least; C1, then further cameras, then the projector, as
        they stood before
    near : sequence of Device or None; the same where they are likely to stand now, to begin with
    known : RigCovariance or None; of the calibration of `devices`

    Returns
    -------
    FittedPoses

    Raises
    ------
    EmptyResultError
        If there are too few points, or nothing that two further devices could contradict.

    Notes
    -----
    The idea is that of Schreiber and Notni (2000): a projector that numbers the points from two
    directions replaces the target. Each point has a depth along its ray of C1, which is eliminated;
    C1 stays where it is, and the distance from C1 to the next device gives the scale. Gauss and
    Newton, weighted by the noise of the phases, with Cauchy's loss of 3 sigma. Combinations of
    turns and shifts that change no phase stay where they were: devices are likely to have moved by
    0.1 degrees and 0.1 % of the distance, and data that tell more outweigh it.
    """
    n_points = sum(scan.n_points for scan in scans)
    if n_points < MIN_POINTS:
        raise EmptyResultError(
            f"self-calibration: expected at least {MIN_POINTS} homologous points, found "
            f"{n_points}. Check exposure, plan and depth range of the scan"
        )
    problem, before = problem_of_points(scans, devices)
    if not sum(int(n.freedom.sum()) for n in problem.normals(before, 1.0)) > 0:
        raise EmptyResultError(
            "self-calibration: expected points that several devices see, found none"
        )
    after = before if near is None else problem.at(near, before.depths)
    noise, crowding = noise_of(problem.normals(after, 1.0), 1.0), 1.0
    for _ in range(NOISE_ROUNDS):
        after = problem.solve(after, noise, crowding)
        noise = noise_of(problem.normals(after, noise), noise)
        crowding = crowding_of(problem, after, noise)
    after = problem.solve(after, noise, crowding)
    joint = joint_covariance(problem, after, noise, crowding, known) if known is not None else None
    return replace(_result(problem, before, after, noise, crowding), joint=joint)


def located(points: Homologous, devices: Sequence[Device], /) -> Floats:
    """Return where homologous points lie, (n, 3), mm, world frame; NaN where nothing tells."""
    view = viewed(points, devices[0])
    depths = best_depths(view, devices, first_depths(points, devices))
    return np.asarray(view.origin + depths[:, None] * view.directions)


def _result(
    problem: PoseProblem, before: State, after: State, noise: float, crowding: float
) -> FittedPoses:
    spread, devices = problem.prior.spread, after.devices
    matrix, _ = problem.information(after, noise, crowding)
    basis = without_scale(devices, spread)
    told = basis.T @ (matrix * np.outer(spread, spread)) @ basis
    strength, axes = np.linalg.eigh(told)
    covariance = (
        basis @ np.linalg.inv(told + np.eye(len(told))) @ basis.T * np.outer(spread, spread)
    )
    names = [f"{d.name}.{number}" for d in devices[1:] for number in POSE_NUMBERS]
    sigma, offset = np.sqrt(np.diagonal(covariance)), problem.prior.offset(devices)
    changes = tuple(
        PoseChange(*_split(name), float(value), float(s),
                   "data" if s < HELD_PART * likely else "former")
        for name, value, s, likely in zip(names, offset, sigma, spread, strict=True)
    )  # fmt: skip
    known = RigCovariance(names=tuple(names), matrix=covariance)
    shares = (basis @ axes[:, 0]) ** 2
    order = np.argsort(-shares)[:N_WEAKEST]
    return FittedPoses(
        devices=devices,
        changes=changes,
        covariance=known,
        joint=None,
        n_numbers=len(told),
        n_determined=int((1 / (1 + strength) < HELD_PART**2).sum()),
        weakest=tuple((names[i], float(shares[i])) for i in order),
        residual_before_px=contradiction_px(problem, before),
        residual_px=contradiction_px(problem, after),
        noise_factor=noise,
        crowding=crowding,
        form_sigma_mm=_form_sigma(problem, after, covariance),
        n_points=sum(scan.points.n_points for scan in problem.scans),
        distance_kept=f"{devices[0].name}-{devices[1].name}",
    )


def _split(name: str) -> tuple[str, str]:
    device, _, number = name.rpartition(".")
    return device, number


def _form_sigma(problem: PoseProblem, at: State, covariance: Floats) -> float:
    """Return the rms of the points' uncertainty, less what a motion and a scale could undo."""
    worst = 0.0
    for scan, depths in zip(problem.scans, at.depths, strict=True):
        every = max(1, scan.points.n_points // FORM_SAMPLE)
        points = scan.points.subset(np.arange(0, scan.points.n_points, every))
        some = viewed(points, at.devices[0])
        found = equations(some, at.devices, depths[::every])
        power = np.maximum((found.by_depth**2).sum(axis=1), 1e-300)
        deeper = -(found.by_depth[:, None, :] @ found.by_pose)[:, 0] / power[:, None]
        places = depths[::every, None] * some.directions
        moved_by = some.directions[:, :, None] * deeper[:, None, :]
        centred = places - places.mean(axis=0)
        alike = np.concatenate(
            [np.tile(np.eye(3), (len(places), 1, 1)), skew(centred), centred[..., None]], axis=2
        ).reshape(-1, 7)
        flat = moved_by.reshape(len(alike), -1)
        flat = flat - alike @ np.linalg.lstsq(alike, flat, rcond=None)[0]
        variance = float(np.einsum("ip,pq,iq->", flat, covariance, flat)) / len(places)
        worst = max(worst, float(np.sqrt(max(variance, 0.0))))
    return worst
