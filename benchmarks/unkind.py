"""Images that are not as in the textbook: gamma, surfaces bright and dark at once, noise.

    python -m benchmarks.unkind response     a projector's gamma taken out of the phase
    python -m benchmarks.unkind exposures    glossy, dark and white: several exposures together
    python -m benchmarks.unkind noise        the noise model of a camera, found from its images
    python -m benchmarks.unkind bricks       two periods of phaseshift-bricks (FRINGE3D_DATA)

Scans are rendered at 640 x 512 px; each figure is against the simulator's truth.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import (
    decode,
    fuse,
    noise_from_repeats,
    noise_from_steps,
    response_from_fringes,
)
from fringe3d.health.response import period_disagreement
from fringe3d.io.recording import read_scan
from fringe3d.model import ImageStack, Scan
from fringe3d.patterns import across, method_plan
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.simulate import (
    OBJECTS,
    PRESETS,
    CameraOptics,
    ProjectorOptics,
    Setup,
    Stage,
    Surface,
    prepare,
    record,
    record_exposures,
)

SIZE = (640, 512)
GAMMA = 2.2

SURFACES = (
    ("two-bodies", 20.0, (0.1, 0.6, 6.0)),
    ("machine-part", 25.0, (0.1, 0.6, 8.0)),
    ("machine-part", 12.0, (0.15, 0.8, 5.0)),
    ("plane", 16.0, (0.1, 0.6, 6.0)),
)
"""Object, width of its white and dark fields, mm, and exposures."""

CONTRAST, GLOSS = 0.98, 5.0
"""Of the fields, and of highlights against the light of white paper."""

CAMERAS = (
    (CameraOptics(full_well_e=1e4, read_noise_e=12.0, bit_depth=8), 1.0),
    (CameraOptics(full_well_e=5e3, read_noise_e=20.0, bit_depth=12), 1.0),
    (CameraOptics(full_well_e=2e3, read_noise_e=8.0, bit_depth=8), 1.0),
    (CameraOptics(full_well_e=1e4, read_noise_e=12.0, bit_depth=8), GAMMA),
)
"""Sensors, and the projector's gamma."""


def main() -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("response", "exposures", "noise", "bricks"))
    tables = {"response": response, "exposures": exposures, "noise": noise, "bricks": bricks}
    for row in tables[parser.parse_args().what]():
        print("| " + " | ".join(row) + " |", flush=True)


def staged(preset_name: str, thing: str, surface: Surface, setup: Setup) -> Stage:
    """Return a scene that is ready to be recorded."""
    preset = PRESETS[preset_name](SIZE)
    scene = preset.scene(OBJECTS[thing](), surface, background="table", scaled=True)
    return prepare(preset.rig, scene, setup)


def response() -> Iterator[tuple[str, ...]]:
    """Yield the phase error of one camera and a projector with a gamma, before and after."""
    yield "steps", "gamma found", "before, median and 95 %, rad", "after"
    quiet = CameraOptics(full_well_e=1e6, read_noise_e=1.0, bit_depth=12)
    preset = PRESETS["single"](SIZE)
    assert preset.rig.projector is not None
    stage = staged("single", "plane", Surface(),
                   Setup(camera=quiet, projector=ProjectorOptics(gamma=GAMMA)))  # fmt: skip
    for n_steps in (3, 4):
        plan = method_plan("m1", preset.rig.projector.shape, period_px=preset.period_px,
                           n_shifts=n_steps)  # fmt: skip
        stack = record(stage, plan, seed=1).stacks[0]
        found = response_from_fringes(stack)
        raw, mended = (phase_error(stage, s) for s in (stack, stack.with_response(found)))
        yield (
            str(n_steps),
            f"{found.gamma:.2f}",
            *(f"{half:.4f}, {most:.4f}" for half, most in (raw, mended)),
        )


def phase_error(stage: Stage, stack: ImageStack) -> tuple[float, float]:
    """Return the median and the 95 % of the phase error on the object, rad."""
    truth, projector = stage.truths[0], stage.rig.projector
    assert projector is not None
    phases = decode(stack, projector.shape).directions[0].main
    w = across(phases.angle, truth.projector_xy[..., 0], truth.projector_xy[..., 1])
    error = 2 * np.pi * (phases.position_px - w) / phases.period_px
    error = np.abs(error[np.isfinite(error) & truth.lit & truth.is_object])
    return float(np.median(error)), float(np.percentile(error, 95))


