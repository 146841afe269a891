"""Faults put into simulated scans: whether the doctor names them, and is silent on sound ones.

    python -m benchmarks.doctor faults                each fault in 20 seeded scans
    python -m benchmarks.doctor sound                 presets x objects, and FRINGE3D_DATA

Faults are put in by the simulator's imperfections, by reordering images, or by a wrong description:
nothing of the checks is used. Scans: 256 x 205 px, full Gray code, light and dark, 4, 5 or 8 steps.

All cases take a quarter of an hour, the sound scans as long; in parts, kept in a file:

    python -m benchmarks.doctor faults --cases 0:5 --only flicker motion --keep kept.json
    python -m benchmarks.doctor faults --cases 5:20 --keep kept.json       what is not kept yet
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.diagnosis import diagnose
from fringe3d.io.recording import read_scan
from fringe3d.model import (
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    Pattern,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.patterns import method_plan
from fringe3d.simulate import OBJECTS, PRESETS, Preset, Stage, prepare, record

SIZE = (256, 205)
RIGS = ("kolibri", "wide-depth", "face", "kolibri-m5", "designed", "single")
THINGS = ("machine-part", "teeth", "bust", "two-bodies", "sphere", "hand", "step-gauge")
STEPS = (4, 8, 5)

Generator = np.random.Generator
Change = Callable[[Stage, Generator], Stage]
Spoil = Callable[[Scan, Generator], Scan]


def main() -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("faults", "sound"))
    parser.add_argument("--cases", default=None, help="FIRST:END of cases or scans")
    parser.add_argument("--only", nargs="*", default=None, help="faults")
    parser.add_argument("--keep", type=Path, default=None, help="file of what was found before")
    options = parser.parse_args()
    kept = Kept(options.keep)
    ends = options.cases or ("0:20" if options.what == "faults" else "0:1000")
    cases = range(*(int(end) for end in ends.split(":")))
    if options.what == "sound":
        sound(cases, kept)
    else:
        faults(cases, options.only or [*RENDERED, *SPOILT], kept)


class Kept(dict[str, list[str]]):
    """What was found, kept in a file at once where one is named."""

    def __init__(self, path: Path | None) -> None:
        super().__init__(json.loads(path.read_text()) if path and path.exists() else {})
        self.path = path

    def __setitem__(self, key: str, value: list[str]) -> None:
        super().__setitem__(key, value)
        if self.path:
            self.path.write_text(json.dumps(self, indent=1))


def staged(number: int, *, cameras: int = 1) -> tuple[Preset, Stage, int]:
    """Return the rig, scene and number of steps of a case."""
    rigs = [name for name in RIGS if cameras == 1 or name != "single"]
    preset = PRESETS[rigs[number % len(rigs)]](SIZE)
    preset = replace(preset, rig=replace(preset.rig, cameras=preset.rig.cameras[:cameras]))
    thing = THINGS[number % len(THINGS)]
    stage = prepare(preset.rig, preset.scene(OBJECTS[thing]()))
    return preset, stage, STEPS[number % len(STEPS)]


def recorded(preset: Preset, stage: Stage, steps: int, seed: int, method: str = "m1") -> Scan:
    """Record a scan."""
    assert preset.rig.projector is not None
    plan = method_plan(method, preset.rig.projector.shape, period_px=preset.period_px,
                       n_shifts=steps, angle=preset.fringe_angle,
                       reduced_bits=preset.reduced_bits)  # fmt: skip
    return record(stage, plan, seed=seed)


def faults(cases: range, names: list[str], kept: Kept) -> None:
    """Put each fault into each case; print how often it is named, and what else is."""
    for number in cases:
        for name in names:
            key = f"{name}, {number}"
            if key in kept:
                continue
            rng = np.random.default_rng([number, sorted([*RENDERED, *SPOILT]).index(name)])
            kept[key] = [kind.value for kind in diagnose(faulty(name, number, rng)).kinds]
            if EXPECTED.get(name, name) not in kept[key]:
                print(f"# case {number}, {name}: {kept[key]}", flush=True)
        print(f"# case {number} done", flush=True)
    print("| fault | named | of | named besides |\n|---|---:|---:|---|")
    for name in names:
        expected = EXPECTED.get(name, name)
        found = {n: kinds for n in range(1000) if (kinds := kept.get(f"{name}, {n}")) is not None}
        n_named = sum(expected in kinds for kinds in found.values())
        others = {n: [k for k in kinds if k != expected] for n, kinds in found.items()}
        besides = "; ".join(f"{n}: {', '.join(more)}" for n, more in others.items() if more)
        print(f"| {name} | {n_named} | {len(found)} | {besides} |", flush=True)


CACHE: dict[tuple[int, int], tuple[Preset, Stage, int]] = {}
PLAIN: dict[tuple[int, int], Scan] = {}


def faulty(name: str, number: int, rng: Generator) -> Scan:
    """Return a scan with a fault."""
    cameras = 2 if name in OF_THE_RIG else 1
    key = (number, cameras)
    if key not in CACHE:
        CACHE.clear()
        CACHE[key] = staged(number, cameras=cameras)
    preset, stage, steps = CACHE[key]
    if name in RENDERED:
        return replace(recorded(preset, RENDERED[name](stage, rng), steps, number), rig=None)
    if key not in PLAIN:
        PLAIN.clear()
        PLAIN[key] = recorded(preset, stage, steps, number)
    found = SPOILT[name](PLAIN[key], rng)
    return found if name in OF_THE_RIG else replace(found, rig=None)


def camera(**ranges: tuple[float, float]) -> Change:
    """Return a change of the cameras' optics to values within ranges."""
    return lambda stage, rng: _with(stage, camera=_drawn(ranges, rng))


