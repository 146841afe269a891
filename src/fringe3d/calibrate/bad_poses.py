"""Poses of a board that do not fit the others, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.calibrate._adjusting import adjusted
from fringe3d.calibrate._board_folds import placed_only, with_poses
from fringe3d.calibrate._bundle import residuals
from fringe3d.calibrate.board import BoardCalibration

Floats = NDArray[np.float64]

BAD_POSE = 3.0
"""Times the typical rms of the other poses in the same device."""

LEAST_BAD_PX = 0.1
"""Corners good to a tenth of a pixel are not bad."""

FEW_BAD = 0.1
"""Part of the corners of a view; so few are single mistakes."""

MEDIAN_TO_RMS = 1.2011
"""Of the distance of normal noise in two coordinates."""


@dataclass(frozen=True, slots=True)
class BadPose:
    """A pose whose corners miss by far more than those of the others.

    Parameters
    ----------
    pose : str
    rms_px : dict of str to (float, float), px
        In each device in which it sticks out, the worst first: its rms, and the typical one of the
        other poses.
    """

    pose: str
    rms_px: dict[str, tuple[float, float]]

    @property
    def worst(self) -> str:
        """Return the device in which it sticks out most."""
        return next(iter(self.rms_px))


def bad_poses(calibration: BoardCalibration, /) -> tuple[BadPose, ...]:
    """Return the poses that stick out, each once."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    poses = list(calibration.world_from_board)
    for device in calibration.devices:
        rms = {pose: calibration.rms_px(device.name, pose=pose) for pose in poses}
        for pose, value in rms.items():
            others = [v for p, v in rms.items() if p != pose and np.isfinite(v)]
            typical = float(np.median(others)) if others else float("nan")
            if value > BAD_POSE * typical and value > LEAST_BAD_PX:
                found.setdefault(pose, {})[device.name] = (value, typical)
    return tuple(
        BadPose(pose, dict(sorted(own.items(), key=lambda item: -item[1][0] / item[1][1])))
        for pose, own in found.items()
    )


def why_bad(calibration: BoardCalibration, bad: BadPose, /) -> str:
    """Say what is wrong with a pose: single corners, a board elsewhere, or all corners."""
    name = bad.worst
    distance = np.concatenate([
        np.linalg.norm(r, axis=1)
        for r, v in zip(calibration.residual_px, calibration.views, strict=True)
        if (v.pose, v.device) == (bad.pose, name)
    ])  # fmt: skip
    limit = 4 * MEDIAN_TO_RMS * float(np.median(distance))
    n_far = int((distance > limit).sum())
    if 0 < n_far <= FEW_BAD * len(distance):
        return f"{n_far} of {len(distance)} corners are wrong (reflection, dirt, shadow)"
    apart = {device: _by_itself(calibration, bad.pose, device) for device in bad.rms_px}
    name = min(apart, key=lambda device: apart[device][0] / bad.rms_px[device][0])
    alone, turn_deg, shift = apart[name]
    if alone < bad.rms_px[name][0] / 2:
        unit = "mm" if calibration.board.has_scale else "pitches"
        return (
            f"by itself '{name}' sees a good board ({alone:.2f} px), but elsewhere than all "
            f"devices together ({shift:.2g} {unit} and {turn_deg:.2g} deg): it moved during the "
            "recording, or the images are of another pose"
        )
    return "all corners are off (blur, or images of another camera or board)"


def _by_itself(calibration: BoardCalibration, pose: str, device: str) -> tuple[float, float, float]:
    """Return the rms of a pose in one device where no other device holds the board; and by how far
    the board turns and shifts then: px, deg, mm."""
    names = [d.name for d in calibration.devices]
    number = list(calibration.world_from_board).index(pose)
    problem, at = with_poses(placed_only(calibration._problem), calibration._state, [number])
    own = [b for b in problem.batches if b.device == names.index(device)]
    problem = replace(problem, batches=own)
    after = adjusted(problem, at)
    found = residuals(problem, after)
    rms = float(np.sqrt(np.mean(np.concatenate([(r**2).sum(axis=1) for r in found]))))
    turn = Rotation.from_matrix(after.pose_rotation[0] @ at.pose_rotation[0].T).magnitude()
    middle = calibration.board.points_mm.mean(axis=0)
    places = [s.pose_rotation[0] @ middle + s.pose_shift[0] for s in (at, after)]
    return rms, float(np.degrees(turn)), float(np.linalg.norm(places[1] - places[0]))
