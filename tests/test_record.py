"""Recording: simulated devices with faults on request; nothing wrong may look right."""

from __future__ import annotations

import errno
import functools
import importlib.util
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from queue import Queue
from typing import Any, get_args

import numpy as np
import pytest

from browser import browser, pixels_of, watched_page
from fringe3d.errors import DeviceError, DeviceLostError, OutputError
from fringe3d.model import PatternPlan, Scan

pytest.importorskip("embreex")

from fringe3d.acquire import (
    Recorded,
    measure_latency,
    opened,
    record,
    with_best_exposure,
)
from fringe3d.acquire.direction import expected_gradient
from fringe3d.cli.console import Reporter
from fringe3d.cli.recorder import Bench, RecordOptions, run_record
from fringe3d.devices import (
    Camera,
    CameraSettings,
    Clock,
    FaultyCamera,
    FaultyProjector,
    FrameFault,
    SystemClock,
    VirtualClock,
    replayed,
)
from fringe3d.devices.simulated import SimulatedWorld
from fringe3d.geometry import project
from fringe3d.io.recording import read_scan
from fringe3d.io.scanfile import plan_text
from fringe3d.patterns import across, method_plan
from fringe3d.simulate import OBJECTS, PRESETS, Preset, Stage, prepare
from fringe3d.simulate import record as record_directly

SIZE = (160, 128)
LATENCY_S = 0.03
OTHER_NOISE_DN = 2.5
"""Mean difference of two recordings of one pattern: noise has 0.5 to 1.7 DN; another pattern makes
20 DN and more."""


@pytest.fixture(scope="module")
def preset() -> Preset:
    return PRESETS["kolibri"](SIZE)


@pytest.fixture(scope="module")
def stage(preset: Preset) -> Stage:
    return prepare(preset.rig, preset.scene(OBJECTS["machine-part"]()))


def plan_of(preset: Preset, method: str) -> PatternPlan:
    assert preset.rig.projector is not None
    return method_plan(
        method, preset.rig.projector.shape, period_px=16.0, n_shifts=4, reduced_bits=3
    )


@functools.cache
def scan_of(stage: Stage, method: str) -> Scan:
    return record_directly(stage, plan_of(PRESETS["kolibri"](SIZE), method), seed=1)


def recorded(stage: Stage, plan: PatternPlan, *, wait_s: float = LATENCY_S) -> Recorded:
    """Record with simulated devices."""
    world = SimulatedWorld(stage, seed=1, latency_s=LATENCY_S)
    devices = (world.cameras, world.projector, CameraSettings(), world.clock)
    with opened(*devices, wait_s=wait_s) as opened_:
        return record(opened_, plan, stage.rig)


def replayed_with(
    scan: Scan,
    faults: Mapping[int, FrameFault] | None = None,
    swaps: Mapping[int, int | None] | None = None,
    *,
    with_rig: bool = True,
) -> Recorded:
    """Replay with faults in C1 (triggers 1 and 2 are white and black) and in the projector."""
    clock = VirtualClock()
    (first, *others), screen = replayed(scan, clock=clock)
    cameras: list[Camera] = [FaultyCamera(first, faults or {}), *others]
    projector = FaultyProjector(screen, swaps or {})
    with opened(cameras, projector, CameraSettings(), clock, wait_s=0.0) as devices:
        return record(devices, scan.stacks[0].plan, scan.rig if with_rig else None)


def differing(found: Recorded, scan: Scan) -> list[int]:
    """Return the places of the images that differ in any bit, in any camera."""
    return sorted({
        place
        for mine, wanted in zip(found.stacks, scan.stacks, strict=True)
        for place, (x, y) in enumerate(zip(mine.images, wanted.images, strict=True))
        if not np.array_equal(x, y)
    })  # fmt: skip


def largest_difference(found: Recorded, scan: Scan) -> float:
    """Return the largest mean difference of an image, DN."""
    return max(
        float(np.abs(x.astype(float) - y).mean())
        for mine, theirs in zip(found.stacks, scan.stacks, strict=True)
        for x, y in zip(mine.images, theirs.images, strict=True)
    )


