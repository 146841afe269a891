"""Cameras that replay a recording, with its timing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringe3d.devices.clock import SystemClock
from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame, Grey
from fringe3d.devices.queue import FrameQueue
from fringe3d.errors import DeviceError
from fringe3d.model import ImageStack, Scan

READOUT_S = 0.002


class FileCamera:
    """A camera that shows recorded images again.

    With trigger "software" each trigger gives the image of the pattern that the `FileProjector`
    shows, or the next one where there is none. With "free" frames come by themselves, one each
    `period_s`, round and round; those that nobody grabs in time are dropped, as a camera would.

    Parameters
    ----------
    stack : ImageStack
    clock : Clock or None (the computer's)
    period_s : float, s; from frame to frame
    projector : FileProjector or None
    """

    def __init__(
        self,
        stack: ImageStack,
        /,
        *,
        clock: Clock | None = None,
        period_s: float = 0.03,
        projector: FileProjector | None = None,
    ) -> None:
        self.name, self._stack = stack.device_name, stack
        self._clock: Clock = clock or SystemClock()
        self._period_s, self._projector = period_s, projector
        self._settings = CameraSettings()
        self._queue = FrameQueue(self.name, self._clock)
        self._count, self._began_s = 0, 0.0

    def open(self) -> CameraInfo:
        """Return what the camera is."""
        bits = int(np.ceil(np.log2(self._stack.saturation_dn + 1)))
        return CameraInfo(
            shape=self._stack.shape,
            bit_depth=bits,
            black_level_dn=self._stack.black_level_dn,
            noise=self._stack.noise,
            model="replayed",
        )

    def close(self) -> None:
        """Forget the frames that were not grabbed."""
        self._queue.clear()

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Choose the trigger; what was recorded cannot be exposed in another way."""
        self._settings, self._began_s, self._count = settings, self._clock.now(), 0
        return settings

    def trigger(self) -> None:
        """Take the image of the pattern that is shown."""
        if self._settings.trigger != "software":
            raise DeviceError(f"camera '{self.name}': expected trigger software, found a trigger")
        now = self._clock.now()
        frame = Frame(image=self._image(), number=self._count + 1, time_s=now)
        self._count += 1
        self._queue.put(frame, now + self._settings.exposure_s + READOUT_S)

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame; of a free camera the newest one."""
        if self._settings.trigger == "free":
            self._run(timeout_s)
        return self._queue.grab(timeout_s)

    def _image(self) -> Grey:
        images = self._stack.images
        if self._projector is None:
            return np.asarray(images[self._count % len(images)])
        return self._projector.image_of(self._stack)

    def _run(self, timeout_s: float) -> None:
        """Let the frames pass that came since the last one, and wait for the next."""
        self._queue.clear()
        past = int((self._clock.now() - self._began_s) / self._period_s)
        number = max(self._count + 1, past)
        start = self._began_s + (number - 1) * self._period_s
        if start + self._period_s > self._clock.now() + timeout_s:
            return
        self._count = number
        image = self._stack.images[(number - 1) % len(self._stack.images)]
        frame = Frame(image=image, number=number, time_s=start)
        self._queue.put(frame, start + self._period_s)


class FileProjector:
    """The projector of a recording: it tells the file cameras which image to show.

    A uniform image that is not in the recording, as white for a reference, is answered with the
    brightest or the darkest value of each pixel.

    Parameters
    ----------
    shape : (n_rows, n_cols); of the projector
    """

    name, triggers_cameras = "projector", False

    def __init__(self, shape: tuple[int, int], /) -> None:
        self._shape = shape
        self._images: Sequence[Grey] = ()
        self._index = 0

    def open(self) -> tuple[int, int]:
        """Return (n_rows, n_cols)."""
        return self._shape

    def close(self) -> None:
        """Do nothing."""

    def load(self, images: Sequence[Grey], /) -> None:
        """Note which images are meant."""
        self._images, self._index = tuple(images), 0

    def show(self, index: int, /) -> None:
        """Note which one is shown."""
        self._index = index

    def image_of(self, stack: ImageStack, /) -> Grey:
        """Return what a camera saw of the image that is shown."""
        if len(self._images) == len(stack.images):
            return np.asarray(stack.images[self._index])
        is_bright = bool(self._images[self._index].mean() > 127)
        return np.asarray(stack.images.max(axis=0) if is_bright else stack.images.min(axis=0))


def replayed(
    scan: Scan, /, *, clock: Clock | None = None, period_s: float = 0.03
) -> tuple[tuple[FileCamera, ...], FileProjector]:
    """Return the cameras and the projector of a recording, to record it again.

    Parameters
    ----------
    scan : Scan
    clock : Clock or None (the computer's)
    period_s : float, s; from frame to frame of free cameras

    Raises
    ------
    DeviceError
        If the scan says nothing of the projector's size.
    """
    shape = scan.stacks[0].plan.projector_shape
    if shape is None:
        raise DeviceError(
            "replay: expected a recording that names the projector's size, found none. Add "
            "projector_size to its scan.toml"
        )
    projector = FileProjector(shape)
    cameras = tuple(
        FileCamera(stack, clock=clock, period_s=period_s, projector=projector)
        for stack in scan.stacks
    )
    return cameras, projector
