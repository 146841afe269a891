"""A simulated scan, measured and compared with its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringe3d.cli.console import Reporter
from fringe3d.io.atomic import new_folder
from fringe3d.io.recording import read_scan
from fringe3d.io.scanfolder import write_scan
from fringe3d.patterns import sequence
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.report.folder import summary, write_result
from fringe3d.simulate import OBJECTS, PRESETS, Surface, prepare, record

SEED = 7
WRONG_MM = 0.5
"""Nothing but a wrong fringe order moves a point that far on this rig: a period is 6 mm."""


def run_demo(out: Path, *, overwrite: bool, reporter: Reporter) -> str:
    """Render the scan, measure it, write both; return what to print."""
    preset = PRESETS["kolibri"]((640, 512))
    assert preset.rig.projector is not None
    # One bit more than the volume needs: the table below it must not be taken for a part of it.
    plan = sequence(preset.rig.projector.shape, periods_px=(preset.period_px,), n_shifts=4,
                    gray_bits=preset.reduced_bits + 1)  # fmt: skip
    with new_folder(out, overwrite=overwrite) as folder:
        reporter.stage("rendering", of=6)
        scene = preset.scene(OBJECTS["machine-part"](), Surface(texture="mottled", contrast=0.15))
        stage = prepare(preset.rig, scene, progress=reporter.step)
        scan = record(stage, plan, seed=SEED, title="a machine part, simulated")
        write_scan(folder / "scan", scan)
        recording = read_scan(folder / "scan", progress=reporter.step)
        options = MeasureOptions()
        result = measure(recording, options, stage=reporter.stage)
        reporter.stage("writing")
        write_result(folder / "result", recording, options, result)
    assert result.points is not None
    truth = stage.truths[0]
    reference = truth.lit & truth.in_volume & truth.seen_by["c2"]
    good = result.points.is_valid
    error = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)[good]
    median_um, p95_um = 1000 * np.percentile(error, [50, 95])
    return (
        f"{summary(result)}\n"
        f"{plan.n_images} images; {(good & reference).sum() / reference.sum():.1%} of the "
        f"{reference.sum():,} pixels that see a lit point which c2 sees, too\n"
        f"distance from the true points: median {median_um:.1f} um, 95 % below {p95_um:.1f} um, "
        f"{(error > WRONG_MM).mean():.2%} more than {WRONG_MM} mm\n"
        f"look at {out}/result/overview.png; the cloud is {out}/result/cloud.ply"
    )
