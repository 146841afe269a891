"""The bias in the rig file, in the findings, and learnt for a rig."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from changed_rigs import turned
from closed_form import Recording, demo_rig
from closed_phases import grid_of
from cv_lens import cv_project
from fringe3d.errors import MethodError, RigError
from fringe3d.health import check_bias, check_evidence
from fringe3d.io.rigfile import fingerprint, read_rig, rig_text
from fringe3d.model import (
    CalibrationBias,
    Correspondences,
    Fringe,
    ImageStack,
    PatternPlan,
    Rejection,
    Rig,
    Scan,
)
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.rig_bias import learn_rig_bias

WIDTH, HEIGHT = 320, 256


@pytest.fixture
def biased(rig: Rig) -> Rig:
    """Return a rig with a bias of crooked numbers."""
    rng = np.random.default_rng(1)
    root = rng.uniform(-0.1, 0.1, (18, 18))
    bias = CalibrationBias(
        coefficients_px=rng.uniform(-0.3, 0.3, (2, 9)),
        middle=np.array([159.5, 127.5, 1000 / 3]),
        scale=np.array([160.0, 128.0, 20 / 3]),
        scatter_px=0.1 / 3,
        sigma_px=0.2 / 3,
        covariance_px2=root @ root.T + 1e-3 * np.eye(18),
        angle=0.7,
        source='a mask, "one half"',
    )
    return replace(rig, bias=bias)


def write(rig: Rig, folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the rig file, with some of its text replaced."""
    path, text = folder / "rig.toml", rig_text(rig)
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


# --- the file ------------------------------------------------------------------------------------


def test_the_file_gives_the_bias_back(biased: Rig, tmp_path: Path) -> None:
    found, bias = read_rig(write(biased, tmp_path)).bias, biased.bias
    assert found is not None
    assert bias is not None
    np.testing.assert_array_equal(found.coefficients_px, bias.coefficients_px)
    np.testing.assert_array_equal(found.middle, bias.middle)
    np.testing.assert_array_equal(found.scale, bias.scale)
    assert (found.scatter_px, found.sigma_px) == (bias.scatter_px, bias.sigma_px)
    assert found.covariance_px2 is not None
    assert bias.covariance_px2 is not None
    np.testing.assert_allclose(found.covariance_px2, bias.covariance_px2, rtol=1e-8)
    assert found.angle == pytest.approx(bias.angle, abs=1e-15)  # degrees in the file
    assert found.source == bias.source
    assert rig_text(read_rig(write(biased, tmp_path))) == rig_text(biased)


def test_a_rig_without_a_bias_has_no_table(rig: Rig, tmp_path: Path) -> None:
    assert "[bias]" not in rig_text(rig)
    assert read_rig(write(rig, tmp_path)).bias is None


def test_a_bias_of_other_devices_is_refused(biased: Rig, tmp_path: Path) -> None:
    own, others = fingerprint(biased.devices), "0123456789abcdef"
    path = write(biased, tmp_path, (own, others))
    with pytest.raises(RigError) as refused:
        read_rig(path)
    text = str(refused.value)
    assert str(path) in text
    assert f"learnt with the devices of this file ({own})" in text
    assert f"found one of other devices ({others})" in text
    assert "fringe3d calibrate bias" in text


def test_the_fingerprint_knows_every_number_of_every_device(rig: Rig) -> None:
    own, devices = fingerprint(rig.devices), rig.devices
    assert own == fingerprint(demo_rig(camera_size=(WIDTH, HEIGHT)).devices)
    assert len(own) == 16
    seen = {own, fingerprint(devices[:2]), fingerprint(devices[::-1])}
    tiny = 1e-9 * np.eye(14)
    for i, device in enumerate(devices):
        pose = device.device_from_world
        for other in (
            replace(device, focal_px=device.focal_px + tiny[0, :2]),
            replace(device, focal_px=device.focal_px + tiny[1, :2]),
            replace(device, center_px=device.center_px + tiny[0, :2]),
            replace(device, distortion=device.distortion + tiny[4]),
            replace(device, n_cols=device.n_cols + 1),
            replace(device, n_rows=device.n_rows + 1),
            replace(device, device_from_world=replace(
                pose, translation=pose.translation + tiny[2, :3])),
            turned(device, "z", 1e-6),
        ):  # fmt: skip
            seen.add(fingerprint([*devices[:i], other, *devices[i + 1 :]]))
    assert len(seen) == 3 + 3 * 8


