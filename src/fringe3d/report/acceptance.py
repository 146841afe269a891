"""The report of an acceptance test: values, limits, decisions; residuals as a picture."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.evaluate import Decision, Probed, Sphere, decide, fit_covariance, spacing_mm
from fringe3d.io.atomic import new_folder
from fringe3d.io.clouds import CloudFile
from fringe3d.io.results import write_coloured_ply
from fringe3d.report.maps import deviation_colours

Floats = NDArray[np.float64]

N_COLUMNS = 3
PANEL_INCHES = 4.6
HELD_BY_SCALE = 99.7
MAP = "RdBu_r"
MOST_CELLS, POINTS_IN_CELL = 400, 3
NAMES = {
    "form": "probing error, form",
    "form 95 %": "95 % form",
    "size": "probing error, size",
    "spacing": "sphere spacing error",
    "flatness": "flatness",
    "flatness 95 %": "95 % flatness",
}
NORMS = (
    "Values after VDI/VDE 2634 part 2 (part 3 where clouds were merged from several views): "
    "least-squares surfaces of free size and place, all points weighed alike; up to 3 per "
    "mille of the points may be left out. Form: largest minus smallest radial deviation. "
    "Size: fitted minus calibrated diameter. Spacing: measured minus calibrated distance of "
    "the centres. Flatness: largest minus smallest distance from the plane. 95 %: the "
    "shortest interval that holds 95 % of the deviations; reported, not judged. Nothing was "
    "filtered here; what `measure` filtered stands in its `measure.toml`.\n\n"
    "Decision after ISO 14253-1: a value passes if it keeps its limit with all of the "
    "expanded uncertainty U (k = 2) of the artefact's calibration, fails if it exceeds it "
    "with all of U, and is not decided between. As in ISO/TS 23165 the noise of the system "
    "under test belongs to its error, not to U; how far it moves the fitted value is told "
    "beside it (sigma of fit, as if the noise of neighbours were independent)."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Position:
    """One result with what was found in it.

    Parameters
    ----------
    name : str; path of the result
    kind : str; ball, ball bar or plane
    cloud : CloudFile
    probed : tuple of Probed; two of a ball bar
    diameter_mm, distance_mm : float or None, mm; calibrated
    """

    name: str
    kind: str
    cloud: CloudFile
    probed: tuple[Probed, ...]
    diameter_mm: float | None = None
    distance_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of the values, None where there is none; expanded uncertainty of the artefacts, mm."""

    form_mm: float | None = None
    size_mm: float | None = None
    spacing_mm: float | None = None
    flatness_mm: float | None = None
    uncertainty_mm: float = 0.0


def acceptance_record(
    positions: Sequence[Position], limits: Limits, /, *, cap_deg: float, margin_mm: float
) -> dict[str, Any]:
    """Return all values with limits and decisions as plain data.

    Parameters
    ----------
    positions : sequence of Position
    limits : Limits
    cap_deg, margin_mm : float; which part of balls and planes was fitted
    """
    values = [value for position in positions for value in _values(position, limits)]
    decisions = [value["decision"] for value in values if value["judged"]]
    return {
        "decision": _overall(decisions),
        "limits": asdict(limits),
        "cap_deg": cap_deg,
        "margin_mm": margin_mm,
        "values": values,
    }


def _overall(decisions: Sequence[str]) -> str:
    for decision in (Decision.FAIL, Decision.OPEN, Decision.PASS):
        if decision.value in decisions:
            return decision.value
    return Decision.NO_LIMIT.value


def _values(position: Position, limits: Limits) -> Iterator[dict[str, Any]]:
    for number, probed in enumerate(position.probed, 1):
        fit = probed.fit
        at = fit.surface.center_mm
        where = position.name + (f", ball {number}" if len(position.probed) > 1 else "")
        about = {
            "where": where,
            "center_mm": [round(float(value), 4) for value in at],
            "points": fit.n_used,
            "left_out": fit.n_rejected,
            "far": probed.n_far,
            "sigma_mm": fit.sigma_mm,
        }
        is_ball = isinstance(fit.surface, Sphere)
        word, limit = ("form", limits.form_mm) if is_ball else ("flatness", limits.flatness_mm)
        yield _value(word, fit.form_mm, limit, limits, about)
        yield _value(f"{word} 95 %", fit.form95_mm, None, limits, about, judged=False)
        if isinstance(fit.surface, Sphere):
            assert position.diameter_mm is not None
            size = 2 * fit.surface.radius_mm - position.diameter_mm
            sigma = None if (c := _covariance(position, probed)) is None else 2 * c[3, 3] ** 0.5
            yield _value("size", size, limits.size_mm, limits, about, sigma=sigma)
    if len(position.probed) == 2:
        assert position.distance_mm is not None
        error = spacing_mm(*position.probed) - position.distance_mm
        about = {"where": position.name, "center_mm": None, "points": None, "left_out": None,
                 "far": None, "sigma_mm": None}  # fmt: skip
        sigma = _spacing_sigma(position)
        yield _value("spacing", error, limits.spacing_mm, limits, about, sigma=sigma)


