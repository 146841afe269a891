"""Check that the images agree with the calibration and with each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.decode import CameraPhases, DirectionPhases
from fringe3d.geometry import epipolar_curve, epipolar_segment, pixel_grid, project
from fringe3d.model import (
    Correspondences,
    Device,
    PhaseMap,
    PointMap,
    Rejection,
    WrappedPhaseMap,
)
from fringe3d.patterns import across

TWO_PI = 2 * np.pi

EPIPOLAR_WARNING_PX, EPIPOLAR_ERROR_PX = 0.5, 3.0
"""Good rigs stay below 0.3 px; 3 px is no calibration of these images."""

TEXTURE_REACH = 5
"""Shifts up to this part of the image are tried."""

TEXTURE_STEP_PX = 3
"""The texture is smoothed by 1 px; its correlation is about 5 px wide."""

TEXTURE_MIN_PEAK = 0.25
TEXTURE_MAX_SHIFT_PX = 3
TEXTURE_CLEAR = 0.12
"""The peak of the texture correlation must stand out this far to accuse the calibration."""

TEXTURE_MIN_SIGNAL = 4.0
FINE_FILTER_PIXELS = 4 * np.pi
"""Pixels that a Gaussian of 1 px averages over."""

LOST_WARNING, LOST_SEVERE = 0.3, 0.8
"""Part of the decoded pixels for which the geometry finds no point."""

MIN_YIELD = 0.002
"""Fewer points per decoded pixel are strays, whatever the reason."""

MENDED_WARNING, MENDED_ERROR = 0.08, 0.2
"""Sharp codes need 1 to 2 %; phases in the wrong direction or half a period off, half."""

GAMMA_DISAGREEMENT_PX = 0.3
GAMMA_EXPLAINED = 0.4
HARMONIC_WARNING = 0.05
RIPPLE_WARNING_RAD = 0.06
"""A hundredth of a period; the same as a second harmonic of 6 % with three steps."""

MIN_RIPPLE_PIXELS = 10_000
"""Fewer pixels do not cover the phases evenly."""

AMBIGUOUS_WARNING, AMBIGUOUS_REFUSED = 0.05, 0.4
"""Part of the decoded pixels that the code leaves several points."""
SAMPLE = 40_000
MAD_TO_SIGMA = 1.4826
FAR_MM = 1e5


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check, in words, with its figure.

    Parameters
    ----------
    level : "ok", "warning" or "error"
    name : str; key of the figure, with its unit
    value : float
    text : str; what was found and what to do
    """

    level: Literal["ok", "warning", "error"]
    name: str
    value: float
    text: str


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
    level: Literal["warning", "error"] = "error" if share > MENDED_ERROR else "warning"
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
        level: Literal["ok", "warning"] = "warning" if ratio > HARMONIC_WARNING else "ok"
        findings.append(Finding(level, name, ratio, text))
    return findings


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


def check_epipolar(matches: Correspondences, /) -> list[Finding]:
    """Judge the distance of decoded projector points from their epipolar curves."""
    return _residual_findings(
        matches.epipolar_residual_px,
        "epipolar_residual_px",
        f"epipolar residual in '{matches.device_name}'",
    )


def check_trinocular(points: PointMap, phases: PhaseMap, projector: Device, /) -> list[Finding]:
    """Compare points of two cameras with what the projector, the third device, says.

    Fringes of one direction show no error between two cameras; but the points must lie in the
    projector where their phase says. A code that leaves several orders is compared by its
    wrapped phase.
    """
    good = points.is_valid
    turns = phases.phase[good] / TWO_PI
    pixels = project(projector, points.points_mm[good])
    position = across(phases.angle, pixels[:, 0], pixels[:, 1])
    residual = position / phases.period_px - turns
    if phases.is_absolute:
        residual -= phases.order_class[good]
    else:
        residual -= np.rint(residual)
    residual_map = np.full(good.shape, np.nan)
    residual_map[good] = residual * phases.period_px
    text = f"trinocular residual (points of two cameras in '{projector.name}')"
    return _residual_findings(residual_map, "trinocular_residual_px", text)


