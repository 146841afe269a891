"""What ``fringe3d calibrate FOLDER`` leaves besides the rig file: figures in words and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.calibrate import (
    BoardCalibration,
    PoseLeftOut,
    bad_poses,
    focal_sigma_by_poses,
    form_covariance,
    point_covariance,
)
from fringe3d.geometry import depth_interval, project
from fringe3d.health import Finding
from fringe3d.model import Device, Rig
from fringe3d.model.covariance import LENS_NUMBERS
from fringe3d.report.board_regions import regions_of

Floats = NDArray[np.float64]

GRID = (21, 16)
"""Places across the image of the first camera at which the volume is looked at."""

LAYERS = (0.2, 0.5, 0.8)
"""Parts of the volume's depth range at which it is looked at."""

LEAST_POINTS = 4
"""A motion and a scale take seven numbers."""


def volume_grid(rig: Rig, /) -> tuple[Floats, Floats]:
    """Return points in the measuring volume along rays of the first camera.

    Returns
    -------
    (n_depths, rows, cols, 3), mm, world frame; (n_depths,), mm
        NaN outside the volume, and where a device does not see the point.
    """
    assert rig.volume is not None
    first = rig.cameras[0]
    x = np.linspace(0, first.n_cols - 1, GRID[0])
    y = np.linspace(0, first.n_rows - 1, GRID[1])
    flat = (np.stack(np.meshgrid(x, y), axis=-1) - first.center_px) / first.focal_px
    rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1)
    world_from_first = first.device_from_world.inverse()
    near, far = depth_interval(
        world_from_first.translation, rays @ world_from_first.rotation.T, rig.volume
    )
    hit = near < far
    low, high = (near[hit].min(), far[hit].max()) if hit.any() else (np.nan, np.nan)
    depths = low + np.array(LAYERS) * (high - low)
    points = world_from_first.apply(depths[:, None, None, None] * rays)
    kept = rig.volume.contains(points)
    for device in rig.devices:
        pixels = project(device, points)
        beyond = np.array([device.n_cols, device.n_rows]) - 0.5
        kept &= np.asarray(((pixels >= -0.5) & (pixels <= beyond)).all(axis=-1))
    return np.where(kept[..., None], points, np.nan), depths


def volume_sigma(calibration: BoardCalibration, points: Floats, /) -> tuple[Floats, Floats]:
    """Return how uncertain points are through the calibration, each (...), mm.

    Returns
    -------
    place, form : (...) float, mm
        Standard deviation of the distance from where a point is, and of that without what a motion
        and a scale of all points undo; NaN where a point is NaN or only one device measures.
    """
    place, form = np.full(points.shape[:-1], np.nan), np.full(points.shape[:-1], np.nan)
    seen = np.isfinite(points).all(axis=-1)
    if len(calibration.devices) < 2 or seen.sum() < LEAST_POINTS:
        return place, form
    for result, of in ((place, point_covariance), (form, form_covariance)):
        covariance = of(
            calibration.devices, calibration.covariance, points[seen], noise_px=calibration.noise_px
        )
        result[seen] = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0))
    return place, form


def board_record(
    calibration: BoardCalibration,
    left_out: Sequence[PoseLeftOut],
    findings: Sequence[Finding],
    rig: Rig,
    depth_mm: tuple[float, float],
    /,
) -> dict[str, Any]:
    """Return the figures of a calibration as plain data."""
    points, depths = volume_grid(rig)
    places, forms = volume_sigma(calibration, points)
    by_poses = focal_sigma_by_poses(calibration, left_out)
    volume = [
        {"depth": float(depth),
         "sigma_median": float(np.nanmedian(place)), "sigma_largest": float(np.nanmax(place)),
         "form_sigma_median": float(np.nanmedian(form)),
         "form_sigma_largest": float(np.nanmax(form))}
        for depth, place, form in zip(depths, places, forms, strict=True)
        if np.isfinite(place).any()
    ]  # fmt: skip
    bad = {b.pose for b in bad_poses(calibration)}
    board = calibration.board
    return {
        "board": {"text": board.text, "kind": board.kind, "size": [board.n_cols, board.n_rows],
                  "pitch_mm": board.pitch_mm, "has_scale": board.has_scale,
                  "shape": calibration.shape,
                  "bend": float(np.ptp(calibration.shape_mm[:, 2]))},
        "devices": [
            _device_record(calibration, d, by_poses[d.name], bad) for d in calibration.devices
        ],
        "poses": _pose_records(calibration, left_out),
        "bad_poses": sorted(bad),
        "views_left_out": list(calibration.left_out),
        "shapes_tried": [{"shape": t.shape, "gain": t.gain} for t in calibration.shape_trials],
        "condition": calibration.condition,
        "known_least": [list(part) for part in calibration.weakest],
        "volume": volume,
        "depth": list(depth_mm),
        "unit": "mm" if board.has_scale else "pitch",
        "health": [
            {"level": f.level, "name": f.name, "value": f.value, "text": f.text} for f in findings
        ],
    }  # fmt: skip