def _value(
    word: str,
    value_mm: float,
    limit_mm: float | None,
    limits: Limits,
    about: dict[str, Any],
    *,
    sigma: float | None = None,
    judged: bool = True,
) -> dict[str, Any]:
    decision = decide(value_mm, limit_mm, limits.uncertainty_mm)
    return {
        "value": word,
        **about,
        "value_mm": value_mm,
        "sigma_of_fit_mm": None if sigma is None else float(sigma),
        "limit_mm": limit_mm,
        "judged": judged,
        "decision": decision.value,
    }


def _covariance(position: Position, probed: Probed) -> Floats | None:
    """Return the covariance of a sphere's numbers from the points' sigma; None without."""
    noise = position.cloud.noise_mm
    if noise is None or not isinstance(probed.fit.surface, Sphere):
        return None
    points = position.cloud.points_mm[probed.chosen]
    across = (probed.fit.surface.normals(points) * noise[probed.chosen]).sum(axis=1)
    return fit_covariance(points, probed.fit, sigma_mm=np.abs(across))


def _spacing_sigma(position: Position) -> float | None:
    ends = [probed.fit.surface.center_mm for probed in position.probed]
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    variance = 0.0
    for probed in position.probed:
        covariance = _covariance(position, probed)
        if covariance is None:
            return None
        variance += float(along @ covariance[:3, :3] @ along)
    return float(np.sqrt(variance))


def acceptance_text(record: dict[str, Any], /) -> str:
    """Return the worst value of each kind, a line each, and the decision."""
    lines = []
    for word, name in NAMES.items():
        own = [value for value in record["values"] if value["value"] == word]
        if not own:
            continue
        worst = max(own, key=lambda value: abs(value["value_mm"]))
        limit = _limit_words(worst)
        lines.append(
            f"{name}: {_um(worst['value_mm'], _form(word))} um at worst of {len(own)} "
            f"({worst['where']}){limit}"
        )
    uncertainty = 1000 * record["limits"]["uncertainty_mm"]
    lines.append(f"decision: {record['decision']} (U = {uncertainty:g} um, k = 2)")
    return "\n".join(lines)


def _limit_words(value: dict[str, Any]) -> str:
    if value["limit_mm"] is None:
        return ""
    return f", limit {1000 * value['limit_mm']:g} um: {value['decision']}"


