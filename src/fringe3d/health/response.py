"""Checks of the images alone, that code, periods and response agree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import CameraPhases, DirectionPhases
from fringe3d.health.finding import Finding, Level
from fringe3d.model import PhaseMap, WrappedPhaseMap, some_known

TWO_PI = 2 * np.pi
MENDED_WARNING, MENDED_ERROR = 0.08, 0.2
"""Sharp codes need 1 to 2 %; phases in the wrong direction or half a period off, half."""

COURSE_PERIODS, LEAST_PERIODS, LEAST_STEPS, LEAST_COURSE = 3, 4, 1000, 0.5
"""Over so many periods the code alone tells how the phase runs; three quarters of at least so many
pixels must agree on each way."""

GAMMA_DISAGREEMENT_PX = 0.3
GAMMA_EXPLAINED = 0.4
HARMONIC_NOTABLE = 0.05
RIPPLE_WARNING_RAD = 0.06
"""A hundredth of a period; the same as a second harmonic of 6 % with three steps."""

MIN_RIPPLE_PIXELS, MIN_RIPPLE_PERIODS = 10_000, 8
"""Fewer pixels or periods do not cover the phases evenly."""

SAMPLE = 40_000

LINES = 128
"""Rows and columns on which the course of the phase is looked at; neighbours tell the same."""


def check_phases(cameras: Sequence[CameraPhases], /) -> list[Finding]:
    """Compare periods with each other, and look for harmonics."""
    findings: list[Finding] = []
    for camera in cameras:
        for direction in camera.directions:
            findings += _code_findings(direction.main)
            findings += check_course(direction.main)
        findings += _period_findings(camera)
        findings += _harmonic_findings(camera)
        findings += _ripple_findings(camera)
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


def check_course(phases: PhaseMap, /) -> list[Finding]:
    """Judge whether the phase runs the way that the code runs.

    Where shift direction and phase offset are both wrong, a code of half periods finds nothing to
    correct: the phase runs backwards within each of its cells, and the surface has stripes.

    Parameters
    ----------
    phases : PhaseMap; a reduced code says nothing

    Returns
    -------
    list of Finding; an error, or none
    """
    if not phases.is_absolute or len(phases.class_of_order) < LEAST_PERIODS:
        return []
    rows, cols = (slice(None, None, max(1, n // LINES)) for n in phases.phase.shape)
    along_rows = _courses(phases.phase[rows], phases.order_class[rows])
    along_cols = _courses(phases.phase[:, cols].T, phases.order_class[:, cols].T)
    near, far = max(along_rows, along_cols, key=lambda c: abs(c[0]))
    if not (near * far < 0 and abs(near) > LEAST_COURSE and abs(far) > LEAST_COURSE):
        return []
    where = f"camera '{phases.device_name}', {axis_name(phases.angle)}"
    text = (
        f"{where}: the phase runs against the code: it falls between neighbours where the code "
        "rises. Reverse shift_direction, and change phase_offset_deg by 180"
    )
    return [Finding("error", f"{phases.device_name}_{axis_name(phases.angle)}_course", near, text)]


def _courses(phase: NDArray[np.float32], order: NDArray[np.int32]) -> tuple[float, float]:
    """Return the part of rising less that of falling pixels, -1 to 1: from one column to the next,
    wrapped, and over three periods; 0 where too little is known."""
    turns = phase / TWO_PI + order.astype(np.float64)
    step = np.diff(turns, axis=1)
    step -= np.rint(step)
    known = step[np.isfinite(step)]
    if len(known) < LEAST_STEPS or not abs(typical := float(np.median(known))) > 0:
        return 0.0, 0.0
    reach = round(COURSE_PERIODS / abs(typical))  # columns
    if not 0 < reach < turns.shape[1]:
        return 0.0, 0.0
    course = turns[:, reach:] - turns[:, :-reach]
    course = course[np.isfinite(course)]
    if len(course) < LEAST_STEPS:
        return 0.0, 0.0
    return float(np.sign(known).mean()), float(np.sign(course).mean())


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


Verdict = Literal["agree", "by gamma", "otherwise", "unseen"]


@dataclass(frozen=True, slots=True)
class _Figure:
    """A figure of one fringe set or pair of periods, and the key that it is kept under."""

    key: str
    value: float
    about: str
    n_shifts: int


@dataclass(frozen=True, slots=True)
class _Disagreement(_Figure):
    """Of two periods, px: `value` is half the range of 95 % of the pixels."""

    median: float
    verdict: Verdict
    gamma: float = 0.0


def _merged(level: Level, name: str, figures: Sequence[_Figure], text: str) -> Finding:
    """Return one finding for the figures of a camera that tell the same."""
    worst = max(figure.value for figure in figures)
    return Finding(level, name, worst, text, {f.key: f.value for f in figures})


def _where(camera: CameraPhases, figures: Sequence[_Figure], what: str = "fringe sets") -> str:
    places = ", ".join(figure.about for figure in figures)
    several = f"{len(figures)} {what} ({places})"
    return f"camera '{camera.device_name}', {places if len(figures) == 1 else several}"


def _range(values: Iterable[float], form: str) -> str:
    """Return the smallest to the largest value in words.

    Examples
    --------
    >>> _range([12.3, 9.1], ".1f"), _range([0.34, 0.341], ".2f")
    ('9.1-12.3', '0.34')
    """
    ordered = sorted(values)
    low, high = format(ordered[0], form), format(ordered[-1], form)
    return low if low == high else f"{low}-{high}"


def _period_findings(camera: CameraPhases) -> list[Finding]:
    """Judge how far the periods of each direction agree; one finding for each verdict."""
    groups: dict[Verdict, list[_Disagreement]] = {}
    for direction in camera.directions:
        for other in direction.others:
            pair = _disagreement(direction, other)
            groups.setdefault(pair.verdict, []).append(pair)
    return [_period_finding(camera, verdict, pairs) for verdict, pairs in groups.items()]


def _period_finding(
    camera: CameraPhases, verdict: Verdict, pairs: Sequence[_Disagreement]
) -> Finding:
    name = f"{camera.device_name}_period_disagreement_px"
    where = _where(camera, pairs, "pairs of periods")
    if verdict == "unseen":
        return _merged("warning", name, pairs, f"{where}: no pixel has both periods")
    spread = _range([p.value for p in pairs], ".2f" if verdict == "agree" else ".1f")
    if verdict == "agree":
        return _merged("ok", name, pairs, f"{where}: the periods agree to {spread} px")
    said = (
        f"{where}: the periods disagree by {_range([p.median for p in pairs], '.1f')} px (median) "
        f"and up to {spread} px (95 % of the pixels)"
    )
    if verdict == "by gamma":
        cure = (
            f"{_range([100 * p.gamma for p in pairs], '.0f')} % of it repeats "
            f"{_range([p.n_shifts for p in pairs], 'd')} times per period: the gamma "
            "(nonlinearity) of projector or camera is not corrected. Take it out with --response "
            "self, linearise the projector, or use more steps"
        )
    else:
        cure = (
            "it does not look like gamma: check the periods in the sequence, the order of the "
            "images, and whether anything moved"
        )
    return _merged("warning", name, pairs, f"{said}; {cure}")


def _disagreement(direction: DirectionPhases, other: PhaseMap) -> _Disagreement:
    main = direction.main
    axis = axis_name(main.angle)
    difference = period_disagreement(main, other)
    finite = difference[np.isfinite(difference)]
    n_shifts = min(m.n_shifts for m in direction.wrapped)
    key = f"{main.device_name}_{axis}_{main.period_px:g}px_{other.period_px:g}px_disagreement_px"
    about = f"{axis} {main.period_px:.4g} and {other.period_px:.4g} px"
    if not len(finite):
        return _Disagreement(key, float("nan"), about, n_shifts, float("nan"), "unseen")
    low, high = np.percentile(finite, [2.5, 97.5])
    spread, median = float(high - low) / 2, float(np.median(np.abs(finite)))
    noise = 2 * float(np.hypot(_sigma_px(main), _sigma_px(other)))
    if spread <= max(GAMMA_DISAGREEMENT_PX, 3 * noise):
        return _Disagreement(key, spread, about, n_shifts, median, "agree")
    gamma = explained_by_nonlinearity(main, other, n_shifts)
    verdict: Verdict = "by gamma" if gamma >= GAMMA_EXPLAINED else "otherwise"
    return _Disagreement(key, spread, about, n_shifts, median, verdict, gamma)


def _harmonic_findings(camera: CameraPhases) -> list[Finding]:
    """Tell the second harmonic, which five and more steps show and keep out of the phase."""
    figures = [
        _set_figure(wrapped, wrapped.harmonic_ratio, "harmonic")
        for direction in camera.directions
        for wrapped in direction.wrapped
        if np.isfinite(wrapped.harmonic_ratio)
    ]
    if not figures:
        return []
    percent = _range([100 * figure.value for figure in figures], ".1f")
    text = f"{_where(camera, figures)}: second harmonic {percent} % of the fringe"
    worst = max(figure.value for figure in figures)
    if worst > HARMONIC_NOTABLE:
        text += (
            "; the gamma of projector or camera is not corrected. Harmless with "
            f"{_range([figure.n_shifts for figure in figures], 'd')} steps; with 3 the phase would "
            f"ripple by {worst:.2f} rad"
        )
    return [_merged("ok", f"{camera.device_name}_harmonic", figures, text)]


def _set_figure(wrapped: WrappedPhaseMap, value: float, unit: str) -> _Figure:
    axis = axis_name(wrapped.angle)
    key = f"{wrapped.device_name}_{axis}_{wrapped.period_px:g}px_{unit}"
    return _Figure(key, value, f"{axis} {wrapped.period_px:.4g} px", wrapped.n_shifts)


def _periods_seen(main: PhaseMap, period_px: float) -> float:
    """Return how many periods the object spans; those on the projector if that is not known."""
    if not main.is_absolute:
        return len(main.class_of_order) * main.period_px / period_px
    known = some_known(main.phase, SAMPLE)
    if not len(known):
        return 0.0
    turns = main.phase.ravel()[known] / TWO_PI + main.order_class.ravel()[known].astype(np.float64)
    low, high = np.percentile(turns, [5, 95])
    return float(high - low) * main.period_px / period_px


def _ripple_findings(camera: CameraPhases) -> list[Finding]:
    """Judge a nonlinear response from how often each phase occurs.

    With few steps the harmonics cannot be seen, but they ripple the phase, and a surface under
    many fringes then shows some phases more often than others.
    """
    figures = [
        _set_figure(wrapped, _ripple_rad(direction, wrapped), "ripple_rad")
        for direction in camera.directions
        for wrapped in direction.wrapped
        if not np.isfinite(wrapped.harmonic_ratio)
        and _periods_seen(direction.main, wrapped.period_px) >= MIN_RIPPLE_PERIODS
    ]
    weak = [figure for figure in figures if figure.value <= RIPPLE_WARNING_RAD]
    strong = [figure for figure in figures if figure.value > RIPPLE_WARNING_RAD]
    cure = (
        "the gamma of projector or camera is not corrected. Take it out with --response self, "
        "linearise the projector, or use more steps"
    )
    name = f"{camera.device_name}_ripple_rad"
    findings = []
    if weak:
        findings.append(_merged("ok", name, weak, _ripple_text(camera, weak)))
    if strong:
        text = f"{_ripple_text(camera, strong)}; {cure}"
        findings.append(_merged("warning", name, strong, text))
    return findings


def _ripple_text(camera: CameraPhases, figures: Sequence[_Figure]) -> str:
    return (
        f"{_where(camera, figures)}: the phase ripples by about "
        f"{_range([figure.value for figure in figures], '.2f')} rad, "
        f"{_range([figure.n_shifts for figure in figures], 'd')} times per period"
    )


def _ripple_rad(direction: DirectionPhases, wrapped: WrappedPhaseMap) -> float:
    """Return the ripple of the phase, rad; NaN where there are too few pixels.

    It is ``a sin(N phi)`` for N steps, and ``|mean exp(i N phi)| = N a / 2`` for small a.
    """
    is_main = wrapped.period_px == direction.main.period_px
    phase = direction.main.phase if is_main else wrapped.phase
    waves = phase.ravel()[some_known(phase, SAMPLE)].astype(np.float64) * wrapped.n_shifts
    if len(waves) < MIN_RIPPLE_PIXELS:
        return float("nan")
    mean = complex(np.cos(waves).mean(), np.sin(waves).mean())
    return 2 * abs(mean) / wrapped.n_shifts


def _sigma_px(phases: PhaseMap) -> float:
    good = some_known(phases.phase, SAMPLE)
    return float(np.median(phases.phase_std.ravel()[good])) * phases.period_px / TWO_PI


def axis_name(angle: float, /) -> str:
    """Return "x", "y" or the angle in degrees, for messages and keys."""
    return {0.0: "x", np.pi / 2: "y"}.get(angle, f"{np.degrees(angle):g}deg")
