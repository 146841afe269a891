"""The commands."""

from __future__ import annotations

import math
import sys
import warnings
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

from fringe3d import __version__
from fringe3d.cli.console import Reporter, fail, say
from fringe3d.errors import AccuracyWarning, Fringe3DError, MethodError

app = App(
    name="fringe3d",
    version=__version__,
    help="Fringe-projection 3D measurement with few images. Lengths in mm, pixels from 0.",
)

Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print the result as JSON.")]
Overwrite = Annotated[bool, Parameter(negative=(), help="Replace what is there.")]


@app.command
def measure(
    scan: Path,
    /,
    *,
    out: Path,
    images: Path | None = None,
    rig: Path | None = None,
    method: Literal["auto", "m1", "m2", "projector"] = "auto",
    shifts: int | None = None,
    gray_bits: int | None = None,
    depth: str | None = None,
    strict: Annotated[bool, Parameter(negative=())] = False,
    min_modulation: float | None = None,
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
        auto takes the best that images and rig allow. m1: two cameras, full Gray code. m2: two
        cameras, reduced code. projector: one camera and the calibrated projector.
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    depth
        MIN:MAX, mm along the principal ray of C1; needed with few bits.
    strict
        Metrology: fewer wrong points, at the price of edges and small patches.
    min_modulation
        Smallest fringe contrast, grey levels.
    """
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.recording import read_scan
    from fringe3d.pipeline import MeasureOptions
    from fringe3d.pipeline import measure as run
    from fringe3d.report.folder import measure_record, summary, write_result

    require_writable(out, overwrite=overwrite)
    options = MeasureOptions(
        method=method,
        n_shifts=shifts,
        gray_bits=gray_bits,
        depth_mm=_depth(depth),
        strict=strict,
        min_modulation_dn=min_modulation,
    )
    with Reporter(quiet=as_json).running() as reporter:
        recording = read_scan(scan, images=images, rig=rig, progress=reporter.step)
        result = run(recording, options, stage=reporter.stage)
        reporter.stage("writing")
        write_result(out, recording, options, result, overwrite=overwrite)
    for finding in result.warnings:
        reporter.warn(finding.text)
    record = measure_record(recording, options, result) | {"out": str(out)}
    say(f"{summary(result)} -> {out}", record, as_json=as_json)


@app.command
def patterns(
    *,
    size: str,
    out: Path,
    period: list[float],
    steps: int = 4,
    direction: Literal["x", "y", "xy"] = "x",
    angle: float | None = None,
    reverse: Annotated[bool, Parameter(negative=())] = False,
    gray: Literal["complementary", "plain", "none"] = "complementary",
    gray_bits: int | None = None,
    inverses: Annotated[bool, Parameter(negative=())] = False,
    light_dark: Annotated[bool, Parameter(negative=())] = False,
    bits: Literal[8, 16] = 8,
    overwrite: Overwrite = False,
) -> None:
    """Write the images to project, and the plan that travels with them.

    Leaves 000.png ..., plan.toml and overview.png in OUT.
    Example: fringe3d patterns --size 1024x768 --period 16 --steps 4 --out patterns

    Parameters
    ----------
    size
        Projector pixels, WIDTHxHEIGHT.
    out
        Folder for the images; must not exist yet.
    period
        Fringe period, projector px; need not be an integer; repeat it for several periods.
    steps
        Phase steps, at least 3; 0 for Gray code alone with cells of the period.
    direction
        x: vertical fringes, y: horizontal, xy: both.
    angle
        Fringe angle in degrees instead of a direction; 0 is x, 90 is y.
    reverse
        Shift the fringes the other way.
    gray
        complementary codes half periods (one image more, no errors at the edges).
    gray_bits
        Tell 2^n periods apart, cyclically; all by default.
    inverses
        Add the inverse of each Gray-code image.
    light_dark
        Add a light and a dark image.
    bits
        Bit depth of the images.
    """
    from fringe3d.patterns import sequence
    from fringe3d.report.patterns import write_patterns

    width, height = _size(size)
    if angle is not None:
        angles: tuple[float, ...] = (math.radians(angle),)
    else:
        angles = tuple({"x": 0.0, "y": math.pi / 2}[name] for name in direction)
    try:
        plan = sequence(
            (height, width),
            periods_px=tuple(period),
            n_shifts=steps,
            angles=angles,
            reverse=reverse,
            gray=gray,
            gray_bits=gray_bits,
            inverses=inverses,
            light_dark=light_dark,
        )
    except ValueError as problem:
        raise MethodError(str(problem)) from None
    write_patterns(out, plan, bit_depth=bits, overwrite=overwrite)
    say(f"{plan.n_images} images of {width} x {height} px, {bits} bit -> {out}")


@app.command
def demo(*, out: Path = Path("demo"), overwrite: Overwrite = False) -> None:
    """Measure an embedded scan, a sphere before a plane, and compare it with the truth.

    Leaves the scan in OUT/scan and the result in OUT/result: look at overview.png.

    Parameters
    ----------
    out
        Folder for scan and result.
    """
    from fringe3d.cli.demo import run_demo

    with Reporter(quiet=False).running() as reporter:
        text = run_demo(out, overwrite=overwrite, reporter=reporter)
    say(text)


def _depth(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise MethodError(f"--depth: expected MIN:MAX in mm, as 600:800, found '{text}'") from None
    if not low < high:
        raise MethodError(f"--depth: expected MIN below MAX, found '{text}'")
    return low, high


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise MethodError(f"--size: expected WIDTHxHEIGHT, as 1024x768, found '{text}'") from None
    if width < 1 or height < 1:
        raise MethodError(f"--size: expected positive numbers, found '{text}'")
    return width, height


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; exit code 0 done, 2 for a mistake that the user can mend."""
    warnings.simplefilter("default", AccuracyWarning)
    try:
        app(arguments, exit_on_error=False, print_error=True, result_action="return_value")
    except CycloptsError:
        sys.exit(2)
    except Fringe3DError as problem:
        fail(str(problem))
        sys.exit(2)
    except KeyboardInterrupt:
        fail("interrupted; nothing was written")
        sys.exit(130)
