"""The commands that measure; the others register themselves."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from fringe3d.cli import (
    biasing,
    boarding,
    calibrating,
    doctoring,
    evaluating,
    exporting,
    fitting,
    merging,
    noising,
    planning,
    recording,
    responding,
    self_calibrating,
    showing,
    simulated,
    table_calibrating,
)
from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least

if TYPE_CHECKING:  # the commands import what they need when they run
    from fringe3d.pipeline import Measurement

__all__ = [
    "app",
    "biasing",
    "boarding",
    "calibrating",
    "doctoring",
    "evaluating",
    "exporting",
    "fitting",
    "merging",
    "noising",
    "planning",
    "recording",
    "responding",
    "self_calibrating",
    "showing",
    "simulated",
    "table_calibrating",
]


@app.command
def measure(
    scan: Path,
    /,
    *,
    out: Path,
    images: Path | None = None,
    rig: Path | None = None,
    method: Literal["auto", "m0", "m1", "m2", "m3", "m4", "m5", "m6", "projector"] = "auto",
    direction: Literal["auto", "x", "y"] = "auto",
    shifts: int | None = None,
    gray_bits: Annotated[int | None, Parameter(validator=at_least(0))] = None,
    light_dark: bool = True,
    depth: str | None = None,
    strict: Annotated[bool, Parameter(negative=())] = False,
    drop_edges: Annotated[bool, Parameter(negative=())] = False,
    min_modulation: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    min_probability: Annotated[float | None, Parameter(validator=at_least(0, 1))] = None,
    outliers: Literal["none", "light", "medium", "strong"] = "none",
    reflections: Literal["none", "light", "medium", "strong"] = "none",
    filter_: Annotated[
        Literal["none", "light", "medium", "strong"], Parameter(name="--filter")
    ] = "none",
    best_estimate: Annotated[bool, Parameter(negative=())] = False,
    response: Path | None = None,
    noise: Path | None = None,
    previous: Path | None = None,
    motion: Annotated[bool, Parameter(negative=())] = False,
    self_calibrate: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Turn a recording into a point cloud.

    Leaves points.npz, cloud.ply, overview.png and measure.toml in OUT.
    Example: fringe3d measure scan --out result --depth 600:800

    Parameters
    ----------
    scan
        Scan folder (with a scan.toml), or a scan file.
    out
        Folder for the result; must not exist yet.
    images
        Folder of the images, where they do not lie beside the scan file.
    rig
        Rig file to use instead of the scan's own.
    method
        auto takes the best that images and rig allow, and says why. Two cameras: m0 full Gray
        code in two directions, m1 full code, m2 reduced code, m3 fringes alone, m4 fringes of two
        directions, m5 fringes alone and segments below one period, m6 whatever there is, by the
        evidence of all pixels; each leaves out the images that it does without. projector: one
        camera and the calibrated projector.
    direction
        Use only the fringes and code of this direction (x: vertical stripes).
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    light_dark
        Use light and dark images for the threshold of the code, where there are any.
    depth
        MIN:MAX, mm along the principal ray of C1; needed with few bits.
    strict
        Metrology: only orders that are certain; with m6 also no points next to what the second
        camera does not see or the light does not reach, nor pixels whose light may be mixed.
    drop_edges
        Leave out points next to depth edges, where light of two surfaces mixes.
    min_modulation
        Smallest fringe contrast, grey levels.
    min_probability
        Reject fringe orders that are less probable, 0 to 1: 0.9 by default, 0.99 if strict; 0 takes
        the best that fits.
    outliers
        Leave out points off the surface of their neighbours by more than their sigma explains:
        spikes, reflections, mixed pixels. light: by more than about 8, medium: 6, strong: 5 sigma.
    reflections
        Two cameras and a calibrated projector: leave out points on which they disagree, for light
        came by a second, shiny path, too. light: by more than 7, medium: 5.5, strong: 4.5 sigma.
    filter_
        Less noise: about a third, a quarter or a sixth of it is left. Edges stay sharp and balls
        keep their size; detail as fine as 3, 5 or 8 pixels is smoothed, and counts in sigma.
    best_estimate
        Two cameras and a calibrated projector: let its phases place the points, too, as far as
        they agree with the cameras.
    response
        Take the gamma of projector and camera out of the phase: "self" for what these images show
        of it, or a response.toml of fringe3d calibrate response.
    noise
        A noise.toml of fringe3d noise, for the sigma of the points, instead of the scan's own
        noise.
    previous
        Result of the frame before, of the same scene and rig: m6 prefers what goes on from it where
        the images leave several solutions.
    motion
        Take the motion of the object between the images out of the phases first: for fringes of
        four steps and more, without a code or with a slow object.
    self_calibrate
        Find the poses of all devices from this scan first, starting from those of the rig; leaves
        them in OUT/rig.toml. Lenses, and the distance of the first two devices, stay.
    """
    from fringe3d.calibrate import check_poses
    from fringe3d.correspond import keep_curves
    from fringe3d.decode import stilled
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.cache import mapped
    from fringe3d.io.importing import parse_depth
    from fringe3d.io.recording import read_scan
    from fringe3d.io.results import read_points_mm
    from fringe3d.options import MeasureOptions
    from fringe3d.pipeline import measure as run
    from fringe3d.report.folder import Request, measure_record, summary, write_result

    require_writable(out, overwrite=overwrite, inputs=(scan, images, rig, response, noise,
                     previous))  # fmt: skip
    is_own = response == Path("self")
    options = MeasureOptions(
        method=method,
        direction=direction,
        n_shifts=shifts,
        gray_bits=gray_bits,
        light_dark=light_dark,
        depth_mm=parse_depth(depth) if depth else None,
        strict=strict,
        drop_edges=drop_edges,
        outliers=outliers,
        reflections=reflections,
        min_modulation_dn=min_modulation,
        min_order_probability=min_probability,
        filter=filter_,
        best_estimate=best_estimate,
        own_response=is_own,
    )
    response = None if is_own else response
    keep_curves(mapped)
    command = shlex.join(["fringe3d", *sys.argv[1:]])
    request = Request(command=command, scan=scan, images=images, rig=rig, response=response,
                      noise=noise, previous=previous)  # fmt: skip
    with Reporter(quiet=as_json).running() as reporter:
        recording = read_scan(scan, images=images, rig=rig, response=response,
                              noise=noise, progress=reporter.step)  # fmt: skip
        if motion:
            stacks = tuple(stilled(stack) for stack in recording.stacks)
            recording = replace(recording, stacks=stacks)
        shape = recording.stacks[0].images.shape[1:]
        before = read_points_mm(previous, shape=shape) if previous else None
        found = None
        if self_calibrate:
            found = self_calibrating.own_poses([recording], options, reporter, names=[scan])
            recording = replace(recording, rig=found.rig)
        result = run(recording, options, stage=reporter.stage, previous_mm=before)
        reporter.stage("writing")
        write_result(out, recording, options, result, request=request, own_poses=found,
                     overwrite=overwrite)  # fmt: skip
    _tell(result, reporter)
    if found is not None:
        for finding in check_poses(found.fitted):
            (reporter.note if finding.level == "ok" else reporter.warn)(finding.text)
    record = measure_record(recording, options, result, request=request, own_poses=found)
    record |= {"out": str(out)}
    say(f"{summary(result)} -> {out}", record, as_json=as_json)


