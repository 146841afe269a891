"""Phase maps of a sphere before a plane, in closed form on OpenCV's lens model: no images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from closed_form import demo_rig
from fringe3d.model import (
    NO_ORDER,
    Device,
    PhaseMap,
    Rejection,
    Rig,
    RigidTransform,
)

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

DISTANCE_MM = 335.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """The plane z = plane_z_mm and a sphere before it; radius 0 for none. World frame, mm."""

    plane_z_mm: float = -8.0
    center_mm: tuple[float, float, float] = (2.0, -2.0, -3.0)
    radius_mm: float = 6.0


PLANE = Surface(radius_mm=0.0)


def small_rig(*, projector_azimuth_deg: float = -12.0, projector_tilt_deg: float = 22.0) -> Rig:
    """Return the demo rig with cameras of 160 x 128 px, 33 x 27 mm, and the projector moved.

    A period is about 5 camera px. The lenses bend the small images by 0.6 px.
    """
    rig = demo_rig(camera_size=(160, 128))
    assert rig.projector is not None
    cameras = tuple(
        moved(camera, focal_px=[1600.0, 1604.0], distortion=[-2.0, 0.0, sign * 0.01, -0.01])
        for camera, sign in zip(rig.cameras, (1, -1), strict=True)
    )
    pose = _above(projector_tilt_deg, projector_azimuth_deg)
    return replace(rig, cameras=cameras, projector=moved(rig.projector, device_from_world=pose))


def _above(tilt_deg: float, azimuth_deg: float) -> RigidTransform:
    """Return the pose of a device that looks at the origin, its rows along the world's x."""
    tilt, azimuth = np.radians([tilt_deg, azimuth_deg])
    back = np.array([np.sin(tilt) * np.sin(azimuth), -np.sin(tilt) * np.cos(azimuth), np.cos(tilt)])
    right = np.array([1.0, 0.0, 0.0]) + back[0] * -back
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-back, right), -back])
    return RigidTransform(rotation=rotation, translation=[0.0, 0.0, DISTANCE_MM])


def moved(device: Device, **changes: Any) -> Device:
    """Return a device with some of its properties changed."""
    names = (
        "name", "role", "n_rows", "n_cols", "focal_px", "center_px", "distortion",
        "device_from_world",
    )  # fmt: skip
    return Device(**{name: getattr(device, name) for name in names} | changes)


def grid_of(camera: Device) -> Floats:
    """Return the pixel centres (x, y) of a camera, (row, col, 2)."""
    x, y = np.meshgrid(np.arange(camera.n_cols), np.arange(camera.n_rows))
    return np.stack([x, y], axis=-1).astype(np.float64)


def cv_rays(camera: Device, pixels: ArrayLike) -> tuple[Floats, Floats]:
    """Return the projection centre (3,) and unit directions (..., 3) of pixels; world frame."""
    xy = np.asarray(pixels, np.float64)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-12)
    normalised = cv2.undistortPoints(
        xy.reshape(-1, 1, 2), camera.camera_matrix, camera.distortion, criteria=stop
    ).reshape(*xy.shape[:-1], 2)
    rotation, translation = camera.device_from_world.rotation, camera.device_from_world.translation
    directions = np.concatenate([normalised, np.ones((*xy.shape[:-1], 1))], axis=-1) @ rotation
    return -rotation.T @ translation, directions / np.linalg.norm(directions, axis=-1)[..., None]


def cv_project(device: Device, points_mm: ArrayLike) -> Floats:
    """Return the pixels (x, y) of points (..., 3) of the world frame."""
    points = np.asarray(points_mm, np.float64)
    rotation, translation = device.device_from_world.rotation, device.device_from_world.translation
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points.reshape(-1, 1, 3)), cv2.Rodrigues(rotation)[0],
        translation.reshape(3, 1).copy(), device.camera_matrix, device.distortion,
    )  # fmt: skip
    return np.asarray(pixels, np.float64).reshape(*points.shape[:-1], 2)


