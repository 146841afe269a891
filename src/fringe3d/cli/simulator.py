"""Simulated scans: a scan folder, its truth and the settings that made it."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.cli.board_simulator import (
    BoardSeries,
    board_series,
    is_board,
    write_series_truth,
)
from fringe3d.cli.console import Reporter
from fringe3d.cli.simulation_words import parse_axis_off, parse_knock
from fringe3d.cli.stage_cache import prepare_cached
from fringe3d.errors import Fringe3DError, MethodError, PlanError
from fringe3d.io.atomic import new_folder, require_writable
from fringe3d.io.rigfile import rig_text
from fringe3d.io.scanfile import read_plan
from fringe3d.io.scanfolder import write_scan
from fringe3d.io.simulation import read_settings, settings_text, write_truth
from fringe3d.model import NO_ORDER, PatternPlan, Rig, TableAxis, TablePosition
from fringe3d.patterns import across, method_plan
from fringe3d.report.simulation import draw_scene
from fringe3d.simulate import (
    OBJECTS,
    PRESETS,
    CameraOptics,
    Preset,
    ProjectorOptics,
    Recording,
    Scene,
    Setup,
    Stage,
    Surface,
    Truth,
    from_file,
    knocked,
    record,
    record_exposures,
    table_axis,
    table_positions,
    turntable,
)
from fringe3d.simulate.objects import MESH_SUFFIXES

KINDS = {
    "surface": Surface,
    "camera": CameraOptics,
    "projector": ProjectorOptics,
    "recording": Recording,
}

HEAD = ("preset", "object", "plan", "seed", "position", "steps", "period_px", "camera_size",
        "background", "rays", "knock", "axis_off", "angle_error_deg")  # fmt: skip
"""Keys of a ``simulation.toml`` that repeat the command line; as settings they are not read."""

BOARD_HEAD = ("bend_mm", "print_error_mm")
"""More of them, of a board."""


Stages = Callable[[int], Stage]


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateOptions:
    """What the user said on the command line; see ``fringe3d simulate --help``."""

    preset: str
    thing: str
    plan: str
    seed: int
    out: Path
    steps: int
    period_px: float | None
    camera_size: tuple[int, int]
    background: str
    n_rays: int
    positions: int
    tilts_deg: tuple[float, ...]
    settings: Path | None
    overwrite: bool
    bend_mm: float = 0.0
    print_error_mm: float = 0.0
    knocks: tuple[str, ...] = ()
    axis_off: str = "0mm:0deg"
    angle_error_deg: float = 0.0

    @property
    def is_turned(self) -> bool:
        """Tell whether the object stands on a rotary table."""
        return self.positions > 1 and not is_board(self.thing)


def run_simulation(options: SimulateOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Render, write the scan (or a series of scans) and its truth; return what to print, and the
    same as plain data."""
    preset = _preset(options)
    require_writable(options.out, overwrite=options.overwrite, inputs=_inputs(options))
    settings = _settings(options)
    rig = _knocked(preset.rig, options)
    try:
        plan = _plan(options, preset)
        series = _series(options, preset)
        setup = Setup(camera=settings["camera"], projector=settings["projector"],
                      recording=settings["recording"], n_rays=options.n_rays)  # fmt: skip
        scenes = (
            series.scenes(preset, settings["surface"], options.background)
            if series is not None
            else _turned(options, preset, settings["surface"])
        )
        with new_folder(options.out, overwrite=options.overwrite) as folder:
            for number, turned in enumerate(scenes):
                stage = prepare_cached(preset.rig, turned, setup, progress=reporter.step)
                is_one = len(scenes) == 1 and series is None
                place = folder if is_one else folder / f"{number:03d}"
                _write(place, stage, plan, options, settings, number, reporter, rig)
            if series is not None:
                write_series_truth(folder, series, rig)
                _write_true_rig(folder, preset.rig, options)
            if len(scenes) > 1:
                draw_scene(folder / "overview.png", stage, plan, title=_title(options))
    except Fringe3DError:
        raise
    except ValueError as problem:
        raise MethodError(f"{problem}. See fringe3d simulate --help") from None
    scans = "a scan" if len(scenes) == 1 else f"{len(scenes)} scans"
    width, height = options.camera_size
    record = {"out": str(options.out), "n_scans": len(scenes), "n_images": plan.n_images,
              "cameras": [camera.name for camera in preset.rig.cameras],
              "camera_size": [width, height]}  # fmt: skip
    text = (
        f"{scans} of {plan.n_images} images, {len(preset.rig.cameras)} camera(s) {width} x "
        f"{height} px, with truth -> {options.out}"
    )
    return text, record


