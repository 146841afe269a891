"""Points to pixels and pixels to rays, for any device."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.geometry import _lens
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import Device

CAMERAS_KEPT = 3
"""Cameras whose viewing rays are kept between measurements, 24 bytes a pixel."""


def readable(array: NDArray[Any], /) -> NDArray[np.float64]:
    """Return a contiguous view that is read only: one type for the compiler, whatever comes."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def lens_of(device: Device, /) -> NDArray[np.float64]:
    """Return the packed lens parameters that the compiled kernels take, (25,)."""
    lens: NDArray[np.float64] = _lens.lens_vector(
        device.focal_px, device.center_px, device.distortion
    )
    return lens


def project(device: Device, points_world: ArrayLike, /) -> NDArray[np.float64]:
    """Project points of the world into the image of a camera or projector.

    Parameters
    ----------
    device : Device
    points_world : (..., 3) float, mm

    Returns
    -------
    (..., 2) float64, px
        (x, y); also beyond the image border. NaN for points behind the device.

    Notes
    -----
    OpenCV's lens model, all 14 coefficients.

    Examples
    --------
    >>> camera = Device(name="c1", role="camera", n_rows=100, n_cols=200,
    ...                 focal_px=[1000, 1000], center_px=[99.5, 49.5])
    >>> project(camera, [1.0, 2.0, 100.0]).tolist()
    [109.5, 69.5]
    """
    points = np.asarray(points_world, np.float64)
    flat, pose = readable(points.reshape(-1, 3)), device.device_from_world
    pixels = np.empty((len(flat), 2))
    over_rows(_lens.project_all, len(flat), flat, (*pose.translation, *pose.rotation.ravel()),
              lens_of(device), pixels, least=POINTS)  # fmt: skip
    return pixels.reshape(*points.shape[:-1], 2)


def normalize(device: Device, pixels: ArrayLike, /) -> NDArray[np.float64]:
    """Undistort pixels to coordinates on the plane z = 1 of the device frame.

    Parameters
    ----------
    device : Device
    pixels : (..., 2) float, px; (x, y)

    Returns
    -------
    (..., 2) float64
        NaN where the lens model is not one to one (beyond the fold of a strong distortion).

    Notes
    -----
    Newton's method on the exact model; `project` of the result meets the pixel to better
    than 1e-6 px. OpenCV's own fixed-point iteration does not for strong distortions.
    """
    pixels = np.asarray(pixels, np.float64)
    flat = np.ascontiguousarray(pixels.reshape(-1, 2))
    normalized = np.empty_like(flat)
    over_rows(_lens.normalize_all, len(flat), flat, lens_of(device), normalized, least=POINTS)
    return normalized.reshape(pixels.shape)


def unproject(device: Device, pixels: ArrayLike, /) -> NDArray[np.float64]:
    """Return the unit directions, in the device frame, of the rays through pixels.

    Parameters
    ----------
    device : Device
    pixels : (..., 2) float, px; (x, y)

    Returns
    -------
    (..., 3) float64, unit length; NaN as in `normalize`

    Examples
    --------
    >>> camera = Device(name="c1", role="camera", n_rows=100, n_cols=200,
    ...                 focal_px=[1000, 1000], center_px=[99.5, 49.5])
    >>> unproject(camera, [99.5, 49.5]).tolist()
    [0.0, 0.0, 1.0]
    """
    normalized = normalize(device, pixels)
    directions = np.concatenate([normalized, np.ones_like(normalized[..., :1])], axis=-1)
    unit: NDArray[np.float64] = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return unit


def rays(device: Device, pixels: ArrayLike, /) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origin (3,), mm, and unit directions (..., 3) of viewing rays in the world frame."""
    world_from_device = device.device_from_world.inverse()
    return world_from_device.translation, world_from_device.rotate(unproject(device, pixels))


@lru_cache(maxsize=CAMERAS_KEPT)
def grid_rays(device: Device, /) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return `rays` of all pixels, (3,) and (row, col, 3), kept for the next call: read only."""
    origin, directions = rays(device, pixel_grid(device.shape))
    origin.flags.writeable = directions.flags.writeable = False
    return origin, directions


def pixel_grid(shape: tuple[int, int], /) -> NDArray[np.float64]:
    """Return the pixel centres of an image, (row, col, 2), as (x, y).

    Examples
    --------
    >>> pixel_grid((2, 3))[1, 2].tolist()
    [2.0, 1.0]
    """
    rows, cols = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return np.stack([cols, rows], axis=-1)


@lru_cache(maxsize=CAMERAS_KEPT)
def pixel_centres(shape: tuple[int, int], /) -> NDArray[np.float64]:
    """Return `pixel_grid`, kept for the next call: read only."""
    grid = pixel_grid(shape)
    grid.flags.writeable = False
    return grid


def triangulation_angle(a: Device, b: Device, reference_point: ArrayLike, /) -> float:
    """Return the angle, rad, between the rays of two devices to a reference point (3,), mm."""
    point = np.asarray(reference_point, np.float64)
    to_a, to_b = point - a.center_world, point - b.center_world
    return float(np.arctan2(np.linalg.norm(np.cross(to_a, to_b)), to_a @ to_b))
