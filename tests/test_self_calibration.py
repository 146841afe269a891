"""Poses from measurements without a target, against OpenCV's projections and simulated scans."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from board_series import C1, C2, PROJECTOR
from cv_lens import cv_project, cv_rays
from fringe3d.calibrate import (
    Homologous,
    Sight,
    ball_center,
    check_poses,
    compare_rigs,
    fit_poses,
    form_covariance,
    located,
)
from fringe3d.cli.run import main
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.evaluate import fit_plane
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Device, Fringe, Rig, RigCovariance, RigidTransform
from fringe3d.model.covariance import POSE_NUMBERS
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure
from fringe3d.self_calibration import KnownLength, distance_of, self_calibrate

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

BOTH, ONE = (0.0, math.pi / 2), (0.0,)


def kicked(device: Device, seed: int, *, deg: float = 0.05, mm: float = 0.1) -> Device:
    """Return a device turned and shifted by so much in a random direction."""
    rng = np.random.default_rng(seed)
    turn, shift = rng.normal(size=3), rng.normal(size=3)
    turn, shift = (
        np.radians(deg) * turn / np.linalg.norm(turn),
        mm * shift / np.linalg.norm(shift),
    )
    kick = RigidTransform(rotation=Rotation.from_rotvec(turn).as_matrix(), translation=shift)
    return replace(device, device_from_world=kick @ device.device_from_world)


def points_in_space(n: int, seed: int, *, depth_mm: float = 60.0) -> Floats:
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([100, 100], [1180, 924], (n, 2))
    origin, directions = cv_rays(C1, pixels)
    return np.asarray(origin + rng.uniform(570 - depth_mm, 570 + depth_mm, (n, 1)) * directions)


def seen(
    points: Floats,
    angles: tuple[float, ...],
    *,
    devices: tuple[Device, ...] = (C1, C2, PROJECTOR),
    noise_px: float = 0.0,
    seed: int = 0,
) -> Homologous:
    """Return what true devices see of points: w grows linearly around each pixel of C2.

    Each pixel of C2 stands a little beside the true one, as the search on a wrong curve leaves it.
    """
    rng = np.random.default_rng(seed)
    axes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    w = (cv_project(PROJECTOR, points) + 0.5) @ axes.T
    n, k = w.shape
    sights = []
    for device in devices[1:]:
        if device.role == "projector":
            continue
        slopes = rng.normal(0, 0.1, (n, k, 2)) + 0.9 * axes
        beside = rng.normal(0, 1.0, (n, 2))
        ahead = np.einsum("nka,na->nk", slopes, beside) + rng.normal(0, noise_px, (n, k))
        sights.append(
            Sight(device=device.name, pixels=cv_project(device, points) + beside, ahead_px=ahead,
                  slopes=slopes, sigma_px=np.full((n, k), max(noise_px, 0.01)))
        )  # fmt: skip
    noisy = w + rng.normal(0, noise_px, (n, k))
    # A sight is relative to what C1 sees, so the noise of C1 is in it, too.
    sights = [replace(s, ahead_px=s.ahead_px - (noisy - w)) for s in sights]
    return Homologous(
        pixels_c1=cv_project(C1, points), angles=angles, position_px=noisy,
        sigma_px=np.full((n, k), max(noise_px, 0.01)), sights=tuple(sights),
    )  # fmt: skip


def with_distance_of(devices: tuple[Device, ...], like: tuple[Device, ...]) -> tuple[Device, ...]:
    """Return true devices in a world scaled so that C1 and the next stand apart as in `like`."""
    apart = [float(np.linalg.norm(d[1].center_world - d[0].center_world)) for d in (devices, like)]
    factor = apart[1] / apart[0]
    grown = []
    for device in devices:
        pose = device.device_from_world
        center = devices[0].center_world + factor * (device.center_world - devices[0].center_world)
        grown.append(
            replace(device, device_from_world=RigidTransform(
                rotation=pose.rotation, translation=-pose.rotation @ center))
        )  # fmt: skip
    return tuple(grown)


def pose_errors(found: tuple[Device, ...], true: tuple[Device, ...]) -> Floats:
    """Return turn (rad) and shift (mm) between found and true, for each free device."""
    off = [
        a.device_from_world @ b.device_from_world.inverse()
        for a, b in zip(found[1:], true[1:], strict=True)
    ]
    return np.concatenate(
        [np.r_[Rotation.from_matrix(o.rotation).as_rotvec(), o.translation] for o in off]
    )


def test_two_directions_restore_all_poses_up_to_scale() -> None:
    former = (C1, kicked(C2, 1, deg=0.3, mm=1.0), kicked(PROJECTOR, 2, deg=0.3, mm=1.0))
    fitted = fit_poses([seen(points_in_space(4000, 0), BOTH)], former)
    true = with_distance_of((C1, C2, PROJECTOR), former)
    errors = pose_errors(fitted.devices, true)
    assert np.abs(errors.reshape(-1, 6)[:, :3]).max() < 1e-5
    assert np.abs(errors.reshape(-1, 6)[:, 3:]).max() < 0.01
    assert fitted.is_determined
    assert fitted.n_numbers == 11
    assert fitted.residual_before_px > 1 > 0.01 > fitted.residual_px
    found = {f"{c.device}.{c.number}": c.value for c in fitted.changes}
    kick = pose_errors(fitted.devices, former)
    assert found["projector.turn_z"] == pytest.approx(kick[8])
    points = located(seen(points_in_space(50, 3), BOTH), fitted.devices)
    factor = np.linalg.norm(former[1].center_world) / np.linalg.norm(C2.center_world)
    np.testing.assert_allclose(points, factor * points_in_space(50, 3), atol=0.02)


def test_errors_of_the_numbers_are_what_their_sigmas_say() -> None:
    """The noise of C1 is shared by projector and C2; scatter of the pulls over 12 sets of points.

    Neighbours' common errors, of which there are none here, are counted in, so pulls are below 1.
    """
    former = (C1, kicked(C2, 1), kicked(PROJECTOR, 2))
    true = with_distance_of((C1, C2, PROJECTOR), former)
    pulls = []
    for seed in range(12):
        cloud = seen(points_in_space(600, seed), BOTH, noise_px=0.1, seed=seed)
        fitted = fit_poses([cloud], former)
        sigma = np.array([c.sigma for c in fitted.changes])
        pulls.append(pose_errors(fitted.devices, true) / sigma * math.sqrt(fitted.crowding))
    assert 0.85 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.15


def test_poses_found_with_wrong_lenses_have_the_covariance_of_sampled_calibrations() -> None:
    """Calibrations drawn from a covariance, devices that moved, poses found again with what the
    lenses are thought to be; 40 draws: sigmas to 11 %.

    Neighbours' common errors are not made, and the factor for them is counted back.
    """
    true = (C1, C2, PROJECTOR)
    lens = {"fx": 1.0, "fy": 1.0, "cx": 1.5, "cy": 1.5, "k1": 2e-3}
    pose = dict.fromkeys(POSE_NUMBERS[:3], 2e-4) | dict.fromkeys(POSE_NUMBERS[3:], 0.1)
    sigma = {f"{d.name}.{number}": value for d in true
             for number, value in (lens if d.name == "c1" else lens | pose).items()}  # fmt: skip
    names, size = tuple(sigma), np.array(list(sigma.values()))
    known = RigCovariance(names=names, matrix=np.diag(size**2))
    cloud = seen(points_in_space(600, 0), BOTH, noise_px=0.02)
    spots = points_in_space(60, 1)
    rng, off, form = np.random.default_rng(4), [], []
    for draw in range(40):
        error = dict(zip(names, rng.normal(0, size), strict=True))
        former = tuple(wrong(d, {n.rpartition(".")[2]: e for n, e in error.items()
                                 if n.startswith(f"{d.name}.")}) for d in true)  # fmt: skip
        fitted = fit_poses([cloud], former, known=known if draw == 39 else None)
        numbers = [n for d in true[1:] for n in (f"{d.name}.{p}" for p in POSE_NUMBERS)]
        off.append(pose_errors(fitted.devices, true))
        form.append(form_error(fitted.devices, true, spots))
    joint = fitted.joint
    assert joint is not None
    expected = np.array([joint.sigma(number) for number in numbers])
    ratio = np.sqrt(np.mean(np.square(off), axis=0)) / expected
    assert 0.7 < ratio.min() <= ratio.max() < 1.35  # each to 11 %, a dozen of them
    alone = form_covariance(true[:2], joint, spots)
    expected_form = float(np.sqrt(np.trace(alone, axis1=1, axis2=2).mean()))
    assert float(np.sqrt(np.mean(np.square(form)))) == pytest.approx(expected_form, rel=0.3)


def wrong(device: Device, errors: dict[str, float]) -> Device:
    """Return a device with errors of its numbers, as `RigCovariance` says."""

    def get(*names: str) -> list[float]:
        return [errors.get(name, 0.0) for name in names]

    distortion = device.distortion.copy()
    distortion[0] += errors.get("k1", 0.0)
    turn = Rotation.from_rotvec(get(*POSE_NUMBERS[:3])).as_matrix()
    small = RigidTransform(rotation=turn, translation=get(*POSE_NUMBERS[3:]))
    return replace(
        device,
        focal_px=device.focal_px + get("fx", "fy"),
        center_px=device.center_px + get("cx", "cy"),
        distortion=distortion,
        device_from_world=small @ device.device_from_world,
    )


def form_error(found: tuple[Device, ...], true: tuple[Device, ...], spots: Floats) -> float:
    """Return the rms of what a motion and a scale leave of points that two cameras place, mm."""
    rigs = [Rig(cameras=devices[:2]) for devices in (found, true)]
    return compare_rigs(rigs[0], rigs[1], spots).form_rms_mm


def test_one_direction_leaves_the_projector_open_along_its_fringes_and_says_so() -> None:
    former = (C1, kicked(C2, 1), kicked(PROJECTOR, 2))
    fitted = fit_poses([seen(points_in_space(6000, 0), ONE, noise_px=0.02)], former)
    assert fitted.n_determined < fitted.n_numbers
    held = {f"{c.device}.{c.number}" for c in fitted.changes if c.held_by == "former"}
    assert "projector.shift_y" in held
    assert "c2.turn_z" not in held
    assert fitted.residual_px < 0.05 < 1 < fitted.residual_before_px
    assert "projector.shift_y" in check_poses(fitted)[-1].text


def test_a_small_plane_leaves_more_open_than_points_all_over() -> None:
    former = (C1, kicked(C2, 1), kicked(PROJECTOR, 2))
    middle = cv_rays(C1, np.random.default_rng(0).uniform([540, 412], [740, 612], (4000, 2)))
    flat = middle[0] + middle[1] * (570 / middle[1][:, 2:])
    small = fit_poses([seen(flat, ONE, noise_px=0.02)], former)
    space = fit_poses([seen(points_in_space(4000, 0), ONE, noise_px=0.02)], former)
    assert small.n_determined <= 8 < space.n_determined
    assert "the former calibration holds" in check_poses(small)[-1].text


def test_one_camera_finds_its_projector_by_two_directions() -> None:
    former = (C1, kicked(PROJECTOR, 2))
    cloud = seen(points_in_space(4000, 0), BOTH, devices=(C1, PROJECTOR))
    fitted = fit_poses([cloud], former)
    errors = pose_errors(fitted.devices, with_distance_of((C1, PROJECTOR), former))
    assert np.abs(errors[:3]).max() < 1e-4
    assert np.abs(errors[3:]).max() < 0.05
    assert fitted.n_numbers == 5


def test_two_cameras_without_projector_need_two_directions() -> None:
    former = (C1, kicked(C2, 1))
    cloud = seen(points_in_space(4000, 0), BOTH)
    fitted = fit_poses([cloud], former)
    assert np.abs(pose_errors(fitted.devices, with_distance_of((C1, C2), former))[:3]).max() < 1e-4
    with pytest.raises(EmptyResultError, match="several devices"):
        fit_poses([seen(points_in_space(4000, 0), ONE)], former)


def test_a_third_camera_is_found_with_the_others() -> None:
    c3 = replace(C2, name="c3", device_from_world=PROJECTOR.device_from_world)
    true = (C1, C2, c3, PROJECTOR)
    former = (C1, kicked(C2, 1), kicked(c3, 3), kicked(PROJECTOR, 2))
    fitted = fit_poses([seen(points_in_space(3000, 0), BOTH, devices=true)], former)
    errors = pose_errors(fitted.devices, with_distance_of(true, former)).reshape(-1, 6)
    assert np.abs(errors[:, :3]).max() < 2e-5
    assert np.abs(errors[:, 3:]).max() < 0.02
    assert fitted.n_numbers == 17


def test_wrong_points_do_not_pull() -> None:
    former = (C1, kicked(C2, 1), kicked(PROJECTOR, 2))
    cloud = seen(points_in_space(4000, 0), BOTH, noise_px=0.02)
    position = cloud.position_px.copy()
    position[::20] += 16.0
    fitted = fit_poses([replace(cloud, position_px=position)], former)
    true = with_distance_of((C1, C2, PROJECTOR), former)
    pulls = pose_errors(fitted.devices, true) / [c.sigma for c in fitted.changes]
    assert np.abs(pulls).max() < 4


def test_points_that_no_poses_bring_together_are_told() -> None:
    cloud = seen(points_in_space(2000, 0), BOTH, noise_px=0.02)
    wild = np.random.default_rng(0).normal(0, 2.0, cloud.position_px.shape)
    fitted = fit_poses([replace(cloud, position_px=cloud.position_px + wild)], (C1, C2, PROJECTOR))
    found = check_poses(fitted)[0]
    assert found.level == "warning"
    assert "no poses bring them together" in found.text


# Simulated scans ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("embreex")
    folder = tmp_path_factory.mktemp("own-poses")
    for thing in ("machine-part", "plane"):
        main(["simulate", "kolibri", "--object", thing, "--plan", "m0", "--camera-size", "320x256",
              "--rays", "1", "--out", str(folder / thing)])  # fmt: skip
    rig = read_rig(folder / "plane" / "rig.toml")
    assert rig.projector is not None
    moved = replace(
        rig,
        cameras=(rig.cameras[0], kicked(rig.cameras[1], 3)),
        projector=kicked(rig.projector, 4),
    )
    from fringe3d.io.rigfile import rig_text

    (folder / "moved.toml").write_text(rig_text(moved))
    return folder


def plane_sigma(folder: Path, rig: Rig) -> float:
    """Return the standard deviation of the plane's top, without 3 permille of the points, mm."""
    from fringe3d.io.recording import read_scan

    scan = read_scan(folder / "plane")
    result: Measurement = measure(replace(scan, rig=rig), MeasureOptions(direction="x"))
    assert result.points is not None
    truth = np.load(folder / "plane" / "truth.npz")
    top = truth["is_object"] & (truth["normals"][..., 2] > 0.99) & truth["lit"]
    top[:3], top[-3:], top[:, :3], top[:, -3:] = False, False, False, False
    inner = top.copy()
    for axis in (0, 1):
        for step in (-3, 3):
            inner &= np.roll(top, step, axis)
    good = result.points.is_valid & inner
    assert good.sum() > 0.99 * inner.sum()
    return fit_plane(result.points.points_mm[good], rejected_part=0.003).sigma_mm


