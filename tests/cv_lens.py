"""Projection and viewing rays by OpenCV: the oracle of everything that goes through a lens."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model import Device

Floats = NDArray[np.float64]


def cv_project(device: Device, points_mm: ArrayLike) -> Floats:
    """Return the pixels (x, y) of points (..., 3) of the world frame."""
    points = np.asarray(points_mm, np.float64)
    pose = device.device_from_world
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points.reshape(-1, 1, 3)), cv2.Rodrigues(pose.rotation)[0],
        pose.translation.reshape(3, 1).copy(), device.camera_matrix, device.distortion,
    )  # fmt: skip
    return np.asarray(pixels, np.float64).reshape(*points.shape[:-1], 2)


def cv_rays(camera: Device, pixels: ArrayLike) -> tuple[Floats, Floats]:
    """Return the projection centre (3,) and unit directions (..., 3) of pixels; world frame."""
    xy = np.asarray(pixels, np.float64)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-13)
    flat = np.ascontiguousarray(xy.reshape(-1, 1, 2))
    lens = (camera.camera_matrix, camera.distortion)
    before_5: Any = getattr(cv2, "undistortPointsIter", None)
    found = (
        before_5(flat, *lens, None, None, stop)
        if before_5 is not None
        else cv2.undistortPoints(flat, *lens, criteria=stop)
    )
    normalised = found.reshape(*xy.shape[:-1], 2)
    pose = camera.device_from_world
    directions = np.concatenate([normalised, np.ones((*xy.shape[:-1], 1))], axis=-1) @ pose.rotation
    lengths = np.linalg.norm(directions, axis=-1)[..., None]
    return -pose.rotation.T @ pose.translation, directions / lengths


def cv_points_at(camera: Device, pixels: ArrayLike, z_mm: float) -> Floats:
    """Return the points (..., 3) that a camera sees in pixels on the plane z = z_mm."""
    origin, directions = cv_rays(camera, pixels)
    depths = (z_mm - origin[2]) / directions[..., 2]
    return np.asarray(origin + depths[..., None] * directions)