def test_the_fingerprint_does_not_know_volume_and_names(biased: Rig, tmp_path: Path) -> None:
    cameras = tuple(replace(c, name=f"left {c.name}") for c in biased.cameras)
    named = replace(biased, volume=None, provenance="another", cameras=cameras)
    assert read_rig(write(named, tmp_path)).bias is not None


@pytest.mark.parametrize("by", [-1, 1])
def test_a_wrong_number_of_coefficients_is_refused(biased: Rig, tmp_path: Path, by: int) -> None:
    assert biased.bias is not None
    last = f", {float(biased.bias.coefficients_px[1, -1])!r}"
    path = write(biased, tmp_path, (last, "" if by < 0 else f"{last}, 0.1"))
    with pytest.raises(RigError) as refused:
        read_rig(path)
    text = str(refused.value)
    assert str(path) in text
    assert "bias.coefficients_px" in text
    assert f"at {'least' if by < 0 else 'most'} 9 entries" in text


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("scatter_px", "-0.1", "scatter_px"),
        ("sigma_px", "-0.1", "sigma_px"),
        ("scale", "[160.0, 0.0, 6.0]", "scale: expected numbers > 0"),
        ("middle", "[160.0, 128.0]", "middle"),
        ("angle_deg", "nan", "angle"),
    ],
)
def test_wrong_values_are_refused(
    biased: Rig, tmp_path: Path, key: str, value: str, text: str
) -> None:
    line = next(t for t in rig_text(biased).split("[bias]")[1].splitlines() if t.startswith(key))
    path = write(biased, tmp_path, (line, f"{key} = {value}"))
    with pytest.raises(RigError, match=text):
        read_rig(path)


# --- findings ------------------------------------------------------------------------------------


def constant(x_px: float, y_px: float, *, angle: float = 0.0) -> CalibrationBias:
    coefficients = np.zeros((2, 9))
    coefficients[:, 0] = x_px, y_px
    return CalibrationBias(coefficients_px=coefficients, middle=np.array([160.0, 128.0, 335.0]),
                           scale=np.array([160.0, 128.0, 20.0]), angle=angle)  # fmt: skip


def test_no_bias_no_finding() -> None:
    assert check_bias(None, None) == []
    assert check_bias(None, constant(0.1, 0.2)) == []


def test_the_size_of_the_bias_is_told() -> None:
    stored = constant(0.3, -0.4)
    (finding,) = check_bias(stored, stored)
    assert (finding.level, finding.name) == ("ok", "calibration_bias_px")
    assert finding.value == pytest.approx(0.5)
    assert "stored with the rig" in finding.text
    assert "0.50 px" in finding.text
    (refined,) = check_bias(constant(0.3, -0.39), stored)
    assert "stored with the rig, refined by these images" in refined.text
    (learnt,) = check_bias(constant(0.9, 1.2), None)
    assert learnt.level == "warning"
    assert learnt.value == pytest.approx(1.5)
    assert "learnt from these images" in learnt.text
    assert "calibrate again" in learnt.text


def test_the_bias_is_looked_at_where_it_holds() -> None:
    """Rising to 0.6 px at the border: the mean of x^2 in the middles of five strips."""
    coefficients = np.zeros((2, 9))
    coefficients[0, 1] = 0.6
    (finding,) = check_bias(replace(constant(0, 0), coefficients_px=coefficients), None)
    assert finding.value == pytest.approx(0.6 * np.sqrt(0.32))


def test_a_bias_of_other_fringes_is_left_out_and_told() -> None:
    used, stored = constant(0.1, 0.0), constant(0.1, 0.0, angle=np.pi / 2)
    first, left_out = check_bias(used, stored)
    assert first.level == "ok"
    assert "learnt from these images" in first.text
    assert (left_out.level, left_out.name) == ("warning", "bias_left_out")
    assert "belongs to fringes at 90.0 degrees; these lie at 0.0" in left_out.text
    assert "calibrate bias" in left_out.text


