"""``fringe3d calibrate FOLDER``: cameras and projector from recordings of a board."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.cli.board_recordings import SeriesOptions, require_fit, seen_in_series
from fringe3d.cli.calibrating import LENS_NAMES, calibrate
from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json
from fringe3d.cli.scan_options import tell
from fringe3d.errors import CalibrationError, MethodError
from fringe3d.model import MeasuringVolume, Rig, RigidTransform

if TYPE_CHECKING:
    from fringe3d.calibrate import BoardCalibration, RigComparison
    from fringe3d.health import Finding

Floats = NDArray[np.float64]

BOARD_LENS_NAMES = LENS_NAMES | {"rational": "rational"}

DEPTH_MARGIN = 0.1
"""Of the depth range of the boards, that the measuring volume has besides."""


@calibrate.default
def board_series(folder: Path, /, *, options: SeriesOptions, as_json: Json = False) -> None:
    """Calibrate cameras and projector from recordings of a board in several poses.

    Leaves the rig with its covariance in OUT, and NAME-board.md, NAME-board.png and
    NAME-volume.png beside it: figures, residuals, and what it is worth in the volume.
    Example: fringe3d calibrate poses --board chessboard:9x7:20mm --out rig.toml

    Parameters
    ----------
    folder
        Folder with one scan folder for each pose: fringes or Gray code in both directions. With
        --camera, folder of plain images.
    """
    tell(lambda reporter: calibrate_series(folder, options, reporter), options.out,
         as_json=as_json)  # fmt: skip


def calibrate_series(
    folder: Path, options: SeriesOptions, reporter: Reporter, /
) -> tuple[str, dict[str, Any]]:
    """Find the board in all scans, calibrate, judge and write.

    Returns
    -------
    str, dict
        What to print, and the same as plain data.

    Raises
    ------
    Fringe3DError
        If recordings or options do not suffice, or nothing can be written.
    """
    from fringe3d.calibrate import (
        BOARD_LENSES,
        SHAPES,
        BoardOptions,
        RigComparison,
        calibrate_board,
        check_board,
        leave_poses_out,
    )
    from fringe3d.health import Finding
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.boardfile import read_board
    from fringe3d.io.rigfile import read_rig, rig_text
    from fringe3d.report.board import board_markdown, board_record, board_text, volume_grid
    from fringe3d.report.board_pictures import board_targets, draw_board
    from fringe3d.report.comparison import comparison_record
    from fringe3d.report.volume_pictures import draw_comparison, draw_volume

    former = read_rig(options.rig) if options.rig else None
    targets = board_targets(options.out, is_compared=former is not None)
    for target in reversed(targets):
        require_writable(target, overwrite=options.overwrite, inputs=[folder])
    board = read_board(options.board)
    views, devices = seen_in_series(folder, options, former, reporter)
    reporter.stage("calibrating", of=3)
    lens_name = BOARD_LENS_NAMES.get(options.distortion)
    wanted = BoardOptions(
        lens=next((lens for lens in BOARD_LENSES if lens == lens_name), None),
        shape=next((shape for shape in SHAPES if shape == options.board_shape), None),
    )
    found = calibrate_board(board, views, devices, wanted)
    require_fit(found, folder, options)
    reporter.stage("leaving poses out", of=3)
    left_out = leave_poses_out(found)
    findings = check_board(found, left_out)
    found = found.in_world(_first_from_world(options, former, found))
    depth_mm = options.depth_mm or _depth_range(found)
    calibrated = _rig(folder, options, former, found, depth_mm)
    points, depths = volume_grid(calibrated)
    compared = _compared(options, former, calibrated, points) if former is not None else None
    if isinstance(compared, Finding):
        findings.append(compared)
    record = board_record(found, left_out, findings, calibrated, depth_mm)
    pictures = list(targets[:2])
    if isinstance(compared, RigComparison):
        record["comparison"] = comparison_record(compared, unit=record["unit"])
        pictures.append(targets[2])
        draw_comparison(targets[2], compared, calibrated.cameras[0], depths, unit=record["unit"],
                        overwrite=options.overwrite)  # fmt: skip
    reporter.stage("writing", of=3)
    draw_board(targets[0], found, record, overwrite=options.overwrite)
    draw_volume(targets[1], found, points, depths, overwrite=options.overwrite)
    command = shlex.join(["fringe3d", *sys.argv[1:]])
    report = board_markdown(record, command=command, pictures=[p.name for p in pictures])
    write_text(targets[-2], report, overwrite=options.overwrite)
    write_text(options.out, rig_text(calibrated), overwrite=options.overwrite)
    return board_text(record), record | {"out": str(options.out)}


def _compared(
    options: SeriesOptions, former: Rig, now: Rig, points: Floats
) -> RigComparison | Finding:
    """Compare with the former rig; where it has not the same devices, a warning."""
    from fringe3d.calibrate import compare_rigs
    from fringe3d.health import Finding

    try:
        return compare_rigs(former, now, points)
    except CalibrationError as problem:
        text = f"not compared with {options.rig}: {str(problem).removeprefix('compare: ')}"
        return Finding("warning", "not_compared", 0.0, text)


def _first_from_world(
    options: SeriesOptions, former: Rig | None, found: BoardCalibration
) -> RigidTransform:
    """Return the pose of C1 in the world that the user wants."""
    if options.world is not None:
        if options.world not in found.world_from_board:
            raise MethodError(
                f"--world: expected the name of a pose ({', '.join(found.world_from_board)}), "
                f"found '{options.world}'"
            )
        return found.world_from_board[options.world]
    if former is not None:
        return former.cameras[0].device_from_world
    return RigidTransform.identity()


def _depth_range(found: BoardCalibration) -> tuple[float, float]:
    """Return the depths, along C1's principal ray, that the boards span, with a margin."""
    first = found.devices[0].device_from_world
    points = found.board.points_mm + found.shape_mm
    z = np.concatenate(
        [(first @ pose).apply(points)[:, 2] for pose in found.world_from_board.values()]
    )
    low, high = float(z.min()), float(z.max())
    margin = DEPTH_MARGIN * (high - low)
    return max(low - margin, low / 2), high + margin


def _rig(
    folder: Path,
    options: SeriesOptions,
    former: Rig | None,
    found: BoardCalibration,
    depth_mm: tuple[float, float],
) -> Rig:
    cameras = tuple(d for d in found.devices if d.role == "camera")
    volume = former.volume if former is not None and options.depth_mm is None else None
    if volume is None:
        volume = MeasuringVolume.depth_slab(
            cameras[0], depth_min_mm=depth_mm[0], depth_max_mm=depth_mm[1]
        )
    rms = ", ".join(f"{d.name} {found.rms_px(d.name):.3f}" for d in found.devices)
    unit = "" if found.board.has_scale else "; lengths in pitches of the board, not mm"
    return Rig(
        cameras=cameras,
        projector=next((d for d in found.devices if d.role == "projector"), None),
        volume=volume,
        provenance=(
            f"{folder.name}: {found.board.text}, {len(found.world_from_board)} poses "
            f"(fringe3d calibrate: rms {rms} px{unit})"
        ),
        covariance=found.covariance,
    )
