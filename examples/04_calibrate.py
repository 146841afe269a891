"""Calibrate cameras and projector from a board that is held into the measuring volume.

Here the corners are computed, with noise. From recordings `fringe3d calibrate POSES --board
chessboard:9x7:6mm --out rig.toml` takes them; in Python `fringe3d.io.board_images.find_corners`
finds them, and `fringe3d.board_scans.views_of_scan` what the projector lights them with.
"""

from pathlib import Path

import numpy as np

from fringe3d.calibrate import (
    BoardView,
    DeviceSize,
    calibrate_board,
    check_board,
    leave_poses_out,
)
from fringe3d.geometry import project
from fringe3d.io.boardfile import read_board
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Rig
from fringe3d.simulate import PRESETS
from fringe3d.simulate.boards import board_poses

SIGMA_PX = 0.05

rng = np.random.default_rng(4)
board = read_board("chessboard:9x7:6mm")
true = PRESETS["kolibri"]().rig

views = []
for number, pose in enumerate(board_poses(board, 12, diameter_mm=80, height_mm=25, seed=4)):
    corners = pose.apply(board.points_mm)  # (n, 3), mm, world
    for device in true.devices:
        pixels = project(device, corners) + SIGMA_PX * rng.standard_normal((len(corners), 2))
        size = np.array([device.n_cols, device.n_rows])
        ids = np.flatnonzero(((pixels > 0) & (pixels < size - 1)).all(axis=1))
        views.append(BoardView(device=device.name, pose=str(number), ids=ids, pixels=pixels[ids],
                               sigma_px=SIGMA_PX))  # fmt: skip

sizes = [DeviceSize(name=d.name, role=d.role, shape=d.shape) for d in true.devices]
calibrated = calibrate_board(board, views, sizes)

for device, given in zip(calibrated.devices, true.devices, strict=True):
    error = device.focal_px.mean() / given.focal_px.mean() - 1
    print(f"{device.name}: rms {calibrated.rms_px(device.name):.3f} px, focal length "
          f"{1000 * error:+.2f} per mille of the truth")  # fmt: skip
for finding in check_board(calibrated, leave_poses_out(calibrated)):
    print(f"{finding.level}: {finding.text}")

rig = Rig(cameras=calibrated.devices[:2], projector=calibrated.devices[2], volume=true.volume,
          covariance=calibrated.covariance, provenance="examples/04_calibrate.py")  # fmt: skip
Path("rig.toml").write_text(rig_text(rig), encoding="utf-8")
