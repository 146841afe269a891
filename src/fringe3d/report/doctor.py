"""A picture of what is wrong with a scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fringe3d.health import Fault, lit_map
from fringe3d.model import Fringe, GrayBit, ImageStack, Pattern, Scan, Uniform
from fringe3d.report.saturation import modulation_dn, saturated_images
from fringe3d.report.saving import save_figure

N_COLUMNS, WIDTH_PX, N_MAPS = 8, 240, 2

SOUND = "nothing wrong was found"


def write_doctor_picture(path: Path, scan: Scan, faults: Sequence[Fault], /, *, title: str) -> None:
    """Draw the images of each camera with what the plan says of them; those concerned are framed.

    Saturated pixels are red, what the projector does not light is blue. After the images come the
    modulation, and in how many fringe images each pixel is saturated.

    Parameters
    ----------
    path : Path; a PNG file
    scan : Scan
    faults : sequence of Fault
    title : str
    """
    from matplotlib.figure import Figure

    rows = [-(-(stack.plan.n_images + N_MAPS) // N_COLUMNS) for stack in scan.stacks]
    figure = Figure(figsize=(2 * N_COLUMNS, 1.9 * sum(rows) + 1 + 0.3 * len(faults)), dpi=80)
    panels = figure.subplots(sum(rows), N_COLUMNS, squeeze=False)
    for panel in panels.flat:
        panel.axis("off")
    first = 0
    for stack, n_rows in zip(scan.stacks, rows, strict=True):
        concerned = {i for f in faults if f.camera in ("", stack.device_name) for i in f.images}
        _draw(panels[first : first + n_rows].ravel(), stack, concerned)
        first += n_rows
    said = dict.fromkeys(f"{fault.kind.value}: {fault.cure}" for fault in faults)
    figure.suptitle("\n".join([title, *said] if said else [title, SOUND]), fontsize=10)
    figure.tight_layout(rect=(0, 0, 1, 0.995))
    save_figure(path, figure, overwrite=True)


def _draw(panels: Any, stack: ImageStack, concerned: set[int]) -> None:
    step = max(1, stack.shape[1] // WIDTH_PX)
    unlit = ~lit_map(stack).lit[::step, ::step]
    # Of several exposures each pixel as its own one showed it.
    scale = 1.0 if stack.fused is None else stack.fused.scale[::step, ::step]
    top = float(np.percentile(stack.images[:, ::step, ::step] / scale, 99.8)) or 1.0
    for index, pattern in enumerate(stack.plan.patterns):
        image = stack.images[index, ::step, ::step]
        grey = np.clip(image / (scale * top), 0, 1)
        colour = np.repeat(grey[..., None], 3, axis=2)
        colour[unlit] = colour[unlit] * 0.6 + np.array([0.0, 0.0, 0.25])
        colour[image >= stack.saturation_dn] = (1.0, 0.1, 0.1)
        panel = panels[index]
        panel.imshow(colour, interpolation="nearest")
        panel.set_title(f"{stack.device_name} {index}: {_words(pattern)}", fontsize=7,
                        color="crimson" if index in concerned else "black")  # fmt: skip
        if index in concerned:
            panel.add_patch(_frame(colour.shape))
    thinned = stack.images[:, ::step, ::step]
    _draw_maps(
        panels[len(thinned) :], replace(stack, images=thinned, fused=None, sigma_growth=None)
    )


def _draw_maps(panels: Any, stack: ImageStack) -> None:
    """Draw modulation and saturation, each with its scale."""
    modulation, saturated = modulation_dn(stack), saturated_images(stack).astype(np.float32)
    saturated[saturated == 0] = np.nan
    saturable = sum(isinstance(p, Fringe) for p in stack.plan.patterns) or stack.plan.n_images
    maps = [("modulation, DN", modulation, "magma", float(np.percentile(modulation, 99.5))),
            ("saturated images", saturated, "autumn_r", saturable)]  # fmt: skip
    for panel, (words, values, colours, top) in zip(panels, maps, strict=False):
        shown = panel.imshow(values, cmap=colours, vmin=0, vmax=top, interpolation="nearest")
        panel.axis("on")
        panel.set_facecolor("#101216")
        panel.set_xticks([])
        panel.set_yticks([])
        panel.set_title(f"{stack.device_name}: {words}", fontsize=7)
        panel.figure.colorbar(shown, ax=panel, shrink=0.8).ax.tick_params(labelsize=6)


def _frame(shape: tuple[int, ...]) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((-0.5, -0.5), shape[1], shape[0], fill=False, edgecolor="crimson", lw=4)


def _words(pattern: Pattern) -> str:
    match pattern:
        case Fringe():
            return f"{pattern.period_px:.4g} px, {np.degrees(pattern.shift) % 360:.0f} deg"
        case GrayBit():
            return f"bit {pattern.bit}{' inverted' if pattern.inverted else ''}"
        case Uniform():
            return "light" if pattern.level == 1 else "dark"
        case _:
            return "unused"
