"""A simulated scan, measured and compared with its truth."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np

from fringe3d.cli.console import Reporter
from fringe3d.cli.simulator import SimulateOptions, run_simulation
from fringe3d.io.atomic import new_folder
from fringe3d.io.recording import read_scan
from fringe3d.io.stored import read_result
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.report.folder import Request, summary, write_result
from fringe3d.report.measurement import report_html

SEED = 7
WRONG_MM = 0.5
"""Noise moves points by 0.01 mm; a wrong fringe order moves them by 6 mm, a mixed pixel by less."""


def run_demo(out: Path, *, overwrite: bool, reporter: Reporter) -> tuple[str, dict[str, Any]]:
    """Render the scan, measure it, write both; return what to print, and the same as data."""
    with new_folder(out, overwrite=overwrite) as folder:
        reporter.stage("rendering", of=6)
        run_simulation(
            SimulateOptions(
                preset="kolibri", thing="machine-part", plan="m2", seed=SEED, out=folder / "scan",
                steps=4, period_px=None, camera_size=(640, 512), background="table", n_rays=4,
                positions=1, tilts_deg=(0.0,), settings=None, overwrite=False,
            ),
            reporter,
        )  # fmt: skip
        recording = read_scan(folder / "scan", progress=reporter.step)
        options = MeasureOptions()
        result = measure(recording, options, stage=reporter.stage)
        reporter.stage("writing")
        command = shlex.join(["fringe3d", "demo", "--out", str(out)])
        request = Request(command=command, scan=out / "scan")
        write_result(folder / "result", recording, options, result, request=request)
        page = report_html(read_result(folder / "result"))
        (folder / "result" / "report.html").write_text(page, encoding="utf-8")
        with np.load(folder / "scan" / "truth.npz") as stored:
            reference = stored["lit"] & stored["in_volume"] & stored["seen_by_c2"]
            true_points = stored["points_mm"]
    assert result.points is not None
    good = result.points.is_valid
    error = np.linalg.norm(result.points.points_mm - true_points, axis=-1)[good]
    median_um, p95_um = 1000 * np.percentile(error, [50, 95])
    n_images = recording.stacks[0].plan.n_images
    found, wrong = float((good & reference).sum() / reference.sum()), (error > WRONG_MM).mean()
    record = {"out": str(out), "points": int(good.sum()), "n_images": n_images,
              "found_part": found, "median_error_um": float(median_um),
              "p95_error_um": float(p95_um), "wrong_part": float(wrong)}  # fmt: skip
    text = (
        f"{summary(result)}\n"
        f"{n_images} images; {found:.1%} of the {reference.sum():,} pixels that see a lit point in "
        "the volume which c2 sees, too\n"
        f"distance from the true points: median {median_um:.1f} um, 95 % below {p95_um:.1f} um, "
        f"{wrong:.2%} more than {WRONG_MM} mm\n"
        f"open {out}/result/report.html in a browser; the cloud is {out}/result/cloud.ply"
    )
    return text, record