def _tell(result: Measurement, reporter: Reporter) -> None:
    """Say how it was measured, and what is to be watched."""
    if result.method != "phase":
        reporter.note(f"method {result.method} with {result.n_images} images: {result.why}")
    if result.method == "m6":  # whose orders rest on it
        for finding in result.findings:
            if finding.name == "calibration_bias_px" and finding.level == "ok":
                reporter.note(finding.text)
    for finding in result.warnings:
        reporter.warn(finding.text)


@app.command(name="import")
def import_(
    images: Path,
    /,
    *,
    out: Path | None = None,
    camera: list[str] | None = None,
    sequence: list[str] | None = None,
    projector_size: str | None = None,
    rig: Path | None = None,
    calibration: Path | None = None,
    calibration_keys: str | None = None,
    inverse_pose: Annotated[bool, Parameter(negative=())] = False,
    depth: str | None = None,
    bit_depth: int | None = None,
    black_level: float = 0.0,
    title: str = "",
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Describe a recording made by other software, and check the description.

    Writes a scan.toml (and a rig.toml). Without --camera or --sequence it asks, on a terminal,
    for these and all else that is not given; with both it asks nothing.
    Example: fringe3d import images --camera "c1={index:02d}.png"
    --sequence "fringes period_px=60 n_shifts=12" --sequence "gray cell_px=30 n_bits=6"
    --calibration stereo.yml --projector-size 1920x1080

    Parameters
    ----------
    images
        Folder of the images.
    out
        The scan file; IMAGES/scan.toml by default.
    camera
        NAME=PATTERN[@FIRST], as "c1=left/{index:02d}.png@1"; repeat it for a second camera.
    sequence
        What was projected, in recorded order, as in the [[sequence]] entries of a scan file:
        "fringes ...", "gray ...", "light", "dark" or "unused count=2"; repeat it.
    projector_size
        Projector pixels, WIDTHxHEIGHT.
    rig
        An existing rig file.
    calibration
        A calibration by OpenCV (YAML, XML, JSON), converted to rig.toml beside the scan file
        (NAME-rig.toml beside a NAME.toml).
    calibration_keys
        Names of its matrices: M1,D1,M2,D2,R,T, with :projector if the second is a projector.
    inverse_pose
        R and T map the second device to the first (OpenCV's map the first to the second). Without
        it both are tried, and what fits the images is taken.
    depth
        MIN:MAX, mm along the principal ray of C1; becomes the measuring volume.
    bit_depth
        Bits of a grey value, 8 to 16; 8 if neither given nor asked.
    black_level
        Grey value without light.
    title
        A line for pictures and reports.
    """
    from fringe3d.cli.importer import ImportOptions, import_recording

    options = ImportOptions(
        images=images,
        out=out or images / "scan.toml",
        cameras=tuple(camera or ()),
        sequence=tuple(sequence or ()),
        projector_size=projector_size,
        rig=rig,
        calibration=calibration,
        calibration_keys=calibration_keys,
        inverse_pose=inverse_pose,
        depth=depth,
        bit_depth=bit_depth,
        black_level=black_level,
        title=title,
        overwrite=overwrite,
    )
    text, record = import_recording(options, Reporter(quiet=as_json))
    say(text, record, as_json=as_json)
