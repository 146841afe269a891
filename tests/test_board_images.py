"""Boards in words, in files and in images; light on their corners; the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

import board_pictures
from board_pictures import BOARD, FRINGES, GRAY, render, true_corners
from fringe3d.board_scans import board_image, views_of_scan
from fringe3d.calibrate import light_on_corners
from fringe3d.cli import main
from fringe3d.decode import decode
from fringe3d.errors import CalibrationError, PlanError, RigError
from fringe3d.geometry import normalize
from fringe3d.io.board_images import find_corners, other_board
from fringe3d.io.boardfile import read_board
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import PatternPlan, Rig, RigCovariance, Scan, Uniform

Floats = NDArray[np.float64]

TURN, PLACE = np.array([0.3, -0.3, 0.1]), np.array([0.0, 0.0, 500.0])
LIGHT = PatternPlan(patterns=(Uniform(level=1.0),))
EXAMPLE = Path(__file__).parent.parent / "examples" / "captures" / "procam-board.toml"


# ------------------------------------------------------------------------------ boards in words


@pytest.mark.parametrize(("text", "expected"), [
    ("chessboard:9x7:20mm", "chessboard of 9 x 7 inner corners, 20 mm"),
    ("Chessboard:9x7:2.5", "chessboard of 9 x 7 inner corners, 2.5 mm"),
    ("chessboard:9x7", "chessboard of 9 x 7 inner corners, unknown pitch"),
    ("charuco:11x8:15mm:11mm:DICT_5X5_100:legacy",
     "charuco (legacy layout) of 10 x 7 inner corners, 15 mm"),
    ("charuco:11x8:0.7", "charuco of 10 x 7 inner corners, unknown pitch"),
    ("circles:9x7:20mm", "circles of 9 x 7 circles, 20 mm"),
    ("asymmetric-circles:4x11:10mm", "asymmetric-circles of 4 x 11 circles, 10 mm"),
])  # fmt: skip
def test_boards_in_words(text: str, expected: str) -> None:
    assert read_board(text).text == expected


@pytest.mark.parametrize(("text", "message"), [
    ("chess:9x7", "expected one of the kinds chessboard, charuco"),
    ("chessboard", "expected COLUMNSxROWS after the kind"),
    ("chessboard:9x7:20cm", "expected a length in mm, found '20cm'"),
    ("chessboard:9x7:20mm:10mm", "found more than this kind of board has"),
    ("chessboard:9x7:legacy", "found more than this kind of board has"),
    ("chessboard:1x7", "expected at least 2 x 2 corners"),
    ("charuco:11x8:15mm", "expected the side of the markers, found none"),
    ("charuco:11x8:15mm:16mm", "expected markers smaller than the squares"),
    ("missing-board.toml", "expected a file, found none"),
])  # fmt: skip
def test_wrong_words_are_named(text: str, message: str) -> None:
    with pytest.raises(PlanError, match=message):
        read_board(text)


def test_a_board_file_says_the_same(tmp_path: Path) -> None:
    file = tmp_path / "board.toml"
    file.write_text(
        'format = "fringe3d-board/1"\nkind = "charuco"\nsize = [11, 8]\npitch_mm = 15\n'
        'marker_mm = 11\ndictionary = "DICT_5X5_100"\nlayout = "legacy"\n'
    )
    found, expected = read_board(str(file)), read_board("charuco:11x8:15:11:DICT_5X5_100:legacy")
    assert found.text == expected.text
    assert (found.marker_mm, found.dictionary) == (11, "DICT_5X5_100")
    file.write_text(
        'format = "fringe3d-board/1"\nkind = "chessboard"\nsize = [9, 7]\npich_mm = 2\n'
    )
    with pytest.raises(PlanError, match="Did you mean 'pitch_mm'"):
        read_board(str(file))


# ------------------------------------------------------------------------------ images


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_boards_of_both_layouts_are_found_and_not_taken_for_each_other(
    legacy: bool,
) -> None:
    """An even number of rows: only there do the layouts differ."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((8, 6), 20, 15, dictionary)
    board.setLegacyPattern(legacy)
    image: NDArray[np.uint8] = np.asarray(board.generateImage((840, 640), marginSize=20), np.uint8)
    words = ["charuco:8x6:20mm:15mm", "charuco:8x6:20mm:15mm:legacy"]
    found = find_corners(image, read_board(words[legacy]))
    assert found.ids.tolist() == list(range(35))
    expected = read_board(words[legacy]).points_mm[:, :2] / 20 * 100 + 119.5
    np.testing.assert_allclose(found.pixels, expected, atol=0.1)  # (0, 0) is a pixel's centre
    assert len(find_corners(image, read_board(words[not legacy]))) == 0
    covered = image.copy()
    covered[:, :330] = 128
    assert 8 <= len(find_corners(covered, read_board(words[legacy]))) < 35
    with pytest.raises(PlanError, match="expected a dictionary of OpenCV"):
        find_corners(image, read_board("charuco:8x6:20mm:15mm:DICT_9X9_50"))