def matches_of(n_accepted: int, n_ambiguous: int, n_hidden: int) -> Correspondences:
    rejection = np.zeros((1, n_accepted + n_ambiguous + n_hidden), np.uint16)
    rejection[0, n_accepted:] = np.uint16(Rejection.NO_MATCH)
    rejection[0, n_accepted : n_accepted + n_ambiguous] = np.uint16(Rejection.AMBIGUOUS)
    nothing = np.full(rejection.shape, np.nan)
    xy = np.full((*rejection.shape, 2), np.nan)
    return Correspondences(
        device_name="c2",
        pixels_c1=xy,
        pixels=xy,
        sigma_px=nothing,
        epipolar_residual_px=nothing,
        fringe_order=np.zeros(rejection.shape, np.int32),
        rejection=rejection,
    )


@pytest.mark.parametrize(("n_ambiguous", "level"), [(0, "ok"), (4, "ok"), (6, "warning")])
def test_open_orders_are_told(n_ambiguous: int, level: str) -> None:
    (finding,) = check_evidence(matches_of(100 - n_ambiguous, n_ambiguous, 500), 1)
    assert (finding.level, finding.name) == (level, "undecided_part")
    assert finding.value == pytest.approx(n_ambiguous / 100)
    assert ("AMBIGUOUS" in finding.text) == (level == "warning")


@pytest.mark.parametrize(("shift", "bit"), [(1, 0), (2, 1), (3, 0), (4, 2), (0, None)])
def test_what_would_tell_the_rivals_apart(shift: int, bit: int | None) -> None:
    """A cyclic Gray code's finest image changes with every period, the next with every second."""
    (finding,) = check_evidence(matches_of(0, 10, 0), shift)
    assert (f"{shift} period(s) apart" in finding.text) == (shift > 0)
    if bit is not None:
        assert f"image {bit} (0 is the finest)" in finding.text
    assert "calibrate bias" in finding.text
    (finding,) = check_evidence(matches_of(0, 10, 0), shift, has_bias=True)
    assert "calibrate bias" not in finding.text


@pytest.mark.parametrize(
    ("now", "largest", "told"), [(30, 4, ("30.0", "4.0")), (3, 4, ("3.0",)), (30, 0, ("30.0",))]
)
def test_which_angle_would_tell(now: float, largest: float, told: tuple[str, ...]) -> None:
    (finding,) = check_evidence(
        matches_of(0, 10, 0), 1, angles=lambda: (np.radians(now), np.radians(largest))
    )
    assert re.findall(r"(\d+\.\d) (?:degrees|or less)", finding.text) == list(told)


def test_nothing_matched_is_no_doubt() -> None:
    (finding,) = check_evidence(matches_of(0, 0, 10), 0)
    assert (finding.level, finding.value) == ("ok", 0.0)


# --- learning ------------------------------------------------------------------------------------


def scan_of(rig: Rig, n_stacks: int = 2, *, angle: float = 0.0) -> Scan:
    """Return four images without any light."""
    plan = PatternPlan(patterns=tuple(Fringe(period_px=16.0, shift=k * np.pi / 2, angle=angle)
                                      for k in range(4)))  # fmt: skip
    stacks = tuple(
        ImageStack(images=np.full((4, HEIGHT, WIDTH), 5, np.uint8), plan=plan,
                   saturation_dn=255.0, device_name=rig.cameras[i].name)
        for i in range(n_stacks)
    )  # fmt: skip
    return Scan(stacks=stacks, rig=rig, title="a dark room")


@pytest.mark.parametrize(
    ("missing", "found"),
    [
        ("camera", "1 camera(s), a projector and a volume"),
        ("projector", "2 camera(s), no projector and a volume"),
        ("volume", "2 camera(s), a projector and no volume"),
    ],
)
def test_a_rig_that_lacks_something_is_refused(rig: Rig, missing: str, found: str) -> None:
    poor = {
        "camera": replace(rig, cameras=rig.cameras[:1]),
        "projector": replace(rig, projector=None),
        "volume": replace(rig, volume=None),
    }[missing]
    with pytest.raises(MethodError, match="calibrate bias: expected a rig with two cameras") as bad:
        learn_rig_bias([scan_of(rig)], poor)
    assert f"found {found}. Add what is missing" in str(bad.value)


def test_a_scan_of_one_camera_is_refused(rig: Rig) -> None:
    with pytest.raises(MethodError, match=r"scan 'a dark room': .*two cameras, found 1\. Record"):
        learn_rig_bias([scan_of(rig, 1)], rig)


