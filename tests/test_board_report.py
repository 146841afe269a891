"""What the report of a calibration says of parts of the image and of the measuring volume."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from board_series import BOARD, RIG, board_views, sizes
from fringe3d.calibrate import (
    BoardCalibration,
    BoardOptions,
    calibrate_board,
    check_board,
    compare_rigs,
)
from fringe3d.model import MeasuringVolume, Rig, RigidTransform
from fringe3d.report.board import board_record, board_text, volume_grid
from fringe3d.report.board_pictures import draw_board
from fringe3d.report.board_regions import CELLS, regions_of
from fringe3d.report.comparison import comparison_record
from fringe3d.report.volume_pictures import draw_comparison, draw_volume

VOLUME = MeasuringVolume.box([-60, -50, 540], [60, 50, 600])


@pytest.fixture(scope="module")
def found() -> BoardCalibration:
    """Return a calibration one of whose poses is off in c2."""
    views = [replace(v, pixels=v.pixels + 0.8) if (v.pose, v.device) == ("pose-2", "c2") else v
             for v in board_views(n_poses=6)]  # fmt: skip
    return calibrate_board(BOARD, views, sizes(), BoardOptions(lens="k1 k2 p1 p2", shape="flat"))


def rig_of(found: BoardCalibration) -> Rig:
    c1, c2, projector = found.devices
    return Rig(cameras=(c1, c2), projector=projector, volume=VOLUME, covariance=found.covariance)


def test_regions_hold_every_corner_where_it_lies(found: BoardCalibration) -> None:
    for device in found.devices:
        regions = regions_of(found, device)
        n = regions.n_corners
        assert n.shape == CELLS[::-1]
        assert n.sum() == sum(len(v) for v in found.views if v.device == device.name)
        squares = np.where(n > 0, n * regions.rms_px**2, 0.0).sum() / n.sum()
        assert np.sqrt(squares) == pytest.approx(found.rms_px(device.name))
        # The lower right part, counted anew: pixel centres are whole numbers.
        left, top = 7 / 8 * device.n_cols - 0.5, 5 / 6 * device.n_rows - 0.5
        own = np.concatenate([v.pixels for v in found.views if v.device == device.name])
        assert n[-1, -1] == (own >= [left, top]).all(axis=1).sum()


def test_what_corners_share_is_seen_and_noise_is_not(found: BoardCalibration) -> None:
    """A lens without its distortion leaves corners drawn towards or from the middle."""
    straight = calibrate_board(BOARD, board_views(n_poses=6), sizes(), BoardOptions(
        lens="pinhole", shape="flat"))  # fmt: skip
    of_lens, of_noise = (
        np.nanmedian(np.linalg.norm(regions_of(f, f.devices[0]).shared_px, axis=-1))
        for f in (straight, found)
    )
    assert of_lens > 4 * of_noise


def test_points_of_the_volume_lie_in_it_and_are_seen_by_all() -> None:
    rig = Rig(cameras=RIG[:2], projector=RIG[2], volume=VOLUME)
    points, depths = volume_grid(rig)
    known = np.asarray(np.isfinite(points).all(axis=-1))
    assert known.reshape(len(known), -1).any(axis=1).all()
    assert VOLUME.contains(points[known]).all()
    for plane, depth in zip(points, depths, strict=True):
        inside = plane[np.isfinite(plane).all(axis=-1)]
        np.testing.assert_allclose(inside[:, 2], depth)  # C1 is the world
    assert depths[0] == pytest.approx(540 + 0.2 * 60)


def test_bad_poses_do_not_hide_what_the_others_are_worth(found: BoardCalibration) -> None:
    record = board_record(found, (), check_board(found, ()), rig_of(found), (540, 600))
    assert record["bad_poses"] == ["pose-2"]
    c2 = record["devices"][1]
    assert c2["rms_px"] > 0.3 > 0.1 > c2["rms_of_good_poses_px"]
    text = board_text(record)
    assert "of good poses" in text
    assert "of their form, without a motion and a scale" in text
    assert sum(f["name"] == "bad_pose_rms_px" for f in record["health"]) == 1
    json.dumps(record)  # what is not known is null


def test_a_former_calibration_is_judged_by_what_is_to_be_expected(found: BoardCalibration) -> None:
    now = rig_of(found)
    points, _ = volume_grid(now)
    for turn_deg, words in ((0.0, "no more than to be expected"), (0.5, "the rig has changed")):
        knock = RigidTransform(
            rotation=Rotation.from_euler("y", turn_deg, degrees=True).as_matrix(),
            translation=[0, 0, 0],
        )
        c2 = replace(now.cameras[1], device_from_world=knock @ now.cameras[1].device_from_world)
        compared = compare_rigs(replace(now, cameras=(now.cameras[0], c2)), now, points)
        record = comparison_record(compared)
        assert words in record["text"]
        assert record["sigma_of"] == ["former", "new"]
    bare = replace(now, covariance=None)
    text = comparison_record(compare_rigs(bare, bare, points))["text"]
    assert "No calibration says how certain it is" in text


def test_pictures_are_drawn(found: BoardCalibration, tmp_path: Path) -> None:
    """That they show something; what, eyes have judged."""
    rig = rig_of(found)
    record = board_record(found, (), check_board(found, ()), rig, (540, 600))
    points, depths = volume_grid(rig)
    compared = compare_rigs(replace(rig, covariance=None), rig, points)
    draw_board(tmp_path / "board.png", found, record, overwrite=False)
    draw_volume(tmp_path / "volume.png", found, points, depths, overwrite=False)
    draw_comparison(tmp_path / "compared.png", compared, rig.cameras[0], depths, overwrite=False)
    for name in ("board", "volume", "compared"):
        picture = cv2.imread(str(tmp_path / f"{name}.png"))
        assert picture is not None
        assert picture.std() > 10
