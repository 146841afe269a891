"""Projector coordinates from Gray code alone, without fringes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode._smooth import local_planes
from fringe3d.decode.gray import code_words, expected_words
from fringe3d.decode.order import all_orders
from fringe3d.errors import MethodError
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, ImageStack, PhaseMap, Rejection
from fringe3d.model.plan import GraySet
from fringe3d.model.rejection import reject

TWO_PI = 2 * np.pi

MIN_CONTRAST_OF_RANGE = 0.02
"""Part of the grey-value range (5 DN of 255) that light and dark must differ by."""

WINDOW_RADIUS_PX = 3
"""7 x 7 camera pixels hold several cells; their steps average out."""

MAX_SLOPE = 3.0
"""Projector cells per camera pixel that still count as one surface."""


def phase_from_code(
    stack: ImageStack, gray_set: GraySet, extent_px: tuple[float, float], /, *, smooth: bool
) -> PhaseMap:
    """Decode a full Gray code to a phase.

    Parameters
    ----------
    stack : ImageStack
    gray_set : GraySet
    extent_px : smallest and largest w of the projector, px
    smooth : bool
        Put a plane through each pixel's neighbourhood (7 x 7): coordinates a few times finer than
        the cells, as a phase of half a turn over the projector. Without, each pixel gets the
        middle of its cell, one turn per cell (`PhaseMap.is_quantised`).

    Raises
    ------
    MethodError
        If the code does not number all cells, or has no threshold.
    """
    words = code_words(stack, gray_set, mean_dn=None)
    orders = all_orders(gray_set.cell_px, extent_px)
    expected = expected_words(
        gray_set, (orders.class_of_order.astype(np.float64) + 0.5) * gray_set.cell_px
    )
    if len(np.unique(expected)) < len(expected):
        raise MethodError(
            f"camera '{stack.device_name}': {len(gray_set.bits)} Gray-code bits do not tell "
            f"{len(expected)} cells of {gray_set.cell_px:g} px apart, and there are no fringes. "
            "Keep more bits"
        )
    cell_of_word = np.full(1 << len(gray_set.bits), NO_ORDER, np.int32)
    cell_of_word[expected] = orders.class_of_order
    cell = cell_of_word[words.word]

    offset, modulation = _brightness(stack, gray_set)
    # Whole cells count only where every bit is clear; a plane evens out unclear ones.
    contrast = modulation if smooth else np.minimum(modulation, words.contrast_dn)
    rejection = _rejection(stack, gray_set, contrast)
    reject(rejection, (rejection == 0) & (cell == NO_ORDER), Rejection.INCONSISTENT_CODE)
    if smooth:
        w, sigma = _smooth_cells(cell, rejection == 0, gray_set.cell_px)
    else:
        w = np.where(rejection == 0, (cell + 0.5) * gray_set.cell_px, np.nan)
        sigma = np.full(w.shape, gray_set.cell_px / np.sqrt(12), np.float32)
    reject(rejection, (rejection == 0) & np.isnan(w), Rejection.ISOLATED)
    period = gray_set.cell_px
    if smooth:
        orders = all_orders(_one_turn_px(extent_px), extent_px)
        period = _one_turn_px(extent_px)
    turns = np.where(rejection == 0, w / period, 0.0)
    order = np.clip(np.floor(turns), orders.class_of_order[0], orders.class_of_order[-1])
    phase = np.clip(TWO_PI * (turns - order), 0, np.nextafter(TWO_PI, 0))
    return PhaseMap(
        phase=np.where(rejection == 0, phase, np.nan),
        order_class=np.where(rejection == 0, order, NO_ORDER),
        class_of_order=orders.class_of_order,
        first_order=orders.first_order,
        phase_std=TWO_PI * sigma / period,
        offset=offset,
        modulation=modulation,
        rejection=rejection,
        period_px=period,
        angle=gray_set.angle,
        device_name=stack.device_name,
        is_quantised=not smooth,
    )


def _one_turn_px(extent_px: tuple[float, float]) -> float:
    """Return a period that holds the projector with room to spare: a phase without wraps."""
    return 2 * (extent_px[1] - extent_px[0])


def _brightness(
    stack: ImageStack, gray_set: GraySet
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return half the sum (above black) and half the difference of light and dark."""
    light, dark = stack.plan.uniform_index(1.0), stack.plan.uniform_index(0.0)
    if light >= 0 and dark >= 0:
        high, low = stack.images[light].astype(np.float32), stack.images[dark].astype(np.float32)
    else:
        places = [i for i in (*gray_set.indices, *gray_set.inverses) if i >= 0]
        images = stack.images[places]
        high, low = images.max(axis=0).astype(np.float32), images.min(axis=0).astype(np.float32)
    return (high + low) / 2 - np.float32(stack.black_level_dn), (high - low) / 2


def _rejection(
    stack: ImageStack, gray_set: GraySet, contrast: NDArray[np.float32]
) -> NDArray[np.uint16]:
    rejection = np.zeros(stack.shape, np.uint16)
    lowest = MIN_CONTRAST_OF_RANGE * stack.range_dn
    reject(rejection, 2 * contrast < lowest, Rejection.LOW_MODULATION)
    # Saturated light does not harm a bit; saturated dark does.
    places = [i for i in (*gray_set.indices, *gray_set.inverses) if i >= 0]
    always = np.ones(stack.shape, bool)
    for place in places:
        always &= stack.images[place] >= stack.saturation_dn
    reject(rejection, always, Rejection.SATURATED)
    return rejection


def _smooth_cells(
    cell: NDArray[np.int32], valid: NDArray[np.bool_], cell_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    values = np.where(valid, cell, np.nan).astype(np.float32)
    smooth, sigma = np.empty_like(values), np.empty_like(values)
    gate = np.float32(1 + MAX_SLOPE * WINDOW_RADIUS_PX)
    over_rows(local_planes, len(values), values, WINDOW_RADIUS_PX, gate, np.float32(1), smooth,
              sigma)  # fmt: skip
    return (smooth.astype(np.float64) + 0.5) * cell_px, sigma * np.float32(cell_px)