@pytest.mark.parametrize("words", ["circles:9x7:20mm", "asymmetric-circles:4x11:10mm"])
@pytest.mark.parametrize("inverse", [False, True])
def test_circles_are_found_dark_and_bright(words: str, inverse: bool) -> None:
    board = read_board(words)
    centers = (
        board.points_mm[:, :2] / board.pitch_mm * (50 if board.kind != "circles" else 70) + 80.25
    )
    image = np.full((640, 760), 255, np.uint8)
    for x, y in centers:
        cv2.circle(image, (round(16 * x), round(16 * y)), 16 * 17, 0, -1, cv2.LINE_AA, 4)
    found = find_corners(255 - image if inverse else image, board)
    assert len(found) == board.n_points
    np.testing.assert_allclose(found.pixels, centers, atol=0.1)  # of a blob's centre


def in_order(found: Floats, expected: Floats) -> Floats:
    """Return the corners of a board that looks the same turned by half, from either end."""
    is_same = np.abs(found - expected).max() < np.abs(found[::-1] - expected).max()
    return found if is_same else found[::-1]


def test_a_chessboard_is_found_to_a_tenth_of_a_pixel_in_8_and_16_bits() -> None:
    stack = render(LIGHT, TURN, PLACE)
    expected, _ = true_corners(TURN, PLACE)
    for image in (stack.images[0], stack.images[0].astype(np.uint16) * 100):
        found = find_corners(image, BOARD)
        off = in_order(found.pixels, expected) - expected
        assert np.abs(off).max() < 0.3
        assert np.sqrt((off**2).mean()) < 0.08  # squares of 30 px, two samples across a pixel
        assert np.abs(off.mean(axis=0)).max() < 0.04  # no common shift, as of half a pixel


def test_another_size_of_board_is_named() -> None:
    image = render(LIGHT, TURN, PLACE).images[0]
    wrong = replace(BOARD, n_cols=9)
    assert len(find_corners(image, wrong)) == 0
    for words in ("chessboard:9x6", "chessboard:7x6", "circles:8x6"):
        other = other_board(image, read_board(words))
        assert other is not None
        assert other.text == "chessboard of 8 x 6 inner corners, 1 mm"
    assert other_board(np.zeros_like(image), wrong) is None
    small = read_board("circles:2x5:10mm")  # a chessboard of that size is none
    assert other_board(np.zeros_like(image), small) is None


# ------------------------------------------------------------------------------ light on corners


