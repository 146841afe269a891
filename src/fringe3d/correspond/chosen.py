"""What is said of the orders that were chosen: reasons, windows, places and residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond._clear import LEAST_PLACING_RATIO
from fringe3d.correspond._orders import DIFFERENCE, RATIO
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.limits import TWO_PI
from fringe3d.correspond.weighing import Task
from fringe3d.model import NO_ORDER, CalibrationBias, PhaseMap, Rejection
from fringe3d.model.rejection import reject

SEARCH_TURNS = (0.2, 0.45)
"""Periods of C2 around a decided order in which its point is searched, least and most."""

LEAST_RATIO = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChosenOrders:
    """Fringe orders that geometry and the second camera chose.

    Parameters
    ----------
    phases : PhaseMap of C1, absolute; what has no order is rejected with its reason
    probability : (row, col) float32; of the order among all candidates; NaN where rejected
    half_px : (row, col) float32, projector px; how far around its phase C2 sees the point
    place_px, place_sigma_px : (row, col) float32, projector px; where across the fringes C1's phase
        and the bias expect the point, less its phase, and the standard deviation
    residual : (row, col) float32, periods; phase that C2 sees at the point minus that of C1, the
        calibration's bias included; NaN where a code decides most pixels at once (`clear`)
    sigma : (row, col) float32, periods; predicted standard deviation of `residual` less the bias
    bias : CalibrationBias; as stored, or as the clear decisions show it
    rival_shift : int; see `fringe3d.matching.Matched`
    """

    phases: PhaseMap
    probability: NDArray[np.float32]
    half_px: NDArray[np.float32]
    place_px: NDArray[np.float32]
    place_sigma_px: NDArray[np.float32]
    residual: NDArray[np.float32]
    sigma: NDArray[np.float32]
    bias: CalibrationBias
    rival_shift: int = 0


def rejection_of(
    task: Task,
    chosen: Choice,
    agrees: NDArray[np.bool_],
    min_probability: float,
) -> NDArray[np.uint16]:
    """Return why pixels have no point, (row, col); 0 where they have one, or no phase."""
    fits = chosen.is_seen & ~(chosen.cost > task.limit)
    certain = np.where(chosen.is_inside, chosen.probability, chosen.outside) >= min_probability
    rejection = np.zeros(task.valid.shape, np.uint16)
    for where, reason in (
        (task.misses | (fits & ~chosen.is_inside & certain), Rejection.OUTSIDE_VOLUME),
        (~task.misses & ~(fits & agrees), Rejection.NO_MATCH),
        (fits & ~task.misses & ~certain, Rejection.AMBIGUOUS),
    ):
        reject(rejection, spread_to(where, task.valid, fill=False), reason)
    return rejection


class Found(NamedTuple):
    """What is known of chosen candidates, (n,): as in `ChosenOrders`."""

    half: NDArray[np.float32]
    place: NDArray[np.float64]
    place_sigma: NDArray[np.float64]
    sigma: NDArray[np.float64]


def found_of(
    task: Task, chosen: Choice, bias: CalibrationBias, phase_std: NDArray[np.float32]
) -> Found:
    """Return what is known for phases with the noise, (n,) rad, with which they were measured."""
    period_px = task.views.phases1.period_px
    difference, ratio = chosen.shown[:, DIFFERENCE], chosen.shown[:, RATIO]
    # C2 may see the phase change many times as fast as the projector: a period there must do.
    expected, spread, sigma = task.expected(chosen, bias)
    noise = phase_std / TWO_PI
    averaged = np.sqrt(np.maximum(noise**2 - (task.first[1] / TWO_PI) ** 2, 0))
    averaged *= np.hypot(1, ratio - 1)  # what averaging has taken away from both phases
    seen = np.clip(np.abs(difference) + 4 * np.hypot(sigma, averaged), *SEARCH_TURNS)
    window = np.minimum(seen / np.maximum(np.abs(ratio), LEAST_RATIO), 0.5)
    rate = np.where(np.abs(ratio) > LEAST_PLACING_RATIO, ratio, np.nan)
    return Found(
        half=(window * period_px).astype(np.float32),
        place=-expected / rate * period_px,
        place_sigma=np.hypot(noise, spread / rate) * period_px,
        sigma=sigma,
    )


def all_orders(phases: PhaseMap) -> NDArray[np.int32]:
    """Return the classes of a full code: each order is its own."""
    return np.arange(len(phases.class_of_order), dtype=np.int32) + np.int32(phases.first_order)


def chosen_orders(
    task: Task,
    chosen: Choice,
    bias: CalibrationBias,
    phases1: PhaseMap,
    rejection: NDArray[np.uint16],
) -> ChosenOrders:
    """Return the result for the phases of C1 as they were measured."""
    valid = task.valid
    phases = replace(
        phases1,
        order_class=spread_to(chosen.order, valid, fill=NO_ORDER),
        class_of_order=all_orders(phases1),
    ).rejecting(rejection)
    found = found_of(task, chosen, bias, phases1.phase_std[valid])
    probability, residual, sigma, place, place_sigma = (
        np.where(phases.rejection == 0, spread_to(values, valid, fill=np.nan), np.nan)
        for values in (chosen.probability, chosen.shown[:, DIFFERENCE], found.sigma, found.place,
                       found.place_sigma)
    )  # fmt: skip
    return ChosenOrders(
        phases=phases,
        probability=probability.astype(np.float32),
        half_px=spread_to(found.half, valid, fill=np.nan),
        place_px=place.astype(np.float32),
        place_sigma_px=place_sigma.astype(np.float32),
        residual=residual.astype(np.float32),
        sigma=sigma.astype(np.float32),
        bias=bias,
    )


def spread_to(values: NDArray[Any], valid: NDArray[np.bool_], *, fill: float) -> NDArray[Any]:
    """Return (row, col) values of those that are valid, (n,), `fill` elsewhere."""
    full = np.full(valid.shape, fill, values.dtype)
    full[valid] = values
    return full
