"""``fringe3d design``: what a rig needs and what it can do, printed and as a folder."""

from __future__ import annotations

import difflib
import json
import math
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fringe3d.cli.console import Reporter
from fringe3d.design import Assessment, Quality, assess, with_depth
from fringe3d.errors import Fringe3DError, MethodError
from fringe3d.io.atomic import new_folder, require_writable
from fringe3d.io.sketchfile import Sketch, read_sketch
from fringe3d.report.design import markdown, summary
from fringe3d.report.design_record import record

PERIOD_PX = 16.0
STEPS = 4
STAGES = 5
"""Four of the assessment, and the writing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignOptions:
    """What the user said on the command line; see ``fringe3d design --help``."""

    rig: str
    period_px: float | None = None
    angle_deg: float | None = None
    depth_mm: tuple[float, float] | None = None
    steps: int | None = None
    noise: float = 0.01
    calibration_px: float = 0.1
    camera_period_px: float | None = None
    beyond: float | None = None
    out: Path | None = None
    optimise: bool = False
    overwrite: bool = False


def run_design(options: DesignOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Assess a rig, write the report if asked; return what to print, and the record."""
    if options.out is not None:
        given = Path(options.rig)
        require_writable(options.out, overwrite=options.overwrite,
                         inputs=(given if given.exists() else None,))  # fmt: skip
    sketch = _load(options.rig)
    period = options.period_px or sketch.period_px or PERIOD_PX
    angle = sketch.angle if options.angle_deg is None else math.radians(options.angle_deg)
    name = Path(options.rig).stem
    try:
        quality = Quality(
            noise=options.noise,
            n_shifts=options.steps or sketch.n_shifts or STEPS,
            calibration_px=options.calibration_px,
        )
        a = assess(
            with_depth(sketch.rig, options.depth_mm),
            period_px=period,
            angle=angle,
            quality=quality,
            camera_period_px=options.camera_period_px,
            beyond=options.beyond,
            stage=lambda stage: reporter.stage(stage, of=STAGES),
        )
    except Fringe3DError:
        raise
    except ValueError as problem:
        raise MethodError(f"{problem}. See fringe3d design --help") from None
    command = shlex.join(["fringe3d", *sys.argv[1:]])
    found = record(a, name=name, command=command)
    if options.out is None:
        said, found = _with_optimised(options, a, None, found, reporter)
        return summary(a, name=name, **said), found
    with new_folder(options.out, overwrite=options.overwrite) as folder:
        said, found = _with_optimised(options, a, folder, found, reporter)
        reporter.stage("writing", of=STAGES)
        _write(folder, a, name, command, found, said)
    text = summary(a, name=name, **said)
    return f"{text}\n\n-> {options.out}", found | {"out": str(options.out)}


def _with_optimised(
    options: DesignOptions,
    a: Assessment,
    folder: Path | None,
    found: dict[str, Any],
    reporter: Reporter,
) -> tuple[dict[str, str], dict[str, Any]]:
    """Look for a better place of the projector if asked; return what to say, and the record."""
    if not options.optimise:
        return {}, found | {"optimised": None}
    from fringe3d.cli.optimiser import run_optimise

    better = run_optimise(a.rig, period_px=a.period_px, angle=a.angle, quality=a.quality,
                          out=folder, reporter=reporter, beyond=options.beyond or 0.0)  # fmt: skip
    said = {"advice": better.advice, "optimised": better.text}
    return said, found | {"optimised": better.record}


def _load(rig: str) -> Sketch:
    """Return a preset, or a rig or sketch from a file."""
    path = Path(rig)
    if path.exists() or path.suffix:
        return read_sketch(path)
    from fringe3d.simulate import PRESETS

    if rig not in PRESETS:
        close = difflib.get_close_matches(rig, PRESETS, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else "Name a file, or one of them"
        raise MethodError(
            f"rig: expected a rig file, a sketch, or one of the presets {', '.join(PRESETS)}, "
            f"found '{rig}'. {hint}"
        )
    preset = PRESETS[rig]((640, 512))
    return Sketch(rig=preset.rig, period_px=preset.period_px, angle=preset.fringe_angle)


def _write(
    folder: Path,
    a: Assessment,
    name: str,
    command: str,
    found: dict[str, Any],
    said: dict[str, str],
) -> None:
    """Write pictures, report, figures and the rig into the folder."""
    from fringe3d.io.rigfile import rig_text
    from fringe3d.report.design_maps import draw_maps
    from fringe3d.report.design_pictures import draw_rig, draw_segments

    title = f"Design of {name}"
    draw_rig(folder / "rig.png", a, title=title)
    draw_maps(folder / "maps.png", a, title=title)
    draw_segments(folder / "segments.png", a, title=title)
    pictures = [
        ("rig.png", "The rig from above and from the side, and its measuring volume."),
        ("maps.png", "Periods per segment (white: where one bit more is needed), predicted sigma "
                     "and ambiguity margin, over the pixels of the first camera."),
        ("segments.png", "Some pixels of the first camera and their epipolar segments."),
    ]  # fmt: skip
    if (folder / "tradeoff.png").exists():
        pictures.append(("tradeoff.png", "Where the projector could stand instead."))
    text = markdown(a, name=name, command=command, pictures=pictures, **said)
    (folder / "design.md").write_text(text, encoding="utf-8")
    (folder / "rig.toml").write_text(rig_text(a.rig), encoding="utf-8")
    (folder / "design.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
