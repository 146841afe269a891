"""Describe a recording with the user, and check the description."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.prompt import Prompt

from fringe3d.cli.console import Reporter
from fringe3d.errors import Fringe3DError, PlanError
from fringe3d.io.atomic import require_writable, write_text
from fringe3d.io.importing import guess_cameras, parse_camera, parse_sequence, scan_text
from fringe3d.io.opencv_calibration import CalibrationKeys, read_opencv_calibration
from fringe3d.io.recording import image_size, read_scan
from fringe3d.io.rigfile import rig_text, slab_text
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.report.folder import summary


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What the user said on the command line; see ``fringe3d import --help``."""

    images: Path
    out: Path
    cameras: tuple[str, ...]
    sequence: tuple[str, ...]
    projector_size: tuple[int, int] | None
    rig: Path | None
    calibration: Path | None
    calibration_keys: str | None
    inverse_pose: bool
    depth_mm: tuple[float, float] | None
    bit_depth: int
    black_level: float
    title: str
    overwrite: bool


def import_recording(options: ImportOptions, reporter: Reporter, /) -> str:
    """Write the scan file (and the rig file), check them; return what to print."""
    if not options.images.is_dir():
        raise PlanError(f"{options.images}: expected the folder of the images, found none")
    if options.rig is not None and (options.calibration or options.depth_mm):
        raise PlanError(
            "--rig: expected a complete rig file, found --calibration or --depth beside it. "
            "Leave them out, or write the depth range into the rig's [volume]"
        )
    require_writable(options.out, overwrite=options.overwrite)
    cameras = [parse_camera(text) for text in options.cameras or _ask_cameras(options.images)]
    sequence = [parse_sequence(text) for text in options.sequence or _ask_sequence()]
    entries: dict[str, Any] = {"title": options.title, "cameras": cameras, "sequence": sequence}
    if options.projector_size:
        entries["projector_size"] = options.projector_size
    if options.bit_depth != 8:
        entries["bit_depth"] = options.bit_depth
    if options.black_level:
        entries["black_level_dn"] = options.black_level
    rig_file = _rig_file(options)
    if rig_file is not None:
        entries["rig"] = str(rig_file)
    text = scan_text(entries, images=options.images, out=options.out)
    if options.calibration is not None:
        _write_rig(options, options.out.with_name("rig.toml"), cameras)
    write_text(options.out, text, overwrite=options.overwrite)
    return _check(options.out, reporter)


def _rig_file(options: ImportOptions) -> Path | None:
    if options.calibration is not None:
        return Path("rig.toml")
    return options.rig.resolve() if options.rig is not None else None


def _write_rig(options: ImportOptions, path: Path, cameras: Sequence[dict[str, Any]]) -> None:
    assert options.calibration is not None
    rig = read_opencv_calibration(
        options.calibration,
        camera_sizes=[image_size(options.images, camera) for camera in cameras],
        projector_size=options.projector_size,
        keys=_keys(options.calibration_keys),
        second_from_first=not options.inverse_pose,
        camera_names=[camera["name"] for camera in cameras],
    )
    text = rig_text(rig)
    if options.depth_mm is not None:
        text += slab_text(rig.cameras[0].name, options.depth_mm)
    write_text(path, text, overwrite=options.overwrite)


def _keys(text: str | None) -> CalibrationKeys | None:
    if text is None:
        return None
    names, _, role = text.partition(":")
    parts = names.split(",")
    if len(parts) != 6 or role not in ("", "camera", "projector"):
        raise PlanError(
            "--calibration-keys: expected M1,D1,M2,D2,R,T and optionally :projector, "
            f"found '{text}'"
        )
    matrix1, distortion1, matrix2, distortion2, rotation, translation = parts
    return CalibrationKeys(
        matrix1=matrix1,
        distortion1=distortion1,
        matrix2=matrix2,
        distortion2=distortion2,
        rotation=rotation,
        translation=translation,
        second_role="projector" if role == "projector" else "camera",
    )


def _ask_cameras(images: Path) -> list[str]:
    proposals = guess_cameras(images)
    _require_terminal("--camera NAME=PATTERN", f"found {', '.join(proposals) or 'no numbers'}")
    answers: list[str] = []
    for number in range(max(1, len(proposals))):
        default = proposals[number] if number < len(proposals) else None
        question = f"Camera {number + 1}: NAME=PATTERN@FIRST ('-' to leave it out)"
        answer = Prompt.ask(question, default=default)
        if answer and answer != "-":
            answers.append(answer)
    return answers


def _ask_sequence() -> list[str]:
    _require_terminal("--sequence 'KIND KEY=VALUE ...'", "found none")
    answers: list[str] = []
    help_text = (
        "What was projected, in recorded order; an empty answer ends the list.\n"
        "  fringes period_px=60 n_shifts=12 direction=x shift_direction=-1 phase_offset_deg=-180\n"
        "  gray cell_px=30 n_bits=6 direction=x inverses=interleaved bright_is=1\n"
        "  light | dark | unused count=2"
    )
    Prompt.ask(help_text + "\nPress Enter", default="", show_default=False)
    while answer := Prompt.ask(f"Images {len(answers) + 1}", default="", show_default=False):
        answers.append(answer)
    return answers


def _require_terminal(option: str, found: str) -> None:
    if not sys.stdin.isatty():
        raise PlanError(
            f"import: {option} is needed where nobody can be asked (no terminal); {found}"
        )


def _check(path: Path, reporter: Reporter) -> str:
    """Measure with the new description; say what came out, and what may be wrong."""
    try:
        with reporter.running():
            scan = read_scan(path, progress=reporter.step)
            result = measure(scan, MeasureOptions(), stage=reporter.stage)
    except Fringe3DError as problem:
        raise PlanError(
            f"{path} is written, but the check failed: {problem}. Correct the file and check it "
            "with 'fringe3d measure'"
        ) from None
    lines = [f"{path}: {summary(result)}"]
    if result.points is None:
        lines.append("for points add --calibration FILE (or --rig FILE) and --projector-size")
    lines += [f"{finding.level}: {finding.text}" for finding in result.findings]
    return "\n".join(lines)
