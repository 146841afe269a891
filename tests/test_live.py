"""Live measurements: the newest images, nothing piled up, every drop counted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from closed_form import Recording
from fringe3d.cli.console import Reporter
from fringe3d.cli.streaming import LiveOptions, run_live
from fringe3d.devices import CameraInfo, CameraSettings, SystemClock, VirtualClock, replayed
from fringe3d.devices.video import VideoCamera
from fringe3d.errors import MethodError
from fringe3d.io.rigfile import rig_text
from fringe3d.io.scanfile import plan_text
from fringe3d.io.scanfolder import write_scan
from fringe3d.live import Frame, Live, Moment, SlidingWindow, Steps, measuring, running
from fringe3d.model import ImageStack, PatternPlan
from fringe3d.model.plan import fringes
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure
from fringe3d.session import Session

PLAN = PatternPlan(patterns=fringes(16.0, 4))
INFOS = {"c1": CameraInfo(shape=(2, 3))}


def moment(number: int) -> Moment:
    return Moment(number=number, images={"c1": np.full((2, 3), number, np.uint8)}, time_s=0.0)


def newest(window: SlidingWindow, number: int) -> list[int]:
    ordered = window.add(moment(number))
    return seen(window.stacks(ordered)) if ordered else []


def seen(stacks: tuple[ImageStack, ...]) -> list[int]:
    return [int(value) for value in stacks[0].images[:, 0, 0]]


def test_each_new_image_gives_a_sequence_in_the_order_of_the_plan() -> None:
    window = SlidingWindow(PLAN, INFOS)
    found = [newest(window, number) for number in range(6)]
    assert found == [[], [], [], [0, 1, 2, 3], [4, 1, 2, 3], [4, 5, 2, 3]]
    assert window.newest == 1


def test_after_a_lost_image_no_old_one_is_mixed_in() -> None:
    window = SlidingWindow(PLAN, INFOS)
    found = [newest(window, number) for number in (0, 1, 2, 3, 5, 6, 7, 8)]
    assert found == [[], [], [], [0, 1, 2, 3], [], [], [], [8, 5, 6, 7]]


def test_while_one_sequence_is_measured_older_ones_that_wait_are_dropped(
    recording: Recording,
) -> None:
    """The first measurement waits until ten images are there, the second sequence is decoded
    meanwhile; then the newest is taken."""
    all_came, first_begun, second_decoded = (threading.Event() for _ in range(3))

    def moments() -> Iterator[Moment]:
        for number in range(4):
            yield moment(number)
        first_begun.wait(10)
        yield moment(4)
        second_decoded.wait(10)
        for number in range(5, 10):
            yield moment(number)
        all_came.set()

    decoded, result = [], measure(recording[0])

    def decode(stacks: tuple[ImageStack, ...], _: tuple[int, ...]) -> Any:
        decoded.append(seen(stacks))
        if len(decoded) == 2:
            second_decoded.set()
        return decoded[-1]

    measured = []

    def slow(shown: Any, _: Measurement | None) -> Measurement:
        measured.append(shown)
        first_begun.set()
        all_came.wait(10)
        return result

    loop = Live(moments(), SlidingWindow(PLAN, INFOS), Steps(decode, slow), SystemClock())
    figures = loop.run(lambda *_: None)
    assert measured == decoded == [[0, 1, 2, 3], [4, 1, 2, 3], [8, 9, 6, 7]]
    assert (figures.moments, figures.clouds, figures.dropped, figures.lost) == (10, 3, 4, 0)


def test_a_sequence_without_a_cloud_does_not_end_the_loop_and_a_lost_camera_does() -> None:
    def refuse(*_: object) -> Any:
        raise MethodError("nothing to see")

    for steps in (Steps(refuse, refuse), Steps(lambda stacks, _: stacks, refuse)):  # type: ignore[arg-type, return-value]
        loop = Live(map(moment, range(6)), SlidingWindow(PLAN, INFOS), steps, SystemClock())
        figures = loop.run(lambda *_: None)
        assert figures.failed + figures.dropped == 3
        assert figures.clouds == 0

    def broken() -> Iterator[Moment]:
        yield moment(0)
        raise MethodError("gone")

    with pytest.raises(MethodError, match="gone"):
        Live(broken(), SlidingWindow(PLAN, INFOS), steps, SystemClock()).run(lambda *_: None)

    def breaks(*_: object) -> Any:
        raise ZeroDivisionError

    loop = Live(map(moment, range(6)), SlidingWindow(PLAN, INFOS), Steps(breaks, refuse),
                SystemClock())  # fmt: skip
    with pytest.raises(ZeroDivisionError):  # a fault of our own is not counted, but told
        loop.run(lambda *_: None)


def test_live_clouds_are_those_of_the_scan(recording: Recording) -> None:
    """From file cameras; of a still scene every sequence has the same images in plan order."""
    scan, _ = recording
    clock = VirtualClock()
    cameras, _ = replayed(scan, clock=clock, period_s=0.02)
    for camera in cameras:
        camera.apply(CameraSettings(trigger="free"))
    infos = {camera.name: camera.open() for camera in cameras}
    plan = scan.stacks[0].plan
    session = Session(scan.rig, plan, MeasureOptions(), keep=False)
    loop = Live(running(cameras, clock), SlidingWindow(plan, infos),
                measuring(session, clock), SystemClock())  # fmt: skip
    clouds = []
    figures = loop.run(lambda result, *_: clouds.append(result), most_clouds=2)
    wanted = measure(scan)
    assert figures.clouds == 2
    assert wanted.points is not None
    for cloud in clouds:
        assert cloud.points is not None
        np.testing.assert_array_equal(cloud.points.points_mm, wanted.points.points_mm)


def test_orders_are_found_anew_in_a_part_of_the_time() -> None:
    """The first measurement, which compiles, does not count; then between two
    of 1 s 24 of 0.125 s take 3 s."""
    clock, did = VirtualClock(), []

    class Slow:
        def measure(self, *_: object, **__: object) -> Any:
            did.append("anew")
            clock.sleep(60.0 if len(did) == 1 else 1.0)
            return Measurement(method="m2", why="", n_images=4, phases=())

        def may_follow(self, _: object) -> bool:
            return True

        def carry_on(self, shown: Any, _: object) -> Any:
            return shown

        def follow(self, _: object, before: Measurement) -> Measurement:
            did.append("followed")
            clock.sleep(0.125)
            return before

    steps = measuring(Slow(), clock, renewing=0.25)  # type: ignore[arg-type]
    before, orders = None, []
    for _ in range(64):
        frame = Frame(SimpleNamespace(carried=SimpleNamespace(phases=())))  # type: ignore[arg-type]
        before = steps.measure(frame, before)
        orders.append(frame.orders.result(timeout=0))
    anew = [i for i, what in enumerate(did) if what == "anew"]
    assert anew == [0, 1, 26, 51]
    assert [i for i, known in enumerate(orders) if known is None] == anew


def options_of(folder: Path, **more: object) -> LiveOptions:
    values: dict[str, object] = {
        "rig": folder / "rig.toml", "plan": folder / "plan.toml", "replay": None, "videos": (),
        "cameras": (), "projector": None, "exposure_ms": 10.0, "wait_ms": 0.0, "period_ms": 20.0,
        "measuring": MeasureOptions(), "still": True, "renew": 50.0, "host": "127.0.0.1",
        "port": 8080, "has_view": False,
        "clouds": 1,
    }  # fmt: skip
    return LiveOptions(**(values | more))  # type: ignore[arg-type]


def test_a_video_and_a_scan_are_measured_from_the_command_line(
    recording: Recording, tmp_path: Path
) -> None:
    """A video without loss (FFV1): every image of it comes back bit for bit."""
    scan, _ = recording
    assert scan.rig is not None
    (tmp_path / "rig.toml").write_text(rig_text(scan.rig))
    (tmp_path / "plan.toml").write_text(plan_text(scan.stacks[0].plan))
    videos = []
    for stack in scan.stacks:
        path = tmp_path / f"{stack.device_name}.avi"
        size = stack.shape[::-1]
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30, size, False)
        if not writer.isOpened():
            pytest.skip("this OpenCV writes no FFV1")
        for image in stack.images:
            writer.write(image)
        writer.release()
        videos.append(f"{stack.device_name}={path}")
    camera = VideoCamera("c1", tmp_path / "c1.avi", clock=VirtualClock())
    assert camera.open().shape == scan.stacks[0].shape
    camera.apply(CameraSettings(trigger="free"))
    np.testing.assert_array_equal(camera.grab(1.0).image, scan.stacks[0].images[0])
    camera.close()
    _, told = run_live(options_of(tmp_path, videos=tuple(videos)), Reporter(quiet=True), print)
    assert (told["clouds"], told["moments"], told["lost"]) == (1, len(scan.stacks[0].images), 0)
    write_scan(tmp_path / "scan", scan)
    _, told = run_live(options_of(tmp_path, replay=tmp_path / "scan", clouds=2),
                       Reporter(quiet=True), print)  # fmt: skip
    assert told["clouds"] == 2


def test_the_page_shows_the_newest_cloud_and_what_is_saturated() -> None:
    pytest.importorskip("viser")
    from fringe3d.view.stream import SATURATED, StreamView

    images = np.zeros((3, 8, 8), np.uint8)
    images[1] = 100
    images[2, 0, 0] = 255
    plan = PatternPlan(patterns=fringes(16.0, 3))
    stack = ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=255)
    points = np.random.default_rng(0).normal([0, 0, 500], 1.0, (8, 8, 3))
    points[3] = np.nan
    view = StreamView(None, host="127.0.0.1", port=8123)
    try:
        assert len(view.show(points, stack, "first")) == 56
        shown = view.show(points + np.array([0, 0, 2.0]), stack, "second")
        middle = np.nanmedian(points.reshape(-1, 3)[~np.isnan(points[..., 0].ravel())], axis=0)
        np.testing.assert_allclose(shown[0] + middle, points[0, 0] + [0, 0, 2], atol=1e-4)
        assert view.text.content == "second"
        assert tuple(view.preview.image[0, 0]) == SATURATED
        assert int(view.preview.image[4, 4, 0]) == 100
    finally:
        view.close()
