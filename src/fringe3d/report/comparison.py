"""Two calibrations of a rig, side by side in the measuring volume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fringe3d.calibrate import RigComparison
from fringe3d.model import Device
from fringe3d.report.board_pictures import SIGMA_MAP, Floats, save_figure


def comparison_record(comparison: RigComparison, /, *, unit: str = "mm") -> dict[str, Any]:
    """Return the figures as plain data, and in words."""
    moved, form = (
        np.linalg.norm(vectors, axis=-1) for vectors in (comparison.moved_mm, comparison.form_mm)
    )
    text = (
        f"compared with the former calibration ({' and '.join(comparison.devices)}, over the "
        f"measuring volume): points move by {comparison.moved_rms_mm:.3g} {unit} rms, "
        f"{np.nanmax(moved):.3g} at most; their form by {comparison.form_rms_mm:.3g} rms, "
        f"{np.nanmax(form):.3g} at most; lengths by {100 * (comparison.scale - 1):+.3f} %"
    )
    return {
        "text": text,
        "devices": list(comparison.devices),
        "moved_rms": comparison.moved_rms_mm,
        "moved_largest": float(np.nanmax(moved)),
        "form_rms": comparison.form_rms_mm,
        "form_largest": float(np.nanmax(form)),
        "scale": comparison.scale,
    }


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
    """Draw by how far points move, and by how much their form changes, at several depths.

    Parameters
    ----------
    path : Path
    comparison : RigComparison; of points (n_depths, rows, cols)
    camera : Device; the first
    depths : (n_depths,), along its principal ray
    unit : str
    overwrite : bool
    """
    figure = Figure(figsize=(4.6 * len(depths), 7.6), dpi=100, layout="constrained")
    figure.suptitle(
        f"The former calibration minus this one, {unit}, over the image of {camera.name}",
        fontsize=12, x=0.01, ha="left",
    )  # fmt: skip
    axes = figure.subplots(2, len(depths), squeeze=False)
    extent = (-0.5, camera.n_cols - 0.5, camera.n_rows - 0.5, -0.5)
    maps = (("points move by", comparison.moved_mm), ("form changes by", comparison.form_mm))
    for row, (what, vectors) in zip(axes, maps, strict=True):
        size = np.linalg.norm(vectors, axis=-1)
        top = float(np.nanmax(size))
        for axis, plane, depth in zip(row, size, depths, strict=True):
            image = axis.imshow(plane, cmap=SIGMA_MAP, vmin=0, vmax=top, extent=extent)
            axis.set_facecolor("#d9dce1")
            axis.set_title(f"{what}, depth {depth:.4g} {unit}", fontsize=10, loc="left")
            axis.tick_params(labelsize=8)
        figure.colorbar(image, ax=list(row), shrink=0.8, pad=0.01)
    save_figure(path, figure, overwrite=overwrite)
