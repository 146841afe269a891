"""What corners of a board leave in the parts of an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import BoardCalibration
from fringe3d.model import Device

Floats = NDArray[np.float64]

CELLS = (8, 6)
"""Parts across and down the image."""

FEW_CORNERS = 4
"""Of fewer nobody can tell what they share."""


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """Residuals by part of an image, (row, col).

    Parameters
    ----------
    n_corners : (rows, cols) int
    rms_px : (rows, cols) float, px; of the distances; NaN where there is no corner
    shared_px : (rows, cols, 2) float, px
        Median of each coordinate: what the lens leaves; NaN where there are fewer than four.
    """

    n_corners: NDArray[np.int64]
    rms_px: Floats
    shared_px: Floats

    @property
    def coverage(self) -> float:
        """Return the part of the image in which there is a corner."""
        return float((self.n_corners > 0).mean())


def residuals_of(calibration: BoardCalibration, device: str, /) -> tuple[Floats, Floats]:
    """Return the corners of a device, and their residuals, each (n, 2), px."""
    own = [(v.pixels, r) for v, r in zip(calibration.views, calibration.residual_px, strict=True)
           if v.device == device]  # fmt: skip
    pixels, residual = zip(*own, strict=True)
    return np.concatenate(pixels), np.concatenate(residual)


def regions_of(calibration: BoardCalibration, device: Device, /) -> Regions:
    """Return what the corners of a device leave, by part of its image."""
    pixels, residual = residuals_of(calibration, device.name)
    cols, rows = CELLS
    cell = np.floor((pixels + 0.5) / [device.n_cols, device.n_rows] * CELLS).astype(int)
    cell = np.clip(cell, 0, np.array(CELLS) - 1)  # noise puts a few beside the image
    counts = np.zeros((rows, cols), np.int64)
    rms, shared = np.full((rows, cols), np.nan), np.full((rows, cols, 2), np.nan)
    for row, col in np.ndindex(rows, cols):
        own = residual[(cell == (col, row)).all(axis=1)]
        counts[row, col] = len(own)
        if len(own):
            rms[row, col] = np.sqrt((own**2).sum(axis=1).mean())
        if len(own) >= FEW_CORNERS:
            shared[row, col] = np.median(own, axis=0)
    return Regions(counts, rms, shared)
