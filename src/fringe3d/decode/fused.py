"""Wrapped phase and fringe orders of one fringe set in one pass over its images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import _fused, _mend
from fringe3d.decode.fit import MAX_PHASE_STD, FringeFit, fringe_fit, wrapped_map
from fringe3d.decode.order import CLEAR_BIT, OrderClasses, OrderTable
from fringe3d.decode.ripple import correction_table
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, ImageStack, PhaseMap, Rejection, WrappedPhaseMap
from fringe3d.model.phasemap import deferred
from fringe3d.model.plan import FringeSet, GraySet

f4, i4, u2 = np.float32, np.int32, np.uint16

LINE_BYTES = 64


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """How the fringes of one set get their orders.

    Parameters
    ----------
    gray_set : GraySet or None; without one, all orders are one class
    table : OrderTable or None; belongs to `gray_set`
    classes : OrderClasses
    """

    gray_set: GraySet | None
    table: OrderTable | None
    classes: OrderClasses


@dataclass(frozen=True, slots=True, eq=False)
class DecodedSet:
    """Wrapped phase of one fringe set, and with orders where its numbering was given."""

    wrapped: WrappedPhaseMap
    known: PhaseMap | None


def decode_set(
    stack: ImageStack,
    fringe_set: FringeSet,
    min_modulation_dn: float | None = None,
    numbering: Numbering | None = None,
    any_fringes: WrappedPhaseMap | None = None,
    /,
) -> DecodedSet:
    """Decode the images of one fringe set, and of the code that numbers it.

    Parameters
    ----------
    stack : ImageStack
    fringe_set : FringeSet
    min_modulation_dn : float or None, DN; see `wrapped_phase`
    numbering : Numbering or None; without, the wrapped phase alone
    any_fringes : WrappedPhaseMap or None
        Fringes whose mean is the threshold of the code; None for this set.
    """
    fit = fringe_fit(stack, fringe_set, min_modulation_dn)
    maps = allocated(stack.shape, numbering)
    n_corrected = fill(maps, stack, fringe_set, fit, numbering, any_fringes)
    if numbering is not None and numbering.table is not None and len(maps.cells):
        n_corrected += _decide_edges(maps, numbering.table)
    phase, rejection = maps.phase, maps.rejection
    if numbering is not None:
        phase = deferred(stack.shape, partial(_signed_phase, stack, fringe_set, fit))
        rejection = deferred(stack.shape, partial(_without_code, maps.rejection))
    wrapped = wrapped_map(
        stack,
        fringe_set,
        fit,
        phase=phase,
        offset=maps.offset,
        modulation=maps.modulation,
        phase_std=_deferred_std(fit, maps),
        rejection=rejection,
        decided=maps.rejection,
    )
    if numbering is None:
        return DecodedSet(wrapped, None)
    return DecodedSet(wrapped, _phase_map(wrapped, fit, maps, numbering, n_corrected))


def _deferred_std(fit: FringeFit, maps: _fused.Maps) -> NDArray[np.float32]:
    compute = partial(fit.phase_std, maps.offset, maps.modulation, maps.phase)
    std: NDArray[np.float32] = deferred(maps.phase.shape, compute)
    return std


def _signed_phase(stack: ImageStack, fringe_set: FringeSet, fit: FringeFit) -> NDArray[np.float32]:
    """Return the phase in (-pi, pi], also where the code contradicts it."""
    maps = allocated(stack.shape, None)
    fill(maps, stack, fringe_set, fit)
    return maps.phase


def _without_code(rejection: NDArray[np.uint16]) -> NDArray[np.uint16]:
    return rejection & ~u2(Rejection.INCONSISTENT_CODE)


def fill(
    maps: _fused.Maps,
    stack: ImageStack,
    fringe_set: FringeSet,
    fit: FringeFit,
    numbering: Numbering | None = None,
    any_fringes: WrappedPhaseMap | None = None,
    /,
) -> int:
    """Read all images of one fringe set and its code once, and write all maps once.

    Parameters
    ----------
    maps : Maps; from `allocated` with the same shape and numbering, may be used again
    stack, fringe_set, numbering, any_fringes : see `decode_set`
    fit : FringeFit

    Returns
    -------
    int; pixels whose word alone would have given another order, without those of `Maps.cells`
    """
    images = np.ascontiguousarray(stack.images).reshape(len(stack.images), -1)
    images.setflags(write=False)
    n_corrected = np.zeros(-(-images.shape[1] // _fused.TILE), np.int64)
    over_rows(
        _fused.decode_pixels,
        len(n_corrected),
        images,
        _steps(fringe_set, fit),
        _numbers(stack, fit, _fused.ZERO if numbering is None else _fused.TWO_PI),
        _code(numbering, any_fringes),
        _flat(maps),
        n_corrected,
    )
    return int(n_corrected.sum())


def _flat(maps: _fused.Maps) -> _fused.Maps:
    return _fused.Maps(**{name: array.reshape(-1) for name, array in maps._asdict().items()})


def allocated(shape: tuple[int, int], numbering: Numbering | None, /) -> _fused.Maps:
    """Return maps (row, col) for `fill`, not filled; those that are not needed are (0, 0)."""
    table = numbering.table if numbering is not None else None
    unsafe = table is not None and bool(table.has_alternative.any())
    return _fused.Maps(
        offset=_aligned(shape, f4),
        modulation=_aligned(shape, f4),
        phase=_aligned(shape, f4),
        rejection=_aligned(shape, u2),
        order=_aligned(shape if table is not None else (0, 0), i4),
        cells=_aligned(shape if unsafe else (0, 0), i4),
    )


def _aligned(shape: tuple[int, int], dtype: type[Any]) -> NDArray[Any]:
    """Return an array, not filled, that starts with a line of the cache."""
    n, size = shape[0] * shape[1], np.dtype(dtype).itemsize
    memory = np.empty(n + LINE_BYTES // size, dtype)
    start = -memory.ctypes.data % LINE_BYTES // size
    return memory[start : start + n].reshape(shape)


def _steps(fringe_set: FringeSet, fit: FringeFit) -> _fused.Steps:
    """Return the steps, filled up with repetitions that weigh nothing."""
    n_steps = len(fringe_set.indices)
    n_filled = -(-n_steps // _fused.TOGETHER) * _fused.TOGETHER
    places = np.full(n_filled, fringe_set.indices[0], np.int64)
    weights = np.zeros((3, n_filled), f4)
    places[:n_steps], weights[:, :n_steps] = fringe_set.indices, fit.solver
    return _fused.Steps(places, weights, correction_table(fit.ripple))


def _numbers(stack: ImageStack, fit: FringeFit, full_turn: np.float32) -> _fused.Numbers:
    noise = (fit.phase_weight / MAX_PHASE_STD) ** 2
    return _fused.Numbers(
        black=f4(stack.black_level_dn),
        saturation=f4(np.ceil(stack.saturation_dn)),  # grey values are whole
        lowest=f4(fit.lowest_dn),
        least_power=f4(noise * fit.read_variance),
        power_gain=f4(noise * fit.gain),
        full_scale=f4(np.iinfo(stack.images.dtype).max),
        full_turn=full_turn,
    )


def _code(numbering: Numbering | None, any_fringes: WrappedPhaseMap | None) -> _fused.Code:
    gray_set = numbering.gray_set if numbering is not None else None
    table = numbering.table if numbering is not None else None
    offset = any_fringes.offset.reshape(-1) if any_fringes is not None else np.empty(0, f4)
    offset.setflags(write=False)
    packed = table.packed if table is not None else np.empty(0, i4)
    packed.setflags(write=False)
    return _fused.Code(
        bits=np.array(gray_set.indices if gray_set is not None else (), np.int64),
        inverses=np.array(gray_set.inverses if gray_set is not None else (), np.int64),
        table=packed,
        first_order=i4(numbering.classes.first_order if numbering is not None else 0),
        clear_part=f4(CLEAR_BIT),
        offset=offset,
    )


def _decide_edges(maps: _fused.Maps, table: OrderTable) -> int:
    """Decide the pixels next to edges of the code in place; return how many are corrected."""
    meaning = _mend.Meaning(
        alternatives=table.alternatives.reshape(-1, 2),
        naive=table.naive,
        following=table.following,
        preceding=table.preceding,
        first_order=i4(table.classes.first_order),
    )
    n_corrected = np.empty(len(maps.order), np.int64)
    nearest = np.empty(maps.order.shape, i4)
    n_blocks = -(-maps.order.shape[1] // _mend.COLUMNS_AT_ONCE)
    over_rows(_mend.find_nearest, n_blocks, maps, nearest, least=1)
    over_rows(_mend.mend_rows, len(maps.order), maps, meaning, nearest, n_corrected)
    return int(n_corrected.sum())


def _one_order(first_order: int, rejection: NDArray[np.uint16]) -> NDArray[np.int32]:
    return np.where(rejection == 0, i4(first_order), i4(NO_ORDER))


def _phase_map(
    wrapped: WrappedPhaseMap,
    fit: FringeFit,
    maps: _fused.Maps,
    numbering: Numbering,
    n_mended: int,
) -> PhaseMap:
    classes, order = numbering.classes, maps.order
    if not len(order):
        one_order = partial(_one_order, classes.first_order, maps.rejection)
        order = deferred(maps.rejection.shape, one_order)
    return PhaseMap(
        phase=maps.phase,
        order_class=order,
        class_of_order=classes.class_of_order,
        first_order=classes.first_order,
        phase_std=_deferred_std(fit, maps),
        offset=maps.offset,
        modulation=maps.modulation,
        rejection=maps.rejection,
        period_px=wrapped.period_px,
        angle=wrapped.angle,
        device_name=wrapped.device_name,
        n_mended=n_mended,
    )
