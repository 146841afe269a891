"""Views of balls on a rotary table in closed form: rays of a pinhole camera meet spheres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import Device, RigidTransform, SurfaceView, TableAxis, TablePosition
from fringe3d.register import surface_view

Floats = NDArray[np.float64]

BALLS = np.array([[9, 0, 0, 6], [-5, 8, 2, 5], [-6, -7, -1, 7], [2, 3, 6, 4]], float)
"""Centre (mm, body frame) and radius of each."""

AXIS = TableAxis(point_mm=[1.5, -2.0, 0.0], direction=[0.03, -0.02, 1.0])


def camera(shape: tuple[int, int] = (96, 128)) -> Device:
    """Return a camera that looks down at the origin, 27 deg beside the vertical, from 300 mm."""
    lean = np.radians(180 - 27)
    cos, sin = np.cos(lean), np.sin(lean)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    return Device(
        name="c1", role="camera", n_rows=shape[0], n_cols=shape[1],
        focal_px=[9.0 * shape[1]] * 2, center_px=[(shape[1] - 1) / 2, (shape[0] - 1) / 2],
        device_from_world=RigidTransform(rotation=rotation, translation=[0, 0, 300]),
    )  # fmt: skip


def rays_of(device: Device) -> Floats:
    """Return unit directions (row, col, 3) in the world frame, without lens distortion."""
    rows, cols = np.mgrid[: device.n_rows, : device.n_cols].astype(float)
    own = np.stack(
        [
            (cols - device.center_px[0]) / device.focal_px[0],
            (rows - device.center_px[1]) / device.focal_px[1],
            np.ones_like(rows),
        ],
        axis=-1,
    )
    own /= np.linalg.norm(own, axis=-1, keepdims=True)
    return np.asarray(own @ device.device_from_world.rotation)


def seen_balls(device: Device, balls: Floats) -> Floats:
    """Return the nearest points of spheres (world frame) on all rays; NaN beside them."""
    directions, origin = rays_of(device), device.center_world
    nearest = np.full(device.shape, np.inf)
    for *center, radius in balls:
        to = np.asarray(center) - origin
        along = directions @ to
        under = along**2 - (to @ to - radius**2)
        with np.errstate(invalid="ignore"):
            depth = np.where(under > 0, along - np.sqrt(under), np.inf)
        nearest = np.minimum(nearest, depth)
    nearest[~np.isfinite(nearest)] = np.nan
    return np.asarray(origin + nearest[..., None] * directions)


def ball_views(
    angles_deg: Sequence[float],
    *,
    sigma_mm: float = 0.0,
    seed: int = 0,
    shape: tuple[int, int] = (96, 128),
    axis: TableAxis = AXIS,
    device: Device | None = None,
) -> tuple[list[SurfaceView], list[RigidTransform]]:
    """Return views of the balls turned by angles, with noise along the rays, and true poses.

    The poses are ``body_from_view``: the body lies as in the first view.
    """
    device = device or camera(shape)
    rng = np.random.default_rng(seed)
    views, poses = [], []
    for angle in np.radians(angles_deg):
        turn = axis.turn(angle)
        balls = np.column_stack([turn.apply(BALLS[:, :3]), BALLS[:, 3]])
        points = seen_balls(device, balls)
        noise = rng.normal(0, 1, device.shape)[..., None] * rays_of(device)
        views.append(surface_view(
            f"{np.degrees(angle):.0f}", device, points + sigma_mm * noise,
            np.full(device.shape, max(sigma_mm, 1e-4)), position=TablePosition(angle=float(angle)),
        ))  # fmt: skip
        poses.append(turn.inverse())
    first = poses[0].inverse()
    return views, [first @ pose for pose in poses]
