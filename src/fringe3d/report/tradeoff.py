"""The trade-off of an optimised rig as a picture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation, TriContourSet
from numpy.typing import NDArray

from fringe3d.design.margin import NEEDED_RATIO
from fringe3d.design.optimise import Candidate, Optimisation
from fringe3d.geometry import triangulation_angle

LEVELS = np.arange(0.0, 10.1, 1.0)
"""Ratios of margin and standard deviation; far above what is needed nothing is gained."""

MAP = "viridis"
CAMERA = "#c22f2f"
LABEL_BOX = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1}
COLORS = ("#000000", "#8c564b", "#1f77b4", "#d95f02", "#e7298a", "#7f7f7f")
CIRCLE_POINTS = 121
ENOUGH_TEXT = f"{NEEDED_RATIO:g}: enough"

Array = NDArray[np.float64]


def draw_tradeoff(path: Path, found: Optimisation, /, *, title: str) -> None:
    """Draw where the projector could stand, what slopes do, and the price of a margin."""
    figure = Figure(figsize=(12.5, 11.6), dpi=100, layout="constrained")
    axes = figure.subplots(2, 2)
    land = found.landscape
    given = math.degrees(found.given.angle)
    steepest = math.degrees(float(found.given.margins.slopes[-1]))
    best = land.ratio[np.arange(len(land.tilts)), land.best_angle]
    image = _draw_places(axes[0, 0], found, land.ratio[:, 0])
    axes[0, 0].set_title(f"fringes at {given:.0f} deg, as given", loc="left")
    _draw_places(axes[0, 1], found, best)
    price = f"(sigma up to {_percent(found.limits.max_price)})"
    axes[0, 1].set_title(f"best fringe angle of each place {price}", loc="left")
    label = f"worst margin / sigma, slopes up to {steepest:.0f} deg"
    figure.colorbar(image, ax=axes[0], shrink=0.85, pad=0.01, label=label)
    _draw_slopes(axes[1, 0], found)
    _draw_price(axes[1, 1], found)
    for axis in axes.ravel():
        axis.title.set_fontsize(10)
        axis.tick_params(labelsize=9)
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=2, fontsize=9, frameon=False,
        columnspacing=3,
    )  # fmt: skip
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    figure.savefig(path)


def _percent(price: float) -> str:
    return f"{100 * price:.0f} %"


def _label(number: int, c: Candidate) -> str:
    tilt, azimuth, angle = np.degrees([c.tilt, c.azimuth, c.angle])
    return (
        f"{number}  {c.name}: tilt {tilt:.1f}, azimuth {azimuth:.1f}, fringes {angle:.1f} deg; "
        f"{1000 * c.sigma_mm:.1f} um, {c.n_images} images"
    )


def _seen_from_above(tilt: Array, azimuth: Array) -> Array:
    """Return where a place is drawn, (..., 2), deg: azimuth 0 is down, 90 deg to the right."""
    return np.degrees(np.stack([tilt * np.sin(azimuth), -tilt * np.cos(azimuth)], axis=-1))


def _draw_places(axis: Axes, found: Optimisation, ratio: Array) -> TriContourSet:
    land = found.landscape
    spots = _seen_from_above(land.tilts, land.azimuths)
    known = np.isfinite(ratio)
    values = np.clip(ratio[known], LEVELS[0] - 1, None)
    mesh = Triangulation(spots[known, 0], spots[known, 1])
    colors = colormaps[MAP].with_extremes(under="#d9d9d9")
    image = axis.tricontourf(mesh, values, LEVELS, cmap=colors, extend="both")
    axis.tricontour(mesh, values, [NEEDED_RATIO], colors="white", linewidths=1.6)
    for camera in found.given.rig.cameras:
        tilt, azimuth = found.stand.angles_of(camera)
        x, y = _seen_from_above(np.array(tilt), np.array(azimuth))
        axis.plot(x, y, "o", color=CAMERA, markersize=9)
        axis.annotate(camera.name, (x, y), xytext=(0, -17), textcoords="offset points", ha="center",
                      color=CAMERA, fontsize=9, fontweight="bold",
                      bbox=LABEL_BOX)  # fmt: skip
        _draw_ring(axis, found, tilt, azimuth, found.limits.min_separation, "--")
    for number, candidate in enumerate(found.candidates):
        if candidate.name == "next to C1" and candidate.rig.projector is not None:
            first = found.given.rig.cameras[0]
            reach = triangulation_angle(first, candidate.rig.projector, found.stand.point_mm)
            _draw_ring(axis, found, *found.stand.angles_of(first), reach, ":")
        spot = _seen_from_above(np.array(candidate.tilt), np.array(candidate.azimuth))
        if candidate.name != "turned":  # it stands where the given one does
            _mark(axis, spot, number)
    edge = 1.08 * math.degrees(found.limits.max_tilt)
    span = max(edge, float(np.abs([*axis.get_xlim(), *axis.get_ylim()]).max()))
    axis.set(xlim=(-span, span), ylim=(-span, span), aspect="equal")
    axis.set_xlabel("tilt of the projector along the line from C1 to C2, deg", fontsize=9)
    axis.set_ylabel("tilt across it (cameras' side below), deg", fontsize=9)
    return image


def _mark(axis: Axes, spot: Array, number: int) -> None:
    axis.plot(*spot, "s", color=COLORS[number % len(COLORS)], markersize=13,
              markeredgecolor="white", zorder=5)  # fmt: skip
    axis.annotate(str(number), tuple(spot), ha="center", va="center_baseline", color="white",
                  fontsize=9, fontweight="bold", zorder=6)  # fmt: skip


def _draw_ring(
    axis: Axes, found: Optimisation, tilt: float, azimuth: float, radius: float, style: str
) -> None:
    """Draw the places that are `radius`, rad, away from a place."""
    centre = found.stand.direction(tilt, azimuth)
    side = np.cross(centre, found.stand.sideways)
    side /= np.linalg.norm(side)
    other = np.cross(centre, side)
    turn = np.linspace(0, 2 * np.pi, CIRCLE_POINTS)[:, None]
    ring = math.cos(radius) * centre
    ring = ring + math.sin(radius) * (np.cos(turn) * side + np.sin(turn) * other)
    level = np.stack([ring @ found.stand.sideways, ring @ found.stand.ahead], axis=-1)
    tilts = np.arctan2(np.linalg.norm(level, axis=-1), ring @ found.stand.upright)
    places = _seen_from_above(tilts, np.arctan2(level[:, 0], level[:, 1]))
    axis.plot(places[:, 0], places[:, 1], style, color=CAMERA, linewidth=1.2)


def _draw_slopes(axis: Axes, found: Optimisation) -> None:
    for number, candidate in enumerate(found.candidates):
        margins = candidate.margins
        axis.plot(np.degrees(margins.slopes), margins.worst_ratio, marker="s",
                  color=COLORS[number % len(COLORS)], markersize=5,
                  linestyle="-" if candidate.is_allowed else "--",
                  label=_label(number, candidate))  # fmt: skip
    axis.axhline(NEEDED_RATIO, color="#999999", linewidth=1)
    axis.annotate(ENOUGH_TEXT, (0.01, NEEDED_RATIO), xycoords=("axes fraction", "data"),
                  ha="left", va="bottom", fontsize=9, color="#666666")  # fmt: skip
    axis.set_ylim(bottom=-0.3)
    axis.set_title("worst margin / sigma of the volume against the slope of surfaces", loc="left")
    axis.set_xlabel("surfaces slope up to, deg", fontsize=9)
    axis.set_ylabel("margin / sigma", fontsize=9)
    axis.grid(alpha=0.3)


def _draw_price(axis: Axes, found: Optimisation) -> None:
    land = found.landscape
    sigma, ratio = 1000 * land.sigma_mm[land.allowed], land.ratio[land.allowed]
    shown = np.isfinite(ratio) & (ratio > 0) & (sigma < 1.3e3 * land.max_sigma_mm)
    axis.plot(sigma[shown], ratio[shown], ".", color="#9ecae1", markersize=3)
    order = np.argsort(sigma[shown])
    front = np.maximum.accumulate(ratio[shown][order])
    axis.plot(sigma[shown][order], front, color=colormaps[MAP](0.3), linewidth=1.2,
              drawstyle="steps-post")  # fmt: skip
    axis.axhline(NEEDED_RATIO, color="#999999", linewidth=1)
    axis.axvline(1000 * land.max_sigma_mm, color="#999999", linewidth=1, linestyle="--")
    axis.annotate(f"{_percent(found.limits.max_price)} of the given",
                  (1000 * land.max_sigma_mm, 0.3), xycoords=("data", "axes fraction"),
                  xytext=(5, 0), textcoords="offset points", ha="left", va="center", rotation=90,
                  fontsize=9, color="#666666")  # fmt: skip
    for number, candidate in enumerate(found.candidates):
        _mark(axis, np.array([1000 * candidate.sigma_mm, candidate.ratio]), number)
    steepest = math.degrees(float(found.given.margins.slopes[-1]))
    axis.set_ylim(bottom=-0.6)
    axis.set_title(f"price: every place and fringe angle tried, slopes up to {steepest:.0f} deg",
                   loc="left")  # fmt: skip
    axis.set_xlabel("predicted standard deviation of the points (median), um", fontsize=9)
    axis.set_ylabel("margin / sigma", fontsize=9)
    axis.grid(alpha=0.3)
