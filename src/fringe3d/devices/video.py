"""Videos of phase-shifted images as cameras."""

from __future__ import annotations

from pathlib import Path

from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame
from fringe3d.errors import DeviceError, FrameTimeoutError
from fringe3d.io.uvc import VideoSource


class VideoCamera:
    """A camera that plays a video at its own pace, frame by frame.

    Parameters
    ----------
    name : str; in the rig
    path : Path; anything that OpenCV reads; without loss of quality, or the noise is not the
        camera's
    clock : Clock
    period_s : float, s; from frame to frame
    """

    def __init__(self, name: str, path: Path, /, *, clock: Clock, period_s: float = 0.03) -> None:
        self.name, self._path, self._clock = name, path, clock
        self._period_s, self._began_s = period_s, 0.0
        self._source: VideoSource | None = None
        self._count = 0

    def open(self) -> CameraInfo:
        """Open the file, and look at a first frame."""
        if not self._path.is_file():
            raise DeviceError(f"{self._path}: expected a video, found no such file")
        first = VideoSource(self._path)
        image = first.read()
        first.close()
        if image is None:
            raise DeviceError(
                f"{self._path}: expected a video, found a file that cannot be decoded"
            )
        self._source = VideoSource(self._path)
        return CameraInfo(shape=image.shape, model=f"video {self._path.name}")

    def close(self) -> None:
        """Let go."""
        if self._source is not None:
            self._source.close()
            self._source = None

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Take trigger "free" alone."""
        if settings.trigger != "free":
            raise DeviceError(f"camera '{self.name}': expected trigger free of a video")
        self._began_s, self._count = self._clock.now(), 0
        return settings

    def trigger(self) -> None:
        """Refuse: a video runs freely."""
        raise DeviceError(f"camera '{self.name}': a video cannot be triggered")

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the next frame; none comes at the end."""
        image = self._source.read() if self._source is not None else None
        if image is None:
            raise FrameTimeoutError(
                f"camera '{self.name}': expected a frame within {timeout_s:g} s, found the end of "
                f"{self._path}"
            )
        self._count += 1
        self._clock.sleep(self._began_s + self._count * self._period_s - self._clock.now())
        return Frame(image=image, number=self._count, time_s=self._clock.now())
