"""The design of a rig in words: a table for the terminal, a Markdown report, a record."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from fringe3d.design import AmbiguityMap, Assessment, Equation, GrayNeeds
from fringe3d.design.gray import ENOUGH
from fringe3d.design.margin import NEEDED_RATIO
from fringe3d.report.design_words import (
    findings,
    over_determined,
    patterns_command,
    percent,
    recommendation,
)

WIDTH = 98

ELSEWHERE = "With the projector elsewhere"

CODES = (
    "A plain code takes as many images as bits; its edges fall where the phase wraps, which costs "
    "about one point in a hundred on parts with steps. The over-determined code (cells of half a "
    "period) takes one image more and has no such weakness."
)


def summary(a: Assessment, /, *, name: str, advice: str = "", optimised: str = "") -> str:
    """Return what the terminal shows, the recommendation first, lines of at most `WIDTH`.

    Parameters
    ----------
    a : Assessment
    name : str; of the rig
    advice, optimised : str; what a better place for the projector gives, and its table
    """
    first, *others = recommendation(a)
    lines = textwrap.wrap(f"{name}: {first}", WIDTH, subsequent_indent="  ")
    for text in _advised(others, advice):
        lines += _item(text)
    if patterns_command(a):  # on one line, to be copied
        lines += ["- The images, to project:", f"  {patterns_command(a)}"]
    lines += ["", *textwrap.wrap(_about(a), WIDTH), _angles(a), ""]
    lines += _aligned(_equation_rows(a), "lrrr")
    for text in (*_columns(a), *(f"({e.number}) {e.remark}" for e in a.equations)):
        lines += textwrap.wrap(text, WIDTH, subsequent_indent="    ")
    lines += ["", *_aligned(_gray_rows(a), "lrrrr")]
    if a.margins is not None:
        lines += ["", *_aligned(_margin_rows(a.margins), "l" + "r" * len(a.margins.slopes))]
    lines.append("")
    for text in findings(a):
        lines += _item(text)
    if optimised:
        lines += ["", optimised]
    return "\n".join(lines)


def _item(text: str) -> list[str]:
    return textwrap.wrap(f"- {text}", WIDTH, subsequent_indent="  ")


def _columns(a: Assessment) -> list[str]:
    """Say what the columns of the equations mean."""
    counted = "the worst pixel of the rig as it is"
    if a.step > 1:
        counted += f" (every {a.step} px, and the last row and column)"
    if any(equation.number == 5 for equation in a.equations):
        counted += ", in (5) with a guard for noise and calibration"
    return [
        "printed: the source paper's form. exact: its closed form on C1's principal ray, for "
        f"fringes square to the epipolar plane and no distortion. all pixels: {counted}."
    ]


def markdown(
    a: Assessment,
    /,
    *,
    name: str,
    command: str,
    pictures: Sequence[tuple[str, str]],
    advice: str = "",
    optimised: str = "",
) -> str:
    """Return the report as Markdown, the recommendation first.

    Parameters
    ----------
    a : Assessment
    name, command : str; of the rig, and as typed
    pictures : sequence of (str, str); file names and what they show
    advice, optimised : see `summary`
    """
    first, *others = recommendation(a)
    parts = [
        f"# Design of {name}",
        f"**{first}**",
        "\n".join(f"- {text}" for text in _advised(others, advice)),
        f"The images, to project: `{patterns_command(a)}`" if patterns_command(a) else "",
        f"Devices {_about(a)}.\nT{_angles(a)[1:]}.",
        f"`{command}`",
        "## Which images",
        _table(_gray_rows(a)),
        CODES,
        "A point has a twin where a second place on its own segment has the same wrapped phase and "
        f"the same cyclic code; enough bits leave less than {100 * ENOUGH:g} % of the points with "
        f"one. *Beyond the volume*: surfaces up to {100 * a.beyond_part:g} % of a segment outside "
        "it, such as the table, are lit and seen, too.",
        _table(_twin_rows(a)),
        "" if a.margins is None else _table(_margin_rows(a.margins)),
        "\n".join(f"- {text}" for text in findings(a)),
        f"## {ELSEWHERE}" if optimised else "",
        f"```\n{optimised}\n```" if optimised else "",
        "## The source paper's equations",
        _table(_equation_rows(a)),
        *_columns(a),
        "\n".join(f"- ({e.number}): {e.remark}" for e in a.equations),
        "## Definitions",
        _definitions(a),
        "## Pictures",
        *(f"![{text}]({file})\n\n{text}" for file, text in pictures),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _advised(others: Sequence[str], advice: str) -> list[str]:
    """Return the recommendation after its first sentence."""
    return [*others, *([f"{ELSEWHERE}: {advice}"] if advice else [])]


def _about(a: Assessment) -> str:
    names = ["C1", *(f"C{number + 2}" for number in range(len(a.rig.cameras) - 1)), "projector"]
    devices = ", ".join(
        f"{name} '{device.name}'" for name, device in zip(names, a.rig.devices, strict=False)
    )
    depths = a.reference.depths
    period = f"period {a.period_px:g} px"
    if a.rig.projector is None:
        period = f"period {a.camera_period_px:g} px in C2"
    elif a.angle:
        period += f", fringes at {math.degrees(a.angle):g} deg"
    return (
        f"{devices}; depths {depths.depth_min_mm:.1f} to {depths.depth_max_mm:.1f} mm; {period}, "
        f"{a.quality.n_shifts} steps"
    )


def _angles(a: Assessment) -> str:
    named = (("C1-C2", a.angle_c1c2), ("C1-projector", a.angle_c1p), ("C2-projector", a.angle_c2p))
    known = [f"{pair} {math.degrees(tau):.1f}" for pair, tau in named if math.isfinite(tau)]
    return f"triangulation angles {', '.join(known)} deg"


def _equation_rows(a: Assessment) -> list[list[str]]:
    rows = [["equation", "printed", "exact", "all pixels"]]
    for equation in a.equations:
        values = (equation.printed, equation.exact, equation.counted)
        unit = {"rad": ", deg", "": ""}.get(equation.unit, f", {equation.unit}")
        rows.append(
            [f"({equation.number}) {equation.quantity}{unit}"]
            + [_number(equation, value) for value in values]
        )
    return rows


def _number(equation: Equation, value: float) -> str:
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "any"
    if equation.unit == "rad":
        return f"{math.degrees(value):.2f}"
    return f"{value:.0f}" if equation.number == 4 else f"{value:.2f}"


def _searches(a: Assessment) -> list[tuple[str, GrayNeeds]]:
    found = []
    if a.projector_needs is not None:
        found.append(("with the projector's geometry", a.projector_needs))
    if a.camera_needs is not None:
        found.append(("with C2's segment alone", a.camera_needs))
    return found


def _gray_rows(a: Assessment) -> list[list[str]]:
    rows = [["Gray-code images, plain / over-determined", "periods", "orders", "volume alone",
             "surfaces beyond it"]]  # fmt: skip
    for where, needs in _searches(a):
        rows.append([where, f"{needs.max_periods:.2f}", f"{needs.max_orders}", _images(needs.bits),
                     _images(needs.bits_beyond)])  # fmt: skip
    return rows


def _images(bits: int) -> str:
    return f"{bits} / {over_determined(bits)}" if bits else "none"


def _margin_rows(margins: AmbiguityMap) -> list[list[str]]:
    degrees = np.degrees(margins.slopes)
    return [
        ["fringes alone: surfaces that slope up to", *(f"{slope:.0f} deg" for slope in degrees)],
        ["smallest ambiguity margin, periods", *(f"{m:.3f}" for m in margins.worst_margin)],
        [f"the same over its sigma ({NEEDED_RATIO:g} are needed)",
         *(f"{r:.1f}" for r in margins.worst_ratio)],
        ["pixels with less than that", *(f"{100 * part:.0f} %" for part in margins.share_unsafe)],
    ]  # fmt: skip


def _twin_rows(a: Assessment) -> list[list[str]]:
    searches = _searches(a)
    head = ["bits"]
    for where, _ in searches:
        head += [f"points with a twin, {where}", "surfaces beyond it"]
    rows = [head]
    for bits in range(max(len(needs.twins) for _, needs in searches)):
        row = [str(bits)]
        for _, needs in searches:
            for shares in (needs.twins, needs.twins_beyond):
                row.append(percent(shares[bits]) if bits < len(shares) else "0 %")
        rows.append(row)
    return rows


def _definitions(a: Assessment) -> str:
    u = a.quality
    return "\n".join(
        f"- {text}"
        for text in (
            "Segment: image of the part of C1's viewing ray that lies in the volume and that the "
            "other device sees or lights; lenses with their distortion.",
            "Periods on C2's segment: fringes that C2 sees between the ends of the segment on a "
            "plane through the reference point that faces the rig.",
            "Orders: the most fringe orders that fit one wrapped phase, floor(m + 2 eps) + 1, "
            f"eps = 3 sigma_phi + calibration error = {a.guard:.4f} periods (noise "
            f"{100 * u.noise:g} %, {u.n_shifts} steps, {u.calibration_px:g} px).",
            "Angle without code: the projector moves about the reference point towards C1, at its "
            "distance; every segment then holds less than one period, eps at both ends included.",
            "Sigma: standard deviation along C1's viewing ray, from the noise of the images alone.",
            "Margin: by how many periods the phase in C2 misses that of C1 if the order is wrong, "
            "for the wrong order that is hardest to tell.",
        )
    )


def _aligned(rows: Sequence[Sequence[str]], sides: str) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if side == "l" else cell.rjust(width)
            for cell, width, side in zip(row, widths, sides, strict=True)
        ).rstrip()
        for row in rows
    ]


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = rows
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)])
