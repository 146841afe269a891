"""Maps over the pixels of C1: periods per segment, predicted sigma, ambiguity margin."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.design import Assessment
from fringe3d.design.counts import spread_pixels
from fringe3d.design.margin import NEEDED_RATIO

NO_MARGIN = "#aab0ba"

Points = NDArray[np.float64]


def draw_maps(path: Path, a: Assessment, /, *, title: str) -> None:
    """Draw periods per segment, predicted sigma and ambiguity margin over the pixels of C1."""
    camera = a.rig.cameras[0]
    panels = _panels(a)
    n_cols = min(2, len(panels))
    n_rows = -(-len(panels) // n_cols)
    height = 5.6 * camera.n_rows / camera.n_cols + 0.9
    figure = Figure(figsize=(6.6 * n_cols, n_rows * height + 0.5), dpi=100, layout="constrained")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        _draw_map(axis, panel)
        axis.set(xlim=(-0.5, camera.n_cols - 0.5), ylim=(camera.n_rows - 0.5, -0.5))
        axis.set_aspect("equal")
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    figure.suptitle(f"{title}: over the pixels of '{camera.name}'", fontsize=12, x=0.01, ha="left")
    figure.savefig(path)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Panel:
    """A map: title, values (row, col), the pixels of its rows and columns, colours, upper end."""

    title: str
    values: Points
    xs: Points
    ys: Points
    colors: str = "viridis"
    top: float | None = None
    has_steps: bool = False


def _panels(a: Assessment) -> list[_Panel]:
    """Return the maps that a rig has."""
    rows, cols = a.rig.cameras[0].shape
    grid = spread_pixels((rows, cols), a.step)
    xs, ys = grid[0, :, 0], grid[:, 0, 1]
    found = []
    if a.projector_periods is not None:
        found.append(_Panel(title="periods on the projector's segment",
                            values=a.projector_periods, xs=xs, ys=ys,
                            has_steps=True))  # fmt: skip
    if a.segments is not None:
        found.append(
            _Panel(
                title="periods on C2's segment",
                values=a.segments.periods,
                xs=xs,
                ys=ys,
                has_steps=True,
            )
        )
    sigma = 1000 * a.uncertainty.sigma_mm
    step = -(-cols // sigma.shape[1])
    found.append(_Panel(title="predicted sigma of the points, um", values=sigma, colors="magma",
                        xs=step * np.arange(sigma.shape[1]),
                        ys=step * np.arange(sigma.shape[0])))  # fmt: skip
    if a.margins is not None:
        slope, pixels = np.degrees(a.margins.slopes[-1]), a.margins.pixels
        words = (
            f"ambiguity margin over its sigma, slopes to {slope:.0f} deg ({NEEDED_RATIO:g}: safe)"
        )
        found.append(_Panel(title=words, values=a.margins.ratio[-1], colors="RdYlGn",
                            top=2 * NEEDED_RATIO, xs=pixels[0, :, 0],
                            ys=pixels[:, 0, 1]))  # fmt: skip
    return found


def _draw_map(axis: Axes, panel: _Panel) -> None:
    """Draw a map with its colour bar; a margin of 0 is grey, and said."""
    values = panel.values
    shown = values[np.isfinite(values)]
    low, high = shown.min(), max(shown.max(), shown.min() + 1e-6)
    if panel.top is not None:
        low, high = 0.0, panel.top
        none = np.ma.masked_where(values != 0, values)
        axis.pcolormesh(panel.xs, panel.ys, none, shading="nearest",
                        cmap=ListedColormap([NO_MARGIN]))  # fmt: skip
        values = np.where(values == 0, np.nan, values)
        part = (shown == 0).mean()
        if part > 0:
            words = f"grey: 0 ({100 * part:.0f} % of the pixels);\na wrong order fits as well"
            axis.text(0.5, 0.5, words, transform=axis.transAxes, ha="center", va="center",
                      fontsize=10, bbox={"facecolor": "white", "edgecolor": "none",
                                         "alpha": 0.85})  # fmt: skip
    image = axis.pcolormesh(panel.xs, panel.ys, values, cmap=panel.colors, vmin=low, vmax=high,
                            shading="nearest")  # fmt: skip
    axis.figure.colorbar(image, ax=axis, shrink=0.85, pad=0.01,
                         extend="neither" if panel.top is None else "max")  # fmt: skip
    if panel.has_steps:
        _draw_powers_of_two(axis, panel)
    axis.set_title(panel.title, fontsize=10, loc="left")
    axis.set_xlabel("x, px", fontsize=9)
    axis.set_ylabel("y, px", fontsize=9)
    axis.set_facecolor("#101216")
    axis.tick_params(labelsize=8)


def _draw_powers_of_two(axis: Axes, panel: _Panel) -> None:
    """Draw lines where one bit more is needed."""
    low, top = np.nanmin(panel.values), np.nanmax(panel.values)
    levels = [2.0**n for n in range(12) if low < 2.0**n < top]
    if levels:
        lines = axis.contour(panel.xs, panel.ys, panel.values, levels=levels, colors="white",
                             linewidths=0.8)  # fmt: skip
        axis.clabel(lines, fmt="%g", fontsize=8)