@pytest.mark.parametrize(("plan", "limit_px"), [(FRINGES, 0.015), (GRAY, 0.03)])
def test_light_on_corners_is_far_better_than_the_phase_beside_them(
    plan: PatternPlan, limit_px: float
) -> None:
    """At the corner itself the phase is that of the white squares, and Gray code counts pixels."""
    stack = render(plan, TURN, PLACE)
    camera, expected = true_corners(TURN, PLACE)
    phases = [d.main for d in decode(stack, whole_cells=True).directions]
    found, sigma = light_on_corners(BOARD, np.arange(48), camera, phases)
    off = found - expected
    assert np.isfinite(off).all()
    assert np.sqrt((off**2).mean()) < limit_px
    assert np.abs(off.mean(axis=0)).max() < limit_px / 2
    assert 0.3 < np.sqrt((off**2).mean()) / np.median(sigma) < 3
    maps = [m.position_px - 0.5 for m in phases]
    beside = np.stack([map_coordinates(m, camera[:, ::-1].T, order=1) for m in maps], axis=-1)
    assert np.sqrt(np.nanmean((beside - expected) ** 2)) > 3 * limit_px


def test_corners_that_are_not_lit_have_no_light() -> None:
    stack = render(FRINGES, TURN, PLACE)
    images = stack.images.copy()
    camera, _ = true_corners(TURN, PLACE)
    images[:, int(camera[:, 1].mean()) :] = 3  # the lower half is in the dark
    phases = [d.main for d in decode(replace(stack, images=images)).directions]
    found, _ = light_on_corners(BOARD, np.arange(48), camera, phases)
    dark = camera[:, 1] > camera[:, 1].mean() + 5
    assert np.isnan(found[dark]).all()
    assert np.isfinite(found[camera[:, 1] < camera[:, 1].mean() - 25]).all()


def test_one_direction_is_not_enough_for_the_projector() -> None:
    stack = render(FRINGES, TURN, PLACE)
    phases = [decode(stack).directions[0].main]
    with pytest.raises(CalibrationError, match="of two directions on the board, found one"):
        light_on_corners(BOARD, np.arange(48), true_corners(TURN, PLACE)[0], phases)


def test_without_a_light_image_the_fringes_show_the_board() -> None:
    stack = render(FRINGES, TURN, PLACE)
    dark = stack.plan.subset(range(stack.plan.n_images - 1))
    fewer = replace(stack, images=stack.images[:-1], plan=dark)
    found = find_corners(board_image(fewer), BOARD)
    expected, _ = true_corners(TURN, PLACE)
    assert np.sqrt(((in_order(found.pixels, expected) - expected) ** 2).mean()) < 0.15
    unknown = replace(fewer, plan=PatternPlan(patterns=dark.patterns))
    scan = Scan(stacks=(unknown,))
    with pytest.raises(PlanError, match="expected the size of the projector"):
        views_of_scan(scan, BOARD, {"c1": (found.ids, found.pixels)}, pose="a", projector="p")


# ------------------------------------------------------------------------------ the command