def seen_points(camera: Device, pixels: ArrayLike, surface: Surface) -> tuple[Floats, Floats, Mask]:
    """Return points (..., 3) and depths along the rays, mm, and which lie on the sphere."""
    origin, directions = cv_rays(camera, pixels)
    depth = (surface.plane_z_mm - origin[2]) / directions[..., 2]
    to_sphere = _to_sphere(origin, directions, surface)
    on_sphere = to_sphere < depth
    depth = np.where(on_sphere, to_sphere, depth)
    return origin + depth[..., None] * directions, depth, on_sphere


def is_seen(device: Device, points_mm: Floats, surface: Surface) -> Mask:
    """Tell whether a device sees points of the surface, the sphere's shadow and border regarded."""
    origin = -device.device_from_world.rotation.T @ device.device_from_world.translation
    away = points_mm - origin
    distance = np.linalg.norm(away, axis=-1)
    free = ~(_to_sphere(origin, away / distance[..., None], surface) < distance - 1e-6)
    pixels = cv_project(device, points_mm)
    inside = (pixels >= -0.5) & (pixels <= np.array([device.n_cols, device.n_rows]) - 0.5)
    return np.asarray(free & inside.all(axis=-1))


def _to_sphere(origin: Floats, directions: Floats, surface: Surface) -> Floats:
    if surface.radius_mm <= 0:
        return np.full(directions.shape[:-1], np.inf)
    to_center = np.asarray(surface.center_mm) - origin
    along = directions @ to_center
    chord2 = surface.radius_mm**2 - (to_center @ to_center - along**2)
    return np.where(chord2 >= 0, along - np.sqrt(np.maximum(chord2, 0)), np.inf)


def true_turns(
    camera: Device,
    projector: Device,
    surface: Surface,
    pixels: ArrayLike,
    *,
    period_px: float = 16.0,
    angle: float = 0.0,
) -> Floats:
    """Return the absolute phase, periods, that lights what a camera sees at pixels (..., 2)."""
    points, _, _ = seen_points(camera, pixels, surface)
    place = cv_project(projector, points)
    w = np.cos(angle) * (place[..., 0] + 0.5) + np.sin(angle) * (place[..., 1] + 0.5)
    return np.asarray(w / period_px)


def phase_map(
    camera: Device,
    projector: Device,
    surface: Surface,
    *,
    n_classes: int | None = None,
    period_px: float = 16.0,
    angle: float = 0.0,
    std: float = 0.01,
    rng: np.random.Generator | None = None,
) -> PhaseMap:
    """Return the exact phases that a camera sees, and every n_classes-th order in one class.

    No n_classes for a full code; with `rng` the phase has noise of `std` rad.
    """
    grid = grid_of(camera)
    points, _, _ = seen_points(camera, grid, surface)
    lit = is_seen(projector, points, surface)
    turns = true_turns(camera, projector, surface, grid, period_px=period_px, angle=angle)
    if rng is not None:
        turns = turns + std / (2 * np.pi) * rng.standard_normal(turns.shape)
    extent = projector.n_cols if abs(np.cos(angle)) > 0.5 else projector.n_rows
    n_orders = int(np.ceil(extent / period_px))
    order = np.floor(turns).astype(np.int32)
    lit &= (order >= 0) & (order < n_orders)
    cycle = n_orders if n_classes is None else n_classes
    return PhaseMap(
        phase=np.where(lit, 2 * np.pi * (turns - order), np.nan),
        order_class=np.where(lit, order % cycle, NO_ORDER),
        class_of_order=np.arange(n_orders, dtype=np.int32) % np.int32(cycle),
        phase_std=np.full(lit.shape, std),
        offset=np.full(lit.shape, 100.0),
        modulation=np.full(lit.shape, 80.0),
        rejection=np.where(lit, 0, np.uint16(Rejection.LOW_MODULATION)).astype(np.uint16),
        period_px=period_px,
        angle=angle,
        device_name=camera.name,
    )
