"""Where in the projector the light on the corners of a board comes from.

A corner lies where black meets white: its own pixels mix the light of both, and most of it is that
of the white part, so that their phase is off by up to a third of a pixel. But the board is a plane:
from camera to projector it is a homography, but for the lenses. That is found from all pixels on
the squares, away from their edges; what the lenses bend besides is smooth, and a plane through the
rest around each corner holds it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._homography import apply_homography, homography
from fringe3d.errors import CalibrationError
from fringe3d.model import Board, PhaseMap

Floats = NDArray[np.float64]

EDGE_PX = 2.0
"""Camera pixels beside an edge that may mix black and white."""

MOST_OF_PITCH = 0.25
"""Of the pitch that is left out beside an edge, at most: small squares keep their middle."""

REACH = 1.0
"""Pitches around a corner: the four squares that meet there."""

SAMPLE = 20_000
"""Pixels that the homography is fitted to."""

MIN_PIXELS = 30
ROUNDS = 4
CAUCHY = 3.0
MAD_TO_SIGMA = 1.4826
LEAST_SIGMA_PX = 0.005
"""Projector px; better than any pattern is."""


def light_on_corners(
    board: Board, ids: NDArray[np.int64], pixels: Floats, phases: Sequence[PhaseMap], /
) -> tuple[Floats, Floats]:
    """Return the projector pixels of corners.

    Parameters
    ----------
    board : Board
    ids : (n,) int; numbers of the corners
    pixels : (n, 2) float, px; the corners in the camera
    phases : sequence of PhaseMap; of that camera, absolute, of two directions at least

    Returns
    -------
    (n, 2) float64, (n,) float64, px
        Projector pixels and the standard deviation of each coordinate; NaN where too few pixels
        around a corner are lit.

    Raises
    ------
    CalibrationError
        If there is one direction alone, or a code does not number all periods.
    """
    if len({m.angle for m in phases}) < 2:
        raise CalibrationError(
            f"camera '{phases[0].device_name}': expected fringes or Gray code of two directions on "
            "the board, found one. The place of a corner in the projector needs both"
        )
    for reduced in (m for m in phases if not m.is_absolute):
        raise CalibrationError(
            f"camera '{reduced.device_name}': expected a Gray code that numbers all periods of "
            f"{reduced.period_px:g} px at {np.degrees(reduced.angle):.0f} degrees over the whole "
            "projector, found a shorter one. Record the full code; or, if it is full, exchange the "
            "directions in the description of the scans (rows and columns), or correct the "
            "projector's size"
        )
    light = _projector_pixels(phases)
    places = np.argwhere(np.isfinite(light).all(axis=-1))[:, ::-1].astype(np.float64)
    to_board = homography(pixels, board.points_mm[ids, :2] / board.pitch_mm)
    on_board = apply_homography(to_board, places)
    chosen = _on_squares(board, on_board, to_board, places)
    places, on_board = places[chosen], on_board[chosen]
    found, sigma = np.full((len(ids), 2), np.nan), np.full(len(ids), np.nan)
    if len(places) < MIN_PIXELS:
        return found, sigma
    seen = light[places[:, 1].astype(int), places[:, 0].astype(int)]
    plane = _robust_homography(places, seen)
    rest = seen - apply_homography(plane, places)
    crowd = _pixels_per_cell(plane, pixels) if any(m.is_quantised for m in phases) else 1.0
    corners = board.points_mm[ids, :2] / board.pitch_mm
    for number, corner in enumerate(corners):
        near = (np.abs(on_board - corner) < REACH).all(axis=1)
        if _surrounded(on_board[near] - corner):
            level, spread = _level_at(places[near] - pixels[number], rest[near])
            found[number] = apply_homography(plane, pixels[number][None])[0] + level
            sigma[number] = np.hypot(spread * np.sqrt(crowd), LEAST_SIGMA_PX)
    return found, sigma


def _projector_pixels(phases: Sequence[PhaseMap]) -> Floats:
    """Return (row, col, 2), px: (x, y) in the projector, NaN where a direction is missing."""
    first = phases[0]
    second = next(m for m in phases if m.angle != first.angle)
    across = np.array([[np.cos(m.angle), np.sin(m.angle)] for m in (first, second)])
    w = np.stack([first.position_px, second.position_px], axis=-1)
    return np.asarray(w @ np.linalg.inv(across).T - 0.5)


def _on_squares(
    board: Board, on_board: Floats, to_board: Floats, places: Floats
) -> NDArray[np.bool_]:
    """Tell which pixels lie on the board and away from its edges."""
    size = (board.points_mm[:, :2].max(axis=0)) / board.pitch_mm
    inside = ((on_board > -REACH) & (on_board < size + REACH)).all(axis=1)
    if "circles" in board.kind:
        return np.asarray(inside)
    step = apply_homography(to_board, places + np.array([1.0, 0.0]))
    down = apply_homography(to_board, places + np.array([0.0, 1.0]))
    per_px = np.maximum(np.abs(step - on_board), np.abs(down - on_board))
    margin = np.minimum(EDGE_PX * per_px, MOST_OF_PITCH)
    off_edge = np.abs(on_board - np.round(on_board)) > margin
    return np.asarray(inside & off_edge.all(axis=1))


def _robust_homography(places: Floats, seen: Floats) -> Floats:
    """Return the homography of most pixels."""
    every = max(1, len(places) // SAMPLE)
    source, target = places[::every], seen[::every]
    kept = np.ones(len(source), bool)
    for _ in range(ROUNDS):
        found = homography(source[kept], target[kept])
        miss = np.linalg.norm(apply_homography(found, source) - target, axis=1)
        kept = miss <= CAUCHY * max(float(np.median(miss)), 1e-6)
    return found


def _surrounded(offset: Floats) -> bool:
    """Tell whether there are pixels on two opposite squares at least, the black ones or the white.

    Elsewhere a plane would reach out to a corner from the side that is lit.
    """
    quarter = 2 * (offset[:, 0] > 0) + (offset[:, 1] > 0)
    count = np.bincount(quarter, minlength=4)
    return bool(len(offset) >= MIN_PIXELS and (
        min(count[0], count[3]) >= MIN_PIXELS // 4 or min(count[1], count[2]) >= MIN_PIXELS // 4
    ))  # fmt: skip


def _level_at(offset: Floats, rest: Floats) -> tuple[Floats, float]:
    """Return a plane through the rest, at the corner, (2,), and its standard deviation, px."""
    scale = max(float(np.abs(offset).max()), 1.0)
    terms = np.column_stack([np.ones(len(offset)), offset / scale])
    weight = np.ones(len(offset))
    for _ in range(ROUNDS):
        normal = (terms * weight[:, None]).T @ terms
        coefficients = np.linalg.solve(normal, (terms * weight[:, None]).T @ rest)
        left = np.linalg.norm(rest - terms @ coefficients, axis=1)
        typical = max(float(np.median(left)) / 1.177, 1e-9)
        weight = 1 / (1 + (left / (CAUCHY * typical)) ** 2)
    return coefficients[0], typical * float(np.sqrt(np.linalg.inv(normal)[0, 0]))


def _pixels_per_cell(plane: Floats, pixels: Floats) -> float:
    """Return how many camera pixels share a projector pixel, and with it an error; at least 1."""
    middle = pixels.mean(axis=0)
    corners = apply_homography(plane, middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    area = abs(float(np.linalg.det(corners[1:] - corners[0])))
    return max(1.0, 1 / max(area, 1e-9))
