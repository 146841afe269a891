"""Corners of calibration boards in images, by OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import PlanError
from fringe3d.io.circle_images import measured_circles
from fringe3d.model import Board
from fringe3d.model.board import BoardKind

Image = NDArray[np.unsignedinteger[Any]]

WINDOW_OF_PITCH = 0.3
"""Half side of the window in which a corner is refined, part of the gap between corners: the next
edge stays outside."""

SMALL_PX = 640
"""Larger side of the image in which other sizes are looked for."""

LEAST_CORNERS = 3
"""Rows and columns of a chessboard that OpenCV looks for."""

PLAIN_KINDS: tuple[BoardKind, ...] = ("chessboard", "circles", "asymmetric-circles")
"""Which carry no numbers: told by how many there are."""

LEAST_WINDOW_PX, MOST_WINDOW_PX = 2, 11
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of a board in an image: numbers (n,) and pixels (n, 2), px, (x, y).

    Of circles: the middles of their images, and their areas (n,), px^2, NaN where not known.
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]
    areas: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.ids)


NONE = Corners(np.zeros(0, np.int64), np.zeros((0, 2)))


def find_corners(image: Image, board: Board, /) -> Corners:
    """Return the corners of a board, none where it is not found.

    Parameters
    ----------
    image : (row, col) uint8 or uint16
    board : Board

    Notes
    -----
    Chessboard: OpenCV's sector-based detector, else its older one; each corner then refined on
    the grey values around it. Circles: blobs in a grid, then their centres of mass.
    """
    grey = _to_eight_bits(image)
    if board.kind == "charuco":
        return _charuco(grey, board)
    if board.kind == "chessboard":
        return _chessboard(grey, board)
    return _circles(grey, board)


def _to_eight_bits(image: Image) -> NDArray[np.uint8]:
    """Return the image as bytes, its brightest 0.1 % at the top."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, np.uint8)
    top = max(float(np.percentile(image, 99.9)), 1.0)
    return np.asarray(np.clip(image * (255 / top), 0, 255), np.uint8)


def _all_corners(found: Any, board: Board) -> Corners:
    pixels = np.asarray(found, np.float64).reshape(-1, 2)  # (n, 1, 2) before OpenCV 5
    return Corners(np.arange(board.n_points), pixels)


def _chessboard(grey: NDArray[np.uint8], board: Board) -> Corners:
    size = (board.n_cols, board.n_rows)
    # With EXHAUSTIVE it finds more, for much more time.
    for more in (0, cv2.CALIB_CB_EXHAUSTIVE):
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | more
        is_found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if is_found:
            break
    else:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        is_found, corners = cv2.findChessboardCorners(
            grey, size, flags=flags | cv2.CALIB_CB_FAST_CHECK
        )
    if not is_found:
        return NONE
    return _refined(grey, _all_corners(corners, board), board)


def _refined(grey: NDArray[np.uint8], corners: Corners, board: Board) -> Corners:
    """Refine corners where the gradients of the edges around them meet."""
    half = int(np.clip(WINDOW_OF_PITCH * _gap_px(corners, board), LEAST_WINDOW_PX, MOST_WINDOW_PX))
    begun = np.ascontiguousarray(corners.pixels.reshape(-1, 1, 2), np.float32)
    found = cv2.cornerSubPix(grey, begun, (half, half), (-1, -1), STOP)
    pixels = np.asarray(found, np.float64).reshape(-1, 2)
    is_near = np.abs(pixels - corners.pixels).max(axis=1) < half
    return Corners(corners.ids, np.where(is_near[:, None], pixels, corners.pixels))


def _gap_px(corners: Corners, board: Board) -> float:
    """Return the smallest gap between neighbours in a row or column, px."""
    by_id = np.full((board.n_points, 2), np.nan)
    by_id[corners.ids] = corners.pixels
    grid = by_id.reshape(board.n_rows, board.n_cols, 2)
    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).ravel() for axis in (0, 1)]
    known = np.concatenate(gaps)
    known = known[np.isfinite(known)]
    return float(known.min()) if len(known) else 10.0


