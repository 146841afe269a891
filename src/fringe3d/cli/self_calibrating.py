"""Poses of all devices from measurements: ``calibrate self`` and ``measure --self-calibrate``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

from fringe3d.cli.calibrating import calibrate
from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json
from fringe3d.cli.scan_options import SomeImagesOptions, read_scans, tell
from fringe3d.errors import MethodError, RigError
from fringe3d.model import Scan
from fringe3d.options import MeasureOptions

if TYPE_CHECKING:
    from fringe3d.self_calibration import KnownLength, SelfCalibrated

MARK = "; poses from "
"""In the provenance of a rig: what follows is told anew by each self-calibration."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SelfOptions(SomeImagesOptions):
    """What the user said on the command line.

    Parameters
    ----------
    known_length
        X,Y:X,Y:MM: distance between the points at two pixels of the first scan's C1; the scale.
    ball_bar
        X,Y:X,Y:MM: distance between the centres of the balls on which these pixels lie; the scale.
    """

    known_length: str | None = None
    ball_bar: str | None = None


@calibrate.command(name="self")
def self_(*, options: SelfOptions, as_json: Json = False) -> None:
    """Find the poses of all devices again from scans of anything, without a target.

    Full Gray code in two directions determines most; something with depth more than a plane. Leaves
    the rig in OUT. Lenses and the first camera stay as they are; the distance of the first two
    devices gives the scale. It prints which numbers the scans determine.
    Example: fringe3d calibrate self --from scan --out rig.toml
    """
    tell(lambda reporter: calibrate_self(options, reporter), options.out, as_json=as_json)


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

    require_writable(options.out, overwrite=options.overwrite, inputs=options.from_)
    if options.known_length and options.ball_bar:
        raise MethodError(
            "--ball-bar: expected one length for the scale, found --known-length, too"
        )
    told = options.ball_bar or options.known_length
    length = parse_length(told, of_balls=bool(options.ball_bar)) if told else None
    scans = read_scans(options, reporter)
    found = own_poses(scans, options.measuring, reporter, names=options.from_, length=length)
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


def parse_length(text: str, /, *, of_balls: bool = False) -> KnownLength:
    """Return the length of ``--known-length``, or of ``--ball-bar``.

    Examples
    --------
    >>> parse_length("10,20:300.5,20:50").length_mm
    50.0
    """
    from fringe3d.self_calibration import KnownLength

    numbers = [float(part) if _is_number(part) else math.nan for part in re.split("[,:]", text)]
    has_form = [len(part.split(",")) for part in text.split(":")] == [2, 2, 1]
    if not has_form or not all(math.isfinite(n) for n in numbers) or numbers[-1] <= 0:
        option = "--ball-bar" if of_balls else "--known-length"
        raise MethodError(
            f"{option}: expected two pixels of C1 and mm, as 120,80:400,85:50, found '{text}'"
        )
    x1, y1, x2, y2, length = numbers
    return KnownLength(first_px=(x1, y1), second_px=(x2, y2), length_mm=length, of_balls=of_balls)


def _is_number(text: str) -> bool:
    return re.fullmatch(r"\s*[+-]?\d*\.?\d+([eE][+-]?\d+)?\s*", text) is not None
