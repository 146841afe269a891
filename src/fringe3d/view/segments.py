"""The epipolar segments of a pixel and the candidates on them, as pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.geometry import project
from fringe3d.io.stored import StoredResult, angle_of
from fringe3d.model import PhaseMap
from fringe3d.patterns import across
from fringe3d.view.panel import WIDTH_IN, drawn
from fringe3d.view.pixel import Candidate, PixelStory, residual_along

GREEN, RED, VIOLET, CYAN = "#1a9c3c", "#d6302a", "#7a3cc8", "#00b7c7"
"""The candidate taken, the others, the pixel; the segment, on phases that hold red and blue."""

STEPS = 60
MARGIN_PX, TALL_PX = 12.0, 24.0
"""Around a segment, px: beside its ends, and at least above and below it."""


def segment_picture(
    stored: StoredResult, story: PixelStory, phases: Mapping[str, PhaseMap], /
) -> NDArray[np.uint8] | None:
    """Draw the segments of a pixel in the other devices, the candidates, and why one was taken.

    Parameters
    ----------
    stored : StoredResult with a rig
    story : PixelStory
    phases : mapping of camera name to PhaseMap; what the other cameras see

    Returns
    -------
    (row, col, 3) uint8, or None
        The surroundings of the pixel in C1; the wrapped phase of each other camera with segment and
        candidates; the phase that the projector throws; what each camera sees along the ray. None
        where the ray misses the volume.
    """
    rig = stored.rig
    if rig is None or not np.isfinite(story.ends_mm).all():
        return None
    near, far = story.ends_mm
    ray = near + np.linspace(0, 1, STEPS)[:, None] * (far - near)
    others = [d for d in rig.devices if d.name in story.segments]
    shown = [d for d in others if d.name in phases or d.role == "projector"]
    curves = {d.name: project(d, ray) for d in shown}
    seen_by = [d.name for d in shown if d.name in phases and math.isfinite(story.phase)]
    figure = Figure(figsize=(WIDTH_IN, 1.25 * (1 + len(shown)) + 1.7 * len(seen_by)),
                    layout="constrained")  # fmt: skip
    ratios = [1.25] * (1 + len(shown)) + [1.7] * len(seen_by)
    axes = list(figure.subplots(len(ratios), 1, height_ratios=ratios, squeeze=False)[:, 0])
    reach = max((np.ptp(curve, axis=0).max() for curve in curves.values()), default=60.0)
    _draw_pixel(axes.pop(0), stored, story, reach / 2 + MARGIN_PX)
    for device in shown:
        axis, curve = axes.pop(0), curves[device.name]
        window = _window(curve)
        is_thrown = device.role == "projector"
        phase = _thrown(stored, window) if is_thrown else _cut(phases[device.name].phase, window)
        axis.imshow(phase, cmap="twilight", interpolation="nearest", vmin=-math.pi, vmax=math.pi,
                    extent=_extent(window))  # fmt: skip
        _draw_segment(axis, device.name, window, curve, story)
    for name in seen_by:
        _draw_along(axes.pop(0), stored, story, phases[name])
    return drawn(figure)


def _draw_pixel(axis: Any, stored: StoredResult, story: PixelStory, reach: float) -> None:
    brightness = stored.maps["offset"]
    axis.imshow(brightness, cmap="gray", interpolation="nearest")
    axis.plot(story.col, story.row, "+", color=VIOLET, markersize=9, markeredgewidth=1.6)
    axis.set(xlim=(story.col - reach, story.col + reach),
             ylim=(story.row + reach / 2.6, story.row - reach / 2.6))  # fmt: skip
    _label(axis, "the pixel in C1")


def _draw_segment(
    axis: Any,
    name: str,
    window: tuple[float, float, float, float],
    curve: NDArray[np.float64],
    story: PixelStory,
) -> None:
    left, right, top, bottom = window
    axis.plot(*curve.T, color=CYAN, linewidth=1.4)
    for candidate in story.candidates:
        x, y = candidate.pixels[name]
        axis.plot(x, y, "o", color=_colour(candidate), markersize=5, markeredgecolor="white",
                  markeredgewidth=0.7)  # fmt: skip
        box = {"boxstyle": "round,pad=0.1", "fc": _colour(candidate), "ec": "none"}
        axis.annotate(f"{candidate.order}", (x, y), (0, 5), textcoords="offset points", fontsize=7,
                      ha="center", color="white", bbox=box)  # fmt: skip
    axis.set(xlim=(left, right), ylim=(bottom, top))
    _label(axis, f"the segment in {name}, over its phase")


def _draw_along(axis: Any, stored: StoredResult, story: PixelStory, phases: PhaseMap) -> None:
    depths, residuals = residual_along(stored, story, phases, n_steps=600)
    axis.plot(depths, residuals, ".", color="0.35", markersize=1.5)
    axis.axhline(0, color="0.7", linewidth=0.8)
    for candidate in story.candidates:
        axis.axvline(candidate.depth_mm, color=_colour(candidate), linewidth=1.2)
    axis.set_ylim(-0.5, 0.5)
    axis.set_xlabel("distance along the ray, mm", fontsize=7)
    _label(axis, f"phase in {phases.device_name} less that of C1, periods")


def _window(curve: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return left, right, top, bottom of what is shown around a curve, px."""
    (left, top), (right, bottom) = curve.min(axis=0), curve.max(axis=0)
    wide = max(right - left + 2 * MARGIN_PX, 3 * MARGIN_PX)
    tall = max(bottom - top + MARGIN_PX, TALL_PX, wide / 3)
    x, y = (left + right) / 2, (top + bottom) / 2
    wide = max(wide, tall)
    return x - wide / 2, x + wide / 2, y - tall / 2, y + tall / 2


def _thrown(stored: StoredResult, window: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Return the wrapped phase that the projector throws in a part of its image."""
    left, right, top, bottom = _whole(window)
    v, u = np.mgrid[top : bottom + 1, left : right + 1]
    fringes = stored.record["decoding"][0]
    turns = across(angle_of(fringes["direction"]), u.astype(float), v.astype(float))
    wrapped: NDArray[np.float64] = np.angle(np.exp(2j * np.pi * turns / fringes["period_px"]))
    return wrapped


def _cut(phase: NDArray[Any], window: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Return a part of a phase map; NaN beyond its border."""
    left, right, top, bottom = _whole(window)
    part = np.full((bottom - top + 1, right - left + 1), np.nan)
    rows = slice(max(top, 0), max(bottom + 1, 0))
    cols = slice(max(left, 0), max(right + 1, 0))
    inside = phase[rows, cols]
    place = (rows.start - top, cols.start - left)
    part[place[0] : place[0] + inside.shape[0], place[1] : place[1] + inside.shape[1]] = inside
    return part


def _whole(window: tuple[float, float, float, float]) -> tuple[int, int, int, int]:
    left, right, top, bottom = window
    return math.floor(left), math.ceil(right), math.floor(top), math.ceil(bottom)


def _extent(window: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    left, right, top, bottom = _whole(window)
    return left - 0.5, right + 0.5, bottom + 0.5, top - 0.5


def _colour(candidate: Candidate) -> str:
    return GREEN if candidate.is_taken else RED


def _label(axis: Any, text: str) -> None:
    axis.set_title(text, fontsize=8, loc="left")
    axis.tick_params(labelsize=7)
