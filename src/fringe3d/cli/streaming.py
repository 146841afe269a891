"""Live measurements: devices, loop and page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import rich

from fringe3d.acquire import opened
from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import view_installed
from fringe3d.devices import (
    Camera,
    CameraInfo,
    CameraSettings,
    Clock,
    SystemClock,
    replayed,
)
from fringe3d.devices.addresses import cameras_at, projector_at
from fringe3d.devices.video import VideoCamera
from fringe3d.errors import DeviceError, MethodError
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig
from fringe3d.io.scanfile import read_plan
from fringe3d.live import Figures, Live, Moment, SlidingWindow, measuring, running, shown
from fringe3d.model import ImageStack, PatternPlan, Rig
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement
from fringe3d.session import Session


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions:
    """What the user said on the command line; see ``fringe3d live --help``."""

    rig: Path
    plan: Path | None
    replay: Path | None
    videos: tuple[str, ...]
    cameras: tuple[str, ...]
    projector: str | None
    exposure_ms: float
    wait_ms: float
    period_ms: float
    measuring: MeasureOptions
    still: bool
    renew: float
    host: str
    port: int
    has_view: bool
    clouds: int | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """Images that come, and what is known of them."""

    plan: PatternPlan
    infos: Mapping[str, CameraInfo]
    moments: Iterator[Moment]


def run_live(
    options: LiveOptions, reporter: Reporter, tell: Callable[[str], None], /
) -> tuple[str, dict[str, Any]]:
    """Measure until there are enough clouds, no images any more, or Ctrl-C."""
    clock = SystemClock()
    rig = read_rig(options.rig)
    with _stream(options, rig, clock, reporter) as stream, ExitStack() as closing:
        session = Session(rig, stream.plan, options.measuring)
        steps = measuring(
            session, clock, uses_previous=options.measuring.method == "m6", still=options.still,
            renewing=options.renew / 100,
        )  # fmt: skip
        window = SlidingWindow(stream.plan, stream.infos)
        loop = Live(stream.moments, window, steps, clock)
        try:
            show = _shower(options, rig, closing, tell, reporter)
            loop.run(show, most_clouds=options.clouds)
        except KeyboardInterrupt:
            loop.stop()
        figures = loop.figures
    return str(figures), asdict(figures)


Show = Callable[[Measurement | None, tuple[ImageStack, ...], Figures], None]


def _shower(
    options: LiveOptions,
    rig: Rig,
    closing: ExitStack,
    tell: Callable[[str], None],
    reporter: Reporter,
) -> Show:
    """Return what shows a cloud: a page, and a line on the terminal."""
    if not options.has_view:
        return lambda _result, _stacks, figures: reporter.step(
            f"{figures.clouds_per_s:.1f} clouds/s", figures.clouds, options.clouds or 0
        )
    with view_installed("live", ", or measure without: --no-view"):
        from fringe3d.view.stream import StreamView
    rich.reconfigure(quiet=True)  # the banner of the server, on standard output
    view = StreamView(rig, host=options.host, port=options.port)
    closing.callback(view.close)
    tell(f"{view.address} shows the newest cloud; Ctrl-C ends it")

    def show(result: Measurement | None, stacks: tuple[ImageStack, ...], figures: Figures) -> None:
        points = result.points if result is not None else None
        view.show(None if points is None else points.points_mm, stacks[0], str(figures))

    return show


@contextmanager
def _stream(options: LiveOptions, rig: Rig, clock: Clock, reporter: Reporter) -> Iterator[Stream]:
    """Open what the images come from; close it at the end."""
    if options.replay is not None:
        scan = read_scan(options.replay, rig=options.rig, progress=reporter.step)
        cameras, _ = replayed(scan, clock=clock, period_s=options.period_ms / 1000)
        with _free(cameras, clock, scan.stacks[0].plan) as stream:
            yield stream
        return
    if options.plan is None:
        raise MethodError("live: expected --plan (what is projected), found none")
    plan = read_plan(options.plan)
    if rig.projector is not None:
        plan = PatternPlan(patterns=plan.patterns, projector_shape=rig.projector.shape)
    if options.videos:
        made = [_video(text, options.period_ms / 1000, clock) for text in options.videos]
        with _free(made, clock, plan) as stream:
            yield stream
        return
    if not options.cameras or options.projector is None:
        raise DeviceError(
            "live: expected --camera and --projector, --replay SCAN, or --video NAME=FILE, found "
            "none of them. See fringe3d live --help"
        )
    devices = (cameras_at(options.cameras, clock), projector_at(options.projector, clock),
               CameraSettings(exposure_ms=options.exposure_ms), clock)  # fmt: skip
    with opened(*devices, wait_s=options.wait_ms / 1000, rig=rig) as open_:
        yield Stream(plan=plan, infos=open_.infos, moments=shown(open_, plan))


@contextmanager
def _free(
    cameras: tuple[Camera, ...] | list[Camera] | Any, clock: Clock, plan: PatternPlan
) -> Iterator[Stream]:
    with ExitStack() as closing:
        infos = {}
        for camera in cameras:
            closing.callback(camera.close)
            infos[camera.name] = camera.open()
        for camera in cameras:
            camera.apply(CameraSettings(trigger="free"))
        yield Stream(plan=plan, infos=infos, moments=running(cameras, clock))


def _video(text: str, period_s: float, clock: Clock) -> Camera:
    name, equals, path = text.partition("=")
    if not equals:
        raise MethodError(
            f"--video {text}: expected NAME=FILE with the name of a camera of the rig"
        )
    return VideoCamera(name, Path(path), clock=clock, period_s=period_s)
