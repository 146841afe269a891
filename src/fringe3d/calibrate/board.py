"""Calibration of cameras and projector from views of a board: one bundle adjustment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._board_information import Information, information
from fringe3d.calibrate._board_lens import (
    LADDER,
    BoardLens,
    BoardLensTrial,
    choose_board_lens,
    free_of,
)
from fringe3d.calibrate._board_orders import together, unmirrored, upright
from fringe3d.calibrate._board_shape import (
    BoardShape,
    ShapeTrial,
    choose_shape,
    settled_shape,
    with_shape,
)
from fringe3d.calibrate._board_start import Alone, calibrated_alone, groups_of, settled
from fringe3d.calibrate._board_views import checked
from fringe3d.calibrate._bundle import (
    N_DEVICE,
    N_LENS,
    Loss,
    Problem,
    State,
    batches_of,
    residuals,
)
from fringe3d.calibrate.board_view import BoardView
from fringe3d.errors import CalibrationError
from fringe3d.model import Board, Device, RigCovariance, RigidTransform
from fringe3d.model.html import table

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceSize:
    """A device to be calibrated.

    Parameters
    ----------
    name : str
    role : "camera" or "projector"
    shape : (n_rows, n_cols)
    known : Device or None; its lens is kept as it is
    """

    name: str
    role: Literal["camera", "projector"]
    shape: tuple[int, int]
    known: Device | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardOptions:
    """How to calibrate.

    Parameters
    ----------
    lens : str or None; distortion terms, one of `BOARD_LENSES`; None takes as many for each device
        as the corners demand
    shape : "flat", "bent" (points leave the plane), "free" (they are also printed unevenly) or
        None; None takes what fits poses best that were left out
    loss : "cauchy", "huber" or "squared"
    """

    lens: BoardLens | None = None
    shape: BoardShape | None = None
    loss: Loss = "cauchy"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardCalibration:
    """Calibrated devices, and the evidence for them.

    Parameters
    ----------
    board : Board
    devices : tuple of Device; the first is the reference
    covariance : RigCovariance
    lenses : dict of str to str; the distortion terms of each device
    trials : dict of str to tuple of BoardLensTrial; empty where the lens was given
    shape : "flat", "bent" or "free"
    shape_trials : tuple of ShapeTrial; empty where the shape was given
    world_from_board : dict of str to RigidTransform; for each pose
    shape_mm, shape_sigma_mm : (N, 3) float, mm; displacement of the board's points, and its
        standard deviation
    views : tuple of BoardView; as used, corners in matching order
    left_out : tuple of str; views that tell nothing, and why
    mirrored : tuple of str; views of the projector that are mirrored and so left out, and why
    residual_px : tuple of (n, 2) float, px; of each view, model minus measurement
    noise_px : dict of str to float, px; standard deviation of a coordinate of a corner
    condition, weakest, is_open
        See `Information`.
    """

    board: Board
    devices: tuple[Device, ...]
    covariance: RigCovariance
    lenses: dict[str, BoardLens]
    trials: dict[str, tuple[BoardLensTrial, ...]]
    shape: BoardShape
    shape_trials: tuple[ShapeTrial, ...]
    world_from_board: dict[str, RigidTransform]
    shape_mm: Floats
    shape_sigma_mm: Floats
    views: tuple[BoardView, ...]
    left_out: tuple[str, ...]
    mirrored: tuple[str, ...]
    residual_px: tuple[Floats, ...]
    noise_px: dict[str, float]
    condition: float
    weakest: tuple[tuple[str, float], ...]
    is_open: bool
    _problem: Problem
    _state: State

    def _repr_html_(self) -> str:
        rows = [
            (device.name, f"rms {self.rms_px(device.name):.3f} px, lens {self.lenses[device.name]}")
            for device in self.devices
        ]
        rows.append(("poses", str(len(self.world_from_board))))
        rows += [("left out", text) for text in (*self.left_out, *self.mirrored)]
        return table(f"calibration by a {self.board.text}, {self.shape}", rows)

    def in_world(self, first_from_world: RigidTransform, /) -> BoardCalibration:
        """Return the calibration in another world frame; so far the first device is the world."""
        here = self.devices[0].device_from_world
        old_from_new = here.inverse() @ first_from_world
        return replace(
            self,
            devices=tuple(
                replace(device, device_from_world=device.device_from_world @ old_from_new)
                for device in self.devices
            ),
            world_from_board={
                pose: old_from_new.inverse() @ transform
                for pose, transform in self.world_from_board.items()
            },
        )

    def rms_px(
        self, device: str, /, *, pose: str | None = None, without: Collection[str] = ()
    ) -> float:
        """Return the root mean square distance of corners, px; NaN where there is none.

        Of one pose, or of all but those to do without.
        """
        own = [
            r
            for r, v in zip(self.residual_px, self.views, strict=True)
            if v.device == device and pose in (None, v.pose) and v.pose not in without
        ]
        if not own:
            return float("nan")
        return float(np.sqrt(np.mean((np.concatenate(own) ** 2).sum(axis=1))))


def calibrate_board(
    board: Board,
    views: Sequence[BoardView],
    devices: Sequence[DeviceSize],
    options: BoardOptions | None = None,
    /,
) -> BoardCalibration:
    """Calibrate devices from views of a board.

    Parameters
    ----------
    board : Board
    views : sequence of BoardView
    devices : sequence of DeviceSize; the first, a camera, is the reference
    options : BoardOptions or None (defaults)

    Returns
    -------
    BoardCalibration

    Raises
    ------
    CalibrationError
        If a device has too few corners or poses, all poses are parallel, orders of corners are
        mirrored, or the devices do not see one board.

    Notes
    -----
    Least squares of the distances of corners, in units of the noise that the residuals of each
    device show, with the loss of Cauchy (3 sigma) or Huber; Levenberg and Marquardt. The pose of
    the first device is given; all others are free.
    """
    options = options or BoardOptions()
    roles: dict[str, str] = {device.name: device.role for device in devices}
    names = tuple(roles)
    kept, left_out = checked(board, views, devices)
    kept, mirrored = unmirrored(board, kept, roles)
    kept = upright(board, kept)
    alone = {device.name: _alone(board, kept, device, options) for device in devices}
    kept, placed, poses = together(board, kept, alone, roles)
    lenses = {d.name: "known" if d.known else options.lens or LADDER[-1] for d in devices}
    problem = _problem(board, kept, names, lenses, options)
    problem, at = settled(problem, _start(problem, kept, alone, placed, poses))
    shape = options.shape
    shape_trials: tuple[ShapeTrial, ...] = ()
    if shape is None:
        problem, at, shape_trials, shape = choose_shape(problem, at)
    elif shape != "flat":
        problem, at = settled_shape(with_shape(problem, shape), at)
    info = information(problem, at, names)
    trials: dict[str, tuple[BoardLensTrial, ...]] = {}
    if options.lens is None:
        lenses, trials = _chosen_lenses(devices, at, info)
        problem, at = _simpler(problem, at, lenses)
        info = information(problem, at, names)
    result = _result(board, kept, devices, problem, at, info)
    return replace(
        result,
        lenses=lenses,
        trials=trials,
        shape=shape,
        shape_trials=shape_trials,
        left_out=left_out,
        mirrored=mirrored,
    )


def _alone(
    board: Board, views: tuple[BoardView, ...], device: DeviceSize, options: BoardOptions
) -> Alone:
    """Calibrate a device by itself."""
    own = [v for v in views if v.device == device.name]
    if device.known is None:
        return calibrated_alone(board.points_mm, own, device.shape, free_of(options.lens or "k1"))
    known = device.known
    lens = np.r_[known.focal_px, known.center_px, known.distortion[:8]]
    free = np.zeros(N_DEVICE, bool)
    return calibrated_alone(board.points_mm, own, device.shape, free, lens=lens)


def _problem(
    board: Board,
    views: tuple[BoardView, ...],
    names: tuple[str, ...],
    lenses: dict[str, BoardLens],
    options: BoardOptions,
) -> Problem:
    free = np.stack([free_of(lenses[name]) for name in names])
    free[1:, N_LENS:] = True
    poses = list(dict.fromkeys(view.pose for view in views))
    points = board.points_mm
    return Problem(
        points=points,
        batches=batches_of(groups_of(views, names, poses)),
        free=free,
        shape_free=np.zeros((len(points), 3), bool),
        shape_sigma=np.ones(3),
        loss=options.loss,
        noise=np.ones(len(names)),
    )


def _chosen_lenses(
    devices: Sequence[DeviceSize], at: State, info: Information
) -> tuple[dict[str, BoardLens], dict[str, tuple[BoardLensTrial, ...]]]:
    lenses: dict[str, BoardLens] = {}
    trials: dict[str, tuple[BoardLensTrial, ...]] = {}
    for number, device in enumerate(devices):
        lenses[device.name] = "known"
        if device.known is None:
            tried, chosen = choose_board_lens(device.name, number, at, info)
            trials[device.name], lenses[device.name] = tried, chosen
    return lenses, trials


def _simpler(problem: Problem, at: State, lenses: dict[str, BoardLens]) -> tuple[Problem, State]:
    """Adjust again with the lenses that were chosen, begun from the fuller ones."""
    free = problem.free.copy()
    free[:, :N_LENS] = [free_of(lens)[:N_LENS] for lens in lenses.values()]
    dropped = problem.free[:, :N_LENS] & ~free[:, :N_LENS]
    return settled(replace(problem, free=free), replace(at, lens=np.where(dropped, 0.0, at.lens)))


def _start(
    problem: Problem,
    views: tuple[BoardView, ...],
    alone: dict[str, Alone],
    placed: dict[str, RigidTransform],
    poses: dict[str, RigidTransform],
) -> State:
    order = list(dict.fromkeys(v.pose for v in views))
    return State(
        lens=np.stack([found.lens for found in alone.values()]),
        device_rotation=np.stack([placed[name].rotation for name in alone]),
        device_shift=np.stack([placed[name].translation for name in alone]),
        pose_rotation=np.stack([poses[pose].rotation for pose in order]),
        pose_shift=np.stack([poses[pose].translation for pose in order]),
        shape=np.zeros_like(problem.points),
    )


def _result(
    board: Board,
    views: tuple[BoardView, ...],
    devices: Sequence[DeviceSize],
    problem: Problem,
    at: State,
    info: Information,
) -> BoardCalibration:
    found = residuals(problem, at)
    if not all(np.isfinite(r).all() for r in found):
        raise CalibrationError(
            "calibration: expected finite residuals, found others. Check --board"
        )
    poses = list(dict.fromkeys(v.pose for v in views))
    noise = {}
    for number, device in enumerate(devices):
        sigma = np.concatenate([v.sigma_px for v in views if v.device == device.name])
        noise[device.name] = float(problem.noise[number] * np.median(sigma))
    return BoardCalibration(
        board=board,
        devices=tuple(_device(d, at, k) for k, d in enumerate(devices)),
        covariance=RigCovariance(names=info.names, matrix=info.covariance),
        lenses={},
        trials={},
        shape="flat",
        shape_trials=(),
        world_from_board={
            pose: RigidTransform(rotation=at.pose_rotation[k], translation=at.pose_shift[k])
            for k, pose in enumerate(poses)
        },
        shape_mm=at.shape,
        shape_sigma_mm=info.shape_sigma,
        views=views,
        left_out=(),
        mirrored=(),
        residual_px=tuple(found),
        noise_px=noise,
        condition=info.condition,
        weakest=info.weakest,
        is_open=info.is_open,
        _problem=problem,
        _state=at,
    )


def _device(size: DeviceSize, at: State, number: int) -> Device:
    lens = at.lens[number]
    pose = RigidTransform(rotation=at.device_rotation[number], translation=at.device_shift[number])
    return Device(
        name=size.name,
        role=size.role,
        n_rows=size.shape[0],
        n_cols=size.shape[1],
        focal_px=lens[:2],
        center_px=lens[2:4],
        distortion=lens[4:12] if lens[9:].any() else lens[4:9],
        device_from_world=pose,
    )