def test_scans_restore_the_sigma_of_a_plane(scans: Path) -> None:
    """Two directions to 5 %, one direction to 15 %, of what the true calibration gives."""
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "machine-part")
    true, moved = scan.rig, read_rig(scans / "moved.toml")
    assert true is not None
    best = plane_sigma(scans, true)
    names = ("c1.fx", "c1.cx", "c2.fx", "c2.cx", "c2.turn_y", "c2.shift_x")
    known = RigCovariance(names=names, matrix=np.diag(np.array([1, 1, 1, 1, 1e-4, 0.1]) ** 2))
    both = self_calibrate([scan], replace(moved, covariance=known))
    assert both.rig.covariance is not None
    assert both.rig.covariance.sigma("c1.fx") == pytest.approx(1.0)  # lenses stay
    assert both.rig.covariance.sigma("projector.turn_x") > 0
    assert both.n_directions == 2
    assert both.fitted.is_determined
    assert plane_sigma(scans, both.rig) < 1.05 * best
    one = self_calibrate([scan], moved, MeasureOptions(direction="x"))
    assert one.n_directions == 1
    assert plane_sigma(scans, one.rig) < 1.15 * best


def test_four_images_without_a_code_find_poses_and_their_orders_again(
    scans: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fringe order is a quarter of a pixel; the moved rig sees points farther beside than that.

    With 4 rays a pixel M6 finds 88.5 % of what both cameras see with the true rig, 87.4 % here.
    """
    from fringe3d.io.recording import read_scan

    monkeypatch.setattr("fringe3d.pose_search.REACH_PX", 1.2)  # what this knock needs
    monkeypatch.setattr("fringe3d.self_calibration.ROUNDS", 2)
    scan, moved = read_scan(scans / "machine-part"), read_rig(scans / "moved.toml")
    options = MeasureOptions(method="m6", direction="x", gray_bits=0)
    found = self_calibrate([scan], moved, options)
    assert found.fitted.residual_before_px > 0.5
    assert found.fitted.residual_px < 0.05
    truth = np.load(scans / "machine-part" / "truth.npz")
    result = measure(replace(scan, rig=found.rig), options)
    assert result.matches is not None
    good = (result.rejection == 0) & truth["lit"]
    right = result.matches.fringe_order[good] == truth["fringe_order"][good]
    assert right.mean() > 0.99
    both_see = truth["lit"] & truth["in_volume"] & truth["seen_by_c2"]
    assert right.sum() > 0.86 * both_see.sum()


@pytest.mark.parametrize(("certainty", "words"), [
    (None, "one place of the devices, found none. The images have no code"),
    (0.6, r"found several \(the best is 60% likely\). The images have no code"),
])  # fmt: skip
def test_orders_that_fit_no_place_or_several_are_refused(
    scans: Path, monkeypatch: pytest.MonkeyPatch, certainty: float | None, words: str
) -> None:
    """What the search for orders says is made up; that it is heard is tested."""
    from fringe3d import self_calibration
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "plane")
    rig = read_rig(scans / "moved.toml")
    found = None if certainty is None else SimpleNamespace(certainty=certainty, rig=rig)
    monkeypatch.setattr(self_calibration, "fit_turned", lambda *_, **__: found)
    options = MeasureOptions(method="m6", direction="x", gray_bits=0)
    with pytest.raises(MethodError, match=words):
        self_calibrate([scan], rig, options)


def test_a_plane_without_a_code_is_refused(scans: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However sure the search is: with other poses a plane fits at other orders as well."""
    from fringe3d import self_calibration
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "plane")
    assert scan.rig is not None
    sure = SimpleNamespace(certainty=1.0, rig=scan.rig)
    monkeypatch.setattr(self_calibration, "fit_turned", lambda *_, **__: sure)
    monkeypatch.setattr(self_calibration, "ROUNDS", 1)
    options = MeasureOptions(method="m6", direction="x", gray_bits=0)
    with pytest.raises(MethodError, match=r"leave their common plane by 0\.\d%.*no code"):
        self_calibrate([scan], scan.rig, options)


