"""Commands that plan a recording: patterns, design."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least, simulator_installed
from fringe3d.errors import MethodError, PlanError


@app.command
def patterns(
    *,
    size: str,
    out: Path,
    period: list[float] | None = None,
    steps: int = 4,
    direction: Literal["x", "y", "xy"] | None = None,
    angle: Annotated[float | None, Parameter(validator=at_least(-360))] = None,
    reverse: Annotated[bool, Parameter(negative=())] = False,
    gray: Literal["complementary", "plain", "none"] = "complementary",
    gray_bits: Annotated[int | None, Parameter(validator=at_least(1))] = None,
    inverses: Annotated[bool, Parameter(negative=())] = False,
    light_dark: Annotated[bool, Parameter(negative=())] = False,
    ramp: Annotated[int | None, Parameter(validator=at_least(3))] = None,
    response: Path | None = None,
    bits: Literal[8, 16] = 8,
    overwrite: Overwrite = False,
    as_json: Json = False,
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
        Fringe period, projector px, at least 2; need not be an integer; repeat it for several. Only
        a grey ramp does without.
    steps
        Phase steps, at least 3; 0 for Gray code alone with cells of the period.
    direction
        x: vertical fringes (the default), y: horizontal, xy: both.
    angle
        Fringe angle in degrees instead of a direction; 0 is x, 90 is y.
    reverse
        Shift the fringes the other way.
    gray
        complementary codes half periods (one image more, no errors at the edges).
    gray_bits
        Tell 2^n periods apart, cyclically; as many as there are by default.
    inverses
        Add the inverse of each Gray-code image.
    light_dark
        Add a light and a dark image.
    ramp
        Add uniform images of so many grey levels from dark to light, of which fringe3d calibrate
        response finds gamma; 17 will do.
    response
        A response.toml of fringe3d calibrate response: the images then make up for the gamma.
    bits
        Bit depth of the images.
    """
    from fringe3d.io.importing import parse_size
    from fringe3d.io.responsefile import mean_curve
    from fringe3d.model import PatternPlan
    from fringe3d.patterns import grey_ramp, numbering, sequence
    from fringe3d.report.patterns import write_patterns

    width, height = parse_size(size, "--size")
    angles = _angles(angle, direction)
    if not period and not ramp:
        raise PlanError(
            "patterns: expected --period, the fringe period in projector px (--period 16), found "
            "none; only a grey ramp (--ramp) does without"
        )
    try:
        plan = (
            PatternPlan(patterns=grey_ramp(ramp), projector_shape=(height, width))
            if (ramp and not period)
            else sequence(
                (height, width),
                periods_px=tuple(period or ()),
                n_shifts=steps,
                angles=angles,
                reverse=reverse,
                gray=gray,
                gray_bits=gray_bits,
                inverses=inverses,
                light_dark=light_dark,
                n_ramp=ramp or 0,
            )
        )
        notes = numbering(plan)
    except ValueError as problem:
        raise MethodError(f"{problem}. See fringe3d patterns --help") from None
    curve = mean_curve(response) if response else None
    write_patterns(out, plan, bit_depth=bits, response=curve, overwrite=overwrite)
    said = [f"{plan.n_images} images of {width} x {height} px, {bits} bit -> {out}"]
    record = {"out": str(out), "n_images": plan.n_images, "size": [width, height],
              "bit_depth": bits, "notes": notes}  # fmt: skip
    say("\n".join([*said, *(f"note: {note}" for note in notes)]), record, as_json=as_json)


def _angles(angle: float | None, direction: str | None) -> tuple[float, ...]:
    """Return the fringe angles that the options ask for, rad; vertical fringes by default."""
    if angle is not None and direction is not None:
        raise MethodError(
            f"--angle, --direction: expected one of them, found {angle:g} and {direction}. Leave "
            "one out"
        )
    if angle is not None:
        return (math.radians(angle),)
    return tuple({"x": 0.0, "y": math.pi / 2}[name] for name in direction or "x")


@app.command
def design(
    rig: str,
    /,
    *,
    period: Annotated[float | None, Parameter(validator=at_least(2))] = None,
    angle: Annotated[float | None, Parameter(validator=at_least(-360))] = None,
    depth: str | None = None,
    steps: Annotated[int | None, Parameter(validator=at_least(3))] = None,
    noise: Annotated[float, Parameter(validator=at_least(0))] = 0.01,
    calibration_error_px: Annotated[float, Parameter(validator=at_least(0))] = 0.1,
    camera_period: Annotated[float | None, Parameter(validator=at_least(1))] = None,
    beyond: Annotated[float | None, Parameter(validator=at_least(0, 2))] = None,
    out: Path | None = None,
    optimise: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Tell which images a rig needs, how certain its points are, where its projector should stand.

    Leaves design.md, design.json, rig.png, maps.png and segments.png in OUT.
    Example: fringe3d design examples/sketches/kolibri.toml --out design

    Parameters
    ----------
    rig
        A rig.toml, a sketch of a rig (distances, angles, chips), or a preset of the simulator.
    period
        Fringe period, projector px; that of sketch or preset, or 16, by default.
    angle
        Fringe angle, degrees; 0: vertical fringes.
    depth
        MIN:MAX, mm along the principal ray of C1; needed where the rig has no volume.
    steps
        Phase steps; those of the sketch, or 4, by default.
    noise
        Noise of a grey value over the fringe amplitude.
    calibration_error_px
        How far calibrated and true image points differ.
    camera_period
        Period that the second camera sees, px; needed where the projector is not calibrated.
    beyond
        Part of a segment beyond each end of the volume in which surfaces are seen, too, as a
        table; all figures then count them. By default 0.4 in a column of their own, and else 0.
    out
        Folder for report and pictures; must not exist yet.
    optimise
        Look for a better place of the projector and angle of the fringes.
    """
    _without_threads()
    from fringe3d.cli.designer import DesignOptions, run_design
    from fringe3d.io.importing import parse_depth

    options = DesignOptions(
        rig=rig,
        period_px=period,
        angle_deg=angle,
        depth_mm=parse_depth(depth) if depth else None,
        steps=steps,
        noise=noise,
        calibration_px=calibration_error_px,
        camera_period_px=camera_period,
        beyond=beyond,
        out=out,
        optimise=optimise,
        overwrite=overwrite,
    )
    with simulator_installed("design"), Reporter(quiet=as_json).running() as reporter:
        text, record = run_design(options, reporter)
    say(text, record, as_json=as_json)


def _without_threads() -> None:
    """Keep the libraries to one thread; they read that as they are loaded.

    A design takes thousands of small arrays, for which threads cost more than they help: on a busy
    machine ten times the whole.
    """
    for library, name in (("numba", "NUMBA_NUM_THREADS"), ("numpy", "OPENBLAS_NUM_THREADS")):
        if library not in sys.modules:
            os.environ.setdefault(name, "1")