def exposures() -> Iterator[tuple[str, ...]]:
    """Yield which part of the pixels is measured by each exposure alone and by all together."""
    yield ("object, fields", "exposures", "each alone, %", "together, %",
           "of what any measures, %", "more than the best, points")  # fmt: skip
    preset = PRESETS["kolibri"](SIZE)
    assert preset.rig.projector is not None
    plan = method_plan("m1", preset.rig.projector.shape, period_px=preset.period_px, n_shifts=4)
    for thing, field_mm, light in SURFACES:
        surface = Surface(albedo=0.95, texture="checker", texture_mm=field_mm, contrast=CONTRAST,
                          gloss=GLOSS, gloss_exponent=60.0)  # fmt: skip
        stage = staged("kolibri", thing, surface, Setup(camera=CameraOptics(exposure=0.8)))
        truth = stage.truths[0]
        seen = truth.is_object & truth.lit & truth.in_volume & truth.seen_by["c2"]
        scans = record_exposures(stage, plan, light, seed=1)
        fused = tuple(fuse([s.stacks[i] for s in scans], light) for i in range(2))
        alone = [measured(scan) & seen for scan in scans]
        together = measured(replace(scans[0], stacks=fused)) & seen
        any_of_them = np.any(alone, axis=0)
        parts = [100 * one.sum() / seen.sum() for one in (*alone, together)]
        yield (f"{thing}, {field_mm:g} mm", ", ".join(f"{x:g}" for x in light),
               ", ".join(f"{part:.1f}" for part in parts[:-1]), f"{parts[-1]:.1f}",
               f"{100 * (together & any_of_them).sum() / any_of_them.sum():.2f}",
               f"{parts[-1] - max(parts[:-1]):+.1f}")  # fmt: skip


def measured(scan: Scan) -> NDArray[np.bool_]:
    """Return which pixels of C1 get a point."""
    points = measure(scan, MeasureOptions(method="m1")).points
    assert points is not None
    return points.is_valid


def noise() -> Iterator[tuple[str, ...]]:
    """Yield read noise and gain: true, from 16 steps, from two recordings of 4."""
    yield "sensor", "read noise, DN", "gain, DN per electron"
    preset = PRESETS["kolibri"](SIZE)
    assert preset.rig.projector is not None
    for camera, gamma in CAMERAS:
        stage = staged("kolibri", "machine-part", Surface(texture="mottled"),
                       Setup(camera=camera, projector=ProjectorOptics(gamma=gamma)))  # fmt: skip
        many, few = (
            method_plan("m1", preset.rig.projector.shape, period_px=preset.period_px, n_shifts=n)
            for n in (16, 4)
        )
        steps = replace(record(stage, many, seed=1).stacks[0], noise=None)
        repeats = [record(stage, few, seed=seed).stacks[0] for seed in (1, 2)]
        models = camera.noise, noise_from_steps(steps).model, noise_from_repeats(repeats).model
        yield (f"{camera.bit_depth} bit, full well {camera.full_well_e:,.0f}, gamma {gamma:g}",
               " / ".join(f"{m.read_noise_dn:.3f}" for m in models),
               " / ".join(f"{m.gain_dn_per_e:.4f}" for m in models))  # fmt: skip


def bricks() -> Iterator[tuple[str, ...]]:
    """Yield by how much the periods of a recording with gamma disagree, before and after."""
    yield "fringes", "response", "modulation, DN", "pixels", "median, px", "half of 95 %, px"
    folder = Path(os.environ["FRINGE3D_DATA"])
    stack = read_scan(Path("examples/captures/phaseshift-bricks.toml"), images=folder).stacks[0]
    taken = stack.with_response(response_from_fringes(stack))
    for name, one in (("as recorded", stack), ("self", taken)):
        for direction in decode(one, (1080, 1920)).directions:
            main, other = direction.main, direction.others[0]
            apart = period_disagreement(main, other)
            light = np.minimum(main.modulation, other.modulation)
            for least in (0, 20, 40):
                part = apart[np.isfinite(apart) & (light >= least)]
                low, high = np.percentile(part, [2.5, 97.5])
                angle = f"{np.degrees(main.angle):g} deg"
                yield (angle, name, f"{least} and more", f"{len(part):,}",
                       f"{np.median(np.abs(part)):.2f}", f"{(high - low) / 2:.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