def test_scans_of_other_cameras_or_fringes_are_refused(rig: Rig) -> None:
    """A bias belongs to the first two cameras, and to one direction."""
    scan = scan_of(rig)
    swapped = replace(scan, stacks=scan.stacks[::-1])
    with pytest.raises(MethodError, match=r"expected images of 'c1' and 'c2' first, .*'c2' and"):
        learn_rig_bias([scan, swapped], rig)
    with pytest.raises(MethodError, match=r"expected fringes at 0 deg as .*, found 30 deg"):
        learn_rig_bias([scan, scan_of(rig, angle=np.radians(30))], rig)


def test_a_bias_is_left_out_for_another_pair_of_cameras(recording: Recording) -> None:
    """With C1 and C2 exchanged it is learnt anew, and no warning is due."""
    scan = recording[0]
    assert scan.rig is not None
    far_off = replace(learn_rig_bias([scan], scan.rig).bias, scatter_px=0.0)
    coefficients = far_off.coefficients_px.copy()
    coefficients[:, 0] += 5.0
    rig = replace(scan.rig, bias=replace(far_off, coefficients_px=coefficients))
    exchanged = measure(
        replace(scan, stacks=scan.stacks[::-1], rig=rig), MeasureOptions(method="m2")
    )
    assert exchanged.bias is not None
    assert exchanged.bias.rms_px < 0.5


def test_a_dark_room_tells_nothing(rig: Rig) -> None:
    with pytest.raises(MethodError, match="calibrate bias: expected a surface whose fringe orders"):
        learn_rig_bias([scan_of(rig)], rig)


def test_a_turned_camera_is_learnt(recording: Recording) -> None:
    """Of the recording of a sphere before a plane, with the calibration wrong by 0.2 px."""
    scan, (truth, _) = recording
    assert scan.rig is not None
    c1, c2 = scan.rig.cameras
    wrong = replace(scan.rig, cameras=(c1, turned(c2, "y", 0.01)))
    steps: list[tuple[str, int, int]] = []
    learnt = learn_rig_bias([scan], wrong, step=lambda *now: steps.append(now))
    assert learnt.certainty > 0.99
    assert learnt.decided_part > 0.99
    assert learnt.bias.source == scan.title
    assert learnt.bias.angle == 0.0
    assert steps == [("preparing recordings", 0, 1), ("preparing recordings", 1, 1)]
    missed = cv_project(wrong.cameras[1], truth.points_mm) - cv_project(c2, truth.points_mm)
    assert np.abs(missed[..., 0]).mean() > 0.15
    origin = -c1.device_from_world.rotation.T @ c1.device_from_world.translation
    depths = np.linalg.norm(truth.points_mm - origin, axis=-1)
    lit = truth.lit & (np.abs(grid_of(c1) - [160, 128]) < [130, 100]).all(axis=-1)
    found = learnt.bias.displacement(grid_of(c1)[lit], depths[lit])
    # Vertical fringes show the displacement across them, in C2 nearly that in x.
    assert np.abs(found[:, 0] - missed[lit, 0]).max() < 0.06


# --- measuring with it ---------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, np.pi / 2])
def test_a_measurement_takes_the_bias_of_its_fringes_alone(
    recording: Recording, angle: float
) -> None:
    scan = recording[0]
    assert scan.rig is not None
    stored = constant(0.01, 0.0, angle=angle)
    biased = replace(scan, rig=replace(scan.rig, bias=stored))
    result = measure(biased, MeasureOptions(method="m6"))
    assert result.bias is not None
    assert (result.bias is stored) == (angle == 0.0)
    assert result.bias.angle == 0.0
    assert any(f.name == "bias_left_out" for f in result.findings) == (angle != 0.0)


def test_a_measurement_without_a_bias_learns_it(recording: Recording) -> None:
    scan, (truth, _) = recording
    assert scan.rig is not None
    c1, c2 = scan.rig.cameras
    wrong = replace(scan.rig, cameras=(c1, turned(c2, "y", 0.01)))
    result = measure(replace(scan, rig=wrong), MeasureOptions(method="m6"))
    assert result.bias is not None
    missed = cv_project(wrong.cameras[1], truth.points_mm) - cv_project(c2, truth.points_mm)
    at = np.array([[160.0, 128.0]])
    found = result.bias.displacement(at, np.array([335.0]))[0, 0]
    assert found == pytest.approx(missed[128, 160, 0], abs=0.06)
