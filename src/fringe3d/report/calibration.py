"""What a calibration leaves besides the rig file: figures, text and a map of what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.calibrate import FittedProjector, LitPoints, rests
from fringe3d.health import Finding, axis_name
from fringe3d.io.atomic import write_text
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Rig
from fringe3d.report.saving import save_figure

Floats = NDArray[np.float64]

SCALES_PX = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Colour scales end at the first of them that holds 95 % of the residuals."""

HELD_BY_SCALE = 95.0
SMOOTH_PX = 8
"""Pixels along a side of the window of means: its noise is an eighth."""

MAP = "RdBu_r"
BACKGROUND = "#d9dce1"
BARS = 81
ROW_INCHES = 4.3
MAX_NAME = 36


def projector_record(
    fitted: FittedProjector,
    scans: Sequence[LitPoints],
    findings: Sequence[Finding],
    /,
    *,
    previous_px: float | None = None,
) -> dict[str, Any]:
    """Return the figures of a fit as plain data.

    Parameters
    ----------
    fitted : FittedProjector
    scans : sequence of LitPoints that it was fitted to
    findings : sequence of Finding; what the checks found
    previous_px : float or None, px; median residual of the projector that it replaces
    """
    left = rests(fitted, scans)
    residual = np.concatenate([r.ravel() for r in fitted.residual_px])
    device = fitted.device
    return {
        "projector": {
            "name": device.name,
            "size": [device.n_cols, device.n_rows],
            "focal_px": device.focal_px.tolist(),
            "center_px": device.center_px.tolist(),
            "distortion": device.distortion[:5].tolist(),
            "rotation": device.device_from_world.rotation.tolist(),
            "translation_mm": device.device_from_world.translation.tolist(),
            "position_mm": device.center_world.tolist(),
        },
        "lens": fitted.lens,
        "directions": fitted.n_directions,
        "points": sum(scan.n_points for scan in scans),
        "points_used": fitted.n_used,
        "residual_median_px": float(np.nanmedian(np.abs(residual))),
        "residual_rms_px": _together([(rest.rms_px, rest.n_points) for rest in left]),
        "held_out_rms_px": fitted.held_out_rms_px,
        "noise_px": fitted.noise_px,
        "extra_noise_px": fitted.extra_px,
        "depth_part": fitted.depth_part,
        "is_determined": fitted.is_determined,
        "previous_median_px": previous_px,
        "parameters": [asdict(parameter) for parameter in fitted.parameters],
        "lenses_tried": [asdict(trial) for trial in fitted.trials],
        "scans": [asdict(rest) | {"angle": round(math.degrees(rest.angle), 6)} for rest in left],
        "health": [
            {"level": f.level, "name": f.name, "value": f.value, "text": f.text} for f in findings
        ],
    }


def _together(parts: Sequence[tuple[float, int]]) -> float:
    """Return the root mean square of several, weighted by their numbers."""
    total = sum(n for _, n in parts)
    return math.sqrt(sum(rms**2 * n for rms, n in parts) / total)


def projector_text(record: dict[str, Any], /) -> str:
    """Return the figures of a fit in words, for the terminal and the report."""
    n_scans = len({scan["scan"] for scan in record["scans"]})
    directions = "one direction" if record["directions"] == 1 else "two directions"
    lines = [
        f"projector from {n_scans} scan{'s' * (n_scans > 1)}, {record['points']:,} points, "
        f"fringes of {directions}",
        f"residual: median {record['residual_median_px']:.3f} px, rms "
        f"{record['residual_rms_px']:.3f} px; noise of phases and points "
        f"{record['noise_px']:.3f} px; held-out rms {record['held_out_rms_px']:.3f} px",
    ]
    if record["previous_median_px"] is not None:
        lines.append(
            f"the projector that it replaces: median residual {record['previous_median_px']:.3f} px"
        )
    lines += [f"{f['level']}: {f['text']}" for f in record["health"] if f["level"] == "ok"]
    lines += ["", *_parameter_lines(record), "", *_lens_lines(record), "", *_scan_lines(record)]
    return "\n".join(lines)


