"""Simulated series of a calibration board: against OpenCV's projections, and read by calibrate."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cv_lens import cv_project
from fringe3d.calibrate import circle_centers
from fringe3d.cli.run import main
from fringe3d.io.board_images import find_corners
from fringe3d.io.boardfile import board_text, read_board
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Board, PatternPlan, RigidTransform, Uniform

pytest.importorskip("embreex")

from fringe3d.simulate import PRESETS, prepare, record
from fringe3d.simulate.boards import BLACK, WHITE, board_poses, printed_board

CHESS = Board(kind="chessboard", n_cols=9, n_rows=7, pitch_mm=6.0)
CHARUCO = Board(kind="charuco", n_cols=6, n_rows=4, pitch_mm=10.0, marker_mm=7.0,
                dictionary="DICT_4X4_50")  # fmt: skip


def test_a_perfect_board_has_its_corners_where_they_should_be() -> None:
    made = printed_board(CHESS)
    np.testing.assert_array_equal(made.points_mm, CHESS.points_mm)
    low, high = made.mesh.vertices_mm.min(axis=0), made.mesh.vertices_mm.max(axis=0)
    np.testing.assert_allclose(low, [-6, -6, 0])
    np.testing.assert_allclose(high, [54, 42, 0])
    corners = made.mesh.vertices_mm[made.mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()  # it faces the viewer, and z points away
    area = np.abs(normals[:, 2]) / 2
    assert made.mesh.albedo is not None
    black = made.mesh.albedo[made.mesh.faces[:, 0]] == np.float32(BLACK)
    assert area[black].sum() == pytest.approx(40 * 36)
    assert area[~black].sum() == pytest.approx(40 * 36)
    assert made.mesh.albedo.max() == np.float32(WHITE)


def test_bend_and_print_error_move_the_corners_by_as_much() -> None:
    bent = printed_board(CHESS, bend_mm=0.2)
    assert np.ptp(bent.points_mm[:, 2]) == pytest.approx(0.2)
    assert bent.points_mm[31, 2] == 0  # the middle one
    assert bent.points_mm[0, 2] == pytest.approx(0.2)
    uneven = printed_board(CHESS, print_error_mm=0.01, seed=1)
    error = uneven.points_mm - CHESS.points_mm
    assert error[:, :2].std() == pytest.approx(0.01, rel=0.2)
    assert not error[:, 2].any()
    other = printed_board(CHESS, print_error_mm=0.01, seed=2)
    assert np.abs(other.points_mm - uneven.points_mm).max() > 0.01


def test_a_charuco_board_is_that_of_opencv() -> None:
    """Seen from the front, painted facet by facet: OpenCV finds each corner by its number."""
    for board in (CHARUCO, read_board("charuco:7x6:10mm:7mm:DICT_5X5_100:legacy")):
        made = printed_board(board)
        assert made.mesh.albedo is not None
        scale, margin = 12, 20
        shape = ((board.n_rows + 1) * 10 * scale + 2 * margin,
                 (board.n_cols + 1) * 10 * scale + 2 * margin)  # fmt: skip
        image = np.full(shape, 255, np.uint8)
        colours = made.mesh.albedo[made.mesh.faces[:, 0]]
        for corners, albedo in zip(made.mesh.vertices_mm[made.mesh.faces], colours, strict=True):
            flat = np.round((corners[:, :2] + 10) * scale + margin).astype(np.int32)
            cv2.fillConvexPoly(image, flat, 0 if albedo < 0.5 else 255)
        found = find_corners(image, board)
        assert found.ids.tolist() == list(range(board.n_points))
        expected = (board.points_mm[:, :2] + 10) * scale + margin
        assert np.abs(found.pixels - expected).max() < 1.0


def test_poses_face_the_devices_and_tilt_to_all_sides() -> None:
    poses = board_poses(CHESS, 12, diameter_mm=80, height_mm=25, seed=0)
    normals = np.array([pose.rotation[:, 2] for pose in poses])
    tilt = np.degrees(np.arccos(-normals[:, 2]))
    assert tilt.min() >= 10
    assert tilt.max() <= 35
    assert np.ptp(np.arctan2(normals[:, 1], normals[:, 0])) > np.radians(270)
    middles = np.array([pose.apply(CHESS.points_mm.mean(axis=0)) for pose in poses])
    assert np.abs(middles[:, 2]).max() <= 12.5
    assert np.ptp(middles[:, 2]) > 12


def test_board_files_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "board.toml"
    for board in (CHESS, CHARUCO, read_board("charuco:7x6:0.7:legacy"), read_board("circles:4x5")):
        path.write_text(board_text(board), encoding="utf-8")
        assert read_board(str(path)) == board


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("boards") / "poses"
    main(["simulate", "kolibri", "--object", "chessboard:9x7:6mm", "--positions", "3", "--steps",
          "3", "--camera-size", "320x256", "--bend", "0.1", "--out", str(out)])  # fmt: skip
    return out


def test_corners_lie_where_the_truth_says(series: Path) -> None:
    board, rig = read_board(str(series / "board.toml")), read_rig(series / "rig.toml")
    assert board.text == CHESS.text
    truth = np.load(series / "truth.npz")
    assert np.ptp(truth["board_points_mm"][:, 2]) == pytest.approx(0.1)
    n_seen = 0
    for number, matrix in enumerate(truth["world_from_board"]):
        world = truth["board_points_mm"] @ matrix[:3, :3].T + matrix[:3, 3]
        scan = read_scan(series / f"{number:03d}", with_rig=False)
        for stack, camera in zip(scan.stacks, rig.cameras, strict=True):
            found = find_corners(stack.images[stack.plan.uniform_index(1.0)], board)
            if not len(found.ids):
                continue
            n_seen += 1
            expected = cv_project(camera, world)
            errors = [np.sqrt(np.mean((found.pixels - order[found.ids]) ** 2))
                      for order in (expected, expected[::-1])]  # fmt: skip
            assert min(errors) < 0.15
    assert n_seen >= 4


def test_calibrate_reads_the_series_and_compares_with_the_former_rig(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Lenses are kept; poses come back, and points move by little against the true rig."""
    out = tmp_path / "rig.toml"
    main(["calibrate", str(series), "--board", str(series / "board.toml"), "--rig",
          str(series / "rig.toml"), "--keep-lenses", "--board-shape", "flat", "--out", str(out),
          "--json"])  # fmt: skip
    record = json.loads(capsys.readouterr().out)
    assert all(device["rms_px"] < 0.4 for device in record["devices"])
    compared = record["comparison"]
    assert compared["devices"] == ["c1", "c2"]
    assert compared["form_rms"] < 0.03
    assert compared["scale"] == pytest.approx(1, abs=2e-3)
    assert "compared with the former calibration" in (tmp_path / "rig-board.md").read_text()
    picture = cv2.imread(str(tmp_path / "rig-compared.png"))
    assert picture is not None
    assert picture.std() > 10


