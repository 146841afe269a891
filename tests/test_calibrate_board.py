"""Calibration by a board: corners of known rigs, mistakes that users make, and real recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from board_series import (
    BOARD,
    C1,
    C2,
    PLAIN,
    PROJECTOR,
    RIG,
    board_views,
    errors,
    sizes,
)
from cv_lens import cv_project
from fringe3d.calibrate import (
    BoardCalibration,
    BoardOptions,
    BoardView,
    bad_poses,
    calibrate_board,
    check_board,
    compare_rigs,
    focal_sigma_by_poses,
    leave_poses_out,
    point_covariance,
    typical_rms_px,
)
from fringe3d.errors import CalibrationError
from fringe3d.model import Board, Device, Rig, RigCovariance, RigidTransform

Floats = NDArray[np.float64]

FLAT = BoardOptions(lens="k1 k2 p1 p2", shape="flat")


@pytest.fixture(scope="module")
def calibrated() -> BoardCalibration:
    """Return the rig from 12 poses with 0.05 px of noise; lens and shape are found."""
    return calibrate_board(BOARD, board_views(), sizes())


def test_the_numbers_of_the_rig_lie_within_their_sigma(calibrated: BoardCalibration) -> None:
    """One run; `docs/simulation.md` has 40. A wrong sign or axis is off by thousands of sigma."""
    off = errors(calibrated.devices)
    pull = [off[name] / calibrated.covariance.sigma(name) for name in calibrated.covariance.names]
    assert max(np.abs(pull)) < 4.5
    assert 0.7 < np.sqrt(np.mean(np.square(pull))) < 1.4
    for name, noise in calibrated.noise_px.items():
        assert noise == pytest.approx(0.05, rel=0.06), name  # 1500 numbers: 2 % each
    assert calibrated.shape == "flat"
    assert {"k1", "p1", "p2"} <= set(calibrated.lenses["c1"].split())
    assert not calibrated.is_open


def test_a_bent_board_is_found_and_the_points_gain_five_fold() -> None:
    x, y = BOARD.points_mm[:, 0] / 180, BOARD.points_mm[:, 1] / 140
    bend = np.zeros((BOARD.n_points, 3))
    bend[:, 2] = 0.2 * (4 * x * (1 - x)) + 0.05 * y
    views = board_views(shape_mm=bend)
    flat = calibrate_board(BOARD, views, sizes(), FLAT)
    found = calibrate_board(BOARD, views, sizes(), replace(FLAT, shape=None))
    assert found.shape == "bent"
    # Up to a plane, which the poses take.
    terms = np.column_stack([np.ones(len(x)), x, y])
    z = bend[:, 2] - found.shape_mm[:, 2]
    rest = z - terms @ np.linalg.lstsq(terms, z, rcond=None)[0]
    assert np.abs(rest).max() < 5 * np.median(found.shape_sigma_mm[:, 2])
    assert np.median(found.shape_sigma_mm[:, 2]) < 0.03
    assert worst_point_mm(flat.devices) > 5 * worst_point_mm(found.devices)
    assert any("bent" in f.text for f in check_board(found, ()))


def worst_point_mm(devices: tuple[Device, ...]) -> float:
    """Return the rms error of points that the devices triangulate from true pixels."""
    grid = np.stack(np.meshgrid([-60, 0, 60], [-50, 0, 50], [520, 570, 620]), -1).reshape(-1, 3)
    rows, right = [], []
    for own, true in zip(devices, RIG, strict=True):
        pixels = cv_project(true, grid)
        for k in (0, 1):
            rows.append([slope(own, grid, axis, k) for axis in range(3)])
            right.append(pixels[:, k] - cv_project(own, grid)[:, k])
    a, b = np.array(rows).transpose(2, 0, 1), np.array(right).T
    off = np.array([np.linalg.lstsq(m, v, rcond=None)[0] for m, v in zip(a, b, strict=True)])
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def slope(own: Device, points: Floats, axis: int, k: int) -> Floats:
    step = 1e-3 * np.eye(3)[axis]
    return (cv_project(own, points + step) - cv_project(own, points - step))[:, k] / 2e-3


def test_the_sigma_of_points_is_that_of_sampled_calibrations(calibrated: BoardCalibration) -> None:
    rng = np.random.default_rng(3)
    covariance = calibrated.covariance
    samples = rng.multivariate_normal(np.zeros(len(covariance.names)), covariance.matrix, 300)
    point = np.array([[30.0, -20.0, 560.0]])
    expected = point_covariance(calibrated.devices, covariance, point)[0]
    moved = []
    for sample in samples:
        devices = [changed(d, covariance, sample) for d in calibrated.devices]
        rows, right = [], []
        for own, other in zip(calibrated.devices, devices, strict=True):
            seen = cv_project(own, point)[0]
            for k in (0, 1):
                rows.append([slope(other, point, axis, k)[0] for axis in range(3)])
                right.append(seen[k] - cv_project(other, point)[0, k])
        moved.append(np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0])
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(np.cov(np.array(moved).T))), np.sqrt(np.diagonal(expected)), rtol=0.15
    )  # 300 samples: 4 %


def test_the_sigma_of_the_form_is_that_of_sampled_calibrations(
    calibrated: BoardCalibration,
) -> None:
    """Sampled rigs against the calibrated one, by rays that meet and a fitted similarity."""
    rng = np.random.default_rng(5)
    own = calibrated.covariance
    samples = rng.multivariate_normal(np.zeros(len(own.names)), own.matrix, 300)
    grid = np.stack(np.meshgrid([-60, 0, 60], [-50, 0, 50], [520, 570, 620]), -1).reshape(-1, 3)
    now = Rig(cameras=calibrated.devices[:2], projector=calibrated.devices[2], covariance=own)
    found = [
        compare_rigs(Rig(cameras=tuple(changed(d, own, s) for d in now.cameras)), now, grid)
        for s in samples
    ]
    moved = np.sqrt(np.mean([(f.moved_mm**2).sum(axis=1) for f in found], axis=0))
    form = np.sqrt(np.mean([(f.form_mm**2).sum(axis=1) for f in found], axis=0))
    assert found[0].counted == ("new",)
    np.testing.assert_allclose(found[0].moved_sigma_mm, moved, rtol=0.15)  # 300 samples: 4 %
    np.testing.assert_allclose(found[0].form_sigma_mm, form, rtol=0.15)
    assert np.median(form) < np.median(moved) / 5


def changed(own: Device, covariance: RigCovariance, sample: Floats) -> Device:
    """Return a device with its numbers changed as `RigCovariance` says."""
    change = {n.rpartition(".")[2]: v for n, v in zip(covariance.names, sample, strict=True)
              if n.startswith(f"{own.name}.")}  # fmt: skip

    def get(*names: str) -> Floats:
        return np.array([change.get(n, 0.0) for n in names])

    turn = Rotation.from_rotvec(get("turn_x", "turn_y", "turn_z")).as_matrix()
    small = RigidTransform(rotation=turn, translation=get("shift_x", "shift_y", "shift_z"))
    distortion = own.distortion[:8] + get("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    return replace(
        own,
        focal_px=own.focal_px + get("fx", "fy"),
        center_px=own.center_px + get("cx", "cy"),
        distortion=distortion,
        device_from_world=small @ own.device_from_world,
    )


def test_the_world_does_not_change_the_covariance_of_points(calibrated: BoardCalibration) -> None:
    first_from_world = RigidTransform(
        rotation=Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), translation=[10, -40, 300]
    )
    elsewhere = calibrated.in_world(first_from_world)
    np.testing.assert_allclose(
        elsewhere.devices[0].device_from_world.rotation, first_from_world.rotation, atol=1e-12
    )
    here = calibrated.devices[1].device_from_world
    there = elsewhere.devices[1].device_from_world @ first_from_world.inverse()
    np.testing.assert_allclose(there.translation, here.translation, atol=1e-9)
    point = np.array([[5.0, 10.0, 580.0]])
    before = point_covariance(calibrated.devices, calibrated.covariance, point)[0]
    moved = first_from_world.inverse().apply(point)
    after = point_covariance(elsewhere.devices, elsewhere.covariance, moved)[0]
    turn = first_from_world.rotation
    np.testing.assert_allclose(turn @ after @ turn.T, before, rtol=1e-6)


def test_known_lenses_stay_and_one_pose_tells_where_devices_stand() -> None:
    views = board_views(n_poses=1, seed=4)
    known = [replace(s, known=d) for s, d in zip(sizes(), RIG, strict=True)]
    found = calibrate_board(BOARD, views, known, BoardOptions(shape="flat"))
    for own, true in zip(found.devices, RIG, strict=True):
        np.testing.assert_array_equal(own.camera_matrix, true.camera_matrix)
        np.testing.assert_array_equal(own.distortion, true.distortion)
    off = errors(found.devices)
    for name in found.covariance.names:
        assert abs(off[name]) < 4.5 * found.covariance.sigma(name)
    assert set(found.lenses.values()) == {"known"}


def test_corners_and_whole_views_may_be_missing() -> None:
    rng = np.random.default_rng(2)
    views = []
    for number, view in enumerate(board_views()):
        if number % 7 == 3:  # this device sees nothing here
            continue
        views.append(view.take(rng.random(len(view)) < 0.6))
    found = calibrate_board(BOARD, views, sizes(), FLAT)
    off = errors(found.devices)
    pull = [off[name] / found.covariance.sigma(name) for name in found.covariance.names]
    assert max(np.abs(pull)) < 4.5


def test_wrong_corners_hardly_matter() -> None:
    rng = np.random.default_rng(5)
    views = []
    for view in board_views():
        pixels = view.pixels.copy()
        wrong = rng.random(len(view)) < 0.02
        pixels[wrong] += rng.normal(0, 5, (int(wrong.sum()), 2))
        views.append(replace(view, pixels=pixels))
    found = calibrate_board(BOARD, views, sizes(), FLAT)
    off = errors(found.devices)
    assert max(abs(off[f"c1.{k}"]) / found.covariance.sigma(f"c1.{k}") for k in ("fx", "cx")) < 4
    assert found.noise_px["c1"] == pytest.approx(0.05, rel=0.15)


def test_a_board_that_looks_the_same_turned_by_half_is_put_right() -> None:
    views = board_views(board=PLAIN)
    order = PLAIN.half_turned
    assert order is not None
    rng = np.random.default_rng(1)
    turned = {(f"pose-{k}", c) for k in range(12) for c in ("c1", "c2") if rng.random() < 0.5}
    mixed = [v.renumbered(order) if (v.pose, v.via or v.device) in turned else v for v in views]
    found = calibrate_board(PLAIN, mixed, sizes(), FLAT)
    assert max(found.rms_px(d.name) for d in RIG) < 0.1
    off = errors(found.devices)
    assert abs(off["c2.shift_x"]) < 4.5 * found.covariance.sigma("c2.shift_x")


def test_a_camera_on_its_head_is_put_right() -> None:
    """It sees the board the other way round in all poses: only the other camera tells."""
    turn = RigidTransform(rotation=np.diag([-1.0, -1.0, 1.0]), translation=[0, 0, 0])
    upside = replace(C2, device_from_world=turn @ C2.device_from_world)
    devices = (C1, upside)
    found = calibrate_board(PLAIN, board_views(devices, PLAIN), sizes(devices), FLAT)
    off = errors(found.devices, devices)
    assert max(found.rms_px(d.name) for d in devices) < 0.1
    assert abs(off["c2.shift_x"]) < 4.5 * found.covariance.sigma("c2.shift_x")


def test_a_mirrored_order_in_one_pose_is_put_right() -> None:
    views = board_views(board=PLAIN)
    row, col = np.divmod(np.arange(PLAIN.n_points), PLAIN.n_cols)
    order = row * PLAIN.n_cols + PLAIN.n_cols - 1 - col
    mixed = [v.renumbered(order) if (v.pose, v.via or v.device) == ("pose-3", "c1") else v
             for v in views]  # fmt: skip
    found = calibrate_board(PLAIN, mixed, sizes(), FLAT)
    assert max(found.rms_px(d.name) for d in RIG) < 0.1


def swapped(view: BoardView) -> BoardView:
    return replace(view, pixels=view.pixels[:, ::-1])


@pytest.mark.parametrize(("name", "message"), [
    ("projector", "projector 'projector': sees the board mirrored in 12 of 12 poses. Rows and"),
    ("c2", "camera 'c2': sees the board mirrored in 12 of 12 poses. Its images are mirrored"),
])  # fmt: skip
def test_rows_and_columns_exchanged_are_named(name: str, message: str) -> None:
    views = [swapped(v) if v.device == name else v for v in board_views()]
    with pytest.raises(CalibrationError, match=message):
        calibrate_board(BOARD, views, sizes(), FLAT)


def test_rows_and_columns_exchanged_in_one_pose_are_named_once_and_left_out() -> None:
    """What is left of the pose, the cameras' views, is used: the rig comes out as it is."""
    views = [swapped(v) if (v.pose, v.device) == ("pose-4", "projector") else v
             for v in board_views()]  # fmt: skip
    found = calibrate_board(BOARD, views, sizes(), FLAT)
    bad = [f.text for f in check_board(found, ()) if f.name in ("bad_pose_rms_px", "mirrored_view")]
    assert len(bad) == 1
    assert "pose pose-4: 'projector' sees the board mirrored, c1 not: in this recording" in bad[0]
    assert "rows and columns of the patterns are exchanged" in bad[0]
    assert {v.device for v in found.views if v.pose == "pose-4"} == {"c1", "c2"}
    assert max(found.rms_px(d.name) for d in RIG) < 0.1
    off = errors(found.devices)
    assert abs(off["projector.shift_x"]) < 4.5 * found.covariance.sigma("projector.shift_x")


