"""``fringe3d simulate --object chessboard:9x7:7mm``: series of a board, for ``calibrate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fringe3d.errors import MethodError
from fringe3d.io.boardfile import KINDS, board_text, read_board
from fringe3d.io.rigfile import rig_text
from fringe3d.io.simulation import write_truth
from fringe3d.model import Board, Rig, RigidTransform
from fringe3d.simulate import Preset, Scene, Surface
from fringe3d.simulate.boards import PrintedBoard, board_poses, printed_board

N_POSES = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSeries:
    """A board as it really is, and its poses."""

    printed: PrintedBoard
    poses: tuple[RigidTransform, ...]

    def scenes(self, preset: Preset, surface: Surface, background: str) -> list[Scene]:
        """Return a scene for each pose; a board is held up, so a table becomes a wall."""
        behind = "wall" if background == "table" else background
        scene = preset.scene(self.printed.mesh, surface, background=behind, scaled=False)
        return [scene.placed(pose) for pose in self.poses]


def is_board(thing: str, /) -> bool:
    """Tell whether ``--object`` names a calibration board."""
    return thing.partition(":")[0].lower() in KINDS or thing.lower().endswith(".toml")


def board_series(
    thing: str, preset: Preset, /, *, n_poses: int, bend_mm: float, print_error_mm: float, seed: int
) -> BoardSeries:
    """Return the board that ``--object`` names, held into the volume of a preset.

    Raises
    ------
    MethodError
        If the board has no pitch, or is of a kind that cannot be simulated.
    """
    board = read_board(thing)
    if not board.has_scale:
        raise MethodError(f"--object {thing}: expected a board with its pitch, as {thing}:7mm")
    poses = board_poses(
        board, n_poses, diameter_mm=preset.diameter_mm, height_mm=preset.height_mm, seed=seed
    )
    printed = printed_board(board, bend_mm=bend_mm, print_error_mm=print_error_mm, seed=seed)
    return BoardSeries(printed=printed, poses=poses)


def write_series_truth(folder: Path, series: BoardSeries, rig: Rig, /) -> None:
    """Write ``board.toml`` (as it should be), ``rig.toml`` (which moved devices no longer obey) and
    ``truth.npz`` (as it is)."""
    board: Board = series.printed.board
    (folder / "board.toml").write_text(board_text(board), encoding="utf-8")
    (folder / "rig.toml").write_text(rig_text(rig), encoding="utf-8")
    matrices = np.tile(np.eye(4), (len(series.poses), 1, 1))
    for matrix, pose in zip(matrices, series.poses, strict=True):
        matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.translation
    write_truth(
        folder / "truth.npz",
        {
            "board_points_mm": series.printed.points_mm,
            "nominal_points_mm": board.points_mm,
            "world_from_board": matrices,
        },
    )
