"""The source paper's tables beside what was measured: Markdown, figures, pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fringe3d.evaluate import Score, Verdict

PAPER_OBJECTS = ("plane", "prism", "machine-part", "teeth")
PAPER_COMPLETENESS = {"M1": (100, 100, 100, 100), "M3": (98, 94, 77, 81)}
"""Per cent, of the objects above; of the other methods the exact figures are not known."""

PAPER_IMAGES = {
    16: {"M0": 48, "M1": 25, "M2": 21, "M3": 16, "M4": 32, "M5": 16},
    4: {"M0": 24, "M1": 13, "M2": 9, "M3": 4, "M4": 8, "M5": 4},
}
PAPER_SIGMA_UM = {16: 2.8}

COLORS = {Verdict.RIGHT: "#3b8c6e", Verdict.WRONG: "#d62728", Verdict.MISSING: "#f2a900"}
MEANINGS = {
    Verdict.RIGHT: "right order",
    Verdict.WRONG: "wrong order, or nothing there",
    Verdict.MISSING: "no point, though lit and seen by both cameras",
}
NOTHING = "#15171c"
UNKNOWN = "-"
PANEL_INCHES, TITLE_INCHES = 2.2, 0.5
SHADES = 12
"""Steps of brightness: enough to see the shape, and small files."""

MIN_COLUMNS = 3
"""Fewer would cut the legend."""

MARGIN_PX = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneFigures:
    """What a measured plane tells; 3 per mille of the points are left out.

    Parameters
    ----------
    sigma_um : float, um; standard deviation of the distances from the plane
    noise_um : float, um; the same after a polynomial of third degree is taken off
    flatness_um : float, um; largest minus smallest distance
    predicted_um : float, um; from the measurement's own uncertainties, across the plane
    n_points : int
    """

    sigma_um: float
    noise_um: float
    flatness_um: float
    predicted_um: float
    n_points: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """One method on one object, judged.

    Parameters
    ----------
    method : str; as printed
    group : str; "paper", "variant" or "table", the part of the report it stands in
    thing : str; the object
    steps : int; phase steps
    n_images : int
    against_m1, of_seen : Score or None; the reference is what M1 measured right, and all that is
        lit, in the volume and seen by C2; None where the method failed
    gross_part : float; points of the reference more than half a millimetre off
    false_share : float; points where there is no object in the volume, over those of the object
    verdict : (row, col) int8 or None; `Verdict`, -1 where there is neither object nor point
    shade : (row, col) float32 or None, 0 to 1; brightness of the surface, for the picture
    plane : PlaneFigures or None
    failure : str; why there is no result
    """

    method: str
    group: str
    thing: str
    steps: int
    n_images: int
    against_m1: Score | None = None
    of_seen: Score | None = None
    gross_part: float = math.nan
    false_share: float = math.nan
    verdict: NDArray[np.int8] | None = None
    shade: NDArray[np.float32] | None = None
    plane: PlaneFigures | None = None
    failure: str = ""


def paper_markdown(entries: Sequence[Entry], /, *, conditions: str, with_pictures: bool) -> str:
    """Return the report: the paper's two tables, the planes, the variants, the lit table.

    Parameters
    ----------
    entries : sequence of Entry
    conditions : str; what was simulated, a few sentences
    with_pictures : bool; refer to the pictures of `write_paper`
    """
    steps = sorted({e.steps for e in entries}, reverse=True)
    parts = ["# The source paper's experiment, simulated", conditions]
    parts += ["## Table 1: completeness", _TABLE_1]
    for n in steps:
        parts += [f"{n} phase steps:", _completeness(_of(entries, "paper", n), n)]
    if with_pictures:
        parts.append("![Right, wrong and missing points](overview.png)")
    parts += ["## Table 2: number of images", _images(_of(entries, "paper"), steps)]
    if any(e.plane for e in entries):
        parts += ["## Standard deviation of the plane", _PLANE, _planes(entries)]
    for group, title, text in (("variant", "Variants", _VARIANTS),
                               ("table", "A lit table below the object", _LIT_TABLE)):  # fmt: skip
        rows = _of(entries, group)
        if rows:
            parts += [f"## {title}", text]
            for n in sorted({e.steps for e in rows}, reverse=True):
                layout = _false_points if group == "table" else _completeness
                parts += [f"{n} phase steps:", layout(_of(rows, group, n), n)]
    failures = [f"- {e.method}, {e.thing}, {e.steps} steps: {e.failure}"
                for e in entries if e.failure]  # fmt: skip
    if failures:
        parts += ["## Methods that gave no result", "\n".join(failures)]
    return "\n\n".join(parts) + "\n"


_TABLE_1 = (
    "Points with the right fringe order, of those that M1 measured right (M1 is 100 % by "
    "definition), and in brackets the points of a wrong order, of the points there, both in per "
    "cent. Last columns, over all objects: right points of all pixels that see a lit point in the "
    "volume which C2 sees, too; wrong points of all points, anywhere (with M1's own, at depth "
    "edges); points there more than 0.5 mm off. M5 is measured on the rig `kolibri-m5`, against M1 "
    "on that rig."
)
_PLANE = (
    "Distances from the least-squares plane, 3 per mille of the points left out. The bend that "
    "calibration errors give it is in the standard deviation; the next column has a polynomial of "
    "third degree taken off. Predicted: from the measurement's own uncertainties."
)
_VARIANTS = (
    "Columns as in Table 1. M2 with the mean of the fringes as threshold instead of light and dark "
    "images; that, and a plain code (one image fewer); with a rig file that knows no projector. M3 "
    "as in Table 1 takes the candidate that fits best; with sure orders alone it rejects what is "
    "ambiguous."
)
_LIT_TABLE = (
    "The object stands on a lit table below the measuring volume. False points: where no object is "
    "inside the volume, over the points of the object, in per cent; in brackets the completeness "
    "against M1 (not strict)."
)


def _of(entries: Iterable[Entry], group: str, steps: int | None = None) -> list[Entry]:
    return [e for e in entries if e.group == group and steps in (None, e.steps)]


def _completeness(entries: Sequence[Entry], steps: int) -> str:
    things = _unique(e.thing for e in entries)
    rows = []
    for method in _unique(e.method for e in entries):
        own = {e.thing: e for e in entries if e.method == method}
        cells = [_cell(own[t]) if t in own else UNKNOWN for t in things]
        rows.append([method, str(next(iter(own.values())).n_images), *cells, *_summary(own)])
        if method in PAPER_COMPLETENESS:
            known = dict(zip(PAPER_OBJECTS, PAPER_COMPLETENESS[method], strict=True))
            images = PAPER_IMAGES.get(steps, {}).get(method, UNKNOWN)
            figures = [str(known.get(t, UNKNOWN)) for t in things]
            rows.append([f"{method} in the paper", str(images), *figures, *[UNKNOWN] * 3])
    return _table(["method", "images", *things, "of seen", "wrong, all", "> 0.5 mm"], rows)


def _cell(entry: Entry) -> str:
    if entry.against_m1 is None:
        return "failed"
    return (f"{_percent(entry.against_m1.completeness, 2)} "
            f"({_percent(entry.against_m1.error_rate, 2)})")  # fmt: skip


def _summary(own: dict[str, Entry]) -> list[str]:
    """Return the figures over all objects, each pixel counted once."""
    seen = [e.of_seen for e in own.values() if e.of_seen is not None]
    accepted = sum(s.n_accepted_anywhere for s in seen)
    if not accepted:
        return [UNKNOWN] * 3
    reference = [s.n_right + s.n_wrong for s in seen]
    gross = [e.gross_part for e in own.values() if e.of_seen is not None]
    return [
        _percent(sum(s.n_right for s in seen) / max(1, sum(s.n_reference for s in seen)), 1),
        _percent(sum(s.n_wrong_anywhere for s in seen) / accepted, 2),
        _percent(float(np.dot(reference, gross)) / max(1, sum(reference)), 2),
    ]


def _images(entries: Sequence[Entry], steps: Sequence[int]) -> str:
    rows = []
    for method in _unique(e.method for e in entries):
        if "on the rig" in method:  # M1 once more
            continue
        counts = {e.steps: e.n_images for e in entries if e.method == method}
        cells: list[str] = []
        for n in steps:
            known = PAPER_IMAGES.get(n, {}).get(method, UNKNOWN)
            cells += [str(counts.get(n, UNKNOWN)), str(known)]
        rows.append([method, *cells])
    head = [title for n in steps for title in (f"{n} steps", "paper")]
    return _table(["method", *head], rows)


def _planes(entries: Sequence[Entry]) -> str:
    rows = [
        [e.method, str(e.steps), *(f"{v:.2f}" for v in (e.plane.sigma_um, e.plane.noise_um,
         e.plane.predicted_um)), f"{e.plane.flatness_um:.0f}", f"{e.plane.n_points:,}",
         str(PAPER_SIGMA_UM.get(e.steps, UNKNOWN))]
        for e in entries if e.plane is not None
    ]  # fmt: skip
    return _table(["method", "steps", "sigma, um", "without bend, um", "predicted, um",
                   "flatness, um", "points", "paper, um"], rows)  # fmt: skip


def _false_points(entries: Sequence[Entry], _steps: int) -> str:
    things = _unique(e.thing for e in entries)
    rows = []
    for method in _unique(e.method for e in entries):
        own = {e.thing: e for e in entries if e.method == method}
        cells = [
            "failed" if own[t].against_m1 is None else
            f"{_percent(own[t].false_share, 2)} ({_percent(_found(own[t]), 2)})"
            for t in things
        ]  # fmt: skip
        rows.append([method, str(next(iter(own.values())).n_images), *cells])
    return _table(["method", "images", *things], rows)


def _found(entry: Entry) -> float:
    return math.nan if entry.against_m1 is None else entry.against_m1.completeness


def _percent(part: float, digits: int) -> str:
    return UNKNOWN if math.isnan(part) else f"{100 * part:.{digits}f}"


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown whose columns line up on a terminal, too."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [cells[0].ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = [":" + "-" * (widths[0] - 1), *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join([line(head), line(rule), *(line(row) for row in rows)])


def paper_record(entries: Sequence[Entry], /, *, conditions: dict[str, Any]) -> dict[str, Any]:
    """Return all figures as plain data, parts as numbers from 0 to 1."""
    return {"conditions": conditions, "results": [_record(entry) for entry in entries]}


def _record(entry: Entry) -> dict[str, Any]:
    record: dict[str, Any] = {
        "method": entry.method, "group": entry.group, "object": entry.thing,
        "steps": entry.steps, "images": entry.n_images,
    }  # fmt: skip
    if entry.against_m1 is None or entry.of_seen is None:
        return record | {"failure": entry.failure}
    record |= {
        "completeness": entry.against_m1.completeness,
        "error_rate": entry.against_m1.error_rate,
        "of_seen": entry.of_seen.completeness,
        "error_rate_anywhere": entry.of_seen.error_rate_anywhere,
        "gross_part": entry.gross_part,
        "false_share": entry.false_share,
        "points": entry.of_seen.n_accepted_anywhere,
    }
    if entry.plane is not None:
        record |= {
            "plane_sigma_um": entry.plane.sigma_um,
            "plane_sigma_without_bend_um": entry.plane.noise_um,
            "plane_sigma_predicted_um": entry.plane.predicted_um,
            "flatness_um": entry.plane.flatness_um,
        }
    # JSON knows no NaN: what is not known is not there.
    return {k: v for k, v in record.items() if not (isinstance(v, float) and math.isnan(v))}


def write_paper(
    folder: Path, entries: Sequence[Entry], markdown: str, record: dict[str, Any], /
) -> None:
    """Write ``paper.md``, ``paper.json`` and the error maps into a folder.

    ``overview.png`` shows all objects with the fewest phase steps; ``errors-OBJECT.png`` one
    object with all methods, variants and steps.
    """
    (folder / "paper.md").write_text(markdown, encoding="utf-8")
    (folder / "paper.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    fewest = min(e.steps for e in entries)
    draw_error_maps(folder / "overview.png", _of(entries, "paper", fewest))
    for thing in _unique(e.thing for e in entries):
        own = [e for e in entries if e.thing == thing]
        draw_error_maps(folder / f"errors-{thing}.png", own)


def draw_error_maps(path: Path, entries: Sequence[Entry], /) -> None:
    """Draw right, wrong and missing points: a row for each object, number of steps and group.

    Parameters
    ----------
    path : PNG to write
    entries : sequence of Entry
    """
    rows: dict[str, list[Entry]] = {}
    for entry in entries:
        rows.setdefault(_row_title(entry), []).append(entry)
    windows = [_window(own) for own in rows.values()]
    n_cols = max(MIN_COLUMNS, *(len(own) for own in rows.values()))
    heights = [
        PANEL_INCHES * (high.stop - high.start) / (wide.stop - wide.start) + TITLE_INCHES
        for high, wide in windows
    ]
    figure = Figure(figsize=(PANEL_INCHES * n_cols + 0.4, sum(heights) + 0.4), dpi=100,
                    layout="constrained")  # fmt: skip
    axes = figure.subplots(len(rows), n_cols, squeeze=False, height_ratios=heights)
    for axis in axes.ravel():
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
    for (title, own), line, window in zip(rows.items(), axes, windows, strict=True):
        line[0].set_ylabel(title, fontsize=8)
        for entry, axis in zip(own, line, strict=False):
            _draw(axis, entry, window)
    handles = [Patch(color=color, label=MEANINGS[v]) for v, color in COLORS.items()]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, frameon=False, fontsize=8)
    figure.savefig(path)


def _row_title(entry: Entry) -> str:
    kind = {"paper": "", "variant": ", variants", "table": ", lit table"}[entry.group]
    return f"{entry.thing}\n{entry.steps} steps{kind}"


def _draw(axis: Axes, entry: Entry, window: tuple[slice, slice]) -> None:
    found = _percent(_found(entry), 1)
    text = f"{found} %" if entry.verdict is not None else "no result"
    axis.set_title(f"{entry.method}\n{entry.n_images} images: {text}", fontsize=8, loc="left")
    palette = np.array([to_rgb(c) for c in (NOTHING, *(COLORS[v] for v in sorted(Verdict)))])
    size = [part.stop - part.start for part in window]
    picture = np.broadcast_to(palette[0], (*size, 3)).copy()
    if entry.verdict is not None and entry.shade is not None:
        verdict = entry.verdict[window]
        picture = palette[verdict + 1]
        right = verdict == Verdict.RIGHT
        shade = np.clip(entry.shade[window][right, None], 0, 1)
        picture[right] *= 0.35 + 0.65 * np.round(SHADES * shade) / SHADES
    axis.imshow(picture, interpolation="nearest")


def _window(entries: Sequence[Entry]) -> tuple[slice, slice]:
    """Return the part of the image that holds the object, or points, with a margin."""
    maps = [e.verdict for e in entries if e.verdict is not None]
    if not maps:
        return slice(0, 4), slice(0, 5)
    there: NDArray[np.int8] = np.max(maps, axis=0)
    return _span(there.max(axis=1) >= 0), _span(there.max(axis=0) >= 0)


def _span(there: NDArray[np.bool_]) -> slice:
    places = np.flatnonzero(there)
    if not len(places):
        return slice(0, len(there))
    return slice(
        max(0, int(places[0]) - MARGIN_PX), min(len(there), int(places[-1]) + MARGIN_PX + 1)
    )
