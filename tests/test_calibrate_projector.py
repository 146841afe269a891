"""A projector fitted to points; OpenCV says where the light of a known projector falls.

Errors of the cameras' calibration are not in these tests: they bend points and projector alike.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from closed_form import Truth
from fringe3d.calibrate import FittedProjector, LitPoints, check_fit, fit_projector
from fringe3d.cli import main
from fringe3d.errors import CalibrationError, EmptyResultError
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform, Scan
from fringe3d.patterns import sequence

Floats = NDArray[np.float64]
Recording = tuple[Scan, tuple[Truth, ...]]

SHAPE = (768, 1024)
NOISE_PX = 0.03
RIGHT = np.pi / 2
ANGLES = ((0.0,), (RIGHT,), (np.radians(20),), (np.radians(-65),), (0.0, RIGHT),
          (np.radians(-20), np.radians(70)))  # fmt: skip


@dataclass(frozen=True)
class Light:
    """A projector in OpenCV's words; nothing of it is symmetric.

    The scene is a box of 200 x 160 x 100 mm about the world's origin, 500 mm away.
    """

    focal: tuple[float, float] = (1650.0, 1660.0)
    center: tuple[float, float] = (530.0, 340.0)
    lens: tuple[float, ...] = (-0.12, 0.15, 0.001, -0.0008, 0.0)
    turn: tuple[float, float, float] = (0.15, -0.3, 0.2)
    place: tuple[float, float, float] = (12.0, -9.0, 500.0)

    def across(self, points: Floats, angle: float) -> Floats:
        matrix = np.array([[self.focal[0], 0, self.center[0]], [0, self.focal[1], self.center[1]],
                           [0, 0, 1]])  # fmt: skip
        pixels, _ = cv2.projectPoints(
            points.reshape(-1, 1, 3), np.array(self.turn), np.array(self.place), matrix,
            np.array(self.lens),
        )  # fmt: skip
        u, v = pixels.reshape(-1, 2).T
        return np.asarray(np.cos(angle) * (u + 0.5) + np.sin(angle) * (v + 0.5))

    @property
    def forward(self) -> Floats:
        return np.asarray(Rotation.from_rotvec(self.turn).as_matrix()[2])


def box(n: int, rng: np.random.Generator, depth: float = 50.0) -> Floats:
    return rng.uniform([-100, -80, -depth], [100, 80, depth], (n, 3))


def lit(
    light: Light, points: Floats, angles: tuple[float, ...], rng: np.random.Generator
) -> LitPoints:
    w = np.stack([light.across(points, angle) for angle in angles], axis=1)
    return LitPoints(
        points_mm=points,
        position_px=w + rng.normal(0, NOISE_PX, w.shape),
        angles=angles,
        sigma_px=NOISE_PX,
        noise_mm=np.tile(1e-6 * light.forward, (len(points), 1)),
    )


def across_of(fitted: FittedProjector, points: Floats, angle: float) -> Floats:
    """Return what OpenCV says of the fitted device."""
    return light_of(fitted.device).across(points, angle)


def light_of(device: Device) -> Light:
    turn = Rotation.from_matrix(device.device_from_world.rotation).as_rotvec()
    return Light(
        focal=(float(device.focal_px[0]), float(device.focal_px[1])),
        center=(float(device.center_px[0]), float(device.center_px[1])),
        lens=tuple(device.distortion[:5].tolist()),
        turn=(float(turn[0]), float(turn[1]), float(turn[2])),
        place=tuple(device.device_from_world.translation.tolist()),
    )


@pytest.mark.parametrize(
    "angles", ANGLES, ids=lambda a: "+".join(f"{np.degrees(x):.0f}" for x in a)
)
def test_the_fit_predicts_opencv_elsewhere_in_the_volume(angles: tuple[float, ...]) -> None:
    """The middle of the box is left out of the fit, and judged."""
    light, rng = Light(), np.random.default_rng(1)
    points = box(8000, rng)
    inside = (np.abs(points) < [40, 30, 20]).all(axis=1)
    fitted = fit_projector([lit(light, points[~inside], angles, rng)], SHAPE)
    assert fitted.is_determined
    assert fitted.n_directions == len(angles)
    for angle in angles:
        truth = light.across(points[inside], angle)
        error = across_of(fitted, points[inside], angle) - truth
        assert np.sqrt(np.mean(error**2)) < NOISE_PX / 10
        predicted = fitted.position_sigma_px(points[inside], angle)
        assert np.sqrt(np.mean(error**2)) < 4 * np.sqrt(np.mean(predicted**2))


def test_two_directions_find_every_number() -> None:
    """The world's origin lies a metre beside the scene: turning it moves the translation."""
    light, rng = Light(), np.random.default_rng(2)
    aside = np.array([900.0, -500.0, 300.0])
    place = np.array(light.place) - Rotation.from_rotvec(light.turn).apply(aside)
    light = replace(light, place=tuple(place.tolist()))
    fitted = fit_projector([lit(light, box(8000, rng) + aside, (0.0, RIGHT), rng)], SHAPE)
    found = {p.name: p for p in fitted.parameters}
    true = {
        "focal_x_px": 1650.0, "focal_y_px": 1660.0, "center_x_px": 530.0, "center_y_px": 340.0,
        "translation_x_mm": place[0], "translation_y_mm": place[1], "translation_z_mm": place[2],
        "rotation_x_deg": np.degrees(0.15), "rotation_y_deg": np.degrees(-0.3),
        "rotation_z_deg": np.degrees(0.2), "k1": -0.12, "k2": 0.15, "p1": 0.001, "p2": -0.0008,
    }  # fmt: skip
    assert set(true) == set(found)
    for name, value in true.items():
        assert found[name].held_by == "data"
        assert abs(found[name].value - value) < 4.5 * found[name].sigma, name
    # A fit that knows nothing is as far from the truth as its sigma allows, too.
    assert found["focal_x_px"].sigma < 1.0
    assert found["center_x_px"].sigma < 1.5