def _parameter_lines(record: dict[str, Any]) -> list[str]:
    lines = [f"{'number':<22}{'value':>12}{'sigma':>10}  held by"]
    for p in record["parameters"]:
        digits = 5 if abs(p["value"]) < 1 else 3
        sigma = "-" if p["held_by"] == "convention" else f"{p['sigma']:.2g}"
        lines.append(f"{p['name']:<22}{p['value']:>12.{digits}f}{sigma:>10}  {p['held_by']}")
    return lines


def _lens_lines(record: dict[str, Any]) -> list[str]:
    lines = [f"{'lens':<22}{'held-out rms, px':>18}"]
    for trial in record["lenses_tried"]:
        mark = "  <- chosen" if trial["lens"] == record["lens"] else ""
        lines.append(f"{trial['lens']:<22}{trial['held_out_rms_px']:>18.4f}{mark}")
    return lines


def _scan_lines(record: dict[str, Any]) -> list[str]:
    width = max(22, 2 + max(len(scan["scan"]) for scan in record["scans"]))
    lines = [f"{'scan':<{width}}{'angle':>6}{'points':>10}{'median, px':>12}{'rms, px':>9}"
             f"{'outliers':>10}{'shared, px':>12}"]  # fmt: skip
    lines += [
        f"{scan['scan']:<{width}}{scan['angle']:>6.0f}{scan['n_points']:>10,}"
        f"{scan['median_px']:>12.3f}{scan['rms_px']:>9.3f}{scan['outliers']:>10.1%}"
        f"{scan['pattern_px']:>12.3f}"
        for scan in record["scans"]
    ]
    return lines


def projector_markdown(
    record: dict[str, Any], /, *, command: str, picture: str, warnings: Sequence[str]
) -> str:
    """Return the report of a fit."""
    said = "".join(f"- **warning**: {text}\n" for text in warnings)
    return (
        f"# A projector from measurements\n\n```\n{command}\n```\n\n{said}\n"
        f"```\n{projector_text(record)}\n```\n\n![What is left]({picture})\n\n"
        "Residual: where the fitted projector puts the light of a point, minus where its phase "
        "says it came from, across the fringes, in projector pixels. Sigma: standard deviation "
        "from the noise that the residuals show; errors of the cameras' calibration bend the "
        "points and the projector alike and are not in it. *convention*: fringes of one direction "
        "do not show it, and nothing that they measure depends on it. *prior*: held by what is "
        "likely for projectors, not by the data. *shared*: what neighbouring points have in "
        "common, which is not noise.\n"
    )


def targets_of(out: Path, /) -> tuple[Path, Path, Path]:
    """Return the files of a calibration: picture, report, and last the rig `out` itself."""
    return (
        out.with_name(f"{out.stem}-projector.png"),
        out.with_name(f"{out.stem}-projector.md"),
        out,
    )


def write_projector(
    out: Path,
    rig: Rig,
    fitted: FittedProjector,
    scans: Sequence[LitPoints],
    record: dict[str, Any],
    /,
    *,
    command: str,
    overwrite: bool = False,
) -> None:
    """Write picture, report and rig, each aside and then renamed; the rig last.

    Parameters
    ----------
    out : Path; the rig file
    rig : Rig with the new projector
    fitted : FittedProjector
    scans : sequence of LitPoints that it was fitted to
    record : dict; of `projector_record`
    command : str; the command line
    overwrite : bool

    Raises
    ------
    OutputError
        If something is there already, or cannot be written.
    """
    picture, report, rig_file = targets_of(out)
    warnings = [f["text"] for f in record["health"] if f["level"] != "ok"]
    title = projector_text(record).splitlines()
    draw_residuals(picture, fitted, scans, title="\n".join(title[:2]), overwrite=overwrite)
    text = projector_markdown(record, command=command, picture=picture.name, warnings=warnings)
    write_text(report, text, overwrite=overwrite)
    write_text(rig_file, rig_text(rig), overwrite=overwrite)


