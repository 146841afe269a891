"""The ripple that a nonlinear response leaves in the phase: which, and its table for decoding."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import Response, Ripple
from fringe3d.model.plan import FringeSet
from fringe3d.model.response import equal_steps

MOST_WAVES = 8
"""Waves of a ripple; a gamma of 2.2 and three steps need five for 2 mrad."""

CURVE_LEVELS = 65
PLACES = 720
"""Of a period at which ripples in closed form are computed."""

TABLE_PLACES = 2048
"""Of a period in the table for decoding; linear between them it is right to 1e-5 rad."""


def gamma_curve(gamma: float, /) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return levels and values of ``level**gamma``."""
    levels = np.linspace(0, 1, CURVE_LEVELS) ** 2  # denser where a power bends most
    return tuple(levels.tolist()), tuple((levels**gamma).tolist())


def ripple_of(response: Response | None, fringe_set: FringeSet, /) -> Ripple | None:
    """Return the ripple of a fringe set: as measured with it, else by the curve; None if unknown.

    Raises
    ------
    MethodError
        If the response does not tell it.
    """
    if response is None:
        return None
    for ripple in response.ripples:
        same = math.isclose(ripple.period_px, fringe_set.period_px, rel_tol=1e-6)
        steps = ripple.n_shifts == len(fringe_set.shifts) and equal_steps(fringe_set.shifts)
        if same and steps and math.isclose(ripple.angle, fringe_set.angle, abs_tol=1e-6):
            turns = (fringe_set.shifts[0] - ripple.origin) * ripple.n_shifts / (2 * math.pi)
            if abs(turns - round(turns)) < 1e-3:
                return ripple
    if response.has_curve and equal_steps(fringe_set.shifts):
        return ripple_of_curve(response, fringe_set)
    raise MethodError(
        f"response of camera '{response.device_name}': expected one that tells the ripple of "
        f"{len(fringe_set.shifts)} steps of {fringe_set.period_px:g} px, found "
        f"{response.source or 'other steps'}. Find it from a grey ramp, from such fringes, or "
        "take --response self"
    )


def ripple_of_curve(response: Response, fringe_set: FringeSet, /) -> Ripple:
    """Return the ripple that the curve of a response leaves in the phase of equal steps.

    In closed form, without the blur of projector and camera, which weakens harmonics.

    Examples
    --------
    >>> from fringe3d.model.plan import PatternPlan, fringes
    >>> three = PatternPlan(patterns=fringes(16.0, 3)).fringe_sets[0]
    >>> levels, values = gamma_curve(2.2)
    >>> response = Response(device_name="c1", levels=levels, values=values)
    >>> round(ripple_of_curve(response, three).amplitude, 2)
    0.21
    """
    shifts = np.asarray(fringe_set.shifts)
    n_steps, origin = len(shifts), float(shifts[0])
    true = origin + 2 * np.pi / n_steps * np.arange(PLACES) / PLACES
    grey = np.interp(0.5 + 0.5 * np.cos(true[:, None] - shifts), response.levels, response.values)
    phasor = grey @ np.exp(1j * shifts)
    error = np.angle(phasor * np.exp(-1j * true))  # measured less true
    # Sampled where the true phase is evenly spread: d true = d measured / slope.
    wave = n_steps * (true + error - origin)
    turn = np.gradient(wave, n_steps * (true[1] - true[0]))
    turn[[0, -1]] = turn[1], turn[-2]
    sines = [float(2 * np.mean(-error * np.sin(k * wave) * turn))
             for k in range(1, MOST_WAVES + 1)]  # fmt: skip
    return Ripple(period_px=fringe_set.period_px, angle=fringe_set.angle, n_shifts=n_steps,
                  origin=origin, sines=tuple(sines))  # fmt: skip


def correction_table(ripple: Ripple | None, /) -> NDArray[np.float32]:
    """Return what is added to measured phases 0 to 2 pi, rad, both ends included; empty for None.

    Shape (`TABLE_PLACES` + 1,) or (0,).
    """
    if ripple is None or not ripple.sines:
        return np.empty(0, np.float32)
    places = 2 * np.pi / TABLE_PLACES * np.arange(TABLE_PLACES + 1)
    return ripple.correction(places).astype(np.float32)


def corrected(ripple: Ripple | None, phase: NDArray[np.float32], /) -> NDArray[np.float32]:
    """Return phases in (-pi, pi] without their ripple."""
    if ripple is None or not ripple.sines:
        return phase
    true = phase + ripple.correction(phase)
    return np.asarray(-((np.pi - true) % (2 * np.pi) - np.pi), np.float32)


def slope_at(ripple: Ripple, true_phase: NDArray[np.float32], /) -> NDArray[np.float32]:
    """Return d true / d measured phase where the true phase is known: noise grows by it."""
    measured = 2 * np.pi / TABLE_PLACES * np.arange(-TABLE_PLACES, 2 * TABLE_PLACES + 1)
    true = np.maximum.accumulate(measured + ripple.correction(measured))
    wrapped = np.mod(true_phase, np.float32(2 * np.pi))
    return np.interp(wrapped, true, np.maximum(ripple.slope(measured), 0)).astype(np.float32)