def _residual_findings(residual_map: NDArray[np.floating], name: str, what: str) -> list[Finding]:
    """Judge a map of residuals, projector px, that vanish for a perfect calibration."""
    good = np.isfinite(residual_map)
    if not good.any():
        return []
    residual = residual_map[good].astype(np.float64)
    typical = float(np.median(np.abs(residual)))
    noise = float(np.median(np.abs(residual - _smooth_part(residual, np.argwhere(good)))))
    text = (
        f"{what}: median |r| {typical:.2f} px, median r {float(np.median(residual)):+.2f} px; "
        f"noise {noise:.2f} px, the rest is a smooth pattern of the calibration"
    )
    level: Literal["ok", "warning", "error"] = "ok"
    if typical > EPIPOLAR_ERROR_PX:
        level = "error"
        text += (
            ". The calibration does not belong to these images: check the rig file (another set? "
            "R inverted? rows and columns exchanged?)"
        )
    elif typical > EPIPOLAR_WARNING_PX:
        level = "warning"
        text += f". Good rigs stay below {EPIPOLAR_WARNING_PX} px: calibrate again"
    return [Finding(level, name, typical, text)]


def _smooth_part(values: NDArray[np.float64], places: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return a cubic surface through values at image places (n, 2), robust against strays."""
    y, x = (places / np.maximum(places.max(axis=0), 1) * 2 - 1).T
    model = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    limit = 5 * MAD_TO_SIGMA * np.median(np.abs(values - np.median(values)))
    kept = np.abs(values - np.median(values)) <= limit
    kept[kept] = np.arange(kept.sum()) % max(1, int(kept.sum()) // SAMPLE) == 0
    coefficients, *_ = np.linalg.lstsq(model[kept], values[kept], rcond=None)
    return np.asarray(model @ coefficients)


def check_yield(points: PointMap, /) -> list[Finding]:
    """Judge how many of the pixels that could have a point the geometry could place."""
    undecoded = Rejection.SATURATED | Rejection.LOW_MODULATION | Rejection.INCONSISTENT_CODE
    decoded = (points.rejection & np.uint16(undecoded)) == 0
    considered = decoded & ((points.rejection & np.uint16(Rejection.OUTSIDE_VOLUME)) == 0)
    if not considered.any():
        return []
    lost = float((points.rejection[considered] != 0).mean())
    found = float((points.rejection[decoded] == 0).mean())
    cause = (
        "the calibration (another set? R inverted?), the measuring volume or the plan does not "
        "belong to these images"
    )
    if found < MIN_YIELD:
        text = f"only {found:.2%} of the decoded pixels gave a point; {cause}"
        return [Finding("error", "lost_part", 1 - found, text)]
    text = f"{lost:.1%} of the decoded pixels have no possible point"
    if lost <= LOST_WARNING:
        return [Finding("ok", "lost_part", lost, text)]
    if lost <= LOST_SEVERE:
        cause = "check calibration, measuring volume and plan"
    return [Finding("warning", "lost_part", lost, f"{text}; {cause}")]


def check_ambiguity(matches: Correspondences, phases: PhaseMap, /) -> list[Finding]:
    """Judge whether the code is long enough for the measuring volume.

    Where many pixels are ambiguous, the accepted ones among them are doubtful, too: their true
    point may be hidden and a wrong one alone be left.
    """
    decoded = phases.rejection == 0
    if not decoded.any():
        return []
    ambiguous = (matches.rejection & np.uint16(Rejection.AMBIGUOUS)) != 0
    share = float(ambiguous[decoded].mean())
    n_classes, n_orders = len(np.unique(phases.class_of_order)), len(phases.class_of_order)
    text = f"{share:.1%} of the decoded pixels fit several points"
    if share <= AMBIGUOUS_WARNING:
        return [Finding("ok", "ambiguous_part", share, text)]
    level: Literal["warning", "error"] = "error" if share > AMBIGUOUS_REFUSED else "warning"
    text += (
        f": the code tells {n_classes} of {n_orders} periods apart, too few for this depth range. "
        "Keep more bits, or give a narrower depth range (--depth MIN:MAX)"
    )
    return [Finding(level, "ambiguous_part", share, text)]


def check_texture(
    matches: Correspondences, phases1: PhaseMap, phases2: PhaseMap, c1: Device, c2: Device, /
) -> list[Finding]:
    """Compare the texture of two cameras at phase-matched points.

    Fringes of one direction show no epipolar error: a wrong calibration gives a pretty, wrong
    cloud. But the surface itself, seen by both cameras, must agree at the matched points, and
    disagree a few pixels beside the epipolar curve.
    """
    profile = texture_profile(matches, phases1, phases2, c1, c2)
    if profile is None:
        return []
    shifts, correlation = profile
    best, shift = float(correlation.max()), float(shifts[np.argmax(correlation)])
    here = float(correlation[np.abs(shifts) <= TEXTURE_MAX_SHIFT_PX].max())
    name = "texture_shift_px"
    wrong = "the calibration does not belong to these images. Check the rig file"
    if here >= TEXTURE_MIN_PEAK and best - here <= TEXTURE_CLEAR:
        return [Finding("ok", name, shift if abs(shift) <= TEXTURE_MAX_SHIFT_PX else 0.0,
                        "the texture of both cameras agrees at the matched points "
                        f"(correlation {here:.2f})")]  # fmt: skip
    if best >= TEXTURE_MIN_PEAK and best - here > TEXTURE_CLEAR:
        return [Finding("error", name, shift, "the texture of both cameras agrees "
                        f"{shift:+.0f} px beside the epipolar curves (correlation {best:.2f}), not "
                        f"on them ({here:.2f}): {wrong}")]  # fmt: skip
    if texture_signal(phases1) < TEXTURE_MIN_SIGNAL:
        return [Finding("ok", name, float("nan"), "too little texture to check the calibration")]
    return [Finding("warning", name, float("nan"), "the texture of both cameras does not agree at "
                    f"the matched points (correlation {here:.2f}): {wrong}, unless the surface "
                    "shines like a mirror")]  # fmt: skip


def texture_signal(phases: PhaseMap, /) -> float:
    """Return how far the texture of the surface stands out of the noise."""
    texture = _texture(phases)
    good = np.isfinite(texture)
    if not good.any():
        return 0.0
    # sigma_A = sigma_I / sqrt(N) = sigma_phase B / sqrt(2); the filter averages 12 pixels.
    noise = phases.phase_std[good] * phases.modulation[good] / np.sqrt(2 * FINE_FILTER_PIXELS)
    return float(np.std(texture[good]) / np.median(noise / np.maximum(phases.offset[good], 1.0)))


def texture_profile(
    matches: Correspondences, phases1: PhaseMap, phases2: PhaseMap, c1: Device, c2: Device, /
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Return shifts across the epipolar curves, px, and the correlation of the textures.

    None where there are too few points.
    """
    good = np.flatnonzero(matches.rejection.ravel() == 0)
    if len(good) < 500:
        return None
    good = good[:: max(1, len(good) // SAMPLE)]
    texture1 = _texture(phases1).ravel()[good]
    texture2 = _texture(phases2)
    pixels = matches.pixels.reshape(-1, 2)[good]
    normal = _across_epipolar(c1, c2, matches)
    reach = max(c2.n_rows, c2.n_cols) // TEXTURE_REACH
    shifts = np.arange(-reach, reach + 1)
    fine = np.abs(shifts) <= 2 * TEXTURE_MAX_SHIFT_PX
    shifts = shifts[fine | (shifts % TEXTURE_STEP_PX == 0)]
    correlation = np.array(
        [_correlation(texture1, _sample(texture2, pixels + shift * normal)) for shift in shifts]
    )
    return shifts, correlation


def _texture(phases: PhaseMap) -> NDArray[np.float64]:
    """Return the local contrast of the surface: brightness without its slow changes."""
    lit = phases.rejection == 0
    bright = np.where(lit, np.log(np.maximum(phases.offset, 1.0)), 0.0)
    weight = ndimage.gaussian_filter(lit.astype(np.float64), 8.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = ndimage.gaussian_filter(bright, 8.0) / weight
    fine = ndimage.gaussian_filter(bright, 1.0) / np.maximum(
        ndimage.gaussian_filter(lit.astype(np.float64), 1.0), 1e-9
    )
    inner = ndimage.binary_erosion(lit, iterations=3)
    return np.where(inner, fine - smooth, np.nan)


def _across_epipolar(c1: Device, c2: Device, matches: Correspondences) -> NDArray[np.float64]:
    """Return the unit normal of the epipolar curve in C2, for the middle of the matched pixels."""
    grid = pixel_grid(c1.shape)[matches.rejection == 0]
    middle = grid[len(grid) // 2]
    near, far = epipolar_segment(c1, c2, middle, None)
    curve = epipolar_curve(
        c1, c2, middle, np.geomspace(float(near), min(float(far), FAR_MM), 3)[1:]
    )
    tangent = curve[1] - curve[0]
    normal: NDArray[np.float64] = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
    return normal if normal[1] >= 0 else -normal


def _sample(texture: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    col, row = np.rint(np.nan_to_num(pixels, nan=-1)).astype(int).T
    inside = (row >= 0) & (row < texture.shape[0]) & (col >= 0) & (col < texture.shape[1])
    values = np.full(len(pixels), np.nan)
    values[inside] = texture[row[inside], col[inside]]
    return values


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 500:
        return 0.0
    x, y = a[both] - a[both].mean(), b[both] - b[both].mean()
    return float((x @ y) / max(np.sqrt((x @ x) * (y @ y)), 1e-30))