@pytest.mark.parametrize("method", ["m2"])
def test_simulated_devices_record_what_the_simulator_renders_bit_for_bit(
    preset: Preset, stage: Stage, method: str
) -> None:
    light = replace(stage.setup.projector, flicker=0.01, vibration_px=0.2)
    unsteady = replace(stage, setup=replace(stage.setup, projector=light))
    plan = plan_of(preset, method)
    found, wanted = recorded(unsteady, plan), record_directly(unsteady, plan, seed=1)
    for mine, theirs in zip(found.stacks, wanted.stacks, strict=True):
        np.testing.assert_array_equal(mine.images, theirs.images)
        assert mine.noise == theirs.noise
    assert found.mended == ()
    assert (np.diff(found.times_s, axis=1) >= LATENCY_S).all()


KINDS_SEEN = {
    "lost-packet": {"incomplete"},
    "dropped": {"missing"},
    "repeated": {"repeated"},
    "again": {"repeated"},
    "late": {"missing", "late"},
    "held": {"missing", "late"},
}


@pytest.mark.parametrize("fault", sorted(set(get_args(FrameFault)) - {"disconnected"}))
def test_a_faulty_frame_is_recognised_and_recorded_again(stage: Stage, fault: FrameFault) -> None:
    scan = scan_of(stage, "m2")
    found = replayed_with(scan, {6: fault, 9: fault})
    assert {m.trouble.kind for m in found.mended} == KINDS_SEEN[fault]
    assert {m.image for m in found.mended} == {3, 5}  # trigger 7 was for image 3 again
    assert differing(found, scan) == []


@pytest.mark.parametrize(
    ("method", "swaps"),
    [
        ("m2", {1: 2, 2: 1}),
        ("m2", {0: 2, 2: 0}),
        ("m2", {4: 5, 5: 4}),
        ("m2", {8: 9, 9: 8}),
        ("m2", {3: None}),
        ("m2", {5: None}),
        ("m3", {0: 1, 1: 0}),
        ("m3", {0: 2, 2: 0}),
        ("m3", {1: 3, 3: 1}),
        ("m4", {5: 7, 7: 5}),
    ],
)
def test_exchanged_and_repeated_patterns_are_found_by_their_brightness(
    stage: Stage, method: str, swaps: Mapping[int, int | None]
) -> None:
    """The frames' numbers and times are all in order: the projector showed something else."""
    scan = scan_of(stage, method)
    found = replayed_with(scan, swaps=swaps)
    assert found.mended
    assert differing(found, scan) == []


def test_two_opposite_steps_of_four_fringes_are_told_by_the_rig_alone(stage: Stage) -> None:
    """Without a rig nothing contradicts: four steps that move the other way are good fringes."""
    scan = scan_of(stage, "m3")
    unseen = replayed_with(scan, swaps={0: 2, 2: 0}, with_rig=False)
    assert differing(unseen, scan) == [0, 2]


def test_the_expected_gradient_is_that_of_a_plane_through_the_volume(preset: Preset) -> None:
    """Kolibri's fringes grow along x in both cameras; by the intersection with the plane z = 0."""
    projector = preset.rig.projector
    assert projector is not None
    for camera in preset.rig.cameras:
        on_plane = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        seen, lit = project(camera, on_plane), project(projector, on_plane)
        w = across(0.0, lit[:, 0], lit[:, 1])
        gradient = np.linalg.solve(seen[1:] - seen[0], w[1:] - w[0])
        found = expected_gradient(camera, preset.rig, 0.0)
        # Of planes across the view instead: tilts of 27 degrees change it by a tenth or so.
        np.testing.assert_allclose(found[0], gradient[0], rtol=0.2)