def draw_residuals(
    path: Path,
    fitted: FittedProjector,
    scans: Sequence[LitPoints],
    /,
    *,
    title: str,
    overwrite: bool = False,
) -> None:
    """Draw what is left of each scan and direction over the pixels of C1, and its histogram.

    One row for each: every pixel; means of windows, on a finer scale, which show patterns below
    the noise; histogram. The scales are symmetric and the same in all rows.
    """
    parts = [(scan, place) for scan in scans for place in range(len(scan.angles))]
    residuals = np.concatenate([r.ravel() for r in fitted.residual_px])
    limit = _scale(residuals)
    high, wide = np.max([np.ptp(scan.pixels, axis=0) for scan in scans], axis=0) + 1
    aspect = float(np.clip(wide / high, 0.6, 1.6))
    width = ROW_INCHES * (2 * aspect + 1) + 1.5
    figure = Figure(figsize=(width, 0.9 + ROW_INCHES * len(parts)), dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    axes = figure.subplots(len(parts), 3, squeeze=False, width_ratios=[aspect, aspect, 0.9])
    by_scan = dict(zip([id(scan) for scan in scans], fitted.residual_px, strict=True))
    smooth_limit = _scale(
        np.concatenate([_means(_map(s, by_scan[id(s)][:, p])).ravel() for s, p in parts])
    )
    for row, (scan, place) in zip(axes, parts, strict=True):
        residual = by_scan[id(scan)][:, place]
        name = f"{_short(scan.name)}, {axis_name(scan.angles[place])}"
        picture = _map(scan, residual)
        _draw_map(row[0], picture, limit, name)
        _draw_map(row[1], _means(picture), smooth_limit, f"mean of {SMOOTH_PX} x {SMOOTH_PX} px")
        _draw_histogram(row[2], residual[np.isfinite(residual)], limit)
    save_figure(path, figure, overwrite=overwrite)


def _short(name: str) -> str:
    return name if len(name) <= MAX_NAME else f"...{name[3 - MAX_NAME :]}"


def _scale(residual: Floats) -> float:
    found = residual[np.isfinite(residual)]
    needed = float(np.percentile(np.abs(found), HELD_BY_SCALE)) if len(found) else 0.0
    return next((scale for scale in SCALES_PX if scale >= needed), SCALES_PX[-1])


def _map(scan: LitPoints, residual: Floats) -> Floats:
    picture = np.full(scan.shape, np.nan)
    picture[scan.pixels[:, 0], scan.pixels[:, 1]] = residual
    return picture


def _means(picture: Floats) -> Floats:
    """Return the means of windows, cut to the typical range first: strays stay points."""
    known = np.isfinite(picture)
    limit = _scale(picture)
    value = ndimage.uniform_filter(np.where(known, np.clip(picture, -limit, limit), 0), SMOOTH_PX)
    share = ndimage.uniform_filter(known.astype(float), SMOOTH_PX)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(known & (share > 0.25), value / share, np.nan))


def _draw_map(axis: Axes, picture: Floats, limit: float, title: str) -> None:
    rows, cols = (np.flatnonzero(np.isfinite(picture).any(axis=k)) for k in (1, 0))
    image = axis.imshow(picture, cmap=MAP, vmin=-limit, vmax=limit, interpolation="nearest")
    axis.set_xlim(cols[0] - 5.5, cols[-1] + 5.5)
    axis.set_ylim(rows[-1] + 5.5, rows[0] - 5.5)
    axis.set_facecolor(BACKGROUND)
    axis.set_title(title, fontsize=10, loc="left")
    axis.tick_params(labelsize=8)
    assert axis.figure is not None
    bar = axis.figure.colorbar(image, ax=axis, shrink=0.9, pad=0.01, extend="both")
    bar.set_label("projector px", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _draw_histogram(axis: Axes, residual: Floats, limit: float) -> None:
    edges = np.linspace(-limit, limit, BARS)
    axis.hist(np.clip(residual, -limit, limit), edges.tolist(), color="#54657e")
    beyond = float((np.abs(residual) > limit).mean())
    median = float(np.median(residual))
    text = (
        f"median |r| {np.median(np.abs(residual)):.3f} px\nmedian r {median:+.3f} px\n"
        f"{beyond:.1%} beyond the scale"
    )
    axis.text(0.02, 0.97, text, transform=axis.transAxes, va="top", fontsize=9)
    axis.axvline(0, color="black", linewidth=0.6)
    axis.set_xlim(-limit, limit)
    axis.set_yticks([])
    axis.set_xticks([-limit, -limit / 2, 0, limit / 2, limit])
    axis.set_xlabel("residual, projector px", fontsize=9)
    axis.tick_params(labelsize=8)
