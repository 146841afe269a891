"""``fringe3d doctor``: what is wrong with a scan, and what helps."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app
from fringe3d.errors import ImageError

if TYPE_CHECKING:  # the command imports what it needs when it runs
    from fringe3d.diagnosis import Diagnosis
    from fringe3d.health import Fault
    from fringe3d.model import Scan


@app.command
def doctor(
    scan: Path,
    /,
    *,
    images: Path | None = None,
    rig: Path | None = None,
    depth: str | None = None,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Name what is wrong with a scan, with its evidence, and what helps.

    Looks at exposure, focus, response, order and description of the images, at flicker and
    movement, then measures and looks at the geometry. Exit code 0 if nothing is wrong, 1 if
    something is.
    Example: fringe3d doctor scan --out scan.png

    Parameters
    ----------
    scan
        Scan folder (with a scan.toml), or a scan file.
    images
        Folder of the images, where they do not lie beside the scan file.
    rig
        Rig file to use instead of the scan's own.
    depth
        MIN:MAX, mm along the principal ray of C1.
    out
        A picture (PNG) of what was found.
    """
    from fringe3d.diagnosis import Diagnosis, diagnose
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.importing import parse_depth
    from fringe3d.io.recording import read_scan
    from fringe3d.options import MeasureOptions
    from fringe3d.report.doctor import write_doctor_picture

    if out is not None:
        require_writable(out, overwrite=overwrite, inputs=(scan, images, rig))
    options = MeasureOptions(depth_mm=parse_depth(depth) if depth else None)
    recording: Scan | None = None
    with Reporter(quiet=as_json).running() as reporter:
        try:
            recording = read_scan(scan, images=images, rig=rig, progress=reporter.step)
            found = diagnose(recording, options, stage=lambda name: reporter.stage(name, of=3))
        except ImageError as problem:
            found = Diagnosis((_unreadable(problem),), ())
        if out is not None and recording is not None:
            write_doctor_picture(out, recording, found.faults, title=str(scan))
    record = {"scan": str(scan), "faults": [_record(fault) for fault in found.faults]}
    say(_text(scan, found), record, as_json=as_json)
    if found.faults:
        sys.exit(1)


def _unreadable(problem: ImageError) -> Fault:
    from fringe3d.health import Fault, Kind

    return Fault(kind=Kind.MISSING_FILES, camera="", figure="", value=math.nan, limit=math.nan,
                 text=str(problem))  # fmt: skip


def _record(fault: Fault) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "fault": fault.kind.value,
        "camera": fault.camera or None,
        "text": fault.text,
        "figure": fault.figure or None,
        "value": number(fault.value),
        "limit": number(fault.limit),
        "images": list(fault.images),
        "cure": fault.cure,
    }


def _text(scan: Path, found: Diagnosis) -> str:
    if not found.faults:
        return f"{scan}: nothing wrong was found"
    lines = []
    for fault in found.faults:
        lines.append(f"{fault.kind.value}: {fault.text}")
        if math.isfinite(fault.value):
            limit = f" (limit {fault.limit:.3g})" if math.isfinite(fault.limit) else ""
            lines.append(f"  {fault.figure}: {fault.value:.3g}{limit}")
        lines.append(f"  what helps: {fault.cure}")
    return "\n".join(lines)
