"""What is wrong with a recording, and what helps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fringe3d.errors import CalibrationError, EmptyResultError, Fringe3DError, MethodError
from fringe3d.health import (
    Fault,
    Finding,
    Kind,
    check_exposure,
    check_focus,
    check_response,
    check_sequence,
    check_steadiness,
    light_of,
    lit_map,
    steps_of,
)
from fringe3d.model import ImageStack, Rig, Scan
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure

GEOMETRIC = {
    "epipolar_residual_px": "epipolar residual, px",
    "trinocular_residual_px": "trinocular residual, px",
    "texture_shift_px": "shift of the texture, px",
    "lost_part": "part of the pixels without a point",
    "moved_px": "contradiction of the devices, px",
}
"""Findings of a measurement that accuse the calibration, and what their figures are."""

OF_RESPONSE = "ripple_rad"
"""End of the name of the finding of a measurement that accuses the response; it needs many
fringes, and only three steps need it."""

LOST = "lost_part"
VOUCHING = ("epipolar_residual_px", "trinocular_residual_px")
"""Findings that no wrong calibration passes: then pixels without a point see a table or a wall that
lies outside the volume."""

MISORDERED = frozenset({
    Kind.MISSING_IMAGE, Kind.REPEATED_IMAGE, Kind.EXCHANGED_IMAGES, Kind.SHIFT_DIRECTION,
    Kind.PERIOD, Kind.GRAY_POLARITY, Kind.GRAY_ORDER, Kind.SEQUENCE,
})  # fmt: skip
"""Faults after which nothing else that the images say can be believed."""

INSIDE_PART = 0.02
"""Of the points that are found without a measuring volume: fewer inside it, and the object is not
there."""

MOST_LOST = 0.8
"""Part of the pixels without a point that a table or wall outside the volume may explain where
nothing vouches for the calibration."""

LEAST_POINTS = 0.01
"""Part of the pixels that must have a point to judge anything by them."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What is wrong with a recording.

    Parameters
    ----------
    faults : tuple of Fault; what stands first is to be mended first
    findings : tuple of Finding; what a measurement says, where one was possible
    """

    faults: tuple[Fault, ...]
    findings: tuple[Finding, ...]

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Return the kinds of the faults, each once."""
        return tuple(dict.fromkeys(fault.kind for fault in self.faults))


def diagnose(
    scan: Scan,
    options: MeasureOptions | None = None,
    /,
    *,
    stage: Callable[[str], object] = str,
) -> Diagnosis:
    """Find what is wrong with a recording: first by each camera's images, then by a measurement.

    Parameters
    ----------
    scan : Scan
    options : MeasureOptions or None (defaults)
    stage : called with the name of each stage as it begins

    Returns
    -------
    Diagnosis
    """
    stage("looking at the images")
    faults = [fault for stack in scan.stacks for fault in _of_images(stack)]
    if MISORDERED & {fault.kind for fault in faults}:
        return Diagnosis(tuple(faults), ())
    stage("measuring")
    result = _measured(scan, options)
    findings = result.findings if isinstance(result, Measurement) else ()
    faults += _of_response(findings, faults)
    if scan.rig is not None:
        stage("looking at the geometry")
        faults += _of_geometry(scan, scan.rig, options, result, faults)
    return Diagnosis(tuple(faults), tuple(findings))


def _of_images(stack: ImageStack) -> list[Fault]:
    """Judge the images of one camera; in the wrong order they say nothing else."""
    lit = lit_map(stack)
    light = light_of(stack, lit)
    exposure = [*check_exposure(stack, lit), *check_focus(stack, light)]
    order = check_sequence(stack, lit)
    if exposure:  # which leaves too little to contradict anything
        order = [fault for fault in order if fault.kind is not Kind.SEQUENCE]
    if order and order[0].kind is not Kind.SEQUENCE:
        return [*order, *exposure]
    steps = [steps_of(stack, lit, fringe_set) for fringe_set in stack.plan.fringe_sets]
    seen = [step for step in steps if step is not None]
    worst = max(seen, key=lambda s: (s.flicker, s.step_error), default=None)
    harmonic = max((s.second_harmonic for s in seen), key=abs, default=float("nan"))
    return [
        *order,
        *exposure,
        *check_response(stack, light, harmonic),
        *check_steadiness(stack, lit, worst),
    ]


def _measured(scan: Scan, options: MeasureOptions | None) -> Measurement | Fringe3DError:
    try:
        return measure(scan, options)
    except Fringe3DError as problem:
        return problem


def _of_response(findings: Sequence[Finding], before: Sequence[Fault]) -> list[Fault]:
    """Return what a measurement says of the response, where the images alone did not."""
    if any(fault.kind is Kind.GAMMA for fault in before):
        return []
    return [
        Fault(kind=Kind.GAMMA, camera="", figure="ripple of the phase, rad", value=finding.value,
              limit=0.06, text=finding.text)
        for finding in findings
        if finding.name.endswith(OF_RESPONSE) and finding.level != "ok"
    ]  # fmt: skip


