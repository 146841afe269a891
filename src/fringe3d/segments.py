"""Whether a code tells the fringe orders on each pixel's segment apart, and what would.

Segments are counted as ``fringe3d design`` counts them: those in the projector, or, where nobody
calibrated it, those in C2, which hold more periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fringe3d.design import (
    GrayNeeds,
    angle_without_code,
    gray_needs,
    guard_periods,
    periods_in_camera,
    periods_on_projector,
    reference_of,
    twin_part,
)
from fringe3d.geometry import triangulation_angle
from fringe3d.model import Device, MeasuringVolume, PhaseMap, Rig

SEGMENTS_KEPT = 8
"""Rigs, volumes and fringes whose segments are kept between measurements."""

COUNT_STEP_PX = 8
"""Segments are counted on every eighth row and column: they change slowly."""

MOST_TWINS = 0.1
"""Part of the points that may have a twin on their segment; C2 and the neighbours decide those."""

TYPICAL_PHASE_STD, TYPICAL_CALIBRATION_PX = 0.01, 0.1
"""rad and projector px; they widen the segments a little, as ``fringe3d design`` does."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """The segments on which fringe orders are searched.

    Parameters
    ----------
    device : Device; in whose image they lie: the projector, or C2
    periods : (row, col) float; on the segments of some of C1's pixels; NaN where there is none
    guard : float, periods; see `fringe3d.design.guard_periods`
    camera_period_px : float or None, px of C2; with which segments in C2 are counted
    """

    device: Device
    periods: NDArray[np.float64]
    guard: float
    camera_period_px: float | None = None

    @property
    def needs(self) -> GrayNeeds:
        """Return the cyclic Gray code that they need."""
        return gray_needs(self.periods, guard=self.guard)

    def twins(self, told_apart: int, /, *, beyond: float = 0.0) -> float:
        """Return the part of the points that have a second order of their class on the segment.

        Parameters
        ----------
        told_apart : int; neighbouring orders that the code tells apart
        beyond : float; part of the segment, at both ends, in which surfaces outside the volume
            may be the second place
        """
        return twin_part(self.periods, math.log2(told_apart), guard=self.guard, beyond=beyond)


@lru_cache(maxsize=SEGMENTS_KEPT)
def segments_in_projector(
    rig: Rig, volume: MeasuringVolume, /, *, period_px: float, angle: float
) -> Segments:
    """Return the segments in the projector of a rig, of fringes with a period, projector px."""
    assert rig.projector is not None
    periods = periods_on_projector(
        replace(rig, volume=volume), period_px=period_px, angle=angle, step=COUNT_STEP_PX
    )
    return Segments(device=rig.projector, periods=periods, guard=_guard(period_px))


def segments_in_camera(
    camera: Device,
    other: Device,
    volume: MeasuringVolume,
    /,
    *,
    period_px: float,
    camera_period_px: float,
) -> Segments:
    """Return the segments in C2 where the projector's place is not known.

    Parameters
    ----------
    camera, other : Device; C1 and C2
    volume : MeasuringVolume
    period_px : float, projector px
    camera_period_px : float, px of C2; the typical period along the segments, as the images show it

    Raises
    ------
    RigError
        If no pixel of C1 sees a part of the volume that C2 sees.
    """
    rig = Rig(cameras=(camera, other), volume=volume)
    counted = periods_in_camera(rig, camera_period_px=camera_period_px, step=COUNT_STEP_PX)
    return Segments(
        device=other,
        periods=counted.periods,
        guard=_guard(period_px),
        camera_period_px=camera_period_px,
    )


def _guard(period_px: float) -> float:
    return guard_periods(TYPICAL_PHASE_STD, TYPICAL_CALIBRATION_PX, period_px)


def told_apart(class_of_order: NDArray[np.int32], /) -> int:
    """Return how many neighbouring orders a code tells apart: the least distance in a class.

    Examples
    --------
    >>> told_apart(np.array([0, 1, 2, 3, 0, 1, 2, 3], np.int32))
    4
    """
    distances = [np.diff(np.flatnonzero(class_of_order == name)) for name in set(class_of_order)]
    return int(min((d.min() for d in distances if len(d)), default=len(class_of_order)))


def code_in_words(bits: int, phases: PhaseMap, /) -> str:
    """Name the code of so many bits for the periods of a phase map."""
    if 2**bits >= len(phases.class_of_order):
        return "a full Gray code (--method m1)"
    return f"{bits} cyclic code images ({bits + 1} if over-determined)"


def too_long(method: str, segments: Segments, phases: PhaseMap, /) -> str:
    """Say what the segments are too long for, and what would do.

    Parameters
    ----------
    method : str
    segments : Segments
    phases : PhaseMap of C1; its code tells too few orders apart
    """
    n, needs = told_apart(phases.class_of_order), segments.needs
    of = "one period" if n == 1 else f"{n} periods (so many the code tells apart)"
    code = ("--method m2 with " if method == "m5" else "") + code_in_words(needs.bits, phases)
    if segments.camera_period_px is None:
        code += "; --method m6, which does with what code there is"
    return (
        f"--method {method}: expected segments of up to {of} in '{segments.device.name}', found up "
        f"to {needs.max_periods:.1f} (median {float(np.nanmedian(segments.periods)):.1f}); "
        f"{segments.twins(n):.0%} of the points have a twin. What would do: "
        f"{code}; a narrower depth range (--depth MIN:MAX); or " + _other_rig(segments)
    )


def _other_rig(segments: Segments) -> str:
    if segments.camera_period_px is None:
        return "a projector closer to the camera (fringe3d design tells how close)"
    return (
        "the projector's calibration (fringe3d calibrate projector), in which segments are as a "
        "rule shorter. fringe3d design counts the same with --camera-period "
        f"{segments.camera_period_px:.1f}"
    )


def angles_without_code(
    rig: Rig, volume: MeasuringVolume, phases: PhaseMap, /
) -> tuple[float, float]:
    """Return the angle between C1, whose phases they are, and the projector in the middle of the
    volume, rad, and the largest one at which each segment holds less than a period; see
    `design.angle_without_code`.
    """
    assert rig.projector is not None
    cameras = sorted(rig.cameras, key=lambda camera: camera.name != phases.device_name)
    placed = replace(rig, cameras=tuple(cameras), volume=volume)
    largest = angle_without_code(
        placed, period_px=phases.period_px, angle=phases.angle, step=4 * COUNT_STEP_PX
    )
    middle = reference_of(placed).point_mm
    return triangulation_angle(placed.cameras[0], rig.projector, middle), largest
