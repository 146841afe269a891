"""Which device of a rig has moved since the calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.calibrate._pose_problem import (
    PoseProblem,
    State,
    contradiction_px,
    crowding_of,
    problem_of_points,
)
from fringe3d.calibrate._poses import N_POSE, loss_of, noise_of, pose_change
from fringe3d.calibrate._projecting import skew
from fringe3d.calibrate.homologous import Homologous
from fringe3d.errors import EmptyResultError
from fringe3d.model import Device

Floats = NDArray[np.float64]

EXPLAINED = 0.9
"""Of what all poses together explain; a single device must explain so much to be named."""

UNEXPLAINED_RATIO = 5.0
"""What another device leaves open over what the named one does; several that moved may look nearly
as one that did not."""

STILL_LEFT = 0.5
"""Part of the contradictions: if no poses undo as much, poses are not what is wrong."""

SIGNIFICANT = 20.0
"""By which the loss, in squared sigmas, of another device must be larger."""


@dataclass(frozen=True, slots=True)
class Mover:
    """A device, as the only one that moved.

    Parameters
    ----------
    device : str
    explained : float; part of the contradictions that go, of those that any poses undo
    loss : float; what stays, squared sigmas
    turn_deg, shift_mm : float; how far it would have moved
    """

    device: str
    explained: float
    loss: float
    turn_deg: float
    shift_mm: float


@dataclass(frozen=True, slots=True)
class Moved:
    """What contradictions say of the devices.

    Parameters
    ----------
    residual_px, left_px : float, projector px
        Median of the contradictions with the calibration, and with the best poses of all devices.
    loss : float; what stays with the best poses of all devices, squared sigmas
    movers : tuple of Mover; the likeliest first
    is_free : bool
        Whether the points were found without the poses. If they were searched on epipolar curves,
        a device that moved moved them, too, and another may seem to be it.
    """

    residual_px: float
    left_px: float
    loss: float
    movers: tuple[Mover, ...]
    is_free: bool = True

    @property
    def is_of_poses(self) -> bool:
        """Tell whether other poses undo most of the contradictions."""
        return self.left_px <= STILL_LEFT * self.residual_px

    @property
    def device(self) -> str | None:
        """Return the name of the device that moved; None where several would explain it, or none.

        With one camera only the projector moves relative to it: that tells nothing.
        """
        if len(self.movers) < 3 or not self.is_free:
            return None
        first, second = self.movers[:2]
        open1, open2 = first.loss - self.loss, second.loss - self.loss
        is_alone = open2 > UNEXPLAINED_RATIO * open1 and open2 - open1 > SIGNIFICANT
        return first.device if first.explained > EXPLAINED and is_alone else None


def contradiction(scans: Sequence[Homologous], devices: Sequence[Device], /) -> float:
    """Return the median by which homologous points contradict the calibration, projector px.

    Raises
    ------
    EmptyResultError
        If no points lie in front of the devices, or none can contradict them.
    """
    value = contradiction_px(*problem_of_points(scans, devices))
    if np.isnan(value):
        raise EmptyResultError("expected points that tell more than their depth, found none")
    return value


def which_moved(scans: Sequence[Homologous], devices: Sequence[Device], /) -> Moved:
    """Let each device alone move, and compare how well that explains the contradictions.

    Parameters
    ----------
    scans : sequence of Homologous; of the same rig
    devices : sequence of Device; C1, further cameras, then the projector, as calibrated

    Returns
    -------
    Moved

    Raises
    ------
    EmptyResultError
        If no points lie in front of the devices, or three devices see none.

    Notes
    -----
    The loss of `fit_poses`. That C1 moved means that all others moved the other way together.
    """
    problem, before = problem_of_points(scans, devices)
    if not sum(int(n.freedom.sum()) for n in problem.normals(before, 1.0)) > 0:
        raise EmptyResultError("expected points that three devices see, found none")
    noise, crowding = noise_of(problem.normals(before, 1.0), 1.0), 1.0
    after = before
    for _ in range(2):
        after = problem.solve(after, noise, crowding)
        noise = noise_of(problem.normals(after, noise), noise)
        crowding = crowding_of(problem, after, noise)
    least = loss_of(problem.normals(after, noise))
    most = loss_of(problem.normals(before, noise))
    movers = [
        _mover(problem, before, number, noise, crowding, (least, most))
        for number in range(len(devices))
    ]
    return Moved(
        residual_px=contradiction_px(problem, before),
        left_px=contradiction_px(problem, after),
        loss=least / crowding,
        movers=tuple(sorted(movers, key=lambda m: m.loss)),
    )


def _mover(
    problem: PoseProblem,
    before: State,
    number: int,
    noise: float,
    crowding: float,
    bounds: tuple[float, float],
) -> Mover:
    free: Callable[[Sequence[Device]], Floats] = partial(_directions, number)
    after = problem.solve(before, noise, crowding, free=free)
    loss = loss_of(problem.normals(after, noise))
    least, most = bounds
    moved, still = after.devices[number], before.devices[number]
    change = pose_change(moved, still)
    if number == 0:  # seen from the others, which moved together
        motion = before.devices[1].device_from_world.inverse() @ after.devices[1].device_from_world
        own = still.device_from_world @ motion.inverse() @ still.device_from_world.inverse()
        turn = Rotation.from_matrix(own.rotation).as_rotvec()
        change = np.r_[turn, own.translation]
    return Mover(
        device=still.name,
        explained=1 - (loss - least) / max(most - least, 1e-12),
        loss=loss / crowding,
        turn_deg=float(np.degrees(np.linalg.norm(change[:3]))),
        shift_mm=float(np.linalg.norm(change[3:])),
    )


def moved_text(moved: Moved, /) -> str:
    """Say which device moved, or that it is not determined."""
    movers = {mover.device: mover for mover in moved.movers}
    name = moved.device
    undone = f"{moved.residual_px:.2f} px, of which other poses leave {moved.left_px:.2f} px"
    if name is not None:
        found = movers[name]
        return (
            f"device '{name}' has moved since the calibration: turned by {found.turn_deg:.3f} deg "
            f"and shifted by {found.shift_mm:.2f} mm it explains {found.explained:.1%} of what "
            f"devices contradict each other by ({undone}; next likely: "
            f"'{moved.movers[1].device}', {moved.movers[1].explained:.1%})"
        )
    if not moved.is_of_poses:
        return (
            f"no poses bring the devices together (contradictions of {undone}): lenses have "
            "changed, or the rig is another one"
        )
    why = "" if moved.is_free else " by fringes of one direction"
    each = ", ".join(f"'{mover.device}' alone {mover.explained:.1%}" for mover in moved.movers)
    return (
        f"devices have moved since the calibration; which is not determined{why} (contradictions "
        f"of {undone}; explained by {each})"
    )


def _directions(number: int, devices: Sequence[Device]) -> Floats:
    """Return the directions (p, 6) in which poses move with one device alone."""
    found = np.zeros((N_POSE * (len(devices) - 1), N_POSE))
    if number > 0:
        found[N_POSE * (number - 1) : N_POSE * number] = np.eye(N_POSE)
        return found
    for place, device in enumerate(devices[1:]):
        rows = found[N_POSE * place : N_POSE * (place + 1)]
        pose = device.device_from_world
        rotation, translation = pose.rotation, pose.translation
        # A motion X + w x X + v of the world turns by R w, and shifts by R v - (R w) x T.
        rows[:3, :3], rows[3:, 3:] = rotation, rotation
        rows[3:, :3] = skew(translation[None])[0] @ rotation
    return found