def projector(**ranges: tuple[float, float]) -> Change:
    """Return a change of the projector to values within ranges."""
    return lambda stage, rng: _with(stage, projector=_drawn(ranges, rng))


def _drawn(ranges: dict[str, tuple[float, float]], rng: Generator) -> dict[str, float]:
    return {key: float(rng.uniform(*ends)) for key, ends in ranges.items()}


def _with(stage: Stage, **changes: dict[str, Any]) -> Stage:
    """Return the stage with other optics or events; rays are cast again where they differ."""
    setup = replace(
        stage.setup, **{part: replace(getattr(stage.setup, part), **values)
                        for part, values in changes.items()}
    )  # fmt: skip
    if any("blur_px" in values for values in changes.values()):
        return prepare(stage.rig, stage.scene, setup)
    return replace(stage, setup=setup)


def dropped(stage: Stage, rng: Generator) -> Stage:
    """Lose one image."""
    return _with(stage, recording={"dropped": (int(rng.integers(0, 11)),)})


def repeated(stage: Stage, rng: Generator) -> Stage:
    """Show one pattern twice, and the one after it not at all."""
    return _with(stage, recording={"repeated": (int(rng.integers(1, 13)),)})


def moving(stage: Stage, rng: Generator) -> Stage:
    """Let the object move by 1 to 2 % of its size during the recording, in any direction."""
    size = float(np.ptp(stage.scene.thing.vertices_mm, axis=0).max())
    way = rng.normal(size=3)
    path = rng.uniform(0.01, 0.02) * size * way / np.linalg.norm(way)
    seconds = 13 * stage.setup.recording.frame_ms / 1000
    return _with(stage, recording={"velocity_mm_s": tuple((path / seconds).tolist())})


RENDERED: dict[str, Change] = {
    "saturation": camera(exposure=(1.6, 3.0)),
    "too-dark": camera(exposure=(0.04, 0.12)),
    "gamma of the projector": projector(gamma=(1.4, 2.4)),
    "gamma of the camera": camera(gamma=(0.4, 0.7)),
    "defocus of the projector": projector(blur_px=(4.5, 6.0)),
    "flicker": projector(flicker=(0.02, 0.05)),
    "vibration": projector(vibration_px=(0.4, 0.8)),
    "motion": moving,
    "missing-image": dropped,
    "repeated-image": repeated,
}

EXPECTED = {
    "gamma of the projector": "gamma",
    "gamma of the camera": "gamma",
    "defocus of the projector": "defocus",
    "vibration": "movement",
    "motion": "movement",
}


def _each(scan: Scan, change: Callable[[ImageStack], ImageStack]) -> Scan:
    return replace(scan, stacks=tuple(change(stack) for stack in scan.stacks))


def _described(scan: Scan, change: Callable[[Pattern], Pattern]) -> Scan:
    """Return the scan, described differently from what was projected."""
    plan = scan.stacks[0].plan
    other = replace(plan, patterns=tuple(change(p) for p in plan.patterns))
    return _each(scan, lambda stack: replace(stack, plan=other))


def exchanged(scan: Scan, rng: Generator) -> Scan:
    """Exchange two images; of four steps not those that only turn the direction of the shift."""
    n = scan.stacks[0].plan.n_images
    steps = sum(isinstance(p, Fringe) for p in scan.stacks[0].plan.patterns)
    while True:
        first, second = (int(i) for i in rng.choice(n, 2, replace=False))
        if not (steps == 4 and {first, second} == {1, 3}):
            break
    order = list(range(n))
    order[first], order[second] = second, first
    return _each(scan, lambda stack: replace(stack, images=stack.images[order]))


def reversed_shift(scan: Scan, _rng: Generator) -> Scan:
    """Say that the fringes move the other way."""
    return _described(scan, lambda p: replace(p, shift=-p.shift) if isinstance(p, Fringe) else p)


def other_period(scan: Scan, rng: Generator) -> Scan:
    """Give a period that is wrong by 5 % or more."""
    factor = float(rng.choice([0.5, 0.8, 0.9, 0.95, 1.05, 1.1, 1.25, 2.0]))
    return _described(
        scan, lambda p: replace(p, period_px=p.period_px * factor) if isinstance(p, Fringe) else p
    )


