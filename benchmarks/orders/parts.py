"""What each part of M6 is worth: the part left out, or something else in its place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.orders.cases import Calibration, Case, Result
from benchmarks.orders.figures import total
from benchmarks.orders.leaving_out import PARTS
from benchmarks.orders.scenes import Scene

OTHERS = ("M3, best order", "M3")

ONLY_STORED = ("bias", "refining of the stored bias", *(name for name in PARTS if "vote" in name))
"""What takes no bias from the images: without a stored one there is nothing else to see."""

ONLY_LEARNT = ("several starts", "jumps, where solutions are compared")
"""What looks for the bias: with a stored one it has nothing to do."""

Row = tuple[str, str]
"""Mode and part left out."""

ROWS: tuple[Row, ...] = (*((mode, "") for mode in OTHERS), *(("default", part) for part in PARTS))


def all_cases(
    scenes: Iterable[Scene], calibrations: Sequence[Calibration], rows: Iterable[Row], /
) -> list[Case]:
    """Return the measurements for each row, with and without a stored bias."""
    found = list(scenes)
    return [
        Case(scene, calibration, has_bias, mode, left_out)
        for mode, left_out in rows
        for has_bias in (True, False)
        if left_out not in (ONLY_LEARNT if has_bias else ONLY_STORED)
        for scene in found
        for calibration in calibrations
    ]


def label(row: Row, /) -> str:
    """Return what the table calls a row.

    Examples
    --------
    >>> label(("default", "bias")), label(("default", "neighbours: none")), label(("M3", ""))
    ('M6 without bias', 'M6, neighbours: none', 'M3')
    """
    mode, left_out = row
    name = "M6" if mode == "default" else mode
    if not left_out:
        return name
    return f"{name}, {left_out}" if ":" in left_out else f"{name} without {left_out}"


def markdown(results: Sequence[Result], /) -> str:
    """Return one table for stored biases and one without; all objects of a rig together."""
    parts = []
    for has_bias, title in ((True, "With a stored bias"), (False, "Without a stored bias")):
        own = [r for r in results if r.case.has_bias == has_bias]
        if own:
            parts.append(f"{title}:\n\n{_table(own)}")
    return "\n\n".join(parts)


def _table(results: Sequence[Result]) -> str:
    presets = list(dict.fromkeys(r.case.scene.preset for r in results))
    lines = [
        "| | " + " | ".join(f"`{preset}`: complete | wrong | false | open" for preset in presets)
        + " |",
        "|---|" + "---:|" * (4 * len(presets)),
    ]  # fmt: skip
    for row in dict.fromkeys((r.case.mode, r.case.left_out) for r in results):
        cells = []
        for preset in presets:
            own = [
                r
                for r in results
                if (r.case.mode, r.case.left_out) == row and r.case.scene.preset == preset
            ]
            cells.append(_cells(own))
        lines.append(f"| {label(row)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n\nPer cent; a row with ! has measurements that were refused."


def _cells(results: Sequence[Result]) -> str:
    counts = total(r.counts for r in results)
    shares = counts.shares()
    mark = " !" if any(r.failure for r in results) else ""
    if results and all(r.failure for r in results):
        return "refused | | | "
    return (
        f"{shares['completeness']:.2f}{mark} | {shares['wrong']:.3f} | {shares['false']:.2f} | "
        f"{shares['undecided']:.2f}"
    )