def test_too_few_corners_are_named() -> None:
    views = [v.take(np.arange(len(v)) < 7) if v.device == "c2" else v for v in board_views()]
    with pytest.raises(CalibrationError, match=r"camera 'c2': expected the board in at least 3 .* "
                       r"in 0 \(pose-0: c2: 7 corners, expected at least 8"):  # fmt: skip
        calibrate_board(BOARD, views, sizes(), FLAT)


def test_corners_on_a_line_do_not_count() -> None:
    views = [v.take(v.ids < 10) if v.pose == "pose-0" else v for v in board_views()]
    found = calibrate_board(BOARD, views, sizes(), FLAT)
    assert "pose-0: c1: all corners lie on a line" in found.left_out


def test_parallel_poses_are_named() -> None:
    with pytest.raises(CalibrationError, match="expected the board tilted differently, found all"):
        calibrate_board(BOARD, board_views(tilt=0.0), sizes(), FLAT)


def test_one_camera_used_twice_is_named() -> None:
    twin = replace(C1, name="c2")
    views = board_views((C1, twin))
    with pytest.raises(CalibrationError, match="'c2': expected another place than that of 'c1'"):
        calibrate_board(BOARD, views, sizes((C1, twin)), FLAT)


def test_images_of_other_poses_are_named() -> None:
    """The second camera's folders are in another order."""
    names = {f"pose-{k}": f"pose-{(5 * k + 2) % 12}" for k in range(12)}
    views = [replace(v, pose=names[v.pose]) if v.device == "c2" else v for v in board_views()]
    with pytest.raises(CalibrationError, match="expected it to stand alike to the other devices"):
        calibrate_board(BOARD, views, sizes(), FLAT)


