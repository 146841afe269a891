"""What C1 sees and another device does not: the measured surface itself stands before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _occlusion
from fringe3d.geometry import grid_rays
from fringe3d.kernels import over_rows
from fringe3d.model import Device

Floats = NDArray[np.float64]

JOINED = 10.0
"""Neighbouring pixels belong to one surface up to ten times their distance on a surface that faces
C1: slopes up to 84 degrees."""

BEHIND_SIGMA = 4.0
"""Standard deviations by which a point must lie behind a surface that is as uncertain."""

SAMPLE = 8
"""Every eighth pixel of both directions tells how far apart neighbours are."""

PAIRS_KEPT = 4
"""Devices and cameras whose epipolar lines are kept, 8 bytes a pixel."""

STEEPEST = 5.0
"""Slope, 79 degrees, by which a point's own surface may come nearer within the margin."""


def hidden_from(
    devices: Sequence[Device],
    camera1: Device,
    depths_mm: Floats,
    noise_mm: Floats,
    /,
    *,
    margin_px: float = 0.0,
) -> NDArray[np.bool_]:
    """Tell which points of a measured surface one of the devices cannot see, or not light.

    Along each epipolar line the surface is entered into a buffer of the distances that a device
    sees first. What lies behind, and what faces away from it, is hidden. Next to the
    border of what a camera sees a pixel of its image holds light of both sides, and phases are
    found for hidden points, too: their place is about right, but no one has seen it.

    Parameters
    ----------
    devices : sequence of Device; cameras and projectors
    camera1 : Device; at another place than any of them
    depths_mm : (row, col) float, mm; along the viewing rays of C1; NaN where there is no surface
    noise_mm : (row, col) float, mm; their standard deviation
    margin_px : float, px of the devices; if positive, what has something before it within so much
        is hidden, too, and so is a surface steeper than five to one

    Returns
    -------
    (row, col) bool

    Notes
    -----
    Only differences between neighbours count, so an error of the calibration, which is smooth,
    does not matter. C1 must see the surface that hides: what is hidden from both stays unknown.
    """
    if min(depths_mm.shape) < 2 or not np.isfinite(depths_mm).any():
        return np.zeros(depths_mm.shape, bool)
    noise = BEHIND_SIGMA * np.sqrt(2) * noise_mm
    hidden = np.zeros(depths_mm.shape, bool)
    for device in devices:
        lines = _Lines(device, camera1, depths_mm)
        hidden |= lines.behind_mm(0.0) > noise
        if margin_px > 0:
            hidden |= lines.behind_mm(margin_px) > noise + margin_px * STEEPEST * lines.pitch_mm
    return np.asarray(hidden)


class _Lines:
    """A surface on the epipolar lines of C1 and a device; places and distances in single precision,
    a thousandth of a pixel and of the noise."""

    def __init__(self, device: Device, camera1: Device, depths_mm: Floats) -> None:
        self._turned, self._number, self._n_lines = _numbered_lines(device, camera1)
        place, distance = np.empty((2, *depths_mm.shape), np.float32)
        to_c1, focal = camera1.center_world - device.center_world, float(device.focal_px.mean())
        _, directions = grid_rays(camera1)
        over_rows(_occlusion.write_sights, len(place), directions, depths_mm, to_c1,
                  _baseline(device, camera1), focal, place, distance)  # fmt: skip
        self.pitch_mm = distance / focal
        self._place, self._distance = (
            np.ascontiguousarray(self._turned(image)) for image in (place, distance)
        )
        self._ends = float(np.nanmin(place)), float(np.nanmax(place))
        known = depths_mm[np.isfinite(depths_mm)][::SAMPLE]
        self._join_mm = JOINED * float(np.median(known) / camera1.focal_px.mean())

    def behind_mm(self, margin_px: float) -> NDArray[np.float32]:
        """Return how far each point lies behind what the device sees there, (row, col)."""
        behind = np.empty((self._n_lines, self._number.shape[1]), np.float32)
        over_rows(_occlusion.find_behind, len(behind), self._number, self._place, self._distance,
                  self._ends, self._join_mm, margin_px, behind)  # fmt: skip
        found = np.empty(self._number.shape, np.float32)
        over_rows(_occlusion.look_up, len(found), self._number, behind, found)
        image = np.empty(self.pitch_mm.shape, np.float32)
        self._turned(image)[:] = found
        return image


@lru_cache(maxsize=PAIRS_KEPT)
def _numbered_lines(
    device: Device, camera1: Device
) -> tuple[Callable[[Floats], Floats], Floats, int]:
    """Return a view of images in which the number of the epipolar line rises with the row and the
    ray's angle with the baseline with the column, that number, (row, col), and how many there are.
    """
    line, angle = _epipolar_angles(device, camera1, grid_rays(camera1)[1])
    turned = _orientation(line, angle)
    number = turned(line)
    number = (number - np.nanmin(number)) / _median_step(number, 0)
    return turned, np.ascontiguousarray(number), int(np.nanmax(number)) + 2


def _baseline(device: Device, camera1: Device) -> Floats:
    way = device.center_world - camera1.center_world
    return np.asarray(way / np.linalg.norm(way))


def _epipolar_angles(device: Device, camera1: Device, directions: Floats) -> tuple[Floats, Floats]:
    """Return the angle of each ray's epipolar plane about the baseline, and of the ray with it."""
    baseline = _baseline(device, camera1)
    forward = camera1.device_from_world.rotation[2]
    forward = forward - (forward @ baseline) * baseline
    forward /= np.linalg.norm(forward)
    line = np.arctan2(directions @ np.cross(baseline, forward), directions @ forward)
    return line, np.arccos(directions @ baseline)


def _orientation(line: Floats, angle: Floats) -> Callable[[Floats], Floats]:
    """Return a view of images in which `line` rises with the row and `angle` with the column."""
    swap = abs(_median_step(line, 1)) > abs(_median_step(line, 0))
    down, right = (
        int(np.sign(_median_step(image.T if swap else image, axis)) or 1)
        for axis, image in enumerate((line, angle))
    )
    return lambda image: (image.T if swap else image)[::down, ::right]


def _median_step(image: Floats, axis: int) -> float:
    return float(np.nanmedian(np.diff(image, axis=axis)[::SAMPLE, ::SAMPLE]))
