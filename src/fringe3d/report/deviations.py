"""The comparison of a cloud with another one, or a mesh: words, figures, a coloured map."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.evaluate import Deviations
from fringe3d.io.atomic import new_folder
from fringe3d.io.results import write_coloured_ply
from fringe3d.report.acceptance import means_on_grid, n_cells, seen_along
from fringe3d.report.maps import deviation_colours

Floats = NDArray[np.float64]

MAP = "RdBu_r"
HELD_BY_SCALE = 0.98
BARS = 81


def deviation_record(d: Deviations, /, *, tolerance_mm: float | None = None) -> dict[str, Any]:
    """Return the figures of a comparison as plain data."""
    record: dict[str, Any] = {
        "points": len(d.signed_mm),
        "compared": len(d.known),
        "without_reference": d.n_alone,
        "reach_mm": d.reach_mm,
        "mean_mm": d.mean_mm,
        "median_mm": float(np.median(d.known)),
        "sigma_mm": float(d.known.std()),
        "rms_mm": d.rms_mm,
        "median_size_mm": d.quantile_mm(0.5),
        "size95_mm": d.quantile_mm(0.95),
        "width95_mm": d.width95_mm,
        "largest_mm": d.quantile_mm(1.0),
    }
    if not math.isnan(d.covered):
        record["covered"] = d.covered
    if tolerance_mm is not None:
        record |= {"tolerance_mm": tolerance_mm, "within_tolerance": d.within(tolerance_mm)}
    return record


def deviation_text(record: dict[str, Any], /) -> str:
    """Return the comparison in one line, with units."""
    parts = [
        f"{record['compared']:,} of {record['points']:,} points compared (reference within "
        f"{record['reach_mm']:.3g} mm): mean {1000 * record['mean_mm']:+.1f} um, sigma "
        f"{1000 * record['sigma_mm']:.1f} um, median size {1000 * record['median_size_mm']:.1f} um,"
        f" 95 % below {1000 * record['size95_mm']:.1f} um"
    ]
    if "covered" in record:
        parts.append(f"{100 * record['covered']:.1f}% of the reference covered")
    if "within_tolerance" in record:
        part, limit = 100 * record["within_tolerance"], 1000 * record["tolerance_mm"]
        parts.append(f"{part:.2f}% within {limit:g} um")
    return "; ".join(parts)


def deviation_markdown(record: dict[str, Any], /, *, command: str) -> str:
    """Return the report as Markdown; overview.png lies beside it."""
    words = {
        "mean_mm": "mean", "median_mm": "median", "sigma_mm": "sigma", "rms_mm": "rms",
        "median_size_mm": "half of the sizes are below", "size95_mm": "95 % of them below",
        "width95_mm": "shortest interval with 95 %", "largest_mm": "largest size",
    }  # fmt: skip
    rows = [f"| {word} | {1000 * record[key]:.2f} |" for key, word in words.items()]
    return "\n".join([
        f"# {record['cloud']} against {record['reference']}", "", deviation_text(record) + ".", "",
        "![deviations](overview.png)", "", "| deviation | um |", "|---|---|", *rows, "",
        "Deviations are square to the reference (the plane of its twelve nearest points, or the "
        "nearest triangle), positive in front of it (outside a mesh). Points without a reference "
        "near them are grey in `deviations.ply`.", "", f"`{command}`", "",
    ])  # fmt: skip


def write_deviations(
    out: Path,
    points_mm: Floats,
    viewpoint_mm: Floats,
    deviations: Deviations,
    record: dict[str, Any],
    markdown: str,
    /,
    *,
    overwrite: bool = False,
) -> None:
    """Write ``compare.md``, ``compare.json``, ``overview.png`` and ``deviations.ply``."""
    limit = max(deviations.quantile_mm(HELD_BY_SCALE), 1e-9)
    with new_folder(out, overwrite=overwrite) as folder:
        (folder / "compare.md").write_text(markdown, encoding="utf-8")
        (folder / "compare.json").write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        draw_deviations(folder / "overview.png", points_mm, viewpoint_mm, deviations,
                        limit_mm=limit, title=deviation_text(record))  # fmt: skip
        signed = deviations.signed_mm
        write_coloured_ply(
            folder / "deviations.ply", points_mm, deviation_colours(signed, limit),
            viewpoint_mm=viewpoint_mm, deviation_mm=signed,
        )  # fmt: skip


def draw_deviations(
    path: Path,
    points_mm: Floats,
    viewpoint_mm: Floats,
    deviations: Deviations,
    /,
    *,
    limit_mm: float,
    title: str,
) -> None:
    """Draw deviations as a map seen from the viewpoint, and their histogram.

    Parameters
    ----------
    path : PNG to write
    points_mm : (n, 3) float, mm
    viewpoint_mm : (3,) float, mm
    deviations : Deviations of these points
    limit_mm : float, mm; end of the scale of colours
    title : str
    """
    known = np.isfinite(deviations.signed_mm)
    flat = seen_along(points_mm, points_mm.mean(axis=0) - viewpoint_mm) * [1, -1]
    picture, extent = means_on_grid(
        flat[known], 1000 * deviations.signed_mm[known], n_cells(int(known.sum()))
    )
    figure = Figure(figsize=(14.5, 7.2), dpi=100, layout="constrained")
    figure.suptitle("\n".join(title.split("; ")), fontsize=11, x=0.01, ha="left")
    left, right = figure.subplots(1, 2, width_ratios=[2.2, 1])
    limit = 1000 * limit_mm
    left.plot(*flat[~known][::10].T, ",", color="#777777")
    image = left.imshow(picture, cmap=MAP, vmin=-limit, vmax=limit, extent=extent,
                        interpolation="nearest")  # fmt: skip
    left.set_aspect("equal")
    left.set_facecolor("#101216")
    left.set_xlabel("mm, seen from the viewpoint", fontsize=9)
    bar = figure.colorbar(image, ax=left, shrink=0.9, pad=0.01, extend="both")
    bar.set_label("deviation, um: positive in front of the reference", fontsize=9)
    values = np.clip(1000 * deviations.known, -1.5 * limit, 1.5 * limit)
    right.hist(values, np.linspace(-1.5 * limit, 1.5 * limit, BARS).tolist(), color="#54657e")
    right.axvline(0, color="black", linewidth=0.6)
    right.set_xlabel("deviation, um (what lies beyond is in the last bars)", fontsize=9)
    right.set_yticks([])
    figure.savefig(path)
