"""Pictures in one line, for notebooks and scripts.

    from fringe3d import plot
    plot.result(result)                     # shows itself at the end of a notebook's cell
    plot.depth(result).save("depth.png")

The command line draws the same with ``fringe3d measure`` and ``fringe3d report``.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.io.atomic import write_text
from fringe3d.io.stored import StoredResult
from fringe3d.model import ImageStack, PatternPlan, PhaseMap, Rig, Scan
from fringe3d.options import MeasureOptions
from fringe3d.patterns import pattern_image
from fringe3d.pipeline import Measurement
from fringe3d.report import maps as panels
from fringe3d.report.folder import point_maps, stored_result, summary
from fringe3d.report.saving import save_figure

if TYPE_CHECKING:  # it takes a second to import: only who draws waits for it
    from matplotlib.figure import Figure

Result = Measurement | StoredResult
DEVICE_COLOURS = {"camera": "tab:blue", "projector": "tab:orange"}
FRUSTUM_PART = 0.35
PANEL_INCHES = 4.2


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure that shows itself in a notebook.

    Parameters
    ----------
    figure : matplotlib Figure
    """

    figure: Figure

    def _repr_png_(self) -> bytes:
        target = io.BytesIO()
        self.figure.savefig(target, format="png")
        return target.getvalue()

    def save(self, path: Path | str, /, *, overwrite: bool = False) -> None:
        """Write the picture as PNG, completely or not at all."""
        save_figure(Path(path), self.figure, overwrite=overwrite)


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A page with a 3D view that shows itself in a notebook.

    Parameters
    ----------
    html : str
    height_px : int; in the notebook
    """

    html: str
    height_px: int = 560

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height_px}px;border:0"
        return f'<iframe style="{style}" srcdoc="{escape(self.html)}"></iframe>'

    def save(self, path: Path | str, /, *, overwrite: bool = False) -> None:
        """Write the page, completely or not at all."""
        write_text(Path(path), self.html, overwrite=overwrite)


def result(measured: Measurement, /) -> Picture:
    """Draw a measurement at a glance, as in ``overview.png``."""
    from fringe3d.report.overview import overview

    return Picture(overview(measured, title=summary(measured)))


def depth(measured: Result, /) -> Picture:
    """Draw the depth z of the points, shaded as a surface."""
    maps, window = _maps(measured)
    return _drawn([panels.relief("depth z, mm (shaded)", maps["points_mm"][..., 2])], window)


def sigma(measured: Result, /) -> Picture:
    """Draw the standard deviation of the points along the viewing ray."""
    maps, window = _maps(measured)
    values = 1000 * maps["sigma_mm"]
    return _drawn([panels.colour_map("sigma along the viewing ray, um", values, "viridis")], window)


def rejected(measured: Result, /) -> Picture:
    """Draw the pixels without a point in a colour for each reason."""
    maps, window = _maps(measured)
    return _drawn([panels.reasons(maps["rejection"])], window)


def cloud(measured: Result, /, *, most_points: int = 150_000) -> Page:
    """Show the points in three dimensions, to be turned with the mouse."""
    from fringe3d.report.measurement import cloud_page

    maps, _ = _maps(measured)
    rig = measured.rig if isinstance(measured, StoredResult) else None
    camera = rig.cameras[0] if rig else None
    return Page(cloud_page(maps, camera, title="points", most_points=most_points))


def phase(decoded: PhaseMap, /) -> Picture:
    """Draw what was decoded of one camera: brightness, contrast, wrapped phase."""
    name = decoded.device_name
    drawn = [
        panels.colour_map(f"mean brightness of '{name}', DN", decoded.offset, "gray"),
        panels.colour_map("modulation, DN", decoded.modulation, "magma"),
        panels.wrapped_phase("wrapped phase, rad", decoded.phase),
    ]
    return _drawn(drawn, panels.window_of(np.isfinite(decoded.phase)))


def images(stack: ImageStack, /, *, most: int = 12) -> Picture:
    """Draw the images of one camera, the first ones if there are many."""
    title = f"camera '{stack.device_name}'"
    brightest = float(np.percentile(stack.images[:, ::4, ::4], 99.8)) or 1.0
    return _sheet(list(stack.images[:most]), brightest, title)


def patterns(plan: PatternPlan, /, *, most: int = 12) -> Picture:
    """Draw what is projected, the first patterns if there are many."""
    shape = plan.projector_shape or (480, 640)
    shown = [pattern_image(pattern, shape) for pattern in plan.patterns[:most]]
    return _sheet(shown, 255, f"plan of {plan.n_images} images")


def rig(shown: Rig, /) -> Picture:
    """Draw where the devices stand, what they see, and the measuring volume."""
    from matplotlib.figure import Figure

    from fringe3d.geometry import frustum_lines, volume_lines

    centers = np.array([device.center_world for device in shown.devices])
    edges = volume_lines(shown.volume) if shown.volume else np.empty((0, 2, 3))
    middle = edges.reshape(-1, 3).mean(axis=0) if len(edges) else centers.mean(axis=0)
    figure = Figure(figsize=(7, 6), layout="constrained")
    axis: Any = figure.add_subplot(projection="3d")
    for device, center in zip(shown.devices, centers, strict=True):
        length = FRUSTUM_PART * float(np.linalg.norm(middle - center)) or 100.0
        for line in frustum_lines(device, length):
            axis.plot(*line.T, color=DEVICE_COLOURS[device.role], linewidth=1)
        axis.plot(*np.stack([center, middle]).T, color="0.7", linewidth=0.7, linestyle=":")
        axis.text(*center, f" {device.name}")
    for line in edges:
        axis.plot(*line.T, color="0.4", linewidth=0.8)
    axis.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm", aspect="equal")
    return Picture(figure)


def pixel(scan: Scan, measured: Measurement, row: int, col: int, /) -> Picture:
    """Draw the epipolar segment of a pixel of C1 in C2, the candidates on it, and what C2 sees.

    Parameters
    ----------
    scan : Scan with a rig of two cameras and a projector
    measured : Measurement of it
    row, col : int; the pixel of C1
    """
    from matplotlib.figure import Figure

    from fringe3d.view.pixel import pixel_story, residual_along

    phases = {camera.device_name: camera.directions[0].main for camera in measured.phases}
    stored = stored_result(scan, MeasureOptions(), measured)
    story = pixel_story(stored, row, col, phases=phases)
    name = measured.phases[1].device_name
    figure = Figure(figsize=(13.5, 4.2), layout="constrained")
    first, second, along = figure.subplots(1, 3, width_ratios=[1, 1, 1.2])
    first.imshow(measured.main.offset, cmap="gray")
    first.plot(col, row, "+", color="tab:red", markersize=14, markeredgewidth=2)
    first.set_title(f"C1: row {row}, column {col}", fontsize=10, loc="left")
    second.imshow(phases[name].phase, cmap="twilight", interpolation="nearest")
    second.plot(*story.segments[name].T, color="tab:cyan", linewidth=1.5)
    second.set_title(f"wrapped phase of '{name}', the segment, the candidates", fontsize=10,
                     loc="left")  # fmt: skip
    depths, residuals = residual_along(stored, story, phases[name])
    along.plot(depths, residuals, ".", color="0.35", markersize=2)
    for candidate in story.candidates:
        colour = "tab:green" if candidate.is_taken else "tab:red"
        second.plot(*candidate.pixels[name], "o", color=colour, markersize=5)
        along.axvline(candidate.depth_mm, color=colour)
        along.annotate(f"{candidate.order}", (candidate.depth_mm, 0.46), color=colour)
    along.set(xlabel="distance along the viewing ray, mm", ylim=(-0.5, 0.5),
              ylabel=f"phase in '{name}' less that of C1, periods")  # fmt: skip
    return Picture(figure)


def _maps(measured: Result) -> tuple[dict[str, NDArray[Any]], panels.Window]:
    maps = measured.maps if isinstance(measured, StoredResult) else point_maps(measured)
    good = maps["rejection"] == 0
    return maps, panels.window_of(np.isfinite(maps["offset"]) & (good if good.any() else True))


def _drawn(drawers: Sequence[Callable[..., None]], window: panels.Window) -> Picture:
    from matplotlib.figure import Figure

    height, width = (s.stop - s.start for s in window)
    aspect = float(np.clip(height / width, 0.4, 1.5))
    wide = PANEL_INCHES * len(drawers) if len(drawers) > 1 else 1.5 * PANEL_INCHES
    figure = Figure(figsize=(wide, wide / len(drawers) * aspect * 0.9 + 0.8), layout="constrained")
    for axis, draw in zip(figure.subplots(1, len(drawers), squeeze=False)[0], drawers, strict=True):
        draw(axis, window)
        axis.set_facecolor("#101216")
        axis.tick_params(labelsize=8)
    return Picture(figure)


def _sheet(shown: Sequence[NDArray[Any]], top: float, title: str) -> Picture:
    from matplotlib.figure import Figure

    n_cols = min(len(shown), 4)
    n_rows = -(-len(shown) // n_cols)
    rows, cols = shown[0].shape
    size = (2.3 * n_cols, n_rows * (2.3 * rows / cols + 0.3) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    for number, (axis, image) in enumerate(zip(axes, shown, strict=False)):
        axis.imshow(image, cmap="gray", vmin=0, vmax=top)
        axis.set_title(str(number), fontsize=8)
        axis.set(xticks=[], yticks=[])
    for axis in axes[len(shown) :]:
        axis.axis("off")
    figure.suptitle(title, fontsize=10)
    return Picture(figure)
