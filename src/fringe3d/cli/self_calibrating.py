"""Poses of all devices from measurements: ``calibrate self`` and ``measure --self-calibrate``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fringe3d.cli.calibrating import CalibrationOptions, Images, Scans, calibrate, read_scans
from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, at_least
from fringe3d.errors import MethodError, RigError
from fringe3d.model import Scan
from fringe3d.options import MeasureOptions

if TYPE_CHECKING:
    from fringe3d.self_calibration import KnownLength, SelfCalibrated

MARK = "; poses from "
"""In the provenance of a rig: what follows is told anew by each self-calibration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SelfOptions(CalibrationOptions):
    """What the user said on the command line; see ``fringe3d calibrate self --help``."""

    shifts: int | None = None
    gray_bits: int | None = None
    known_length: str | None = None


@calibrate.command(name="self")
def self_(
    *,
    from_: Scans,
    out: Path,
    rig: Path | None = None,
    images: Images = None,
    depth: str | None = None,
    shifts: int | None = None,
    gray_bits: Annotated[int | None, Parameter(validator=at_least(0))] = None,
    known_length: str | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the poses of all devices again from scans of anything, without a target.

    Leaves the rig in OUT. Lenses and the first camera stay as they are; the distance of the first
    two devices gives the scale. It prints which numbers the scans determine.
    Example: fringe3d calibrate self --from scan --out rig.toml

    Parameters
    ----------
    from_
        Scan folder or scan file; repeat it for several scans of the same rig. Full Gray code in two
        directions determines most; something with depth more than a plane.
    out
        The rig file to write.
    rig
        Rig file instead of the scan's own.
    depth
        MIN:MAX, mm along the principal ray of C1; needed where orders are not numbered.
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    known_length
        X,Y:X,Y:MM: distance between the points at two pixels of the first scan's C1; the scale.
    """
    from fringe3d.io.importing import parse_depth

    options = SelfOptions(
        scans=tuple(from_),
        out=out,
        rig=rig,
        images=tuple(images or ()),
        depth_mm=parse_depth(depth) if depth else None,
        shifts=shifts,
        gray_bits=gray_bits,
        known_length=known_length,
        overwrite=overwrite,
    )
    with Reporter(quiet=as_json).running() as reporter:
        text, record = calibrate_self(options, reporter)
    for finding in record["health"]:
        if finding["level"] != "ok":
            reporter.warn(finding["text"])
    say(f"{text}\n\n-> {out}", record, as_json=as_json)


def calibrate_self(options: SelfOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Find the poses, and write the rig.

    Returns
    -------
    str, dict
        What to print, and the same as plain data.

    Raises
    ------
    Fringe3DError
        If scans, rig or options do not suffice, or nothing can be written.
    """
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.rigfile import rig_text
    from fringe3d.report.self_calibration import self_calibration_record, self_calibration_text

    require_writable(options.out, overwrite=options.overwrite, inputs=options.scans)
    length = parse_length(options.known_length) if options.known_length else None
    scans = read_scans(options, reporter)
    wanted = MeasureOptions(
        n_shifts=options.shifts, gray_bits=options.gray_bits, depth_mm=options.depth_mm
    )
    found = own_poses(scans, wanted, reporter, names=options.scans, length=length)
    write_text(options.out, rig_text(found.rig), overwrite=options.overwrite)
    record = self_calibration_record(found)
    return self_calibration_text(record), record | {"out": str(options.out)}


def own_poses(
    scans: Sequence[Scan],
    options: MeasureOptions,
    reporter: Reporter,
    /,
    *,
    names: Sequence[Path],
    length: KnownLength | None = None,
) -> SelfCalibrated:
    """Find the poses of the devices of the first scan's rig, and say in it where they are from.

    Raises
    ------
    RigError
        If there is no rig to begin with.
    """
    from fringe3d.self_calibration import self_calibrate

    rig = scans[0].rig
    if rig is None:
        raise RigError(
            f"{names[0]}: self-calibration: expected a rig to begin with, found none. Name one "
            "with --rig (lenses stay as they are)"
        )
    found = self_calibrate(scans, rig, options, length=length, step=reporter.step)
    told = (
        f"{rig.provenance.partition(MARK)[0]}{MARK}{', '.join(str(name) for name in names)} "
        f"(fringe3d self-calibration: {found.fitted.residual_px:.3f} px, "
        f"{found.fitted.n_determined} of {found.fitted.n_numbers} numbers)"
    )
    return replace(found, rig=replace(found.rig, provenance=told))


def parse_length(text: str, /) -> KnownLength:
    """Return the length of ``--known-length``.

    Examples
    --------
    >>> parse_length("10,20:300.5,20:50").length_mm
    50.0
    """
    from fringe3d.self_calibration import KnownLength

    numbers = [float(part) if _is_number(part) else math.nan for part in re.split("[,:]", text)]
    has_form = [len(part.split(",")) for part in text.split(":")] == [2, 2, 1]
    if not has_form or not all(math.isfinite(n) for n in numbers) or numbers[-1] <= 0:
        raise MethodError(
            f"--known-length: expected two pixels of C1 and mm, as 120,80:400,85:50, found '{text}'"
        )
    x1, y1, x2, y2, length = numbers
    return KnownLength(first_px=(x1, y1), second_px=(x2, y2), length_mm=length)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"\s*[+-]?\d*\.?\d+([eE][+-]?\d+)?\s*", text) is not None
