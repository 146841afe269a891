"""What a rig is designed around: its reference point, its depths, the direction it faces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.paper import Depths
from fringe3d.errors import RigError
from fringe3d.geometry import depth_interval, pixel_grid, rays
from fringe3d.model import Device, MeasuringVolume, Rig

SEARCH_PIXELS = 32
"""Pixels along each side of C1 that are tried where its principal ray misses the volume."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """The point at which the rig is described.

    Parameters
    ----------
    point_mm : (3,) float, mm; the middle of the measuring volume on C1's principal ray, or on
        its ray through the middle of what it sees of the volume
    facing : (3,) float; unit normal of a surface there that faces the rig: the middle between
        the directions to the two cameras (to camera and projector, where there is one camera)
    depths : Depths; of the volume along that ray
    """

    point_mm: NDArray[np.float64]
    facing: NDArray[np.float64]
    depths: Depths


def with_depth(rig: Rig, depth_mm: tuple[float, float] | None, /) -> Rig:
    """Return the rig with its volume cut to a depth range (min, max), mm from C1.

    Raises
    ------
    RigError
        If the rig has no volume and no depth range is given, or if the range lies behind C1.
    """
    if depth_mm is None:
        require_volume(rig)
        return rig
    try:
        slab = MeasuringVolume.depth_slab(
            rig.cameras[0], depth_min_mm=depth_mm[0], depth_max_mm=depth_mm[1]
        )
    except ValueError as problem:
        raise RigError(f"depth range: {problem}. Correct it") from None
    return replace(rig, volume=slab if rig.volume is None else rig.volume.intersection(slab))


def require_volume(rig: Rig, /) -> MeasuringVolume:
    """Return the measuring volume; raise RigError where the rig has none."""
    if rig.volume is None:
        raise RigError(
            "rig: expected a measuring volume, for it bounds the segments; found none. Give the "
            "depth range of the objects (--depth MIN:MAX, mm from the first camera), or add a "
            "[volume] to the rig"
        )
    return rig.volume


def partner_of(rig: Rig, /) -> Device:
    """Return the device that C1 works with: C2, or the projector of a rig with one camera."""
    if len(rig.cameras) > 1:
        return rig.cameras[1]
    if rig.projector is None:
        raise RigError(
            "rig: expected a second camera or a projector, found one camera alone. Add a device"
        )
    return rig.projector


def facing_direction(rig: Rig, points_mm: ArrayLike, /) -> NDArray[np.float64]:
    """Return the unit normals, at points (..., 3), of surfaces that face the rig, (..., 3)."""
    points = np.asarray(points_mm, np.float64)
    middle = np.zeros_like(points)
    for device in (rig.cameras[0], partner_of(rig)):
        away = device.center_world - points
        middle += away / np.linalg.norm(away, axis=-1, keepdims=True)
    return np.asarray(middle / np.linalg.norm(middle, axis=-1, keepdims=True))


def reference_of(rig: Rig, /) -> Reference:
    """Return the reference point of a rig with a measuring volume.

    Raises
    ------
    RigError
        If there is no volume, if it has no end along the ray, or if C1 does not see it.
    """
    volume, camera = require_volume(rig), rig.cameras[0]
    origin, direction = rays(camera, camera.center_px)
    near, far = (float(end) for end in depth_interval(origin, direction, volume))
    if not near < far:
        origin, direction = rays(camera, _middle_pixel(camera, volume))
        near, far = (float(end) for end in depth_interval(origin, direction, volume))
    if not (0 < near < far < np.inf):
        raise RigError(
            f"rig: expected a volume with two ends before camera '{camera.name}', found depths "
            f"from {near:g} to {far:g} mm. Give a depth range (--depth MIN:MAX)"
        )
    middle = (near + far) / 2
    point = origin + middle * direction
    depths = Depths(depth_min_mm=near, depth_ref_mm=middle, depth_max_mm=far)
    return Reference(point_mm=point, facing=facing_direction(rig, point), depths=depths)


def _middle_pixel(camera: Device, volume: MeasuringVolume) -> NDArray[np.float64]:
    """Return the middle of the pixels that see a convex volume: that pixel sees it, too."""
    rows, cols = (max(1, n // SEARCH_PIXELS) for n in camera.shape)
    pixels = pixel_grid(camera.shape)[::rows, ::cols].reshape(-1, 2)
    near, far = depth_interval(*rays(camera, pixels), volume)
    seen = near < far
    if not seen.any():
        raise RigError(
            f"rig: expected the measuring volume in the view of camera '{camera.name}', found it "
            "beside. Correct the volume, the depth range or the pose of the camera"
        )
    return np.asarray(pixels[seen].mean(axis=0))
