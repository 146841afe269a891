"""``fringe3d record``: from devices to a scan folder."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least, simulator_installed
from fringe3d.errors import MethodError


@app.command
def record(
    rig: str,
    /,
    *,
    plan: Path,
    out: Path,
    camera: Annotated[list[str] | None, Parameter(negative=())] = None,
    projector: str | None = None,
    simulate: str | None = None,
    replay: Path | None = None,
    exposure_ms: Annotated[float, Parameter(validator=at_least(0.001))] = 10.0,
    gain_db: float = 0.0,
    expose: Literal["fixed", "auto"] = "fixed",
    exposures: str | None = None,
    wait_ms: Annotated[float, Parameter(validator=at_least(0))] = 100.0,
    measure_latency: Annotated[bool, Parameter(negative=())] = False,
    trigger: Literal["software", "hardware"] = "software",
    table: Annotated[int, Parameter(validator=at_least(1))] = 1,
    camera_size: str = "640x512",
    seed: Annotated[int, Parameter(validator=at_least(0))] = 0,
    title: str = "",
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Project a plan and record it with all cameras; every frame is checked.

    A frame that is missing, late, repeated, not whole, or of another brightness than its pattern is
    recorded again. OUT is a scan folder when all is well, and is not there otherwise; what had to
    be mended stands in its recording.toml.
    Examples: fringe3d record rig.toml --plan patterns/plan.toml --camera c1=gige:192.168.1.20
    --camera c2=gige:192.168.1.21 --projector window:1 --expose auto --out scan;
    without hardware: fringe3d record kolibri --simulate teeth --plan patterns/plan.toml --out scan

    Parameters
    ----------
    rig
        The rig file; with --simulate a rig of fringe3d simulate, as kolibri.
    plan
        What is projected: plan.toml of fringe3d patterns.
    out
        The scan folder; must not exist yet.
    camera
        NAME=ADDRESS, with the name of a camera of the rig: gige:IP (or MAC or serial number),
        pylon:SERIAL, uvc:INDEX, file:SCAN. Repeat it for each camera. fringe3d devices lists them.
    projector
        window:OUTPUT, the number of a screen, or its name; file:SCAN.
    simulate
        Simulate everything: the object that stands before the rig.
    replay
        Cameras and projector replay this scan.
    exposure_ms
        Exposure of all cameras.
    gain_db
        Gain of all cameras.
    expose
        auto finds the exposure of each camera at which white is bright and not saturated.
    exposures
        Record the sequence once with each of these multiples of the exposure, as 0.25,1,4.
    wait_ms
        Time from the order to show a pattern to the exposure.
    measure_latency
        Measure that time first.
    trigger
        hardware: a line of the projector triggers the cameras.
    table
        Turn the object to that many positions: a scan folder for each.
    camera_size
        Pixels of simulated cameras, WIDTHxHEIGHT.
    seed
        Of the simulated noise.
    title
        A line for pictures and reports.
    """
    from fringe3d.io.importing import parse_size

    options: dict[str, Any] = {
        "rig": rig, "plan": plan, "out": out, "cameras": tuple(camera or ()),
        "projector": projector, "replay": replay, "thing": simulate,
        "camera_size": parse_size(camera_size, "--camera-size"), "seed": seed,
        "exposure_ms": exposure_ms, "gain_db": gain_db, "auto_exposure": expose == "auto",
        "series": parse_factors(exposures), "wait_ms": wait_ms,
        "measures_latency": measure_latency, "hardware_trigger": trigger == "hardware",
        "positions": table, "title": title, "command": shlex.join(["fringe3d", *sys.argv[1:]]),
        "overwrite": overwrite,
    }  # fmt: skip
    with simulator_installed("record --simulate"), Reporter(quiet=as_json).running() as reporter:
        from fringe3d.cli.recorder import RecordOptions, run_record

        text, record_ = run_record(RecordOptions(**options), reporter)
    say(text, record_, as_json=as_json)


def parse_factors(text: str | None, /) -> tuple[float, ...]:
    """Return the multiples of ``--exposures``.

    Examples
    --------
    >>> parse_factors("0.25,1,4")
    (0.25, 1.0, 4.0)
    """
    if text is None:
        return ()
    try:
        factors = tuple(float(part) for part in text.split(","))
    except ValueError:
        factors = (0.0,)
    if not all(0 < factor < 1000 for factor in factors):
        raise MethodError(
            f"--exposures: expected multiples of the exposure, as 0.25,1,4, found '{text}'"
        )
    return factors