def test_one_direction_finds_the_seven_numbers_of_a_pinhole() -> None:
    """OpenCV's projector without distortion: turn, place across and forward, focal length, ..."""
    light, rng = Light(lens=(0.0,) * 5, focal=(1650.0, 1650.0)), np.random.default_rng(3)
    fitted = fit_projector([lit(light, box(8000, rng), (0.0,), rng)], SHAPE, lens="pinhole")
    found = {p.name: p for p in fitted.parameters}
    hidden = {name for name, p in found.items() if p.held_by == "convention"}
    assert hidden == {"center_y_px", "translation_y_mm"}
    turn = np.degrees(np.array(light.turn))
    for name, value in (
        ("focal_px", 1650.0), ("center_x_px", 530.0), ("translation_x_mm", 12.0),
        ("translation_z_mm", 500.0), *zip((f"rotation_{k}_deg" for k in "xyz"), turn, strict=True),
    ):  # fmt: skip
        assert abs(found[name].value - value) < 4.5 * found[name].sigma, name


def test_sigma_of_predictions_is_that_of_repeated_noise() -> None:
    """Noise of phase and of points; the ratio of scatter and sigma is a pull."""
    light, rng = Light(lens=(-0.12, 0.0, 0.0, 0.0, 0.0)), np.random.default_rng(4)
    points = box(1500, rng)
    where = box(60, rng, depth=80.0)
    clean = light.across(points, 0.0)
    ray = np.array([-0.3, 0.1, 1.0]) / np.linalg.norm([-0.3, 0.1, 1.0])
    predictions, sigmas = [], []
    for _ in range(30):
        moved = points + rng.normal(0, 0.01, (len(points), 1)) * ray
        scan = LitPoints(
            points_mm=moved,
            position_px=(clean + rng.normal(0, NOISE_PX, len(clean)))[:, None],
            angles=(0.0,),
            sigma_px=NOISE_PX,
            noise_mm=np.tile(0.01 * ray, (len(points), 1)),
        )
        fitted = fit_projector([scan], SHAPE, lens="k1")
        predictions.append(across_of(fitted, where, 0.0))
        sigmas.append(fitted.position_sigma_px(where, 0.0))
    through_points = 0.01 * (
        light.across(points + ray / 2, 0.0) - light.across(points - ray / 2, 0.0)
    )
    assert np.median(np.hypot(NOISE_PX, through_points)) == pytest.approx(fitted.noise_px, rel=0.05)
    scatter = np.std(predictions, axis=0, ddof=1)
    pull = np.sqrt(np.mean(scatter**2) / np.mean(np.array(sigmas) ** 2))
    # 30 draws of about 9 independent numbers: 4 %; the rest is for the estimate of crowding.
    assert 0.85 < pull < 1.12
    bias = np.mean(predictions, axis=0) - light.across(where, 0.0)
    assert np.sqrt(np.mean(bias**2)) < 0.5 * np.sqrt(np.mean(scatter**2))