def _of_geometry(
    scan: Scan,
    rig: Rig,
    options: MeasureOptions | None,
    result: Measurement | Fringe3DError,
    before: Sequence[Fault],
) -> list[Fault]:
    """Judge the calibration, which camera is which, and where the object stands."""
    if isinstance(result, MethodError) and "several points" not in str(result):
        return []
    accused = _accusations(result, vouch=False)
    if not accused and not isinstance(result, Fringe3DError):
        return []
    if any(fault.kind in (Kind.TOO_DARK, Kind.DEFOCUS) for fault in before):
        return []  # too few pixels tell anything
    free = _free_of_volume(scan, rig, options)
    if free is not None:
        outside = _outside(free, rig)
        if outside is not None:
            return [outside]
        if accused and all(fault.figure == GEOMETRIC[LOST] for fault in accused):
            return []  # the calibration fits; what is lost lies outside
    exchanged = _exchanged(scan, options, result)
    if exchanged is not None:
        return [exchanged]
    return _accusations(result) or _accusations_of_error(result)


def _accusations(result: Measurement | Fringe3DError, *, vouch: bool = True) -> list[Fault]:
    """Return the findings of a measurement that accuse the calibration or the code, as faults.

    With `vouch`, residuals that are small clear it of the pixels that have no point.
    """
    if not isinstance(result, Measurement):
        return []
    vouched = vouch and any(f.name in VOUCHING and f.level == "ok" and np.isfinite(f.value)
                  for f in result.findings) and _has_points(result)  # fmt: skip
    found = [f for f in result.findings if f.name in GEOMETRIC and f.level != "ok"
             and not (f.name == LOST and (vouched or f.value < MOST_LOST))]  # fmt: skip
    return [Fault(kind=Kind.CALIBRATION, camera="", figure=GEOMETRIC[f.name], value=f.value,
                    limit=float("nan"), text=f.text) for f in found]  # fmt: skip


def _accusations_of_error(result: Measurement | Fringe3DError) -> list[Fault]:
    """Return why a measurement was refused as a fault."""
    if isinstance(result, CalibrationError | EmptyResultError):
        return [Fault(kind=Kind.CALIBRATION, camera="", figure="", value=float("nan"),
                      limit=float("nan"), text=str(result))]  # fmt: skip
    if isinstance(result, MethodError):
        return [Fault(kind=Kind.AMBIGUOUS, camera="", figure="", value=float("nan"),
                      limit=float("nan"), text=str(result))]  # fmt: skip
    return []


def _has_points(result: Measurement) -> bool:
    """Tell whether enough pixels have a point to judge anything by them."""
    return result.points is not None and (result.points.rejection == 0).mean() >= LEAST_POINTS


def _free_of_volume(scan: Scan, rig: Rig, options: MeasureOptions | None) -> Measurement | None:
    """Measure without the volume; None where there is none, or that contradicts the calibration."""
    if rig.volume is None:
        return None
    free = _measured(replace(scan, rig=replace(rig, volume=None, bias=None)), options)
    if not isinstance(free, Measurement) or _accusations(free) or not _has_points(free):
        return None
    return free


def _outside(free: Measurement, rig: Rig) -> Fault | None:
    """Tell whether points that were found without the measuring volume lie outside it."""
    assert free.points is not None
    assert rig.volume is not None
    good = free.points.rejection == 0
    inside = float(rig.volume.contains(free.points.points_mm[good]).mean())
    if inside >= INSIDE_PART:
        return None
    middle = np.median(free.points.points_mm[good], axis=0)
    text = (
        f"{inside:.1%} of the {int(good.sum()):,} points lie inside the measuring volume; their "
        f"middle is at ({middle[0]:.0f}, {middle[1]:.0f}, {middle[2]:.0f}) mm"
    )
    return Fault(kind=Kind.OUTSIDE, camera="", figure="part of the points inside the volume",
                 value=inside, limit=INSIDE_PART, text=text)  # fmt: skip


def _exchanged(
    scan: Scan, options: MeasureOptions | None, result: Measurement | Fringe3DError
) -> Fault | None:
    """Tell whether the images of two cameras fit each other's calibration better."""
    if len(scan.stacks) != 2 or scan.stacks[0].shape != scan.stacks[1].shape:
        return None
    first, second = scan.stacks
    swapped = replace(
        scan,
        stacks=(
            replace(second, device_name=first.device_name),
            replace(first, device_name=second.device_name),
        ),
    )
    other = _measured(swapped, options)
    if not isinstance(other, Measurement) or other.points is None or _accusations(other):
        return None
    now = result.points.n_points if isinstance(result, Measurement) and result.points else 0
    if other.points.n_points <= LEAST_POINTS * other.points.rejection.size:
        return None
    is_better = other.points.n_points > now
    if not is_better and all(fault.figure == GEOMETRIC[LOST] for fault in _accusations(result)):
        return None  # neither contradicts itself: the one that finds more is right
    text = (
        f"the images of '{first.device_name}' and '{second.device_name}' fit each other's "
        f"calibration: {other.points.n_points:,} points without contradiction, {now:,} as described"
    )
    return Fault(kind=Kind.CAMERAS, camera="", figure="points as described over points exchanged",
                 value=now / other.points.n_points, limit=1.0, text=text)  # fmt: skip
