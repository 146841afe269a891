"""The period that fringes have beside a Gray code."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.health.sampling import LitMap
from fringe3d.model import ImageStack
from fringe3d.model.plan import FringeSet, GraySet

CHAINS_PX = {5: 12, 4: 6, 1: 3}
"""Pixels over which phases are added up, for codes of so many bits and more: the cells of a short
code come back soon."""

MAX_STEP = 0.8 * np.pi
LEAST_CHAINS, LEAST_PERIOD_PX = 500, 2.0
MOST_ROWS = 200


def measured_period(stack: ImageStack, lit: LitMap, fringe_set: FringeSet, /) -> float:
    """Return the period of fringes, projector px, from how far phase and code run together.

    NaN where there is no code of the same direction, or too little is seen.
    """
    codes = [code for code in stack.plan.gray_sets if code.angle == fringe_set.angle]
    if not codes:
        return float("nan")
    rows = slice(None, None, max(1, stack.shape[0] // MOST_ROWS))
    cols = slice(None, None, max(1, stack.shape[1] // MOST_ROWS))
    along = _courses(stack.images[:, rows], lit.lit[rows], fringe_set, codes[0])
    turned = stack.images[:, :, cols].swapaxes(1, 2)
    across = _courses(turned, lit.lit[:, cols].T, fringe_set, codes[0])
    phase, cells = max(along, across, key=lambda course: np.abs(course[0]).sum())
    if len(phase) < LEAST_CHAINS or not (total := float(np.abs(phase).sum())) > 0:
        return float("nan")
    period = abs(float((cells * np.sign(phase)).sum())) * codes[0].cell_px * 2 * np.pi / total
    return period if period > LEAST_PERIOD_PX else float("nan")


def _courses(
    images: NDArray[np.unsignedinteger[Any]],
    lit: NDArray[np.bool_],
    fringe_set: FringeSet,
    code: GraySet,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return over chains along the rows: the change of the phase, rad, and that of the cell."""
    shifts = np.asarray(fringe_set.shifts)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    solver = np.linalg.pinv(model).astype(np.float32)
    steps = images[list(fringe_set.indices)].astype(np.float32)
    offset, cosine, sine = np.tensordot(solver, steps, axes=1)
    turn = np.diff(np.arctan2(sine, cosine), axis=1)
    turn = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    turn[~(lit[:, 1:] & lit[:, :-1]) | (np.abs(turn) > MAX_STEP)] = np.nan
    chain = next(px for bits, px in CHAINS_PX.items() if code.n_bits >= bits)
    n, n_cells = turn.shape[1] // chain, 1 << code.n_bits
    chains = turn[:, : n * chain].reshape(len(turn), n, chain).sum(axis=2)
    moved = np.diff(_cells(images, offset, code)[:, : n * chain + 1 : chain], axis=1)
    moved = np.mod(moved + n_cells // 2, n_cells) - n_cells // 2
    known = np.isfinite(chains)
    return chains[known], moved[known].astype(np.float32)


def _cells(
    images: NDArray[np.unsignedinteger[Any]], mean: NDArray[np.float32], code: GraySet
) -> NDArray[np.int64]:
    """Return the numbers of the cells, with the bits that there are."""
    number = np.zeros(mean.shape, np.int64)
    bit_above = np.zeros(mean.shape, bool)
    places = dict(zip(code.bits, zip(code.indices, code.inverses, strict=True), strict=True))
    for bit in reversed(range(code.n_bits)):
        index, inverse = places.get(bit, (-1, -1))
        if index < 0 and inverse < 0:
            continue
        bright = images[index] > mean if index >= 0 else images[inverse] <= mean
        bit_above = bit_above ^ bright
        number |= bit_above.astype(np.int64) << bit
    return number
