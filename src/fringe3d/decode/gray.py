"""Gray-code images to code words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import GrayBit, ImageStack
from fringe3d.model.plan import GraySet
from fringe3d.patterns import gray_bit


@dataclass(frozen=True, slots=True)
class CodeWords:
    """Observed bits of a Gray code.

    Parameters
    ----------
    word : (row, col) int32; the observed bits, MSB first, packed
    contrast_dn : (row, col) float32, DN; smallest distance of a bit from its threshold
    """

    word: NDArray[np.int32]
    contrast_dn: NDArray[np.float32]


def code_words(
    stack: ImageStack, gray_set: GraySet, /, *, mean_dn: NDArray[np.float32] | None
) -> CodeWords:
    """Decide every bit of a Gray code.

    A bit is compared with its inverse image where there is one, else with the mean of the
    phase steps, else with the mean of the light and the dark image.

    Parameters
    ----------
    stack : ImageStack
    gray_set : GraySet
    mean_dn : (row, col) float32, DN, or None
        Mean of the fringe images as recorded (black level included), where there are fringes.

    Raises
    ------
    MethodError
        If there is nothing to compare a bit with.
    """
    fixed = _fixed_threshold(stack, mean_dn)
    if fixed is not None:  # the mean of unequal steps may lie beyond all grey values
        fixed = np.clip(fixed, 0, np.iinfo(stack.images.dtype).max)
    word = np.zeros(stack.shape, np.int32)
    contrast = np.full(stack.shape, np.inf, np.float32)
    for bit, index, inverse in zip(gray_set.bits, gray_set.indices, gray_set.inverses, strict=True):
        if index >= 0 and inverse >= 0:
            bright = stack.images[index].astype(np.float32)
            difference = (bright - stack.images[inverse]) / 2
        elif fixed is None:
            raise MethodError(
                f"camera '{stack.device_name}': Gray-code bit {bit} has no threshold: its inverse, "
                "fringes, or both a light and a dark image are needed. Record one of them"
            )
        else:
            sign, place = (1, index) if index >= 0 else (-1, inverse)
            difference = sign * (stack.images[place] - fixed)
        word = (word << 1) | (difference > 0)
        np.minimum(contrast, np.abs(difference), out=contrast)
    return CodeWords(word, contrast)


def _fixed_threshold(
    stack: ImageStack, mean_dn: NDArray[np.float32] | None
) -> NDArray[np.float32] | None:
    if mean_dn is not None:
        return mean_dn
    light, dark = stack.plan.uniform_index(1.0), stack.plan.uniform_index(0.0)
    if light >= 0 and dark >= 0:
        return np.asarray((stack.images[light].astype(np.float32) + stack.images[dark]) / 2)
    return None


def expected_words(gray_set: GraySet, w: NDArray[np.float64], /) -> NDArray[np.int32]:
    """Return the word that a projector coordinate w (px) should show, as `CodeWords.word`."""
    word = np.zeros(np.shape(w), np.int32)
    for bit in gray_set.bits:
        pattern = GrayBit(bit=bit, n_bits=gray_set.n_bits, cell_px=gray_set.cell_px,
                          angle=gray_set.angle, first_cell=gray_set.first_cell)  # fmt: skip
        word = (word << 1) | gray_bit(pattern, w)
    return word