def test_an_image_too_early_is_recorded_again_with_a_longer_wait(
    preset: Preset, stage: Stage
) -> None:
    plan = plan_of(preset, "m3")
    found = recorded(stage, plan, wait_s=LATENCY_S + 0.002)
    assert found.mended == ()
    late = recorded(stage, plan, wait_s=0.2 * LATENCY_S)
    assert late.mended
    assert largest_difference(late, scan_of(stage, "m3")) < OTHER_NOISE_DN


def test_a_projector_that_stays_dark_or_stuck_is_an_error(preset: Preset, stage: Stage) -> None:
    plan = plan_of(preset, "m3")
    stuck: dict[int, int | None] = dict.fromkeys(range(1, 100))
    with pytest.raises(DeviceError, match=r"image 1: .* 4 tries: .*shows again what image 0"):
        replayed_with(scan_of(stage, "m3"), swaps=stuck)
    world = SimulatedWorld(stage, seed=1)
    dark = replace(stage, setup=replace(stage.setup, projector=replace(
        stage.setup.projector, dark=1.0)))  # fmt: skip
    world.stage = dark
    with (
        opened(
            world.cameras, world.projector, CameraSettings(), world.clock, wait_s=0.1
        ) as devices,
        pytest.raises(DeviceError, match=r"'c1': expected an image that a white .*--expose auto"),
    ):
        record(devices, plan)


def test_the_measured_latency_is_that_of_the_projector(stage: Stage) -> None:
    """The exposure must begin after the change: bisection to 2 ms, and never too short."""
    world = SimulatedWorld(stage, seed=1, latency_s=0.0873)
    with opened(world.cameras, world.projector, CameraSettings(), world.clock, wait_s=0.3) as d:
        found = measure_latency(d)
    assert 0.0873 - 0.0005 <= found <= 0.0873 + 0.0025  # 5 % of 10 ms may be missing


@pytest.mark.parametrize("start_ms", [0.1, 10.0, 150.0])
def test_auto_exposure_makes_white_bright_and_not_saturated(stage: Stage, start_ms: float) -> None:
    world = SimulatedWorld(stage, seed=1)
    settings = CameraSettings(exposure_ms=start_ms)
    with opened(world.cameras, world.projector, settings, world.clock, wait_s=0.1) as devices:
        found = with_best_exposure(devices)
    # The default exposure fills 80 % of the range with white paper that faces the projector.
    for settings in found.settings.values():
        assert 6 < settings.exposure_ms < 16


# Scan folders


def bench_of(stages: Any, *, n_positions: int = 1) -> Bench:
    """Return simulated devices."""
    world = SimulatedWorld(stages, seed=1, n_positions=n_positions)
    return Bench(cameras=world.cameras, projector=world.projector, table=world.table,
                 clock=world.clock, rig=world.stage.rig)  # fmt: skip


def replaying(
    scan: Scan, first: Callable[[Camera], Camera] | None = None, *, clock: Clock | None = None
) -> Bench:
    """Return devices that replay a scan, the first camera with faults."""
    clock = clock or VirtualClock()
    found, projector = replayed(scan, clock=clock)
    cameras: list[Camera] = [*found]
    if first is not None:
        cameras[0] = first(cameras[0])
    return Bench(cameras=cameras, projector=projector, table=None, clock=clock, rig=scan.rig)


def options_of(folder: Path, plan: PatternPlan, **more: Any) -> RecordOptions:
    (folder / "plan.toml").write_text(plan_text(plan))
    return RecordOptions(rig="rig.toml", plan=folder / "plan.toml", out=folder / "scan", **more)


def test_a_scan_folder_reads_back_as_it_was_recorded(
    tmp_path: Path, preset: Preset, stage: Stage
) -> None:
    plan = plan_of(preset, "m2")
    wanted = scan_of(stage, "m2")
    bench = replaying(wanted, lambda c: FaultyCamera(c, {4: "dropped"}))
    text, told = run_record(options_of(tmp_path, plan), Reporter(quiet=True), bench=bench)
    scan = read_scan(tmp_path / "scan")
    np.testing.assert_array_equal(scan.stacks[1].images, wanted.stacks[1].images)
    assert scan.rig is not None
    assert scan.stacks[0].plan == plan
    assert told["mended"] == 1
    assert "1 frames were recorded again" in text
    log = (tmp_path / "scan" / "recording.toml").read_text()
    assert 'kind = "missing"' in log


