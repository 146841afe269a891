"""How many points a browser can draw while its camera moves, told by how often it moves."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import median

LEAST = 2**12
"""Points of the coarsest level: they add little to the time of a page without a graphics card."""

FACTOR = 2
"""Each level has so many times the points of the one before."""

FIRST = 2**14
"""At most so many move at first, before it is known how fast the browser is."""

SLOW_S, FAST_S = 0.075, 0.035
"""Between two frames: above the first fewer points move, below the second more. They are more than
`FACTOR` apart, so that the level does not swing."""

REST_S = 0.3
"""A camera that rests so long is shown more points."""

GAPS = 3
"""The level changes when the middle one of so many gaps says so."""

LATE = 2
"""Frames that are on their way when the level changes, and still show the one before."""

PAGE_S = 0.05
"""For the page itself, without a graphics card; what more a frame takes is for its points."""

SLOW_POINT_S, SLOWEST_POINT_S = 2e-6, 4e-6
"""To draw a point without a graphics card: what a browser is taken to need until it has moved, and
at most; few points tell badly what many would take."""

STILL_S = 0.6
"""A frame at rest may take so long. The first one of a movement has to wait for the one before, and
the view library draws one each second even at rest: longer ones would leave no time to begin."""

REFINED = 4
"""After a rest the points become so many times more at once, until all are shown, or as many as
the browser can draw within `STILL_S`."""


def levels_of(n_points: int, /) -> list[int]:
    """Return how many points each level shows, the coarsest first.

    Examples
    --------
    >>> levels_of(100_000)
    [4096, 8192, 16384, 32768, 65536, 100000]
    >>> levels_of(10)
    [10]
    """
    levels, n = [], LEAST
    while n < n_points:
        levels.append(n)
        n *= FACTOR
    return [*levels, n_points]


class Detail:
    """Decides how many points one browser draws: few while its camera moves, more when it rests.

    A browser reports its camera once a frame while it moves, so the gaps between the reports are
    the time that a frame takes. It reports nothing at rest.

    Parameters
    ----------
    levels : ints, rising; points of each level, see `levels_of`

    Attributes
    ----------
    level : int; the number of the level to draw now
    is_everything : bool; draw all points at rest, however long that takes

    Examples
    --------
    A browser that takes 0.2 s for each frame is given less; when it rests, more:

    >>> detail = Detail(levels_of(1_000_000))
    >>> for frame in range(20):
    ...     detail.moved(0.2 * frame)
    >>> detail.level
    0
    >>> for _ in range(3):
    ...     detail.rested(9.0)
    >>> levels_of(1_000_000)[detail.level]
    131072
    """

    def __init__(self, levels: Sequence[int], /) -> None:
        self._levels = tuple(levels)
        self._most = len(levels) - 1
        fitting = [i for i, n in enumerate(levels) if n <= FIRST]
        self._moving = max(fitting, default=0)
        self._point_s = SLOW_POINT_S
        self._gaps: deque[float] = deque(maxlen=GAPS)
        self._late = 0
        self._last: float | None = None
        self._drawn = 0.0
        self.is_everything = False
        self.level = self.resting

    @property
    def resting(self) -> int:
        """Return the level that is drawn at rest."""
        if self.is_everything:
            return self._most
        fitting = [i for i in range(self._most + 1) if self._cost_s(i) <= STILL_S]
        return max(self._moving, *fitting, 0)

    def moved(self, now: float, /) -> None:
        """Take note that the camera moved, at a time in s."""
        gap = None if self._last is None else now - self._last
        self._last = now
        if self.level != self._moving:
            # What is drawn now shows more; it may take long, and nothing is heard meanwhile.
            self._drawn = max(self._drawn, now) + LATE * self._cost_s(self.level)
            self._to(self._moving)
        elif gap is not None and self._late > 0:
            self._late -= 1
        elif gap is not None and gap < REST_S + self._cost_s(self.level):
            self._gaps.append(gap)
        if len(self._gaps) == GAPS:
            self._adapt(now)

    def rested(self, now: float, /) -> None:
        """Take note that nothing was heard for `wait_s`: draw more points."""
        if self.level >= self.resting:
            return
        wanted = REFINED * self._levels[self.level]
        fitting = [i for i, n in enumerate(self._levels) if n <= wanted]
        self.level = min(self.resting, max(self.level + 1, *fitting))
        self._drawn = now + self._cost_s(self.level)
        self._gaps.clear()
        self._last = None

    def wait_s(self, now: float, /) -> float:
        """Return after how many seconds of silence the camera rests."""
        frame = self._cost_s(self.level)
        if self._last is None:  # it rests already, and becomes finer
            return max(0.0, self._drawn - now)
        return max(0.0, self._drawn - now) + REST_S + frame

    def _adapt(self, now: float) -> None:
        typical = median(self._gaps)
        wanted = (typical - PAGE_S) / self._levels[self.level]
        self._point_s = min(max(wanted, 0.0), SLOWEST_POINT_S)
        self._drawn = now  # frames flow
        if typical > SLOW_S and self._moving > 0:
            self._moving -= 1
        elif typical < FAST_S and self._moving < self._most:
            self._moving += 1
        else:
            return
        self._to(self._moving)

    def _to(self, level: int) -> None:
        self.level = level
        self._late = LATE
        self._gaps.clear()

    def _cost_s(self, level: int) -> float:
        return PAGE_S + self._point_s * self._levels[level]