POSES = [(-0.4, 0.1), (0.4, -0.2), (0.1, 0.45), (-0.2, -0.45), (0.05, 0.1)]


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return scan folders with one light image of one camera for each of five poses."""
    folder = tmp_path_factory.mktemp("series")
    for number, (x, y) in enumerate(POSES):
        stack = render(
            LIGHT, np.array([x, y, 0.1]), PLACE + np.array([0.0, 0.0, 15.0 * number]), seed=number
        )
        write_scan(folder / f"pose-{number + 8}", Scan(stacks=(stack,)))
    return folder


def run(*words: object) -> int:
    """Return the exit code of a command."""
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_camera_is_calibrated_from_plain_images(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rig.toml"
    words = ("calibrate", series, "--board", "chessboard:8x6:20mm", "--out", out)
    assert run(*words, "--json") == 0
    record = json.loads(capsys.readouterr().out)
    true = board_pictures.CAMERA
    rig = read_rig(out)
    assert rig.covariance is not None
    sigma = rig.covariance.sigma("c1.fx")
    assert rig.cameras[0].focal_px[0] == pytest.approx(true.focal_px[0], abs=5 * sigma)
    assert sigma < 4
    assert [p["pose"] for p in record["poses"]] == [f"pose-{n}" for n in range(8, 13)]
    assert record["devices"][0]["rms_px"] < 0.1
    assert rig.volume is not None
    assert rig.volume.contains([[0, 0, 540]]).all()
    assert "5 poses (fringe3d calibrate: rms c1" in rig.provenance
    report = (tmp_path / "rig-board.md").read_text()
    assert "rig-board.png" in report
    assert (tmp_path / "rig-board.png").stat().st_size > 10_000
    assert (tmp_path / "rig-volume.png").stat().st_size > 5_000

    # Once more, in the frame of a pose, with lenses that are known and a range of depths.
    again = tmp_path / "again.toml"
    assert run(*words[:4], "--out", again, "--rig", out, "--keep-lenses", "--world", "pose-9",
               "--depth", "400:700", "--leave-out", "pose-12") == 0  # fmt: skip
    there = read_rig(again)
    np.testing.assert_array_equal(there.cameras[0].focal_px, rig.cameras[0].focal_px)
    first = Rotation.from_rotvec([*POSES[1], 0.1]).apply(-BOARD.points_mm.mean(axis=0))
    expected = PLACE + first + [0, 0, 15]
    np.testing.assert_allclose(
        there.cameras[0].device_from_world.translation, expected, atol=4 * sigma
    )
    printed = capsys.readouterr().out
    assert "4 poses, 1 devices" in printed


def test_plain_images_need_no_description(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images of one number are of one pose; it comes to the same as with scan folders."""
    (tmp_path / "left").mkdir()
    (tmp_path / "right").mkdir()
    for number in range(8, 13):
        image = cv2.imread(str(series / f"pose-{number}" / "c1" / "000.png"), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(tmp_path / "left" / f"im{number:02d}.png"), image)
    (tmp_path / "right" / "07.png").write_bytes((tmp_path / "left" / "im12.png").read_bytes())
    call = ("calibrate", tmp_path, "--board", "chessboard:8x6:20mm", "--json", "--out")
    assert run(*call, tmp_path / "a.toml", "--camera", "left=left/im{index:02d}.png") == 0
    found = json.loads(capsys.readouterr().out)
    assert run(call[0], series, *call[2:], tmp_path / "b.toml") == 0
    expected = json.loads(capsys.readouterr().out)
    assert [p["pose"] for p in found["poses"]] == ["08", "09", "10", "11", "12"]
    assert found["devices"][0]["name"] == "left"
    assert found["devices"][0]["rms_px"] == pytest.approx(expected["devices"][0]["rms_px"])
    for more, message in (
        (("--camera", "left=left/im{index:02d}.png"), "found 'left' twice"),
        (("--camera", "right=right/{index:02d}.png"), "images of one number from all cameras"),
        (("--camera", "right=up/{index:02d}.png"), "up/"),
        (("--scan", "scan.toml"), "found both. Leave one out"),
    ):
        words = (*call, tmp_path / "c.toml", "--camera", "left=left/im{index:02d}.png", *more)
        assert run(*words) == 2
        assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("words", "message"), [
    (("--board", "chessboard:9x6:20mm"), "shows a chessboard of 8 x 6: correct --board"),
    (("--board", "chessboard:8x6", "--leave-out", "pose-99"), "found pose-99"),
    (("--board", "chessboard:8x6", "--world", "pose-99"), "found 'pose-99'"),
    (("--board", "chessboard:8x6", "--keep-lenses"), "expected a former rig"),
])  # fmt: skip
def test_mistakes_on_the_command_line_are_named(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...], message: str,
) -> None:  # fmt: skip
    assert run("calibrate", series, *words, "--out", tmp_path / "rig.toml") == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "rig.toml").exists()


