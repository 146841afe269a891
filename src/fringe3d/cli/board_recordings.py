"""Recordings of a board in several poses: which there are, and what all devices see in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from fringe3d.cli.console import Reporter
from fringe3d.cli.scan_options import RigOptions
from fringe3d.errors import CalibrationError, Fringe3DError, MethodError, RigError
from fringe3d.model import Board, ImageStack, PatternPlan, Rig, Scan, Uniform

if TYPE_CHECKING:
    from fringe3d.board_scans import Found
    from fringe3d.calibrate import BoardCalibration, BoardView, DeviceSize

MOST_TYPICAL_PX = 3.0
"""Of the rms in the typical pose: a calibration that is good has a tenth of it."""

IMAGES_LOOKED_AT = 3
"""Images that tell which board they show."""

FEW_POSES = 3
"""Fewer do not calibrate a lens; if others are without the board, it may be another one."""

Pose = tuple[str, Callable[[], Scan]]
"""Its name, and how its recording is read."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesOptions(RigOptions):
    """What the user said on the command line.

    Parameters
    ----------
    board
        chessboard:9x7:20mm (inner corners), charuco:11x8:15mm:11mm:DICT_4X4_50[:legacy] (squares),
        circles:9x7:20mm, asymmetric-circles:4x11:10mm, or a board.toml.
    scan
        Scan file that describes the images in each of the folders, where they have no scan.toml.
    camera
        NAME=PATTERN of plain images of the board, one for each pose, in the folder or below it, as
        left=left/{index:03d}.png; repeat it for each camera. Images of one number are of one pose.
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

    board: str
    scan: Path | None = None
    camera: Annotated[list[str] | None, Parameter(negative=())] = None
    keep_lenses: Annotated[bool, Parameter(negative=())] = False
    distortion: Literal["auto", "none", "k1", "k1-p", "k2-p", "k3-p", "rational"] = "auto"
    board_shape: Literal["auto", "flat", "bent", "free"] = "auto"
    cameras_only: Annotated[bool, Parameter(negative=())] = False
    leave_out: Annotated[list[str] | None, Parameter(negative=())] = None
    world: str | None = None


def poses_of(folder: Path, options: SeriesOptions, /) -> list[Pose]:
    """Return the poses in the order of their numbers, without those to be left out.

    Raises
    ------
    MethodError
        If there are none, or a pose to be left out is not among them.
    """
    if not folder.is_dir():
        raise MethodError(
            f"{folder}: expected a folder with one scan folder for each pose of the board, found "
            f"{'a file' if folder.exists() else 'none'}. Check the path"
        )
    if options.camera and options.scan:
        raise MethodError(
            "--camera: expected plain images or a scan file (--scan), found both. Leave one out"
        )
    found = _plain_poses(folder, options.camera) if options.camera else _scans(folder, options)
    unknown = set(options.leave_out or ()) - {name for name, _ in found}
    if unknown:
        raise MethodError(
            f"--leave-out: expected names of poses ({', '.join(name for name, _ in found)}), found "
            f"{', '.join(sorted(unknown))}"
        )
    return [pose for pose in found if pose[0] not in (options.leave_out or ())]


def _scans(folder: Path, options: SeriesOptions) -> list[Pose]:
    """Return the scan folders in a folder."""
    from fringe3d.io.recording import read_scan

    inside = [p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")]
    found = sorted(
        (p for p in inside if options.scan is not None or (p / "scan.toml").is_file()),
        key=lambda p: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", p.name)],
    )
    if not found:
        where = f"{len(inside)} folders without a scan.toml" if inside else "no folders"
        raise MethodError(
            f"{folder}: expected one scan folder for each pose of the board, found {where}. "
            "Describe the images that all have in common with --scan (fringe3d import writes it); "
            "or name plain images of the board with --camera NAME=PATTERN"
        )
    if options.scan is None:
        return [(p.name, partial(read_scan, p, with_rig=False)) for p in found]
    return [(p.name, partial(read_scan, options.scan, images=p, with_rig=False)) for p in found]


def _plain_poses(folder: Path, cameras: Sequence[str]) -> list[Pose]:
    """Return plain images of a board, those of one number as one pose."""
    from fringe3d.io.importing import image_files, parse_camera, require_images

    files: dict[str, dict[int, Path]] = {}
    for text in cameras:
        camera = parse_camera(text) | {"first_index": 0}
        if camera["name"] in files:
            raise MethodError(f"--camera: expected different names, found '{camera['name']}' twice")
        files[camera["name"]] = image_files(folder, camera)
        if not files[camera["name"]]:
            require_images(folder, camera)  # says why
    numbers = sorted(set().union(*files.values()))
    common = [n for n in numbers if all(n in own for own in files.values())]
    if not common:
        found = "; ".join(f"{name}: {min(own)} to {max(own)}" for name, own in files.items())
        raise MethodError(
            "--camera: expected images of one number from all cameras, for each pose, found none "
            f"({found}). Number them alike"
        )
    numbers.sort(key=lambda n: (n != common[0], n))  # the first shows all cameras
    width = len(str(numbers[-1]))
    return [
        (f"{n:0{width}d}", partial(_plain, {k: own[n] for k, own in files.items() if n in own}))
        for n in numbers
    ]


def _plain(files: dict[str, Path]) -> Scan:
    """Read one image of each camera, in even light."""
    from fringe3d.io.images import read_image

    plan = PatternPlan(patterns=(Uniform(level=1.0),))
    images = {name: read_image(path) for name, path in files.items()}
    return Scan(stacks=tuple(
        ImageStack(images=image[None], plan=plan, device_name=name,
                   saturation_dn=255.0 if image.itemsize == 1 else 65535.0)
        for name, image in images.items()
    ))  # fmt: skip


def seen_in_series(
    folder: Path, options: SeriesOptions, former: Rig | None, reporter: Reporter, /
) -> tuple[list[BoardView], list[DeviceSize]]:
    """Return what all devices see in all poses, and the devices.

    Raises
    ------
    Fringe3DError
        If recordings or options do not suffice, or the board is found in none of them.
    """
    from fringe3d.board_scans import views_of_scan
    from fringe3d.io.boardfile import read_board

    board = read_board(options.board)
    poses = poses_of(folder, options)
    views: list[BoardView] = []
    devices: list[DeviceSize] = []
    without: list[Scan] = []  # the board: what else do they show?
    for number, (pose, read) in enumerate(poses):
        reporter.step("finding the board", number, len(poses))
        scan = read()
        own = _devices(options, former, scan)
        devices = devices or own
        _require_same(f"{folder}: pose {pose}", own, devices, may_lack=bool(options.camera))
        corners = _corners(board, scan)
        name = next((d.name for d in devices if d.role == "projector"), None)
        try:
            views += views_of_scan(scan, board, corners, pose=pose, projector=name)
        except Fringe3DError as problem:
            raise type(problem)(f"{folder / pose}: {problem}") from None
        if not len(corners[scan.stacks[0].device_name][0]) and len(without) < IMAGES_LOOKED_AT:
            without.append(scan)
    reporter.step("finding the board", len(poses), len(poses))
    n_found = len({view.pose for view in views if len(view)})
    if n_found < min(FEW_POSES, len(poses) / 2):
        raise CalibrationError(
            f"--board: expected a {board.text} in the images, found it in {n_found or 'none'} of "
            f"{len(poses)} poses. {_what_they_show(board, without)}"
        )
    return views, devices


def require_fit(found: BoardCalibration, folder: Path, options: SeriesOptions, /) -> None:
    """Refuse a calibration that fits none of its poses.

    Raises
    ------
    CalibrationError
        If the corners of the typical pose miss by more than any lens or detector explains.
    """
    from fringe3d.calibrate import typical_rms_px

    device, rms = typical_rms_px(found)
    if rms <= MOST_TYPICAL_PX:
        return
    scans = [read() for _, read in poses_of(folder, options)[:IMAGES_LOOKED_AT]]
    raise CalibrationError(
        f"{folder}: expected the corners of the typical pose within {MOST_TYPICAL_PX:g} px of "
        f"where one rig and one {found.board.text} show them, found {rms:.1f} px in '{device}'. "
        f"{_what_they_show(found.board, scans)}. Are all images of this camera and pose?"
    )


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


def _require_same(
    where: str, own: Sequence[DeviceSize], devices: Sequence[DeviceSize], *, may_lack: bool
) -> None:
    """Refuse a pose that was recorded by other devices."""
    names = [d.name for d in own]
    expected = [d for d in devices if d.name in names] if may_lack else devices
    for here, first in zip(own, expected, strict=False):
        if (here.name, here.shape) != (first.name, first.shape):
            raise CalibrationError(
                f"{where}: expected images of {first.role} '{first.name}' with {first.shape[1]} x "
                f"{first.shape[0]} pixels as in the first pose, found '{here.name}' with "
                f"{here.shape[1]} x {here.shape[0]}. Are they of another camera?"
            )
    if len(own) != len(expected):
        raise CalibrationError(
            f"{where}: expected {len(devices)} devices as in the first pose, found {len(own)}"
        )


def _corners(board: Board, scan: Scan) -> dict[str, Found]:
    from fringe3d.board_scans import board_image
    from fringe3d.calibrate import circle_centers
    from fringe3d.io.board_images import find_corners

    found = {s.device_name: find_corners(board_image(s), board) for s in scan.stacks}
    return {
        name: (c.ids, c.pixels if c.areas is None else
               circle_centers(board, c.ids, c.pixels, c.areas))
        for name, c in found.items()
    }  # fmt: skip


def _what_they_show(board: Board, scans: Sequence[Scan]) -> str:
    """Return which other board images show, and what to do, for a message."""
    from fringe3d.board_scans import board_image
    from fringe3d.io.board_images import other_board

    seen = [other for s in scans if (other := other_board(board_image(s.stacks[0]), board))]
    if not seen:
        return (
            "Check kind and size (inner corners of a chessboard, squares of a ChArUco board, its "
            "dictionary and layout), sharpness and light"
        )
    other = max(seen, key=lambda b: b.n_cols * b.n_rows)  # of a large one a part may be seen
    return f"An image shows a {other.kind} of {other.n_cols} x {other.n_rows}: correct --board"
