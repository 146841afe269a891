"""What stands beside the points: scale, pixel, rejected pixels."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.model import Rejection
from fringe3d.report.advice import reason_rows
from fringe3d.report.cloud_data import Channel
from fringe3d.report.maps import REASON_COLORS
from fringe3d.view.pixel import PixelStory

ACCEPTED = "#e8e8e8"
STOPS = 12
"""Colours of a scale between which the browser blends."""

WIDTH_IN, DPI = 3.0, 200
"""Twice as fine as the panel is wide, for screens with fine pixels."""


def colour_bar(channel: Channel, low: float, high: float, /) -> str:
    """Return the scale of a channel as HTML.

    Examples
    --------
    >>> bar = colour_bar(Channel("sigma", "um", np.zeros((2, 2)), "viridis"), 5.0, 25.0)
    >>> "linear-gradient" in bar, "15" in bar, "25 um" in bar
    (True, True, True)
    """
    parts = colormaps[channel.colours](np.linspace(0, 1, STOPS))[:, :3]
    stops = ",".join("#" + "".join(f"{round(255 * c):02x}" for c in part) for part in parts)
    ends = (f"{low:.4g}", f"{(low + high) / 2:.4g}", f"{high:.4g} {channel.unit}".strip())
    labels = "".join(f"<span>{escape(end)}</span>" for end in ends)
    return (
        '<div style="margin:2px 12px 8px;font-size:12px">'
        f'<div style="height:12px;border-radius:2px;background:linear-gradient(90deg,{stops})">'
        f'</div><div style="display:flex;justify-content:space-between">{labels}</div></div>'
    )


def rejection_image(rejection: NDArray[np.unsignedinteger[Any]], /) -> NDArray[np.uint8]:
    """Return rejected pixels in the colour of their first reason, with rows and columns."""
    bits = rejection.astype(np.int64)
    number = np.where(bits > 0, np.log2(np.maximum(bits & -bits, 1)) + 1, 0).astype(int)
    hexes = (ACCEPTED, *REASON_COLORS)
    table = np.array([[int(h[i : i + 2], 16) for i in (1, 3, 5)] for h in hexes], np.uint8)
    height = WIDTH_IN * rejection.shape[0] / rejection.shape[1]
    figure = Figure(figsize=(WIDTH_IN, min(height, 2 * WIDTH_IN)), layout="constrained")
    axis = figure.subplots()
    axis.imshow(table[number], interpolation="nearest")
    axis.tick_params(labelsize=7)
    return drawn(figure)


def rejection_legend(rejection: NDArray[np.unsignedinteger[Any]], /) -> str:
    """Return the reasons with their colours, most frequent first, as HTML."""
    names = {reason.name: i for i, reason in enumerate(Rejection)}
    accepted = f"<b>accepted</b> {int((rejection == 0).sum()):,}"
    lines = [_swatch(ACCEPTED, accepted)]
    for row in reason_rows(rejection):
        colour = REASON_COLORS[names[row.name.replace(" ", "_").upper()]]
        text = f"<b>{escape(row.name)}</b> {row.n_pixels:,}: {escape(row.meaning)}"
        lines.append(_swatch(colour, text))
    return f'<div style="margin:0 12px 8px;font-size:13px;line-height:1.35">{"".join(lines)}</div>'


def _swatch(colour: str, text: str) -> str:
    box = f'<span style="flex:0 0 12px;height:12px;margin-top:3px;background:{colour}"></span>'
    return f'<div style="display:flex;gap:6px;margin:3px 0">{box}<span>{text}</span></div>'


def story_text(story: PixelStory, /) -> str:
    """Return the story of a pixel as Markdown."""
    lines = [f"row {story.row}, column {story.col}: {plain(story.words)}", ""]
    for name, segment in story.segments.items():
        if np.isfinite(segment).all():
            (x1, y1), (x2, y2) = segment
            lines.append(f"- segment in {name}: ({x1:.1f}, {y1:.1f}) to ({x2:.1f}, {y2:.1f}) px")
    for candidate in story.candidates:
        places = ", ".join(f"{n} ({x:.1f}, {y:.1f})" for n, (x, y) in candidate.pixels.items())
        taken = " **taken**" if candidate.is_taken else ""
        misses = "".join(
            f", misses {name}'s phase by {residual:+.3f} periods"
            for name, residual in candidate.residuals.items()
            if np.isfinite(residual)
        )
        depth = f"{candidate.depth_mm:.2f} mm"
        lines.append(f"- order {candidate.order}: {depth}, {places}{misses}{taken}")
    return "\n".join(lines)


def plain(text: str, /) -> str:
    """Return a text in which nothing is Markdown with components."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("{", "&#123;")


def drawn(figure: Figure, /) -> NDArray[np.uint8]:
    """Return the pixels of a picture, (row, col, 3)."""
    figure.set_dpi(DPI)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
