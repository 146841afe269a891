"""Checks of the calibration by residuals, yield and ambiguity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import project
from fringe3d.health.finding import Finding, Level
from fringe3d.model import CalibrationBias, Correspondences, Device, PhaseMap, PointMap, Rejection
from fringe3d.patterns import across

TWO_PI = 2 * np.pi
MAD_TO_SIGMA = 1.4826
SAMPLE = 20_000

EPIPOLAR_WARNING_PX, EPIPOLAR_ERROR_PX = 0.5, 3.0
"""Good rigs stay below 0.3 px; 3 px is no calibration of these images."""

LOST_WARNING, LOST_SEVERE = 0.3, 0.8
"""Part of the decoded pixels for which the geometry finds no point."""

MIN_YIELD = 0.002
"""Fewer points per decoded pixel are strays, whatever the reason."""

TWIN_WARNING = 0.05
"""Part of the points that a surface outside the volume could stand behind."""

DOUBTFUL_ORDER, DOUBTFUL_WARNING = 0.9, 0.02
"""Probability below which an order is in doubt, and the part of the points that may be."""

UNDECIDED_WARNING = 0.05
"""Part of the placed pixels; edges and reflections leave a few percent open everywhere."""

PREVIOUS_WARNING = 0.5
"""Part of the points that the frame before should know."""

BIAS_WARNING_PX = 1.0

AMBIGUOUS_WARNING, AMBIGUOUS_REFUSED = 0.05, 0.4
"""Part of the decoded pixels that the code leaves several points."""


def check_epipolar(matches: Correspondences, /) -> list[Finding]:
    """Judge the distance of decoded projector points from their epipolar curves."""
    residual = matches.epipolar_residual_px
    places = np.argwhere(np.isfinite(residual))
    return _residual_findings(
        residual[places[:, 0], places[:, 1]].astype(np.float64),
        places,
        "epipolar_residual_px",
        f"epipolar residual in '{matches.device_name}'",
    )


def check_trinocular(points: PointMap, phases: PhaseMap, projector: Device, /) -> list[Finding]:
    """Compare points of two cameras with what the projector, the third device, says.

    Fringes of one direction show no error between two cameras; but the points must lie in the
    projector where their phase says. A code that leaves several orders is compared by its
    wrapped phase.
    """
    index = np.flatnonzero(points.rejection == 0)
    good = np.unravel_index(_part_of(index, SAMPLE), points.rejection.shape)
    pixels = project(projector, points.points_mm[good])
    position = across(phases.angle, pixels[:, 0], pixels[:, 1])
    residual = position / phases.period_px - phases.phase[good] / TWO_PI
    if phases.is_absolute:
        residual -= phases.order_class[good]
    else:
        residual -= np.rint(residual)
    known = np.isfinite(residual)
    return _residual_findings(
        residual[known] * phases.period_px,
        np.column_stack(good)[known],
        "trinocular_residual_px",
        f"trinocular residual (points of two cameras in '{projector.name}')",
    )


def _part_of(index: NDArray[np.intp], n: int) -> NDArray[np.intp]:
    """Return about n of the pixels; an odd step does not stay on the same columns."""
    return index[:: max(1, len(index) // n) | 1]


def _residual_findings(
    residual: NDArray[np.float64], places: NDArray[np.intp], name: str, what: str
) -> list[Finding]:
    """Judge residuals at places (n, 2), projector px, that vanish for a perfect calibration."""
    if not len(residual):
        return []
    typical = float(np.median(np.abs(residual)))
    noise = float(np.median(np.abs(residual - _smooth_part(residual, places))))
    text = (
        f"{what}: median |r| {typical:.2f} px, median r {float(np.median(residual)):+.2f} px; "
        f"noise {noise:.2f} px, the rest is a smooth pattern of the calibration"
    )
    level: Level = "ok"
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
    # What fits several orders says nothing against the calibration.
    is_open = (points.rejection & np.uint16(Rejection.AMBIGUOUS)) != 0
    decoded = (points.rejection & np.uint16(undecoded)) == 0
    n_open = int((decoded & is_open).sum())
    decoded &= ~is_open
    considered = decoded & ((points.rejection & np.uint16(Rejection.OUTSIDE_VOLUME)) == 0)
    if not considered.any():
        return []
    lost = float((points.rejection[considered] != 0).mean())
    found = float((points.rejection[decoded] == 0).mean())
    cause = (
        "the calibration (another set? R inverted?), the measuring volume or the plan does not "
        "belong to these images"
    )
    if found < MIN_YIELD and decoded.sum() <= n_open:
        return []
    if found < MIN_YIELD:
        text = f"only {found:.2%} of the decoded pixels gave a point; {cause}"
        return [Finding("error", "lost_part", 1 - found, text)]
    text = f"{lost:.1%} of the decoded pixels have no possible point"
    if lost <= LOST_WARNING:
        return [Finding("ok", "lost_part", lost, text)]
    if lost <= LOST_SEVERE:
        cause = (
            "that is right where a table or a wall outside the measuring volume is seen; else "
            "check calibration, volume and plan"
        )
    return [Finding("warning", "lost_part", lost, f"{text}; {cause}")]


def check_twins(share: float, /, *, code: str = "one code image more") -> list[Finding]:
    """Judge how many points could be surfaces just outside the volume.

    Parameters
    ----------
    share : float; part of the points, found (`twin_share`) or counted by geometry
    code : str; what would tell them apart
    """
    text = f"{share:.1%} of the points have a twin of their code just outside the measuring volume"
    advice = (
        ": a table, wall or holder there is taken for a part of the object. Look at the cloud; "
        f"record {code}, or make the volume as deep as what is seen"
    )
    return _part("twin_part", share, TWIN_WARNING, text, advice)


def check_previous(
    matches: Correspondences, main: PhaseMap, projector: Device, previous_mm: NDArray[np.float64], /
) -> list[Finding]:
    """Tell how many points are those of the frame before, moved by less than half a period."""
    x, y = np.moveaxis(project(projector, previous_mm), -1, 0)
    before = across(main.angle, x, y) / main.period_px
    known = (matches.rejection == 0) & np.isfinite(before)
    if not known.any():
        text = "the frame before (--previous) has no point where this one has"
        return [
            Finding("warning", "previous_part", 0.0, f"{text}. Name a result of the same scene")
        ]
    turns = matches.fringe_order[known] + main.phase[known] / (2 * np.pi)
    share = float((np.abs(turns - before[known]) < 0.5).mean())
    text = f"{share:.1%} of the points are those of the frame before, up to half a period"
    if share >= PREVIOUS_WARNING:
        return [Finding("ok", "previous_part", share, text)]
    advice = "Name a result of the same scene, a moment earlier, or leave --previous out"
    return [Finding("warning", "previous_part", share, f"{text}. {advice}")]


def check_probability(matches: Correspondences, /) -> list[Finding]:
    """Judge how many accepted points have a fringe order that is not much the likeliest."""
    assert matches.order_probability is not None
    accepted = matches.rejection == 0
    if not accepted.any():
        return []
    doubtful = float((matches.order_probability[accepted] < DOUBTFUL_ORDER).mean())
    text = f"{doubtful:.1%} of the points have a fringe order less probable than {DOUBTFUL_ORDER:g}"
    advice = (
        ": many of them will be wrong by whole periods, and their sigma does not say so. Leave "
        "--min-probability out, or record a code"
    )
    return _part("doubtful_part", doubtful, DOUBTFUL_WARNING, text, advice)


def _part(name: str, share: float, most: float, text: str, advice: str) -> list[Finding]:
    """Tell of a part of the pixels; warn, and say what to do, where it is too large."""
    if share <= most:
        return [Finding("ok", name, share, text)]
    return [Finding("warning", name, share, text + advice)]


def check_evidence(
    matches: Correspondences,
    rival_shift: int,
    /,
    *,
    has_bias: bool = False,
    angles: Callable[[], tuple[float, float]] | None = None,
) -> list[Finding]:
    """Judge how many fringe orders the evidence of all pixels leaves open (method M6).

    Parameters
    ----------
    matches : Correspondences
    rival_shift : int; periods by which another solution differs that fits as well; 0 for none
    has_bias : bool; the calibration's bias is stored with the rig
    angles : called where many are open; returns that between C1 and the projector, and the largest
        one at which each segment holds less than a period, rad
    """
    ambiguous = (matches.rejection & np.uint16(Rejection.AMBIGUOUS)) != 0
    candidates = int((ambiguous | (matches.rejection == 0)).sum())
    share = float(ambiguous.sum() / candidates) if candidates else 0.0
    text = f"{share:.1%} of the pixels with candidates fit several fringe orders about equally well"
    if share <= UNDECIDED_WARNING:
        return [Finding("ok", "undecided_part", share, text)]
    apart = f", {rival_shift} period(s) apart" if rival_shift else ""
    bit = (rival_shift & -rival_shift).bit_length() - 1 if rival_shift else 0
    bias = (
        "the rig's calibration bias, learnt once from a well-structured scan of something else "
        "(fringe3d calibrate bias); "
    )
    advice = (
        f"{apart}; they are rejected as AMBIGUOUS. What would tell: {'' if has_bias else bias}"
        f"image {bit} (0 is the finest) of a cyclic Gray code; a narrower depth range (--depth "
        f"MIN:MAX); or a projector at another angle{_as_now(angles)} (fringe3d design --optimise)"
    )
    return [Finding("warning", "undecided_part", share, text + advice)]


def _as_now(angles: Callable[[], tuple[float, float]] | None) -> str:
    """Return between which angles the projector might be moved, for a message."""
    if angles is None:
        return ""
    now, largest = np.degrees(angles())
    if not 0 < largest < now:
        return f", now {now:.1f} degrees from C1"
    return (
        f" than {now:.1f} degrees from C1: at {largest:.1f} or less each segment holds one order; "
        "beyond, the less symmetrically the cameras see it, the better"
    )


def check_bias(used: CalibrationBias | None, stored: CalibrationBias | None, /) -> list[Finding]:
    """Tell by how much points in C2 miss the calibration, and where that is known from."""
    if used is None:
        return []
    rms = used.rms_px
    fits = stored is not None and stored.fits(used.angle)
    of = "learnt from these images"
    if fits:
        of = "stored with the rig" + ("" if used is stored else ", refined by these images")
    text = f"calibration bias ({of}): points in the second camera miss by {rms:.2f} px (rms)"
    findings = [Finding("ok", "calibration_bias_px", rms, text)]
    if rms > BIAS_WARNING_PX:
        text += f". Good rigs stay below {BIAS_WARNING_PX} px: calibrate again"
        findings = [Finding("warning", "calibration_bias_px", rms, text)]
    if stored is not None and not fits:
        text = (
            f"the bias that is stored with the rig belongs to fringes at "
            f"{np.degrees(stored.angle):.1f} degrees; these lie at {np.degrees(used.angle):.1f}: "
            "it was left out. Learn one for them (fringe3d calibrate bias)"
        )
        findings.append(Finding("warning", "bias_left_out", 1.0, text))
    return findings


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
    level: Level = "error" if share > AMBIGUOUS_REFUSED else "warning"
    text += (
        ": without a code this rig does not tell the fringe orders apart (fringe3d design shows "
        "the ambiguity margin). Record a reduced Gray code (--method m2) or a second direction "
        "(--method m4), weigh all pixels together (--method m6; calibrated projector), or give a "
        "narrower depth range (--depth MIN:MAX)"
        if n_classes == 1
        else f": the code tells {n_classes} of {n_orders} periods apart, too few for this depth "
        "range. Keep more bits, weigh all pixels together (--method m6; calibrated projector), or "
        "give a narrower depth range (--depth MIN:MAX)"
    )
    return [Finding(level, "ambiguous_part", share, text)]
