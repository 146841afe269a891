"""Record, measure and show at once; what nobody has time for is dropped and counted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from fringe3d.decode import CameraPhases, stilled
from fringe3d.decoding import Decoded, carried_on
from fringe3d.devices import Clock
from fringe3d.errors import Fringe3DError
from fringe3d.kernels import sharing
from fringe3d.live.window import Moment, SlidingWindow
from fringe3d.model import ImageStack
from fringe3d.pipeline import Measurement
from fringe3d.session import Session

WAITING = 2
"""Sequences that may wait to be measured; the oldest is dropped for a newer one."""

KEPT_TIMES = 200
"""Of the newest clouds, of which the latency is told."""

IDLE_S = 0.05

AT_ONCE = 2
"""Sequences that are worked on: one is decoded, one measured."""

SETTLING_S = 2.0
"""Within which the orders of a frame are settled after the frame before was measured."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A sequence that is decoded.

    Parameters
    ----------
    shown : Decoded
    orders : Future; the phases of all cameras with the orders that go on from the frame before, as
        soon as they are settled; None where this frame is measured anew
    """

    shown: Decoded
    orders: Future[tuple[CameraPhases, ...] | None] = field(default_factory=Future)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ready:
    job: _Job
    stacks: tuple[ImageStack, ...]
    shown: Frame | None


Show = Callable[[Measurement | None, tuple[ImageStack, ...], Figures], None]


@dataclass(frozen=True, slots=True)
class Steps:
    """What is done with a sequence, the first while the one before is in the second.

    Parameters
    ----------
    decode : function of the stacks and the times of their images
    measure : function of what was decoded, and of the measurement before (or None)
    """

    decode: Callable[[tuple[ImageStack, ...], tuple[int, ...]], Frame]
    measure: Callable[[Frame, Measurement | None], Measurement]


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
                    with sharing(AT_ONCE):
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
        with self._counting_failures(), sharing(AT_ONCE):
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
    stream = _Stream(session, clock, uses_previous=uses_previous, still=still, renewing=renewing)
    return Steps(stream.decode, stream.measure)


class _Stream:
    """Frames of a session, one after the other.

    While a frame is measured, the next one gets the orders that go on from it: they are settled as
    its measurement begins.
    """

    def __init__(
        self, session: Session, clock: Clock, *, uses_previous: bool, still: bool, renewing: float
    ) -> None:
        self._session, self._clock = session, clock
        self._uses_previous, self._still, self._renewing = uses_previous, still, renewing
        self._due_s = clock.now()
        self._last: Frame | None = None

    def decode(self, stacks: tuple[ImageStack, ...], times: tuple[int, ...]) -> Frame:
        """Decode, and carry the orders on where those of the frame before are settled so."""
        taken = [stilled(s, times) for s in stacks] if self._still else stacks
        shown = self._session.decode(taken)
        before = self._orders_before()
        self._last = Frame(shown if before is None else carried_on(shown, before))
        return self._last

    def _orders_before(self) -> tuple[CameraPhases, ...] | None:
        if self._last is None:
            return None
        try:
            return self._last.orders.result(timeout=SETTLING_S)
        except TimeoutError:  # nobody measures any more
            return None

    def measure(self, frame: Frame, before: Measurement | None) -> Measurement:
        """Go on from the frame before, or measure anew where that is due."""
        begin = self._clock.now()
        try:
            if before is not None and begin < self._due_s and self._session.may_follow(before):
                shown = self._session.carry_on(frame.shown, before)
                assert shown.carried is not None
                frame.orders.set_result(shown.carried.phases)
                return self._session.follow(shown, before)
        finally:
            if not frame.orders.done():
                frame.orders.set_result(None)
        points = before.points if self._uses_previous and before is not None else None
        previous_mm = None if points is None else points.points_mm
        found = self._session.measure(frame.shown, previous_mm=previous_mm)
        end, took = self._clock.now(), self._clock.now() - begin
        # The first may have waited for the compiler.
        self._due_s = end if before is None else end + took * (1 / self._renewing - 1)
        return found
