"""One picture that shows a measurement at a glance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fringe3d.health import axis_name, period_disagreement
from fringe3d.model import PhaseMap, Rejection
from fringe3d.model.rejection import count_by_reason
from fringe3d.pipeline import Measurement

ACCEPTED = "#e8e8e8"
REASON_COLORS = (
    "#d62728", "#30343b", "#9467bd", "#8c564b", "#e377c2", "#ff7f0e", "#ffdd00",
    "#17becf", "#2ca02c", "#1f77b4", "#98df8a", "#bcbd22", "#ff9896", "#b8c4d0", "#5b4bb5",
)  # fmt: skip
MAX_PANEL_PX = 900
"""Maps are thinned to about this size; nobody sees more in one panel."""

MARGIN_PX = 12
LEGEND_COLUMNS = 3
TWO_PI = 2 * np.pi


def write_overview(path: Path, result: Measurement, /, *, title: str) -> None:
    """Write the overview of a measurement as PNG.

    With points: image, modulation, wrapped phase, order, depth, rejected pixels by reason.
    Without a rig: the wrapped phase of every period and direction, and how the periods agree.
    """
    panels = _phase_panels(result) if result.points is None else _point_panels(result)
    n_cols = 3
    n_rows = -(-len(panels) // n_cols)
    window = _window(result)
    height, width = (s.stop - s.start for s in window)
    aspect = float(np.clip(height / width, 0.5, 1.5))
    size = (16.5, 1.0 + n_rows * (5.0 * aspect + 0.75))
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    for axis, draw in zip(axes, panels, strict=False):
        draw(axis, window)
        axis.set_facecolor("#101216")
        axis.tick_params(labelsize=8)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    figure.savefig(path)


def _window(result: Measurement) -> tuple[slice, slice]:
    """Return the part of the image that holds decoded pixels, with a margin."""
    decoded = np.isfinite(result.main.phase)
    if not decoded.any():
        return slice(0, decoded.shape[0]), slice(0, decoded.shape[1])
    bounds = []
    for axis in (1, 0):
        # 0.05 % of the decoded pixels may lie outside: stray pixels do not set the scale.
        profile = np.cumsum(decoded.sum(axis=axis)) / decoded.sum()
        low, high = np.searchsorted(profile, [0.0005, 0.9995])
        margin = MARGIN_PX + int(0.03 * (high - low))
        bounds.append(slice(max(0, int(low) - margin), min(len(profile), int(high) + margin)))
    return bounds[0], bounds[1]


Drawer = Any


def _point_panels(result: Measurement) -> list[Drawer]:
    main = result.main
    assert result.points is not None
    assert result.matches is not None
    depth = result.points.points_mm[..., 2]
    order = np.where(result.matches.rejection == 0, result.matches.fringe_order, np.nan)
    is_code = main.is_quantised
    wrapped = (
        _map("projector column, px", main.position_px, "viridis")
        if is_code
        else _wrapped("wrapped phase, rad", main.phase)
    )
    return [
        _map(f"image: mean brightness of '{main.device_name}', DN", main.offset, "gray"),
        _map("modulation (fringe contrast), DN", main.modulation, "magma"),
        wrapped,
        _map("code cell" if main.is_quantised else "fringe order", order, "nipy_spectral"),
        _relief("depth z, mm (shaded)", depth),
        _reasons(result.rejection),
    ]


def _phase_panels(result: Measurement) -> list[Drawer]:
    panels: list[Drawer] = [
        _map(f"image: mean brightness of '{result.main.device_name}', DN", result.main.offset,
             "gray"),
        _map("modulation (fringe contrast), DN", result.main.modulation, "magma"),
        _reasons(result.rejection),
    ]  # fmt: skip
    for direction in result.phases[0].directions:
        axis = axis_name(direction.main.angle)
        for phases in (direction.main, *direction.others):
            label = f"{axis}, period {phases.period_px:g} px"
            panels.append(_wrapped(f"wrapped phase, rad: {label}", phases.phase))
        if direction.main.is_absolute:
            panels.append(
                _map(f"projector coordinate, px: {axis}", direction.main.position_px, "viridis")
            )
        panels += [_disagreement(direction.main, other) for other in direction.others]
    return panels


def _disagreement(main: PhaseMap, other: PhaseMap) -> Drawer:
    title = (
        f"disagreement of the periods, px: {axis_name(main.angle)}, "
        f"{main.period_px:g} - {other.period_px:g}"
    )
    difference = period_disagreement(main, other)
    limit = float(np.nanpercentile(np.abs(difference), 99)) if np.isfinite(difference).any() else 1
    return _map(title, difference, "RdBu_r", limits=(-limit, limit))


def _map(
    title: str,
    values: NDArray[Any],
    colors: str,
    *,
    limits: tuple[float, float] | None = None,
    ticks: dict[float, str] | None = None,
) -> Drawer:
    def draw(axis: Axes, window: tuple[slice, slice]) -> None:
        shown = _thin(values, window)
        low, high = limits or _robust_limits(shown)
        image = axis.imshow(shown, cmap=colors, vmin=low, vmax=high, extent=_extent(window),
                            interpolation="nearest")  # fmt: skip
        axis.set_title(title, fontsize=10, loc="left")
        bar = axis.figure.colorbar(image, ax=axis, shrink=0.85, pad=0.01)
        if ticks:
            bar.set_ticks(list(ticks), labels=list(ticks.values()))

    return draw


def _wrapped(title: str, phase: NDArray[np.float32]) -> Drawer:
    """Draw a phase as wrapped within (-pi, pi], whatever turn it is kept in."""
    values = np.where(phase > np.pi, phase - TWO_PI, phase)
    ticks = {
        -np.pi: "\N{MINUS SIGN}\N{GREEK SMALL LETTER PI}",
        0.0: "0",
        np.pi: "\N{GREEK SMALL LETTER PI}",
    }
    return _map(title, values, "twilight", limits=(-np.pi, np.pi), ticks=ticks)


def _relief(title: str, depth: NDArray[np.float64]) -> Drawer:
    def draw(axis: Axes, window: tuple[slice, slice]) -> None:
        shown = _thin(depth, window)
        low, high = _robust_limits(shown)
        image = axis.imshow(shown, cmap="turbo_r", vmin=low, vmax=high, extent=_extent(window),
                            interpolation="nearest")  # fmt: skip
        axis.figure.colorbar(image, ax=axis, shrink=0.85, pad=0.01)
        colored = image.to_rgba(shown)[..., :3]
        gradient = np.hypot(*np.gradient(shown))
        slope = float(np.nanmedian(gradient)) if np.isfinite(gradient).any() else 1.0
        filled = np.where(np.isfinite(shown), shown, high)
        light = LightSource(azdeg=315, altdeg=50)
        shade = light.hillshade(-filled, vert_exag=0.5 / max(slope, 1e-9))
        mixed = colored * (0.35 + 0.65 * shade[..., None])
        missing = ~np.isfinite(shown)
        mixed[missing] = (0.06, 0.07, 0.09)
        axis.imshow(np.clip(mixed, 0, 1), extent=_extent(window), interpolation="nearest")
        axis.set_title(title, fontsize=10, loc="left")

    return draw


def _reasons(rejection: NDArray[np.uint16]) -> Drawer:
    counts = count_by_reason(rejection)
    total = rejection.size
    accepted = total - sum(counts.values())

    def draw(axis: Axes, window: tuple[slice, slice]) -> None:
        bits = np.asarray(_thin(rejection, window), np.int64)
        lowest = bits & -bits
        number = np.where(lowest > 0, np.log2(np.maximum(lowest, 1)) + 1, 0)
        colors = ListedColormap([ACCEPTED, *REASON_COLORS])
        axis.imshow(number, cmap=colors, vmin=-0.5, vmax=len(REASON_COLORS) + 0.5,
                    extent=_extent(window), interpolation="nearest")  # fmt: skip
        handles = [Patch(color=ACCEPTED, label=f"accepted: {accepted:,}")]
        for reason, color in zip(Rejection, REASON_COLORS, strict=True):
            if reason.name in counts:
                words = (reason.name or "").replace("_", " ").lower()
                handles.append(Patch(color=color, label=f"{words}: {counts[reason.name]:,}"))
        axis.set_title(f"rejected by reason, of {total:,} pixels", fontsize=10, loc="left")
        axis.legend(handles=handles, fontsize=7.5, ncols=LEGEND_COLUMNS, frameon=False,
                    loc="upper center", bbox_to_anchor=(0.5, -0.08))  # fmt: skip

    return draw


def _thin(values: NDArray[Any], window: tuple[slice, slice]) -> NDArray[Any]:
    """Thin a map; a block takes its first pixel with a value, so that sparse points stay seen."""
    part = values[window]
    step = max(1, int(np.ceil(max(part.shape) / MAX_PANEL_PX)))
    rows, cols = (n // step * step for n in part.shape)
    blocks = part[:rows, :cols].reshape(rows // step, step, cols // step, step)
    thin = blocks[:, 0, :, 0].copy()
    for i, j in np.ndindex(step, step):
        other = blocks[:, i, :, j]
        empty = np.isnan(thin) if thin.dtype.kind == "f" else thin != 0
        filled = np.isfinite(other) if thin.dtype.kind == "f" else other == 0
        thin = np.where(empty & filled, other, thin)
    return thin


def _extent(window: tuple[slice, slice]) -> tuple[float, float, float, float]:
    rows, cols = window
    return cols.start - 0.5, cols.stop - 0.5, rows.stop - 0.5, rows.start - 0.5


def _robust_limits(values: NDArray[Any]) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, [0.5, 99.5])
    return float(low), float(max(high, low + 1e-6))
