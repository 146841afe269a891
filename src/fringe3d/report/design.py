"""The design of a rig in words: a table for the terminal, a Markdown report, a record."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from fringe3d.design import AmbiguityMap, Assessment, Equation, GrayNeeds
from fringe3d.design.gray import BEYOND, ENOUGH
from fringe3d.design.margin import NEEDED_RATIO

WIDTH = 98

FLAT = math.radians(25.0)
"""Fringes that cross the epipolar lines at less are said to follow them."""

CODES = (
    "A plain code takes as many images as bits; its edges fall where the phase wraps, which costs "
    "about one point in a hundred on parts with steps. The over-determined code (cells of half a "
    "period) takes one image more and has no such weakness."
)


def summary(a: Assessment, /, *, name: str, optimised: str = "") -> str:
    """Return what the terminal shows, lines of at most `WIDTH` characters."""
    lines = [*textwrap.wrap(f"{name}: {_about(a)}", WIDTH), _angles(a), ""]
    lines += _aligned(_equation_rows(a), "lrrr")
    for equation in a.equations:
        lines += textwrap.wrap(f"({equation.number}) {equation.remark}", WIDTH,
                               subsequent_indent="    ")  # fmt: skip
    lines += ["", *_aligned(_gray_rows(a), "lrrrr")]
    if a.margins is not None:
        lines += ["", *_aligned(_margin_rows(a.margins), "l" + "r" * len(a.margins.slopes))]
    lines.append("")
    for text in findings(a):
        lines += textwrap.wrap(f"- {text}", WIDTH, subsequent_indent="  ")
    if optimised:
        lines += ["", optimised]
    return "\n".join(lines)


def markdown(
    a: Assessment,
    /,
    *,
    name: str,
    command: str,
    pictures: Sequence[tuple[str, str]],
    optimised: str = "",
) -> str:
    """Return the report as Markdown; `pictures` are file names and what they show."""
    parts = [
        f"# Design of {name}",
        f"`{command}`",
        f"Devices {_about(a)}.\nT{_angles(a)[1:]}.",
        "## Which images",
        "\n".join(f"- {text}" for text in findings(a)),
        _table(_gray_rows(a)),
        CODES,
        "A point has a twin where a second place on its own segment has the same wrapped phase and "
        f"the same cyclic code; enough bits leave less than {100 * ENOUGH:g} % of the points with "
        f"one. *Beyond the volume*: surfaces up to {100 * BEYOND:g} % of a segment outside it, "
        "such as the table, are lit and seen, too.",
        _table(_twin_rows(a)),
        "" if a.margins is None else _table(_margin_rows(a.margins)),
        "## A better place for the projector" if optimised else "",
        f"```\n{optimised}\n```" if optimised else "",
        "## The source paper's equations",
        _table(_equation_rows(a)),
        "\n".join(f"- ({e.number}): {e.remark}" for e in a.equations),
        "*Exact* is the closed form of C1's principal ray (fringes square to the epipolar plane, "
        "no distortion), *all pixels* the worst pixel of the rig as it is.",
        "## Definitions",
        _definitions(a),
        "## Pictures",
        *(f"![{text}]({file})\n\n{text}" for file, text in pictures),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


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
    return f"{bits} / {_over_determined(bits)}" if bits else "none"


def _over_determined(bits: int) -> int:
    """Return the images of a code with cells of half a period."""
    return bits + 1 if bits else 0


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


def percent(share: float, /) -> str:
    """Say a share in per cent; a small one is not called none."""
    return "0 %" if share == 0 else "below 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def findings(a: Assessment, /) -> list[str]:
    """Return what follows from the figures, one sentence each."""
    found = []
    if a.place is not None and a.place.crossing < FLAT:
        found.append(
            f"The fringes nearly follow the epipolar lines ({math.degrees(a.place.crossing):.0f} "
            "deg between them): points get uncertain. Turn them to "
            f"{math.degrees(a.place.square_angle):.0f} deg (--angle)."
        )
    found.append(_code_finding(a))
    if a.projector_needs is not None and a.camera_needs is not None:
        saved = _over_determined(a.camera_needs.bits) - _over_determined(a.projector_needs.bits)
        if saved > 0:
            found.append(
                f"The projector's calibration saves {_count(saved, 'image')}: without it "
                f"{a.camera_needs.max_periods:.1f} periods of C2's segment come into question "
                f"instead of {a.projector_needs.max_periods:.1f}."
            )
    if a.place is not None and math.isfinite(a.place.free_angle):
        found.append(
            f"No code is needed up to {math.degrees(a.place.free_angle):.2f} deg between C1 and "
            f"projector (now {math.degrees(a.angle_c1p):.1f}); C1's principal ray alone would "
            f"allow {math.degrees(a.place.free_angle_principal):.2f} deg."
        )
    if a.margins is not None and a.projector_needs is not None and a.projector_needs.bits:
        found.append(_margin_finding(a.margins, a.quality.n_shifts))
    u = a.uncertainty
    found.append(
        f"Sigma of the points, surfaces that face the rig: median {1000 * u.median_mm:.1f} um, "
        f"5 to 95 % {1000 * u.low_mm:.1f} to {1000 * u.high_mm:.1f} um ({a.quality.n_shifts} "
        f"steps, noise {100 * a.quality.noise:g} % of the modulation)."
    )
    return found


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _code_finding(a: Assessment) -> str:
    needs = a.projector_needs or a.camera_needs
    assert needs is not None
    steps = a.quality.n_shifts
    further = ""
    if needs.bits_beyond > needs.bits:
        bits = needs.bits_beyond
        further = (
            f" Where a table or a wall is seen beyond the volume, take {_count(bits, 'bit')}: "
            f"{steps + bits + 1} images."
        )
    if needs.bits == 0:
        why = "every segment is shorter than a period"
        if needs.exact_bits:
            why = (
                f"the longest segment holds {needs.max_periods:.2f} periods, and only "
                f"{percent(needs.twins[0])} of the points have a twin"
            )
        return f"No Gray code: {steps} images, for {why} (M5).{further}"
    left = needs.twins[needs.bits]
    twins = ""
    if left > 0:
        exact = _count(needs.exact_bits, "bit")
        twins = f"; {percent(left)} of the points have a twin, {exact} leave none"
    return (
        f"Reduced Gray code of {_count(needs.bits, 'bit')}, {needs.bits + 1} images as an "
        f"over-determined code: {steps + needs.bits + 1} images in all{twins}.{further}"
    )


def _margin_finding(margins: AmbiguityMap, steps: int) -> str:
    enough = margins.worst_ratio >= NEEDED_RATIO
    if not enough[0]:
        return (
            f"Fringes alone ({steps} images) do not suffice pixel by pixel: C2 cannot tell some "
            "wrong order even on surfaces that face the rig. See --optimise."
        )
    # Surfaces up to a steeper slope include those up to a flatter one.
    slope = math.degrees(float(margins.slopes[enough][-1]))
    text = (
        f"Fringes alone suffice ({steps} images, M3) on surfaces that slope up to {slope:.0f} deg"
    )
    return f"{text}." if enough.all() else f"{text}, not on steeper ones. See --optimise."


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


def record(a: Assessment, /, *, name: str, command: str) -> dict[str, Any]:
    """Return all figures for machines; angles in degrees, with the unit in the key."""
    depths, u = a.reference.depths, a.uncertainty
    found: dict[str, Any] = {
        "command": command,
        "rig": name,
        "period_px": a.period_px if a.rig.projector else None,
        "camera_period_px": a.camera_period_px,
        "fringe_angle_deg": math.degrees(a.angle),
        "steps": a.quality.n_shifts,
        "noise": a.quality.noise,
        "calibration_error_px": a.quality.calibration_px,
        "guard_periods": a.guard,
        "depth_min_mm": depths.depth_min_mm,
        "depth_ref_mm": depths.depth_ref_mm,
        "depth_max_mm": depths.depth_max_mm,
        "angle_c1_c2_deg": math.degrees(a.angle_c1c2),
        "angle_c1_projector_deg": math.degrees(a.angle_c1p),
        "angle_c2_projector_deg": math.degrees(a.angle_c2p),
        "equations": [_equation_record(equation) for equation in a.equations],
        "gray_code": {where: _needs_record(needs) for where, needs in _named_searches(a)},
        "sigma_median_mm": u.median_mm,
        "sigma_5_percent_mm": u.low_mm,
        "sigma_95_percent_mm": u.high_mm,
        "findings": findings(a),
    }
    if a.place is not None:
        found |= {
            "angle_without_code_deg": math.degrees(a.place.free_angle),
            "angle_without_code_principal_ray_deg": math.degrees(a.place.free_angle_principal),
            "fringe_crossing_deg": math.degrees(a.place.crossing),
            "fringe_angle_square_deg": math.degrees(a.place.square_angle),
        }
    if a.margins is not None:
        found["ambiguity_margin"] = {
            "slopes_deg": np.degrees(a.margins.slopes).tolist(),
            "worst_periods": a.margins.worst_margin.tolist(),
            "worst_ratio": a.margins.worst_ratio.tolist(),
            "worst_order": a.margins.worst_order.tolist(),
            "share_unsafe": a.margins.share_unsafe.tolist(),
        }
    cleaned: dict[str, Any] = _without_nan(found)
    return cleaned


def _named_searches(a: Assessment) -> list[tuple[str, GrayNeeds]]:
    pairs = (("projector_segment", a.projector_needs), ("camera_segment", a.camera_needs))
    return [(name, needs) for name, needs in pairs if needs is not None]


def _equation_record(equation: Equation) -> dict[str, Any]:
    turn = math.degrees if equation.unit == "rad" else float
    unit = {"rad": "_deg", "px": "_px"}.get(equation.unit, "")
    return {
        "number": equation.number,
        "quantity": equation.quantity,
        f"printed{unit}": turn(equation.printed),
        f"exact{unit}": turn(equation.exact),
        f"all_pixels{unit}": turn(equation.counted),
        "remark": equation.remark,
    }


def _needs_record(needs: GrayNeeds) -> dict[str, Any]:
    return {
        "max_periods": needs.max_periods,
        "max_orders": needs.max_orders,
        "bits": needs.bits,
        "bits_without_any_twin": needs.exact_bits,
        "bits_with_surfaces_beyond": needs.bits_beyond,
        "twin_share_by_bits": list(needs.twins),
        "twin_share_beyond_by_bits": list(needs.twins_beyond),
    }


def _without_nan(value: Any) -> Any:
    """Return the record with null for what is unknown or infinite: JSON has no such numbers."""
    if isinstance(value, dict):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