def test_a_rig_that_fits_no_pose_is_not_written(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """So it is with a part of a board, which each device may find elsewhere on it."""
    monkeypatch.setattr("fringe3d.calibrate.typical_rms_px", lambda _: ("c1", 37.6))
    out = tmp_path / "rig.toml"
    assert run("calibrate", series, "--board", "chessboard:8x6:20mm", "--out", out) == 2
    assert "found 37.6 px in 'c1'" in capsys.readouterr().err
    assert not out.exists()


def test_folders_without_poses_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").mkdir()
    words = ("--board", "chessboard:8x6", "--out", tmp_path / "rig.toml")
    assert run("calibrate", tmp_path, *words) == 2
    assert "found 1 folders without a scan.toml" in capsys.readouterr().err
    assert run("calibrate", tmp_path / "none", *words) == 2
    assert "expected a folder with one scan folder for each pose" in capsys.readouterr().err


# ------------------------------------------------------------------------------ real recordings


def test_the_real_board_meets_its_figures(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A chessboard on paper that is taped to glass; nobody knows its true shape."""
    folder, out = captures / "procam-board", tmp_path / "rig.toml"
    assert run("calibrate", folder, "--scan", EXAMPLE, "--board", "chessboard:9x7", "--out", out,
               "--json") == 0  # fmt: skip
    said = capsys.readouterr()
    record = json.loads(said.out)
    rms = {device["name"]: device["rms_px"] for device in record["devices"]}
    assert rms["c1"] <= 0.31
    assert rms["projector"] <= 0.21
    assert "only 5 poses: the focal lengths are determined poorly (c1 34" in said.err
    assert "lengths are in units of it, not in mm" in said.err
    rig = read_rig(out)
    for pose in sorted(p for p in folder.iterdir() if p.is_dir()):
        assert abs(epipolar_median(rig, pose)) < 0.06, pose.name


def epipolar_median(rig: Rig, pose: Path) -> float:
    """Return the median signed distance of dense Gray pixels from their epipolar lines, px."""
    camera, projector = rig.cameras[0], rig.projector
    assert projector is not None
    stack = read_scan(EXAMPLE, images=pose).stacks[0]
    maps = [d.main.position_px for d in decode(stack, whole_cells=True).directions]
    light = np.stack(maps, axis=-1) - 0.5
    places = np.argwhere(np.isfinite(light).all(axis=-1))[::53]
    seen = normalize(camera, places[:, ::-1].astype(float))
    sent = normalize(projector, light[places[:, 0], places[:, 1]])
    relative = projector.device_from_world @ camera.device_from_world.inverse()
    one = np.ones((len(places), 1))
    line = np.cross(relative.translation, np.hstack([seen, one]) @ relative.rotation.T)
    distance = (np.hstack([sent, one]) * line).sum(axis=1) / np.hypot(line[:, 0], line[:, 1])
    return float(np.nanmedian(distance) * projector.focal_px.mean())


# ------------------------------------------------------------------------------ the rig file


def test_the_covariance_of_a_rig_is_read_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    covariance = RigCovariance(names=("c1.fx", "c1.k1", "c1.turn_x"), matrix=root @ root.T)
    rig = Rig(cameras=(board_pictures.CAMERA,), covariance=covariance)
    file = tmp_path / "rig.toml"
    file.write_text(rig_text(rig))
    found = read_rig(file).covariance
    assert found is not None
    assert found.names == covariance.names
    np.testing.assert_allclose(found.matrix, covariance.matrix, rtol=1e-8)
    assert found.sigma("c1.fx") == pytest.approx(np.sqrt(covariance.matrix[0, 0]))
    assert found.sigma("c1.cx") == 0
    text = file.read_text()
    file.write_text(text.replace("focal_px = [800.0", "focal_px = [800.5"))
    with pytest.raises(RigError, match="covariance: expected that of the devices of this file"):
        read_rig(file)
    file.write_text(text.replace('"c1.k1", ', ""))
    with pytest.raises(RigError, match="expected rows of 1 to 2 numbers"):
        read_rig(file)
    with pytest.raises(ValueError, match="covariance: expected devices of"):
        Rig(cameras=(replace(board_pictures.CAMERA, name="x"),), covariance=covariance)
    with pytest.raises(ValueError, match=r"expected DEVICE\.NUMBER, found 'c1\.f'"):
        RigCovariance(names=("c1.f",), matrix=np.eye(1))
