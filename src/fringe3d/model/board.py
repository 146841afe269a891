"""Calibration boards: plane targets with numbered corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BoardKind = Literal["chessboard", "charuco", "circles", "asymmetric-circles"]

LEAST_CORNERS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A board with corners (or circles) in a regular pattern.

    Board frame: origin at the first corner, x along the rows of corners, y along the columns, z
    away from the viewer; mm.

    Parameters
    ----------
    kind : "chessboard", "charuco", "circles" or "asymmetric-circles"
    n_cols, n_rows : int
        Corners, as OpenCV counts them: of a chessboard the inner ones. Of circles the circles in a
        row, and the rows; of an asymmetric grid every second row is shifted by half a gap.
    pitch_mm : float, mm, > 0
        Distance of neighbouring corners in a row; of an asymmetric grid that between two rows
        (half of the distance within a row).
    has_scale : bool; whether the pitch is known; without, lengths are in units of the pitch
    marker_mm : float, mm; side of a ChArUco marker, 0 for other boards
    dictionary : str; OpenCV's name, as DICT_4X4_50
    is_legacy : bool; ChArUco layout of OpenCV before 4.6 (differs where the rows are even)

    Examples
    --------
    >>> Board(kind="chessboard", n_cols=3, n_rows=2, pitch_mm=10.0).points_mm[:4].tolist()
    [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 10.0, 0.0]]
    """

    kind: BoardKind
    n_cols: int
    n_rows: int
    pitch_mm: float = 1.0
    has_scale: bool = True
    marker_mm: float = 0.0
    dictionary: str = ""
    is_legacy: bool = False

    def __post_init__(self) -> None:
        if min(self.n_cols, self.n_rows) < LEAST_CORNERS:
            raise ValueError(
                f"board: expected at least {LEAST_CORNERS} x {LEAST_CORNERS} corners, found "
                f"{self.n_cols} x {self.n_rows}"
            )
        if not 0 < self.pitch_mm < np.inf:
            raise ValueError(f"board: expected a positive pitch, found {self.pitch_mm:g} mm")
        if self.kind == "charuco" and not 0 < self.marker_mm < self.pitch_mm:
            raise ValueError(
                "board: expected markers smaller than the squares, found "
                f"{self.marker_mm:g} and {self.pitch_mm:g} mm"
            )

    @property
    def n_points(self) -> int:
        """Return the number of corners."""
        return self.n_cols * self.n_rows

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Return the corners by their number, (n, 3), mm, row by row."""
        row, col = np.divmod(np.arange(self.n_points), self.n_cols)
        x = 2 * col + row % 2 if self.kind == "asymmetric-circles" else col
        return np.stack([x, row, 0 * row], axis=1) * self.pitch_mm

    @property
    def half_turned(self) -> NDArray[np.int64] | None:
        """Return the numbers of the corners as a board that looks the same turned by half has them.

        None where the board shows which way it is turned.
        """
        if self.kind == "charuco":
            return None
        turned = self.points_mm[::-1]
        is_same = np.allclose(turned[0] - turned, self.points_mm)
        # The squares of a chessboard must come to lie on squares of the same colour.
        if self.kind == "chessboard" and (self.n_cols + self.n_rows) % 2:
            is_same = False
        return np.arange(self.n_points)[::-1] if is_same else None

    @property
    def text(self) -> str:
        """Return the board in words."""
        size = f"{self.n_cols} x {self.n_rows}"
        pitch = f"{self.pitch_mm:g} mm" if self.has_scale else "unknown pitch"
        what = "circles" if "circles" in self.kind else "inner corners"
        legacy = " (legacy layout)" if self.is_legacy else ""
        return f"{self.kind}{legacy} of {size} {what}, {pitch}"