def _device_record(
    calibration: BoardCalibration, device: Device, focal_by_poses: float, bad: set[str]
) -> dict[str, Any]:
    name = device.name
    own = [v for v in calibration.views if v.device == name]
    regions = regions_of(calibration, device)
    return {
        "name": name,
        "role": device.role,
        "size": [device.n_cols, device.n_rows],
        "poses": len({v.pose for v in own}),
        "corners": sum(map(len, own)),
        "rms_px": calibration.rms_px(name),
        "rms_of_good_poses_px": calibration.rms_px(name, without=bad),
        "noise_px": calibration.noise_px[name],
        "lens": calibration.lenses[name],
        "lenses_tried": [
            {"lens": t.lens, "lacking": t.lacking} for t in calibration.trials.get(name, ())
        ],
        "coverage": regions.coverage,
        "regions": {
            "corners": regions.n_corners.tolist(),
            "rms_px": _or_none(regions.rms_px.tolist()),
            "shared_px": _or_none(regions.shared_px.tolist()),
        },
        "focal_sigma_by_poses_px": focal_by_poses,
        "numbers": _numbers(calibration, device),
    }


def _or_none(values: Any) -> Any:
    """Return nested lists with None where nothing is known."""
    if isinstance(values, list):
        return [_or_none(value) for value in values]
    return values if np.isfinite(values) else None


def _numbers(calibration: BoardCalibration, device: Device) -> list[dict[str, Any]]:
    """Return name, value, sigma and origin of each number of a device."""
    covariance, name = calibration.covariance, device.name
    is_known = calibration.lenses[name] == "known"
    values = [*device.focal_px, *device.center_px, *device.distortion[:8]]
    rows = []
    for key, value in zip(LENS_NUMBERS, values, strict=True):
        is_free = f"{name}.{key}" in covariance.names
        if is_free or value != 0 or key in ("fx", "fy", "cx", "cy"):
            held = "data" if is_free else "given" if is_known else "fixed"
            rows.append(_row(key, value, covariance.sigma(f"{name}.{key}"), held))
    pose = device.device_from_world
    vector = np.degrees(Rotation.from_matrix(pose.rotation).as_rotvec())
    is_reference = f"{name}.turn_x" not in covariance.names
    held = "reference" if is_reference else "data"
    for axis, value in zip("xyz", vector, strict=True):
        sigma = np.degrees(covariance.sigma(f"{name}.turn_{axis}"))
        rows.append(_row(f"rotation_{axis}_deg", value, sigma, held))
    sigmas = _translation_sigma(calibration, device)
    unit = "mm" if calibration.board.has_scale else "pitch"
    for axis, value, sigma in zip("xyz", pose.translation, sigmas, strict=True):
        rows.append(_row(f"translation_{axis}_{unit}", value, sigma, held))
    return rows


def _row(name: str, value: float, sigma: float, held_by: str) -> dict[str, Any]:
    return {"name": name, "value": float(value), "sigma": float(sigma), "held_by": held_by}


def _translation_sigma(calibration: BoardCalibration, device: Device) -> Floats:
    """Return the standard deviation of the translation: a turn of the device moves it, too."""
    names = [f"{device.name}.{k}_{a}" for k in ("turn", "shift") for a in "xyz"]
    covariance = calibration.covariance
    if names[0] not in covariance.names:
        return np.zeros(3)
    places = [covariance.names.index(name) for name in names]
    x, y, z = device.device_from_world.translation
    slope = np.hstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
    part = slope @ covariance.matrix[np.ix_(places, places)] @ slope.T
    return np.asarray(np.sqrt(np.maximum(np.diagonal(part), 0)))


def _pose_records(
    calibration: BoardCalibration, left_out: Sequence[PoseLeftOut]
) -> list[dict[str, Any]]:
    without = {p.pose: p for p in left_out}
    records = []
    first = calibration.devices[0].device_from_world
    for pose, world_from_board in calibration.world_from_board.items():
        normal = (first @ world_from_board).rotation[:, 2]
        record: dict[str, Any] = {
            "pose": pose,
            "tilt_deg": float(np.degrees(np.arccos(np.clip(abs(normal[2]), 0, 1)))),
            "corners": sum(len(v) for v in calibration.views if v.pose == pose),
            "rms_px": {},
            "held_out_rms_px": {},
        }
        for device in calibration.devices:
            value = calibration.rms_px(device.name, pose=pose)
            if np.isfinite(value):
                record["rms_px"][device.name] = value
        if pose in without:
            record["held_out_rms_px"] = without[pose].rms_px
        records.append(record)
    return records


