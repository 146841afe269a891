"""Fringe orders by evidence: of the candidates on a segment the one that the second camera sees.

Methods M2 to M5 are this one choice: they differ in how many orders the code leaves, and in
whether a second fringe direction tells them apart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond._clear import DECIDED, NOTHING, OPEN, OUTSIDE
from fringe3d.correspond.both_ways import agrees_with_c2, asked_of_c2, swapped, swapped_bias
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.chosen import (
    LEAST_RATIO,
    SEARCH_TURNS,
    ChosenOrders,
    all_orders,
    chosen_orders,
    found_of,
    rejection_of,
    spread_to,
)
from fringe3d.correspond.clear import choose_clearly, is_regular
from fringe3d.correspond.direct import Judging
from fringe3d.correspond.smoothing import quiet
from fringe3d.correspond.solutions import rivals, rivals_around
from fringe3d.correspond.solving import (
    coarse_stride,
    learnt_from,
    nothing_known,
    refined,
    solve,
)
from fringe3d.correspond.strictness import doubtful
from fringe3d.correspond.surfaces import is_fragment, no_surer_than_most
from fringe3d.correspond.visibility import is_hidden, takes_foreign_light
from fringe3d.correspond.weighing import Task, TwoViews
from fringe3d.correspond.witnesses import Witnesses, ask
from fringe3d.model import (
    NO_ORDER,
    CalibrationBias,
    Device,
    MeasuringVolume,
    Rejection,
)
from fringe3d.model.rejection import reject

FIT_SIGMA = 6.0
"""A candidate fits if C2 sees its phase within six standard deviations, steep walls included."""

ABSOLUTE_SAMPLE, LEAST_ABSOLUTE_STEP = 6_000, 4
"""Pixels from which the bias is learnt where the code leaves nothing to choose, and the least step
between them: neighbours err alike."""


def choose_orders(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    /,
    *,
    bias: CalibrationBias | None = None,
    search: bool = False,
    witnesses: Witnesses | None = None,
    min_probability: float = 0.9,
    fit_sigma: float = FIT_SIGMA,
    together: bool = True,
    strict: bool = False,
    plain: bool = False,
) -> ChosenOrders:
    """Choose the fringe order of each pixel of C1.

    Candidates are the orders of the pixel's class on its segment, and beyond it by two fifths of
    its length on both sides: a surface outside the volume is recognised there and is not folded
    into it. Each candidate is one point; the phases that C2 (and, of a second direction, the
    projector) has there are compared with those of C1. The residuals are judged by their own
    standard deviations, after a smooth bias of the calibration that the clear decisions show.

    Parameters
    ----------
    views : TwoViews
    projector : Device
    volume : MeasuringVolume
    bias : CalibrationBias or None; of the rig; None learns it from the images
    search : bool; no code confirms the orders: where the bias is not known, look for all that go
        with the images (where they come with different orders, these are less probable), and reject
        points that the surface itself hides from C2 or the light, fragments of surfaces, and what
        `fringe3d.correspond.strictness.doubtful` tells. A known bias is refined
    witnesses : Witnesses or None; further cameras, and the frame before
    min_probability : float; less probable orders are AMBIGUOUS; 0 takes the best that fits
    fit_sigma : float; residuals beyond are no fit
    together : bool; decide with the evidence of all pixels along eight paths through each, on
        which the absolute phase is continuous; otherwise each pixel decides alone
    strict : bool; C2, asked in its turn, must be certain of the same order; and fewer doubts do
    plain : bool; weigh the candidates of all pixels, also where hardly one fits but one: slow, and
        nearly the same. For comparison

    Returns
    -------
    ChosenOrders

    Notes
    -----
    Variance of the residual, in periods: ``sigma_2**2 + (q - 1)**2 sigma_1**2 + (c |grad
    phi_2|)**2 + m**2`` with q the phase that C2 sees over that of the projector along the ray,
    c the calibration's error in C2, px, and m = 0.0015.
    """
    witnesses, is_known, found = witnesses or Witnesses(), bias is not None, None
    is_alone = (
        not witnesses.cameras
        and witnesses.previous_turns is None
        and views.second is None
        and not views.periods1
    )
    has_code = is_regular(views.phases1) and (bias is None or bias.covariance_px2 is None)
    if has_code and is_alone and together and not (search or strict or plain):
        return _clearly(views, projector, volume, bias, min_probability, fit_sigma)
    measured, views = views, quiet(views) if search else views
    keeps = plain or bool(witnesses.cameras)
    task = Task(views, projector, volume, fit_sigma**2, together, keeps=keeps)
    panel = ask(task, witnesses, projector, volume)
    if search:
        found = _searched(views, projector, volume, fit_sigma, together, witnesses, bias)
        bias = bias if found is None else found.bias
    else:
        bias = learnt_coarsely(views, projector, volume, fit_sigma, known=bias, together=together)
    chosen, bias = solve(task, bias)
    chosen, bias = panel.asked_again(chosen, bias, is_known=is_known or found is not None)
    if found is not None:
        chosen = _no_surer_than_rivals(task, chosen, found.agreement)
    elif search and not is_known:
        chosen = _unsure(task, chosen)
    if not search:  # a code leaves so few orders that what fits outside is outside
        chosen = replace(chosen, outside=np.ones(len(task.where)))
    agrees, surface = np.ones(len(task.where), bool), np.zeros(len(task.where), bool)
    if together and not views.phases1.is_absolute and len(task.where):
        back_views = swapped(views) if search else asked_of_c2(task, chosen)
        back = Task(back_views, projector, volume, task.limit, together=True, keeps=plain)
        agrees, surface = _confirmed(task, chosen, bias, back, projector, strict=strict)
    rejection = rejection_of(task, chosen, agrees, min_probability)
    if search:
        hidden = is_hidden(task, chosen, surface, projector)
        reject(rejection, spread_to(hidden, task.valid, fill=False), Rejection.HIDDEN)
        fragment = is_fragment(task, chosen, rejection) & (rejection == 0)
        reject(rejection, fragment, Rejection.AMBIGUOUS)
        for where, reason in doubtful(task, chosen, rejection, surface, projector, strict=strict):
            reject(rejection, where, reason)
    orders = chosen_orders(task, chosen, bias, measured.phases1, rejection)
    return replace(orders, rival_shift=0 if found is None else found.rival_shift)


class _Searched(NamedTuple):
    """What the search for the bias tells: the best, the weight of the solutions that share its
    order, (row, col), and see `fringe3d.matching.Matched`."""

    bias: CalibrationBias
    agreement: NDArray[np.float64]
    rival_shift: int


def _searched(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    fit_sigma: float,
    together: bool,
    witnesses: Witnesses,
    bias: CalibrationBias | None,
) -> _Searched | None:
    """Look on a part of the pixels for all biases that go with the images; None if none does.

    Its candidates, as many as the image has pixels, are not kept.
    """
    stride = coarse_stride(views.phases1.phase)
    coarse = Task(views, projector, volume, fit_sigma**2, together, stride)
    ask(coarse, witnesses, projector, volume)
    found = rivals([coarse]) if bias is None else rivals_around(coarse, bias)
    if found is None:
        return None
    return _Searched(found.best, found.agreement(views.phases1.phase.shape), found.shift())


def _no_surer_than_rivals(task: Task, chosen: Choice, agreement: NDArray[np.float64]) -> Choice:
    """Lower the probability of orders that solutions do not share."""
    agreement = no_surer_than_most(task, chosen, agreement[task.valid])
    return replace(
        chosen, probability=chosen.probability * agreement, outside=chosen.outside * agreement
    )


def _unsure(task: Task, chosen: Choice) -> Choice:
    """Leave open what has several candidates: all share the same error, and nothing tells it."""
    is_only = task.n_labels() == 1
    return replace(
        chosen, probability=chosen.probability * is_only, outside=chosen.outside * is_only
    )


def _clearly(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    bias: CalibrationBias | None,
    min_probability: float,
    fit_sigma: float,
) -> ChosenOrders:
    """Do what `choose_orders` does with a code, most pixels at once; see `clear`."""
    coarse = _coarse_task(views, projector, volume, fit_sigma, True)
    bias = bias or learnt_from(coarse, coarse.decide(nothing_known(coarse)))
    judging = Judging(bias, fit_sigma**2, SEARCH_TURNS, LEAST_RATIO)
    found, task, chosen, agrees = choose_clearly(
        views, projector, volume, bias, coarse, judging=judging
    )
    chosen = replace(chosen, outside=np.ones(len(task.where)))
    misses = ~(coarse.tables.ends[..., 0] < coarse.tables.ends[..., 1])
    is_inside = found.state == DECIDED
    rejection = np.zeros(agrees.shape, np.uint16)
    reject(rejection, (found.state == OUTSIDE) | ((found.state == NOTHING) & misses),
           Rejection.OUTSIDE_VOLUME)  # fmt: skip
    reject(rejection, ((found.state == NOTHING) & ~misses) | (is_inside & ~agrees),
           Rejection.NO_MATCH)  # fmt: skip
    order = np.where(is_inside, found.order, np.int32(NO_ORDER))
    probability = np.where(is_inside, np.float32(1), np.float32(np.nan))
    is_open = found.state.ravel()[task.where] == OPEN
    where, weighed = task.where[is_open], found_of(task, chosen, bias, task.first[1])
    own = rejection_of(task, chosen, agrees.ravel()[task.where], min_probability)
    rejection.ravel()[where] = own.ravel()[where]
    order.ravel()[where] = chosen.order[is_open]
    probability.ravel()[where] = chosen.probability[is_open]
    found.half_px.ravel()[where] = weighed.half[is_open]
    found.place_px.ravel()[where] = weighed.place[is_open]
    found.place_sigma_px.ravel()[where] = weighed.place_sigma[is_open]
    phases = replace(
        views.phases1, order_class=order, class_of_order=all_orders(views.phases1)
    ).rejecting(rejection)
    nothing = np.broadcast_to(np.float32(np.nan), order.shape)
    probability[phases.rejection != 0] = np.nan
    return ChosenOrders(
        phases=phases, probability=probability, half_px=found.half_px, place_px=found.place_px,
        place_sigma_px=found.place_sigma_px, residual=nothing, sigma=nothing, bias=bias,
    )  # fmt: skip


def _confirmed(
    task: Task,
    chosen: Choice,
    bias: CalibrationBias,
    back: Task,
    projector: Device,
    *,
    strict: bool,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which orders C2, asked in its turn, and the light confirm, and which of them are well
    founded, (n,) each: to hide other points they need not be as certain as a point must, if strict.
    """
    bias_back = swapped_bias(bias, task, chosen, projector, back.frame)
    seen_back, _ = solve(back, bias_back, doubts=False)
    agrees = agrees_with_c2(task, chosen, back, seen_back, strict=False)
    fits = chosen.cost <= task.limit
    agrees &= ~takes_foreign_light(task, chosen, agrees & fits, projector)
    surface = agrees & fits
    if strict:
        agrees &= agrees_with_c2(task, chosen, back, seen_back, strict=True)
    return agrees, surface


def learnt_coarsely(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    fit_sigma: float,
    *,
    known: CalibrationBias | None,
    together: bool = True,
) -> CalibrationBias:
    """Learn the bias from the clear decisions on a part of the pixels, which tells as much; or
    refine a known one."""
    if known is not None and known.covariance_px2 is None:
        return known
    coarse = _coarse_task(views, projector, volume, fit_sigma, together)
    if known is not None:
        return refined(coarse, known)
    return learnt_from(coarse, coarse.decide(nothing_known(coarse)))


def _coarse_task(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    fit_sigma: float,
    together: bool,
) -> Task:
    """Return the task of a part of the pixels, along which the phase can be continued."""
    phases1 = views.phases1
    if phases1.is_absolute:
        step = max(LEAST_ABSOLUTE_STEP, round((phases1.phase.size / ABSOLUTE_SAMPLE) ** 0.5))
        stride = step, step
    else:
        stride = coarse_stride(phases1.phase)
    return Task(views, projector, volume, fit_sigma**2, together, stride)
