"""What the user wants of a measurement, and which images it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from fringe3d.errors import MethodError
from fringe3d.model import (
    Device,
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    PatternPlan,
    Rig,
    Uniform,
)

Method = Literal["auto", "m0", "m1", "m2", "m3", "m4", "m5", "m6", "projector"]
Direction = Literal["auto", "x", "y"]
Filter = Literal["none", "light", "medium", "strong"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureOptions:
    """How to measure. The defaults use all images and take the best method.

    Parameters
    ----------
    method : "auto" (the best that plan and rig allow), one of "m0" to "m6" (two cameras, see
        `fringe3d.methods`) or "projector" (one camera and the calibrated projector)
    direction : "auto", "x" or "y"; keep only the fringes and code of this direction. "auto" keeps
        all: one camera and the projector use two directions, two cameras that one whose fringes
        cross the epipolar lines best
    n_shifts : int or None; keep that many of the phase steps of every set
    gray_bits : int or None; keep the finest images of every Gray code; 0 for none
    light_dark : bool; False leaves out light and dark images: the mean of the fringes is the
        threshold of the code
    depth_mm : (min, max) or None, mm; depth range along the principal ray of C1, besides the
        rig's volume
    strict : bool; metrology: only orders that are certain
    drop_edges : bool; no points within two pixels of a depth edge, where light of two surfaces
        mixes
    min_modulation_dn : float or None, DN
    min_order_probability : float or None, 0 to 1; fringe orders that are less probable are
        AMBIGUOUS; 0 takes the best that fits. None is 0.9, and 0.99 if strict
    filter : "none", "light", "medium" or "strong"; less noise of the phases, see
        `fringe3d.decode.filtering`
    blur_px : float or None, px; standard deviation of the lens blur of the cameras, of which the
        phases are corrected, see `fringe3d.decode.footprint`; None leaves them as they are
    best_estimate : bool; where two cameras see the points and the projector is calibrated, its
        phases place them, too, see `fringe3d.combining`
    outliers : "none", "light", "medium" or "strong"; reject points off the surface of their
        neighbours by more than their sigma explains, see `fringe3d.triangulate.remove_outliers`
    reflections : "none", "light", "medium" or "strong"; reject points on which cameras and
        projector disagree, see `fringe3d.reflections`
    own_response : bool; take out of the phases what a nonlinear response (gamma) does to them, as
        these images show it; else that of the stacks
    """

    method: Method = "auto"
    direction: Direction = "auto"
    n_shifts: int | None = None
    gray_bits: int | None = None
    light_dark: bool = True
    depth_mm: tuple[float, float] | None = None
    strict: bool = False
    drop_edges: bool = False
    min_modulation_dn: float | None = None
    min_order_probability: float | None = None
    filter: Filter = "none"
    blur_px: float | None = 0.4
    best_estimate: bool = False
    outliers: Filter = "none"
    reflections: Filter = "none"
    own_response: bool = False


def keep_images(stack: ImageStack, options: MeasureOptions, /) -> ImageStack:
    """Leave out the phase steps and Gray-code images that the options do not want."""
    kept = set(range(stack.plan.n_images)) - _other_directions(stack.plan, options.direction)
    if options.n_shifts is not None:
        for fringe_set in stack.plan.fringe_sets:
            kept -= set(fringe_set.indices) - set(_steps(fringe_set.indices, options.n_shifts))
    if options.gray_bits is not None:
        _require_bits(stack, options.gray_bits)
        for code in stack.plan.gray_sets:
            for bit, *places in zip(code.bits, code.indices, code.inverses, strict=True):
                if bit >= options.gray_bits:
                    kept -= set(places)
    if not options.light_dark:
        kept -= {i for i, p in enumerate(stack.plan.patterns) if isinstance(p, Uniform)}
    return stack.subset(sorted(kept))


def _other_directions(plan: PatternPlan, direction: Direction) -> set[int]:
    """Return the places of the images whose stripes run the other way."""
    if direction == "auto":
        return set()
    wanted = {angle for angle in plan.angles if axis_of(angle) == direction}
    if not wanted:
        raise MethodError(
            f"--direction {direction}: expected one of the recorded directions "
            f"{sorted({axis_of(angle) for angle in plan.angles})}, found none such in the plan"
        )
    return {
        index
        for index, pattern in enumerate(plan.patterns)
        if isinstance(pattern, Fringe | GrayBit) and pattern.angle not in wanted
    }


def axis_of(angle: float, /) -> Direction:
    """Return the direction, x or y, that a fringe angle (rad) is closer to."""
    return "x" if abs(np.cos(angle)) >= abs(np.sin(angle)) else "y"


def _require_bits(stack: ImageStack, gray_bits: int) -> None:
    recorded = max((len(code.bits) for code in stack.plan.gray_sets), default=0)
    if not 0 <= gray_bits <= recorded:
        raise MethodError(
            f"--gray-bits: expected 0 to {recorded} of the {recorded} recorded code images, found "
            f"{gray_bits}"
        )


def _steps(indices: Sequence[int], n_shifts: int) -> list[int]:
    if not 3 <= n_shifts <= len(indices):
        wanted = "3" if len(indices) == 3 else f"3 to {len(indices)}"
        raise MethodError(
            f"--shifts: expected {wanted} of the {len(indices)} recorded phase steps, found "
            f"{n_shifts}"
        )
    return [indices[round(i * len(indices) / n_shifts)] for i in range(n_shifts)]


def volume_of(
    rig: Rig | None, camera_name: str, options: MeasureOptions, /
) -> MeasuringVolume | None:
    """Return the rig's volume, cut to the depth range that the options give for a camera."""
    if rig is None or options.depth_mm is None:
        return None if rig is None else rig.volume
    camera = next(c for c in rig.cameras if c.name == camera_name)
    return _cut(rig.volume, camera, options.depth_mm)


@lru_cache(maxsize=8)
def _cut(
    volume: MeasuringVolume | None, camera: Device, depth_mm: tuple[float, float]
) -> MeasuringVolume:
    """Return the same volume for the same rig: what is prepared for it can be used again."""
    try:
        slab = MeasuringVolume.depth_slab(
            camera, depth_min_mm=depth_mm[0], depth_max_mm=depth_mm[1]
        )
    except ValueError as problem:
        raise MethodError(f"--depth: {problem}") from None
    return slab if volume is None else volume.intersection(slab)
