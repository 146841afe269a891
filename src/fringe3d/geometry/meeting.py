"""Homologous points to the points in space where their rays meet."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry._lens import safe_radius
from fringe3d.geometry._meeting import meet_all
from fringe3d.geometry.projection import grid_rays, lens_of, readable
from fringe3d.kernels import over_rows
from fringe3d.model import Correspondences, Device, MeasuringVolume


class Met(NamedTuple):
    """Where rays meet: points (row, col, 3), sigma and skew (row, col), mm, NaN where there is no
    point; rejection (row, col)."""

    points_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float32]
    skew_mm: NDArray[np.float32]
    rejection: NDArray[np.uint16]


def meet(
    matches: Correspondences,
    camera: Device,
    other: Device,
    volume: MeasuringVolume | None,
    /,
    *,
    max_epipolar_px: float,
    max_sigma_part: float,
    met: Met | None = None,
    todo: NDArray[np.bool_] | None = None,
) -> Met:
    """Intersect the viewing rays of homologous points; see `fringe3d.triangulate.triangulate`.

    Parameters
    ----------
    matches : Correspondences
    camera, other : Device; C1 and the other device
    volume : MeasuringVolume or None
    max_epipolar_px : float, px; may be infinite
    max_sigma_part : float; largest standard deviation, part of the depth
    met : Met or None; points that are known, to which the others are added
    todo : (row, col) bool or None; the pixels that are left; None for all
    """
    shape = matches.rejection.shape
    whole = shape == camera.shape
    directions = grid_rays(camera)[1] if whole else np.empty((0, 0, 3))
    bounds = (np.empty((0, 3)), np.empty(0))
    if volume is not None:
        bounds = (np.ascontiguousarray(volume.normals), volume.offsets_mm)
    met = met or Met(
        points_mm=np.empty((*shape, 3)),
        sigma_mm=np.empty(shape, np.float32),
        skew_mm=np.empty(shape, np.float32),
        rejection=matches.rejection.copy(),
    )
    pixels1, pixels2, sigma, residual, rays1 = (
        readable(a) for a in (matches.pixels_c1, matches.pixels, matches.sigma_px,
                               matches.epipolar_residual_px, directions)
    )  # fmt: skip
    over_rows(
        meet_all, shape[0], pixels1, pixels2, sigma, residual, rays1,
        (_numbers(camera), _numbers(other)),
        tuple(readable(a) for a in bounds), (max_epipolar_px, max_sigma_part),
        np.ones(shape, np.bool_) if todo is None else todo, tuple(met),
    )  # fmt: skip
    return met


def _numbers(device: Device) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], float]:
    lens = lens_of(device)
    rotation = np.ascontiguousarray(device.device_from_world.rotation)
    return readable(device.center_world), readable(rotation), lens, float(safe_radius(lens))
