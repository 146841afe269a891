"""Describe a recording with the user, and check the description."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fringe3d.cli.console import Reporter, fail
from fringe3d.cli.dialogue import ImportOptions, complete
from fringe3d.errors import (
    CalibrationError,
    EmptyResultError,
    Fringe3DError,
    PlanError,
    RigError,
)
from fringe3d.health import CORRELATION
from fringe3d.io.atomic import require_writable, write_text
from fringe3d.io.importing import (
    guess_cameras,
    matrix_names,
    parse_bit_depth,
    parse_camera,
    parse_depth,
    parse_keys,
    parse_sequence,
    parse_size,
    read_calibration,
    relative_path,
    require_images,
    scan_text,
)
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.io.volumetable import slab_text
from fringe3d.pipeline import Measurement, MeasureOptions, measure
from fringe3d.report.folder import finding_record, summary

__all__ = ["ImportOptions", "import_recording"]

Told = tuple[str, dict[str, Any]]
"""What to print, and the same as plain data."""

POSE_FINDINGS = ("epipolar_residual_px", "trinocular_residual_px", "lost_part", "texture_shift_px")
"""Of these one at least is bad where R and T are taken the wrong way round: but for cameras that
stand mirror-like, with fringes of one direction."""

POSE_ERRORS = (CalibrationError, EmptyResultError, RigError)

MORE_POINTS = 1.05
"""Times as many: so far one direction must be ahead to be taken for the right one."""

CLEARER_TEXTURE = 0.15
"""Of artanh of the correlation: five times its spread, for a part of the image holds some 170
independent points, and the median of nine parts is taken."""


def import_recording(options: ImportOptions, reporter: Reporter, /) -> Told:
    """Write the scan file (and the rig file), check them; return what to print, and a record."""
    _require_sense(options)
    if not (options.cameras and options.sequence):
        _require_terminal(options)
        options = complete(options)
    elif options.without_effect:
        raise PlanError(
            f"{', '.join(options.without_effect)}: expected --calibration beside it, found none. "
            "Add it, or leave this out"
        )
    cameras = [parse_camera(text) for text in options.cameras]
    for camera in cameras:
        require_images(options.images, camera)
    scan = scan_text(_entries(options, cameras), images=options.images, out=options.out)
    rig = _rig_text(options, cameras) if options.calibration else None
    _write(options, scan, rig)
    if rig is None or options.inverse_pose:
        return _check(options, reporter)
    return _check_both_directions(options, cameras, rig, reporter)


def _require_sense(options: ImportOptions) -> None:
    """Refuse what is wrong already, before anything is asked or written."""
    if not options.images.is_dir():
        raise PlanError(
            f"{options.images}: expected the folder of the images, found none. Check the path"
        )
    if options.rig is not None and (options.calibration or options.depth):
        raise PlanError(
            "--rig: expected a complete rig file, found --calibration or --depth beside it. "
            "Leave them out, or write the depth range into the rig's [volume]"
        )
    _require_values(options)
    if options.rig is not None:
        read_rig(options.rig)
    inputs = (options.rig, options.calibration)
    require_writable(options.out, overwrite=options.overwrite, inputs=inputs)
    if options.calibration is not None:
        matrix_names(options.calibration)
        require_writable(options.rig_out, overwrite=options.overwrite, inputs=inputs)


def _require_values(options: ImportOptions) -> None:
    if not 0 <= options.black_level < math.inf:
        raise PlanError(
            f"--black-level: expected a grey value >= 0, found {options.black_level:g}. Correct it"
        )
    for text in options.cameras:
        require_images(options.images, parse_camera(text))
    for text in options.sequence:
        parse_sequence(text)
    if options.projector_size is not None:
        parse_size(options.projector_size)
    if options.depth is not None:
        parse_depth(options.depth)
    if options.calibration_keys is not None:
        parse_keys(options.calibration_keys)
    if options.bit_depth is not None:
        parse_bit_depth(str(options.bit_depth))


def _require_terminal(options: ImportOptions) -> None:
    if sys.stdin is not None and sys.stdin.isatty():
        return
    option, found = "--sequence 'KIND KEY=VALUE ...'", "none"
    if not options.cameras:
        proposals = guess_cameras(options.images)
        option, found = "--camera NAME=PATTERN", ", ".join(proposals) or "no numbers"
    raise PlanError(
        f"import: {option} is needed where nobody can be asked (no terminal); found {found}"
    )


def _entries(options: ImportOptions, cameras: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the tables of the scan file."""
    entries: dict[str, Any] = {
        "title": options.title,
        "cameras": cameras,
        "sequence": [parse_sequence(text) for text in options.sequence],
        "bit_depth": options.bit_depth or 8,
        "black_level_dn": options.black_level,
    }
    if options.projector_size:
        entries["projector_size"] = parse_size(options.projector_size)
    if options.calibration is not None:
        entries["rig"] = options.rig_out.name
    elif options.rig is not None:
        entries["rig"] = relative_path(options.rig, to=options.out.parent)
    return entries


