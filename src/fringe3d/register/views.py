"""Points on the grid of a camera to a view with normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import EmptyResultError
from fringe3d.kernels import over_rows
from fringe3d.model import Device, SurfaceView, TablePosition
from fringe3d.register._grid import grid_normals

REACH = 4.0
"""Neighbours belong to one surface up to so many typical distances: slopes up to 76 deg."""

LEAST_POINTS = 200

ROWS = 256
"""So many rows at least tell the typical distance of points."""

SPARSE, DENSE, MOST_TOGETHER = 0.5, 0.8, 8
"""Where fewer of the points have neighbours, pixels are put together until so many have; and the
most that are put together along a side."""


def surface_view(
    name: str,
    camera: Device,
    points_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.floating],
    grey: NDArray[np.uint8] | None = None,
    /,
    *,
    position: TablePosition | None = None,
) -> SurfaceView:
    """Make a view of points on the pixels of a camera.

    Parameters
    ----------
    name : str
    camera : Device; C1
    points_mm : (row, col, 3) float, mm, world frame; NaN where there are none
    sigma_mm : (row, col) float, mm; along the viewing ray
    grey : (row, col) uint8 or None; brightness
    position : TablePosition or None

    Raises
    ------
    EmptyResultError
        If there are hardly any points.

    Notes
    -----
    A normal is that of the plane of least squares through the points of 5 x 5 pixels that belong
    to the surface. Where most points have no neighbours (Gray code alone gives one for each
    projector pixel), pixels are put together until most have; the points of each are averaged.
    """
    brightness = np.zeros(camera.shape, np.uint8) if grey is None else grey
    camera, points, sigma, brightness = _dense(camera, points_mm, sigma_mm, brightness)
    points = np.ascontiguousarray(points, np.float64)
    n_points = int(np.isfinite(points[..., 0]).sum())
    spacing = typical_spacing_mm(points)
    if n_points < LEAST_POINTS or not np.isfinite(spacing):
        raise EmptyResultError(
            f"{name}: expected a view with at least {LEAST_POINTS} points, found {n_points}. "
            "Leave it out, or measure it again"
        )
    normals = np.empty(points.shape, np.float32)
    over_rows(grid_normals, len(points), points, camera.center_world, REACH * spacing, normals)
    return SurfaceView(
        name=name,
        camera=camera,
        points_mm=points,
        normals=normals,
        sigma_mm=np.asarray(sigma, np.float32),
        grey=brightness,
        spacing_mm=spacing,
        position=position,
    )


def typical_spacing_mm(points_mm: NDArray[np.float64], /) -> float:
    """Return the median distance of points of neighbouring pixels, mm; NaN if there are none.

    Of large views a part of the rows tells.
    """
    step = max(len(points_mm) // ROWS, 1)
    here, below = points_mm[:-1:step], points_mm[1::step]
    sides = [np.diff(here, axis=1).reshape(-1, 3), (below - here[: len(below)]).reshape(-1, 3)]
    steps = np.linalg.norm(np.concatenate(sides), axis=1)
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if len(steps) else float("nan")


def _dense(
    camera: Device,
    points: NDArray[np.float64],
    sigma: NDArray[np.floating],
    grey: NDArray[np.uint8],
) -> tuple[Device, NDArray[np.float64], NDArray[np.floating], NDArray[np.uint8]]:
    """Put pixels together until most points have neighbours."""
    if _neighboured(points[..., 0]) < SPARSE:
        for factor in range(2, MOST_TOGETHER + 1):
            found = _together(camera, points, sigma, grey, factor)
            if _neighboured(found[1][..., 0]) >= DENSE:
                return found
    return camera, points, sigma, grey


def _neighboured(values: NDArray[np.float64]) -> float:
    """Return the part of the points that have one to the right and one below."""
    good = np.isfinite(values)
    both = good[:-1, :-1] & good[1:, :-1] & good[:-1, 1:]
    return float(both.sum() / max(int(good.sum()), 1))


def _together(
    camera: Device,
    points: NDArray[np.float64],
    sigma: NDArray[np.floating],
    grey: NDArray[np.uint8],
    factor: int,
) -> tuple[Device, NDArray[np.float64], NDArray[np.floating], NDArray[np.uint8]]:
    """Average the points of squares of pixels."""
    rows, cols = camera.n_rows // factor, camera.n_cols // factor

    def blocks(values: NDArray[np.floating]) -> NDArray[np.float64]:
        cut = np.asarray(values, np.float64)[: rows * factor, : cols * factor]
        parts = cut.reshape(rows, factor, cols, factor, -1)
        return parts.transpose(0, 2, 1, 3, 4).reshape(rows, cols, factor**2, -1)

    good = np.isfinite(blocks(points)[..., :1])
    count = good.sum(axis=2)

    def mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
        total = np.where(good, blocks(values), 0.0).sum(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(total / count)

    coarse = replace(
        camera, n_rows=rows, n_cols=cols, focal_px=camera.focal_px / factor,
        center_px=(camera.center_px + 0.5) / factor - 0.5,
    )  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = mean(sigma)[..., 0] / np.sqrt(count[..., 0])
    bright = np.nan_to_num(mean(grey.astype(np.float64))[..., 0]).astype(np.uint8)
    return coarse, mean(points), noise, bright
