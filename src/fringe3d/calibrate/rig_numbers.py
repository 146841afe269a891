"""Numbers of a rig that several views together may tell, and what they change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._pose_problem import crowding_of, problem_of_points
from fringe3d.calibrate._poses import (
    Equations,
    Viewed,
    best_depths,
    equations,
    noise_of,
    normal_equations,
    viewed,
    with_pose_change,
)
from fringe3d.calibrate.homologous import Homologous
from fringe3d.model import Device, RigCovariance
from fringe3d.model.covariance import POSE_NUMBERS

Floats = NDArray[np.float64]

FOCAL = "focal"
LIKELY_TURN, LIKELY_SHIFT, LIKELY_FOCAL = np.radians(0.1), 1e-3, 3e-4
"""How far numbers are likely to be off; shifts as a part of the distance, focal lengths of
themselves."""

STEP = 1e-4
"""Of the derivatives, as a part of what is likely."""

DISTANCE_KEPT = 1e-7
"""Part of itself by which the distance of C1 and the next device may change: the scale."""


@dataclass(frozen=True, slots=True)
class RigNumber:
    """A number of a device that may be off.

    Parameters
    ----------
    device : int
    name : str; of `POSE_NUMBERS` (rad, mm, device frame), or "focal" (relative)
    likely : float; how far it is likely to be off
    """

    device: int
    name: str
    likely: float


def numbers_of(devices: Sequence[Device], distance_mm: float, /) -> list[RigNumber]:
    """Return what may be off: the poses of all devices but the first, and all focal lengths.

    Parameters
    ----------
    devices : C1, the device that places points with it, then others
    distance_mm : float, mm; typical distance of points
    """
    likely = [LIKELY_TURN] * 3 + [LIKELY_SHIFT * distance_mm] * 3
    poses = [RigNumber(k, name, size) for k in range(1, len(devices))
             for name, size in zip(POSE_NUMBERS, likely, strict=True)]  # fmt: skip
    return poses + [RigNumber(k, FOCAL, LIKELY_FOCAL) for k in range(len(devices))]


def changed(
    devices: Sequence[Device], numbers: Sequence[RigNumber], by: Floats, /
) -> tuple[Device, ...]:
    """Return the devices with their numbers changed."""
    result = list(devices)
    for k, device in enumerate(devices):
        change, stretch = np.zeros(len(POSE_NUMBERS)), 1.0
        for number, value in zip(numbers, by, strict=True):
            if number.device == k and number.name == FOCAL:
                stretch += value
            elif number.device == k:
                change[POSE_NUMBERS.index(number.name)] = value
        result[k] = with_pose_change(replace(device, focal_px=device.focal_px * stretch), change)
    return tuple(result)


def placing(points: Homologous, devices: Sequence[Device], /) -> Homologous:
    """Return the points that the first two devices place, with what these two alone saw."""
    if devices[1].role == "projector":
        kept = np.flatnonzero(np.isfinite(points.position_px).any(axis=1))
        return replace(points.subset(kept), sights=())
    own = next(s for s in points.sights if s.device == devices[1].name)
    kept = np.flatnonzero(np.isfinite(own.ahead_px).any(axis=1))
    return replace(points, sights=(own,)).subset(kept)


def placed(
    points: Homologous, devices: Sequence[Device], depths: Floats, /
) -> tuple[Floats, Floats, Floats]:
    """Return depths (n,), points (n, 3), mm, and sigmas along the rays (n,) by two devices."""
    view = viewed(points, devices[0])
    depths = best_depths(view, devices[:2], depths, rounds=3)
    power = (equations(view, devices[:2], depths).by_depth ** 2).sum(axis=1)
    world = view.origin + depths[:, None] * view.directions
    length = np.linalg.norm(view.directions, axis=-1)
    return depths, world, length / np.sqrt(np.maximum(power, 1e-300))


def point_shifts(
    points: Homologous,
    devices: Sequence[Device],
    depths: Floats,
    numbers: Sequence[RigNumber],
    /,
) -> Floats:
    """Return how points at depths move with each number, (n, 3, q): what both devices see stays.

    The depths need not be those that fit best; so a point's own noise can be left out of them.
    """
    view = viewed(points, devices[0])
    here = equations(view, devices[:2], depths)
    power = np.maximum((here.by_depth**2).sum(axis=1), 1e-300)
    found = np.zeros((points.n_points, 3, len(numbers)))
    for k, number in enumerate(numbers):
        if number.device > 1:
            continue
        step = STEP * number.likely
        other = changed(devices, [number], np.array([step]))
        there = viewed(points, other[0])
        seen = equations(there, other[:2], depths).residual - here.residual
        deeper = -(here.by_depth * seen).sum(axis=1) / power
        turned = depths[:, None] * (there.directions - view.directions)
        found[:, :, k] = (turned + deeper[:, None] * view.directions) / step
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Contradictions:
    """What devices contradict each other by, point for point, and what that tells of the numbers:
    normal matrix (q, q), gradient (q,); the median of the contradictions in sigmas."""

    matrix: Floats
    gradient: Floats
    in_sigmas: float


def contradictions(
    scans: Sequence[Homologous], devices: Sequence[Device], numbers: Sequence[RigNumber], /
) -> Contradictions:
    """Return what three devices or more, or two directions of fringes, tell of the numbers."""
    size = len(numbers)
    problem, state = problem_of_points(scans, devices)
    plain = problem.normals(state, 1.0)
    freedom = np.concatenate([n.freedom for n in plain])
    if not freedom.any():
        return Contradictions(np.zeros((size, size)), np.zeros(size), float("nan"))
    noise = noise_of(plain, 1.0)
    crowding = crowding_of(problem, state, noise)
    matrix, gradient, squares = np.zeros((size, size)), np.zeros(size), []
    for view, depths in zip(problem.scans, state.depths, strict=True):
        normal = normal_equations(_by_numbers(view, devices, depths, numbers), noise)
        matrix += normal.matrix / crowding
        gradient += normal.gradient / crowding
        squares.append(normal.squares[normal.freedom > 0] * noise**2)
    middle = float(np.sqrt(np.median(np.concatenate(squares))))
    return Contradictions(matrix, gradient, middle)


def _by_numbers(
    view: Viewed, devices: Sequence[Device], depths: Floats, numbers: Sequence[RigNumber]
) -> Equations:
    """Return the equations of one scan with their slopes by the numbers."""
    here = equations(view, devices, depths)
    slopes = np.zeros((*here.residual.shape, len(numbers)))
    for k, number in enumerate(numbers):
        step = STEP * number.likely
        other = changed(devices, [number], np.array([step]))
        there = equations(viewed(view.points, other[0]), other, depths)
        slopes[:, :, k] = (there.residual - here.residual) / step
    return Equations(here.residual, here.by_depth, slopes)


def distance_slope(devices: Sequence[Device], numbers: Sequence[RigNumber], /) -> Floats:
    """Return the relative change of the first two devices' distance with each number, (q,)."""
    before = _apart(devices)
    steps = [STEP * n.likely for n in numbers]
    return np.array([(_apart(changed(devices, [n], np.array([s]))) / before - 1) / s
                     for n, s in zip(numbers, steps, strict=True)])  # fmt: skip