def test_measure_finds_its_own_poses_and_leaves_them_with_the_result(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["measure", str(scans / "plane"), "--rig", str(scans / "moved.toml"), "--json", "--out"]
    main([*call, str(tmp_path / "own"), "--self-calibrate"])
    record = json.loads(capsys.readouterr().out)
    found = record["self_calibration"]
    assert found["residual_px"] < 0.1 < 1 < found["residual_before_px"]
    assert found["determined"] == 11
    health = {finding["name"]: finding["value"] for finding in record["health"]}
    assert health["trinocular_residual_px"] < 0.1
    assert "poses from" in record["rig"]["provenance"]
    own = read_rig(tmp_path / "own" / "rig.toml")
    assert own.projector is not None
    main(["calibrate", "self", "--from", str(scans / "plane"), "--rig", str(scans / "moved.toml"),
          "--out", str(tmp_path / "again.toml")])  # fmt: skip
    told = capsys.readouterr()
    assert "the data determine 11 of 11 numbers of the poses (scale: distance c1-c2)" in told.out
    again = read_rig(tmp_path / "again.toml")
    np.testing.assert_allclose(
        own.cameras[1].device_from_world.translation,
        again.cameras[1].device_from_world.translation,
    )


def test_a_known_length_gives_the_scale(scans: Path) -> None:
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "plane")
    truth = np.load(scans / "plane" / "truth.npz")
    ends = [(80, 128), (240, 130)]
    a, b = (truth["points_mm"][y, x] for x, y in ends)
    assert np.isfinite([a, b]).all()
    mm = float(np.linalg.norm(a - b))
    moved = read_rig(scans / "moved.toml")
    length = KnownLength(first_px=ends[0], second_px=ends[1], length_mm=2 * mm)
    found = self_calibrate([scan], moved, length=length)
    assert found.length_factor == pytest.approx(2.0, rel=2e-3)
    assert found.rig.covariance is None
    c1, c2 = found.rig.cameras
    true = read_rig(scans / "plane" / "rig.toml")
    before = np.linalg.norm(true.cameras[1].center_world - true.cameras[0].center_world)
    assert np.linalg.norm(c2.center_world - c1.center_world) == pytest.approx(2 * before, rel=2e-3)