def _rig_text(options: ImportOptions, cameras: Sequence[dict[str, Any]]) -> str:
    assert options.calibration is not None
    rig = read_calibration(
        options.calibration,
        images=options.images,
        cameras=cameras,
        projector_size=parse_size(options.projector_size) if options.projector_size else None,
        keys=parse_keys(options.calibration_keys) if options.calibration_keys else None,
        inverse_pose=options.inverse_pose,
    )
    volume = slab_text(rig.cameras[0].name, parse_depth(options.depth)) if options.depth else ""
    return rig_text(rig) + volume


def _write(options: ImportOptions, scan: str, rig: str | None) -> None:
    """Write both files, or neither."""
    if rig is None:
        write_text(options.out, scan, overwrite=options.overwrite)
        return
    earlier = options.rig_out.read_bytes() if options.rig_out.is_file() else None
    write_text(options.rig_out, rig, overwrite=options.overwrite)
    try:
        write_text(options.out, scan, overwrite=options.overwrite)
    except BaseException:
        if earlier is None:
            options.rig_out.unlink()
        else:
            options.rig_out.write_bytes(earlier)
        raise


def _check_both_directions(
    options: ImportOptions, cameras: Sequence[dict[str, Any]], rig: str, reporter: Reporter
) -> Told:
    """Check R and T as OpenCV writes them; where they do not fit, the other way round.

    What fits is taken, and said; where neither does, the first problem is told.
    """
    inverse = replace(options, inverse_pose=True)
    found = _tried(options, reporter)
    if isinstance(found, Fringe3DError) and not isinstance(found, POSE_ERRORS):
        raise _failed(options, found)
    write_text(options.rig_out, _rig_text(inverse, cameras), overwrite=True)
    other = _tried(inverse, reporter)
    is_inverse, why = direction_that_fits(
        (_n_points(found), _n_points(other)), (_correlation(found), _correlation(other))
    )
    if is_inverse and not isinstance(other, Fringe3DError):
        return _told(
            inverse,
            other,
            "R and T map the second device to the first (--inverse-pose): so they fit the images "
            f"better ({why})",
        )
    write_text(options.rig_out, rig, overwrite=True)
    if isinstance(found, Fringe3DError):
        raise _failed(options, found)
    if is_inverse is not None:
        return _told(options, found)
    return _told(
        options,
        found,
        f"warning: R and T fit in both directions ({why}), and are taken as OpenCV's, from the "
        "first device to the second. If the cloud is deformed, import with --inverse-pose",
    )


