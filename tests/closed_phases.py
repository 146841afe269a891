"""Phase maps of a sphere before a plane, in closed form on OpenCV's lens model: no images."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from closed_form import above_table, demo_rig, sphere_distance
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import Task, TwoViews, choose_orders, coarse_stride
from fringe3d.correspond.chosen import ChosenOrders
from fringe3d.model import (
    NO_ORDER,
    Device,
    MeasuringVolume,
    PhaseMap,
    Rejection,
    Rig,
)

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
    pose = above_table(projector_tilt_deg, projector_azimuth_deg)
    return replace(rig, cameras=cameras, projector=moved(rig.projector, device_from_world=pose))


def moved(device: Device, **changes: Any) -> Device:
    """Return a device with some of its properties changed; lists will do for arrays."""
    return replace(device, **changes)


def grid_of(camera: Device) -> Floats:
    """Return the pixel centres (x, y) of a camera, (row, col, 2)."""
    x, y = np.meshgrid(np.arange(camera.n_cols), np.arange(camera.n_rows))
    return np.stack([x, y], axis=-1).astype(np.float64)


def seen_points(camera: Device, pixels: ArrayLike, surface: Surface) -> tuple[Floats, Floats, Mask]:
    """Return points (..., 3) and depths along the rays, mm, and which lie on the sphere."""
    origin, directions = cv_rays(camera, pixels)
    depth = (surface.plane_z_mm - origin[2]) / directions[..., 2]
    to_sphere = sphere_distance(origin, directions, surface.center_mm, surface.radius_mm)
    on_sphere = to_sphere < depth
    depth = np.where(on_sphere, to_sphere, depth)
    return origin + depth[..., None] * directions, depth, on_sphere


def is_seen(device: Device, points_mm: Floats, surface: Surface) -> Mask:
    """Tell whether a device sees points of the surface, the sphere's shadow and border regarded."""
    origin = -device.device_from_world.rotation.T @ device.device_from_world.translation
    away = points_mm - origin
    distance = np.linalg.norm(away, axis=-1)
    toward = away / distance[..., None]
    free = ~(
        sphere_distance(origin, toward, surface.center_mm, surface.radius_mm) < distance - 1e-6
    )
    pixels = cv_project(device, points_mm)
    inside = (pixels >= -0.5) & (pixels <= np.array([device.n_cols, device.n_rows]) - 0.5)
    return np.asarray(free & inside.all(axis=-1))


@cache
def visible(rig: Rig, surface: Surface, margin_px: float = 3.0) -> Mask:
    """Tell which pixels of C1 are lit and seen by C2, away from its border and the silhouettes."""
    c1, c2 = rig.cameras
    assert rig.projector is not None
    points, _, _ = seen_points(c1, grid_of(c1), surface)
    seen = is_seen(rig.projector, points, surface) & is_seen(c2, points, surface)
    place = cv_project(c2, points)
    good = ((place > margin_px) & (place < np.array([c2.n_cols, c2.n_rows]) - 1 - margin_px)).all(
        axis=-1
    )
    if surface.radius_mm > 0:
        for shift in itertools.product((-margin_px, 0, margin_px), repeat=2):
            for camera, xy in ((c1, grid_of(c1)), (c2, place)):
                around, _, on_sphere = seen_points(camera, xy + np.array(shift), surface)
                good &= on_sphere == seen_points(c1, grid_of(c1), surface)[2]
                good &= is_seen(rig.projector, around, surface)
    return np.asarray(seen & good)


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


def choose(
    rig: Rig, views: TwoViews, volume: MeasuringVolume | None = None, **how: Any
) -> ChosenOrders:
    """Choose orders with the rig's projector, in its volume or another."""
    assert rig.projector is not None
    assert rig.volume is not None
    return choose_orders(views, rig.projector, volume or rig.volume, **how)


def task_of(rig: Rig, views: TwoViews, stride: tuple[int, int] | None = None) -> Task:
    """Return the candidates of the pixels, or of those of a coarse grid, decided together."""
    assert rig.projector is not None
    assert rig.volume is not None
    stride = coarse_stride(views.phases1.phase) if stride is None else stride
    return Task(views, rig.projector, rig.volume, 36.0, together=True, stride=stride)


def turns_off(rig: Rig, views: TwoViews, surface: Surface, order: NDArray[np.int32]) -> Floats:
    """Return how many periods orders are off; a noisy phase near its wrap is no error."""
    assert rig.projector is not None
    turns = true_turns(rig.cameras[0], rig.projector, surface, grid_of(rig.cameras[0]))
    own = views.phases1.phase / (2 * np.pi)
    return np.where(order == NO_ORDER, np.nan, np.rint(order + own - turns))
