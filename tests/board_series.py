"""Views of a board by a known rig, for the tests of the calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cv_lens import cv_project
from fringe3d.calibrate import BoardView, DeviceSize
from fringe3d.model import Board, Device, RigidTransform
from fringe3d.model.device import Role

Floats = NDArray[np.float64]

BOARD = Board(kind="charuco", n_cols=10, n_rows=8, pitch_mm=20.0, marker_mm=15.0)
PLAIN = Board(kind="chessboard", n_cols=9, n_rows=7, pitch_mm=20.0)


def device(
    name: str, role: Role, size: tuple[int, int], focal: ArrayLike, center: ArrayLike,
    distortion: ArrayLike = (), turn: ArrayLike = (0, 0, 0), shift: ArrayLike = (0, 0, 0),
) -> Device:  # fmt: skip
    """Return a device; its world is the first camera."""
    pose = RigidTransform(
        rotation=Rotation.from_rotvec(np.asarray(turn, float)).as_matrix(), translation=shift
    )
    return Device(name=name, role=role, n_rows=size[1], n_cols=size[0], focal_px=focal,
                  center_px=center, distortion=distortion, device_from_world=pose)  # fmt: skip


C1 = device("c1", "camera", (1280, 1024), [1750, 1752], [640, 510], [-0.1, 0.08, 0.0005, -0.0003])
C2 = device("c2", "camera", (1280, 1024), [1765, 1762], [636, 512], [-0.12, 0.1, -0.0004, 0.0003],
            [0, 0.35, 0.02], [-200, 2, 40])  # fmt: skip
PROJECTOR = device("projector", "projector", (1024, 768), [2100, 2098], [514, 700],
                   [-0.05, 0.03, 0.0005, -0.0005], [0.02, 0.17, 0], [-100, 30, 15])  # fmt: skip
RIG = (C1, C2, PROJECTOR)


def sizes(devices: tuple[Device, ...] = RIG) -> list[DeviceSize]:
    """Return what is to be calibrated."""
    return [DeviceSize(name=d.name, role=d.role, shape=d.shape) for d in devices]


def board_poses(n_poses: int, seed: int, *, tilt: float = 0.5) -> list[tuple[Floats, Floats]]:
    """Return poses of the board's middle in the world: rotation vector, rad, and place, mm."""
    rng = np.random.default_rng(seed)
    return [
        (
            np.r_[rng.uniform(-tilt, tilt, 2), rng.uniform(-0.4, 0.4)],
            np.r_[rng.uniform(-25, 25, 2), rng.uniform(500, 640)],
        )
        for _ in range(n_poses)
    ]


def board_views(
    devices: tuple[Device, ...] = RIG,
    board: Board = BOARD,
    *,
    n_poses: int = 12,
    seed: int = 0,
    noise_px: float = 0.05,
    shape_mm: ArrayLike = 0.0,
    tilt: float = 0.5,
) -> list[BoardView]:
    """Return what the devices see; corners outside an image are missing."""
    rng = np.random.default_rng(1000 + seed)
    points = board.points_mm - board.points_mm.mean(axis=0) + np.asarray(shape_mm)
    views = []
    for number, (turn, place) in enumerate(board_poses(n_poses, seed, tilt=tilt)):
        world = Rotation.from_rotvec(turn).apply(points) + place
        for own in devices:
            pixels = cv_project(own, world)
            seen = ((pixels >= 0) & (pixels < [own.n_cols, own.n_rows])).all(axis=1)
            noisy = pixels + rng.normal(0, noise_px, pixels.shape) if noise_px else pixels
            views.append(
                BoardView(device=own.name, pose=f"pose-{number}", ids=np.flatnonzero(seen),
                          pixels=noisy[seen], via="c1" if own.role == "projector" else "")
            )  # fmt: skip
    return views


def errors(found: tuple[Device, ...], true: tuple[Device, ...] = RIG) -> dict[str, float]:
    """Return found minus true for the numbers of `RigCovariance`."""
    result: dict[str, float] = {}
    lens = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    for a, b in zip(found, true, strict=True):
        values = [np.r_[d.focal_px, d.center_px, d.distortion[:8]] for d in (a, b)]
        off = a.device_from_world @ b.device_from_world.inverse()
        turn = Rotation.from_matrix(off.rotation).as_rotvec()
        names = [*lens, *(f"{kind}_{axis}" for kind in ("turn", "shift") for axis in "xyz")]
        numbers = np.r_[values[0] - values[1], turn, off.translation]
        result |= {f"{b.name}.{name}": float(v) for name, v in zip(names, numbers, strict=True)}
    return result
