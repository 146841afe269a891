"""``fringe3d design --optimise``: better places of the projector, printed and as files."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fringe3d.cli.console import Reporter
from fringe3d.design.margin import NEEDED_RATIO
from fringe3d.design.optimise import Candidate, Optimisation, optimise
from fringe3d.design.residual import Quality
from fringe3d.design.task import Limits
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Rig

WIDTH = 98
"""Columns of printed text."""

HEAD = ("", "tilt", "azimuth", "fringes", "nearest", "periods", "wrong", "margin/sigma", "alone",
        "sigma", "", "images")  # fmt: skip
UNITS = ("", "deg", "deg", "deg", "camera", "", "orders", "at {0} deg", "to, deg", "um", "",
         "to {0} deg")  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimised:
    """What `run_optimise` found, to print and to keep.

    Parameters
    ----------
    advice : str; what to build, and what else there is
    text : str; the table of candidates, its legend and the names of the files
    record : dict; the same figures for machines
    """

    advice: str
    text: str
    record: dict[str, Any]


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
    beyond: float = 0.0,
) -> Optimised:
    """Look for better places of the projector.

    Parameters
    ----------
    rig : Rig of two cameras and a projector, with a measuring volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    quality : Quality; of images and calibration
    out : Path or None; folder for ``tradeoff.png`` and ``designed-rig.toml``
    reporter : Reporter
    limits : Limits or None; what places must respect
    beyond : float; part of a segment beyond the volume in which surfaces are seen, too
    """
    found = optimise(
        rig, period_px=period_px, angle=angle, quality=quality, limits=limits, beyond=beyond,
        progress=reporter.step,
    )  # fmt: skip
    advice = recommendation(found, quality)
    record = {
        "recommended": found.best.name if found.best.is_enough else None,
        "recommendation": advice,
        "candidates": [_record(c) for c in found.candidates],
    }
    text = f"{table(found)}\n{legend(found, quality)}"
    if out is not None:
        text += f"\n{write_files(out, found)}"
    return Optimised(advice=advice, text=text, record=record)


def write_files(out: Path, found: Optimisation, /) -> str:
    """Write the picture and, if it differs from the given one, the rig; tell their names."""
    from fringe3d.report.tradeoff import draw_tradeoff

    draw_tradeoff(out / "tradeoff.png", found, title="Where the projector could stand")
    if found.best is found.given or not found.best.is_enough:
        return "The trade-off: tradeoff.png"
    given = found.given.rig.provenance
    provenance = f"{given}; projector moved by fringe3d design --optimise".lstrip("; ")
    moved = replace(found.best.rig, provenance=provenance)
    (out / "designed-rig.toml").write_text(rig_text(moved), encoding="utf-8")
    return "The rig: designed-rig.toml; the trade-off: tradeoff.png"


def table(found: Optimisation, /) -> str:
    """Return the candidates as an aligned text table."""
    steepest = _degrees(float(found.given.margins.slopes[-1]))
    rows: list[tuple[str, ...]] = [HEAD, tuple(unit.format(steepest) for unit in UNITS)]
    rows += [_row(number, c) for number, c in enumerate(found.candidates)]
    widths = [max(len(row[col]) for row in rows) for col in range(len(HEAD))]
    return "\n".join(
        " ".join(
            cell.ljust(width) if col == 0 else cell.rjust(width)
            for col, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _degrees(angle: float) -> str:
    return "-" if math.isnan(angle) else f"{math.degrees(angle):.0f}"


def _row(number: int, c: Candidate) -> tuple[str, ...]:
    return (
        f"{number} {c.name}{'' if c.is_allowed else ' *'}",
        f"{math.degrees(c.tilt):.1f}",
        f"{math.degrees(c.azimuth):.1f}",
        f"{math.degrees(c.angle):.1f}",
        f"{math.degrees(c.separation):.1f}",
        f"{c.periods:.2f}",
        "none" if c.is_single else f"+-{c.most_wrong}",
        f"{c.ratio:.1f}",
        _degrees(c.enough_slope),
        f"{1000 * c.sigma_mm:.2f}",
        _price(c),
        f"{c.n_images}",
    )


def _price(c: Candidate) -> str:
    return f"{100 * (c.price - 1):+.0f} %".replace("-0 %", "+0 %")


def legend(found: Optimisation, quality: Quality, /) -> str:
    """Return what the columns mean, and which rows are out of bounds."""
    steepest = _degrees(float(found.given.margins.slopes[-1]))
    n = quality.n_shifts
    said = [
        f"alone to: the steepest surfaces on which the {n} phase-shifted images do without a code "
        f"(margin/sigma at least {NEEDED_RATIO:g}). images: those that slopes up to {steepest} deg "
        "need, with an over-determined code where there is one."
    ]
    # The next period in C2, not a wrong order, is what a code saves these from.
    blurred = [str(i) for i, c in enumerate(found.candidates) if c.is_single and not c.is_enough]
    if blurred:
        said.append(
            f"In {', '.join(blurred)} no wrong order fits, but a calibration error of "
            f"{quality.calibration_px:g} px may lead C2 to the next period on steeper surfaces: "
            "there a code helps, or a better calibration."
        )
    if not all(c.is_allowed for c in found.candidates):
        least = math.degrees(found.limits.min_separation)
        said.append(
            f"* beyond the limits: nearer than {least:.0f} deg to a camera, tilted by more than "
            f"{math.degrees(found.limits.max_tilt):.0f} deg, or sigma above "
            f"{100 * found.limits.max_price:.0f} % of the given."
        )
    return "\n".join(textwrap.fill(text, WIDTH, subsequent_indent="  ") for text in said)


def recommendation(found: Optimisation, quality: Quality, /) -> str:
    """Return in words what to build, and what else there is at which price."""
    best, given, n = found.best, found.given, quality.n_shifts
    if best is given and given.is_enough:
        return "The rig needs no change: fringes alone tell all orders apart."
    others = " ".join(_alternatives(found, n))
    if best.is_enough:
        why = "no wrong order lies in the volume"
        if not best.is_single:
            steepest = _degrees(float(given.margins.slopes[-1]))
            why = f"C2 tells wrong orders apart on slopes up to {steepest} deg"
        return (
            f"{best.n_images} images without a code, at {_place(best)} ('{best.name}', sigma "
            f"{1000 * best.sigma_mm:.1f} um instead of {1000 * given.sigma_mm:.1f} um): {why}. "
            f"{others}"
        ).rstrip()
    steepest = _degrees(float(given.margins.slopes[-1]))
    return (
        f"No place was found where {n} images tell all orders apart on slopes up to {steepest} deg "
        f"(margin/sigma at least {NEEDED_RATIO:g}): '{best.name}' gives {best.ratio:.1f}. {others} "
        f"Else keep a reduced Gray code, take wider fringes, or calibrate better than "
        f"{quality.calibration_px:g} px."
    ).replace("  ", " ")


def _place(c: Candidate) -> str:
    return (
        f"tilt {math.degrees(c.tilt):.1f} deg, azimuth {math.degrees(c.azimuth):.1f} deg, fringes "
        f"at {math.degrees(c.angle):.1f} deg"
    )


def _alternatives(found: Optimisation, n_shifts: int) -> list[str]:
    """Say what the other ways to images without a code give, and their price."""
    said = []
    for c in found.candidates:
        if math.isnan(c.enough_slope) or (c is found.best and c.is_enough):
            continue
        where = f"slopes up to {_degrees(c.enough_slope)} deg"
        if c.enough_slope == 0:
            where = "surfaces that face the rig"
        gives = f"{n_shifts} images on {where}, sigma {_price(c)}"
        if c.name == "several periods":
            said.append(f"With {c.periods:.1f} periods on a segment ({_place(c)}): {gives}.")
        elif c.name == "one period":
            said.append(f"With one period ({_place(c)}): {gives}.")
        elif c.name == "next to C1":
            said.append(
                f"The paper's way (M5), {math.degrees(c.separation):.1f} deg from C1: {gives}"
                f"{'' if c.is_allowed else ', beyond the limits'}."
            )
    return said


def _record(c: Candidate) -> dict[str, Any]:
    slope = math.degrees(c.enough_slope)
    return {
        "name": c.name,
        "tilt_deg": math.degrees(c.tilt),
        "azimuth_deg": math.degrees(c.azimuth),
        "fringe_angle_deg": math.degrees(c.angle),
        "nearest_camera_deg": math.degrees(c.separation),
        "within_limits": c.is_allowed,
        "periods": c.periods,
        "most_wrong_order": 0 if c.is_single else c.most_wrong,
        "worst_ratio": c.ratio,
        "alone_up_to_slope_deg": None if math.isnan(c.enough_slope) else slope,
        "sigma_median_mm": c.sigma_mm,
        "price": c.price,
        "images": c.n_images,
    }
