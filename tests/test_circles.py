"""Circle grids: an ellipse's middle is not the image of the circle's centre."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from board_series import device
from cv_lens import cv_project, cv_rays
from fringe3d.calibrate import circle_centers
from fringe3d.io.board_images import find_corners
from fringe3d.io.boardfile import read_board
from fringe3d.model import Board

Floats = NDArray[np.float64]

CAMERA = device("c1", "camera", (640, 512), [800, 801], [318, 259], [-0.1, 0.05, 0, 0])
FINE = 5
"""Samples along each side of a pixel: an edge is placed to a fiftieth of a pixel."""

TURN, PLACE = [0.5, -0.4, 0.1], np.array([0.0, 0.0, 330.0])


def picture(
    board: Board, part: float, *, noise: float = 0.0, is_bright: bool = False
) -> tuple[NDArray[np.uint8], Floats]:
    """Return an image of circles with that radius, pitches, and where their centres are seen.

    Dark ones in uneven light, or bright ones before straying light that grows to one side.
    """
    rotation = Rotation.from_rotvec(TURN).as_matrix()
    points = board.points_mm - board.points_mm.mean(axis=0)
    step = (np.arange(FINE) + 0.5) / FINE - 0.5
    rows, cols = ((np.arange(n)[:, None] + step).ravel() for n in CAMERA.shape)
    y, x = np.meshgrid(rows, cols, indexing="ij")
    grey = np.full(y.shape, 3.0 if is_bright else 200.0)
    centers = cv_project(CAMERA, points @ rotation.T + PLACE)
    reach = int(1.3 * part * board.pitch_mm * 800 / 250) + 3
    for point, center in zip(points, centers, strict=True):
        col, row = (FINE * (int(c) - reach) for c in center)
        window = np.s_[row : row + 2 * reach * FINE, col : col + 2 * reach * FINE]
        origin, directions = cv_rays(CAMERA, np.stack([x[window], y[window]], axis=-1))
        depth = ((PLACE - origin) @ rotation[:, 2]) / (directions @ rotation[:, 2])
        on_board = (origin + depth[..., None] * directions - PLACE) @ rotation
        inside = np.linalg.norm(on_board[..., :2] - point[:2], axis=-1) < part * board.pitch_mm
        grey[window][inside] = 200.0 if is_bright else 30.0
    shape = (CAMERA.n_rows, FINE, CAMERA.n_cols, FINE)
    seen = gaussian_filter(grey.reshape(shape).mean(axis=(1, 3)), 0.6)
    light = np.linspace(0.8, 1.1, CAMERA.n_cols)
    seen = seen + 40 * (light - 0.8) if is_bright else seen * light
    seen += np.random.default_rng(0).normal(0, noise, seen.shape)
    return np.clip(np.round(seen), 0, 255).astype(np.uint8), centers


@pytest.mark.parametrize(("words", "part"), [
    ("circles:8x6:24mm", 0.3), ("asymmetric-circles:4x9:18mm", 0.42),
])  # fmt: skip
def test_the_centres_are_found_where_they_are_seen(words: str, part: float) -> None:
    """Without the correction the middles lie beside them, all to one side.

    What is left is the lens, which bends each circle by up to 0.04 px at the corners of the image.
    """
    board = read_board(words)
    image, centers = picture(board, part, noise=1.0)
    found = find_corners(image, board)
    assert found.ids.tolist() == list(range(board.n_points))
    assert found.areas is not None
    corrected = circle_centers(board, found.ids, found.pixels, found.areas)
    order = slice(None) if np.abs(corrected - centers).max() < 5 else slice(None, None, -1)
    before, after = found.pixels - centers[order], corrected - centers[order]
    assert np.linalg.norm(before.mean(axis=0)) > 0.15
    assert np.linalg.norm(after.mean(axis=0)) < 0.01
    assert np.sqrt((after**2).mean()) < 0.03


def test_bright_circles_are_found_as_well() -> None:
    """Straying light that trebles over the image pulls none of them aside."""
    board = read_board("circles:8x6:24mm")
    image, centers = picture(board, 0.3, noise=0.5, is_bright=True)
    found = find_corners(image, board)
    assert found.areas is not None
    corrected = circle_centers(board, found.ids, found.pixels, found.areas)
    order = slice(None) if np.abs(corrected - centers).max() < 5 else slice(None, None, -1)
    error = corrected - centers[order]
    assert np.linalg.norm(error.mean(axis=0)) < 0.01
    assert np.sqrt((error**2).mean()) < 0.03


def test_few_circles_stay_as_they_are() -> None:
    board = read_board("circles:3x2:10mm")
    middles = board.points_mm[:, :2] * 5.0
    areas = np.full(6, np.nan)
    np.testing.assert_array_equal(circle_centers(board, np.arange(6), middles, areas), middles)
