"""UVC cameras (webcams), which run freely: a trigger takes the first frame that began after it."""

from __future__ import annotations

from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame, Grey
from fringe3d.errors import DeviceError, DeviceLostError, FrameTimeoutError
from fringe3d.io.uvc import VideoSource

OLD_FRAMES = 3
"""Frames that may lie in the driver from before the trigger."""


class UvcCamera:
    """A UVC camera by OpenCV.

    Such cameras have no trigger and no numbers: as it is triggered, what lies in the driver's
    queue is thrown away, and then the next frame is taken.

    Parameters
    ----------
    name : str; in the rig
    place : str; number of the camera
    clock : Clock; of the recorder, on which frames are dated
    """

    def __init__(self, name: str, place: str, /, *, clock: Clock) -> None:
        self.name, self._clock = name, clock
        if not place.isdigit():
            raise DeviceError(f"camera '{name}': expected uvc:NUMBER, found uvc:{place}")
        self._number = int(place)
        self._source: VideoSource | None = None
        self._waiting: list[Frame] = []
        self._count = 0
        self._is_free = False

    def open(self) -> CameraInfo:
        """Connect, and look at a first frame."""
        self._source = VideoSource(self._number)
        if not self._source.is_open:
            self._source = None
            raise DeviceError(
                f"camera '{self.name}': expected a UVC camera {self._number}, found none. fringe3d "
                "devices lists them"
            )
        return CameraInfo(shape=self._read().shape[:2], model=f"UVC {self._number}")

    def close(self) -> None:
        """Let go."""
        if self._source is not None:
            self._source.close()
            self._source = None

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Set exposure and gain, as far as the driver lets."""
        if settings.trigger == "hardware":
            raise DeviceError(f"camera '{self.name}': UVC cameras have no hardware trigger")
        if self._source is not None:
            self._source.expose(settings.exposure_ms, settings.gain_db)
        self._is_free = settings.trigger == "free"
        return settings

    def trigger(self) -> None:
        """Take the next frame that is new."""
        when = self._clock.now()
        for _ in range(OLD_FRAMES):
            self._read()
        self._waiting.append(self._frame(when))

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the frame of the last trigger."""
        if self._is_free:
            return self._frame(self._clock.now())
        if not self._waiting:
            self._clock.sleep(timeout_s)
            raise FrameTimeoutError(f"camera '{self.name}': expected a frame, found none")
        return self._waiting.pop(0)

    def _frame(self, when: float) -> Frame:
        self._count += 1
        return Frame(image=self._read(), number=self._count, time_s=when)

    def _read(self) -> Grey:
        image = self._source.read() if self._source is not None else None
        if image is None:
            raise DeviceLostError(f"camera '{self.name}': expected a frame, found none any more")
        return image
