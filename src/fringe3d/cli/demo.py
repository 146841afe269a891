"""The embedded scan, measured and compared with its truth."""

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
from fringe3d.simulate import SphereScene, demo_rig, simulate

SEED = 7


def run_demo(out: Path, *, overwrite: bool, reporter: Reporter) -> str:
    """Render the scan, measure it, write both; return what to print."""
    rig = demo_rig()
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(16.0,), n_shifts=4)
    with new_folder(out, overwrite=overwrite) as folder:
        reporter.stage("rendering", of=6)
        scan, truths = simulate(rig, plan, SphereScene(), np.random.default_rng(SEED))
        write_scan(folder / "scan", scan)
        recording = read_scan(folder / "scan", progress=reporter.step)
        options = MeasureOptions()
        result = measure(recording, options, stage=reporter.stage)
        reporter.stage("writing")
        write_result(folder / "result", recording, options, result)
    assert result.points is not None
    good = result.points.is_valid
    error = np.linalg.norm(result.points.points_mm - truths[0].points_mm, axis=-1)[good]
    median_um, p95_um = 1000 * np.percentile(error, [50, 95])
    return (
        f"{summary(result)}\n"
        f"distance from the true points: median {median_um:.1f} um, 95 % below {p95_um:.1f} um\n"
        f"look at {out}/result/overview.png; the cloud is {out}/result/cloud.ply"
    )
