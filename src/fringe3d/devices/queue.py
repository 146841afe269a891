"""Frames under way: what simulated and replaying cameras have in common."""

from __future__ import annotations

from collections import deque

from fringe3d.devices.protocols import Clock, Frame
from fringe3d.errors import FrameTimeoutError


class FrameQueue:
    """Frames that become ready at known times.

    Parameters
    ----------
    name : str; of the camera
    clock : Clock
    """

    def __init__(self, name: str, clock: Clock, /) -> None:
        self._name, self._clock = name, clock
        self._frames = deque[tuple[float, Frame]]()

    def put(self, frame: Frame, ready_s: float, /) -> None:
        """Add a frame that is ready at a time of the clock."""
        self._frames.append((ready_s, frame))

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame; wait for it if need be, up to `timeout_s`."""
        now = self._clock.now()
        if not self._frames or self._frames[0][0] > now + timeout_s:
            self._clock.sleep(timeout_s)
            raise FrameTimeoutError(
                f"camera '{self._name}': expected a frame within {1000 * timeout_s:.0f} ms, found "
                "none. Check the trigger and the connection"
            )
        ready, frame = self._frames.popleft()
        self._clock.sleep(ready - now)
        return frame

    def clear(self) -> None:
        """Forget all frames."""
        self._frames.clear()
