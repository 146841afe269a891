"""How grey values follow the patterns: found from the images, and taken out of the phase.

A memoryless response turns the fringe ``1/2 + 1/2 cos(Phi - shift)`` into ``sum c_h cos h(Phi -
shift)``. N equal steps keep out of the phase all harmonics but kN - 1 and kN + 1, which ripple it N
times per period. The ripple is known from the response in closed form, and from the phases
themselves: a surface under many fringes shows every phase equally often, so that the true phase is
the cumulative histogram of the measured one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fringe3d.decode.fused import decode_set
from fringe3d.decode.noise import usable_sample
from fringe3d.decode.ripple import MOST_WAVES, gamma_curve, ripple_of_curve
from fringe3d.errors import MethodError
from fringe3d.model import GrayBit, ImageStack, Response, Ripple, WrappedPhaseMap
from fringe3d.model.plan import FringeSet, PatternPlan
from fringe3d.model.response import equal_steps

LEAST_PIXELS = 10_000
TILES = 6
CERTAIN = 3.0
"""A wave of the ripple counts from three standard errors on."""

MOST_SMOOTHED = 0.5
"""Noise smooths the histogram; waves of which it leaves less than half are not told."""

FALLING = 0.003
"""Part of full brightness by which noise may let a grey ramp fall."""

GAMMA_RANGE = 0.2, 6.0
BRIGHT_OF_MODULATION, FEW_PIXELS = 1.2, 200
"""Light less dark over the modulation, from which on a code has shown both."""


def response_from_fringes(stack: ImageStack, /) -> Response:
    """Find the response of one camera's images from their fringes alone.

    The ripples follow from the phases. The gamma follows from where the mean of the fringes lies
    between dark and light; where the plan has neither these nor a code, from the second harmonic
    (four and more steps) or the ripple. Blur weakens these two, so that they show too little of it.

    Parameters
    ----------
    stack : ImageStack

    Returns
    -------
    Response; its curve is missing where the steps do not tell it

    Raises
    ------
    MethodError
        If there are no fringes with equal steps, or too few pixels.
    """
    plain = stack.with_response(None)
    sets = [f for f in stack.plan.fringe_sets if equal_steps(f.shifts)]
    if not sets:
        raise MethodError(
            f"camera '{stack.device_name}': the response shows in fringes with equal steps, or in "
            "a grey ramp (fringe3d patterns --ramp 17); the plan holds neither"
        )
    ripples, maps = [], []
    for fringe_set in sets:
        wrapped = decode_set(plain, fringe_set).wrapped
        maps.append(wrapped)
        ripples.append(ripple_from_phases(wrapped, fringe_set))
    most = max(range(len(sets)), key=lambda i: len(sets[i].indices))
    gamma, how = _gamma_of(plain, sets[most], maps[most], ripples[most])
    levels, values = gamma_curve(gamma) if math.isfinite(gamma) else ((), ())
    return Response(device_name=stack.device_name, levels=levels, values=values, gamma=gamma,
                    ripples=tuple(ripples), source=how)  # fmt: skip


def _gamma_of(
    stack: ImageStack, fringe_set: FringeSet, wrapped: WrappedPhaseMap, ripple: Ripple
) -> tuple[float, str]:
    """Return the gamma, and what it was found from; NaN where it is out of range."""
    n_steps = len(fringe_set.shifts)
    middle = _middle_of(stack, wrapped)
    if math.isfinite(middle):
        return gamma_of_middle(middle), f"light, dark and the mean of {n_steps} steps"
    if n_steps >= 4:
        ratio = second_harmonic(stack, fringe_set, wrapped)
        return gamma_of_harmonic(ratio), f"the second harmonic of {n_steps} steps"
    gamma = _gamma_of_ripple(ripple, fringe_set) if ripple.sines else 1.0
    return gamma, f"the phases of {n_steps} steps"


def ripple_from_phases(wrapped: WrappedPhaseMap, fringe_set: FringeSet, /) -> Ripple:
    """Find the ripple of a phase map from how often each phase occurs.

    ``d true / d measured`` is the density of the measured phase times 2 pi, whose Fourier
    coefficients are means over the pixels; their standard errors come from tiles of the image.

    Parameters
    ----------
    wrapped : WrappedPhaseMap; not corrected
    fringe_set : FringeSet with equal steps

    Raises
    ------
    MethodError
        If there are too few pixels.
    """
    phase = wrapped.phase
    known = np.isfinite(phase)
    if known.sum() < LEAST_PIXELS:
        raise MethodError(
            f"camera '{wrapped.device_name}': the response shows in the phases of at least "
            f"{LEAST_PIXELS:,} pixels, found {int(known.sum()):,}. Use a larger surface"
        )
    n_steps, origin = len(fringe_set.shifts), fringe_set.shifts[0]
    tile = _tile_numbers(phase.shape)[known]
    waves = n_steps * (phase[known].astype(np.float64) - origin)
    count = np.bincount(tile, minlength=TILES * TILES).astype(np.float64)
    sigma = float(np.median(wrapped.phase_std[known]))
    sines: list[float] = []
    for k in range(1, MOST_WAVES + 1):
        kept = math.exp(-((k * n_steps * sigma) ** 2) / 2)
        sums = np.bincount(tile, np.cos(k * waves), minlength=TILES * TILES)
        mean = sums.sum() / count.sum()
        n_tiles = max(2, int((count > 0).sum()))
        spread = np.sqrt(((sums - mean * count) ** 2).sum() * n_tiles / (n_tiles - 1)) / count.sum()
        if kept < MOST_SMOOTHED or abs(mean) < CERTAIN * spread:
            break
        sines.append(2 * mean / kept / (k * n_steps))
    return Ripple(period_px=fringe_set.period_px, angle=fringe_set.angle, n_shifts=n_steps,
                  origin=origin, sines=tuple(sines))  # fmt: skip


def _tile_numbers(shape: tuple[int, int]) -> NDArray[np.intp]:
    rows, cols = (np.arange(n) * TILES // n for n in shape)
    return np.asarray(rows[:, None] * TILES + cols)


def second_harmonic(stack: ImageStack, fringe_set: FringeSet, wrapped: WrappedPhaseMap, /) -> float:
    """Return the second harmonic over the first, with sign, as four and more equal steps show it.

    From five steps on each pixel shows it; with four it goes with cos 2 phi over the pixels.
    """
    rows, cols = usable_sample(wrapped.rejection)
    grey = np.stack([stack.images[i][rows, cols] for i in fringe_set.indices]).astype(np.float64)
    phase, light = wrapped.phase[rows, cols].astype(np.float64), wrapped.modulation[rows, cols]
    shifts, n_steps = np.asarray(fringe_set.shifts), len(fringe_set.shifts)
    if n_steps == 4:
        seen = np.cos(2 * (shifts - shifts[0])) @ grey / 4 / light
        wave = np.cos(2 * (phase - shifts[0]))
        kept = np.abs(seen) <= 2 * np.percentile(np.abs(seen), 95)  # edges
        return float((seen * wave)[kept].sum() / (wave**2)[kept].sum())
    phasor = np.exp(2j * shifts) @ grey * (2 / n_steps)
    return float(np.median((phasor * np.exp(-2j * phase)).real / light))


def gamma_of_harmonic(ratio: float, /) -> float:
    """Return the gamma whose second harmonic has this part of the first: (g - 1) / (g + 2).

    Examples
    --------
    >>> round(gamma_of_harmonic(1.2 / 4.2), 6)
    2.2
    """
    return (1 + 2 * ratio) / (1 - ratio) if -0.5 < ratio < 1 else float("nan")


def _gamma_of_ripple(ripple: Ripple, fringe_set: FringeSet) -> float:
    """Return the gamma that leaves such a ripple with three steps, by bisection."""

    def excess(gamma: float) -> float:
        levels, values = gamma_curve(gamma)
        trial = Response(device_name="", levels=levels, values=values)
        return ripple_of_curve(trial, fringe_set).sines[0] - ripple.sines[0]

    return _root(excess)


def gamma_of_middle(middle: float, /) -> float:
    """Return the gamma with which the mean of fringes lies there, from dark (0) to light (1).

    The mean of ``((1 + cos)/2)**g`` is ``Gamma(g + 1/2) / (sqrt(pi) Gamma(g + 1))``; no blur
    changes it.

    Examples
    --------
    >>> round(gamma_of_middle(0.5), 6), round(gamma_of_middle(0.375), 6)
    (1.0, 2.0)
    """
    return _root(lambda g: middle - math.exp(math.lgamma(g + 0.5) - math.lgamma(g + 1))
                 / math.sqrt(math.pi))  # fmt: skip


def _root(rising: Callable[[float], float]) -> float:
    """Return where a rising function of gamma is zero; NaN where it is not."""
    low, high = GAMMA_RANGE
    if not rising(low) <= 0 <= rising(high):
        return float("nan")
    return float(optimize.brentq(rising, low, high))


def _middle_of(stack: ImageStack, wrapped: WrappedPhaseMap) -> float:
    """Return where the mean of the fringes lies between dark and light, median of the pixels.

    Dark and light as uniform images show them, or the code; NaN where neither is there.
    """
    rows, cols = usable_sample(wrapped.rejection)
    plan, black = stack.plan, stack.black_level_dn
    places = [plan.uniform_index(0.0), plan.uniform_index(1.0)]
    if min(places) < 0:
        places = [i for i, p in enumerate(plan.patterns) if isinstance(p, GrayBit)]
    if len(places) < 2:
        return float("nan")
    grey = stack.images[places][:, rows, cols].astype(np.float32) - black
    dark, light = grey.min(axis=0), grey.max(axis=0)
    # A pixel of which the code shows one level only, or a saturated one, tells nothing.
    known = light - dark > BRIGHT_OF_MODULATION * wrapped.modulation[rows, cols]
    known &= light < stack.saturation_dn - black
    if known.sum() < FEW_PIXELS:
        return float("nan")
    return float(np.median((wrapped.offset[rows, cols] - dark)[known] / (light - dark)[known]))


def response_from_ramp(stack: ImageStack, levels: list[float], places: list[int], /) -> Response:
    """Find the response from uniform images of several grey levels, dark and light among them.

    Parameters
    ----------
    stack : ImageStack
    levels, places : of the uniform images, in rising order of level

    Raises
    ------
    MethodError
        If levels are missing, the light image is saturated, or brightness does not rise.
    """
    where = f"camera '{stack.device_name}': grey ramp"
    if len(levels) < 3 or levels[0] != 0 or levels[-1] != 1:
        raise MethodError(f"{where}: expected at least three levels from 0 to 1, found {levels}")
    dark, light = (stack.images[places[i]].astype(np.float32) for i in (0, -1))
    span = light - dark
    usable = (light < stack.saturation_dn) & (span > 0.25 * np.percentile(span, 95))
    usable &= span > 0.1 * stack.range_dn
    if usable.sum() < LEAST_PIXELS // 10:
        raise MethodError(
            f"{where}: too few pixels are bright in the light image without being saturated "
            f"({int(usable.sum()):,}). Adapt the exposure"
        )
    total = float(span[usable].sum())
    values = [float((stack.images[p][usable] - dark[usable]).sum() / total) for p in places]
    if min(np.diff(values)) < -FALLING:
        raise MethodError(
            f"{where}: expected brightness that rises with the level, found "
            f"{[round(v, 3) for v in values]}. Are the images in the order of the plan?"
        )
    values = [0.0, *np.clip(np.maximum.accumulate(values), 0, 1)[1:-1].tolist(), 1.0]
    log_level, log_value = np.log(levels[1:-1]), np.log(np.maximum(values[1:-1], FALLING))
    fit = log_level @ log_value / (log_level @ log_level)
    return Response(device_name=stack.device_name, levels=tuple(levels), values=tuple(values),
                    gamma=float(fit), source=f"a grey ramp of {len(levels)} levels")  # fmt: skip


def ramp_of(plan: PatternPlan, /) -> tuple[list[float], list[int]]:
    """Return levels and places of the uniform images of a plan, by level."""
    found = plan.uniform_levels
    return [level for level, _ in found], [place for _, place in found]
