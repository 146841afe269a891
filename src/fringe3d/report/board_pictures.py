"""Picture of a calibration by a board: what corners leave, and where they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.calibrate import BoardCalibration
from fringe3d.model import Device
from fringe3d.report.board_regions import regions_of, residuals_of
from fringe3d.report.saving import save_figure

Floats = NDArray[np.float64]

ROW_INCHES = 3.6
ARROW_OF_WIDTH = 0.06
"""Length of the arrow of a large residual, part of the width of the image."""

HELD_BY_SCALE = 95.0
"""Part of corners or regions that a scale holds, %; what is beyond is cut, and marked."""

HISTOGRAM_SIGMAS = 5.0
LONGEST_BAR = 4.0
"""Times the typical bar; longer ones are cut, and their value is written."""

BARS = 41
SIZE_MAP = "YlOrBr"
BACKGROUND = "#d9dce1"


def draw_board(
    path: Path, calibration: BoardCalibration, record: dict[str, Any], /, *, overwrite: bool
) -> None:
    """Draw, for each device, residuals, their regions, their histogram, and rms by pose."""
    devices = calibration.devices
    poses = list(calibration.world_from_board)
    figure = Figure(figsize=(16.5, 0.8 + ROW_INCHES * len(devices)), dpi=100, layout="constrained")
    title = f"{record['board']['text']}: {len(poses)} poses; board {calibration.shape}"
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    axes = figure.subplots(len(devices), 4, squeeze=False, width_ratios=[1.35, 1.5, 0.8, 1.0])
    colours = {pose: colormaps["tab10" if len(poses) <= 10 else "turbo"](
        k if len(poses) <= 10 else k / len(poses)) for k, pose in enumerate(poses)}  # fmt: skip
    for row, device in zip(axes, devices, strict=True):
        _draw_arrows(row[0], calibration, device, colours)
        _draw_regions(row[1], calibration, device)
        _draw_histogram(row[2], calibration, device)
        _draw_poses(row[3], record, device, colours)
    save_figure(path, figure, overwrite=overwrite)


def _over_image(axis: Axes, device: Device, title: str) -> None:
    axis.set_xlim(-0.5, device.n_cols - 0.5)
    axis.set_ylim(device.n_rows - 0.5, -0.5)
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=10, loc="left")
    axis.set_xlabel("x, px", fontsize=8)
    axis.set_ylabel("y, px", fontsize=8)
    axis.tick_params(labelsize=8)


def _draw_arrows(
    axis: Axes, calibration: BoardCalibration, device: Device, colours: dict[str, Any]
) -> None:
    _, residual = residuals_of(calibration, device.name)
    large = max(float(np.percentile(np.linalg.norm(residual, axis=1), HELD_BY_SCALE)), 1e-3)
    scale = large / (ARROW_OF_WIDTH * device.n_cols)
    n_cut = 0
    for view, own in zip(calibration.views, calibration.residual_px, strict=True):
        if view.device != device.name:
            continue
        length = np.linalg.norm(own, axis=1, keepdims=True)
        cut = np.minimum(1.0, large / np.maximum(length, 1e-12)) * own
        axis.quiver(*view.pixels.T, *cut.T, angles="xy", scale_units="xy", scale=scale,
                    color=colours[view.pose], width=0.0022)  # fmt: skip
        far = view.pixels[length[:, 0] > large]
        axis.plot(*far.T, "o", markersize=5, markerfacecolor="none", markeredgecolor="black",
                  markeredgewidth=0.6)  # fmt: skip
        n_cut += len(far)
    _over_image(axis, device, f"{device.role} {device.name}: residuals, coloured by pose")
    axis.quiver([0.03 * device.n_cols], [0.06 * device.n_rows], [large], [0], angles="xy",
                scale_units="xy", scale=scale, color="black", width=0.004)  # fmt: skip
    axis.text(0.11 * device.n_cols, 0.06 * device.n_rows,
              f"{large:.2g} px; circles: {n_cut} longer, cut", va="center", fontsize=8)  # fmt: skip


def _draw_regions(axis: Axes, calibration: BoardCalibration, device: Device) -> None:
    """Draw the rms of corners, their number and what they share, by part of the image."""
    regions = regions_of(calibration, device)
    known = regions.rms_px[np.isfinite(regions.rms_px)]
    top = max(float(np.percentile(known, HELD_BY_SCALE)), 1e-3)
    extent = (-0.5, device.n_cols - 0.5, device.n_rows - 0.5, -0.5)
    image = axis.imshow(regions.rms_px, cmap=SIZE_MAP, vmin=0, vmax=top, extent=extent)
    axis.set_facecolor(BACKGROUND)
    rows, cols = regions.rms_px.shape
    wide, high = device.n_cols / cols, device.n_rows / rows
    x, y = np.meshgrid((np.arange(cols) + 0.5) * wide, (np.arange(rows) + 0.5) * high)
    for place in np.ndindex(rows, cols):
        is_dark = regions.rms_px[place] > 0.6 * top
        axis.text(x[place], y[place] - 0.28 * high, str(regions.n_corners[place]), ha="center",
                  va="center", fontsize=8, color="white" if is_dark else "black")  # fmt: skip
    shared = np.linalg.norm(regions.shared_px, axis=-1)
    told = shared[np.isfinite(shared)]
    large = max(float(np.percentile(told, HELD_BY_SCALE)) if len(told) else 0.0, 1e-3)
    cut = np.minimum(1.0, large / np.maximum(shared, 1e-12))[..., None] * regions.shared_px
    arrows = axis.quiver(x, y + 0.12 * high, cut[..., 0], cut[..., 1], angles="xy",
                         scale_units="xy", scale=large / (0.7 * wide), width=0.005,
                         pivot="middle", color="#1f4e79")  # fmt: skip
    _over_image(axis, device, f"corners in {regions.coverage:.0%} of the image")
    axis.quiverkey(arrows, 0.72, 1.035, large, f"{large:.2g} px shared", labelpos="E",
                   fontproperties={"size": 8})  # fmt: skip
    assert axis.figure is not None
    extend = "max" if known.max() > top else "neither"
    bar = axis.figure.colorbar(image, ax=axis, shrink=0.9, pad=0.01, extend=extend)
    bar.set_label("rms, px (grey: no corner)", fontsize=8)
    bar.ax.tick_params(labelsize=8)


def _draw_histogram(axis: Axes, calibration: BoardCalibration, device: Device) -> None:
    _, residual = residuals_of(calibration, device.name)
    noise = max(calibration.noise_px[device.name], 1e-6)
    limit = HISTOGRAM_SIGMAS * noise
    edges = np.linspace(-limit, limit, BARS)
    for k, colour in ((0, "#3b6ea8"), (1, "#c2652a")):
        axis.hist(residual[:, k], edges.tolist(), histtype="step", color=colour, label="xy"[k],
                  linewidth=1.4)  # fmt: skip
    middle = (edges[1:] + edges[:-1]) / 2
    bell = np.exp(-((middle / noise) ** 2) / 2) * (edges[1] - edges[0]) / noise / np.sqrt(2 * np.pi)
    axis.plot(middle, bell * len(residual), color="grey", linewidth=1, label=f"sigma {noise:.3f}")
    beyond = float((np.abs(residual) > limit).mean())
    rms, largest = calibration.rms_px(device.name), float(np.abs(residual).max())
    axis.set_title(f"rms {rms:.3f} px; {beyond:.1%} beyond, to {largest:.2g} px",
                   fontsize=10, loc="left")  # fmt: skip
    axis.set_xlabel("residual, px", fontsize=8)
    axis.set_ylabel("corners", fontsize=8)
    axis.tick_params(labelsize=8)
    axis.legend(fontsize=8, frameon=False)


def _draw_poses(
    axis: Axes, record: dict[str, Any], device: Device, colours: dict[str, Any]
) -> None:
    poses = record["poses"]
    place = np.arange(len(poses))
    rms = np.array([p["rms_px"].get(device.name, 0.0) for p in poses])
    held = np.array([p["held_out_rms_px"].get(device.name, np.nan) for p in poses])
    all_found = np.r_[rms[rms > 0], held[np.isfinite(held)]]
    top = min(1.05 * all_found.max(), LONGEST_BAR * float(np.median(rms[rms > 0])))
    axis.barh(place, rms, color=[colours[p["pose"]] for p in poses], height=0.7)
    axis.plot(held, place, "k|", markersize=9, markeredgewidth=2, label="where left out")
    for y, value in enumerate(np.fmax(rms, held)):
        if value > top:
            axis.text(0.98 * top, y, f"to {value:.3g}", ha="right", va="center", fontsize=8,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 1})  # fmt: skip
    if np.isfinite(held).any():
        axis.legend(fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.985))
    axis.set_xlim(0, top)
    axis.set_yticks(place, [p["pose"][-18:] for p in poses], fontsize=8)
    axis.invert_yaxis()
    axis.set_title("rms by pose", fontsize=10, loc="left")
    axis.set_xlabel("rms, px", fontsize=8)
    axis.tick_params(labelsize=8)


def board_targets(out: Path, /, *, is_compared: bool = False) -> Sequence[Path]:
    """Return the files of a calibration: pictures, report, and last the rig itself.

    The picture of the comparison with a former rig, if there is one, follows the other pictures.
    """
    compared = ("-compared.png",) if is_compared else ()
    names = ("-board.png", "-volume.png", *compared, "-board.md")
    return [*(out.with_name(f"{out.stem}{name}") for name in names), out]
