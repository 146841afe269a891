"""Checks of the images alone, that code, periods and response agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import CameraPhases, DirectionPhases
from fringe3d.health.finding import Finding, Level
from fringe3d.model import PhaseMap, WrappedPhaseMap

TWO_PI = 2 * np.pi
MENDED_WARNING, MENDED_ERROR = 0.08, 0.2
"""Sharp codes need 1 to 2 %; phases in the wrong direction or half a period off, half."""

GAMMA_DISAGREEMENT_PX = 0.3
GAMMA_EXPLAINED = 0.4
HARMONIC_WARNING = 0.05
RIPPLE_WARNING_RAD = 0.06
"""A hundredth of a period; the same as a second harmonic of 6 % with three steps."""

MIN_RIPPLE_PIXELS, MIN_RIPPLE_PERIODS = 10_000, 8
"""Fewer pixels or periods do not cover the phases evenly."""

SAMPLE = 40_000


def check_phases(cameras: Sequence[CameraPhases], /) -> list[Finding]:
    """Compare periods with each other, and look for harmonics."""
    findings: list[Finding] = []
    for camera in cameras:
        for direction in camera.directions:
            findings += _code_findings(direction.main)
            findings += [_period_finding(direction, other) for other in direction.others]
            findings += _harmonic_findings(direction)
    return findings


def _code_findings(phases: PhaseMap) -> list[Finding]:
    """Judge how often the phase had to correct the code."""
    good = int((phases.rejection == 0).sum())
    if not good or not phases.n_mended:
        return []
    share = phases.n_mended / good
    where = f"camera '{phases.device_name}', {axis_name(phases.angle)}"
    name = f"{phases.device_name}_{axis_name(phases.angle)}_mended_part"
    text = f"{where}: the phase corrected the code of {share:.1%} of the pixels by one cell"
    if share <= MENDED_WARNING:
        return [Finding("ok", name, share, text)]
    level: Level = "error" if share > MENDED_ERROR else "warning"
    cure = (
        "phase and code do not belong together. Check shift_direction, phase_offset_deg, "
        "first_coordinate and the order of the steps in the sequence"
    )
    return [Finding(level, name, share, f"{text}; {cure}")]


def period_disagreement(a: PhaseMap, b: PhaseMap, /) -> NDArray[np.float64]:
    """Return w of `a` minus w of `b`, (row, col), projector px; NaN where either is missing."""
    return a.position_px - b.position_px


def explained_by_nonlinearity(a: PhaseMap, b: PhaseMap, n_shifts: int, /) -> float:
    """Return how much of the disagreement of two periods repeats with their phases, 0 to 1.

    A nonlinear response (gamma) leaves a phase error with N waves per period for N steps; two
    periods then disagree by a function of their two phases. The share is the R**2 of a fit of
    sines and cosines of N times each phase.
    """
    difference = period_disagreement(a, b)
    good = np.flatnonzero(np.isfinite(difference))
    if len(good) < 100:
        return 0.0
    good = good[:: max(1, len(good) // SAMPLE)]
    d = difference.ravel()[good]
    d = np.clip(d - np.median(d), *np.percentile(d - np.median(d), [1, 99]))
    waves = [n_shifts * m.phase.ravel()[good].astype(np.float64) for m in (a, b)]
    model = np.stack([np.ones_like(d), *(f(x) for x in waves for f in (np.cos, np.sin))], axis=1)
    coefficients, *_ = np.linalg.lstsq(model, d, rcond=None)
    return float(1 - ((d - model @ coefficients) ** 2).sum() / ((d - d.mean()) ** 2).sum())


def _period_finding(direction: DirectionPhases, other: PhaseMap) -> Finding:
    main = direction.main
    difference = period_disagreement(main, other)
    finite = difference[np.isfinite(difference)]
    where = f"camera '{main.device_name}', {axis_name(main.angle)}"
    name = f"{main.device_name}_{axis_name(main.angle)}_period_disagreement_px"
    if not len(finite):
        return Finding("warning", name, float("nan"), f"{where}: no pixel has both periods")
    low, high = np.percentile(finite, [2.5, 97.5])
    spread = float(high - low) / 2
    noise = 2 * np.hypot(_sigma_px(main), _sigma_px(other))
    pair = f"{main.period_px:g} and {other.period_px:g} px"
    if spread <= max(GAMMA_DISAGREEMENT_PX, 3 * noise):
        return Finding("ok", name, spread, f"{where}: periods {pair} agree to {spread:.2f} px")
    n_shifts = min(m.n_shifts for m in direction.wrapped)
    share = explained_by_nonlinearity(main, other, n_shifts)
    typical = float(np.median(np.abs(finite)))
    said = (
        f"{where}: the periods {pair} disagree by {typical:.1f} px (median) and up to "
        f"{spread:.1f} px (95 % of the pixels)"
    )
    if share >= GAMMA_EXPLAINED:
        cure = (
            f"{share:.0%} of it repeats {n_shifts} times per period: the gamma (nonlinearity) of "
            "projector or camera is not corrected. Linearise the projector, or use more steps"
        )
    else:
        cure = (
            "it does not look like gamma: check the periods in the sequence, the order of the "
            "images, and whether anything moved"
        )
    return Finding("warning", name, spread, f"{said}; {cure}")


def _harmonic_findings(direction: DirectionPhases) -> list[Finding]:
    findings = []
    for wrapped in direction.wrapped:
        ratio = wrapped.harmonic_ratio
        if not np.isfinite(ratio):
            if _periods_seen(direction.main, wrapped.period_px) >= MIN_RIPPLE_PERIODS:
                findings += _ripple_findings(wrapped)
            continue
        name = f"{wrapped.device_name}_{axis_name(wrapped.angle)}_{wrapped.period_px:g}px_harmonic"
        text = (
            f"camera '{wrapped.device_name}', {axis_name(wrapped.angle)}: second harmonic "
            f"{ratio:.1%} of the fringe of {wrapped.period_px:g} px"
        )
        if ratio > HARMONIC_WARNING:
            text += (
                "; the gamma of projector or camera is not corrected. Harmless for "
                f"{wrapped.n_shifts} steps, but not when measuring with 3"
            )
        level: Level = "warning" if ratio > HARMONIC_WARNING else "ok"
        findings.append(Finding(level, name, ratio, text))
    return findings


def _periods_seen(main: PhaseMap, period_px: float) -> float:
    """Return how many periods the object spans; those on the projector if that is not known."""
    if not main.is_absolute:
        return len(main.class_of_order) * main.period_px / period_px
    position = main.position_px[main.rejection == 0]
    if not len(position):
        return 0.0
    low, high = np.percentile(position, [5, 95])
    return float(high - low) / period_px


def _ripple_findings(wrapped: WrappedPhaseMap) -> list[Finding]:
    """Judge a nonlinear response from how often each phase occurs.

    With few steps the harmonics cannot be seen, but they ripple the phase, ``a sin(N phi)``, and
    a surface under many fringes then shows some phases more often than others:
    ``|mean exp(i N phi)| = N a / 2`` for small a.
    """
    phase = wrapped.phase[np.isfinite(wrapped.phase)].astype(np.float64)
    if len(phase) < MIN_RIPPLE_PIXELS:
        return []
    n = wrapped.n_shifts
    ripple = 2 * float(np.abs(np.exp(1j * n * phase).mean())) / n
    axis = axis_name(wrapped.angle)
    name = f"{wrapped.device_name}_{axis}_{wrapped.period_px:g}px_ripple_rad"
    text = (
        f"camera '{wrapped.device_name}', {axis}: the phase of the fringe of "
        f"{wrapped.period_px:g} px ripples by about {ripple:.2f} rad, {n} times per period"
    )
    if ripple <= RIPPLE_WARNING_RAD:
        return [Finding("ok", name, ripple, text)]
    cure = "the gamma of projector or camera is not corrected. Linearise it, or use more steps"
    return [Finding("warning", name, ripple, f"{text}; {cure}")]


def _sigma_px(phases: PhaseMap) -> float:
    good = phases.rejection == 0
    return float(np.median(phases.phase_std[good])) * phases.period_px / TWO_PI


def axis_name(angle: float, /) -> str:
    """Return "x", "y" or the angle in degrees, for messages and keys."""
    return {0.0: "x", np.pi / 2: "y"}.get(angle, f"{np.degrees(angle):g}deg")