def test_noise_that_was_not_predicted_widens_sigma() -> None:
    light, rng = Light(), np.random.default_rng(5)
    points = box(4000, rng)
    scan = lit(light, points, (0.0,), rng)
    waves = 0.1 * np.sin(points[:, :1] / 9) * np.sin(points[:, 1:2] / 9)
    wavy = LitPoints(points_mm=points, position_px=scan.position_px + waves, angles=(0.0,),
                     sigma_px=NOISE_PX)  # fmt: skip
    plain, worse = fit_projector([scan], SHAPE), fit_projector([wavy], SHAPE)
    sigma = [f.position_sigma_px(points, 0.0, any_lens=True).mean() for f in (plain, worse)]
    assert plain.extra_px < 0.01 < 0.03 < worse.extra_px
    assert sigma[1] > 2 * sigma[0]


@pytest.mark.parametrize("part", [0.02, 0.1])
def test_wrong_orders_do_no_harm(part: float) -> None:
    light, rng = Light(), np.random.default_rng(6)
    scan = lit(light, box(6000, rng), (0.0,), rng)
    wrong = rng.random(scan.n_points) < part
    w = scan.position_px + wrong[:, None] * rng.choice([-32, -16, 16, 32, 48], (scan.n_points, 1))
    spoiled = LitPoints(points_mm=scan.points_mm, position_px=w, angles=(0.0,), sigma_px=NOISE_PX)
    fitted = fit_projector([spoiled], SHAPE)
    where = box(1000, rng)
    error = across_of(fitted, where, 0.0) - light.across(where, 0.0)
    assert np.sqrt(np.mean(error**2)) < NOISE_PX / 5


@pytest.mark.parametrize(
    ("lens", "chosen"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0), "pinhole"),
        ((-0.1, 0.0, 0.0, 0.0, 0.0), "k1"),
        ((-0.1, 0.2, 0.002, -0.003, 0.0), "k1 k2 p1 p2"),
    ],
)
def test_as_many_terms_of_the_lens_as_the_data_ask_for(
    lens: tuple[float, ...], chosen: str
) -> None:
    light, rng = Light(lens=lens), np.random.default_rng(7)
    fitted = fit_projector([lit(light, box(6000, rng), (0.0, RIGHT), rng)], SHAPE)
    assert chosen == fitted.lens
    assert fitted.held_out_rms_px < 1.05 * NOISE_PX


def board(n: int, rng: np.random.Generator, tilt: float, shift_mm: float) -> Floats:
    points = box(n, rng, depth=1e-9)
    points[:, 2] = np.tan(tilt) * points[:, 0] + shift_mm
    return points


