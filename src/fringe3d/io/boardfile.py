"""Calibration boards in words (``chessboard:9x7:20mm``) and in ``board.toml``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

import tomlkit
from pydantic import Field

from fringe3d.errors import PlanError
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import Board
from fringe3d.model.board import BoardKind

KINDS: tuple[BoardKind, ...] = ("chessboard", "charuco", "circles", "asymmetric-circles")

EXAMPLES = (
    "chessboard:9x7:20mm, charuco:11x8:15mm:11mm:DICT_4X4_50, circles:9x7:20mm or "
    "asymmetric-circles:4x11:10mm"
)
DEFAULT_DICTIONARY = "DICT_4X4_50"


class BoardTable(StrictModel):
    """``board.toml``; sizes as OpenCV counts them."""

    format: Literal["fringe3d-board/1"]
    kind: BoardKind
    size: tuple[int, int]
    pitch_mm: float | None = Field(default=None, gt=0)
    marker_mm: float | None = Field(default=None, gt=0)
    marker_part: float | None = Field(default=None, gt=0, lt=1)
    dictionary: str = DEFAULT_DICTIONARY
    layout: Literal["new", "legacy"] = "new"

    def board(self) -> Board:
        """Return the board."""
        pitch = self.pitch_mm or 1.0
        marker = self.marker_mm or (self.marker_part or 0.0) * pitch
        is_legacy, has_scale = self.layout == "legacy", self.pitch_mm is not None
        return _board(self.kind, self.size, pitch, marker, self.dictionary,
                      is_legacy=is_legacy, has_scale=has_scale)  # fmt: skip


def _board(
    kind: BoardKind,
    size: tuple[int, int],
    pitch: float,
    marker: float,
    dictionary: str,
    *,
    is_legacy: bool,
    has_scale: bool,
) -> Board:
    is_charuco = kind == "charuco"
    if is_charuco and not marker:
        raise ValueError("charuco: expected the side of the markers, found none")
    inner = 1 if is_charuco else 0  # OpenCV counts the squares of a ChArUco board
    return Board(
        kind=kind,
        n_cols=size[0] - inner,
        n_rows=size[1] - inner,
        pitch_mm=pitch,
        has_scale=has_scale,
        marker_mm=marker if is_charuco else 0.0,
        dictionary=dictionary if is_charuco else "",
        is_legacy=is_legacy,
    )


def read_board(text: str, /) -> Board:
    """Return a board from words, or from a file.

    Parameters
    ----------
    text : str
        ``KIND:COLUMNSxROWS[:PITCH[:MARKER[:DICTIONARY]]][:legacy]`` with lengths in mm; without a
        pitch lengths are in units of it, and MARKER is a part of it. Or the path of a TOML file.

    Raises
    ------
    PlanError
        If it is none of both.

    Examples
    --------
    >>> read_board("chessboard:9x7:20mm").text
    'chessboard of 9 x 7 inner corners, 20 mm'
    """
    if text.lower().endswith(".toml"):
        path = Path(text)
        table = read_toml(path, BoardTable, PlanError)
        try:
            return table.board()
        except ValueError as problem:
            raise PlanError(f"{path}: {problem}. Correct it") from None
    try:
        return _parsed(text)
    except ValueError as problem:
        raise PlanError(
            f"--board '{text}': {problem}. Expected as {EXAMPLES}, or a board.toml"
        ) from None


def board_text(board: Board, /) -> str:
    """Return the text of the ``board.toml`` that `read_board` reads back."""
    squares = 1 if board.kind == "charuco" else 0
    lines: dict[str, Any] = {
        "format": "fringe3d-board/1",
        "kind": board.kind,
        "size": [board.n_cols + squares, board.n_rows + squares],
    }
    if board.has_scale:
        lines["pitch_mm"] = board.pitch_mm
    if board.kind == "charuco":
        lines["marker_mm" if board.has_scale else "marker_part"] = board.marker_mm
        lines["dictionary"] = board.dictionary
        lines["layout"] = "legacy" if board.is_legacy else "new"
    return tomlkit.dumps(lines)


def _parsed(text: str) -> Board:
    kind_word, *words = text.strip().split(":")
    kind = next((k for k in KINDS if k == kind_word.lower()), None)
    if kind is None:
        raise ValueError(f"expected one of the kinds {', '.join(KINDS)}, found '{kind_word}'")
    size = re.fullmatch(r"(\d{1,3})x(\d{1,3})", words[0].lower()) if words else None
    if size is None:
        raise ValueError("expected COLUMNSxROWS after the kind")
    rest = words[1:]
    is_legacy = "legacy" in rest
    rest = [word for word in rest if word != "legacy"]
    dictionary = next((w.upper() for w in rest if w.upper().startswith("DICT_")), None)
    lengths = [_length(word) for word in rest if not word.upper().startswith("DICT_")]
    is_charuco = kind == "charuco"
    if len(lengths) > 1 + is_charuco or ((is_legacy or dictionary) and not is_charuco):
        raise ValueError("found more than this kind of board has")
    # A marker is never as large as its square: alone it is a part of it.
    has_scale = len(lengths) == 2 or bool(lengths and not (is_charuco and lengths[0] < 1))
    pitch = lengths[0] if has_scale else 1.0
    has_marker = is_charuco and bool(lengths) and (len(lengths) == 2 or not has_scale)
    return _board(
        kind,
        (int(size[1]), int(size[2])),
        pitch,
        lengths[-1] if has_marker else 0.0,
        dictionary or DEFAULT_DICTIONARY,
        is_legacy=is_legacy,
        has_scale=has_scale,
    )


def _length(word: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(mm)?", word.lower())
    if found is None:
        raise ValueError(f"expected a length in mm, found '{word}'")
    return float(found[1])