def test_a_ball_bar_gives_the_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The distance of the cameras, wrong by 1 %, comes back; so does the bar's, by its own mesh."""
    pytest.importorskip("embreex")
    from fringe3d.simulate import OBJECTS, PRESETS

    scan = tmp_path / "scan"
    main(["simulate", "kolibri", "--object", "ball-bar", "--plan", "m1", "--camera-size", "320x256",
          "--rays", "1", "--out", str(scan)])  # fmt: skip
    preset = PRESETS["kolibri"]((320, 256))
    scene = preset.scene(OBJECTS["ball-bar"]())
    centers = scene.world_from_object.apply(scene.thing.spheres[:, :3])
    mm = float(np.linalg.norm(centers[1] - centers[0]))
    true = read_rig(scan / "rig.toml")
    tops = centers + np.array([0, 0, 0.5 * scene.thing.spheres[0, 3]])
    pixels = np.round(cv_project(true.cameras[0], tops)).astype(int)
    assert true.projector is not None
    c1, c2, projector = with_distance_of((*true.cameras, true.projector), _grown(true, 1.01))
    wrong = replace(true, cameras=(c1, c2), projector=projector)
    from fringe3d.io.rigfile import rig_text

    (tmp_path / "wrong.toml").write_text(rig_text(wrong))
    words = ":".join([*(f"{x},{y}" for x, y in pixels), f"{mm:.5f}"])
    out = tmp_path / "rig.toml"
    main(["calibrate", "self", "--from", str(scan), "--rig", str(tmp_path / "wrong.toml"),
          "--ball-bar", words, "--out", str(out), "--json"])  # fmt: skip
    record = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert record["scale"] == "known length"
    found = read_rig(out)
    apart = [np.linalg.norm(r.cameras[1].center_world - r.cameras[0].center_world)
             for r in (found, true)]  # fmt: skip
    assert apart[0] == pytest.approx(apart[1], rel=1e-3)


