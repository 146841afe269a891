"""The trade-off of an optimised rig as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
COLORS = ("#000000", "#8c564b", "#1f77b4", "#d95f02", "#7b3294", "#e7298a", "#7f7f7f")
ONE, SEVERAL = "#2a9d6f", "#9ecae1"
CIRCLE_POINTS = 121
RATIO_LABEL = f"margin / sigma (grey line: {NEEDED_RATIO:g}, enough)"
LABEL_PT = 13.0
"""Points by which a number stands beside its place; two numbers are at least so far apart."""

Array = NDArray[np.float64]


def draw_tradeoff(path: Path, found: Optimisation, /, *, title: str) -> None:
    """Draw where the projector could stand, what slopes do, and the price of a margin."""
    figure = Figure(figsize=(12.5, 11.8), dpi=100, layout="constrained")
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
    label = f"worst margin / sigma, slopes to {steepest:.0f} deg (white: {NEEDED_RATIO:g}, enough)"
    figure.colorbar(image, ax=axes[0], shrink=0.85, pad=0.01, label=label)
    _draw_slopes(axes[1, 0], found)
    _draw_price(axes[1, 1], found)
    for axis in axes.ravel():
        axis.title.set_fontsize(10)
        axis.tick_params(labelsize=9)
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=2, fontsize=8, frameon=False,
        columnspacing=2,
    )  # fmt: skip
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    figure.draw_without_rendering()  # the layout says how far apart places are on paper
    for axis in axes[0]:
        spots = [_seen_from_above(np.array(c.tilt), np.array(c.azimuth)) for c in found.candidates]
        # Turned alone, it stands where the given one does.
        _number(axis, spots, {i for i, c in enumerate(found.candidates) if c.name == "turned"},
                _cameras(found))  # fmt: skip
    _number(axes[1, 1],
            [np.array([1000 * c.sigma_mm, c.ratio]) for c in found.candidates])  # fmt: skip
    figure.savefig(path)


def _percent(price: float) -> str:
    return f"{100 * price:.0f} %"


def _label(number: int, c: Candidate) -> str:
    tilt, azimuth, angle = np.degrees([c.tilt, c.azimuth, c.angle])
    slope = c.enough_slope
    alone = "with a code" if math.isnan(slope) else f"no code to {math.degrees(slope):.0f} deg"
    return (
        f"{number}  {c.name}: tilt {tilt:.1f}, azimuth {azimuth:.1f}, fringes {angle:.1f} deg; "
        f"{1000 * c.sigma_mm:.1f} um, {alone}"
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
    for camera, spot in zip(found.given.rig.cameras, _cameras(found), strict=True):
        axis.plot(*spot, "o", color=CAMERA, markersize=9)
        axis.annotate(camera.name, tuple(spot), xytext=(0, -17), textcoords="offset points",
                      ha="center", color=CAMERA, fontsize=9, fontweight="bold",
                      bbox=LABEL_BOX)  # fmt: skip
        tilt, azimuth = found.stand.angles_of(camera)
        _draw_ring(axis, found, tilt, azimuth, found.limits.min_separation, "--")
    for candidate in found.candidates:
        if candidate.name == "next to C1" and candidate.rig.projector is not None:
            first = found.given.rig.cameras[0]
            reach = triangulation_angle(first, candidate.rig.projector, found.stand.point_mm)
            _draw_ring(axis, found, *found.stand.angles_of(first), reach, ":")
    edge = 1.08 * math.degrees(found.limits.max_tilt)
    span = max(edge, float(np.abs([*axis.get_xlim(), *axis.get_ylim()]).max()))
    axis.set(xlim=(-span, span), ylim=(-span, span), aspect="equal")
    axis.set_xlabel("tilt of the projector along the line from C1 to C2, deg", fontsize=9)
    axis.set_ylabel("tilt across it (cameras' side below), deg", fontsize=9)
    return image


def _cameras(found: Optimisation) -> list[Array]:
    """Return where the cameras are drawn."""
    places = [found.stand.angles_of(camera) for camera in found.given.rig.cameras]
    return [_seen_from_above(np.array(tilt), np.array(azimuth)) for tilt, azimuth in places]


def _number(
    axis: Axes, spots: Sequence[Array], left_out: set[int] | None = None,
    taken: Sequence[Array] = (),
) -> None:  # fmt: skip
    """Mark places with small squares, and set their numbers beside them where there is room."""
    to_points = axis.transData.transform
    scale = 72 / axis.figure.dpi
    marks = [scale * to_points(spot) for spot in spots]
    used = [scale * to_points(spot) for spot in taken]
    used += [spot - np.array([0.0, LABEL_PT]) for spot in used]  # their names stand below
    turns = np.radians([45, 135, -45, -135, 0, 180, 90, -90])
    ways = [far * LABEL_PT * np.array([np.cos(turn), np.sin(turn)])
            for far in (1.0, 1.8, 2.6) for turn in turns]  # fmt: skip
    for number, (spot, mark) in enumerate(zip(spots, marks, strict=True)):
        if left_out and number in left_out:
            continue
        way = max(ways, key=lambda w: min(
            (min(LABEL_PT, float(np.linalg.norm(mark + w - other))) for other in [*used, *marks]),
        ))  # fmt: skip
        used.append(mark + way)
        color = COLORS[number % len(COLORS)]
        axis.plot(*spot, "s", color=color, markersize=7, markeredgecolor="white", zorder=5)
        axis.annotate(
            str(number), tuple(spot), xytext=tuple(way), textcoords="offset points", ha="center",
            va="center", color="white", fontsize=9, fontweight="bold", zorder=6,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": color, "edgecolor": "white"},
            arrowprops={"arrowstyle": "-", "color": color, "shrinkA": 0, "shrinkB": 2},
        )  # fmt: skip


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
    axis.set_ylim(bottom=-0.3)
    axis.set_title("worst margin / sigma of the volume against the slope of surfaces", loc="left")
    axis.set_xlabel("surfaces slope up to, deg (dashed: beyond the limits)", fontsize=9)
    axis.set_ylabel(RATIO_LABEL, fontsize=9)
    axis.grid(alpha=0.3)


def _draw_price(axis: Axes, found: Optimisation) -> None:
    """Draw the ratio of all that was tried against its price, one period apart from several."""
    land = found.landscape
    allowed = land.allowed[:, None] & np.isfinite(land.ratio) & (land.ratio > 0)
    allowed &= land.sigma_mm < 1.3 * land.max_sigma_mm
    single = land.reach < land.max_reach
    for own, color, words in ((single, ONE, "below one period"), (~single, SEVERAL, "more")):
        sigma, ratio = 1000 * land.sigma_mm[allowed & own], land.ratio[allowed & own]
        axis.plot(sigma, ratio, ".", color=color, markersize=3)
        order = np.argsort(sigma)
        axis.plot(sigma[order], np.maximum.accumulate(ratio[order]), color=color, linewidth=1.4,
                  drawstyle="steps-post", label=words)  # fmt: skip
    axis.axhline(NEEDED_RATIO, color="#999999", linewidth=1)
    axis.axvline(1000 * land.max_sigma_mm, color="#999999", linewidth=1, linestyle="--")
    sigmas = [1000 * c.sigma_mm for c in found.candidates]
    low, high = min(sigmas), max(*sigmas, 1000 * land.max_sigma_mm)
    axis.set_xlim(low - 0.06 * (high - low), high + 0.12 * (high - low))
    top = max([c.ratio for c in found.candidates] + [NEEDED_RATIO])
    axis.set_ylim(-1.2, 1.15 * top + 1)
    axis.legend(loc="upper left", fontsize=9, title="segments, places tried (first order)",
                title_fontsize=9, framealpha=0.9, ncols=2)  # fmt: skip
    steepest = math.degrees(float(found.given.margins.slopes[-1]))
    axis.set_title(f"price of a margin, slopes up to {steepest:.0f} deg", loc="left")
    axis.set_xlabel(
        "predicted standard deviation of the points (median), um; dashed: "
        f"{_percent(found.limits.max_price)} of the given", fontsize=9,
    )  # fmt: skip
    axis.set_ylabel(RATIO_LABEL, fontsize=9)
    axis.grid(alpha=0.3)
