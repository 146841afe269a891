"""Everything that the images of one camera tell about the projector coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringe3d.decode.code_only import phase_from_code
from fringe3d.decode.fused import DecodedSet, Numbering, decode_set
from fringe3d.decode.gray import code_words
from fringe3d.decode.order import OrderTable, one_class, order_from_code, order_table, order_unknown
from fringe3d.decode.periods import order_from_coarser, order_from_periods
from fringe3d.decode.phase import wrapped_phase
from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, PhaseMap, WrappedPhaseMap
from fringe3d.model.plan import FringeSet, PatternPlan
from fringe3d.patterns import EDGE_TOLERANCE, extent_px


@dataclass(frozen=True, slots=True)
class DirectionPhases:
    """Phases of one fringe angle.

    Parameters
    ----------
    main : PhaseMap; of the period with the smallest predicted error in projector px
    others : tuple of PhaseMap; of the other periods, on the same footing
    wrapped : tuple of WrappedPhaseMap; as decoded, in the order of the plan
    """

    main: PhaseMap
    others: tuple[PhaseMap, ...]
    wrapped: tuple[WrappedPhaseMap, ...]

    @property
    def other_periods(self) -> tuple[WrappedPhaseMap, ...]:
        """Return the wrapped phases of all periods but that of the main map."""
        return tuple(m for m in self.wrapped if m.period_px != self.main.period_px)

    def like(self, phases: PhaseMap) -> PhaseMap:
        """Return the map of the same period as that of another camera, else the main one."""
        same = (m for m in (self.main, *self.others) if m.period_px == phases.period_px)
        return next(same, self.main)


@dataclass(frozen=True, slots=True)
class CameraPhases:
    """Phases of one camera, one entry for each fringe angle, in the order of the plan."""

    device_name: str
    directions: tuple[DirectionPhases, ...]


def decode(
    stack: ImageStack,
    projector_shape: tuple[int, int] | None = None,
    /,
    *,
    min_modulation_dn: float | None = None,
    whole_cells: bool = False,
    plain: bool = False,
) -> CameraPhases:
    """Decode all fringe and Gray-code images of one camera.

    Parameters
    ----------
    stack : ImageStack
    projector_shape : (n_rows, n_cols) or None
        Overrides that of the plan. Without either, the code bounds the projector.
    min_modulation_dn : float or None, DN; see `wrapped_phase`
    whole_cells : bool; leave a Gray code without fringes unsmoothed, see `phase_from_code`
    plain : bool; with NumPy alone, see `wrapped_phase`

    Returns
    -------
    CameraPhases

    Raises
    ------
    MethodError
        If the plan holds neither fringes nor a Gray code, or not enough of them.
    """
    plan = stack.plan
    if not plan.angles:
        raise MethodError(
            f"camera '{stack.device_name}': the plan holds neither fringes nor Gray code; "
            "there is nothing to decode"
        )
    shape = projector_shape or plan.projector_shape
    extents = {angle: _extent(plan, angle, shape) for angle in plan.angles}
    numbered = dict(
        found
        for angle, extent in extents.items()
        if (found := numbering_of(stack, angle, extent)) is not None
    )
    sets: list[DecodedSet] = []
    for fringe_set in plan.fringe_sets:
        # The mean of any fringes is the threshold for the code, whatever their direction.
        first = sets[0].wrapped if sets else None
        decode_one = _plain_set if plain else decode_set
        numbering = numbered.get(fringe_set)
        sets.append(decode_one(stack, fringe_set, min_modulation_dn, numbering, first))
    directions = [
        _decode_direction(stack, angle, sets, extent, whole_cells)
        for angle, extent in extents.items()
    ]
    return CameraPhases(stack.device_name, tuple(directions))


def _plain_set(
    stack: ImageStack,
    fringe_set: FringeSet,
    min_modulation_dn: float | None,
    numbering: Numbering | None,
    any_fringes: WrappedPhaseMap | None,
) -> DecodedSet:
    """Do what `decode_set` does, step by step."""
    wrapped = wrapped_phase(stack, fringe_set, min_modulation_dn=min_modulation_dn, plain=True)
    if numbering is None:
        return DecodedSet(wrapped, None)
    if numbering.gray_set is None or numbering.table is None:
        return DecodedSet(wrapped, order_unknown(wrapped, numbering.classes))
    offset = any_fringes.offset if any_fringes is not None else wrapped.offset
    words = code_words(stack, numbering.gray_set, mean_dn=offset + np.float32(stack.black_level_dn))
    return DecodedSet(wrapped, order_from_code(wrapped, words, numbering.table))


def _decode_direction(
    stack: ImageStack,
    angle: float,
    sets: Sequence[DecodedSet],
    extent: tuple[float, float],
    whole_cells: bool,
) -> DirectionPhases:
    own = [s for s in sets if s.wrapped.angle == angle]
    maps = [s.wrapped for s in own]
    if not maps:
        codes = [g for g in stack.plan.gray_sets if g.angle == angle]
        coded = phase_from_code(stack, codes[0], extent, smooth=not whole_cells)
        return DirectionPhases(coded, (), ())
    known = next((s.known for s in own if s.known is not None), None)
    if known is None:
        known = order_from_periods(maps, extent)
    if len(maps) == 1 or not known.is_absolute:
        return DirectionPhases(known, (), tuple(maps))
    phases = [
        known if m.period_px == known.period_px else order_from_coarser(m, known) for m in maps
    ]
    main, *others = sorted(phases, key=_position_error)
    return DirectionPhases(main, tuple(others), tuple(maps))


def numbering_of(
    stack: ImageStack, angle: float, extent: tuple[float, float]
) -> tuple[FringeSet, Numbering] | None:
    """Return the fringes of this angle whose orders are found at once, and how.

    Those of the period that the code suits best, or the only ones; None for several periods
    without a code, and without fringes.
    """
    fringe_sets = [f for f in stack.plan.fringe_sets if f.angle == angle]
    codes = [g for g in stack.plan.gray_sets if g.angle == angle]
    if not fringe_sets or (len(fringe_sets) > 1 and not codes):
        return None
    if not codes:
        return fringe_sets[0], Numbering(None, None, one_class(fringe_sets[0].period_px, extent))
    code = codes[0]
    tables = [order_table(code, f.period_px, extent) for f in fringe_sets]
    periods = [f.period_px for f in fringe_sets]
    best = min(range(len(periods)), key=lambda i: _suitability(tables[i], periods[i], code.cell_px))
    if periods[best] < code.cell_px * (1 - EDGE_TOLERANCE):
        raise MethodError(
            f"camera '{stack.device_name}': the cells of the code are {code.cell_px:g} px wide, "
            f"the fringes {periods[best]:g} px: the code does not tell periods apart that "
            "share a cell. Keep the finer bits, or correct cell_px or period_px in the sequence"
        )
    return fringe_sets[best], Numbering(code, tables[best], tables[best].classes)


def _suitability(table: OrderTable, period_px: float, cell_px: float) -> tuple[bool, float, float]:
    """Rank fringes for a code: cells no wider than a period, few orders in a class, fine."""
    classes = table.classes.class_of_order
    too_fine = period_px < cell_px * (1 - EDGE_TOLERANCE)
    return too_fine, len(classes) / len(np.unique(classes)), period_px


def _position_error(phases: PhaseMap) -> float:
    """Return the typical standard deviation of w, projector px."""
    good = phases.rejection == 0
    if not good.any():
        return float("inf")
    return float(np.median(phases.phase_std[good])) * phases.period_px


def _extent(plan: PatternPlan, angle: float, shape: tuple[int, int] | None) -> tuple[float, float]:
    if shape is not None:
        return extent_px(shape, angle)
    codes = [g for g in plan.gray_sets if g.angle == angle]
    if codes:
        return 0.0, codes[0].cell_px * (1 << codes[0].n_bits)
    periods = [f.period_px for f in plan.fringe_sets if f.angle == angle]
    if len(periods) == 1:
        return 0.0, 2 * periods[0]  # at least two periods: the order is not known
    raise MethodError(
        "plan: the size of the projector image is needed to number the fringes, and neither the "
        "plan nor the rig has it. Add 'projector_size = [width, height]' to the scan file"
    )
