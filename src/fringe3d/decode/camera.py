"""Everything that the images of one camera tell about the projector coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringe3d.decode.code_only import phase_from_code
from fringe3d.decode.gray import code_words
from fringe3d.decode.order import (
    OrderTable,
    order_from_code,
    order_table,
    order_unknown,
)
from fringe3d.decode.periods import order_from_coarser, order_from_periods
from fringe3d.decode.phase import wrapped_phase
from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, PhaseMap, WrappedPhaseMap
from fringe3d.model.plan import GraySet, PatternPlan
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
) -> CameraPhases:
    """Decode all fringe and Gray-code images of one camera.

    Parameters
    ----------
    stack : ImageStack
    projector_shape : (n_rows, n_cols) or None
        Overrides that of the plan. Without either, the code bounds the projector.
    min_modulation_dn : float or None, DN; see `wrapped_phase`
    whole_cells : bool; leave a Gray code without fringes unsmoothed, see `phase_from_code`

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
    # The mean of any fringes is the threshold for the code, whatever their direction.
    wrapped = [
        wrapped_phase(stack, fringe_set, min_modulation_dn=min_modulation_dn)
        for fringe_set in plan.fringe_sets
    ]
    directions = [
        _decode_direction(stack, angle, wrapped, _extent(plan, angle, shape), whole_cells)
        for angle in plan.angles
    ]
    return CameraPhases(stack.device_name, tuple(directions))


def _decode_direction(
    stack: ImageStack,
    angle: float,
    wrapped: Sequence[WrappedPhaseMap],
    extent: tuple[float, float],
    whole_cells: bool,
) -> DirectionPhases:
    maps = [m for m in wrapped if m.angle == angle]
    codes = [g for g in stack.plan.gray_sets if g.angle == angle]
    if not maps:
        coded = phase_from_code(stack, codes[0], extent, smooth=not whole_cells)
        return DirectionPhases(coded, (), ())
    if codes:
        known = _orders_by_code(stack, codes[0], maps, wrapped[0], extent)
    elif len(maps) > 1:
        known = order_from_periods(maps, extent)
    else:
        known = order_unknown(maps[0], extent)
    if known.is_absolute:
        phases = [
            known if m.period_px == known.period_px else order_from_coarser(m, known) for m in maps
        ]
    else:
        phases = [known]
    main, *others = sorted(phases, key=_position_error)
    return DirectionPhases(main, tuple(others), tuple(maps))


def _orders_by_code(
    stack: ImageStack,
    code: GraySet,
    maps: Sequence[WrappedPhaseMap],
    any_fringes: WrappedPhaseMap,
    extent: tuple[float, float],
) -> PhaseMap:
    """Find the fringe orders of the period that the code suits best."""
    mean_dn = any_fringes.offset + np.float32(stack.black_level_dn)
    words = code_words(stack, code, mean_dn=mean_dn)
    tables = [order_table(code, m.period_px, extent) for m in maps]
    best = min(
        range(len(maps)), key=lambda i: _suitability(tables[i], maps[i].period_px, code.cell_px)
    )
    if maps[best].period_px < code.cell_px * (1 - EDGE_TOLERANCE):
        raise MethodError(
            f"camera '{stack.device_name}': the cells of the code are {code.cell_px:g} px wide, "
            f"the fringes {maps[best].period_px:g} px: the code does not tell periods apart that "
            "share a cell. Keep the finer bits, or correct cell_px or period_px in the sequence"
        )
    return order_from_code(maps[best], words, tables[best])


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
