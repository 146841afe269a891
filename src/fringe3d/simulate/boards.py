"""Calibration boards to be simulated: printed unevenly, bent, in random poses."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from fringe3d.model import Board, RigidTransform
from fringe3d.simulate.mesh import Mesh

Floats = NDArray[np.float64]

WHITE, BLACK = 0.8, 0.06
"""Albedo of paper and of toner."""

PARTS = 4
"""Facets along each side of a square, so that a bent one is not flat."""

CIRCLE, CIRCLE_FACETS = 0.3, 64
"""Radius of a circle, part of the distance of neighbours, and the facets around it."""

CELL_PX = 16
"""Resolution at which OpenCV draws a ChArUco board, px for a cell of a marker."""

LEAST_TILT_DEG, MOST_TILT_DEG, MOST_TURN_DEG = 10.0, 35.0, 25.0

SIDEWAYS = 0.08
"""Part of the volume's diameter by which boards stand beside its middle, at most."""

FACING = np.diag([1.0, -1.0, -1.0])
"""The board's z points away from the devices, which look down on the volume."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrintedBoard:
    """A board as it really is.

    Parameters
    ----------
    board : Board; as it should be
    points_mm : (N, 3) float, mm; its corners as they are, in the board frame
    mesh : Mesh; in the board frame
    """

    board: Board
    points_mm: Floats
    mesh: Mesh


def printed_board(
    board: Board, /, *, bend_mm: float = 0.0, print_error_mm: float = 0.0, seed: int = 0
) -> PrintedBoard:
    """Return a board with errors.

    Parameters
    ----------
    board : Board
    bend_mm : float, mm; by how much its rim stands away from the devices, beyond the middle
    print_error_mm : float, mm; standard deviation of the corners' places, along x and y each
    seed : int; of the print

    Notes
    -----
    Between corners the print error is bilinear. The bend is a paraboloid over the corners. Circles
    are black, with a radius of `CIRCLE` of the distance of neighbours.
    """
    shape = _Shape.of(board, bend_mm, print_error_mm, seed)
    flat, is_black = _circle_facets(board) if "circles" in board.kind else _square_facets(board)
    vertices = shape.place(flat).reshape(-1, 3)
    first = 4 * np.arange(len(flat))[:, None]
    front = np.array([[0, 2, 1], [0, 3, 2]])  # which faces -z
    faces = np.concatenate([first + three for three in front]).astype(np.int32)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0
    albedo = np.where(is_black, BLACK, WHITE).repeat(4).astype(np.float32)
    return PrintedBoard(
        board=board,
        points_mm=shape.place(board.points_mm[:, :2]),
        mesh=Mesh(vertices_mm=vertices, faces=faces[has_area], albedo=albedo),
    )


def _square_facets(board: Board) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the facets of a board of squares: corners (n, 4, 2), mm, and which are black."""
    lines = _lines(board)
    x, y = (
        np.concatenate([(square - 1 + lines[:-1]) for square in range(n + 1)] + [[float(n)]])
        for n in (board.n_cols, board.n_rows)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    corners = [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]]
    is_black = _is_black(board, (grid[:-1, :-1] + grid[1:, 1:]) / 2 + 1).ravel()
    return np.stack(corners, axis=2).reshape(-1, 4, 2) * board.pitch_mm, is_black


