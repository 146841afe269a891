"""What the overlaps of views said of their rig: figures as data, in words, as a table."""

from __future__ import annotations

import math
from typing import Any

from fringe3d.rig_from_views import RigFromViews

UNITS = {"turn": ("mdeg", 1000 * 180 / math.pi), "shift": ("um", 1000.0), "focal": ("ppm", 1e6)}

TOLD = 0.5
"""Part of what was likely beforehand below which a sigma counts as told by the views."""


def recalibration_record(found: RigFromViews, /) -> dict[str, Any]:
    """Return the figures as plain data."""
    return {
        "is_off": found.is_off,
        "in_sigmas": found.in_sigmas,
        "overlap_before_um": 1000 * found.overlap_before_mm,
        "overlap_um": 1000 * found.overlap_mm,
        "contradiction_before": found.contradiction_before,
        "contradiction": found.contradiction,
        "form_um": 1000 * found.form_mm,
        "points": found.n_points,
        "rounds": found.n_rounds,
        "changes": [
            {"device": c.device, "number": c.number, "unit": _unit(c.number)[0],
             "value": float(c.value * _unit(c.number)[1]),
             "sigma": float(c.sigma * _unit(c.number)[1]),
             "told": bool(c.sigma < TOLD * c.likely)}
            for c in found.changes
        ],
    }  # fmt: skip


def recalibration_text(record: dict[str, Any], /) -> str:
    """Return the outcome in a sentence or two."""
    figures = (
        f"overlaps {record['overlap_before_um']:.2f} -> {record['overlap_um']:.2f} um, "
        f"contradiction of the devices {record['contradiction_before']:.2f} -> "
        f"{record['contradiction']:.2f} sigmas"
    )
    if math.isnan(record["contradiction"]):
        figures = figures.partition(",")[0]
    if not record["is_off"]:
        return (
            "the rig fits its views: changes that fit them better are within "
            f"{record['in_sigmas']:.1f} sigmas; it stays as it is ({figures})"
        )
    return (
        f"the rig was off by {record['in_sigmas']:.1f} sigmas; corrected, the form of what a view "
        f"sees changes by {record['form_um']:.1f} um; {figures}"
    )


def recalibration_lines(record: dict[str, Any], /) -> list[str]:
    """Return a section of a Markdown report."""
    lines = ["## Rig", "", recalibration_text(record) + ".", ""]
    if not record["is_off"]:
        return lines
    lines += ["| device | number | change | sigma | held by |", "|---|---|---|---|---|"]
    for c in record["changes"]:
        by = "the views" if c["told"] else "the former calibration"
        number = c["number"].replace("_", " ")
        value = f"{c['value']:+.2f} {c['unit']} | {c['sigma']:.2f}"
        lines.append(f"| {c['device']} | {number} | {value} | {by} |")
    return [*lines, ""]


def _unit(number: str) -> tuple[str, float]:
    return UNITS[number.partition("_")[0]]