def test_a_ball_is_told_from_what_is_beside_it_and_from_a_plane() -> None:
    """A cap above a table, with noise; the centre is known to its sigma, noise / sqrt(n) and so."""
    rng = np.random.default_rng(0)
    pixels = np.stack(np.meshgrid(np.arange(100.0), np.arange(80.0)), axis=-1).reshape(-1, 2)
    x, y = (0.5 * (pixels - [40, 40])).T
    z = np.where(x**2 + y**2 < 9.5**2, 12 + np.sqrt(np.maximum(100 - x**2 - y**2, 0)), 0.0)
    points = np.column_stack([x, y, z + rng.normal(0, 0.01, len(x))])
    points[5] = np.nan
    np.testing.assert_allclose(ball_center(points, pixels, (42, 38)), [0, 0, 12], atol=0.01)
    with pytest.raises(EmptyResultError, match="60 points on it at least, found 0"):
        ball_center(points, pixels, (-50, 0))
    for noise in (0.01, 2.0):
        plane = np.column_stack([x, y, rng.normal(0, noise, len(x))])
        with pytest.raises(EmptyResultError, match="expected a sphere"):
            ball_center(plane, pixels, (50, 40))


def _grown(rig: Rig, factor: float) -> tuple[Device, ...]:
    """Return C1 and a second device that many times as far away."""
    c1, c2 = rig.cameras
    pose = c2.device_from_world
    center = c1.center_world + factor * (c2.center_world - c1.center_world)
    moved = RigidTransform(rotation=pose.rotation, translation=-pose.rotation @ center)
    return c1, replace(c2, device_from_world=moved)


