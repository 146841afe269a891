"""What a projector is fitted to: points in space and where on it their light comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.geometry import pixel_grid, rays
from fringe3d.model import Device, PhaseMap, PointMap

Floats = NDArray[np.float64]

BLOCKS_ACROSS = 25
"""Blocks of pixels along the longer side of the image; odd, so that their parity is a
checkerboard."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitPoints:
    """Points of one scan and their projector coordinates across the fringes.

    Parameters
    ----------
    points_mm : (n, 3) float, mm, world frame
    position_px : (n, n_angles) float, projector px
        The coordinate w of each fringe angle; NaN where it is not known.
    angles : tuple of float, rad; fringe angles
    sigma_px : (n, n_angles) float, projector px, > 0; standard deviation of `position_px`
    noise_mm : (n, 3) float, mm, or None (no noise)
        Displacement of each point by one standard deviation, away from the first camera.
    block : (n,) int or None (a grid over the points)
        Neighbouring points share a block; a fit to the even ones is judged on the odd ones.
    pixels : (n, 2) int or None; (row, col) of C1, for pictures
    shape : (n_rows, n_cols) of C1, for pictures
    name : str; of the scan

    Raises
    ------
    ValueError
        If shapes do not agree, or a number is not finite.
    """

    points_mm: Floats
    position_px: Floats
    angles: tuple[float, ...]
    sigma_px: Floats
    noise_mm: Floats
    block: NDArray[np.int64]
    pixels: NDArray[np.int64]
    shape: tuple[int, int]
    name: str

    def __init__(
        self,
        *,
        points_mm: ArrayLike,
        position_px: ArrayLike,
        angles: Sequence[float],
        sigma_px: ArrayLike,
        noise_mm: ArrayLike | None = None,
        block: ArrayLike | None = None,
        pixels: ArrayLike | None = None,
        shape: tuple[int, int] = (0, 0),
        name: str = "",
    ) -> None:
        points = _floats("points_mm", points_mm, (-1, 3))
        n, n_angles = len(points), len(angles)
        position = _floats("position_px", position_px, (n, n_angles), may_miss=True)
        sigma = _floats("sigma_px", np.broadcast_to(sigma_px, (n, n_angles)), (n, n_angles),
                        may_miss=True)  # fmt: skip
        if not (sigma[np.isfinite(position)] > 0).all():
            raise ValueError("lit points: sigma_px: expected positive numbers")
        noise = np.zeros((n, 3)) if noise_mm is None else noise_mm
        for field, value in (
            ("points_mm", points),
            ("position_px", position),
            ("angles", tuple(float(angle) for angle in angles)),
            ("sigma_px", sigma),
            ("noise_mm", _floats("noise_mm", noise, (n, 3))),
            ("block", _whole("block", _grid(points) if block is None else block, (n,))),
            ("pixels", _whole("pixels", np.zeros((n, 2)) if pixels is None else pixels, (n, 2))),
            ("shape", shape),
            ("name", name),
        ):
            object.__setattr__(self, field, value)

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        return len(self.points_mm)


def lit_points(
    points: PointMap, phases: Sequence[PhaseMap], camera: Device, /, *, name: str = ""
) -> LitPoints:
    """Collect the points of a measurement and the projector coordinates of their pixels.

    Parameters
    ----------
    points : PointMap; of two cameras, on the grid of C1
    phases : PhaseMap of C1 for each fringe angle, absolute
    camera : Device; C1
    name : str; of the scan

    Returns
    -------
    LitPoints

    Raises
    ------
    ValueError
        If a code leaves several orders.
    """
    good = points.is_valid
    _, directions = rays(camera, pixel_grid(good.shape)[good])
    pixels = np.argwhere(good)
    side = -(-max(good.shape) // BLOCKS_ACROSS)
    rows, cols = (pixels // side).T
    to_px = [m.period_px / (2 * np.pi) for m in phases]
    # float32 is the rounding of a map; the sigma of a phase is never below it.
    sigma = [np.fmax(m.phase_std[good], 1e-6) * px for m, px in zip(phases, to_px, strict=True)]
    return LitPoints(
        points_mm=points.points_mm[good],
        position_px=np.stack([m.position_px[good] for m in phases], axis=1),
        angles=[m.angle for m in phases],
        sigma_px=np.stack(sigma, axis=1),
        noise_mm=directions * points.sigma_mm[good][:, None],
        block=rows * BLOCKS_ACROSS + cols,
        pixels=pixels,
        shape=(good.shape[0], good.shape[1]),
        name=name,
    )


def _floats(
    name: str, value: ArrayLike, shape: tuple[int, int], *, may_miss: bool = False
) -> Floats:
    """Return a read-only array of a shape (-1 matches any length), finite unless told else."""
    array = np.array(value, np.float64)
    if array.ndim != 2 or any(s not in (-1, n) for s, n in zip(shape, array.shape, strict=True)):
        raise ValueError(f"lit points: {name}: expected shape {shape}, found {array.shape}")
    if not may_miss and not np.isfinite(array).all():
        raise ValueError(f"lit points: {name}: expected finite numbers, found NaN or infinity")
    array.setflags(write=False)
    return array


def _whole(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.int64]:
    array = np.array(value, np.int64)
    if array.shape != shape:
        raise ValueError(f"lit points: {name}: expected shape {shape}, found {array.shape}")
    array.setflags(write=False)
    return array


def _grid(points: Floats) -> NDArray[np.int64]:
    """Return the cell of each point in a grid over the two longest directions of the cloud."""
    if not len(points):
        return np.zeros(0, np.int64)
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    flat = centred @ axes[:, 1:]
    low, high = flat.min(axis=0), flat.max(axis=0)
    cells = (flat - low) / np.maximum(high - low, 1e-12) * (BLOCKS_ACROSS - 1e-6)
    i, j = cells.astype(np.int64).T
    return np.asarray(i * BLOCKS_ACROSS + j)