def test_a_board_without_a_pitch_is_not_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "kolibri", "--object", "circles:9x7", "--out", str(tmp_path / "new")])
    assert "expected a board with its pitch" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("words", ["circles:4x3:10mm", "asymmetric-circles:3x5:5mm"])
def test_circles_are_round_and_where_they_should_be(words: str) -> None:
    board = read_board(words)
    mesh = printed_board(board).mesh
    corners = mesh.vertices_mm[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()
    assert mesh.albedo is not None
    black = mesh.albedo[mesh.faces[:, 0]] == np.float32(BLACK)
    radius = 0.3 * (10 if board.kind == "circles" else 5 * np.sqrt(2))
    area = -normals[:, 2] / 2
    assert area[black].sum() == pytest.approx(board.n_points * np.pi * radius**2)
    middles = corners[black].mean(axis=1)
    away = np.linalg.norm(middles[:, None] - board.points_mm, axis=2)
    assert away.min(axis=1).max() < radius
    nearest = away.argmin(axis=1)
    for number, point in enumerate(board.points_mm):
        own = nearest == number
        centroid = (middles[own] * area[black][own, None]).sum(axis=0) / area[black][own].sum()
        np.testing.assert_allclose(centroid, point, atol=1e-9)


def test_rendered_circles_are_found_where_the_truth_says() -> None:
    """A tilted pose; with the middles of the ellipses all would lie to one side."""
    preset = PRESETS["wide-depth"]((320, 256))
    board = read_board("circles:6x5:40mm")
    made = printed_board(board)
    turn = Rotation.from_rotvec([0.6, 0.3, 0]).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    pose = RigidTransform(rotation=turn, translation=-turn @ board.points_mm.mean(axis=0))
    scene = preset.scene(made.mesh, background="none", scaled=False).placed(pose)
    light = PatternPlan(patterns=(Uniform(level=1.0),), projector_shape=(768, 1024))
    scan = record(prepare(preset.rig, scene), light, seed=0)
    for stack, camera in zip(scan.stacks, preset.rig.cameras, strict=True):
        found = find_corners(stack.images[0], board)
        assert found.areas is not None
        assert len(found) == board.n_points
        expected = cv_project(camera, pose.apply(made.points_mm))
        off = circle_centers(board, found.ids, found.pixels, found.areas) - expected
        before = found.pixels - expected
        if np.abs(off).max() > 5:
            off = off[::-1] + expected[::-1] - expected
            before = before[::-1] + expected[::-1] - expected
        assert np.linalg.norm(before.mean(axis=0)) > 0.06
        assert np.linalg.norm(off.mean(axis=0)) < 0.02
        assert np.sqrt((off**2).mean()) < 0.05
