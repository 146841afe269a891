"""``fringe3d record``: from devices to a scan folder."""

from __future__ import annotations

import shlex
import sys
from contextlib import suppress
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
    black_level: Annotated[float | None, Parameter(validator=at_least(0))] = None,
    patience_ms: Annotated[float, Parameter(validator=at_least(1))] = 500.0,
    table: Annotated[int, Parameter(validator=at_least(1))] = 1,
    camera_size: str = "640x512",
    seed: Annotated[int, Parameter(validator=at_least(0))] = 0,
    title: str = "",
    preview: Annotated[bool, Parameter(negative=())] = False,
    host: str = "127.0.0.1",
    port: Annotated[int, Parameter(validator=at_least(1, 65535))] = 8080,
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
        NAME=ADDRESS, with the name of a camera of the rig: gige:IP (or MAC address), pylon:SERIAL,
        uvc:INDEX, file:SCAN. Repeat it for each camera. fringe3d devices lists them.
    projector
        window:OUTPUT, the number of a screen, or its name; file:SCAN; lab:, that of fringe3d lab.
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
    black_level
        Grey value without light, of all cameras, where they do not say it themselves.
    patience_ms
        Time that a frame may take from the camera, beyond its exposure.
    table
        Turn the object to that many positions: a scan folder for each.
    camera_size
        Pixels of simulated cameras, WIDTHxHEIGHT.
    seed
        Of the simulated noise.
    title
        A line for pictures and reports.
    preview
        Show first, in the browser, what the cameras see: modulation, and what is saturated. A
        button on the page begins the recording.
    host
        Address of that page: by default only this machine can see it.
    port
        The next free one is taken where it is in use.
    """
    from fringe3d.io.importing import parse_size

    options: dict[str, Any] = {
        "rig": rig, "plan": plan, "out": out, "cameras": tuple(camera or ()),
        "projector": projector, "replay": replay, "thing": simulate,
        "camera_size": parse_size(camera_size, "--camera-size"), "seed": seed,
        "exposure_ms": exposure_ms, "gain_db": gain_db, "auto_exposure": expose == "auto",
        "series": parse_factors(exposures), "wait_ms": wait_ms,
        "measures_latency": measure_latency, "hardware_trigger": trigger == "hardware",
        "black_level_dn": black_level, "patience_ms": patience_ms,
        "positions": table, "title": title, "command": shlex.join(["fringe3d", *sys.argv[1:]]),
        "overwrite": overwrite, "is_shown_first": preview, "host": host, "port": port,
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


@app.command
def devices(*, as_json: Json = False) -> None:
    """List the cameras and outputs that are connected, with their addresses for fringe3d record.

    Examples: fringe3d devices; fringe3d devices --json
    """
    from fringe3d.devices.discovery import find_devices

    found, missing = find_devices()
    lines = [f"{device.kind:<10} {device.address:<28} {device.about}" for device in found]
    lines = lines or ["no camera and no output found"]
    lines += [f"not searched: {why}" for why in missing]
    record_ = {
        "devices": [{"kind": d.kind, "address": d.address, "about": d.about} for d in found],
        "not_searched": list(missing),
    }
    say("\n".join(lines), record_, as_json=as_json)


@app.command
def lab(
    preset: str,
    /,
    *,
    thing: Annotated[str, Parameter(name="--object")] = "machine-part",
    camera_size: str = "640x512",
    seed: Annotated[int, Parameter(validator=at_least(0))] = 0,
    latency_ms: Annotated[float, Parameter(validator=at_least(0))] = 30.0,
    port: Annotated[int, Parameter(validator=at_least(1, 65535))] = 3957,
    as_json: Json = False,
) -> None:
    """Simulate cameras behind GigE Vision on this machine, and their projector; Ctrl-C ends it.

    Any program that speaks GigE Vision sees the cameras at 127.0.0.1, 127.0.0.2, ...
    Example: fringe3d lab kolibri --object teeth, and elsewhere: fringe3d record rig.toml --plan
    plan.toml --camera c1=gige:127.0.0.1 --camera c2=gige:127.0.0.2 --projector lab: --out scan

    Parameters
    ----------
    preset
        A rig of fringe3d simulate.
    thing
        What stands before it.
    camera_size
        Pixels of the cameras, WIDTHxHEIGHT.
    seed
        Of the noise.
    latency_ms
        From the order to the light.
    port
        Where the projector takes its orders.
    """
    from fringe3d.io.importing import parse_size

    with simulator_installed("lab"), Reporter(quiet=as_json).running() as reporter:
        from fringe3d.cli.recorder import simulated_world
        from fringe3d.devices import SystemClock
        from fringe3d.devices.lab import serve

        world, _ = simulated_world(
            preset, thing, reporter, camera_size=parse_size(camera_size, "--camera-size"),
            seed=seed, clock=SystemClock(), latency_s=latency_ms / 1000,
        )  # fmt: skip
    at = {camera.name: f"127.0.0.{n + 1}" for n, camera in enumerate(world.cameras)}
    places = ", ".join(f"{name} at {address}" for name, address in at.items())
    with suppress(KeyboardInterrupt):
        say(f"cameras {places}; projector at lab:127.0.0.1:{port}; Ctrl-C ends it",
            {"cameras": at, "projector": f"lab:127.0.0.1:{port}"}, as_json=as_json)  # fmt: skip
        serve(world, port=port)


@app.command
def live(
    rig: Path,
    /,
    *,
    plan: Path | None = None,
    replay: Path | None = None,
    video: Annotated[list[str] | None, Parameter(negative=())] = None,
    camera: Annotated[list[str] | None, Parameter(negative=())] = None,
    projector: str | None = None,
    exposure_ms: Annotated[float, Parameter(validator=at_least(0.001))] = 10.0,
    wait_ms: Annotated[float, Parameter(validator=at_least(0))] = 100.0,
    period_ms: Annotated[float, Parameter(validator=at_least(0.1))] = 30.0,
    method: Literal["auto", "m0", "m1", "m2", "m3", "m4", "m5", "m6", "projector"] = "auto",
    motion: Annotated[bool, Parameter(negative=())] = False,
    renew: Annotated[float, Parameter(validator=at_least(1, 100))] = 10.0,
    clouds: Annotated[int | None, Parameter(validator=at_least(1))] = None,
    host: str = "127.0.0.1",
    port: Annotated[int, Parameter(validator=at_least(1, 65535))] = 8080,
    view: bool = True,
    as_json: Json = False,
) -> None:
    """Record, measure and show in a loop; Ctrl-C ends it.

    The newest images, as many as the plan has, are measured whenever there is time: each new image
    may give a new cloud. What there is no time for is dropped and counted.
    Examples: fringe3d live rig.toml --plan plan.toml --camera c1=gige:192.168.1.20 --camera
    c2=gige:192.168.1.21 --projector window:1; fringe3d live scan/rig.toml --replay scan

    Parameters
    ----------
    rig
        The rig file.
    plan
        What is projected, round and round.
    replay
        Play a scan round and round instead.
    video
        NAME=FILE: play a video of a camera of the rig, whose first frame shows the first pattern.
        Repeat it for each camera.
    camera, projector
        As for fringe3d record.
    exposure_ms
        Exposure of all cameras.
    wait_ms
        Time from the order to show a pattern to the exposure.
    period_ms
        From frame to frame of --replay and --video.
    method
        How to measure; m6 takes the cloud before as evidence.
    motion
        Take the motion between the images out of the phases first: for fringes without a code.
    renew
        Part of the time, %, in which fringe orders are found anew, 100 for each cloud; between,
        m2 to m6 let them go on from the cloud before, which is several times as fast.
    clouds
        End after that many.
    host
        Address to listen on: by default only this machine can see the page.
    port
        The next free one is taken where it is in use.
    view
        --no-view measures without a page.
    """
    from fringe3d.cli.streaming import LiveOptions, run_live
    from fringe3d.options import MeasureOptions

    options = LiveOptions(
        rig=rig, plan=plan, replay=replay, videos=tuple(video or ()), cameras=tuple(camera or ()),
        projector=projector, exposure_ms=exposure_ms, wait_ms=wait_ms, period_ms=period_ms,
        measuring=MeasureOptions(method=method), still=motion, renew=renew, host=host, port=port,
        has_view=view, clouds=clouds,
    )  # fmt: skip
    with Reporter(quiet=as_json).running() as reporter:
        text, record_ = run_live(options, reporter, reporter.tell)
    say(text, record_, as_json=as_json)