def inverted(scan: Scan, _rng: Generator) -> Scan:
    """Say that the Gray code is bright where it is dark."""
    return _described(
        scan, lambda p: replace(p, inverted=not p.inverted) if isinstance(p, GrayBit) else p
    )


def lsb_first(scan: Scan, _rng: Generator) -> Scan:
    """Say that the Gray code begins with its finest image."""
    return _described(
        scan, lambda p: replace(p, bit=p.n_bits - 1 - p.bit) if isinstance(p, GrayBit) else p
    )


def other_rig(scan: Scan, rng: Generator) -> Scan:
    """Turn one camera by 1 to 3 degrees about its centre."""
    assert scan.rig is not None
    cameras = list(scan.rig.cameras)
    place = int(rng.integers(len(cameras)))
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(rng.uniform(1, 3)) * axis / np.linalg.norm(axis))
    knock = RigidTransform(rotation=turn.as_matrix(), translation=np.zeros(3))
    device = cameras[place]
    cameras[place] = replace(device, device_from_world=knock @ device.device_from_world)
    return replace(scan, rig=replace(scan.rig, cameras=tuple(cameras)))


def names_exchanged(scan: Scan, _rng: Generator) -> Scan:
    """Give each camera's images the other's name."""
    first, second = scan.stacks
    return replace(scan, stacks=(replace(second, device_name=first.device_name),
                                 replace(first, device_name=second.device_name)))  # fmt: skip


def volume_elsewhere(scan: Scan, rng: Generator) -> Scan:
    """Put the measuring volume 1.2 to 2 of its heights (at least 60 mm) above or below."""
    assert scan.rig is not None
    assert scan.rig.volume is not None
    return replace(scan, rig=_shifted(scan.rig, float(rng.uniform(1.2, 2) * rng.choice([-1, 1]))))


def _shifted(rig: Rig, heights: float) -> Rig:
    assert rig.volume is not None
    up = np.array([0.0, 0.0, 1.0])
    normals, offsets = rig.volume.normals, rig.volume.offsets_mm
    height = offsets[normals @ up > 0.99][0] + offsets[normals @ up < -0.99][0]
    step = heights * max(height, 60.0) * up
    moved = MeasuringVolume(normals=normals, offsets_mm=offsets + normals @ step)
    return replace(rig, volume=moved)


OF_THE_RIG = ("cameras-exchanged", "wrong-calibration", "outside-volume")
"""Faults of scans with two cameras and their rig; the images of one camera show the others."""

SPOILT: dict[str, Spoil] = {
    "exchanged-images": exchanged,
    "shift-direction": reversed_shift,
    "wrong-period": other_period,
    "gray-polarity": inverted,
    "gray-bit-order": lsb_first,
    "outside-volume": volume_elsewhere,
    "wrong-calibration": other_rig,
    "cameras-exchanged": names_exchanged,
}


def sound(numbers: range, kept: Kept) -> None:
    """Print what the doctor says of sound scans."""
    for name, make in [*sound_scans(), *captures()][numbers.start : numbers.stop]:
        if name not in kept:
            faults = diagnose(make()).faults
            kept[name] = [f"{fault.kind.value} ({fault.value:.3g})" for fault in faults]
        print(f"{name}: {', '.join(kept[name]) or 'sound'}", flush=True)
    print(f"{len(kept)} scans, {sum(bool(kinds) for kinds in kept.values())} with faults")


def sound_scans() -> Iterator[tuple[str, Callable[[], Scan]]]:
    """Yield scans of every rig with several objects and plans, to be made."""
    number = 0
    for rig in PRESETS:
        for thing in list(OBJECTS)[number % 2 :: 2]:
            method = ("m1", "m2", "m1")[number % 3]
            yield f"{rig}, {thing}, {method}", partial(sound_scan, rig, thing, method, number)
            number += 1


def sound_scan(rig: str, thing: str, method: str, number: int) -> Scan:
    """Record one of them."""
    preset = PRESETS[rig](SIZE)
    stage = prepare(preset.rig, preset.scene(OBJECTS[thing]()))
    return recorded(preset, stage, (4, 8, 3, 5)[number % 4], number, method)


def captures() -> Iterator[tuple[str, Callable[[], Scan]]]:
    """Yield the recordings by others, where they are, to be read."""
    folder = os.environ.get("FRINGE3D_DATA")
    for file in sorted(Path("examples/captures").glob("*.toml")) if folder else ():
        if file.stem == "procam-board":
            for pose in sorted((Path(str(folder)) / file.stem).glob("capture_*")):
                yield f"{file.stem}, {pose.name}", partial(read_scan, file, images=pose)
        elif not file.stem.endswith("-rig"):
            yield file.stem, partial(read_scan, file, images=Path(str(folder)))


if __name__ == "__main__":
    main()