def left_behind(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if p.name != "plan.toml")


def test_a_camera_that_is_disconnected_in_the_middle_leaves_nothing(
    tmp_path: Path, preset: Preset, stage: Stage
) -> None:
    bench = replaying(scan_of(stage, "m2"), lambda c: FaultyCamera(c, {7: "disconnected"}))
    with pytest.raises(DeviceLostError, match="'c1': expected an answer, found none since frame 7"):
        run_record(options_of(tmp_path, plan_of(preset, "m2")), Reporter(quiet=True), bench=bench)
    assert left_behind(tmp_path) == []


def test_an_interrupt_leaves_nothing_and_closes_the_devices(
    tmp_path: Path, preset: Preset, stage: Stage
) -> None:
    closed = []

    class Closing(FaultyCamera):
        def close(self) -> None:
            closed.append(self.name)
            super().close()

    def interrupt(count: int) -> None:
        if count == 6:
            raise KeyboardInterrupt

    bench = replaying(scan_of(stage, "m2"), lambda c: Closing(c, {}, meanwhile=interrupt))
    with pytest.raises(KeyboardInterrupt):
        run_record(options_of(tmp_path, plan_of(preset, "m2")), Reporter(quiet=True), bench=bench)
    assert left_behind(tmp_path) == []
    assert closed == ["c1"]


