"""Moment after moment: from cameras that run freely, or pattern by pattern."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fringe3d.acquire import Devices, shoot
from fringe3d.devices import Camera, Clock
from fringe3d.errors import FrameTimeoutError
from fringe3d.live.window import Moment
from fringe3d.model import PatternPlan
from fringe3d.patterns import pattern_image

TIMEOUT_S = 2.0


def running(cameras: Sequence[Camera], clock: Clock, /) -> Iterator[Moment]:
    """Yield what cameras see that run freely, in step with the projector and with each other.

    The frame with the number 1 shows the first pattern of the plan. A camera that is behind is
    asked again; where a frame was lost, the others' are left, too. Ends where no frame comes any
    more, as at the end of a video.

    Parameters
    ----------
    cameras : sequence of Camera with trigger "free", open
    clock : Clock
    """
    while True:
        try:
            frames = {camera.name: camera.grab(TIMEOUT_S) for camera in cameras}
            newest = max(frame.number for frame in frames.values())
            for camera in cameras:
                while frames[camera.name].number < newest:
                    frames[camera.name] = camera.grab(TIMEOUT_S)
        except FrameTimeoutError:
            return
        if {frame.number for frame in frames.values()} == {newest}:
            images = {name: frame.image for name, frame in frames.items()}
            yield Moment(number=newest - 1, images=images, time_s=clock.now())


def shown(devices: Devices, plan: PatternPlan, /) -> Iterator[Moment]:
    """Show pattern after pattern, round and round, and yield what the cameras see of each.

    A moment of which a frame is missing or not whole is left out.
    """
    shape = devices.projector.open()
    devices.projector.load([pattern_image(pattern, shape) for pattern in plan.patterns])
    last, number = dict.fromkeys(devices.settings, -1), 0
    while True:
        shot = shoot(devices, number % plan.n_images, last)
        last.update({name: frame.number for name, frame in shot.frames.items()})
        if not shot.troubles:
            images = {name: frame.image for name, frame in shot.frames.items()}
            yield Moment(number=number, images=images, time_s=devices.clock.now())
        number += 1
