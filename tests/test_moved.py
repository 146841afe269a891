"""Which device moved: against OpenCV's projections of a rig of which one device was kicked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_self_calibration import BOTH, ONE, kicked, points_in_space, seen

from board_series import C1, C2, PROJECTOR
from closed_form import Recording
from fringe3d.calibrate import contradiction, expected_contradiction, moved_text, which_moved
from fringe3d.errors import EmptyResultError
from fringe3d.model import Device, Rig, RigCovariance, RigidTransform
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


def test_points_that_tell_no_more_than_their_depth_contradict_nothing() -> None:
    """Not a number would pass any limit; a plane that two devices hardly saw was such a case."""
    cloud = seen(points_in_space(300, 5), ONE, noise_px=0.05)
    sights = tuple(replace(s, ahead_px=np.full_like(s.ahead_px, np.nan)) for s in cloud.sights)
    with pytest.raises(EmptyResultError, match="more than their depth"):
        contradiction([replace(cloud, sights=sights)], DEVICES)


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


def test_the_limit_follows_from_the_covariance_of_the_calibration(
    rig: Rig, recording: Recording
) -> None:
    """A fifth of a usual knock: below 0.5 px, but far more than what the calibration may miss."""
    scan, _ = recording
    assert rig.projector is not None
    names = [f"{d.name}.{n}" for d in rig.devices for n in ("cx", "cy", "turn_z")]
    sigma = np.array([0.05, 0.05, 1e-5] * len(rig.devices))
    known = RigCovariance(names=tuple(names), matrix=np.diag(sigma**2))
    poorly = RigCovariance(names=tuple(names), matrix=np.diag((10 * sigma) ** 2))
    moved = replace(rig, projector=kicked(rig.projector, 5, deg=0.01, mm=0.02))
    for found, is_told in (
        (replace(rig, covariance=known), False),
        (replace(moved, covariance=known), True),
        (replace(moved, covariance=poorly), False),
        (moved, False),
    ):
        findings = measure(replace(scan, rig=found)).findings
        by_name = {f.name: f for f in findings}
        assert ("moved_px" in by_name) == is_told
        assert is_told == any(f.level != "ok" and "moved" in f.text for f in findings)
        if found.covariance is not None and not is_told:
            assert by_name["contradiction_px"].level == "ok"


def test_the_expected_contradiction_is_that_of_sampled_calibrations() -> None:
    """Devices drawn from the covariance; what calibration and noise add is counted together."""
    cloud = seen(points_in_space(400, 5), BOTH, noise_px=0.05)
    rng = np.random.default_rng(0)
    names = [f"{d.name}.{n}" for d in DEVICES for n in ("fx", "cx", "k1")]
    names += [f"{d.name}.{n}" for d in DEVICES[1:] for n in ("turn_y", "shift_z")]
    sigma = np.array([0.5, 0.3, 1e-3] * 3 + [1e-4, 0.05] * 2)
    mixed = np.eye(len(names)) + 0.3 * rng.normal(size=(len(names), len(names)))
    root = sigma[:, None] * mixed
    covariance = RigCovariance(names=tuple(names), matrix=root @ root.T)
    found = []
    for _ in range(60):
        drawn = dict(zip(names, root @ rng.normal(size=len(names)), strict=True))
        found.append(contradiction([cloud], [drawn_device(d, drawn) for d in DEVICES]))
    typical = float(np.sqrt(np.mean(np.square(found))))
    assert expected_contradiction(cloud, DEVICES, covariance) == pytest.approx(typical, rel=0.15)


def drawn_device(own: Device, change: dict[str, float]) -> Device:
    def get(*numbers: str) -> NDArray[np.float64]:
        return np.array([change.get(f"{own.name}.{n}", 0.0) for n in numbers])

    turn = Rotation.from_rotvec(get("turn_x", "turn_y", "turn_z")).as_matrix()
    small = RigidTransform(rotation=turn, translation=get("shift_x", "shift_y", "shift_z"))
    return replace(
        own,
        focal_px=own.focal_px + get("fx", "fy"),
        center_px=own.center_px + get("cx", "cy"),
        distortion=own.distortion + np.r_[get("k1"), np.zeros(len(own.distortion) - 1)],
        device_from_world=small @ own.device_from_world,
    )
