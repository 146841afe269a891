#!/usr/bin/env python3
"""Measure the recordings by others and print the table of docs/captures.md.

Usage: FRINGE3D_DATA=FOLDER python benchmarks/accuracy_captures.py [few]

With `few`: the bust from four of its images, against all of them (docs/evidence.md).
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import fit_projector, lit_points
from fringe3d.errors import Fringe3DError
from fringe3d.health import period_disagreement
from fringe3d.io.recording import read_scan
from fringe3d.model import Scan
from fringe3d.model.rejection import count_by_reason
from fringe3d.pipeline import Measurement, MeasureOptions, measure

ROOT = Path(__file__).parent.parent
DATA = Path(os.environ.get("FRINGE3D_DATA", ROOT.parent / "shared" / "data"))

RUNS = [
    *(("slmaster-relief", MeasureOptions(n_shifts=n)) for n in (12, 6, 4, 3)),
    *(("slmaster-relief", MeasureOptions(gray_bits=n, depth_mm=(680.0, 800.0))) for n in (5, 3, 1)),
    ("slmaster-bust-rendered", MeasureOptions()),
    *(
        ("slmaster-bust-rendered", MeasureOptions(gray_bits=n, depth_mm=(500.0, 680.0)))
        for n in (6, 5, 4, 3, 2)
    ),
    ("slmaster-bust-rendered", MeasureOptions(n_shifts=4)),
    ("sltk-shell-0020", MeasureOptions()),
    ("sltk-shell-0021", MeasureOptions()),
    ("phaseshift-bricks", MeasureOptions()),
]


def main() -> None:
    """Print one row for each run."""
    if not DATA.is_dir():
        sys.exit(f"{DATA}: expected the folder of the captures; set FRINGE3D_DATA")
    if sys.argv[1:] == ["few"]:
        four_images_of_the_bust()
        return
    print("| recording | options | method | points | z 0.1-99.9 %, mm | sigma, mm | mended | s |")
    print("|---|---|---|---|---|---|---|---|")
    for name, options in RUNS:
        scan = captured(name)
        start = time.perf_counter()
        try:
            result = measure(scan, options)
        except Fringe3DError as refusal:
            said = str(refusal).split(". ")[0]
            print(f"| {name} | {wording(options)} | refused | | {said} | | | |")
            continue
        print(row(name, options, result, time.perf_counter() - start))
        for finding in result.findings:
            print(f"<!-- {name}: {finding.level}: {finding.text} -->")
        print(f"<!-- {name}: {count_by_reason(result.rejection)} -->", flush=True)


def captured(name: str) -> Scan:
    """Read a recording by its description."""
    folder = name.removesuffix("-0020").removesuffix("-0021")
    return read_scan(ROOT / "examples" / "captures" / f"{name}.toml", images=DATA / folder)


def four_images_of_the_bust() -> None:
    """Find the projector by the full code, then measure with four images and no code.

    Prints which part of the points of the full code is there, and how many have another order:
    with the same rig and depth, and as two cameras without a projector find them.
    """
    scan = captured("slmaster-bust-rendered")
    assert scan.rig is not None
    shape = scan.stacks[0].plan.projector_shape
    assert shape is not None
    cameras = replace(scan, rig=replace(scan.rig, projector=None, volume=None, covariance=None))
    whole = measure(cameras, MeasureOptions(method="m1", drop_edges=True))
    assert whole.points is not None
    seen = lit_points(whole.points, [whole.main], scan.rig.cameras[0], name="bust")
    fitted = fit_projector([seen], shape)
    residual = float(np.nanmedian(np.abs(fitted.residual_px[0])))
    print(f"projector: half of the points within {residual:.3f} px", flush=True)
    rig = replace(scan.rig, projector=fitted.device, covariance=None)
    depth = (490.0, 680.0)
    few = measure(
        replace(scan, rig=rig),
        MeasureOptions(method="m6", n_shifts=4, gray_bits=0, depth_mm=depth),
    )
    same = measure(replace(scan, rig=rig), MeasureOptions(method="m1", depth_mm=depth))
    for what, full in (
        ("same rig and depth", same),
        ("two cameras alone", measure(cameras, MeasureOptions(method="m1"))),
    ):
        assert few.points is not None
        assert full.points is not None
        both = few.points.is_valid & full.points.is_valid
        # Next to a wrap the same point may have one order more and a period of phase less.
        other = int((np.abs(turns(few) - turns(full))[both] > 0.5).sum())
        print(f"full code, {what}: {full.points.n_points:,} points; with four images "
              f"{both.sum() / full.points.n_points:.2%} of them, {other:,} of {both.sum():,} "
              "with another order")  # fmt: skip


def turns(result: Measurement) -> NDArray[np.float64]:
    """Return the absolute phase, periods."""
    assert result.matches is not None
    return np.asarray(result.matches.fringe_order + result.main.phase / (2 * np.pi))


def wording(options: MeasureOptions) -> str:
    """Return the options in words."""
    given = [
        f"{n} steps" if (n := options.n_shifts) else "",
        f"{options.gray_bits} code images" if options.gray_bits is not None else "",
        "depth {:g}:{:g}".format(*options.depth_mm) if options.depth_mm else "",
    ]
    return ", ".join(filter(None, given)) or "all images"


def row(name: str, options: MeasureOptions, result: Measurement, seconds: float) -> str:
    """Return one row of the table."""
    if result.points is None:
        typical = [
            np.nanmedian(np.abs(period_disagreement(d.main, other)))
            for d in result.phases[0].directions
            for other in d.others
        ]
        depth = "periods disagree by " + " / ".join(f"{t:.1f}" for t in typical) + " px"
        n_points, sigma = int((result.rejection == 0).sum()), float("nan")
    else:
        good = result.points.is_valid
        low, high = np.percentile(result.points.points_mm[good, 2], [0.1, 99.9])
        depth, n_points = f"{low:.1f} to {high:.1f}", result.points.n_points
        sigma = float(np.median(result.points.sigma_mm[good]))
    return (
        f"| {name} | {wording(options)} | {result.method} | {n_points:,} | {depth} | {sigma:.3f} "
        f"| {result.main.n_mended:,} | {seconds:.1f} |"
    )


if __name__ == "__main__":
    main()