def _charuco(grey: NDArray[np.uint8], board: Board) -> Corners:
    number = getattr(cv2.aruco, board.dictionary, None)
    if not isinstance(number, int):
        raise PlanError(
            f"--board: expected a dictionary of OpenCV, as DICT_4X4_50, found '{board.dictionary}'"
        )
    pattern = cv2.aruco.CharucoBoard(
        (board.n_cols + 1, board.n_rows + 1), board.pitch_mm, board.marker_mm,
        cv2.aruco.getPredefinedDictionary(number),
    )  # fmt: skip
    pattern.setLegacyPattern(board.is_legacy)
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    if ids is None or len(ids) == 0:
        return NONE
    found = Corners(
        np.asarray(ids, np.int64).ravel(), np.asarray(pixels, np.float64).reshape(-1, 2)
    )
    order = np.argsort(found.ids)
    return _refined(grey, Corners(found.ids[order], found.pixels[order]), board)


def _circles(grey: NDArray[np.uint8], board: Board) -> Corners:
    is_shifted = board.kind == "asymmetric-circles"
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID if is_shifted else cv2.CALIB_CB_SYMMETRIC_GRID
    size = (board.n_cols, board.n_rows)
    for image in (grey, 255 - grey):  # dark circles on light, then light ones on dark
        for more in (0, cv2.CALIB_CB_CLUSTERING):
            is_found, centers = cv2.findCirclesGrid(
                image, size, flags=flags | more, blobDetector=_blobs(grey.size)
            )
            if is_found:
                begun = _all_corners(centers, board)
                return Corners(begun.ids, *measured_circles(grey, begun.pixels))
    return NONE


def _blobs(n_pixels: int) -> Any:
    """Return a detector of circles of any size between 3 px across and a tenth of the image."""
    options = cv2.SimpleBlobDetector_Params()  # type: ignore[attr-defined]
    options.minArea, options.maxArea = 8.0, n_pixels / 100
    options.minDistBetweenBlobs = 4.0
    options.filterByCircularity, options.minCircularity = True, 0.6
    options.filterByInertia, options.minInertiaRatio = True, 0.1
    options.filterByConvexity, options.minConvexity = True, 0.9
    options.minThreshold, options.maxThreshold, options.thresholdStep = 10, 245, 10
    return cv2.SimpleBlobDetector_create(options)  # type: ignore[attr-defined]


def other_board(image: Image, board: Board, /) -> Board | None:
    """Return another board that is in the image, None where none is found.

    It looks for other kinds of the same size, then for other sizes near that of the board.
    """
    grey = _to_eight_bits(image)
    scale = min(1.0, SMALL_PX / max(grey.shape))
    grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    near = [
        (cols, rows)
        for cols in range(max(3, board.n_cols - 2), board.n_cols + 3)
        for rows in range(max(3, board.n_rows - 2), board.n_rows + 3)
    ]
    # A part of a larger board may look like a board.
    near.sort(key=lambda s: (-s[0] * s[1], abs(s[0] - board.n_cols) + abs(s[1] - board.n_rows)))
    same = [(board.n_cols, board.n_rows)]
    sizes = dict.fromkeys(PLAIN_KINDS, same) | {board.kind: near}
    for kind in sorted(PLAIN_KINDS, key=lambda kind: kind == board.kind):
        for cols, rows in sizes[kind]:
            other = Board(kind=kind, n_cols=cols, n_rows=rows)
            if other.kind == board.kind and (cols, rows) == same[0]:
                continue
            if _is_there(grey, other):
                return other
    return None


def _is_there(grey: NDArray[np.uint8], board: Board) -> bool:
    if board.kind == "chessboard":
        if min(board.n_cols, board.n_rows) < LEAST_CORNERS:
            return False
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        return bool(cv2.findChessboardCorners(grey, (board.n_cols, board.n_rows), flags=flags)[0])
    return len(_circles(grey, board)) > 0
