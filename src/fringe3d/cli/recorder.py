"""Recorded scans: devices, exposure, latency, plan, and the folder that is whole or not there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringe3d import __version__
from fringe3d.acquire import (
    Devices,
    Recorded,
    measure_latency,
    opened,
    record,
    with_best_exposure,
)
from fringe3d.cli.console import Reporter
from fringe3d.cli.previewing import preview
from fringe3d.devices import Camera, CameraSettings, Clock, Projector, RotaryTable, SystemClock
from fringe3d.devices.addresses import cameras_at, devices_of_files, projector_at
from fringe3d.errors import DeviceError, PlanError
from fringe3d.io.atomic import new_folder, require_writable
from fringe3d.io.recordlog import write_record_log
from fringe3d.io.rigfile import read_rig
from fringe3d.io.scanfile import read_plan
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import PatternPlan, Rig, Scan, TablePosition

if TYPE_CHECKING:  # the simulator is an extra
    from fringe3d.devices.simulated import SimulatedWorld

SETTLE_S = 0.005
"""Added to a measured latency."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """What the user said on the command line; see ``fringe3d record --help``."""

    rig: str
    plan: Path
    out: Path
    cameras: tuple[str, ...] = ()
    projector: str | None = None
    replay: Path | None = None
    thing: str | None = None
    camera_size: tuple[int, int] = (640, 512)
    seed: int = 0
    exposure_ms: float = 10.0
    gain_db: float = 0.0
    auto_exposure: bool = False
    series: tuple[float, ...] = ()
    wait_ms: float = 100.0
    measures_latency: bool = False
    hardware_trigger: bool = False
    black_level_dn: float | None = None
    patience_ms: float = 500.0
    positions: int = 1
    title: str = ""
    command: str = ""
    overwrite: bool = False
    is_shown_first: bool = False
    host: str = "127.0.0.1"
    port: int = 8080


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """What records: devices that are not yet open, their clock, and the rig."""

    cameras: Sequence[Camera]
    projector: Projector
    table: RotaryTable | None
    clock: Clock
    rig: Rig | None


def run_record(
    options: RecordOptions, reporter: Reporter, /, *, bench: Bench | None = None
) -> tuple[str, dict[str, Any]]:
    """Record, write; return what to print and its record.

    `bench` are the devices; those of the options if None.
    """
    inputs = (options.plan, options.replay, Path(options.rig))
    require_writable(options.out, overwrite=options.overwrite, inputs=inputs)
    plan = read_plan(options.plan)
    bench = bench or _bench(options, reporter)
    settings = CameraSettings(
        exposure_ms=options.exposure_ms,
        gain_db=options.gain_db,
        trigger="hardware" if options.hardware_trigger else "software",
    )
    with (
        new_folder(options.out, overwrite=options.overwrite) as folder,
        opened(bench.cameras, bench.projector, settings, bench.clock,
               wait_s=options.wait_ms / 1000, grace_s=options.patience_ms / 1000,
               rig=bench.rig) as devices,
    ):  # fmt: skip
        plan = _fitting(plan, devices, options.plan)
        devices = _prepared(devices, options, reporter)
        if options.is_shown_first:
            preview(devices, plan, reporter.tell, host=options.host, port=options.port)
        n_mended = _record_all(folder, devices, plan, options, bench, reporter)
    scans = "a scan" if options.positions == 1 else f"{options.positions} scans"
    names = ", ".join(camera.name for camera in bench.cameras)
    text = f"{scans} of {plan.n_images} images by {names} -> {options.out}"
    if n_mended:
        text += f" ({n_mended} frames were recorded again or passed over: see recording.toml)"
    record_ = {
        "out": str(options.out),
        "images": plan.n_images,
        "cameras": [camera.name for camera in bench.cameras],
        "exposure_ms": {name: s.exposure_ms for name, s in devices.settings.items()},
        "wait_ms": 1000 * devices.wait_s,
        "mended": n_mended,
    }
    return text, record_


def _bench(options: RecordOptions, reporter: Reporter) -> Bench:
    if options.thing is not None:
        return _simulated(options, reporter)
    if options.positions > 1:
        raise DeviceError(
            "--table: expected --simulate, whose table is the only one that is known. Turn the "
            "object by hand and record scan after scan, or write a RotaryTable (see "
            "docs/howto-record.md)"
        )
    clock = SystemClock()
    rig = read_rig(Path(options.rig))
    if options.replay is not None:
        cameras, projector = devices_of_files(options.replay, clock)
        return Bench(cameras=cameras, projector=projector, table=None, clock=clock, rig=rig)
    if not options.cameras or options.projector is None:
        raise DeviceError(
            "record: expected cameras and a projector, found none. Name them: --camera "
            "c1=gige:192.168.1.20 --projector window:1 (fringe3d devices lists what is there), or "
            "try --simulate machine-part"
        )
    return Bench(cameras=cameras_at(options.cameras, clock),
                 projector=projector_at(options.projector, clock), table=None, clock=clock,
                 rig=rig)  # fmt: skip


def _simulated(options: RecordOptions, reporter: Reporter) -> Bench:
    assert options.thing is not None
    world, rig = simulated_world(
        options.rig, options.thing, reporter, camera_size=options.camera_size, seed=options.seed,
        n_positions=options.positions,
    )  # fmt: skip
    return Bench(cameras=world.cameras, projector=world.projector, table=world.table,
                 clock=world.clock, rig=rig)  # fmt: skip


def simulated_world(
    preset: str,
    thing: str,
    reporter: Reporter,
    /,
    *,
    camera_size: tuple[int, int],
    seed: int,
    n_positions: int = 1,
    clock: Clock | None = None,
    latency_s: float = 0.03,
) -> tuple[SimulatedWorld, Rig]:
    """Return simulated devices before an object, and their rig."""
    from fringe3d.cli.simulator import SimulateOptions, stages_of
    from fringe3d.devices.simulated import SimulatedWorld

    made, stages = stages_of(
        SimulateOptions(
            preset=preset, thing=thing, plan="m1", seed=seed, out=Path(), steps=4, period_px=None,
            camera_size=camera_size, background="table", n_rays=4, positions=n_positions,
            tilts_deg=(0.0,), settings=None, overwrite=False,
        ),
        reporter,
    )  # fmt: skip
    world = SimulatedWorld(stages, seed=seed, clock=clock, latency_s=latency_s,
                           n_positions=n_positions)  # fmt: skip
    return world, made.rig


def _fitting(plan: PatternPlan, devices: Devices, path: Path) -> PatternPlan:
    """Return the plan for this projector; refuse one that was made for another."""
    shape = devices.projector.open()
    if plan.projector_shape not in (None, shape):
        rows, cols = plan.projector_shape or (0, 0)
        raise PlanError(
            f"{path}: expected a plan for {shape[1]} x {shape[0]} projector pixels, found one for "
            f"{cols} x {rows}. Make it for this projector: fringe3d patterns --size "
            f"{shape[1]}x{shape[0]}"
        )
    return PatternPlan(patterns=plan.patterns, projector_shape=shape)


def _prepared(devices: Devices, options: RecordOptions, reporter: Reporter) -> Devices:
    """Find latency and exposure, where the user wants that."""
    if options.black_level_dn is not None:
        devices = replace(devices, infos={
            name: replace(info, black_level_dn=options.black_level_dn)
            for name, info in devices.infos.items()
        })  # fmt: skip
    if options.auto_exposure:
        devices = with_best_exposure(devices)
        found = ", ".join(f"{n} {s.exposure_ms:.3g} ms" for n, s in devices.settings.items())
        reporter.note(f"exposure: {found}")
    if options.measures_latency:
        latency_s = measure_latency(devices)
        devices = replace(devices, wait_s=latency_s + SETTLE_S)
        reporter.note(
            f"the projector takes {1000 * latency_s:.0f} ms; waiting a little longer "
            f"(--wait-ms {1000 * devices.wait_s:.0f})"
        )
    return devices


def _record_all(
    folder: Path,
    devices: Devices,
    plan: PatternPlan,
    options: RecordOptions,
    bench: Bench,
    reporter: Reporter,
) -> int:
    """Record at each position of the table; return how many frames had to be mended."""
    n_mended = 0
    if options.positions > 1:
        assert bench.table is not None
        bench.table.open()
    for position in range(options.positions):
        place = folder if options.positions == 1 else folder / f"{position:03d}"
        table = None
        if options.positions > 1 and bench.table is not None:
            reached_deg = bench.table.turn_to(360 * position / options.positions)
            table = TablePosition(angle=math.radians(reached_deg))
        exposed = [
            record(_exposed(devices, factor), plan, bench.rig, progress=reporter.step)
            for factor in options.series or (1.0,)
        ]
        _write(place, devices, exposed, options, bench, table)
        for recorded in exposed:
            n_mended += len(recorded.mended)
            for warning in recorded.warnings if not options.series else ():
                reporter.warn(warning)
    if options.positions > 1 and bench.table is not None:
        bench.table.close()
    return n_mended


def _exposed(devices: Devices, factor: float) -> Devices:
    """Expose by a multiple of the usual time."""
    wanted = {
        name: replace(settings, exposure_ms=settings.exposure_ms * factor)
        for name, settings in devices.settings.items()
    }
    if wanted == devices.settings:
        return devices
    made = {camera.name: camera.apply(wanted[camera.name]) for camera in devices.cameras}
    return replace(devices, settings=made)


def _write(
    folder: Path,
    devices: Devices,
    exposed: Sequence[Recorded],
    options: RecordOptions,
    bench: Bench,
    table: TablePosition | None,
) -> None:
    title = options.title or options.out.name
    scan, *series = (
        Scan(stacks=r.stacks, rig=bench.rig, title=title, table=table) for r in exposed
    )
    times = {settings.exposure_ms for settings in devices.settings.values()}
    same = times.pop() if len(times) == 1 and not options.series else None
    write_scan(folder, scan, series=series, exposures=options.series, exposure_ms=same)
    cameras = [
        {
            "name": name,
            "model": info.model,
            "exposure_ms": devices.settings[name].exposure_ms,
            "gain_db": devices.settings[name].gain_db,
            "times_s": [
                round(float(t), 6) for recorded in exposed for t in recorded.times_s[number]
            ],
        }
        for number, (name, info) in enumerate(devices.infos.items())
    ]
    mended = [
        {"image": m.image, "attempt": m.attempt, "kind": m.trouble.kind, "camera": m.trouble.camera,
         "text": m.trouble.text}
        for recorded in exposed for m in recorded.mended
    ]  # fmt: skip
    when = datetime.now(UTC).isoformat(timespec="seconds")
    full = {"version": __version__, "command": options.command, "recorded": when,
            "wait_ms": round(1000 * devices.wait_s, 3),
            "warnings": [w for recorded in exposed for w in recorded.warnings]}  # fmt: skip
    write_record_log(folder, full, cameras, mended)
