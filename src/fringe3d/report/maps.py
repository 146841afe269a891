"""Maps on the pixels of C1 as pictures: coloured, shaded, rejected pixels by reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fringe3d.model import Rejection
from fringe3d.model.rejection import count_by_reason

ACCEPTED = "#e8e8e8"
REASON_COLORS = (
    "#d62728", "#30343b", "#9467bd", "#8c564b", "#e377c2", "#ff7f0e", "#ffdd00",
    "#17becf", "#2ca02c", "#1f77b4", "#98df8a", "#bcbd22", "#ff9896", "#b8c4d0", "#5b4bb5",
    "#006d5b", "#b5651d",
)  # fmt: skip
SIGNED, ALONE = "RdBu_r", (150, 150, 150)
"""Colours of deviations, red where positive, and of what has none."""

MAX_PANEL_PX = 900
"""Maps are thinned to about this size; nobody sees more in one panel."""

LEGEND_COLUMNS = 3
TWO_PI = 2 * np.pi

MARGIN_PX = 12

Window = tuple[slice, slice]
Drawer = Callable[[Axes, Window], None]


def window_of(decoded: NDArray[np.bool_], /) -> Window:
    """Return the part of the image that holds decoded pixels (row, col), with a margin."""
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


def colour_map(
    title: str,
    values: NDArray[Any],
    colors: str,
    *,
    limits: tuple[float, float] | None = None,
    ticks: dict[float, str] | None = None,
) -> Drawer:
    """Draw a map in colours, within its limits or those of most of its values."""

    def draw(axis: Axes, window: Window) -> None:
        shown = thin(values, window)
        low, high = limits or robust_limits(shown)
        image = axis.imshow(shown, cmap=colors, vmin=low, vmax=high, extent=_extent(window),
                            interpolation="nearest")  # fmt: skip
        axis.set_title(title, fontsize=10, loc="left")
        bar = axis.figure.colorbar(image, ax=axis, shrink=0.85, pad=0.01)
        if ticks:
            bar.set_ticks(list(ticks), labels=list(ticks.values()))

    return draw


def wrapped_phase(title: str, phase: NDArray[np.float32]) -> Drawer:
    """Draw a phase as wrapped within (-pi, pi], whatever turn it is kept in."""
    values = np.where(phase > np.pi, phase - TWO_PI, phase)
    ticks = {
        -np.pi: "\N{MINUS SIGN}\N{GREEK SMALL LETTER PI}",
        0.0: "0",
        np.pi: "\N{GREEK SMALL LETTER PI}",
    }
    return colour_map(title, values, "twilight", limits=(-np.pi, np.pi), ticks=ticks)


def relief(title: str, depth: NDArray[np.float64]) -> Drawer:
    """Draw a depth in colours, shaded as a surface."""

    def draw(axis: Axes, window: Window) -> None:
        shown = thin(depth, window)
        low, high = robust_limits(shown)
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


def reasons(rejection: NDArray[np.unsignedinteger[Any]]) -> Drawer:
    """Draw the rejected pixels in a colour for each reason."""
    counts = count_by_reason(rejection)
    total = rejection.size
    accepted = total - sum(counts.values())

    def draw(axis: Axes, window: Window) -> None:
        bits = np.asarray(thin(rejection, window), np.int64)
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


def thin(values: NDArray[Any], window: Window) -> NDArray[Any]:
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


def _extent(window: Window) -> tuple[float, float, float, float]:
    rows, cols = window
    return cols.start - 0.5, cols.stop - 0.5, rows.stop - 0.5, rows.start - 0.5


def robust_limits(values: NDArray[Any]) -> tuple[float, float]:
    """Return the limits within which 99 % of the values lie; 0 and 1 without any."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, [0.5, 99.5])
    return float(low), float(max(high, low + 1e-6))


def deviation_colours(signed_mm: NDArray[np.float64], limit_mm: float, /) -> NDArray[np.uint8]:
    """Return the colours (n, 3) of deviations (n,); grey where none is known.

    Examples
    --------
    >>> deviation_colours(np.array([-1.0, 0.0, 1.0, np.nan]), 1.0).tolist()
    [[5, 48, 97], [247, 246, 246], [103, 0, 31], [150, 150, 150]]
    """
    part = 0.5 + signed_mm / (2 * limit_mm)
    colours = np.asarray(255 * colormaps[SIGNED](part)[:, :3]).astype(np.uint8)
    colours[~np.isfinite(signed_mm)] = ALONE
    return colours
