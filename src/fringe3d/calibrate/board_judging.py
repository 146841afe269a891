"""What to think of a calibration: poses left out, bad poses, warnings."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._board_folds import held_out, views_of
from fringe3d.calibrate._bundle import residuals
from fringe3d.calibrate.bad_poses import bad_poses, why_bad
from fringe3d.calibrate.board import BoardCalibration
from fringe3d.health import Finding

Floats = NDArray[np.float64]

POOR_FOCAL = 1e-3
"""Part of the focal length. Twelve poses in a narrow field (16 deg) reach 5e-4 to 7e-4, twenty
hardly less, and points then keep their form to 5e-5 of the volume; five 1.5e-3 to 2e-3."""

GOOD_POSES = 8


@dataclass(frozen=True, slots=True, eq=False)
class PoseLeftOut:
    """A calibration without one of its poses.

    Parameters
    ----------
    pose : str
    rms_px : dict of str to float, px; of that pose in each device, only its place being fitted
    focal_px : dict of str to (2,) float; focal lengths without it
    """

    pose: str
    rms_px: dict[str, float]
    focal_px: dict[str, Floats]


def leave_poses_out(calibration: BoardCalibration, /) -> tuple[PoseLeftOut, ...]:
    """Calibrate again without each pose in turn, and judge each by the others.

    Returns
    -------
    tuple of PoseLeftOut; none where there are too few poses to leave one out
    """
    problem, at = calibration._problem, calibration._state
    names = [device.name for device in calibration.devices]
    poses = list(calibration.world_from_board)
    found = []
    for number, pose in enumerate(poses):
        if len(poses) <= 3:
            break
        fitted, outside, judged = held_out(problem, at, [number])
        squares: dict[str, list[Floats]] = defaultdict(list)
        for view, r in zip(views_of(outside.batches), residuals(outside, judged), strict=True):
            squares[names[view.device]].append((r**2).sum(axis=1))
        rms = {n: float(np.sqrt(np.concatenate(s).mean())) for n, s in squares.items()}
        focal = {name: fitted.lens[k, :2] for k, name in enumerate(names)}
        found.append(PoseLeftOut(pose, rms, focal))
    return tuple(found)


def focal_sigma_by_poses(
    calibration: BoardCalibration, left_out: Sequence[PoseLeftOut], /
) -> dict[str, float]:
    """Return the standard deviation of each focal length as its changes by poses tell, px.

    The jackknife over poses: corners of one pose share errors (light, bend of the board, blur) that
    the noise of single corners does not show.
    """
    n = len(left_out)
    result = {}
    for device in calibration.devices:
        found = np.array([p.focal_px[device.name].mean() for p in left_out])
        spread = float(((found - found.mean()) ** 2).sum()) if n else float("nan")
        result[device.name] = float(np.sqrt((n - 1) / n * spread)) if n else float("nan")
    return result


def typical_rms_px(calibration: BoardCalibration, /) -> tuple[str, float]:
    """Return the device whose corners miss most in its typical pose, and by how much, px rms."""
    poses = list(calibration.world_from_board)
    typical = {
        device.name: float(np.nanmedian([calibration.rms_px(device.name, pose=p) for p in poses]))
        for device in calibration.devices
    }
    worst = max(typical, key=lambda name: typical[name])
    return worst, typical[worst]


def check_board(calibration: BoardCalibration, left_out: Sequence[PoseLeftOut], /) -> list[Finding]:
    """Judge a calibration."""
    return [
        *_check_poses(calibration),
        _check_focal(calibration, left_out),
        _check_open(calibration),
        *_check_shape(calibration),
        *_check_scale(calibration),
    ]


def _check_poses(calibration: BoardCalibration) -> list[Finding]:
    findings = []
    roles = {device.name: device.role for device in calibration.devices}
    for bad in bad_poses(calibration):
        value, typical = bad.rms_px[bad.worst]
        others = ", ".join(f"'{name}' {rms:.2f}" for name, (rms, _) in list(bad.rms_px.items())[1:])
        text = (
            f"pose {bad.pose}: {value:.2f} px rms in {roles[bad.worst]} '{bad.worst}', the other "
            f"poses {typical:.2f} px{f' (also {others} px)' if others else ''}: "
            f"{why_bad(calibration, bad)}. Leave it out (--leave-out {bad.pose}) or record it again"
        )
        findings.append(Finding("warning", "bad_pose_rms_px", value, text))
    findings += [
        Finding("warning", "mirrored_view", 1.0, f"pose {text}. Correct it; the pose is used "
                "without this view") for text in calibration.mirrored
    ]  # fmt: skip
    if not findings:
        worst = max(calibration.rms_px(v.device, pose=v.pose) for v in calibration.views)
        findings.append(Finding("ok", "bad_pose_rms_px", worst, "no pose sticks out"))
    return findings


def _check_focal(calibration: BoardCalibration, left_out: Sequence[PoseLeftOut]) -> Finding:
    by_poses = focal_sigma_by_poses(calibration, left_out)
    parts, worst = [], 0.0
    for device in calibration.devices:
        if calibration.lenses[device.name] == "known":
            continue
        focal = float(device.focal_px.mean())
        noise = calibration.covariance.sigma(f"{device.name}.fx")
        poses = by_poses[device.name]
        worst = max(worst, float(np.nanmax([noise, poses])) / focal)
        between = f", {poses:.1f} px by leaving poses out" if np.isfinite(poses) else ""
        parts.append(f"{device.name} {focal:.1f} px, sigma {noise:.1f} px by noise{between}")
    n = len(calibration.world_from_board)
    figures = "; ".join(parts)
    if worst > POOR_FOCAL:
        few = f"only {n} poses: " if n < GOOD_POSES else ""
        text = (
            f"{few}the focal lengths are determined poorly ({figures}). Take at least "
            f"{GOOD_POSES + 4} poses, tilted by 20 to 40 deg to all sides, all over the image and "
            "at several distances"
        )
        return Finding("warning", "focal_sigma_part", worst, text)
    return Finding("ok", "focal_sigma_part", worst, f"focal lengths: {figures}")


def _check_open(calibration: BoardCalibration) -> Finding:
    names = ", ".join(f"{name}" for name, _ in calibration.weakest[:3])
    if calibration.is_open:
        text = (
            f"the corners leave a combination of {names} open. Take poses with other tilts, or "
            "fewer distortion terms (--distortion)"
        )
        return Finding("warning", "condition", calibration.condition, text)
    text = f"condition {calibration.condition:.1e}; known least: {names} together"
    return Finding("ok", "condition", calibration.condition, text)


def _check_shape(calibration: BoardCalibration) -> list[Finding]:
    if calibration.shape == "flat":
        tried = [t for t in calibration.shape_trials if t.shape == "bent"]
        text = (
            "the board is flat as far as its poses can tell"
            if tried
            else "the board was taken as flat"
        )
        return [Finding("ok", "board_bend_mm", 0.0, text)]
    z = calibration.shape_mm[:, 2]
    sigma = calibration.shape_sigma_mm
    seen = sigma[:, 2] > 0
    bend = float(np.ptp(z[seen]))
    unit = "mm" if calibration.board.has_scale else "pitches"
    typical = float(np.median(sigma[seen, 2]))
    text = (
        f"the board is bent: its corners leave a plane by {bend:.3g} {unit} in all "
        f"(sigma {typical:.1g})"
    )
    if calibration.shape == "free":
        aside = float(np.linalg.norm(calibration.shape_mm[seen, :2], axis=1).max())
        text += f", and are printed up to {aside:.2g} {unit} beside their places"
    return [Finding("ok", "board_bend_mm", bend, f"{text}; this is counted in")]


def _check_scale(calibration: BoardCalibration) -> list[Finding]:
    if calibration.board.has_scale:
        return []
    text = (
        "the pitch of the board is unknown: lengths are in units of it, not in mm. Give it, as "
        "--board chessboard:9x7:20mm"
    )
    return [Finding("warning", "has_scale", 0.0, text)]