def test_a_known_length_needs_points_at_its_ends() -> None:
    cloud = seen(points_in_space(600, 0), BOTH)
    nowhere = KnownLength(first_px=(-50.0, 0.0), second_px=(640.0, 512.0), length_mm=10.0)
    with pytest.raises(EmptyResultError, match=r"known length: expected a point at pixel \(-50"):
        distance_of(nowhere, cloud, (C1, C2, PROJECTOR))


def test_what_cannot_be_found_is_refused(scans: Path) -> None:
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "plane")
    assert scan.rig is not None
    no_projector = replace(scan.rig, projector=None)
    with pytest.raises(MethodError, match="two directions with two cameras without a projector"):
        self_calibrate([scan], no_projector, MeasureOptions(direction="x"))
    code = tuple(
        stack.subset([i for i, p in enumerate(stack.plan.patterns) if not isinstance(p, Fringe)])
        for stack in scan.stacks
    )
    with pytest.raises(MethodError, match="expected fringes in each direction"):
        self_calibrate([replace(scan, stacks=code)], scan.rig)
    single = replace(scan, stacks=scan.stacks[:1])
    with pytest.raises(MethodError, match="two directions with one camera"):
        self_calibrate([single], scan.rig, MeasureOptions(direction="x"))


def test_mistakes_on_the_command_line(
    scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "rig.toml")
    call = ["calibrate", "self", "--from", str(scans / "plane"), "--out", out]
    with pytest.raises(SystemExit):
        main([*call, "--known-length", "1,2:3:4"])
    assert "--known-length: expected two pixels of C1 and mm" in capsys.readouterr().err
    assert not (tmp_path / "rig.toml").exists()


def test_measure_names_the_device_that_moved(scans: Path) -> None:
    """Two directions tell the devices apart; the scan is rendered with the true rig."""
    from fringe3d.io.recording import read_scan

    scan = read_scan(scans / "machine-part")
    assert scan.rig is not None
    assert scan.rig.projector is not None
    c1, c2 = scan.rig.cameras
    for rig, name in (
        (replace(scan.rig, cameras=(c1, kicked(c2, 3, deg=0.1))), "c2"),
        (replace(scan.rig, projector=kicked(scan.rig.projector, 5)), "projector"),
    ):
        told = [f.text for f in measure(replace(scan, rig=rig)).warnings if f.name == "moved_px"]
        assert len(told) == 1
        assert f"device '{name}' has moved" in told[0]
    options = MeasureOptions(direction="x")
    told = [f.text for f in measure(replace(scan, rig=rig), options).warnings
            if f.name == "moved_px"]  # fmt: skip
    assert len(told) == 1
    assert "not determined by fringes of one direction" in told[0]