def board_text(record: dict[str, Any], /) -> str:
    """Return the figures of a calibration in words, for the terminal and the report."""
    corners = sum(device["corners"] for device in record["devices"])
    n = len(record["poses"])
    lines = [
        f"{record['board']['text']}: {n} poses, {len(record['devices'])} devices, "
        f"{corners:,} corners",
        *(f"{f['level']}: {f['text']}" for f in record["health"] if f["level"] == "ok"),
        *_volume_lines(record),
        *_comparison_lines(record),
        "",
        *_device_lines(record),
        "",
        *_pose_lines(record),
        *(f"not used: {text}" for text in record["views_left_out"]),
    ]
    for device in record["devices"]:
        lines += ["", f"{device['name']:<22}{'value':>12}{'sigma':>10}  held by"]
        for number in device["numbers"]:
            digits = 5 if abs(number["value"]) < 1 else 3
            sigma = f"{number['sigma']:.2g}" if number["held_by"] == "data" else "-"
            lines.append(
                f"{number['name']:<22}{number['value']:>12.{digits}f}{sigma:>10}  "
                f"{number['held_by']}"
            )
    return "\n".join(lines)


def _volume_lines(record: dict[str, Any]) -> list[str]:
    if not record["volume"]:
        return []
    parts = [
        f"{v['sigma_median']:.2g} at {v['depth']:.4g} (at most {v['sigma_largest']:.2g})"
        for v in record["volume"]
    ]
    forms = [
        f"{v['form_sigma_median']:.2g} (at most {v['form_sigma_largest']:.2g})"
        for v in record["volume"]
    ]
    return [
        f"points in the measuring volume, sigma from the calibration, {record['unit']}: "
        f"{'; '.join(parts)}; of their form, without a motion and a scale of all: "
        f"{'; '.join(forms)}"
    ]


def _comparison_lines(record: dict[str, Any]) -> list[str]:
    found = record.get("comparison")
    return [found["text"]] if found else []


def _device_lines(record: dict[str, Any]) -> list[str]:
    has_bad = bool(record["bad_poses"])
    without = f"{'of good poses':>15}" if has_bad else ""
    lines = [
        f"{'device':<14}{'poses':>6}{'corners':>9}{'rms, px':>9}{without}{'noise, px':>11}"
        f"{'coverage':>10}  lens"
    ]
    for d in record["devices"]:
        without = f"{d['rms_of_good_poses_px']:>15.3f}" if has_bad else ""
        lines.append(
            f"{d['name']:<14}{d['poses']:>6}{d['corners']:>9,}{d['rms_px']:>9.3f}{without}"
            f"{d['noise_px']:>11.3f}{d['coverage']:>10.0%}  {d['lens']}"
        )
    return lines


def _pose_lines(record: dict[str, Any]) -> list[str]:
    names = [device["name"] for device in record["devices"]]
    width = max(14, 2 + max(len(p["pose"]) for p in record["poses"]))
    head = "".join(f"{name[:12]:>13}" for name in names)
    lines = [
        f"{'rms and, where left out, px':<{width + 9}}",
        f"{'pose':<{width}}{'tilt':>5}{'corners':>9}{head}" + (f"{'left out:':>11}{head}"),
    ]
    for pose in record["poses"]:
        rms = "".join(_cell(pose["rms_px"].get(name)) for name in names)
        held = "".join(_cell(pose["held_out_rms_px"].get(name)) for name in names)
        lines.append(
            f"{pose['pose']:<{width}}{pose['tilt_deg']:>5.0f}{pose['corners']:>9,}{rms}"
            f"{'':>11}{held}"
        )
    return lines


def _cell(value: float | None) -> str:
    return f"{'-':>13}" if value is None else f"{value:>13.3f}"


def board_markdown(record: dict[str, Any], /, *, command: str, pictures: Sequence[str]) -> str:
    """Return the report of a calibration."""
    warnings = [f["text"] for f in record["health"] if f["level"] != "ok"]
    shown = "".join(f"- **Warning**: {text}\n" for text in warnings)
    return (
        f"# Calibration by a board\n\n```\n{command}\n```\n\n{shown}\n"
        f"```\n{board_text(record)}\n```\n\n"
        + "".join(f"![{picture}]({picture})\n\n" for picture in pictures)
        + "Residual: where the calibration expects a corner, minus where it was found, px of the "
        "device. Rms: of the distance of corners; noise: standard deviation of one coordinate, "
        "robust. Left out: the same for a pose to which the calibration was not fitted, but for "
        "the place of the board. Sigma: from the noise of single corners; what corners of one pose "
        "share shows in the focal lengths by leaving poses out. Coverage: part of a grid of 8 x 6 "
        "over the image in which corners lie; the second column of pictures shows it, with the "
        "number of corners, their rms and, as an arrow, the residual that they share. Form: what "
        "a motion and a scale of all points do not undo. Rotation and translation: of "
        "device_from_world, as a rotation vector; its sigma is a turn about the device's axis. "
        "Lens: the simplest whose missing terms could as well be zero.\n"
    )
