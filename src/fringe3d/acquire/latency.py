"""How long a projector takes from the order to the light."""

from __future__ import annotations

import numpy as np

from fringe3d.acquire.checks import Reference, reference_of
from fringe3d.acquire.shooting import Devices, shoot
from fringe3d.errors import DeviceError

LONGEST_S = 1.0
"""No projector takes longer; televisions may take 0.2 s."""

RESOLUTION_S = 0.002
REPEATS = 3
"""An order falls anywhere between two refreshes: the slowest of several counts."""

REACHED = 0.05
"""Part of white that may be missing."""


def measure_latency(devices: Devices, /) -> float:
    """Return the time after which a new image is certain to be there, s.

    Black and white are shown in turn, and the exposure starts ever sooner after the order, by
    bisection, until it begins before the light has changed.

    Parameters
    ----------
    devices : Devices, open; their `wait_s` does not matter

    Raises
    ------
    DeviceError
        If the image has not changed a second after the order.
    """
    shape = devices.projector.open()
    devices.projector.load([np.full(shape, 255, np.uint8), np.zeros(shape, np.uint8)])
    references = _references(devices)
    low, high = 0.0, LONGEST_S
    while high - low > RESOLUTION_S:
        middle = (low + high) / 2
        if all(_has_changed(devices, references, middle) for _ in range(REPEATS)):
            high = middle
        else:
            low = middle
    return high


def _references(devices: Devices) -> dict[str, Reference]:
    last = dict.fromkeys(devices.settings, -1)
    shots = [shoot(devices, index, last, longer_s=LONGEST_S) for index in (0, 1)]
    for shot in shots:
        if shot.troubles:
            raise DeviceError(
                f"latency: expected frames of white and black, found {shot.troubles[0].text}"
            )
    white, black = shots
    return {
        name: reference_of(name, white.frames[name].image, black.frames[name].image, info)
        for name, info in devices.infos.items()
    }


def _has_changed(devices: Devices, references: dict[str, Reference], wait_s: float) -> bool:
    """Tell whether the light has changed from black to white, and back, after a time."""
    last = dict.fromkeys(devices.settings, -1)
    done = True
    for index, level in ((0, 1.0), (1, 0.0)):
        shot = shoot(devices, index, last, longer_s=wait_s - devices.wait_s)
        for name, frame in shot.frames.items():
            part = float(np.median(references[name].part_of(frame.image)))
            done &= abs(part - level) < REACHED
        done &= not shot.troubles
        devices.clock.sleep(LONGEST_S / 2)
    return done