def beforehand(
    devices: Sequence[Device], numbers: Sequence[RigNumber], off: Floats, /
) -> tuple[Floats, Floats]:
    """Return what is likely beforehand: (q, q), (q,); the distance of two devices is the scale."""
    weight = np.array([n.likely for n in numbers]) ** -2.0
    slope = distance_slope(devices, numbers) / DISTANCE_KEPT
    return np.diag(weight) + np.outer(slope, slope), weight * off


def covariance_of(
    devices: Sequence[Device], numbers: Sequence[RigNumber], matrix: Floats, /
) -> RigCovariance:
    """Return the covariance as that of a rig: a focal length stands for both of its axes."""
    names, rows = [], []
    for k, number in enumerate(numbers):
        device = devices[number.device]
        own = {number.name: 1.0}
        if number.name == FOCAL:
            own = {"fx": float(device.focal_px[0]), "fy": float(device.focal_px[1])}
        for name, factor in own.items():
            names.append(f"{device.name}.{name}")
            rows.append(factor * np.eye(len(numbers))[k])
    turn = np.array(rows)
    return RigCovariance(names=tuple(names), matrix=turn @ matrix @ turn.T)


def _apart(devices: Sequence[Device]) -> float:
    return float(np.linalg.norm(devices[1].center_world - devices[0].center_world))