def acceptance_markdown(record: dict[str, Any], /, *, command: str) -> str:
    """Return the report as Markdown; overview.png lies beside it."""
    rows = [
        "| value | artefact | centre, mm | points | left out | too far | sigma, um | value, um | "
        "sigma of fit, um | limit, um | decision |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for value in record["values"]:
        center = value["center_mm"]
        cells = [
            NAMES[value["value"]],
            value["where"],
            "" if center is None else ", ".join(f"{round(c, 2) + 0.0:.2f}" for c in center),
            *("" if value[k] is None else f"{value[k]:,}" for k in ("points", "left_out", "far")),
            _um(value["sigma_mm"], ".1f"),
            _um(value["value_mm"], _form(value["value"])),
            _um(value["sigma_of_fit_mm"], ".2f"),
            _um(value["limit_mm"], "g"),
            value["decision"] if value["judged"] else "reported",
        ]
        rows.append("| " + " | ".join(cells) + " |")
    uncertainty = 1000 * record["limits"]["uncertainty_mm"]
    return "\n".join([
        f"# Acceptance: {record['decision']}", "", "```", acceptance_text(record), "```", "",
        "![residuals](overview.png)", "", *rows, "",
        f"Balls: a cap of {record['cap_deg']:g} deg about the middle of what was measured. Planes: "
        f"without a border of {record['margin_mm']:g} mm. U = {uncertainty:g} um. *Left out*: of "
        "the 3 per mille. *Too far*: points over the part that was fitted that belong to something "
        "else, or are gross errors: look at them.", "", NORMS, "", f"`{command}`", "",
    ])  # fmt: skip


def _form(word: str) -> str:
    return "+.1f" if word in ("size", "spacing") else ".1f"


def _um(value_mm: float | None, form: str) -> str:
    return "" if value_mm is None else f"{1000 * value_mm:{form}}"


def write_acceptance(
    out: Path,
    positions: Sequence[Position],
    record: dict[str, Any],
    markdown: str,
    /,
    *,
    overwrite: bool = False,
) -> None:
    """Write ``acceptance.md``, ``acceptance.json``, ``overview.png`` and ``deviations.ply``."""
    with new_folder(out, overwrite=overwrite) as folder:
        (folder / "acceptance.md").write_text(markdown, encoding="utf-8")
        (folder / "acceptance.json").write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        draw_residuals(folder / "overview.png", positions, title=acceptance_text(record))
        _write_points(folder / "deviations.ply", positions)


def _write_points(path: Path, positions: Sequence[Position]) -> None:
    """Write the points that were fitted, with their distances from the surfaces."""
    parts = [(position, probed) for position in positions for probed in position.probed]
    points = np.concatenate([p.cloud.points_mm[probed.chosen] for p, probed in parts])
    distances = np.concatenate([probed.fit.distances_mm for _, probed in parts])
    limit = max(float(np.percentile(np.abs(distances), HELD_BY_SCALE)), 1e-9)
    view = next((p.cloud.viewpoint_mm for p in positions if p.cloud.viewpoint_mm is not None), None)
    colours = deviation_colours(distances, limit)
    write_coloured_ply(path, points, colours, viewpoint_mm=view, deviation_mm=distances)


def draw_residuals(path: Path, positions: Sequence[Position], /, *, title: str) -> None:
    """Draw the residuals of each fitted surface as a map, seen along its middle normal.

    All maps have one scale; it holds 99.7 % of the residuals.
    """
    parts = [(position, probed) for position in positions for probed in position.probed]
    shown = np.concatenate([p.fit.distances_mm[p.fit.is_used] for _, p in parts])
    limit = 1000 * float(np.percentile(np.abs(shown), HELD_BY_SCALE)) or 1.0
    n_cols = min(max(len(parts), 2), N_COLUMNS)
    n_rows = -(-len(parts) // n_cols)
    n_lines = title.count("\n") + 1
    size = (n_cols * PANEL_INCHES, n_rows * PANEL_INCHES + 0.25 * n_lines + 0.3)
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    for axis, (position, probed) in zip(axes, parts, strict=False):
        image = _draw_map(axis, position, probed, limit)
    for axis in axes[len(parts) :]:
        axis.set_visible(False)
    bar = figure.colorbar(image, ax=list(axes), shrink=0.8, pad=0.01, extend="both")
    bar.set_label("measured minus fitted, um: positive outside, or above", fontsize=9)
    figure.savefig(path)


def _draw_map(axis: Axes, position: Position, probed: Probed, limit_um: float) -> Any:
    points = position.cloud.points_mm[probed.chosen]
    fit = probed.fit
    normal = (
        fit.surface.normals(points).mean(axis=0)
        if isinstance(fit.surface, Sphere)
        else fit.surface.normal
    )
    flat = seen_along(points, normal)
    picture, extent = means_on_grid(flat, 1000 * fit.distances_mm, n_cells(len(flat)))
    image = axis.imshow(picture, cmap=MAP, vmin=-limit_um, vmax=limit_um, extent=extent,
                        interpolation="nearest")  # fmt: skip
    axis.plot(*flat[~fit.is_used].T, "x", color="black", markersize=3, markeredgewidth=0.6)
    axis.set_facecolor("#d9dce1")
    word = "flatness" if position.kind == "plane" else "form"
    name = position.name if len(position.name) < 36 else f"...{position.name[-33:]}"
    axis.set_title(
        f"{position.kind}, {name}\n{word} {1000 * fit.form_mm:.1f} um, 95 % "
        f"{1000 * fit.form95_mm:.1f}, sigma {1000 * fit.sigma_mm:.1f}; {fit.n_used:,} points",
        fontsize=9, loc="left",
    )  # fmt: skip
    axis.set_xlabel("mm", fontsize=8)
    axis.tick_params(labelsize=8)
    return image


def n_cells(n_points: int, /) -> int:
    """Return how many cells a map of points has along its longer side: some points in each."""
    return int(np.clip(np.sqrt(n_points / POINTS_IN_CELL), 8, MOST_CELLS))


def seen_along(points_mm: Floats, direction: Floats, /) -> Floats:
    """Return points on a picture that looks along a direction, (n, 2) mm, x to the right.

    The world's x axis points to the right, unless the view is along it.
    """
    ahead = direction / np.linalg.norm(direction)
    right = np.eye(3)[0] if abs(ahead[0]) < 0.9 else np.eye(3)[1]
    right = right - (right @ ahead) * ahead
    right /= np.linalg.norm(right)
    return np.asarray(points_mm @ np.column_stack([right, np.cross(ahead, right)]))


def means_on_grid(
    flat: Floats, values: Floats, n_bins: int, /
) -> tuple[Floats, tuple[float, float, float, float]]:
    """Return means of values in square cells, NaN where there are none, and the picture's extent.

    Parameters
    ----------
    flat : (n, 2) float; x to the right, y upwards
    values : (n,) float
    n_bins : int; cells along the longer side
    """
    low, high = flat.min(axis=0), flat.max(axis=0)
    cell = max(float((high - low).max()) / n_bins, 1e-9)
    cols, rows = ((flat - low) / cell).astype(int).T
    shape = (int(rows.max()) + 1, int(cols.max()) + 1)
    place = (shape[0] - 1 - rows) * shape[1] + cols
    count = np.bincount(place, minlength=shape[0] * shape[1])
    total = np.bincount(place, values, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        picture = (total / count).reshape(shape)
    top = low + cell * np.array([shape[1], shape[0]])
    return picture, (float(low[0]), float(top[0]), float(low[1]), float(top[1]))