def rig_of(light: Light) -> Rig:
    """Return two cameras beside the projector that look at the box."""

    def camera(name: str, aside: float) -> Device:
        rotation = Rotation.from_rotvec(light.turn).as_matrix()
        return Device(
            name=name, role="camera", n_rows=512, n_cols=640, focal_px=[1400, 1400],
            center_px=[320, 256],
            device_from_world=RigidTransform(
                rotation=rotation, translation=np.add(light.place, [aside, 0, 0])
            ),
        )  # fmt: skip

    volume = MeasuringVolume.box([-100, -80, -50], [100, 80, 50])
    return Rig(cameras=(camera("c1", 60.0), camera("c2", -60.0)), volume=volume)


def test_a_board_alone_is_not_enough_and_said_so() -> None:
    light, rng = Light(), np.random.default_rng(8)
    scan = lit(light, board(6000, rng, 0.0, 0.0), (0.0,), rng)
    fitted = fit_projector([scan], SHAPE)
    findings = {f.name: f for f in check_fit(fitted, [scan], rig_of(light))}
    assert not fitted.is_determined
    assert fitted.lens in ("pinhole", "k1")
    assert findings["depth_part"].level == "warning"
    assert "--from A --from B" in findings["depth_part"].text
    assert findings["volume_sigma_px"].level == "warning"
    # It knows the board itself.
    error = across_of(fitted, scan.points_mm, 0.0) - light.across(scan.points_mm, 0.0)
    assert np.sqrt(np.mean(error**2)) < 2 * NOISE_PX


def test_boards_at_several_places_are_enough() -> None:
    light, rng = Light(), np.random.default_rng(9)
    scans = [
        lit(light, board(3000, rng, tilt, shift), (0.0,), rng)
        for tilt, shift in ((0.0, -40.0), (0.3, 0.0), (-0.3, 20.0))
    ]
    fitted = fit_projector(scans, SHAPE)
    findings = check_fit(fitted, scans, rig_of(light))
    assert fitted.is_determined
    assert {f.level for f in findings} == {"ok"}
    where = box(1000, rng)
    error = across_of(fitted, where, 0.0) - light.across(where, 0.0)
    assert np.sqrt(np.mean(error**2)) < NOISE_PX / 3
    assert len(fitted.residual_px) == 3


def test_lit_points_lie_in_the_image_also_where_the_fringes_do_not_show_it() -> None:
    """A projector with lens shift, and one whose pixels are narrow: both are seen along x alone."""
    rng = np.random.default_rng(10)
    for light in (Light(center=(530.0, 840.0)), Light(focal=(2900.0, 1450.0))):
        points = box(6000, rng)
        scan = lit(light, points, (0.0,), rng)
        fitted = fit_projector([scan], SHAPE)
        v = across_of(fitted, points, RIGHT) - 0.5
        assert v.min() > -0.5
        assert v.max() < SHAPE[0] - 0.5
        error = across_of(fitted, points, 0.0) - light.across(points, 0.0)
        assert np.sqrt(np.mean(error**2)) < NOISE_PX / 5


def test_a_mirrored_direction_is_refused() -> None:
    light, rng = Light(), np.random.default_rng(11)
    scan = lit(light, box(3000, rng), (0.0, RIGHT), rng)
    mirrored = scan.position_px * [1, -1] + [0, SHAPE[0]]
    spoiled = LitPoints(points_mm=scan.points_mm, position_px=mirrored, angles=scan.angles,
                        sigma_px=NOISE_PX)  # fmt: skip
    with pytest.raises(CalibrationError, match="each direction fit a projector, but not the same"):
        fit_projector([spoiled], SHAPE)


def test_what_is_no_projector_is_refused() -> None:
    rng = np.random.default_rng(12)
    points = box(2000, rng)
    noise = LitPoints(points_mm=points, position_px=rng.uniform(0, 1024, (2000, 1)), angles=(0.0,),
                      sigma_px=NOISE_PX)  # fmt: skip
    with pytest.raises(CalibrationError, match="fit no projector"):
        fit_projector([noise], SHAPE)
    few = LitPoints(points_mm=points[:50], position_px=np.ones((50, 1)), angles=(0.0,),
                    sigma_px=NOISE_PX)  # fmt: skip
    with pytest.raises(EmptyResultError, match="at least 200 points"):
        fit_projector([few], SHAPE)