def stages_of(options: SimulateOptions, reporter: Reporter, /) -> tuple[Preset, Stages]:
    """Return the rig, and a function that prepares the scene at a position of the table."""
    preset, settings = _preset(options), _settings(options)
    setup = Setup(camera=settings["camera"], projector=settings["projector"],
                  recording=settings["recording"], n_rays=options.n_rays)  # fmt: skip
    scenes = _turned(options, preset, settings["surface"])

    def stage(position: int) -> Stage:
        return prepare_cached(preset.rig, scenes[position], setup, progress=reporter.step)

    return preset, stage


def _knocked(rig: Rig, options: SimulateOptions) -> Rig:
    """Return the rig as it was calibrated, before devices moved."""
    names = [device.name for device in rig.devices]
    for text in options.knocks:
        name, turn_deg, shift_mm = parse_knock(text)
        if name not in names:
            raise MethodError(
                f"--knock '{text}': expected one of the devices {', '.join(names)}, found '{name}'"
            )
        seed = [options.seed, names.index(name)]
        rig = knocked(rig, name, turn_deg=turn_deg, shift_mm=shift_mm, seed=seed)
    return rig


def _write_true_rig(folder: Path, rig: Rig, options: SimulateOptions) -> None:
    """Write the rig that recorded, where it is not that of the scan."""
    if options.knocks:
        (folder / "true-rig.toml").write_text(rig_text(rig), encoding="utf-8")


def _series(options: SimulateOptions, preset: Preset) -> BoardSeries | None:
    """Return the series of a board, where the object is one."""
    if not is_board(options.thing):
        return None
    return board_series(
        options.thing,
        preset,
        n_poses=options.positions,
        bend_mm=options.bend_mm,
        print_error_mm=options.print_error_mm,
        seed=options.seed,
    )


def _turned(options: SimulateOptions, preset: Preset, surface: Surface) -> list[Scene]:
    """Return the object on its table, in all positions."""
    scene = preset.scene(_thing(options), surface, background=options.background,
                         scaled=options.thing in OBJECTS)  # fmt: skip
    axis = _axis(options)
    return list(turntable(scene, n_positions=options.positions, tilts_deg=options.tilts_deg,
                          axis=axis, angle_error_deg=options.angle_error_deg,
                          seed=options.seed))  # fmt: skip


def _axis(options: SimulateOptions) -> TableAxis:
    off_mm, lean_deg = parse_axis_off(options.axis_off)
    return table_axis(off_mm=off_mm, lean_deg=lean_deg, seed=options.seed)


def _preset(options: SimulateOptions) -> Preset:
    if options.preset not in PRESETS:
        raise MethodError(
            f"preset: expected one of {', '.join(PRESETS)}, found '{options.preset}'. "
            f"{_hint(options.preset, PRESETS)}"
        )
    return PRESETS[options.preset](options.camera_size)


