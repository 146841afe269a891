"""``fringe3d design --optimise``: better places of the projector, printed and as files."""

from __future__ import annotations

import math
import textwrap
from dataclasses import replace
from pathlib import Path

from fringe3d.cli.console import Reporter
from fringe3d.design.margin import NEEDED_RATIO
from fringe3d.design.optimise import Candidate, Optimisation, optimise
from fringe3d.design.residual import Quality
from fringe3d.design.search import Limits
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Rig

WIDTH = 100
"""Columns of printed text."""

HEAD = ("", "tilt", "azimuth", "fringes", "to camera", "periods", "wrong", "margin/sigma",
        "sigma", "", "images")  # fmt: skip
UNITS = ("", "deg", "deg", "deg", "deg", "", "orders", "{flat} deg  {steep} deg", "um", "", "")


def run_optimise(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float,
    quality: Quality,
    out: Path | None,
    reporter: Reporter,
    limits: Limits | None = None,
) -> str:
    """Look for better places of the projector; return what to print.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    quality : Quality; of images and calibration
    out : Path or None; folder for ``tradeoff.png`` and ``designed-rig.toml``
    reporter : Reporter
    limits : Limits or None; what places must respect
    """
    found = optimise(
        rig, period_px=period_px, angle=angle, quality=quality, limits=limits,
        progress=reporter.step,
    )  # fmt: skip
    text = f"{table(found)}\n\n{recommendation(found, quality)}"
    if out is None:
        return text
    return text + write_files(out, found)


def write_files(out: Path, found: Optimisation, /) -> str:
    """Write the picture and, if it differs from the given one, the rig; tell their names."""
    from fringe3d.report.tradeoff import draw_tradeoff

    draw_tradeoff(out / "tradeoff.png", found, title="Where the projector could stand")
    if found.best is found.given or not found.best.is_enough:
        return "\nThe trade-off: tradeoff.png"
    given = found.given.rig.provenance
    provenance = f"{given}; projector moved by fringe3d design --optimise".lstrip("; ")
    moved = replace(found.best.rig, provenance=provenance)
    (out / "designed-rig.toml").write_text(rig_text(moved), encoding="utf-8")
    return "\nThe rig: designed-rig.toml; the trade-off: tradeoff.png"


def table(found: Optimisation, /) -> str:
    """Return the candidates as an aligned text table."""
    slopes = [math.degrees(float(s)) for s in found.given.margins.slopes]
    middle = len(slopes) // 2
    about = UNITS[7].format(flat=f"{slopes[middle]:.0f}", steep=f"{slopes[-1]:.0f}")
    rows: list[tuple[str, ...]] = [HEAD, (*UNITS[:7], about, *UNITS[8:])]
    rows += [_row(number, c, middle) for number, c in enumerate(found.candidates)]
    widths = [max(len(row[col]) for row in rows) for col in range(len(HEAD))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if col == 0 else cell.rjust(width)
            for col, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _row(number: int, c: Candidate, middle: int) -> tuple[str, ...]:
    ratios = c.margins.worst_ratio
    most = len(c.margins.orders) and int(abs(c.margins.orders).max())
    return (
        f"{number} {c.name}{'' if c.is_allowed else ' *'}",
        f"{math.degrees(c.tilt):.1f}",
        f"{math.degrees(c.azimuth):.1f}",
        f"{math.degrees(c.angle):.1f}",
        f"{math.degrees(c.separation):.1f}",
        f"{c.periods:.2f}",
        f"+-{most}" if most else "none",
        f"{ratios[middle]:6.1f}  {ratios[-1]:6.1f}",
        f"{1000 * c.sigma_mm:.2f}",
        f"{100 * (c.price - 1):+.0f} %",
        f"{c.n_images}",
    )


def recommendation(found: Optimisation, quality: Quality, /) -> str:
    """Return in words what to build."""
    said = textwrap.fill(_advice(found, quality), WIDTH)
    outside = [c for c in found.candidates if not c.is_allowed]
    if not outside:
        return said
    least = math.degrees(found.limits.min_separation)
    most = 100 * found.limits.max_price
    return (
        f"* beyond the limits: nearer than {least:.0f} deg to a camera, tilted by more than "
        f"{math.degrees(found.limits.max_tilt):.0f} deg, or sigma above {most:.0f} %\n{said}"
    )


def _advice(found: Optimisation, quality: Quality) -> str:
    best, given = found.best, found.given
    steepest = math.degrees(float(given.margins.slopes[-1]))
    if best is given and given.is_enough:
        return "The rig needs no change: fringes alone tell all orders apart."
    if not best.is_enough:
        return (
            f"No place was found where {quality.n_shifts} images tell all orders apart on slopes "
            f"up to {steepest:.0f} deg (margin/sigma at least {NEEDED_RATIO:g}): {best.name} gives "
            f"{best.ratio:.1f}. Keep a reduced Gray code, take wider fringes, or calibrate better "
            f"than {quality.calibration_px:g} px."
        )
    why = "no wrong order lies in the volume"
    if len(best.margins.orders):
        why = f"C2 tells wrong orders apart on slopes up to {steepest:.0f} deg"
    return (
        f"Recommended: {best.name}, tilt {math.degrees(best.tilt):.1f} deg, azimuth "
        f"{math.degrees(best.azimuth):.1f} deg, fringes at {math.degrees(best.angle):.1f} deg "
        f"(--angle). There {best.n_images} images do without a code, for {why}; sigma "
        f"{1000 * best.sigma_mm:.1f} um instead of {1000 * given.sigma_mm:.1f} um."
    )