def test_the_world_may_be_anywhere() -> None:
    """Move the world: the same projector is found, in the other frame."""
    light, rng = Light(), np.random.default_rng(13)
    scan = lit(light, box(4000, rng), (0.0,), rng)
    other_from_world = RigidTransform(
        rotation=Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix(), translation=[800, -90, 3000]
    )
    moved = LitPoints(
        points_mm=other_from_world.apply(scan.points_mm), position_px=scan.position_px,
        angles=scan.angles, sigma_px=NOISE_PX, noise_mm=other_from_world.rotate(scan.noise_mm),
        block=scan.block,
    )  # fmt: skip
    here, there = fit_projector([scan], SHAPE), fit_projector([moved], SHAPE)
    where = box(500, rng)
    difference = across_of(here, where, 0.0) - across_of(there, other_from_world.apply(where), 0.0)
    assert np.abs(difference).max() < NOISE_PX / 20


@pytest.fixture
def scan_folder(recording: Recording, tmp_path: Path) -> Path:
    """Return a scan of a sphere before a plane whose rig has no projector."""
    scan, _ = recording
    assert scan.rig is not None
    folder = tmp_path / "scan"
    write_scan(folder, scan)
    (folder / "rig.toml").write_text(rig_text(replace(scan.rig, projector=None)))
    return folder