def test_parts_of_a_board_that_are_found_in_other_places_fit_no_rig() -> None:
    """Of a larger board the second camera finds another part in each second pose, a column on."""
    whole = calibrate_board(BOARD, board_views(), sizes(), FLAT)
    n_cols = BOARD.n_cols - 1
    views = [
        replace(part, ids=part.ids - 1)
        if v.device == "c2" and int(v.pose[5:]) % 2 and (part := v.take(v.ids % n_cols > 0))
        else v
        for v in board_views()
    ]
    _, good = typical_rms_px(whole)
    _, bad = typical_rms_px(calibrate_board(BOARD, views, sizes(), FLAT))
    assert good < 0.2
    assert bad > 3.0


def test_devices_without_a_common_pose_are_named() -> None:
    views = [v for k, v in enumerate(board_views((C1, C2))) if (k // 2 < 6) == (v.device == "c1")]
    with pytest.raises(CalibrationError, match="camera 'c2': expected poses in which it and c1"):
        calibrate_board(BOARD, views, sizes((C1, C2)), FLAT)


def test_a_pose_of_another_camera_is_a_bad_pose_with_its_reason() -> None:
    zoomed = replace(C2, focal_px=np.array([1500.0, 1500.0]))
    views = board_views()
    other = board_views((C1, zoomed, PROJECTOR))
    mixed = [b if (b.pose, b.device) == ("pose-5", "c2") else a
             for a, b in zip(views, other, strict=True)]  # fmt: skip
    found = calibrate_board(BOARD, mixed, sizes(), FLAT)
    bad = [f for f in check_board(found, ()) if f.level == "warning"]
    assert any("pose pose-5" in f.text and "camera 'c2'" in f.text for f in bad)
    assert any("--leave-out pose-5" in f.text for f in bad)


def test_a_board_that_moved_is_told_from_blurred_corners() -> None:
    views = board_views()
    rng = np.random.default_rng(8)
    moved = [replace(v, pixels=v.pixels + np.array([0.8, -0.4]))
             if (v.pose, v.device) == ("pose-2", "c2") else v for v in views]  # fmt: skip
    found = calibrate_board(BOARD, moved, sizes(), FLAT)
    (text,) = (f.text for f in check_board(found, ()) if f.level == "warning" and "pose" in f.name)
    assert "pose pose-2" in text
    assert "it moved during the recording" in text
    # 0.9 px at 1765 px and about 0.6 m; the camera alone tells sideways shifts best.
    shift = float(text.partition("all devices together (")[2].split()[0])
    assert 0.1 < shift < 1.0
    (bad,) = bad_poses(found)
    assert bad.worst == "c2"
    without = found.rms_px("c2", without={"pose-2"})
    assert without < 0.08  # 0.05 px in x and y
    assert found.rms_px("c2") > 1.5 * without
    blurred = [replace(v, pixels=v.pixels + rng.normal(0, 0.8, v.pixels.shape))
               if (v.pose, v.device) == ("pose-2", "c2") else v for v in views]  # fmt: skip
    found = calibrate_board(BOARD, blurred, sizes(), FLAT)
    text = " ".join(f.text for f in check_board(found, ()) if f.level == "warning")
    assert "all corners are off" in text


def test_leaving_poses_out_shows_the_noise_of_the_rest(calibrated: BoardCalibration) -> None:
    left_out = leave_poses_out(calibrated)
    assert [p.pose for p in left_out] == list(calibrated.world_from_board)
    rms = np.mean([p.rms_px["c1"] for p in left_out])
    assert rms == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    by_poses = focal_sigma_by_poses(calibrated, left_out)
    # Independent noise: both ways estimate the same; the jackknife of 12 poses to a quarter.
    for own in RIG:
        sigma = calibrated.covariance.sigma(f"{own.name}.fx")
        assert 0.5 < by_poses[own.name] / sigma < 2


def test_few_poses_determine_the_focal_length_poorly() -> None:
    found = calibrate_board(BOARD, board_views(n_poses=4, noise_px=0.3), sizes(), FLAT)
    finding = next(f for f in check_board(found, leave_poses_out(found))
                   if f.name == "focal_sigma_part")  # fmt: skip
    assert finding.level == "warning"
    assert "only 4 poses: the focal lengths are determined poorly (c1 17" in finding.text


def test_a_board_without_a_pitch_has_no_scale() -> None:
    board = replace(BOARD, pitch_mm=1.0, marker_mm=0.5, has_scale=False)
    found = calibrate_board(board, board_views(), sizes(), FLAT)
    ratio = found.devices[1].device_from_world.translation / C2.device_from_world.translation
    np.testing.assert_allclose(ratio[[0, 2]], 1 / 20, rtol=0.01)
    assert any(f.name == "has_scale" and f.level == "warning" for f in check_board(found, ()))


def test_views_are_checked() -> None:
    with pytest.raises(ValueError, match="each corner once"):
        BoardView(device="c1", pose="a", ids=[1, 1], pixels=[[0, 0], [1, 1]])
    with pytest.raises(ValueError, match="finite pixels"):
        BoardView(device="c1", pose="a", ids=[1], pixels=[[0, np.nan]])
    views = [BoardView(device="c9", pose="a", ids=[1], pixels=[[0, 0]])]
    with pytest.raises(ValueError, match="found 'c9'"):
        calibrate_board(BOARD, views, sizes())


@pytest.mark.parametrize(("kind", "cols", "rows", "turns"), [
    ("chessboard", 9, 7, True), ("chessboard", 9, 6, False), ("circles", 9, 6, True),
    ("asymmetric-circles", 4, 11, False), ("asymmetric-circles", 4, 10, True),
])  # fmt: skip
def test_boards_know_whether_they_look_the_same_turned_by_half(
    kind: str, cols: int, rows: int, turns: bool
) -> None:
    board = Board(kind=kind, n_cols=cols, n_rows=rows)  # type: ignore[arg-type]
    assert (board.half_turned is not None) == turns
