"""A picture of what the calibration of a rig misses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringe3d.model import CalibrationBias, Device
from fringe3d.report.saving import save_figure

N_ARROWS = (9, 12)
"""Rows and columns."""


def write_bias_picture(path: Path, bias: CalibrationBias, camera: Device, /, *, title: str) -> None:
    """Draw the displacement in C2 over the image of C1, at the near end, middle and far end.

    Parameters
    ----------
    path : Path
    bias : CalibrationBias
    camera : Device; C1
    title : str
    """
    from matplotlib.figure import Figure

    x, y = np.meshgrid(
        np.linspace(0, camera.n_cols - 1, N_ARROWS[1]),
        np.linspace(0, camera.n_rows - 1, N_ARROWS[0]),
    )
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    depths = bias.middle[2] + np.array([-1, 0, 1]) * bias.scale[2]
    moved = [bias.displacement(pixels, np.full(len(pixels), depth)) for depth in depths]
    top = max(float(np.linalg.norm(moved, axis=-1).max()), 1e-3)
    figure = Figure(figsize=(13, 4.4), layout="constrained", dpi=110)
    panels = figure.subplots(1, 3, sharey=True)
    for panel, depth, step in zip(panels, depths, moved, strict=True):
        size = np.linalg.norm(step, axis=1)
        arrows = panel.quiver(x.ravel(), y.ravel(), step[:, 0], step[:, 1], size, cmap="viridis",
                              clim=(0, top), angles="xy", scale=12 * top, width=0.006)  # fmt: skip
        panel.set(title=f"{depth:.0f} mm from C1", xlabel="x in C1 (px)", aspect="equal",
                  xlim=(-30, camera.n_cols + 30), ylim=(camera.n_rows + 30, -30))  # fmt: skip
    panels[0].set_ylabel("y in C1 (px)")
    figure.colorbar(arrows, ax=panels, label="displacement in C2 (px)", shrink=0.9)
    figure.suptitle(f"{title}: {bias.rms_px:.2f} px rms, known to {bias.sigma_px:.2f} px")
    save_figure(path, figure, overwrite=True)
