"""Pictures of the measuring volume: how certain points are, and two calibrations side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.calibrate import BoardCalibration, RigComparison
from fringe3d.model import Device
from fringe3d.report.board import volume_sigma
from fringe3d.report.saving import save_figure

Floats = NDArray[np.float64]

SIZE_MAP, SIGN_MAP = "viridis", "RdBu_r"
BACKGROUND = "#d9dce1"

HELD_BY_SCALE = 95.0
"""Part of the points that the colours hold, %: the corners of the image may be far worse."""

NEARLY_HELD = 1.5
"""Where the largest is no further off, the colours hold it, too."""

MOST_RATIO = 5.0
"""Colours of what is told in sigmas end there."""

ARROW_OF_WIDTH = 0.08
"""Length of a large arrow, part of the width of the image."""


def draw_volume(
    path: Path,
    calibration: BoardCalibration,
    points: Floats,
    depths: Floats,
    /,
    *,
    overwrite: bool,
) -> None:
    """Draw the sigma of points, and of their form, at several depths; and the board's shape."""
    unit = _unit(calibration)
    n_shapes = int(calibration.shape != "flat")
    n = len(depths) + n_shapes
    figure = Figure(figsize=(4.0 * n, 6.4), dpi=100, layout="compressed")
    device = calibration.devices[0]
    figure.suptitle(
        f"Sigma of points from the calibration, {unit}, over the image of {device.name}; form: "
        "without a motion and a scale of all points",
        fontsize=12, x=0.01, ha="left",
    )  # fmt: skip
    axes = figure.subplots(2, n, squeeze=False)
    both = volume_sigma(calibration, points)
    for row, what, maps in zip(axes, ("place", "form"), both, strict=True):
        own = [f"{what}, depth {depth:.4g} {unit}" for depth in depths]
        _draw_maps(list(row[: len(depths)]), maps, own, device, label=f"sigma, {unit}")
    if n_shapes:
        _draw_shape(axes[0, -1], calibration, unit)
        axes[1, -1].set_axis_off()
    save_figure(path, figure, overwrite=overwrite)


def _unit(calibration: BoardCalibration) -> str:
    return "mm" if calibration.board.has_scale else "pitches"


def _draw_maps(
    axes: list[Axes],
    maps: Floats,
    titles: list[str],
    device: Device,
    *,
    label: str,
    top: float | None = None,
    is_signed: bool = False,
) -> None:
    """Draw maps (n, row, col) over the image of a device, on one scale."""
    known = np.abs(maps[np.isfinite(maps)])
    held = float(np.percentile(known, HELD_BY_SCALE)) if len(known) else 1.0
    largest = float(known.max()) if len(known) else 1.0
    limit = top or max(largest if largest < NEARLY_HELD * held else held, 1e-9)
    extent = (-0.5, device.n_cols - 0.5, device.n_rows - 0.5, -0.5)
    for axis, plane, title in zip(axes, maps, titles, strict=True):
        image = axis.imshow(
            plane, cmap=SIGN_MAP if is_signed else SIZE_MAP, extent=extent,
            vmin=-limit if is_signed else 0, vmax=limit,
        )  # fmt: skip
        axis.set_facecolor(BACKGROUND)
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_xlabel(f"x in {device.name}, px", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0].set_ylabel(f"y in {device.name}, px", fontsize=8)
    extend = "neither" if largest <= limit else "both" if is_signed else "max"
    assert axes[0].figure is not None
    bar = axes[0].figure.colorbar(image, ax=axes, shrink=0.8, pad=0.01, extend=extend)
    bar.set_label(f"{label}; at most {largest:.2g}", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _draw_shape(axis: Axes, calibration: BoardCalibration, unit: str) -> None:
    board, z = calibration.board, calibration.shape_mm[:, 2]
    limit = max(float(np.abs(z).max()), 1e-9)
    x, y = board.points_mm[:, 0], board.points_mm[:, 1]
    dots = axis.scatter(x, y, c=z, cmap=SIGN_MAP, vmin=-limit, vmax=limit, s=60)
    axis.invert_yaxis()
    axis.set_aspect("equal")
    axis.set_title(f"board: out of its plane, {unit}", fontsize=10, loc="left")
    axis.set_xlabel(f"x on the board, {unit}", fontsize=8)
    axis.set_ylabel(f"y on the board, {unit}", fontsize=8)
    axis.tick_params(labelsize=8)
    assert axis.figure is not None
    axis.figure.colorbar(dots, ax=axis, shrink=0.8, pad=0.02)


def draw_comparison(
    path: Path,
    comparison: RigComparison,
    camera: Device,
    depths: Floats,
    /,
    *,
    unit: str = "mm",
    overwrite: bool,
) -> None:
    """Draw how points move, how their form changes, and that in sigmas, at several depths.

    Parameters
    ----------
    path : Path
    comparison : RigComparison; of points (n_depths, rows, cols)
    camera : Device; the first
    depths : (n_depths,), along its principal ray
    unit : str
    overwrite : bool
    """
    n_rows = 3 if comparison.counted else 2
    figure = Figure(figsize=(4.4 * len(depths), 3.5 * n_rows), dpi=100, layout="compressed")
    figure.suptitle(
        f"Former calibration minus this one, {unit}, over the image of {camera.name}; colour: "
        f"along its axis (+: farther), arrows: across it",
        fontsize=12, x=0.01, ha="left",
    )  # fmt: skip
    axes = figure.subplots(n_rows, len(depths), squeeze=False)
    maps = (("points", comparison.moved_mm), ("form", comparison.form_mm))
    for row, (what, vectors) in zip(axes, maps, strict=False):
        titles = [f"{what}, depth {depth:.4g} {unit}" for depth in depths]
        _draw_maps(
            list(row), vectors[..., 2], titles, camera, label=f"farther by, {unit}", is_signed=True
        )
        _draw_arrows(list(row), vectors[..., :2], camera, unit)
    if comparison.counted:
        ratio = np.linalg.norm(comparison.form_mm, axis=-1) / comparison.form_sigma_mm
        titles = [f"form over its sigma, depth {depth:.4g} {unit}" for depth in depths]
        label = f"sigmas of the {' and the '.join(comparison.counted)} calibration"
        _draw_maps(list(axes[2]), ratio, titles, camera, label=label, top=MOST_RATIO)
    save_figure(path, figure, overwrite=overwrite)


def _draw_arrows(axes: list[Axes], vectors: Floats, camera: Device, unit: str) -> None:
    """Draw vectors (n, row, col, 2), every second of them, on one scale."""
    x = np.linspace(0, camera.n_cols - 1, vectors.shape[2])[::2]
    y = np.linspace(0, camera.n_rows - 1, vectors.shape[1])[::2]
    length = np.linalg.norm(vectors, axis=-1)
    large = max(float(np.nanpercentile(length, HELD_BY_SCALE)), 1e-9)
    cut = np.minimum(1.0, large / np.maximum(length, 1e-12))[..., None] * vectors
    scale = large / (ARROW_OF_WIDTH * camera.n_cols)
    for axis, plane in zip(axes, cut, strict=True):
        arrows = axis.quiver(x, y, plane[::2, ::2, 0], plane[::2, ::2, 1], angles="xy",
                             scale_units="xy", scale=scale, width=0.004)  # fmt: skip
    axes[-1].quiverkey(arrows, 0.82, 1.04, large, f"{large:.2g} {unit}", labelpos="E",
                       fontproperties={"size": 8})  # fmt: skip
