"""The exposure that a scene needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringe3d.acquire.shooting import Devices, Shot, shoot
from fringe3d.devices import CameraInfo, CameraSettings, Grey
from fringe3d.errors import DeviceError

TARGET, NEAR_TARGET = 0.85, 0.05
"""Part of the range that the brightest lit pixels shall reach, and how nearly."""

BRIGHT_PERCENTILE = 99.0
"""Of the lit pixels: a glossy spot may be brighter."""

MOST_ROUNDS = 12
MIN_MS, MAX_MS = 0.02, 500.0
MOST_FACTOR = 4.0
"""By which one round may change an exposure."""

LIT_DN_OF_RANGE = 0.02


def with_best_exposure(devices: Devices, /) -> Devices:
    """Expose so that white is bright and not saturated, in each camera on its own.

    Parameters
    ----------
    devices : Devices, open

    Returns
    -------
    Devices, with other settings

    Raises
    ------
    DeviceError
        If a camera sees no light of the projector at any exposure, or is too bright at the
        shortest one.
    """
    shape = devices.projector.open()
    devices.projector.load([np.full(shape, 255, np.uint8), np.zeros(shape, np.uint8)])
    for _ in range(MOST_ROUNDS):
        white, black = (_taken(devices, index) for index in (0, 1))
        wanted = {
            camera.name: _better(
                camera.name,
                devices.settings[camera.name],
                devices.infos[camera.name],
                white.frames[camera.name].image,
                black.frames[camera.name].image,
            )
            for camera in devices.cameras
        }
        if wanted == devices.settings:
            return devices
        devices = replace(
            devices,
            settings={camera.name: camera.apply(wanted[camera.name]) for camera in devices.cameras},
        )
    return devices


def _taken(devices: Devices, index: int) -> Shot:
    last = dict.fromkeys(devices.settings, -1)
    for _ in range(3):
        shot = shoot(devices, index, last)
        if not shot.troubles:
            return shot
    raise DeviceError(
        f"exposure: expected frames, found none that is whole: {shot.troubles[0].text}"
    )


def _better(
    name: str, settings: CameraSettings, info: CameraInfo, white: Grey, black: Grey
) -> CameraSettings:
    """Return a better exposure; the same where it is good enough, or as good as can be."""
    top, whole = info.saturation_dn, info.saturation_dn - info.black_level_dn
    gain = white.astype(np.float32) - black
    lit = (gain > LIT_DN_OF_RANGE * whole) | (white >= top)
    if not lit.any():
        factor = MOST_FACTOR
    else:
        bright = float(np.percentile(white[lit], BRIGHT_PERCENTILE))
        part = (bright - info.black_level_dn) / whole
        if abs(part - TARGET) < NEAR_TARGET:
            return settings
        is_saturated = bright >= top
        factor = 1 / MOST_FACTOR if is_saturated else min(TARGET / part, MOST_FACTOR)
    exposure_ms = min(max(settings.exposure_ms * factor, MIN_MS), MAX_MS)
    if exposure_ms == settings.exposure_ms and (not lit.any() or factor < 1):
        what = "too bright" if lit.any() else "without light of the projector"
        raise DeviceError(
            f"camera '{name}': expected an exposure of {MIN_MS:g} to {MAX_MS:g} ms that suits the "
            f"scene, found images {what} at {exposure_ms:g} ms. Change the aperture, the gain "
            "(--gain-db) or the projector's brightness"
        )
    return replace(settings, exposure_ms=exposure_ms)
