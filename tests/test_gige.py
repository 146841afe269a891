"""GenICam cameras by their real protocol, on the loopback interface."""

from __future__ import annotations

import multiprocessing
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fringe3d.devices import CameraSettings, SystemClock
from fringe3d.errors import DeviceError, DeviceLostError, FrameTimeoutError

pytest.importorskip("embreex")
pytest.importorskip("viva_genicam")

from fringe3d.cli.console import Reporter
from fringe3d.cli.recorder import RecordOptions, run_record
from fringe3d.devices.discovery import find_devices
from fringe3d.devices.genicam import GigeCamera
from fringe3d.devices.gige_simulator import CONTROL_PORT, GigeSimulator
from fringe3d.devices.lab import LabProjector, serve
from fringe3d.devices.simulated import SimulatedWorld
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import rig_text
from fringe3d.io.scanfile import plan_text
from fringe3d.model import PatternPlan
from fringe3d.model.plan import fringes
from fringe3d.simulate import OBJECTS, PRESETS, Stage, prepare, record

SHAPE = (64, 96)
PATIENCE_S = 5.0
"""A busy machine may let a frame wait; nothing here depends on how long."""


@pytest.fixture(autouse=True)
def _free_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", CONTROL_PORT))
        except OSError as problem:
            pytest.skip(f"GigE Vision on the loopback interface: {problem}")


def counted(_exposure_ms: float, _gain_db: float) -> np.ndarray:
    image = np.arange(SHAPE[0] * SHAPE[1], dtype=np.uint32) % 251
    return image.reshape(SHAPE).astype(np.uint8)


@pytest.fixture
def camera() -> Iterator[GigeCamera]:
    camera = GigeCamera("c1", "127.0.0.1", clock=SystemClock())
    yield camera
    camera.close()


def test_a_frame_comes_bit_for_bit_with_its_settings_number_and_time(camera: GigeCamera) -> None:
    seen = []

    def see(exposure_ms: float, gain_db: float) -> np.ndarray:
        seen.append((exposure_ms, gain_db))
        return counted(exposure_ms, gain_db) + np.uint8(len(seen))

    simulator = GigeSimulator(see, shape=SHAPE)
    simulator.start()
    try:
        info = camera.open()
        assert (info.shape, info.bit_depth) == (SHAPE, 8)
        made = camera.apply(CameraSettings(exposure_ms=7.25, gain_db=3.0))
        assert made.exposure_ms == 7.25
        for number in (1, 2):
            before = SystemClock().now()
            camera.trigger()
            frame = camera.grab(PATIENCE_S)
            assert (frame.number, frame.is_complete) == (number, True)
            np.testing.assert_array_equal(frame.image, counted(0, 0) + np.uint8(number))
            # The clock is fitted through the network; a busy machine answers late.
            assert before - 0.2 < frame.time_s < SystemClock().now() + 0.2
        assert seen == [(7.25, 3.0)] * 2
        with pytest.raises(FrameTimeoutError, match="'c1': expected a frame within 20 ms"):
            camera.grab(0.02)
    finally:
        simulator.stop()
    with pytest.raises(DeviceLostError, match="'c1'"):
        camera.trigger()


def test_sixteen_bits_come_in_the_right_order(camera: GigeCamera) -> None:
    wanted = (np.arange(SHAPE[0] * SHAPE[1], dtype=np.uint16) * 9).reshape(SHAPE)
    simulator = GigeSimulator(lambda *_: wanted, shape=SHAPE, bytes_per_pixel=2)
    simulator.start()
    try:
        assert camera.open().bit_depth == 16
        camera.apply(CameraSettings())
        camera.trigger()
        np.testing.assert_array_equal(camera.grab(PATIENCE_S).image, wanted)
    finally:
        simulator.stop()


