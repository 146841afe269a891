"""Points on the grid of a camera to a view with normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import EmptyResultError
from fringe3d.kernels import over_rows
from fringe3d.model import Device, SurfaceView, TablePosition
from fringe3d.register._grid import grid_normals

REACH = 4.0
"""Neighbours belong to one surface up to so many typical distances: slopes up to 76 deg."""

LEAST_POINTS = 200


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
    to the surface.
    """
    points = np.ascontiguousarray(points_mm, np.float64)
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
        sigma_mm=np.asarray(sigma_mm, np.float32),
        grey=np.zeros(points.shape[:2], np.uint8) if grey is None else grey,
        spacing_mm=spacing,
        position=position,
    )


def typical_spacing_mm(points_mm: NDArray[np.float64], /) -> float:
    """Return the median distance of points of neighbouring pixels, mm; NaN if there are none."""
    sides = [np.diff(points_mm, axis=axis).reshape(-1, 3) for axis in (0, 1)]
    steps = np.linalg.norm(np.concatenate(sides), axis=1)
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if len(steps) else float("nan")