def test_a_full_disk_leaves_nothing(
    tmp_path: Path, preset: Preset, stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []

    def write(path: Path, _image: object) -> None:
        written.append(path)
        if len(written) == 13:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        path.write_bytes(b"")

    monkeypatch.setattr("fringe3d.io.scanfolder.write_png", write)
    with pytest.raises(OutputError, match=r"scan: cannot be written: .*No space left"):
        run_record(options_of(tmp_path, plan_of(preset, "m2")), Reporter(quiet=True),
                   bench=replaying(scan_of(stage, "m2")))  # fmt: skip
    assert left_behind(tmp_path) == []


def test_a_preview_shows_what_is_seen_until_its_button_is_pressed(
    preset: Preset, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a browser: the pictures are there and not black; nothing is written before the click."""
    pytest.importorskip("viser")
    told: Queue[str] = Queue()
    reporter, bench = Reporter(quiet=True), replaying(scan_of(stage, "m2"), clock=SystemClock())
    monkeypatch.setattr(reporter, "tell", told.put)
    options = replace(options_of(tmp_path, plan_of(preset, "m2")), is_shown_first=True)
    recording = threading.Thread(  # a daemon: without a click it would never end
        target=run_record, args=(options, reporter), kwargs={"bench": bench}, daemon=True
    )
    with browser() as chromium:
        page, said = watched_page(chromium)
        recording.start()
        page.goto(told.get(timeout=60).split()[0])
        for name in ("c1", "c2"):
            page.get_by_text(f"{name}: a tenth of the pixels changes").wait_for()
        pictures = page.get_by_role("img")
        assert sum(np.ptp(pixels_of(pictures.nth(n))) > 100 for n in range(pictures.count())) >= 2
        assert not options.out.exists()
        page.get_by_role("button", name="record", exact=True).click()
        recording.join(timeout=60)
        assert (options.out / "scan.toml").exists()
        assert [s for s in said if "WebSocket" not in s] == []  # the page ends with its server


def test_a_series_of_exposures_becomes_one_stack(
    tmp_path: Path, preset: Preset, stage: Stage
) -> None:
    plan = plan_of(preset, "m3")
    options = options_of(tmp_path, plan, series=(1.0, 4.0))
    run_record(options, Reporter(quiet=True), bench=bench_of(stage))
    stack = read_scan(tmp_path / "scan").stacks[0]
    assert stack.fused is not None
    assert set(np.unique(stack.fused.exposure)) == {1.0, 4.0}
    assert len(list((tmp_path / "scan" / "c1").iterdir())) == 8


def test_a_table_gives_a_scan_for_each_position(
    tmp_path: Path, preset: Preset, stage: Stage
) -> None:
    """The simulated table shows prepared scenes: here the part, and the same moved."""
    plan = plan_of(preset, "m3")
    moved = replace(stage, setup=replace(stage.setup, recording=replace(
        stage.setup.recording, ambient=0.2)))  # fmt: skip
    bench = bench_of(lambda k: (stage, moved)[k], n_positions=2)
    run_record(options_of(tmp_path, plan, positions=2), Reporter(quiet=True), bench=bench)
    for position, scene in enumerate((stage, moved)):
        scan = read_scan(tmp_path / "scan" / f"{position:03d}")
        wanted = record_directly(scene, plan, seed=1, position=position)
        np.testing.assert_array_equal(scan.stacks[0].images, wanted.stacks[0].images)
        assert scan.table is not None
        assert scan.table.angle == pytest.approx(np.pi * position)


def test_a_recording_is_replayed_bit_for_bit(stage: Stage) -> None:
    scan = scan_of(stage, "m2")
    again = replayed_with(scan)
    assert differing(again, scan) == []
    assert again.mended == ()


def test_a_free_camera_drops_frames_that_nobody_grabs(stage: Stage) -> None:
    scan = scan_of(stage, "m3")
    clock = VirtualClock()
    camera = replayed(scan, clock=clock, period_s=0.1)[0][0]
    camera.apply(CameraSettings(trigger="free"))
    numbers = []
    for busy_s in (0.0, 0.0, 0.35, 0.0):
        clock.sleep(busy_s)
        frame = camera.grab(1.0)
        numbers.append(frame.number)
        np.testing.assert_array_equal(frame.image, scan.stacks[0].images[(frame.number - 1) % 4])
    assert numbers == [1, 2, 5, 6]
    assert clock.now() == pytest.approx(0.6)


def test_devices_of_another_size_than_the_rig_are_refused(stage: Stage) -> None:
    other = PRESETS["kolibri"]((320, 256)).rig
    world = SimulatedWorld(stage, seed=1)
    with (
        pytest.raises(DeviceError, match="'c1': calibrated for 320 x 256 pixels, found 160 x 128"),
        opened(
            world.cameras, world.projector, CameraSettings(), world.clock, wait_s=0.1, rig=other
        ),
    ):
        pass


def test_basler_cameras_are_triggered_one_by_one() -> None:
    """By the emulated cameras of the library, in a process of their own: they must be asked for
    before it is loaded. Their picture is a test pattern that moves from frame to frame.
    """
    if importlib.util.find_spec("pypylon") is None:
        pytest.skip("no pypylon here: pip install 'fringe3d[pylon]'")
    done = subprocess.run([sys.executable, "-c", BASLER], env=os.environ | {"PYLON_CAMEMU": "2"},
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["2", "8", "25.0", "1", "2", "3", "True"]


BASLER = """
from fringe3d.devices import CameraSettings, SystemClock
from fringe3d.devices.discovery import find_devices
from fringe3d.devices.pylon import PylonCamera, pylon
from fringe3d.errors import FrameTimeoutError

found = [d.address for d in find_devices()[0] if d.address.startswith("pylon:")]
print(len(found))
camera = PylonCamera("c1", found[1].removeprefix("pylon:"), clock=SystemClock())
print(camera.open().bit_depth)
print(camera.apply(CameraSettings(exposure_ms=25.0)).exposure_ms)
for _ in range(3):
    camera.trigger()
    frame = camera.grab(5.0)
    assert frame.is_complete and frame.image.std() > 1, frame
    print(frame.number)
try:
    camera.grab(0.05)
except FrameTimeoutError:
    print(True)
camera.close()
"""
