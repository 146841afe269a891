"""Cameras and projectors with faults on request: what goes wrong on real ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

from fringe3d.devices.protocols import (
    Camera,
    CameraInfo,
    CameraSettings,
    Frame,
    Grey,
    Projector,
)
from fringe3d.errors import DeviceLostError, FrameTimeoutError

FrameFault = Literal["lost-packet", "dropped", "repeated", "again", "late", "held", "disconnected"]
"""What may happen to a frame:

- lost-packet: its lower half is black, and the frame says that it is not complete;
- dropped: it never arrives;
- repeated: the frame before arrives again, with its own number;
- again: the image before arrives again, with a new number and time;
- late: it arrives after the recorder has given up, before the frame of the next trigger;
- held: it arrives after the frame of the next trigger: two frames are exchanged;
- disconnected: from now on nothing answers.
"""


class FaultyCamera:
    """A camera with faults at some of its frames.

    Parameters
    ----------
    camera : Camera
    faults : number of the trigger (from 1) to what happens
    meanwhile : called with the number of each trigger; for a test that interrupts
    """

    def __init__(
        self,
        camera: Camera,
        faults: Mapping[int, FrameFault],
        /,
        *,
        meanwhile: Callable[[int], None] | None = None,
    ) -> None:
        self._camera, self._faults = camera, dict(faults)
        self.name = camera.name
        self._meanwhile = meanwhile
        self._count = 0
        self._last: Frame | None = None
        self._held: list[Frame] = []
        self._late: list[tuple[int, Frame]] = []

    def open(self) -> CameraInfo:
        """Open the camera."""
        return self._camera.open()

    def close(self) -> None:
        """Close the camera."""
        self._camera.close()

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Set the camera."""
        return self._camera.apply(settings)

    def trigger(self) -> None:
        """Trigger the camera."""
        self._count += 1
        if self._meanwhile is not None:
            self._meanwhile(self._count)
        self._require_connected()
        self._camera.trigger()

    def grab(self, timeout_s: float, /) -> Frame:
        """Return a frame, or what the fault makes of it."""
        self._require_connected()
        if self._late and self._late[0][0] < self._count:
            return self._late.pop(0)[1]
        try:
            frame = self._camera.grab(timeout_s)
        except FrameTimeoutError:
            if self._held:
                return self._held.pop(0)
            raise
        return self._with_fault(frame, timeout_s)

    def _with_fault(self, frame: Frame, timeout_s: float) -> Frame:
        fault, last = self._faults.pop(self._count, None), self._last
        self._last = frame
        match fault:
            case "lost-packet":
                image = frame.image.copy()
                image[len(image) // 2 :] = 0
                return replace(frame, image=image, is_complete=False)
            case "dropped":
                return self._camera.grab(timeout_s)
            case "late":
                self._late.append((self._count, frame))
                return self._camera.grab(timeout_s)
            case "held":
                self._held.append(frame)
                return self._camera.grab(timeout_s)
            case "repeated" if last is not None:
                return last
            case "again" if last is not None:
                return replace(frame, image=last.image)
            case _:
                return frame

    def _require_connected(self) -> None:
        gone = [at for at, fault in self._faults.items() if fault == "disconnected"]
        if gone and self._count >= min(gone):
            raise DeviceLostError(
                f"camera '{self.name}': expected an answer, found none since frame {min(gone)}. "
                "Check the cable and the power"
            )


class FaultyProjector:
    """A projector that shows another image at some orders.

    Parameters
    ----------
    projector : Projector
    swaps : number of the order since `load` (from 0) to the image that is shown instead, or None
        for none: the one before stays
    """

    def __init__(self, projector: Projector, swaps: Mapping[int, int | None], /) -> None:
        self._projector, self._swaps = projector, swaps
        self.name, self.triggers_cameras = projector.name, projector.triggers_cameras
        self._count, self._of_many = 0, False

    def open(self) -> tuple[int, int]:
        """Open the projector."""
        return self._projector.open()

    def close(self) -> None:
        """Close the projector."""
        self._projector.close()

    def load(self, images: Sequence[Grey], /) -> None:
        """Load the images; faults are of sequences, not of the two images of a reference."""
        self._count, self._of_many = 0, len(images) > 2
        self._projector.load(images)

    def show(self, index: int, /) -> None:
        """Show the image, or what the fault makes of it."""
        wanted = self._swaps.get(self._count, index) if self._of_many else index
        self._count += 1
        if wanted is not None:
            self._projector.show(wanted)
