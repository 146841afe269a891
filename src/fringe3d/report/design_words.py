"""What the design of a rig recommends and finds, one sentence each."""

from __future__ import annotations

import math

from fringe3d.design import AmbiguityMap, Assessment
from fringe3d.design.margin import NEEDED_RATIO

FLAT = math.radians(25.0)
"""Fringes that cross the epipolar lines at less are said to follow them."""

M6_DOES = (
    "M6, which decides by all pixels together, does with the same images where the calibration's "
    "bias is stored in the rig (fringe3d calibrate bias); what it cannot tell it leaves open."
)


def recommendation(a: Assessment, /) -> list[str]:
    """Return how many images the rig needs, and which."""
    said = [_needed(a), *_beyond(a)]
    if a.margins is not None and a.projector_needs is not None and a.projector_needs.bits:
        said.append(_fringes_alone(a.margins, a.quality.n_shifts))
    if a.place is not None and a.place.crossing < FLAT:
        said.insert(
            0,
            f"The fringes nearly follow the epipolar lines ({math.degrees(a.place.crossing):.0f} "
            "deg between them): points get uncertain. Turn them to "
            f"{math.degrees(a.place.square_angle):.0f} deg (--angle).",
        )
    return said


def findings(a: Assessment, /) -> list[str]:
    """Return what else follows from the figures."""
    found = []
    if a.projector_needs is not None and a.camera_needs is not None:
        saved = over_determined(a.camera_needs.bits) - over_determined(a.projector_needs.bits)
        if saved > 0:
            found.append(
                f"The projector's calibration saves {_count(saved, 'image')}: without it "
                f"{a.camera_needs.max_periods:.1f} periods of C2's segment come into question "
                f"instead of {a.projector_needs.max_periods:.1f}."
            )
    if a.place is not None and math.isfinite(a.place.free_angle):
        found.append(
            f"No code is needed up to {math.degrees(a.place.free_angle):.2f} deg between C1 and "
            f"projector (now {math.degrees(a.angle_c1p):.1f}): then every pixel's segment, and a "
            "guard for noise and calibration, stay below one period."
        )
    u = a.uncertainty
    found.append(
        f"Sigma of the points, surfaces that face the rig: median {1000 * u.median_mm:.1f} um, "
        f"5 to 95 % {1000 * u.low_mm:.1f} to {1000 * u.high_mm:.1f} um ({a.quality.n_shifts} "
        f"steps, noise {100 * a.quality.noise:g} % of the modulation)."
    )
    return found


def percent(share: float, /) -> str:
    """Say a share in per cent; a small one is not called none."""
    return "0 %" if share == 0 else "below 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def over_determined(bits: int, /) -> int:
    """Return the images of a code with cells of half a period."""
    return bits + 1 if bits else 0


def n_images(a: Assessment, bits: int, /) -> int:
    """Return the images with an over-determined code of so many bits."""
    return a.quality.n_shifts + over_determined(bits)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _needed(a: Assessment) -> str:
    bits, needs = a.bits, a.needs
    total = f"{_count(n_images(a, bits), 'image')}: {a.quality.n_shifts} phase steps"
    if bits == 0:
        why = "every segment is shorter than a period"
        if needs.exact_bits:
            why = (
                f"the longest segment holds {needs.max_periods:.2f} periods, and only "
                f"{percent(needs.twins[0])} of the points have a twin"
            )
        return f"{total} and no Gray code, for {why} (M5)."
    twins = ""
    left = needs.twins[bits] if a.beyond is None else needs.twins_beyond[bits]
    if left > 0 and a.beyond is None:
        exact = _count(needs.exact_bits, "bit")
        twins = f"; {percent(left)} of the points have a twin, {exact} leave none"
    return (
        f"{total} and a reduced Gray code of {_count(bits, 'bit')} ({over_determined(bits)} "
        f"images, over-determined){twins}."
    )


def _beyond(a: Assessment) -> list[str]:
    """Say what surfaces beyond the volume, as a table, ask for."""
    bits, part = a.needs.bits_beyond, f"{100 * a.beyond_part:g} % of a segment"
    if a.beyond:
        return [f"Surfaces up to {part} beyond the volume, such as a table, are counted in."]
    if bits <= a.bits:
        return []
    return [
        f"Where a table or a wall is seen up to {part} beyond the volume, take "
        f"{_count(bits, 'bit')}: {n_images(a, bits)} images."
    ]


def _fringes_alone(margins: AmbiguityMap, steps: int) -> str:
    enough = margins.worst_ratio >= NEEDED_RATIO
    if not enough[0]:
        return (
            f"Fringes alone ({steps} images) do not suffice pixel by pixel: C2 cannot tell some "
            f"wrong order even on surfaces that face the rig. See --optimise. {M6_DOES}"
        )
    # Surfaces up to a steeper slope include those up to a flatter one.
    slope = math.degrees(float(margins.slopes[enough][-1]))
    text = (
        f"Fringes alone suffice ({steps} images, M3) on surfaces that slope up to {slope:.0f} deg"
    )
    return f"{text}." if enough.all() else f"{text}, not on steeper ones. See --optimise. {M6_DOES}"


def patterns_command(a: Assessment, /) -> str:
    """Return the command that makes the images; empty where the projector is not known."""
    if a.rig.projector is None:
        return ""
    rows, cols = a.rig.projector.shape
    turn = math.degrees(a.angle)
    options = f"--size {cols}x{rows} --period {a.period_px:g} --steps {a.quality.n_shifts}"
    if turn:
        options += f" --angle {turn:.3g}"
    across = abs(math.cos(a.angle)) * cols + abs(math.sin(a.angle)) * rows
    if a.bits == 0:
        options += " --gray none"
    elif 2**a.bits < across / a.period_px:  # more number all periods: the default
        options += f" --gray-bits {a.bits}"
    return f"fringe3d patterns {options} --out patterns"
