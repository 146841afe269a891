"""``fringe3d calibrate``: what a rig's own measurements tell of it."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from cyclopts import App, Parameter
from numpy.typing import NDArray

from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json, app
from fringe3d.cli.scan_options import ScanOptions, read_scans, tell
from fringe3d.errors import Fringe3DError, MethodError, PlanError, RigError
from fringe3d.model import PatternPlan, Rejection, Rig, Scan

if TYPE_CHECKING:
    from fringe3d.calibrate import LitPoints
    from fringe3d.health import Finding

calibrate = App(
    name="calibrate",
    help="Calibrate a rig: FOLDER with recordings of a board in several poses, or a COMMAND that "
    "needs no target. Example: fringe3d calibrate poses --board chessboard:9x7:20mm --out rig.toml",
)
app.command(calibrate)

MARK = "; projector from "
"""In the provenance of a rig: what follows is told anew by each calibration."""

STAGES = 4
"""Of one measurement: decoding, correspondences, points, checks."""

MOST_INCONSISTENT = 0.05
"""Part of the lit pixels whose code may contradict itself or the projector's size."""

LENS_NAMES = {
    "none": "pinhole",
    "k1": "k1",
    "k1-p": "k1 p1 p2",
    "k2-p": "k1 k2 p1 p2",
    "k3-p": "k1 k2 p1 p2 k3",
}


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorOptions(ScanOptions):
    """What the user said on the command line.

    Parameters
    ----------
    projector_size
        Projector pixels, WIDTHxHEIGHT, where neither plan nor rig says it.
    distortion
        Terms of the projector's lens; auto takes as many as improve points that were not fitted.
        p: p1 and p2; k2: k1 and k2; k3: k1, k2 and k3.
    """

    projector_size: str | None = None
    distortion: Literal["auto", "none", "k1", "k1-p", "k2-p", "k3-p"] = "auto"

    @property
    def size(self) -> tuple[int, int] | None:
        """Return the pixels of the projector, (width, height)."""
        from fringe3d.io.importing import parse_size

        return parse_size(self.projector_size) if self.projector_size else None


@calibrate.command
def projector(*, options: ProjectorOptions, as_json: Json = False) -> None:
    """Find the projector from scans by two calibrated cameras, without any target.

    Takes scans with a full Gray code of something with depth. Leaves the rig with its projector in
    OUT, and NAME-projector.md and NAME-projector.png beside it: figures, and a map of what the
    projector leaves unexplained.
    Example: fringe3d calibrate projector --from scan-a --from scan-b --out rig.toml
    """
    tell(lambda reporter: calibrate_projector(options, reporter), options.out, as_json=as_json)


def calibrate_projector(
    options: ProjectorOptions, reporter: Reporter, /
) -> tuple[str, dict[str, Any]]:
    """Measure the scans without a projector, fit one to them, write the rig.

    Parameters
    ----------
    options : ProjectorOptions
    reporter : Reporter

    Returns
    -------
    str, dict
        What to print, and the same as plain data.

    Raises
    ------
    Fringe3DError
        If scans, rig or options do not suffice, or nothing can be written.
    """
    from fringe3d.calibrate import LENSES, check_fit, fit_projector, residual_px
    from fringe3d.io.atomic import require_writable
    from fringe3d.report.calibration import (
        projector_record,
        projector_text,
        targets_of,
        write_projector,
    )

    for target in reversed(targets_of(options.out)):
        require_writable(target, overwrite=options.overwrite, inputs=options.from_)
    scans = _read(options, reporter)
    rig = _common_rig(options, scans)
    shape = _projector_shape(options, rig, scans)
    measured = [
        _measured(path, scan, shape, options, reporter)
        for path, scan in zip(options.from_, scans, strict=True)
    ]
    lit = [points for points, _ in measured]
    n_stages = STAGES * len(scans) + 2
    reporter.stage("fitting the projector", of=n_stages)
    name = rig.projector.name if rig.projector else _free_name(rig)
    lens = next((lens for lens in LENSES if lens == LENS_NAMES.get(options.distortion)), None)
    fitted = fit_projector(lit, shape, lens=lens, name=name)
    findings = [finding for _, found in measured for finding in found]
    findings += check_fit(fitted, lit, rig)
    before = None
    if rig.projector is not None:
        old = [residual_px(rig.projector, points).ravel() for points in lit]
        before = float(np.nanmedian(np.abs(np.concatenate(old))))
    record = projector_record(fitted, lit, findings, previous_px=before)
    reporter.stage("writing", of=n_stages)
    # What else the rig knew belonged to the projector that it had.
    calibrated = Rig(
        cameras=rig.cameras,
        projector=fitted.device,
        volume=rig.volume,
        provenance=_provenance(rig, [points.name for points in lit], record),
    )
    command = shlex.join(["fringe3d", *sys.argv[1:]])
    write_projector(
        options.out, calibrated, fitted, lit, record, command=command, overwrite=options.overwrite
    )
    return projector_text(record), record | {"out": str(options.out)}


def _read(options: ProjectorOptions, reporter: Reporter) -> list[Scan]:
    """Read the scans; each must have two calibrated cameras."""
    scans = read_scans(options, reporter)
    for path, scan in zip(options.from_, scans, strict=True):
        if scan.rig is None:
            raise MethodError(
                f"{path}: expected a rig with two calibrated cameras, found none. Name one with "
                "--rig"
            )
        if len(scan.stacks) < 2 or len(scan.rig.cameras) < 2:
            raise MethodError(
                f"{path}: expected images and calibration of two cameras, found "
                f"{len(scan.stacks)} camera(s) in the scan and {len(scan.rig.cameras)} in the rig. "
                "A projector is found from the points that two cameras measure; with one camera "
                "calibrate it with a board"
            )
    return scans


