"""The result folder of a measurement."""

from __future__ import annotations

import hashlib
import math
import platform
import textwrap
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d import __version__
from fringe3d.health import Finding, axis_name
from fringe3d.io.atomic import new_folder
from fringe3d.io.results import toml_document, toml_plain, write_ply, write_points
from fringe3d.io.rigfile import rig_text
from fringe3d.io.stored import StoredResult
from fringe3d.model import NO_ORDER, Scan
from fringe3d.model.rejection import count_by_reason
from fringe3d.pipeline import Measurement, MeasureOptions, point_cloud
from fringe3d.report.overview import write_overview
from fringe3d.report.point_sigma import calibration_sigma_mm
from fringe3d.report.saturation import saturated_images
from fringe3d.report.self_calibration import self_calibration_record
from fringe3d.self_calibration import SelfCalibrated

TITLE_COLUMNS = 175
CALIBRATION_SIGMA = "sigma_calibration_mm"


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What was asked for, as the user wrote it: enough to ask again.

    Parameters
    ----------
    command : str; the command line
    scan : Path; scan folder or scan file
    images, rig, response, noise : Path or None; None where the scan file names them
    previous : Path or None; result of the frame before
    """

    command: str
    scan: Path
    images: Path | None = None
    rig: Path | None = None
    response: Path | None = None
    noise: Path | None = None
    previous: Path | None = None


def write_result(
    out: Path,
    scan: Scan,
    options: MeasureOptions,
    result: Measurement,
    /,
    *,
    request: Request | None = None,
    own_poses: SelfCalibrated | None = None,
    overwrite: bool = False,
) -> None:
    """Write everything that a measurement leaves, completely or not at all.

    ``points.npz`` and ``cloud.ply`` (``phase.npz`` without a rig), ``overview.png`` and
    ``measure.toml``, which repeats the request if there is one; ``rig.toml``, with which it was
    measured: with the poses that the scan itself showed, if it was asked.
    """
    with new_folder(out, overwrite=overwrite) as folder:
        if result.points is None:
            write_points(folder / "phase.npz", phase_maps(result))
        else:
            center = _camera_center(scan, result)
            doubt = calibration_sigma_mm(scan, result)
            more = {} if doubt is None else {CALIBRATION_SIGMA: doubt}
            maps = point_maps(result) | _light_maps(scan, result)
            write_points(folder / "points.npz", maps, camera_center_mm=center, **more)
            columns = {name: sigma[result.points.is_valid] for name, sigma in more.items()}
            write_ply(folder / "cloud.ply", point_cloud(result), viewpoint_mm=center,
                      comment=f"fringe3d {__version__}, mm", **columns)  # fmt: skip
        write_overview(folder / "overview.png", result, title=_title(scan, result))
        record = measure_record(scan, options, result, request=request, own_poses=own_poses)
        if scan.rig is not None:
            (folder / "rig.toml").write_text(rig_text(scan.rig), encoding="utf-8")
        (folder / "measure.toml").write_text(toml_document(record), encoding="utf-8")


def stored_result(scan: Scan, options: MeasureOptions, result: Measurement, /) -> StoredResult:
    """Return a result with points as it would be read back, without writing it."""
    maps = point_maps(result) | _light_maps(scan, result)
    record = toml_plain(measure_record(scan, options, result))
    return StoredResult(folder=Path("result"), record=record, maps=maps, rig=scan.rig)


def _light_maps(scan: Scan, result: Measurement) -> dict[str, NDArray[Any]]:
    """Return where fringe images are saturated, and from which of several exposures C1's pixels
    come."""
    stack = next(s for s in scan.stacks if s.device_name == result.main.device_name)
    maps: dict[str, NDArray[Any]] = {"saturated_images": saturated_images(stack)}
    return maps if stack.fused is None else maps | {"exposure": stack.fused.exposure}


def point_maps(result: Measurement, /) -> dict[str, NDArray[Any]]:
    """Return the maps of ``points.npz``, on the grid of C1."""
    assert result.points is not None
    assert result.matches is not None
    main, points, matches = result.main, result.points, result.matches
    good = points.is_valid
    turns = np.where(matches.fringe_order == NO_ORDER, np.nan, matches.fringe_order)
    on_camera = result.method != "projector"
    probability = matches.order_probability
    assert probability is not None
    maps: dict[str, NDArray[Any]] = {
        "points_mm": points.points_mm,
        "sigma_mm": points.sigma_mm,
        "absolute_phase": np.where(good, main.phase + 2 * np.pi * turns, np.nan),
        "fringe_order": np.where(good, matches.fringe_order, NO_ORDER),
        "order_probability": np.where(good, probability, np.nan).astype(np.float32),
        "pixels_c2" if on_camera else "projector_xy": np.where(
            good[..., None], matches.pixels, np.nan
        ),
        "skew_mm": points.skew_mm,
        "offset": main.offset,
        "modulation": main.modulation,
        "rejection": points.rejection,
    }
    if np.isfinite(matches.epipolar_residual_px).any():
        maps["epipolar_residual_px"] = matches.epipolar_residual_px
    return maps


def _camera_center(scan: Scan, result: Measurement) -> NDArray[np.float64]:
    """Return the centre of projection of C1 in the world frame, (3,) mm."""
    assert scan.rig is not None
    camera = next(c for c in scan.rig.cameras if c.name == result.main.device_name)
    return camera.center_world


def phase_maps(result: Measurement, /) -> dict[str, NDArray[Any]]:
    """Return the maps of ``phase.npz``: one set for each camera, direction and period."""
    maps: dict[str, NDArray[Any]] = {"rejection": result.rejection}
    for camera in result.phases:
        for direction in camera.directions:
            for phases in (direction.main, *direction.others):
                key = f"{camera.device_name}_{axis_name(phases.angle)}_{phases.period_px:g}px"
                maps[f"{key}_wrapped_phase"] = phases.phase
                maps[f"{key}_fringe_order"] = phases.order_class
                maps[f"{key}_phase_std"] = phases.phase_std
                maps[f"{key}_modulation"] = phases.modulation
                maps[f"{key}_offset"] = phases.offset
                maps[f"{key}_rejection"] = phases.rejection
                if phases.is_absolute:
                    maps[f"{key}_absolute_phase"] = phases.absolute_phase
    return maps


def summary(result: Measurement, /) -> str:
    """Return the result in one line, with units."""
    total = result.rejection.size
    if result.points is None:
        n_phases = int((result.rejection == 0).sum())
        return (
            f"phase maps only (no rig): {n_phases:,} of {total:,} pixels decoded, "
            f"{len(result.phases[0].directions)} direction(s)"
        )
    if not result.points.is_valid.any():
        return f"no points of {total:,} pixels by method {result.method}: all were rejected"
    depth = result.points.points_mm[..., 2][result.points.is_valid]
    sigma = float(np.median(result.points.sigma_mm[result.points.is_valid]))
    return (
        f"{result.points.n_points:,} points of {total:,} pixels by method {result.method}, "
        f"z {depth.min():.1f} to {depth.max():.1f} mm, median sigma {sigma * 1000:.1f} um"
    )


def measure_record(
    scan: Scan,
    options: MeasureOptions,
    result: Measurement,
    /,
    *,
    request: Request | None = None,
    own_poses: SelfCalibrated | None = None,
) -> dict[str, Any]:
    """Return what ``measure.toml`` says: everything needed to repeat and to judge the result."""
    used = {stack.device_name: stack for stack in scan.stacks}
    record: dict[str, Any] = {
        "summary": summary(result),
        "method": result.method,
        "why_this_method": result.why,
        "images_used": result.n_images,
        "title": scan.title,
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"fringe3d": __version__, "python": platform.python_version(),
                     "numpy": np.__version__},
        "options": {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(options).items()},
        "pixels": {"total": result.rejection.size, "accepted": int((result.rejection == 0).sum()),
                   "rejected": count_by_reason(result.rejection)},
        "health": [finding_record(finding) for finding in result.findings],
        "images": {name: {"count": len(stack.images), "sha256": _digest(stack.images)}
                   for name, stack in used.items()},
        "seconds": {name: round(value, 3) for name, value in result.seconds.items()},
        "decoding": [
            {"camera": camera.device_name, "direction": axis_name(direction.main.angle),
             "period_px": direction.main.period_px, "mended_by_one_cell": direction.main.n_mended,
             "median_phase_std": _median(direction.main.phase_std, direction.main.rejection)}
            for camera in result.phases for direction in camera.directions
        ],
    }  # fmt: skip
    if request is not None:
        paths = {
            "scan": request.scan,
            "images": request.images,
            "rig": request.rig,
            "response": request.response,
            "noise": request.noise,
            "previous": request.previous,
        }
        given = {name: str(path) for name, path in paths.items() if path is not None}
        record["request"] = {"command": request.command, **given}
    if scan.rig is not None:
        record["rig"] = {
            "provenance": scan.rig.provenance,
            "sha256": hashlib.sha256(rig_text(scan.rig).encode()).hexdigest(),
        }
    if scan.table is not None:
        angle = scan.table.angle
        record["table"] = {"angle_deg": None if angle is None else math.degrees(angle),
                           "tilt_deg": math.degrees(scan.table.tilt)}  # fmt: skip
    if own_poses is not None:
        record["self_calibration"] = self_calibration_record(own_poses)
    return record


def finding_record(finding: Finding, /) -> dict[str, Any]:
    """Return a finding as plain data."""
    record = asdict(finding)
    return record if finding.figures else {k: v for k, v in record.items() if k != "figures"}


def _digest(images: NDArray[Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(images).data).hexdigest()


def _median(values: NDArray[np.float32], rejection: NDArray[np.uint16]) -> float:
    good = values[rejection == 0]
    return float(np.median(good)) if good.size else float("nan")


def _title(scan: Scan, result: Measurement) -> str:
    lines = [scan.title or "fringe3d", summary(result)]
    lines += [f"{finding.level}: {finding.text}" for finding in result.warnings]
    return "\n".join(textwrap.fill(line, TITLE_COLUMNS, subsequent_indent="    ") for line in lines)
