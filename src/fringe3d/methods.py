"""Which method the plan and the rig allow, and which images it needs.

=========  ==================================================  ===================================
method     images                                              fringe order
=========  ==================================================  ===================================
m0         full Gray code, two directions                      code; point of equal phases, no
                                                               epipolar geometry
m1         full Gray code, one direction                       code
m2         reduced Gray code                                   code, unique on the segment
m3         fringes of one direction                            the candidate that C2 fits best
m4         fringes of two directions                           the same, with both directions
m5         fringes of one direction, segments of one period    the only candidate
m6         fringes; code and a second direction if there are   the evidence of all pixels together
           any
projector  one camera: full or reduced code, one or two        code, unique on the segment
           directions
=========  ==================================================  ===================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringe3d.decode import has_mirrored_neighbours
from fringe3d.decode.order import order_table
from fringe3d.decode.periods import EXACTLY_ALIKE
from fringe3d.design.gray import BEYOND
from fringe3d.errors import MethodError
from fringe3d.model import (
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    PatternPlan,
    PhaseMap,
    Rig,
    Uniform,
)
from fringe3d.options import MeasureOptions, volume_of
from fringe3d.patterns import extent_px, unambiguous_px
from fringe3d.segments import MOST_TWINS, segments_in_projector, told_apart, too_long

FRINGES_ALONE = ("m3", "m4", "m5")


@dataclass(frozen=True, slots=True)
class Choice:
    """A method, and why it was taken."""

    method: str
    why: str


def choose_method(
    rig: Rig | None, stacks: Sequence[ImageStack], options: MeasureOptions, /
) -> Choice:
    """Return the method that options, rig and images allow; say why if none does.

    The choice is final but for codes and fringes alone, which `settle` tells apart when it is
    known what the code says.

    Raises
    ------
    MethodError
        If the method that was asked for is not possible: what is missing, and what would do.
    """
    if rig is None:
        if options.method != "auto":
            raise MethodError(
                f"--method {options.method}: expected a calibrated rig, found none. Name one with "
                "--rig, or leave --method out to get the phase maps"
            )
        return Choice("phase", "no calibrated rig")
    two_cameras = len(stacks) >= 2 and len(rig.cameras) >= 2
    if options.method != "auto":
        _require(options.method, rig, stacks, two_cameras)
        return Choice(options.method, "asked for")
    if not two_cameras:
        _require("projector", rig, stacks, two_cameras)
        return Choice("projector", "one camera and the calibrated projector")
    plan = stacks[0].plan
    if not plan.fringe_sets or plan.gray_sets:
        return Choice("m1", "two cameras and a code")
    if len({f.period_px for f in plan.fringe_sets}) > 1:
        return _of_several_periods(plan, rig, options, stacks[0].device_name)
    if len(plan.angles) > 1:
        return Choice("m4", "two cameras, no code, fringes of two directions")
    if rig.projector is None:
        return Choice("m5", "two cameras, fringes alone, no calibrated projector")
    return Choice("m6", "two cameras, no code, fringes of one direction")


def _of_several_periods(
    plan: PatternPlan, rig: Rig, options: MeasureOptions, camera_name: str
) -> Choice:
    """Return what to do with several periods and no code.

    They number the periods of the finest one as far as they do not look alike again: enough for a
    segment (M1, which `settle` calls M2 if they do not number all), or M6 must weigh them.
    """
    volume = volume_of(rig, camera_name, options)
    m1 = Choice("m1", "two cameras and fringes of several periods")
    if plan.projector_shape is None or rig.projector is None or volume is None:
        return m1
    for angle in plan.angles:
        periods = [f.period_px for f in plan.fringe_sets if f.angle == angle]
        low, high = extent_px(plan.projector_shape, angle)
        numbered = unambiguous_px(periods, high - low)
        exactly = unambiguous_px(periods, high - low, alike=EXACTLY_ALIKE)
        segments = segments_in_projector(rig, volume, period_px=min(periods), angle=angle)
        too_few = segments.twins(round(numbered / min(periods))) > MOST_TWINS
        if numbered < high - low and (too_few or numbered < exactly):
            listed = ", ".join(f"{period:g}" for period in sorted(periods))
            return Choice("m6", f"fringes of {listed} px look alike again after {numbered:g} px")
    return m1


def _require(method: str, rig: Rig, stacks: Sequence[ImageStack], two_cameras: bool) -> None:
    """Raise MethodError if cameras, projector or images do not suffice for a method."""
    if method == "projector":
        if rig.projector is None:
            raise MethodError(
                "--method projector: expected a calibrated projector in the rig, found none. "
                + ("Use --method m1" if two_cameras else "Add the projector to the rig file, or "
                   "record with a second camera")
            )  # fmt: skip
        return
    if not two_cameras:
        raise MethodError(
            f"--method {method}: expected images and calibration of two cameras, found "
            f"{len(stacks)} camera(s) in the scan and {len(rig.cameras)} in the rig. "
            "Use --method projector"
        )
    plan = stacks[0].plan
    fringe_angles = {f.angle for f in plan.fringe_sets}
    if method in ("m0", "m4") and len(fringe_angles) < 2:
        raise MethodError(
            f"--method {method}: expected fringes of two directions, found {len(fringe_angles)}. "
            "Record the second direction (fringe3d patterns --direction xy), or use --method "
            + ("m1" if plan.gray_sets else "m3")
        )
    if method == "m0" and fringe_angles - {g.angle for g in plan.gray_sets}:
        raise MethodError(
            "--method m0: expected a Gray code in both directions, found "
            f"{len({g.angle for g in plan.gray_sets})}. Use --method m1 or m4"
        )
    has_several_periods = len({f.period_px for f in plan.fringe_sets}) > 1
    if method in ("m1", "m2") and not plan.gray_sets and not has_several_periods:
        raise MethodError(
            f"--method {method}: expected a Gray code, found fringes alone. Use --method "
            + ("m4, or" if len(fringe_angles) > 1 else "m5 or m3, or")
            + " record the code images"
        )
    if method in (*FRINGES_ALONE, "m6") and not plan.fringe_sets:
        raise MethodError(f"--method {method}: expected fringe images, found none. Use --method m1")
    if method in ("m3", "m6") and rig.projector is None:
        raise MethodError(
            f"--method {method}: expected a calibrated projector, in which the candidates are "
            "compared; found none in the rig. Calibrate it (fringe3d calibrate projector, from one "
            "scan with a full code), or use --method "
            + ("m1" if plan.gray_sets else "m4 with a second fringe direction")
        )


def images_of(
    choice: Choice,
    stack: ImageStack,
    rig: Rig | None,
    volume: MeasuringVolume | None,
    options: MeasureOptions,
    /,
) -> ImageStack:
    """Leave out the images that a method does without.

    M3, M4 and M5 use fringes alone, of the finest period; M2 of a full code as many of the
    finest code images as the segments need.
    """
    plan = stack.plan
    if choice.method in FRINGES_ALONE:
        finest = min(f.period_px for f in plan.fringe_sets)
        kept = [
            i
            for i, p in enumerate(plan.patterns)
            if isinstance(p, Fringe) and p.period_px == finest
        ]
        return stack.subset(kept)
    if choice.method != "m2" or options.gray_bits is not None or rig is None:
        return stack
    if rig.projector is None or volume is None:
        return stack  # what the segments need is not known: take what was recorded
    angles = [f.angle for f in plan.fringe_sets if any(g.angle == f.angle for g in plan.gray_sets)]
    bits = {angle: _bits_needed(plan, angle, rig, volume) for angle in angles}
    kept = [
        i
        for i, p in enumerate(plan.patterns)
        if isinstance(p, Fringe | Uniform)
        or (isinstance(p, GrayBit) and p.bit < bits.get(p.angle, p.n_bits))
    ]
    return stack.subset(kept)


def _bits_needed(plan: PatternPlan, angle: float, rig: Rig, volume: MeasuringVolume) -> int:
    """Return how many of the finest code images leave hardly any twins on a segment.

    Surfaces beyond the volume, as the table, are counted: one image more costs little.
    """
    assert rig.projector is not None
    code = next(g for g in plan.gray_sets if g.angle == angle)
    period = min(f.period_px for f in plan.fringe_sets if f.angle == angle)
    extent = extent_px(rig.projector.shape, angle)
    segments = segments_in_projector(rig, volume, period_px=period, angle=angle)
    for bits in range(1, len(code.bits)):
        shorter = plan.subset(
            [i for i, p in enumerate(plan.patterns)
             if isinstance(p, GrayBit) and p.angle == angle and p.bit < bits]
        )  # fmt: skip
        table = order_table(shorter.gray_sets[0], period, extent)
        n = told_apart(table.classes.class_of_order)
        if segments.twins(n, beyond=BEYOND) <= MOST_TWINS / 10:
            return bits
    return len(code.bits)


def settle(
    choice: Choice,
    main: PhaseMap,
    rig: Rig | None,
    volume: MeasuringVolume | None,
    options: MeasureOptions,
    /,
) -> Choice:
    """Tell the methods of two cameras apart, now that it is known what the code tells.

    Raises
    ------
    MethodError
        If the code does not suffice for the method that was asked for, or the segments are too
        long for it.
    """
    if choice.method in ("phase", "projector") or rig is None:
        return choice
    asked = options.method != "auto"
    n_classes, n_orders = len(np.unique(main.class_of_order)), len(main.class_of_order)
    if choice.method == "m0" and not main.is_absolute:
        raise MethodError(f"--method m0: {_expected_full(n_classes, n_orders)}")
    if choice.method in ("m1", "m2"):
        choice = _settle_code(choice, main, asked)
    if main.is_absolute or rig.projector is None or volume is None:
        if choice.method in ("m2", "m3", "m5", "m6") and volume is None:
            raise MethodError(
                f"method {choice.method}: expected a measuring volume, found none in the rig. Give "
                "the depth range of the object (--depth MIN:MAX, mm)"
            )
        return choice
    segments = segments_in_projector(rig, volume, period_px=main.period_px, angle=main.angle)
    twins = segments.twins(told_apart(main.class_of_order))
    if choice.method == "m6" and not asked and twins <= MOST_TWINS / 10:
        return Choice("m5", "no code, and hardly a segment in the projector exceeds a period")
    if has_mirrored_neighbours(main):
        return choice  # where in the period the code is ambiguous differs: C2 decides
    if choice.method == "m2" and not asked and twins > MOST_TWINS:
        return Choice("m6", f"{choice.why}, but up to {segments.needs.max_periods:.1f} lie on a "
                      "segment: too few for M2")  # fmt: skip
    if choice.method in ("m2", "m5") and twins > MOST_TWINS:
        raise MethodError(too_long(choice.method, segments, main))
    return choice


def _settle_code(choice: Choice, main: PhaseMap, asked: bool) -> Choice:
    n_classes, n_orders = len(np.unique(main.class_of_order)), len(main.class_of_order)
    if main.is_absolute:
        if asked and choice.method == "m2":
            raise MethodError(
                "--method m2: expected a reduced Gray code, found a full one. Use --method m1, or "
                "keep fewer bits with --gray-bits"
            )
        return choice if asked else Choice("m1", "the code numbers all periods")
    if asked and choice.method == "m1":
        raise MethodError(f"--method m1: {_expected_full(n_classes, n_orders)}")
    if asked:
        return choice
    return Choice("m2", f"the code tells {n_classes} of {n_orders} periods apart")


def _expected_full(n_classes: int, n_orders: int) -> str:
    return (
        f"expected a full Gray code, found one that tells {n_classes} of {n_orders} periods apart. "
        "Keep more bits, or use --method m2 with the depth range of the object (--depth)"
    )