def direction_that_fits(
    n_points: tuple[int, int], correlations: tuple[float, float], /
) -> tuple[bool | None, str]:
    """Tell whether R and T map the second device to the first; None where both fit.

    Parameters
    ----------
    n_points : (int, int); as OpenCV writes R and T, and the other way round
    correlations : (float, float); of the texture of both cameras; NaN where it does not tell

    Returns
    -------
    bool or None, str
        And the figures in words. Texture decides where it tells in both directions: for cameras
        that stand mirror-like, fringes match either way, the surface does not.

    Examples
    --------
    >>> direction_that_fits((70_000, 71_000), (0.77, 0.91))[0]
    True
    """
    here, there = n_points
    points = f"{here:,} points as OpenCV's, {there:,} the other way round"
    gain = float(np.diff(np.arctanh(np.clip(correlations, -0.999, 0.999)))[0])
    if min(n_points) > 0 and abs(gain) > CLEARER_TEXTURE:
        texture = "correlation of the texture {:.2f} as OpenCV's, {:.2f} the other way round"
        return gain > 0, texture.format(*correlations)
    if there > MORE_POINTS * here:
        return True, points
    return (None if there > here / MORE_POINTS else False), points


def _tried(options: ImportOptions, reporter: Reporter) -> Measurement | Fringe3DError:
    try:
        return _measured(options, reporter)
    except Fringe3DError as problem:
        return problem


def _n_points(result: Measurement | Fringe3DError) -> int:
    """Return the number of points; none where the checks of the pose contradict it."""
    if isinstance(result, Fringe3DError) or result.points is None:
        return 0
    is_wrong = any(f.name in POSE_FINDINGS for f in result.warnings)
    return 0 if is_wrong else result.points.n_points


def _correlation(result: Measurement | Fringe3DError) -> float:
    """Return the correlation of the texture; NaN where it is not known."""
    if isinstance(result, Fringe3DError):
        return math.nan
    return next((f.figures[CORRELATION] for f in result.findings if CORRELATION in f.figures),
                math.nan)  # fmt: skip


def _check(options: ImportOptions, reporter: Reporter) -> Told:
    """Measure with the new description; say what came out, and what may be wrong."""
    try:
        return _told(options, _measured(options, reporter))
    except Fringe3DError as problem:
        raise _failed(options, problem) from None


def _measured(options: ImportOptions, reporter: Reporter) -> Measurement:
    path = options.out
    try:
        with reporter.running():
            scan = read_scan(path, progress=reporter.step)
            return measure(scan, MeasureOptions(), stage=reporter.stage)
    except KeyboardInterrupt:
        fail(f"interrupted; {path} is written but not checked. 'fringe3d measure' checks it")
        raise SystemExit(130) from None


def _failed(options: ImportOptions, problem: Fringe3DError) -> PlanError:
    return PlanError(
        f"{options.out} is written, but the check failed: {str(problem).rstrip('.')}"
        f"{_remedy(options, problem)}. 'fringe3d measure' repeats the check"
    )


def _told(options: ImportOptions, result: Measurement, *remarks: str) -> Told:
    lines = [f"{options.out}: {summary(result)}"]
    if result.points is None:
        lines.append(
            "for points import again with --overwrite and --calibration FILE (or --rig FILE)"
        )
    lines += [f"{finding.level}: {finding.text}" for finding in result.findings]
    record = {
        "out": str(options.out),
        "rig": str(options.rig_out if options.calibration else options.rig or "") or None,
        "inverse_pose": options.inverse_pose,
        "points": result.points.n_points if result.points else None,
        "remarks": list(remarks),
        "health": [finding_record(finding) for finding in result.findings],
    }
    return "\n".join([*lines, *remarks]), record


def _remedy(options: ImportOptions, problem: Fringe3DError) -> str:
    """Return what else may mend a pose that contradicts the images."""
    is_pose = isinstance(problem, POSE_ERRORS)
    if options.calibration is None or not is_pose:
        return ""
    if not options.inverse_pose:
        return ". R and T the other way round do not fit either"
    return (
        ". Or R and T map the other way than was said: import again without --inverse-pose, and "
        "with --overwrite"
    )