def test_the_command_writes_a_rig_with_a_projector(
    scan_folder: Path, rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "rig.toml"
    words = ["calibrate", "projector", "--from", str(scan_folder), "--out", str(out)]
    main([*words, "--projector-size", "1024x768", "--json"])
    record = json.loads(capsys.readouterr().out)
    assert {path.name for path in out.parent.iterdir()} == {
        "rig.toml", "rig-projector.md", "rig-projector.png",
    }  # fmt: skip
    found = read_rig(out)
    assert found.projector is not None
    assert rig.projector is not None
    assert found.projector.shape == rig.projector.shape
    assert rig_text(replace(found, projector=None, provenance="")) == rig_text(
        replace(rig, projector=None, provenance="")
    )
    assert f"projector from {scan_folder}" in found.provenance
    assert record["residual_median_px"] < 0.1
    assert record["held_out_rms_px"] < 0.2
    assert record["projector"]["focal_px"] == found.projector.focal_px.tolist()
    assert {p["held_by"] for p in record["parameters"]} <= {"data", "prior", "convention"}
    # Measuring with it agrees with measuring without.
    main(["measure", str(scan_folder), "--rig", str(out), "--method", "m1", "--out",
          str(tmp_path / "result")])  # fmt: skip
    assert "trinocular" in (tmp_path / "result" / "measure.toml").read_text()


def test_nothing_is_replaced_unless_asked(
    scan_folder: Path, rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig may be mended in place; what it had is compared."""
    out = tmp_path / "rig.toml"
    mine = rig_text(rig)
    out.write_text(mine)
    words = ["calibrate", "projector", "--from", str(scan_folder), "--out", str(out)]
    words += ["--projector-size", "1024x768"]
    assert "found an existing file" in refused(words, capsys)
    assert out.read_text() == mine
    main([*words, "--overwrite", "--rig", str(out)])
    assert "the projector that it replaces: median residual 0.0" in capsys.readouterr().out
    assert read_rig(out).provenance.count("projector from") == 1


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    return " ".join(capsys.readouterr().err.split())


def test_mistakes_get_one_message(
    scan_folder: Path, recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out" / "rig.toml"
    words = ["calibrate", "projector", "--from", str(scan_folder), "--out", str(out)]
    assert "--projector-size WIDTHxHEIGHT" in refused(words, capsys)
    sized = [*words, "--projector-size", "1024x768"]
    assert "expected one folder for all scans" in refused(
        [*sized, "--images", "a", "--images", "b"], capsys
    )
    assert "found one that tells 64 of 120" in refused(
        [*words, "--projector-size", "1920x1080"], capsys
    )
    scan, _ = recording
    assert scan.rig is not None
    lone = tmp_path / "lone"
    write_scan(lone, replace(scan, stacks=scan.stacks[:1]))
    alone = ["calibrate", "projector", "--from", str(lone), "--out", str(out)]
    assert "expected images and calibration of two cameras" in refused(alone, capsys)
    text = (lone / "scan.toml").read_text()
    (lone / "scan.toml").write_text(text.replace('rig = "rig.toml"', ""))
    assert "Name one with --rig" in refused(alone, capsys)
    other = tmp_path / "other"
    camera = scan.rig.cameras[1]
    moved = Device(
        name=camera.name, role="camera", n_rows=camera.n_rows, n_cols=camera.n_cols,
        focal_px=camera.focal_px + 1, center_px=camera.center_px, distortion=camera.distortion,
        device_from_world=camera.device_from_world,
    )  # fmt: skip
    write_scan(other, replace(scan, rig=replace(scan.rig, cameras=(scan.rig.cameras[0], moved))))
    assert "found others" in refused([*sized, "--from", str(other)], capsys)
    short = tmp_path / "short"
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray_bits=2)
    kept = [i for i, p in enumerate(scan.stacks[0].plan.patterns) if i < plan.n_images]
    write_scan(short, replace(scan, stacks=tuple(stack.subset(kept) for stack in scan.stacks)))
    said = refused(["calibrate", "projector", "--from", str(short), "--out", str(out)], capsys)
    assert "expected a full Gray code" in said
    assert "--method" not in said
    assert not out.parent.exists()


def test_a_simulated_scan_gives_the_true_projector(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A machine part on a table; the truth is the projector with which it was rendered."""
    scan, out = tmp_path / "scan", tmp_path / "rig.toml"
    main(["simulate", "kolibri", "--object", "machine-part", "--plan", "m1", "--camera-size",
          "400x320", "--seed", "3", "--out", str(scan)])  # fmt: skip
    capsys.readouterr()
    main(["calibrate", "projector", "--from", str(scan), "--out", str(out), "--json"])
    record = json.loads(capsys.readouterr().out)
    true, found = read_rig(scan / "rig.toml").projector, read_rig(out).projector
    assert true is not None
    assert found is not None
    rng = np.random.default_rng(14)
    angle, radius = rng.uniform(0, 2 * np.pi, 2000), 40 * np.sqrt(rng.random(2000))
    volume = np.stack([radius * np.cos(angle), radius * np.sin(angle),
                       rng.uniform(-12.5, 12.5, 2000)], axis=1)  # fmt: skip
    error = light_of(found).across(volume, 0.0) - light_of(true).across(volume, 0.0)
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert record["is_determined"]
    assert {f["level"] for f in record["health"] if f["name"].endswith("_px")} == {"ok"}


def test_the_rendered_bust_gets_a_projector(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording by others whose projector nobody calibrated."""
    description = Path(__file__).parent.parent / "examples/captures/slmaster-bust-rendered.toml"
    out = tmp_path / "rig.toml"
    main(["calibrate", "projector", "--from", str(description), "--images", str(captures), "--out",
          str(out), "--depth", "450:700", "--json"])  # fmt: skip
    record = json.loads(capsys.readouterr().out)
    assert record["residual_median_px"] < 0.04
    assert record["residual_rms_px"] < 0.1
    assert record["held_out_rms_px"] < 0.1
    assert record["is_determined"]
    assert {f["level"] for f in record["health"]} == {"ok"}
    # A rendered projector is free of distortion and looks through the middle of its image.
    assert abs(record["projector"]["center_px"][0] - 959.5) < 3.0
    assert abs(record["projector"]["distortion"][0]) < 0.01
