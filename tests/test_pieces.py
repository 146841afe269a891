"""A part that contradicts itself along a smooth line is cut where it is thin."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.correspond.pieces import CORE_PX, _core, cut_apart

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SHAPE = (40, 60)
ROWS, COLS = np.mgrid[: SHAPE[0], : SHAPE[1]]


def halves(*, gap: int, bridge: int, jump: int = 2) -> tuple[Ints, Ints, Bools]:
    """Return one part of two halves: a seam of `gap` rows between columns 29 and 30, `bridge` rows
    in which they hang together, and an edge along the rest."""
    parts = np.zeros(SHAPE, np.int64)
    higher, smooth = np.zeros((2, *SHAPE), np.int64), np.ones((2, *SHAPE), bool)
    higher[1, :gap, 29] = jump
    smooth[1, gap + bridge :, 29] = False
    return parts, higher, smooth


def n_pieces(cut: Ints) -> int:
    return len(np.unique(cut[cut >= 0]))


@pytest.mark.parametrize("jump", [-3, 1, 2])
@pytest.mark.parametrize("bridge", [1, 4])
def test_a_thin_bridge_is_cut(bridge: int, jump: int) -> None:
    cut = cut_apart(*halves(gap=20, bridge=bridge, jump=jump))
    left, right = np.unique(cut[:, :26]), np.unique(cut[:, 34:])  # the bridge may be either's
    assert len(left) == len(right) == 1
    assert left != right


def test_a_core_is_what_all_neighbours_within_two_pixels_are_bonded_to() -> None:
    n_rows, n_cols = 25, 31
    bonds = np.random.default_rng(3).random((2, n_rows, n_cols)) > 0.02
    bonds[0, -1], bonds[1, :, -1] = False, False  # there is no next one
    wanted = np.zeros((n_rows, n_cols), bool)
    for row in range(CORE_PX, n_rows - CORE_PX):
        for col in range(CORE_PX, n_cols - CORE_PX):
            top, left = row - CORE_PX, col - CORE_PX
            bottom, right = row + CORE_PX, col + CORE_PX
            down = bonds[0, top:bottom, left : right + 1]
            wanted[row, col] = down.all() and bonds[1, top : bottom + 1, left:right].all()
    assert 10 < wanted.sum() < 0.9 * wanted.size
    np.testing.assert_array_equal(_core(bonds), wanted)


@pytest.mark.parametrize("shape", [(1, 30), (4, 30), (30, 3)])
def test_what_is_thin_everywhere_has_no_core(shape: tuple[int, int]) -> None:
    higher, smooth = np.zeros((2, *shape), np.int64), np.ones((2, *shape), bool)
    higher[:, : shape[0] // 2 + 1, : shape[1] // 2] = 1
    cut = cut_apart(np.zeros(shape, np.int64), higher, smooth)
    assert (cut >= 0).all()


def test_rows_and_columns_are_alike() -> None:
    parts, higher, smooth = halves(gap=20, bridge=2)
    plain = cut_apart(parts, higher, smooth)
    turned = cut_apart(parts.T, higher.transpose(0, 2, 1)[::-1], smooth.transpose(0, 2, 1)[::-1])
    np.testing.assert_array_equal(plain != plain[0, 0], turned[0, 0] != turned.T)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param({"gap": 20, "bridge": 12}, id="wide bridge"),
        pytest.param({"gap": 20, "bridge": 5}, id="bridge as wide as a core"),
        pytest.param({"gap": 7, "bridge": 2}, id="short seam"),
        pytest.param({"gap": 20, "bridge": 2, "jump": 0}, id="no seam"),
    ],
)
def test_what_does_not_contradict_itself_or_is_not_thin_stays_whole(case: dict[str, int]) -> None:
    assert n_pieces(cut_apart(*halves(**case))) == 1


def test_eight_pixels_are_a_seam_if_the_phase_is_smooth_there() -> None:
    parts, higher, smooth = halves(gap=8, bridge=2)
    assert n_pieces(cut_apart(parts, higher, smooth)) == 2
    smooth[1, 0, 29] = False
    assert n_pieces(cut_apart(parts, higher, smooth)) == 1


def test_only_what_contradicts_itself_is_cut() -> None:
    """Two parts, each of two halves that hang together by a bridge; one has no seam."""
    parts, higher, smooth = halves(gap=20, bridge=2)
    higher, smooth = np.tile(higher, (1, 1, 2)), np.tile(smooth, (1, 1, 2))
    higher[1, :, 60:], smooth[1, :20, 89] = 0, False
    cut = cut_apart(np.concatenate([parts, parts + 1], axis=1), higher, smooth)
    assert n_pieces(cut[:, :60]) == 2
    assert n_pieces(cut[:, 60:]) == 1


def test_other_parts_and_gaps_stay_what_they_are() -> None:
    parts, higher, smooth = halves(gap=20, bridge=2)
    other = (ROWS > 30) & (COLS < 20)
    parts[other], parts[35:, 40:] = 1, -1
    cut = cut_apart(parts, higher, smooth)
    assert (cut[35:, 40:] == -1).all()
    assert n_pieces(cut) == 3
    assert len(np.unique(cut[other])) == 1
    assert not np.isin(cut[other][0], cut[~other])


def test_no_pixels() -> None:
    parts, higher, smooth = halves(gap=20, bridge=2)
    assert (cut_apart(np.full_like(parts, -1), higher, smooth) == -1).all()