def _hint(typed: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(typed, list(known), n=1)
    return f"Did you mean '{close[0]}'?" if close else "Choose one of them"


def _inputs(options: SimulateOptions) -> tuple[Path | None, ...]:
    """Return the files that go in, which the output must not replace."""
    in_words = options.thing in OBJECTS or ":" in options.thing
    thing = None if in_words else Path(options.thing)
    plan = Path(options.plan) if options.plan.endswith(".toml") else None
    return thing, plan, options.settings


def _settings(options: SimulateOptions) -> dict[str, Any]:
    if options.settings is None:
        return {name: kind() for name, kind in KINDS.items()}
    return read_settings(options.settings, KINDS, ignored=HEAD + BOARD_HEAD)


def _plan(options: SimulateOptions, preset: Preset) -> PatternPlan:
    assert preset.rig.projector is not None
    shape = preset.rig.projector.shape
    if options.plan.endswith(".toml"):
        plan = read_plan(Path(options.plan))
        if plan.projector_shape not in (None, shape):
            rows, cols = plan.projector_shape or (0, 0)
            raise PlanError(
                f"{options.plan}: expected a plan for {shape[1]} x {shape[0]} projector pixels, "
                f"found one for {cols} x {rows}. Make it for the projector of '{options.preset}'"
            )
        return PatternPlan(patterns=plan.patterns, projector_shape=shape)
    return method_plan(
        options.plan,
        shape,
        period_px=options.period_px or preset.period_px,
        n_shifts=options.steps,
        reduced_bits=preset.reduced_bits,
        angle=preset.fringe_angle,
    )


def _thing(options: SimulateOptions) -> Any:
    if options.thing in OBJECTS:
        return OBJECTS[options.thing]()
    path = Path(options.thing)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MethodError(
            f"--object: expected one of {', '.join(OBJECTS)}, or a mesh file "
            f"({', '.join(MESH_SUFFIXES)}), found '{options.thing}'. "
            f"{_hint(options.thing, OBJECTS)}"
        )
    return from_file(path)


def _write(
    folder: Path,
    stage: Stage,
    plan: PatternPlan,
    options: SimulateOptions,
    settings: dict[str, Any],
    number: int,
    reporter: Reporter,
    rig: Rig,
) -> None:
    exposures = stage.setup.recording.exposures
    if exposures:
        scan, *series = record_exposures(stage, plan, exposures, seed=options.seed,
                                         title=_title(options))  # fmt: skip
    else:
        scan, series = record(stage, plan, seed=options.seed, position=number,
                              title=_title(options), progress=reporter.step), []  # fmt: skip
    scan = replace(scan, rig=rig, table=_position(options, number))
    write_scan(folder, scan, series=series, exposures=exposures)
    _write_true_rig(folder, stage.rig, options)
    n_dropped = len(set(stage.setup.recording.dropped))
    for place in range(plan.n_images - n_dropped, plan.n_images):
        for stack in scan.stacks:  # what was dropped is missing at the end
            (folder / stack.device_name / f"{place:03d}.png").unlink()
    maps = truth_maps(stage.truths, plan)
    maps["world_from_object"] = np.eye(4)
    maps["world_from_object"][:3, :3] = stage.scene.world_from_object.rotation
    maps["world_from_object"][:3, 3] = stage.scene.world_from_object.translation
    if options.is_turned:
        axis = _axis(options)
        maps |= {"table_point_mm": axis.point_mm, "table_direction": axis.direction}
    write_truth(folder / "truth.npz", maps)
    head = {
        "preset": options.preset, "object": options.thing, "plan": options.plan,
        "seed": options.seed, "position": number, "steps": options.steps,
        "camera_size": list(options.camera_size), "background": options.background,
        "rays": options.n_rays,
    } | ({"bend_mm": options.bend_mm, "print_error_mm": options.print_error_mm}
         if is_board(options.thing) else {})  # fmt: skip
    if options.period_px is not None:
        head["period_px"] = options.period_px
    if options.knocks:
        head["knock"] = list(options.knocks)
    if options.is_turned:
        head |= {"axis_off": options.axis_off, "angle_error_deg": options.angle_error_deg}
    (folder / "simulation.toml").write_text(settings_text(head, settings), encoding="utf-8")
    draw_scene(folder / "overview.png", stage, plan, title=_title(options))


def _position(options: SimulateOptions, number: int) -> TablePosition | None:
    """Return what the table's controller says; None where there is no table."""
    if not options.is_turned:
        return None
    return table_positions(options.positions, options.tilts_deg)[number]


def truth_maps(truths: Sequence[Truth], plan: PatternPlan) -> dict[str, NDArray[Any]]:
    """Return the true maps by name: those of C1 plain, of others with the suffix ``_c2``, ..."""
    maps: dict[str, NDArray[Any]] = {}
    for number, truth in enumerate(truths):
        suffix = "" if number == 0 else f"_{truth.device_name}"
        maps |= {
            f"points_mm{suffix}": truth.points_mm,
            f"normals{suffix}": truth.normals.astype(np.float32),
            f"projector_xy{suffix}": truth.projector_xy,
            f"in_volume{suffix}": truth.in_volume,
            f"lit{suffix}": truth.lit,
            f"is_object{suffix}": truth.is_object,
        }
        for name, pixels in truth.pixels.items():
            maps[f"pixels_{name}{suffix}"] = pixels
            maps[f"seen_by_{name}{suffix}"] = truth.seen_by[name]
        if plan.fringe_sets:
            maps[f"fringe_order{suffix}"] = _fringe_order(truth, plan)
    return maps


def _fringe_order(truth: Truth, plan: PatternPlan) -> NDArray[np.int32]:
    """Return the order of the first fringes of the plan; `NO_ORDER` where nothing is seen."""
    fringes = plan.fringe_sets[0]
    w = across(fringes.angle, truth.projector_xy[..., 0], truth.projector_xy[..., 1])
    return np.nan_to_num(np.floor(w / fringes.period_px), nan=NO_ORDER).astype(np.int32)


def _title(options: SimulateOptions) -> str:
    thing = options.thing if ":" in options.thing else Path(options.thing).stem
    return f"{thing} on {options.preset}, plan {Path(options.plan).stem}"
