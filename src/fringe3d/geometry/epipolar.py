"""Epipolar segments and curves: the images of a viewing ray in another device."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.geometry._clip import clip_all
from fringe3d.geometry._sheets import cross_all
from fringe3d.geometry.projection import (
    grid_rays,
    lens_of,
    normalize,
    pixel_grid,
    project,
    rays,
    readable,
)
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import Device, MeasuringVolume

INTERVALS_KEPT = 4
"""Cameras and volumes whose intervals are kept between measurements, 16 bytes a pixel."""

FRUSTUM_SAMPLES = 257
"""Samples along each image border; they miss less than 0.001 px of the bulge of a strongly
distorted border."""


def frustum(device: Device, /) -> MeasuringVolume:
    """Return the pyramid that a device sees or lights, as half-spaces of the world frame.

    The pyramid encloses the (distorted) image border; no pixel of the image is cut off.
    """
    right, bottom = device.n_cols - 0.5, device.n_rows - 0.5
    xs = np.linspace(-0.5, right, FRUSTUM_SAMPLES)
    ys = np.linspace(-0.5, bottom, FRUSTUM_SAMPLES)
    border = np.concatenate(
        [
            np.stack([x, y], axis=-1)
            for x, y in (
                (xs, np.full_like(xs, -0.5)),
                (xs, np.full_like(xs, bottom)),
                (np.full_like(ys, -0.5), ys),
                (np.full_like(ys, right), ys),
            )
        ]
    )
    seen = normalize(device, border)
    if np.isnan(seen).any():
        # The lens folds inside the image: the widest rays lie somewhere in it.
        seen = normalize(device, pixel_grid(device.shape)).reshape(-1, 2)
    lower, upper = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    normals = np.array(
        [[-1, 0, lower[0]], [1, 0, -upper[0]], [0, -1, lower[1]], [0, 1, -upper[1]], [0, 0, -1]]
    )
    world_from_device = device.device_from_world.inverse()
    normals_world = world_from_device.rotate(normals)
    return MeasuringVolume(
        normals=normals_world, offsets_mm=normals_world @ world_from_device.translation
    )


def depth_interval(
    origin: NDArray[np.float64], directions: NDArray[np.float64], volume: MeasuringVolume, /
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Clip viewing rays by a convex volume.

    Parameters
    ----------
    origin : (3,) float, mm
    directions : (..., 3) float, unit length
    volume : MeasuringVolume

    Returns
    -------
    near, far : (...) float64, mm
        Distances along the rays, ``0 <= near``; ``near > far`` where a ray misses the volume
        (or is NaN), ``far`` infinite where the volume is open.
    """
    flat, normals = (  # read only, whatever comes: one type for the compiler
        readable(values) for values in (directions.reshape(-1, 3), volume.normals)
    )
    near, far = np.empty(len(flat)), np.empty(len(flat))
    room = volume.offsets_mm - volume.normals @ origin
    over_rows(clip_all, len(flat), flat, normals, room, near, far, least=POINTS)
    shape = directions.shape[:-1]
    return near.reshape(shape), far.reshape(shape)


@lru_cache(maxsize=INTERVALS_KEPT)
def grid_intervals(
    camera: Device, other: Device, volume: MeasuringVolume | None, /
) -> NDArray[np.float32]:
    """Clip the viewing rays of all pixels by a volume, kept for the next call: read only.

    Returns
    -------
    (row, col, 4) float32, mm
        Where a ray enters and leaves the volume, and where the part of it begins and ends that
        `other` sees; as `depth_interval`.
    """
    origin, directions = grid_rays(camera)
    intervals = np.empty((*camera.shape, 4), np.float32)
    seen = frustum(other)
    bounds = (seen, seen) if volume is None else (volume, volume.intersection(seen))
    for first, bound in zip((0, 2), bounds, strict=True):
        near, far = depth_interval(origin, directions, bound)
        intervals[..., first], intervals[..., first + 1] = near, far
    if volume is None:
        intervals[..., :2] = 0, np.inf
    intervals.flags.writeable = False
    return intervals


def epipolar_curve(
    a: Device, b: Device, pixel: ArrayLike, depths_mm: ArrayLike, /
) -> NDArray[np.float64]:
    """Return the image in `b` of the ray of `a` through one pixel.

    Parameters
    ----------
    a, b : Device
    pixel : (2,) float, px; (x, y) in `a`
    depths_mm : (n,) float, mm; distances along the ray

    Returns
    -------
    (n, 2) float64, px
        Points of the curve; straight only without distortion. NaN behind `b`.
    """
    origin, direction = rays(a, pixel)
    return project(b, origin + np.asarray(depths_mm, np.float64)[:, None] * direction)


def epipolar_segment(
    a: Device, b: Device, pixels: ArrayLike, volume: MeasuringVolume | None, /
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the part of each viewing ray of `a` inside the volume and the view of `b`.

    Parameters
    ----------
    a, b : Device
    pixels : (..., 2) float, px; (x, y) in `a`
    volume : MeasuringVolume or None (only the view of `b` bounds the segment)

    Returns
    -------
    near, far : (...) float64, mm
        As `depth_interval`.
    """
    origin, directions = rays(a, pixels)
    seen = frustum(b)
    bounds = seen if volume is None else volume.intersection(seen)
    return depth_interval(origin, directions, bounds)


def sheet_crossing(
    projector: Device,
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    position_px: NDArray[np.float64],
    angle: float,
    /,
) -> NDArray[np.float64]:
    """Intersect viewing rays with the light sheets of a projector.

    The sheet is the set of points that the projector lights with the coordinate
    ``w = cos(angle) (u + 1/2) + sin(angle) (v + 1/2)``. Without distortion it is a plane.

    Parameters
    ----------
    projector : Device
    origin : (3,) float, mm
    directions : (n, 3) float, unit length
    position_px : (n,) float, projector px; w
    angle : float, rad

    Returns
    -------
    (n,) float64, mm
        Distance along each ray; NaN where ray and sheet do not meet in front of the projector.

    Notes
    -----
    The pinhole solution ``t = (a - c w) / (e w - b)`` starts a Newton iteration on the exact
    model. Its derivative is taken by a central difference of 1e-4 of the distance.
    """
    to_projector = projector.device_from_world
    depths = np.empty(len(directions))
    over_rows(
        cross_all,
        len(directions),
        to_projector.apply(origin), to_projector.rotation, np.ascontiguousarray(directions),
        np.broadcast_to(np.asarray(position_px, np.float64), depths.shape).copy(),
        lens_of(projector),
        np.array([np.cos(angle), np.sin(angle)]), depths,
        least=POINTS,
    )  # fmt: skip
    return depths


def closest_depths(
    origin_a: NDArray[np.float64],
    directions_a: NDArray[np.float64],
    origin_b: NDArray[np.float64],
    directions_b: NDArray[np.float64],
    /,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances along two sets of rays at which they are closest to each other.

    Parameters
    ----------
    origin_a, origin_b : (3,) float, mm
    directions_a, directions_b : (n, 3) float, unit length

    Returns
    -------
    depth_a, depth_b : (n,) float64, mm
        Negative behind the origin; NaN or infinite for parallel rays.
    """
    base = origin_b - origin_a
    cosine = (directions_a * directions_b).sum(-1)
    along_a, along_b = directions_a @ base, directions_b @ base
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_a = (along_a - cosine * along_b) / (1 - cosine**2)
        depth_b = (cosine * along_a - along_b) / (1 - cosine**2)
    return depth_a, depth_b
