"""Wrapped phase and fringe orders of one fringe set in one pass over its images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringe3d.decode import _fused, _mend
from fringe3d.decode.fit import MAX_PHASE_STD, FringeFit, fringe_fit, wrapped_map
from fringe3d.decode.order import CLEAR_BIT, OrderClasses, OrderTable
from fringe3d.model import ImageStack, PhaseMap, WrappedPhaseMap
from fringe3d.model.plan import FringeSet, GraySet

f4, i4, u2 = np.float32, np.int32, np.uint16


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
    fill(maps, stack, fringe_set, fit, numbering, any_fringes)
    if numbering is not None and numbering.table is not None and len(maps.cells):
        _decide_edges(maps, numbering.table)
    n_valid, n_mended = (int(n) for n in maps.counts.sum(axis=0))
    wrapped = wrapped_map(
        stack,
        fringe_set,
        fit,
        phase=maps.wrapped,
        offset=maps.offset,
        modulation=maps.modulation,
        phase_std=maps.sigma,
        rejection=maps.reason,
        n_valid=n_valid,
    )
    if numbering is None:
        return DecodedSet(wrapped, None)
    return DecodedSet(wrapped, _phase_map(wrapped, maps, numbering, n_mended))


def fill(
    maps: _fused.Maps,
    stack: ImageStack,
    fringe_set: FringeSet,
    fit: FringeFit,
    numbering: Numbering | None = None,
    any_fringes: WrappedPhaseMap | None = None,
    /,
) -> None:
    """Read all images of one fringe set and its code once, and write all maps once.

    Parameters
    ----------
    maps : Maps; from `allocated` with the same shape and numbering, may be used again
    stack, fringe_set, numbering, any_fringes : see `decode_set`
    fit : FringeFit
    """
    images = np.ascontiguousarray(stack.images)
    images.setflags(write=False)
    code = _code(numbering, any_fringes)
    _fused.decode_rows(images, _steps(fringe_set, fit), _numbers(stack, fit), code, maps)


def allocated(shape: tuple[int, int], numbering: Numbering | None, /) -> _fused.Maps:
    """Return maps for `fill`, not filled."""
    ordered = shape if numbering is not None else (0, 0)
    table = numbering.table if numbering is not None else None
    unsafe = table is not None and bool(table.has_alternative.any())
    return _fused.Maps(
        offset=np.empty(shape, f4),
        modulation=np.empty(shape, f4),
        sigma=np.empty(shape, f4),
        wrapped=np.empty(shape, f4),
        reason=np.empty(shape, u2),
        phase=np.empty(ordered, f4),
        order=np.empty(ordered, i4),
        rejection=np.empty(ordered, u2),
        cells=np.empty(shape if unsafe else (0, 0), i4),
        counts=np.empty((shape[0], 2), np.int64),
    )


def _steps(fringe_set: FringeSet, fit: FringeFit) -> _fused.Steps:
    """Return the steps, filled up with repetitions that weigh nothing."""
    n_steps = len(fringe_set.indices)
    n_filled = -(-n_steps // _fused.TOGETHER) * _fused.TOGETHER
    places = np.full(n_filled, fringe_set.indices[0], np.int64)
    weights = np.zeros((3, n_filled), f4)
    places[:n_steps], weights[:, :n_steps] = fringe_set.indices, fit.solver
    return _fused.Steps(places, weights)


def _numbers(stack: ImageStack, fit: FringeFit) -> _fused.Numbers:
    return _fused.Numbers(
        black=f4(stack.black_level_dn),
        saturation=f4(np.ceil(stack.saturation_dn)),  # grey values are whole
        lowest=f4(fit.lowest_dn),
        max_std=f4(MAX_PHASE_STD),
        weight=f4(fit.phase_weight),
        read_variance=f4(fit.read_variance),
        gain=f4(fit.gain),
        full_scale=f4(np.iinfo(stack.images.dtype).max),
    )


def _code(numbering: Numbering | None, any_fringes: WrappedPhaseMap | None) -> _fused.Code:
    gray_set = numbering.gray_set if numbering is not None else None
    table = numbering.table if numbering is not None else None
    offset = any_fringes.offset if any_fringes is not None else np.empty((0, 0), f4)
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


def _decide_edges(maps: _fused.Maps, table: OrderTable) -> None:
    """Decide the pixels next to edges of the code in place."""
    meaning = _mend.Meaning(
        alternatives=table.alternatives.reshape(-1, 2),
        naive=table.naive,
        following=table.following,
        preceding=table.preceding,
        first_order=i4(table.classes.first_order),
    )
    _mend.mend_rows(maps, meaning, np.empty(maps.order.shape, i4))


def _phase_map(
    wrapped: WrappedPhaseMap, maps: _fused.Maps, numbering: Numbering, n_mended: int
) -> PhaseMap:
    classes = numbering.classes
    return PhaseMap(
        phase=maps.phase,
        order_class=maps.order,
        class_of_order=classes.class_of_order,
        first_order=classes.first_order,
        phase_std=wrapped.phase_std,
        offset=wrapped.offset,
        modulation=wrapped.modulation,
        rejection=maps.rejection,
        period_px=wrapped.period_px,
        angle=wrapped.angle,
        device_name=wrapped.device_name,
        n_mended=n_mended,
    )
