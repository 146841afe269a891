"""Record, measure and show at once; what nobody has time for is dropped and counted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from fringe3d.decode import stilled
from fringe3d.decoding import Decoded
from fringe3d.devices import Clock
from fringe3d.errors import Fringe3DError
from fringe3d.live.window import Moment, SlidingWindow
from fringe3d.model import ImageStack
from fringe3d.pipeline import Measurement
from fringe3d.session import Session

WAITING = 2
"""Sequences that may wait to be measured; the oldest is dropped for a newer one."""

KEPT_TIMES = 200
"""Of the newest clouds, of which the latency is told."""

IDLE_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """How a live measurement does.

    Parameters
    ----------
    moments : int; images of each camera that came
    lost : int; that did not come, by their numbers
    clouds : int; that were measured
    dropped : int; whole sequences that were not measured, for newer ones were there
    failed : int; that gave no cloud
    latency_ms : float, ms; from the newest image to its cloud, median of the newest clouds
    clouds_per_s : float; since the first cloud, which may have had to wait for the compiler
    """

    moments: int
    lost: int
    clouds: int
    dropped: int
    failed: int
    latency_ms: float
    clouds_per_s: float

    def __str__(self) -> str:
        return (
            f"{self.clouds} clouds ({self.clouds_per_s:.1f}/s) of {self.moments} images, latency "
            f"{self.latency_ms:.0f} ms; {self.dropped} sequences dropped, {self.lost} images lost, "
            f"{self.failed} without a cloud"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Job:
    ordered: tuple[Moment, ...]
    newest: Moment


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ready:
    job: _Job
    stacks: tuple[ImageStack, ...]
    shown: Decoded | None


Show = Callable[[Measurement | None, tuple[ImageStack, ...], Figures], None]


@dataclass(frozen=True, slots=True)
class Steps:
    """What is done with a sequence, the first while the one before is in the second.

    Parameters
    ----------
    decode : function of the stacks and the times of their images
    measure : function of what was decoded, and of the measurement before (or None)
    """

    decode: Callable[[tuple[ImageStack, ...], tuple[int, ...]], Decoded]
    measure: Callable[[Decoded, Measurement | None], Measurement]


class Live:
    """Images in, clouds out: one thread listens to the cameras, one decodes the newest sequence
    while the caller's measures and shows the one before.

    Parameters
    ----------
    moments : iterable of Moment; listened to in a thread of its own
    window : SlidingWindow; with each new image there is a sequence to measure
    steps : Steps
    clock : Clock
    """

    def __init__(
        self, moments: Iterable[Moment], window: SlidingWindow, steps: Steps, clock: Clock, /
    ) -> None:
        self._moments, self._window, self._steps = moments, window, steps
        self._clock = clock
        self._waiting = deque[_Job](maxlen=WAITING)
        self._news = threading.Condition()
        self._stop, self._is_over = threading.Event(), False
        self._problem: BaseException | None = None
        self._first_s = clock.now()
        self._count = dict.fromkeys(("moments", "lost", "clouds", "dropped", "failed"), 0)
        self._latencies = deque[float](maxlen=KEPT_TIMES)

    @property
    def figures(self) -> Figures:
        """Return how it does."""
        passed = max(self._clock.now() - self._first_s, 1e-9)
        latency = float(np.median(self._latencies)) if self._latencies else float("nan")
        return Figures(
            **self._count,
            latency_ms=1000 * latency,
            clouds_per_s=max(self._count["clouds"] - 1, 0) / passed,
        )

    def stop(self) -> None:
        """Let `run` end after the cloud that is being measured."""
        self._stop.set()

    def run(self, show: Show, /, *, most_clouds: int | None = None) -> Figures:
        """Measure and show until the images end, `stop` is called, or there are enough clouds.

        Parameters
        ----------
        show : called with each measurement (None where it failed), its images and the figures
        most_clouds : int or None (no end)

        Raises
        ------
        Fringe3DError
            If the cameras fail.
        """
        listener = threading.Thread(target=self._listen, daemon=True)
        listener.start()
        before: Measurement | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="decoding") as pool:
            try:
                ahead = pool.submit(self._decode_newest)
                while (ready := ahead.result()) is not None:
                    ahead = pool.submit(self._decode_newest)
                    result = self._measured(ready, before)
                    before = result or before
                    show(result, ready.stacks, self.figures)
                    if most_clouds is not None and self._count["clouds"] >= most_clouds:
                        break
            finally:
                self._stop.set()
        listener.join(timeout=5.0)
        if self._problem is not None:
            raise self._problem
        return self.figures

    def _listen(self) -> None:
        last = None
        try:
            for moment in self._moments:
                if self._stop.is_set():
                    return
                self._count["moments"] += 1
                if last is not None:
                    self._count["lost"] += moment.number - last - 1
                last = moment.number
                ordered = self._window.add(moment)
                if ordered:
                    self._offer(_Job(ordered=ordered, newest=moment))
        except Fringe3DError as problem:
            self._problem = problem
        finally:
            with self._news:
                self._is_over = True
                self._news.notify()

    def _offer(self, job: _Job) -> None:
        with self._news:
            if len(self._waiting) == WAITING:
                self._count["dropped"] += 1
            self._waiting.append(job)
            self._news.notify()

    def _decode_newest(self) -> _Ready | None:
        """Wait for a sequence, and decode it; None where there will be no more."""
        job, decoded = self._next_job(), None
        if job is None:
            return None
        stacks = self._window.stacks(job.ordered)
        times = tuple(moment.number for moment in job.ordered)
        with self._counting_failures():
            decoded = self._steps.decode(stacks, times)
        return _Ready(job=job, stacks=stacks, shown=decoded)

    def _next_job(self) -> _Job | None:
        """Return the newest sequence; older ones that wait are dropped."""
        with self._news:
            while not self._waiting and not self._is_over and not self._stop.is_set():
                self._news.wait(IDLE_S)
            if self._stop.is_set() or not self._waiting:
                return None
            job = self._waiting.pop()
            self._count["dropped"] += len(self._waiting)
            self._waiting.clear()
        return job

    @contextmanager
    def _counting_failures(self) -> Iterator[None]:
        """Count a sequence that gives no cloud; a hand before the lens is no reason to end."""
        try:
            yield
        except Fringe3DError:
            self._count["failed"] += 1

    def _measured(self, ready: _Ready, before: Measurement | None) -> Measurement | None:
        result = None
        with self._counting_failures():
            if ready.shown is not None:
                result = self._steps.measure(ready.shown, before)
        if result is None:
            return None
        if not self._count["clouds"]:
            self._first_s = self._clock.now()
        self._count["clouds"] += 1
        self._latencies.append(self._clock.now() - ready.job.newest.time_s)
        return result


def measuring(
    session: Session,
    clock: Clock,
    /,
    *,
    uses_previous: bool = False,
    still: bool = False,
    renewing: float = 1.0,
) -> Steps:
    """Return how a session measures a stream.

    Parameters
    ----------
    session : Session
    clock : Clock
    uses_previous : bool; the cloud before is evidence (M6)
    still : bool; the motion between the images is taken out first
    renewing : float, 0 to 1; part of the time in which the fringe orders are found anew; else they
        go on from the cloud before (`fringe3d.session.Session.follow`)
    """
    due_s = clock.now()

    def decode(stacks: tuple[ImageStack, ...], times: tuple[int, ...]) -> Decoded:
        return session.decode([stilled(s, times) for s in stacks] if still else stacks)

    def measure(shown: Decoded, before: Measurement | None) -> Measurement:
        nonlocal due_s
        begin = clock.now()
        if before is not None and begin < due_s:
            return session.follow(shown, before)
        points = before.points if uses_previous and before is not None else None
        found = session.measure(shown, previous_mm=None if points is None else points.points_mm)
        end = clock.now()
        # The first may have waited for the compiler.
        due_s = end + (end - begin) * (1 / renewing - 1) if before is not None else end
        return found

    return Steps(decode, measure)