def _common_rig(options: ProjectorOptions, scans: list[Scan]) -> Rig:
    """Return the rig of the scans; the cameras of all must be the same."""
    from fringe3d.io.rigfile import rig_text

    rigs = [scan.rig for scan in scans if scan.rig is not None]
    texts = [rig_text(Rig(cameras=rig.cameras)) for rig in rigs]
    for path, text in zip(options.from_, texts, strict=True):
        if text != texts[0]:
            raise RigError(
                f"{path}: expected the cameras of {options.from_[0]}, found others. One "
                "calibration needs scans of one rig: calibrate each apart, or name the rig of all "
                "with --rig"
            )
    return rigs[0]


def _projector_shape(options: ProjectorOptions, rig: Rig, scans: list[Scan]) -> tuple[int, int]:
    """Return (n_rows, n_cols) as options, plans and rig say; they must agree."""
    said: dict[tuple[int, int], str] = {}
    if options.size is not None:
        said[options.size[::-1]] = "--projector-size"
    for path, scan in zip(options.from_, scans, strict=True):
        shape = scan.stacks[0].plan.projector_shape
        if shape is not None:
            said.setdefault(shape, str(path))
    if rig.projector is not None:
        said.setdefault(rig.projector.shape, f"the rig's projector '{rig.projector.name}'")
    if not said:
        raise PlanError(
            f"{options.from_[0]}: expected the size of the projector, found it neither in the plan "
            "nor in the rig. Say it: --projector-size WIDTHxHEIGHT"
        )
    if len(said) > 1:
        found = " and ".join(f"{cols} x {rows} ({where})" for (rows, cols), where in said.items())
        raise PlanError(f"projector: expected one size, found {found}. Correct one of them")
    return next(iter(said))


def _measured(
    path: Path,
    scan: Scan,
    shape: tuple[int, int],
    options: ProjectorOptions,
    reporter: Reporter,
) -> tuple[LitPoints, list[Finding]]:
    """Measure a scan without its projector; return the points with their coordinates."""
    from fringe3d.calibrate import lit_points
    from fringe3d.pipeline import MeasureOptions, measure

    assert scan.rig is not None
    stacks = tuple(
        replace(stack, plan=PatternPlan(patterns=stack.plan.patterns, projector_shape=shape))
        for stack in scan.stacks
    )
    # What both cameras see beside the volume is as good for this.
    cameras_only = replace(scan.rig, projector=None, volume=None, covariance=None)
    bare = replace(scan, stacks=stacks, rig=cameras_only)
    # The fit judges what neighbours share: phases as they were seen, none corrected by the others.
    wanted = MeasureOptions(method="m1", drop_edges=True, depth_mm=options.depth_mm, blur_px=None)
    n_stages = STAGES * len(options.from_) + 2
    try:
        result = measure(bare, wanted, stage=lambda name: reporter.stage(name, of=n_stages))
    except MethodError as problem:
        raise MethodError(f"{path}: {_without_method(str(problem), shape)}") from None
    except Fringe3DError as problem:
        raise type(problem)(f"{path}: {problem}") from None
    assert result.points is not None
    maps = [d.main for d in result.phases[0].directions if d.main.is_absolute]
    name = str(path)
    found = [*result.warnings, *_check_size(result.rejection, shape)]
    warnings = [replace(f, text=f"{name}: {f.text}") for f in found]
    cameras = {camera.name: camera for camera in scan.rig.cameras}
    return lit_points(result.points, maps, cameras[result.main.device_name], name=name), warnings


def _check_size(rejection: NDArray[np.uint16], shape: tuple[int, int]) -> list[Finding]:
    """Warn where many pixels have a code that a projector of this size does not show."""
    from fringe3d.health import Finding

    lit = (rejection & np.uint16(Rejection.LOW_MODULATION | Rejection.SATURATED)) == 0
    wrong = (rejection & np.uint16(Rejection.INCONSISTENT_CODE)) != 0
    part = float(wrong[lit].mean()) if lit.any() else 0.0
    if part <= MOST_INCONSISTENT:
        return []
    text = (
        f"{part:.0%} of the lit pixels have a code that a projector of {shape[1]} x {shape[0]} "
        "pixels does not show. Is its size right (--projector-size)?"
    )
    return [Finding("warning", "inconsistent_part", part, text)]


def _without_method(text: str, shape: tuple[int, int]) -> str:
    """Turn what `measure` says of method M1 into what to do here."""
    if not text.startswith("--method m1: "):
        return text
    found = text.removeprefix("--method m1: ").partition(". ")[0]
    return (
        f"{found} ({shape[1]} x {shape[0]} projector pixels). The projector is found from scans "
        "that number every period: record one with a full Gray code (fringe3d patterns without "
        "--gray-bits), or correct the projector's size"
    )


def _free_name(rig: Rig) -> str:
    names = {camera.name for camera in rig.cameras}
    return next(name for name in ("projector", "projector-2", "projector-3") if name not in names)


def _provenance(rig: Rig, names: list[str], record: dict[str, Any]) -> str:
    cameras = rig.provenance.partition(MARK)[0] or "cameras of unknown origin"
    return (
        f"{cameras}{MARK}{', '.join(names)} (fringe3d calibrate projector: {record['points']:,} "
        f"points, median residual {record['residual_median_px']:.3f} px)"
    )
