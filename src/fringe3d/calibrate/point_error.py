"""How uncertain measured points are because the calibration is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.calibrate._projecting import image_and_slopes, skew
from fringe3d.model import Device, RigCovariance
from fringe3d.model.covariance import DEVICE_NUMBERS

Floats = NDArray[np.float64]


def point_covariance(
    devices: Sequence[Device],
    covariance: RigCovariance,
    points_mm: ArrayLike,
    /,
    *,
    noise_px: Mapping[str, float] | None = None,
) -> Floats:
    """Return the covariance of points that the devices measure together, from the calibration.

    Parameters
    ----------
    devices : sequence of Device, two at least; cameras and projector
    covariance : RigCovariance
    points_mm : (n, 3) float, mm, world frame
    noise_px : mapping of str to float, px, or None (the same for all)
        Noise of a coordinate in each device: it tells how a point is placed between rays that miss
        each other.

    Returns
    -------
    (n, 3, 3) float64, mm^2, axes of the world

    Notes
    -----
    A point X is where ``sum |project_d(X) - pixel_d|^2 / noise_d^2`` is least; so its change is
    ``-(sum A^T A)^-1 sum A^T J`` times that of the devices' numbers. OpenCV's distortion up to k6.
    """
    moved = _moved_by(devices, covariance, points_mm, noise_px)
    return np.asarray(moved @ covariance.matrix @ np.swapaxes(moved, 1, 2))


def form_covariance(
    devices: Sequence[Device],
    covariance: RigCovariance,
    points_mm: ArrayLike,
    /,
    *,
    noise_px: Mapping[str, float] | None = None,
) -> Floats:
    """Return the covariance of points without what a motion and a scale of all of them undo.

    Parameters
    ----------
    devices, covariance, points_mm, noise_px
        As of `point_covariance`; four points at least.

    Returns
    -------
    (n, 3, 3) float64, mm^2, axes of the world
        By how much the form of the points together is wrong, whatever their place and size.
    """
    points = np.asarray(points_mm, np.float64).reshape(-1, 3)
    moved = _moved_by(devices, covariance, points, noise_px).reshape(3 * len(points), -1)
    centred = points - points.mean(axis=0)
    alike = np.concatenate(
        [np.tile(np.eye(3), (len(points), 1, 1)), skew(centred), centred[..., None]], axis=2
    ).reshape(-1, 7)
    axes = np.linalg.qr(alike)[0]
    form = (moved - axes @ (axes.T @ moved)).reshape(len(points), 3, -1)
    return np.asarray(form @ covariance.matrix @ np.swapaxes(form, 1, 2))


def _moved_by(
    devices: Sequence[Device],
    covariance: RigCovariance,
    points_mm: ArrayLike,
    noise_px: Mapping[str, float] | None,
) -> Floats:
    """Return by how much points move with each number of the devices, (n, 3, numbers)."""
    points = np.asarray(points_mm, np.float64).reshape(-1, 3)
    normal = np.zeros((len(points), 3, 3))
    answer = np.zeros((len(points), 3, len(covariance.names)))
    for device in devices:
        lens = np.r_[device.focal_px, device.center_px, device.distortion[:8]]
        seen = device.device_from_world.apply(points)
        _, by_point, by_lens = image_and_slopes(seen, lens)
        by_number = np.concatenate([by_lens, -by_point @ skew(seen), by_point], axis=2)
        weight = 1 / (noise_px[device.name] if noise_px else 1.0)
        by_world = by_point @ device.device_from_world.rotation * weight
        across = np.swapaxes(by_world, 1, 2)
        normal += across @ by_world
        for number, key in enumerate(DEVICE_NUMBERS):
            name = f"{device.name}.{key}"
            if name in covariance.names:
                slope = by_number[:, :, number, None] * weight
                answer[:, :, covariance.names.index(name)] -= (across @ slope)[..., 0]
    return np.asarray(np.linalg.solve(normal, answer))