def _circle_facets(board: Board) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the facets of circles, each in the middle of a cell: as those of squares."""
    angle = 2 * np.pi * np.arange(CIRCLE_FACETS + 1) / CIRCLE_FACETS
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    chord = 2 * np.pi / CIRCLE_FACETS
    rim = CIRCLE * _gap(board) * np.sqrt(chord / np.sin(chord)) * way  # as large as the circle
    edge = way / (2 * np.abs(way).max(axis=1, keepdims=True))
    rings = np.stack([0 * rim, rim / 2, rim, (rim + edge) / 2, edge])
    quads = [rings[:-1, :-1], rings[:-1, 1:], rings[1:, 1:], rings[1:, :-1]]
    cell = np.stack(quads, axis=2)[:, :, ::-1]
    inside = np.repeat([True, True, False, False], CIRCLE_FACETS)
    places = board.points_mm[:, :2] / board.pitch_mm
    n_cols, n_rows = np.round(places.max(axis=0)).astype(int)
    cells = np.stack(np.meshgrid(np.arange(-1, n_cols + 2), np.arange(-1, n_rows + 2)), axis=-1)
    middles = cells.reshape(-1, 2)
    has_circle = (middles[:, None] == np.round(places)).all(axis=2).any(axis=1)
    flat = cell.reshape(1, -1, 4, 2) + middles[:, None, None]
    return flat.reshape(-1, 4, 2) * board.pitch_mm, (has_circle[:, None] & inside).ravel()


def _gap(board: Board) -> float:
    """Return the distance of neighbouring circles, pitches."""
    return float(np.sqrt(2)) if board.kind == "asymmetric-circles" else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Where places of the sheet (x, y), mm, lie in space."""

    middle: Floats
    radius: float
    bend_mm: float
    errors: RegularGridInterpolator

    @staticmethod
    def of(board: Board, bend_mm: float, print_error_mm: float, seed: int) -> _Shape:
        flat = board.points_mm[:, :2]
        middle = (flat[0] + flat[-1]) / 2
        ends = np.round(flat.max(axis=0) / board.pitch_mm).astype(int)
        lines = [np.arange(-1, end + 2) * board.pitch_mm for end in ends]
        rng = np.random.default_rng(seed)
        errors = print_error_mm * rng.standard_normal((*map(len, lines), 2))
        return _Shape(
            middle,
            float(np.linalg.norm(flat[-1] - middle)),
            bend_mm,
            RegularGridInterpolator(lines, errors, bounds_error=False, fill_value=None),
        )

    def place(self, flat: Floats) -> Floats:
        away = np.linalg.norm(flat - self.middle, axis=-1) / self.radius
        return np.concatenate(
            [flat + self.errors(flat), self.bend_mm * away[..., None] ** 2], axis=-1
        )


def _lines(board: Board) -> Floats:
    """Return the lines across a square, 0 to 1, between which it has one colour."""
    if board.kind == "chessboard":
        return np.linspace(0, 1, PARTS + 1)
    side = board.marker_mm / board.pitch_mm
    within = (1 - side) / 2 + side * np.linspace(0, 1, _cells(board) + 1)
    return np.asarray(np.r_[0, within, 1], np.float64)


def _dictionary(board: Board) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(int(getattr(cv2.aruco, board.dictionary)))


def _cells(board: Board) -> int:
    """Return the cells along a side of a marker, with its black rim."""
    return int(_dictionary(board).markerSize) + 2


def _is_black(board: Board, squares: Floats) -> NDArray[np.bool_]:
    """Tell the colour at places (..., 2), counted in squares from the board's own corner."""
    if board.kind == "chessboard":
        return np.asarray(np.floor(squares).sum(axis=-1) % 2 == 0)
    size = (board.n_cols + 1, board.n_rows + 1)
    pattern = cv2.aruco.CharucoBoard(size, board.pitch_mm, board.marker_mm, _dictionary(board))
    pattern.setLegacyPattern(board.is_legacy)
    side = int(np.ceil(CELL_PX * _cells(board) * board.pitch_mm / board.marker_mm))
    image = pattern.generateImage((size[0] * side, size[1] * side))
    x, y = np.moveaxis((squares * side).astype(int), -1, 0)
    return np.asarray(image[y, x] < 128)


def board_poses(
    board: Board, n_poses: int, /, *, diameter_mm: float, height_mm: float, seed: int
) -> tuple[RigidTransform, ...]:
    """Return ``world_from_board`` of a board that is held into a measuring volume.

    Parameters
    ----------
    board : Board
    n_poses : int, >= 1
    diameter_mm, height_mm : float, mm; of the volume about the world's origin
    seed : int

    Notes
    -----
    Tilted by 10 to 35 degrees to all sides in turn, turned in its plane by up to 25 degrees, its
    middle all over the height of the volume.
    """
    rng = np.random.default_rng([seed, 7])
    middle = board.points_mm.mean(axis=0)
    poses = []
    for number in range(n_poses):
        towards = 2 * np.pi * (number * 0.618 + 0.1 * rng.random())
        tilt = np.radians(rng.uniform(LEAST_TILT_DEG, MOST_TILT_DEG))
        turn = np.radians(rng.uniform(-MOST_TURN_DEG, MOST_TURN_DEG))
        lean = Rotation.from_rotvec(tilt * np.array([np.cos(towards), np.sin(towards), 0.0]))
        rotation = lean.as_matrix() @ Rotation.from_euler("z", turn).as_matrix() @ FACING
        side = SIDEWAYS * diameter_mm * rng.uniform(-1, 1, 2)
        place = np.r_[side, height_mm * rng.uniform(-0.5, 0.5)]
        poses.append(RigidTransform(rotation=rotation, translation=place - rotation @ middle))
    return tuple(poses)
