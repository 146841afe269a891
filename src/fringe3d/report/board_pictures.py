"""Pictures of a calibration by a board: residuals, and what it is worth in the volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.calibrate import BoardCalibration
from fringe3d.errors import OutputError
from fringe3d.io.atomic import require_writable
from fringe3d.model import Device
from fringe3d.report.board import volume_sigma

Floats = NDArray[np.float64]

ROW_INCHES = 4.2
ARROW_OF_WIDTH = 0.06
"""Length of the arrow of a large residual, part of the width of the image."""

HELD_BY_SCALE = 98.0
BARS = 41
SIGMA_MAP = "viridis"
SHAPE_MAP = "RdBu_r"


def draw_board(
    path: Path, calibration: BoardCalibration, record: dict[str, Any], /, *, overwrite: bool
) -> None:
    """Draw, for each device, residuals over its image, their histogram, and rms by pose."""
    devices = calibration.devices
    poses = list(calibration.world_from_board)
    figure = Figure(figsize=(15.5, 0.8 + ROW_INCHES * len(devices)), dpi=100, layout="constrained")
    title = f"{record['board']['text']}: {len(poses)} poses; board {calibration.shape}"
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    axes = figure.subplots(len(devices), 3, squeeze=False, width_ratios=[1.5, 0.9, 1.1])
    colours = {pose: colormaps["tab10" if len(poses) <= 10 else "turbo"](
        k if len(poses) <= 10 else k / len(poses)) for k, pose in enumerate(poses)}  # fmt: skip
    for row, device in zip(axes, devices, strict=True):
        _draw_arrows(row[0], calibration, device, colours)
        _draw_histogram(row[1], calibration, device)
        _draw_poses(row[2], record, device, colours)
    save_figure(path, figure, overwrite=overwrite)


def _residuals(calibration: BoardCalibration, device: Device) -> Floats:
    own = [
        r
        for r, v in zip(calibration.residual_px, calibration.views, strict=True)
        if v.device == device.name
    ]
    return np.concatenate(own)


def _draw_arrows(
    axis: Axes, calibration: BoardCalibration, device: Device, colours: dict[str, Any]
) -> None:
    distance = np.linalg.norm(_residuals(calibration, device), axis=1)
    large = max(float(np.percentile(distance, HELD_BY_SCALE)), 1e-3)
    scale = large / (ARROW_OF_WIDTH * device.n_cols)
    for view, residual in zip(calibration.views, calibration.residual_px, strict=True):
        if view.device == device.name:
            axis.quiver(*view.pixels.T, *residual.T, angles="xy", scale_units="xy", scale=scale,
                        color=colours[view.pose], width=0.0022)  # fmt: skip
    axis.quiver([0.03 * device.n_cols], [0.06 * device.n_rows], [large], [0], angles="xy",
                scale_units="xy", scale=scale, color="black", width=0.004)  # fmt: skip
    axis.text(0.11 * device.n_cols, 0.06 * device.n_rows, f"{large:.2g} px", va="center")
    axis.set_xlim(-0.5, device.n_cols - 0.5)
    axis.set_ylim(device.n_rows - 0.5, -0.5)
    axis.set_aspect("equal")
    axis.set_title(
        f"{device.role} {device.name}: residuals, coloured by pose", fontsize=10, loc="left"
    )
    axis.tick_params(labelsize=8)


def _draw_histogram(axis: Axes, calibration: BoardCalibration, device: Device) -> None:
    residual = _residuals(calibration, device)
    limit = max(float(np.percentile(np.abs(residual), 99.0)), 1e-3)
    edges = np.linspace(-limit, limit, BARS)
    for k, colour in ((0, "#3b6ea8"), (1, "#c2652a")):
        axis.hist(np.clip(residual[:, k], -limit, limit), edges.tolist(), histtype="step",
                  color=colour, label="xy"[k], linewidth=1.4)  # fmt: skip
    noise = calibration.noise_px[device.name]
    middle = (edges[1:] + edges[:-1]) / 2
    bell = np.exp(-((middle / noise) ** 2) / 2) * (edges[1] - edges[0]) / noise / np.sqrt(2 * np.pi)
    axis.plot(middle, bell * len(residual), color="grey", linewidth=1, label=f"sigma {noise:.3f}")
    rms = calibration.rms_px(device.name)
    axis.set_title(f"rms {rms:.3f} px", fontsize=10, loc="left")
    axis.set_xlabel("residual, px", fontsize=9)
    axis.set_yticks([])
    axis.tick_params(labelsize=8)
    axis.legend(fontsize=8, frameon=False)


def _draw_poses(
    axis: Axes, record: dict[str, Any], device: Device, colours: dict[str, Any]
) -> None:
    poses = record["poses"]
    place = np.arange(len(poses))
    rms = [p["rms_px"].get(device.name, 0.0) for p in poses]
    axis.barh(place, rms, color=[colours[p["pose"]] for p in poses], height=0.7)
    held = [p["held_out_rms_px"].get(device.name, np.nan) for p in poses]
    if np.isfinite(held).any():
        axis.plot(held, place, "k|", markersize=9, markeredgewidth=2, label="where left out")
        axis.legend(fontsize=8, frameon=False, loc="lower right")
    axis.set_yticks(place, [p["pose"][-18:] for p in poses], fontsize=8)
    axis.invert_yaxis()
    axis.set_title("rms by pose, px", fontsize=10, loc="left")
    axis.tick_params(labelsize=8)


def draw_volume(
    path: Path,
    calibration: BoardCalibration,
    points: Floats,
    depths: Floats,
    /,
    *,
    overwrite: bool,
) -> None:
    """Draw the sigma of points at several depths, and the shape of the board."""
    unit = "mm" if calibration.board.has_scale else "pitches"
    sigma = np.linalg.norm(volume_sigma(calibration, points), axis=-1)
    n_shapes = int(calibration.shape != "flat")
    n = len(depths) + n_shapes
    figure = Figure(figsize=(4.6 * n, 4.3), dpi=100, layout="constrained")
    figure.suptitle(
        f"Sigma of points from the calibration, {unit}, over the image of "
        f"{calibration.devices[0].name}",
        fontsize=12, x=0.01, ha="left",
    )  # fmt: skip
    axes = figure.subplots(1, n, squeeze=False)[0]
    known = sigma[np.isfinite(sigma)]
    top = float(known.max()) if len(known) else 1.0
    device = calibration.devices[0]
    extent = (-0.5, device.n_cols - 0.5, device.n_rows - 0.5, -0.5)
    for axis, plane, depth in zip(axes, sigma, depths, strict=False):
        image = axis.imshow(plane, cmap=SIGMA_MAP, vmin=0, vmax=top, extent=extent)
        axis.set_facecolor("#d9dce1")
        axis.set_title(f"depth {depth:.4g} {unit}", fontsize=10, loc="left")
        axis.tick_params(labelsize=8)
    if len(known):
        figure.colorbar(image, ax=list(axes[: len(depths)]), shrink=0.8, pad=0.01)
    if n_shapes:
        _draw_shape(axes[-1], calibration, unit)
    save_figure(path, figure, overwrite=overwrite)


def _draw_shape(axis: Axes, calibration: BoardCalibration, unit: str) -> None:
    board, z = calibration.board, calibration.shape_mm[:, 2]
    limit = max(float(np.abs(z).max()), 1e-9)
    x, y = board.points_mm[:, 0], board.points_mm[:, 1]
    dots = axis.scatter(x, y, c=z, cmap=SHAPE_MAP, vmin=-limit, vmax=limit, s=60)
    axis.invert_yaxis()
    axis.set_aspect("equal")
    axis.set_title(f"board: out of its plane, {unit}", fontsize=10, loc="left")
    axis.tick_params(labelsize=8)
    assert axis.figure is not None
    axis.figure.colorbar(dots, ax=axis, shrink=0.8, pad=0.02)


def save_figure(path: Path, figure: Figure, /, *, overwrite: bool) -> None:
    """Write a picture, completely or not at all."""
    require_writable(path, overwrite=overwrite)
    aside = path.with_name(f".{path.name}.partial")
    _try_writing(path, aside, lambda: figure.savefig(aside, format="png"))


def _try_writing(path: Path, aside: Path, write: Callable[[], object]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write()
        aside.replace(path)
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem}") from problem
    finally:
        with suppress(OSError):
            aside.unlink()


def board_targets(out: Path, /, *, is_compared: bool = False) -> Sequence[Path]:
    """Return the files of a calibration: pictures, report, and last the rig itself.

    The picture of the comparison with a former rig, if there is one, follows the other pictures.
    """
    compared = ("-compared.png",) if is_compared else ()
    names = ("-board.png", "-volume.png", *compared, "-board.md")
    return [*(out.with_name(f"{out.stem}{name}") for name in names), out]
