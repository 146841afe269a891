"""Which device moved: against OpenCV's projections of a rig of which one device was kicked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_self_calibration import BOTH, ONE, kicked, points_in_space, seen

from board_series import C1, C2, PROJECTOR
from closed_form import Recording
from fringe3d.calibrate import moved_text, which_moved
from fringe3d.model import Device, Rig
from fringe3d.pipeline import measure

pytestmark = pytest.mark.usefixtures("one_thread")

DEVICES = (C1, C2, PROJECTOR)


def with_kicked(names: str, seed: int) -> tuple[Device, ...]:
    return tuple(
        kicked(device, seed + number) if device.name in names.split() else device
        for number, device in enumerate(DEVICES)
    )


@pytest.mark.parametrize("angles", [BOTH, ONE])
@pytest.mark.parametrize("name", ["c1", "c2", "projector"])
def test_the_device_that_moved_is_named(name: str, angles: tuple[float, ...]) -> None:
    cloud = seen(points_in_space(3000, 5), angles, noise_px=0.05)
    moved = which_moved([cloud], with_kicked(name, 1))
    assert moved.device == name
    assert moved.movers[0].turn_deg == pytest.approx(0.05, rel=0.05)
    assert moved.residual_px > 5 * moved.left_px
    assert f"device '{name}' has moved" in moved_text(moved)


def test_two_that_moved_are_not_one() -> None:
    for angles in (BOTH, ONE):
        cloud = seen(points_in_space(3000, 5), angles, noise_px=0.05)
        moved = which_moved([cloud], with_kicked("c2 projector", 3))
        assert moved.device is None
        assert "which is not determined" in moved_text(moved)


def test_wrong_lenses_are_no_move() -> None:
    cloud = seen(points_in_space(3000, 5), BOTH, noise_px=0.05)
    bent = replace(C2, distortion=C2.distortion + np.r_[0.3, -0.8, np.zeros(12)])
    longer = replace(PROJECTOR, focal_px=PROJECTOR.focal_px * [1.01, 0.99])
    moved = which_moved([cloud], (C1, bent, longer))
    assert moved.device is None
    assert "no poses bring the devices together" in moved_text(moved)


def test_measure_says_that_devices_moved(rig: Rig, recording: Recording) -> None:
    scan, _ = recording
    assert rig.projector is not None
    good = measure(replace(scan, rig=rig))
    assert not any(f.name == "moved_px" for f in good.findings)
    moved = replace(rig, projector=kicked(rig.projector, 5))
    result = measure(replace(scan, rig=moved))
    told = [f for f in result.warnings if f.name == "moved_px"]
    assert len(told) == 1
    assert "moved since the calibration" in told[0].text
    assert told[0].value > 0.5
