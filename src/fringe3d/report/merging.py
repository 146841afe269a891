"""The report of a merge: figures as data, in words, as Markdown with pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fringe3d.model import FATES, MergedCloud, Registration, SurfaceMesh, SurfaceView
from fringe3d.register import odd_views
from fringe3d.report.recalibration import recalibration_lines, recalibration_text

OPEN_CLOSURE = 5.0
"""Closure over the residuals of the overlaps, from which on the way round does not close."""

NOTE = (
    "A view's sigma is that of its place at the middle of the body, relative to the first view; "
    "the axis is given in the world frame of the rig, at the height of the body's middle."
)


def merge_record(
    views: Sequence[SurfaceView], found: Registration, cloud: MergedCloud, /
) -> dict[str, Any]:
    """Return the figures of a merge as plain data."""
    pairs = found.after
    names = [view.name for view in views]
    record: dict[str, Any] = {
        "views": [_view_record(k, view, found, cloud) for k, view in enumerate(views)],
        "points": len(cloud.points_mm),
        "points_of_views": sum(cloud.counts().values()),
        "fates": {fate.name.lower(): count for fate, count in cloud.counts().items()},
        "sigma_um": 1000 * float(np.median(cloud.sigma_mm)),
        "sigma_of_views_um": 1000 * float(np.median([np.nanmedian(v.sigma_mm) for v in views])),
        "views_at_a_place": float(np.median(cloud.n_views)),
        "overlaps": len(pairs),
        "residual_before_um": _median(1000 * p.rms_mm for p in found.before),
        "residual_um": _median(1000 * p.rms_mm for p in pairs),
        "residual_in_sigmas": _median(p.in_sigmas for p in pairs),
        "noise_factor": found.noise_factor,
        "closure_um": 1000 * found.closure_mm,
        "closure_urad": 1e6 * found.closure_rad,
        "rounds": found.n_iterations,
        "middle_mm": found.middle_mm.tolist(),
        "pairs": [
            {"first": names[p.first], "second": names[p.second], "points": p.n_points,
             "residual_um": 1000 * p.rms_mm, "mean_um": 1000 * p.mean_mm}
            for p in pairs
        ],
        "odd_views": [asdict(odd) | {"name": names[odd.view]} for odd in odd_views(found)],
    }  # fmt: skip
    if found.table is not None:
        record["table"] = _table_record(found)
    return record


def _median(values: Any) -> float:
    known = list(values)
    return float(np.median(known)) if known else math.nan


def _view_record(
    k: int, view: SurfaceView, found: Registration, cloud: MergedCloud
) -> dict[str, Any]:
    pose = found.body_from_view[k]
    record: dict[str, Any] = {
        "name": view.name,
        "points": int(np.count_nonzero(cloud.fates[k])),
        "rotation": pose.rotation.tolist(),
        "translation_mm": pose.translation.tolist(),
        "sigma_place_um": 1000 * found.sigma_mm(k),
        "sigma_turn_urad": 1e6 * found.sigma_rad(k),
    }
    if found.table is not None and math.isfinite(found.table.angles[k]):
        record["angle_deg"] = math.degrees(found.table.angles[k])
        record["angle_sigma_deg"] = math.degrees(found.table.angle_sigma[k])
        record["beside_the_table_um"] = 1000 * float(found.table.off_mm[k])
    return record


def _table_record(found: Registration) -> dict[str, Any]:
    table = found.table
    assert table is not None
    off = table.off_mm[np.isfinite(table.off_mm)]
    return {
        "point_mm": table.middle_mm.tolist(),
        "direction": table.axis.direction.tolist(),
        "shift_sigma_um": 1000 * table.shift_sigma_mm,
        "lean_sigma_urad": 1e6 * table.lean_sigma,
        "poses_beside_um": 1000 * float(np.median(off)),
    }


def merge_text(record: dict[str, Any], /) -> str:
    """Return the merge in a few lines, with units."""
    lines = [
        f"{record['points']:,} points of {len(record['views'])} views, which saw "
        f"{record['points_of_views']:,}; median sigma {record['sigma_um']:.1f} um (single views "
        f"{record['sigma_of_views_um']:.1f} um); {record['overlaps']} overlaps, residual "
        f"{record['residual_um']:.1f} um ({record['residual_before_um']:.0f} um before)"
    ]
    if not math.isnan(record["closure_um"]):
        lines[0] += f"; closure {record['closure_um']:.1f} um, {record['closure_urad']:.0f} urad"
    if "table" in record:
        t = record["table"]
        at, way = (
            ", ".join(f"{round(x, 4) + 0.0:.4f}" for x in t[key])
            for key in ("point_mm", "direction")
        )
        lines.append(
            f"table axis through ({at}) mm, direction ({way}); sigma {t['shift_sigma_um']:.2f} um "
            f"across, {t['lean_sigma_urad']:.1f} urad; poses {t['poses_beside_um']:.1f} um beside"
        )
    if "recalibration" in record:
        lines.append(recalibration_text(record["recalibration"]))
    return "\n".join(lines)


def odd_texts(record: dict[str, Any], /) -> list[str]:
    """Return a warning for each view that does not fit the others, and for a way round that does
    not close.
    """
    found = [
        f"{odd['name']}: this view does not fit the others: {odd['why']}. Its calibration, or the "
        "body, may have moved: look at its own checks, measure it with --self-calibrate, or leave "
        "it out"
        for odd in record["odd_views"]
    ]
    if record["closure_um"] > OPEN_CLOSURE * max(record["residual_um"], 1e-9):
        found.append(
            f"once around, {record['closure_um']:.0f} um are left where overlaps differ by "
            f"{record['residual_um']:.0f} um: views may be joined at a wrong place. Look at the "
            "pictures; give the table's angles, if only roughly"
        )
    return found


def mesh_record(mesh: SurfaceMesh, kind: str, /) -> dict[str, Any]:
    """Return the figures of a mesh."""
    known = np.isfinite(mesh.sigma_mm)
    return {
        "kind": kind,
        "vertices": len(mesh.vertices_mm),
        "faces": len(mesh.faces),
        "closed": mesh.is_closed,
        "vertices_without_points": int((~known).sum()),
        "sigma_um": 1000 * float(np.median(mesh.sigma_mm[known])) if known.any() else math.nan,
    }


def merge_markdown(record: dict[str, Any], pictures: Sequence[tuple[str, str]], /) -> str:
    """Return the report as Markdown; pictures (caption, file) lie beside it."""
    lines = [f"# {record['title']}", "", merge_text(record).replace("\n", "\n\n") + ".", ""]
    warnings = odd_texts(record) + record.get("warnings", [])
    if warnings:
        lines += ["## What to look at", "", *(f"- {text}" for text in warnings), ""]
    for caption, file in pictures:
        lines += [f"## {caption}", "", f"![{caption}]({file})", ""]
    lines += ["## Points", "", "| what became of them | points |", "|---|---|"]
    lines += [f"| {FATES[fate]} | {record['fates'][fate.name.lower()]:,} |"
              for fate in FATES if fate.name.lower() in record["fates"]]  # fmt: skip
    lines += [""]
    if "recalibration" in record:
        lines += recalibration_lines(record["recalibration"])
    lines += [*_mesh_lines(record), "## Views", "", *_view_lines(record), ""]
    lines += [NOTE, "", f"`{record['command']}`", ""]
    return "\n".join(lines)


def _mesh_lines(record: dict[str, Any]) -> list[str]:
    if "mesh" not in record:
        return []
    m = record["mesh"]
    state = "closed" if m["closed"] else "open"
    return [
        "## Mesh", "",
        f"{m['kind']}: {m['vertices']:,} vertices, {m['faces']:,} faces, {state}; median sigma of "
        f"the vertices {m['sigma_um']:.1f} um; {m['vertices_without_points']:,} vertices close "
        "holes and have none.", "",
    ]  # fmt: skip


def _view_lines(record: dict[str, Any]) -> list[str]:
    has_angle = any("angle_deg" in view for view in record["views"])
    head = "| view | points | sigma um | sigma urad |" + (" angle deg | beside um |" * has_angle)
    lines = [head, "|---" * (4 + 2 * has_angle) + "|"]
    for v in record["views"]:
        row = f"| {v['name']} | {v['points']:,} | {v['sigma_place_um']:.2f} | "
        row += f"{v['sigma_turn_urad']:.1f} |"
        if has_angle:
            row += (f" {v['angle_deg']:.4f} | {v['beside_the_table_um']:.1f} |"
                    if "angle_deg" in v else " | |")  # fmt: skip
        lines.append(row)
    return lines
