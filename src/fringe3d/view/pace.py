"""How fast a browser draws, told by how often its camera moves."""

from __future__ import annotations

from collections import deque

SLOW_S = 0.25
"""Between two frames: what moves more slowly does not follow the hand."""

LONGEST_S = 10.0
"""A longer pause is one of the hand, not of the drawing."""

FRAMES = 2
"""Gaps, one after the other, that must all be long. A browser that draws fast has short ones in
each movement; a hand that pauses has a short one before and after."""


class Pace:
    """Tells from the times of a moving camera whether the browser cannot keep up.

    A browser reports its camera once a frame while it moves.

    Examples
    --------
    >>> pace = Pace()
    >>> [pace.is_slow(at) for at in (0.0, 1.0, 2.1)]
    [False, False, True]
    >>> pace = Pace()
    >>> any(pace.is_slow(at) for at in (0.0, 0.05, 0.1, 1.0, 1.05, 1.1, 2.0, 2.05, 14.0))
    False
    """

    def __init__(self) -> None:
        self._last: float | None = None
        self._gaps: deque[float] = deque(maxlen=FRAMES)

    def is_slow(self, now: float, /) -> bool:
        """Take note of a movement at a time, s; tell whether the last ones came too slowly."""
        if self._last is not None:
            gap = now - self._last
            if gap > LONGEST_S:
                self._gaps.clear()
            else:
                self._gaps.append(gap)
        self._last = now
        return len(self._gaps) == FRAMES and min(self._gaps) > SLOW_S
