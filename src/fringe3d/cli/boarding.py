"""``fringe3d calibrate FOLDER``: cameras and projector from recordings of a board."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray

from fringe3d.cli.calibrating import LENS_NAMES, calibrate
from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite
from fringe3d.errors import CalibrationError, Fringe3DError, MethodError, RigError
from fringe3d.model import Board, MeasuringVolume, Rig, RigidTransform, Scan

if TYPE_CHECKING:
    from fringe3d.board_scans import Found
    from fringe3d.calibrate import BoardCalibration, BoardView, DeviceSize, RigComparison

Floats = NDArray[np.float64]

BOARD_LENS_NAMES = LENS_NAMES | {"rational": "rational"}

DEPTH_MARGIN = 0.1
"""Of the depth range of the boards, that the measuring volume has besides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesOptions:
    """What the user said on the command line; see ``fringe3d calibrate --help``."""

    folder: Path
    board: Board
    out: Path
    scan: Path | None = None
    rig: Path | None = None
    keep_lenses: bool = False
    lens: str | None = None
    shape: str | None = None
    cameras_only: bool = False
    leave_out: tuple[str, ...] = ()
    world: str | None = None
    depth_mm: tuple[float, float] | None = None
    overwrite: bool = False


@calibrate.default
def board_series(
    folder: Path,
    /,
    *,
    board: str,
    out: Path,
    scan: Path | None = None,
    rig: Path | None = None,
    keep_lenses: Annotated[bool, Parameter(negative=())] = False,
    distortion: Literal["auto", "none", "k1", "k1-p", "k2-p", "k3-p", "rational"] = "auto",
    board_shape: Literal["auto", "flat", "bent", "free"] = "auto",
    cameras_only: Annotated[bool, Parameter(negative=())] = False,
    leave_out: Annotated[list[str] | None, Parameter(negative=())] = None,
    world: str | None = None,
    depth: str | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Calibrate cameras and projector from recordings of a board in several poses.

    Leaves the rig with its covariance in OUT, and NAME-board.md, NAME-board.png and
    NAME-volume.png beside it: figures, residuals, and what it is worth in the volume.
    Example: fringe3d calibrate poses --board chessboard:9x7:20mm --out rig.toml

    Parameters
    ----------
    folder
        Folder with one scan folder for each pose: fringes or Gray code in both directions.
    board
        chessboard:9x7:20mm (inner corners), charuco:11x8:15mm:11mm:DICT_4X4_50[:legacy] (squares),
        circles:9x7:20mm, asymmetric-circles:4x11:10mm, or a board.toml.
    out
        The rig file to write.
    scan
        Scan file that describes the images in each of the folders, where they have no scan.toml.
    rig
        Former rig: the world frame stays with its first camera, its volume is kept, and it is
        compared with the new one over the measuring volume (NAME-compared.png).
    keep_lenses
        Take the lenses from --rig as they are.
    distortion
        Terms of the lenses; auto takes as many for each device as the corners demand.
    board_shape
        bent lets corners leave the plane, free also lets them be printed unevenly; auto takes what
        fits poses best that were left out.
    cameras_only
        Do not calibrate the projector.
    leave_out
        Name of a pose not to use; repeat it for several.
    world
        Name of a pose: its board becomes the world frame.
    depth
        MIN:MAX, mm along the principal ray of C1: the measuring volume.
    """
    from fringe3d.io.boardfile import read_board
    from fringe3d.io.importing import parse_depth

    options = SeriesOptions(
        folder=folder,
        board=read_board(board),
        out=out,
        scan=scan,
        rig=rig,
        keep_lenses=keep_lenses,
        lens=BOARD_LENS_NAMES.get(distortion),
        shape=None if board_shape == "auto" else board_shape,
        cameras_only=cameras_only,
        leave_out=tuple(leave_out or ()),
        world=world,
        depth_mm=parse_depth(depth) if depth else None,
        overwrite=overwrite,
    )
    with Reporter(quiet=as_json).running() as reporter:
        text, record = calibrate_series(options, reporter)
    for finding in record["health"]:
        if finding["level"] != "ok":
            reporter.warn(finding["text"])
    say(f"{text}\n\n-> {out}", record, as_json=as_json)


def calibrate_series(options: SeriesOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
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
        calibrate_board,
        check_board,
        leave_poses_out,
    )
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.rigfile import read_rig, rig_text
    from fringe3d.report.board import board_markdown, board_record, board_text, volume_grid
    from fringe3d.report.board_pictures import board_targets, draw_board, draw_volume
    from fringe3d.report.comparison import comparison_record, draw_comparison

    former = read_rig(options.rig) if options.rig else None
    targets = board_targets(options.out, is_compared=former is not None)
    for target in reversed(targets):
        require_writable(target, overwrite=options.overwrite, inputs=[options.folder])
    views, devices = _seen(options, former, reporter)
    reporter.stage("calibrating", of=3)
    wanted = BoardOptions(
        lens=next((lens for lens in BOARD_LENSES if lens == options.lens), None),
        shape=next((shape for shape in SHAPES if shape == options.shape), None),
    )
    found = calibrate_board(options.board, views, devices, wanted)
    reporter.stage("leaving poses out", of=3)
    left_out = leave_poses_out(found)
    findings = check_board(found, left_out)
    found = found.in_world(_first_from_world(options, former, found))
    depth_mm = options.depth_mm or _depth_range(found)
    calibrated = _rig(options, former, found, depth_mm)
    record = board_record(found, left_out, findings, calibrated, depth_mm)
    points, depths = volume_grid(calibrated, depth_mm)
    pictures = list(targets[:2])
    if former is not None and (compared := _compared(former, calibrated, points)) is not None:
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


def _compared(former: Rig, now: Rig, points: Floats) -> RigComparison | None:
    """Compare with the former rig; None where it has not the same devices."""
    from fringe3d.calibrate import compare_rigs

    try:
        return compare_rigs(former, now, points)
    except CalibrationError:
        return None


def pose_folders(options: SeriesOptions, /) -> list[Path]:
    """Return the folders of the poses in the order of their numbers.

    Raises
    ------
    MethodError
        If there are none, or a pose to be left out is not among them.
    """
    folder = options.folder
    if not folder.is_dir():
        raise MethodError(
            f"{folder}: expected a folder with one scan folder for each pose of the board, found "
            f"{'a file' if folder.exists() else 'none'}. Check the path"
        )
    inside = [p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")]
    found = sorted(
        (p for p in inside if options.scan is not None or (p / "scan.toml").is_file()),
        key=lambda p: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", p.name)],
    )
    if not found:
        where = f"{len(inside)} folders without a scan.toml" if inside else "no folders"
        raise MethodError(
            f"{folder}: expected one scan folder for each pose of the board, found {where}. "
            "Describe the images that all have in common with --scan (fringe3d import writes it)"
        )
    unknown = set(options.leave_out) - {p.name for p in found}
    if unknown:
        raise MethodError(
            f"--leave-out: expected names of poses ({', '.join(p.name for p in found)}), found "
            f"{', '.join(sorted(unknown))}"
        )
    return [p for p in found if p.name not in options.leave_out]


def _seen(
    options: SeriesOptions, former: Rig | None, reporter: Reporter
) -> tuple[list[BoardView], list[DeviceSize]]:
    """Return what all devices see in all poses, and the devices."""
    from fringe3d.board_scans import views_of_scan
    from fringe3d.io.recording import read_scan

    folders = pose_folders(options)
    views: list[BoardView] = []
    devices: list[DeviceSize] = []
    for number, folder in enumerate(folders):
        reporter.step("finding the board", number, len(folders))
        scan = read_scan(
            options.scan or folder, images=folder if options.scan else None, with_rig=False
        )
        own = _devices(options, former, scan)
        devices = devices or own
        _require_same(folder, own, devices)
        corners = _corners(options.board, scan)
        name = next((d.name for d in devices if d.role == "projector"), None)
        try:
            views += views_of_scan(scan, options.board, corners, pose=folder.name, projector=name)
        except Fringe3DError as problem:
            raise type(problem)(f"{folder}: {problem}") from None
        if number == 0:
            first = scan
    reporter.step("finding the board", len(folders), len(folders))
    if not any(len(view) for view in views):
        raise CalibrationError(_not_found(options.board, first, len(folders)))
    return views, devices


def _devices(options: SeriesOptions, former: Rig | None, scan: Scan) -> list[DeviceSize]:
    from fringe3d.calibrate import DeviceSize

    known = {d.name: d for d in former.devices} if former is not None else {}
    kept = known if options.keep_lenses else {}
    if options.keep_lenses and former is None:
        raise MethodError(
            "--keep-lenses: expected a former rig to take them from (--rig), found none"
        )
    devices = [
        DeviceSize(name=s.device_name, role="camera", shape=s.shape, known=kept.get(s.device_name))
        for s in scan.stacks
    ]
    plan = scan.stacks[0].plan
    if not options.cameras_only and plan.angles:
        old = former.projector if former is not None else None
        name = old.name if old is not None else "projector"
        shape = plan.projector_shape or (old.shape if old is not None else (0, 0))
        devices.append(DeviceSize(name=name, role="projector", shape=shape, known=kept.get(name)))
    for device in devices:
        if former is not None and options.keep_lenses and device.known is None:
            raise RigError(
                f"{options.rig}: expected the lens of '{device.name}' to keep (--keep-lenses), "
                f"found only {', '.join(known)}"
            )
        if device.known is not None and device.known.shape != device.shape:
            raise RigError(
                f"{options.rig}: {device.role} '{device.name}': its lens is for "
                f"{device.known.n_cols} x {device.known.n_rows} pixels, the recordings have "
                f"{device.shape[1]} x {device.shape[0]}. Name the rig of these devices"
            )
    return devices


def _require_same(folder: Path, own: Sequence[DeviceSize], devices: Sequence[DeviceSize]) -> None:
    """Refuse a pose that was recorded by other devices."""
    for here, first in zip(own, devices, strict=False):
        if (here.name, here.shape) != (first.name, first.shape):
            raise CalibrationError(
                f"{folder}: expected images of {first.role} '{first.name}' with {first.shape[1]} x "
                f"{first.shape[0]} pixels as in the first pose, found '{here.name}' with "
                f"{here.shape[1]} x {here.shape[0]}. Are they of another camera?"
            )
    if len(own) != len(devices):
        raise CalibrationError(
            f"{folder}: expected {len(devices)} devices as in the first pose, found {len(own)}"
        )


def _corners(board: Board, scan: Scan) -> dict[str, Found]:
    from fringe3d.board_scans import board_image
    from fringe3d.io.board_images import find_corners

    found = {s.device_name: find_corners(board_image(s), board) for s in scan.stacks}
    return {name: (corners.ids, corners.pixels) for name, corners in found.items()}


def _not_found(board: Board, scan: Scan, n_poses: int) -> str:
    from fringe3d.board_scans import board_image
    from fringe3d.io.board_images import other_size

    size = other_size(board_image(scan.stacks[0]), board)
    hint = (
        f"The first image shows one of {size[0]} x {size[1]}: correct --board"
        if size
        else "Check kind and size (inner corners of a chessboard, squares of a ChArUco board, its "
        "dictionary and layout), sharpness and light"
    )
    return (
        f"--board: expected a {board.text} in the images, found it in none of {n_poses} poses. "
        f"{hint}"
    )


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
            f"{options.folder.name}: {found.board.text}, {len(found.world_from_board)} poses "
            f"(fringe3d calibrate: rms {rms} px{unit})"
        ),
        covariance=found.covariance,
    )
