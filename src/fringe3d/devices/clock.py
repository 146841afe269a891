"""Clocks: the computer's, and one that runs as fast as a simulation wants."""

from __future__ import annotations

import time


class SystemClock:
    """The computer's clock."""

    def now(self) -> float:
        """Return the time since some moment, s."""
        return time.monotonic()

    def sleep(self, seconds: float, /) -> None:
        """Wait."""
        time.sleep(max(seconds, 0.0))


class VirtualClock:
    """A clock that moves only as somebody waits: recordings in no time.

    Examples
    --------
    >>> clock = VirtualClock()
    >>> clock.sleep(3600)
    >>> clock.now()
    3600.0
    """

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the time that was waited for, s."""
        return self._now

    def sleep(self, seconds: float, /) -> None:
        """Move the clock on."""
        self._now += max(seconds, 0.0)