def test_a_packet_that_is_lost_for_good_makes_a_frame_incomplete(camera: GigeCamera) -> None:
    simulator = GigeSimulator(counted, shape=SHAPE, lost=[(1, 2)])
    simulator.start()
    try:
        camera.open()
        camera.apply(CameraSettings())
        for number, is_complete in ((1, False), (2, True)):
            camera.trigger()
            frame = camera.grab(PATIENCE_S)
            assert (frame.number, frame.is_complete) == (number, is_complete)
    finally:
        simulator.stop()


def test_the_simulated_camera_answers_as_the_standard_says() -> None:
    """By bytes sent by hand: discovery, and the model's name at its place (GigE Vision 2.0)."""
    simulator = GigeSimulator(counted, shape=SHAPE, serial="77")
    simulator.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
            host.settimeout(PATIENCE_S)
            host.sendto(struct.pack(">BBHHH", 0x42, 0x11, 0x0002, 0, 9), ("127.0.0.1", 3956))
            answer, _ = host.recvfrom(1000)
    finally:
        simulator.stop()
    assert struct.unpack(">HHHH", answer[:8]) == (0, 3, 248, 9)
    assert answer[8 + 0x24 : 8 + 0x28] == socket.inet_aton("127.0.0.1")
    assert answer[8 + 0x68 :].startswith(b"simulated\0")
    assert answer[8 + 0xD8 :].startswith(b"77\0")


def test_an_address_that_is_not_there_is_told_what_is(camera: GigeCamera) -> None:
    simulator = GigeSimulator(counted, shape=SHAPE)
    simulator.start()
    try:
        found, _ = find_devices()
        assert "gige:127.0.0.1" in [device.address for device in found]
        other = GigeCamera("c1", "127.0.0.9", clock=SystemClock())
        with pytest.raises(DeviceError, match=r"'127\.0\.0\.9'.*found 127\.0\.0\.1 \(F3:D0"):
            other.open()
    finally:
        simulator.stop()
    with pytest.raises(DeviceError, match=r"expected a GigE camera '127\.0\.0\.1'"):
        camera.open()
    with pytest.raises(DeviceError, match="Start one: fringe3d lab kolibri"):
        LabProjector("127.0.0.1:1").open()


def small_stage() -> Stage:
    made = PRESETS["kolibri"]((96, 80))
    return prepare(made.rig, made.scene(OBJECTS["sphere"]()))


def _laboratory(port: int, ready: object) -> None:
    serve(SimulatedWorld(small_stage(), seed=4, clock=SystemClock()), port=port, ready=ready)


def test_cameras_in_another_process_record_the_simulated_scan_bit_for_bit(
    tmp_path: Path,
) -> None:
    stage = small_stage()
    assert stage.rig.projector is not None
    plan = PatternPlan(patterns=fringes(32.0, 3), projector_shape=stage.rig.projector.shape)
    (tmp_path / "rig.toml").write_text(rig_text(stage.rig))
    (tmp_path / "plan.toml").write_text(plan_text(plan))
    spawn = multiprocessing.get_context("spawn")
    ready, port = spawn.Event(), 3958
    laboratory = spawn.Process(target=_laboratory, args=(port, ready), daemon=True)
    laboratory.start()
    try:
        assert ready.wait(60)
        options = RecordOptions(
            rig=str(tmp_path / "rig.toml"), plan=tmp_path / "plan.toml", out=tmp_path / "scan",
            cameras=("c1=gige:127.0.0.1", "c2=gige:127.0.0.2"), projector=f"lab:127.0.0.1:{port}",
            black_level_dn=2.0, patience_ms=1000 * PATIENCE_S,
        )  # fmt: skip
        _, told = run_record(options, Reporter(quiet=True))
    finally:
        laboratory.terminate()
        laboratory.join()
    assert told["mended"] == 0
    found, wanted = read_scan(tmp_path / "scan"), record(stage, plan, seed=4)
    for mine, theirs in zip(found.stacks, wanted.stacks, strict=True):
        np.testing.assert_array_equal(mine.images, theirs.images)
