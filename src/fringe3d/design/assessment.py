"""Everything that the design of a rig tells: which images it needs, and how well it measures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.design.counts import (
    SegmentMap,
    angle_without_code,
    periods_in_camera,
    periods_on_projector,
    spread_pixels,
)
from fringe3d.design.equations import Equation, compare
from fringe3d.design.gray import BEYOND, GrayNeeds, gray_needs, guard_periods
from fringe3d.design.margin import AmbiguityMap, ambiguity_margins
from fringe3d.design.reference import Reference, partner_of, reference_of
from fringe3d.design.residual import Quality
from fringe3d.design.uncertainty import (
    UncertaintyMap,
    fringe_crossing,
    phase_noise,
    predict_uncertainty,
)
from fringe3d.geometry import triangulation_angle
from fringe3d.model import Rig
from fringe3d.model.html import table

MAX_PIXELS = 400_000
"""Larger cameras are counted on a grid: maps are smooth, and nobody waits."""

COARSE_PIXELS, MARGIN_PIXELS = 15_000, 1000
"""Of those that see the volume: for what varies slowly, or is counted many times."""

SLOPES_DEG = (0.0, 10.0, 20.0)

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorPlace:
    """How the projector stands to C1, and its fringes to the epipolar lines.

    Parameters
    ----------
    free_angle : float, rad; largest angle C1-P at which no code is needed, all pixels and the
        guard counted; see `angle_without_code`
    crossing : float, rad; between fringes and epipolar lines, see `fringe_crossing`
    square_angle : float, rad; the fringe angle at which they cross squarely
    """

    free_angle: float
    crossing: float
    square_angle: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """What a rig can do with its fringes.

    Parameters
    ----------
    rig : Rig with a volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    camera_period_px : float or None, px of C2, where the user gave it
    quality : Quality; of images and calibration
    guard : float, periods; see `guard_periods`
    beyond : float or None; part of a segment beyond each end of the volume in which surfaces are
        seen, too, where the user gave it
    step : int; the maps of periods hold every step-th row and column of C1, and the last ones
    reference : Reference
    angle_c1c2, angle_c1p, angle_c2p : float, rad; NaN where a device is missing
    equations : tuple of Equation
    projector_periods : (row, col) float or None
    projector_needs : GrayNeeds or None; code for a search along the projector segment
    segments : SegmentMap or None; in C2
    camera_needs : GrayNeeds or None; code for a search along C2's segment, without the projector
    place : ProjectorPlace or None
    uncertainty : UncertaintyMap
    margins : AmbiguityMap or None; needs two cameras and a projector
    """

    rig: Rig
    period_px: float
    angle: float
    camera_period_px: float | None
    quality: Quality
    guard: float
    beyond: float | None
    step: int
    reference: Reference
    angle_c1c2: float
    angle_c1p: float
    angle_c2p: float
    equations: tuple[Equation, ...]
    projector_periods: Map | None
    projector_needs: GrayNeeds | None
    segments: SegmentMap | None
    camera_needs: GrayNeeds | None
    place: ProjectorPlace | None
    uncertainty: UncertaintyMap
    margins: AmbiguityMap | None

    @property
    def needs(self) -> GrayNeeds:
        """Return the code for the search that the rig's calibration allows."""
        needs = self.projector_needs or self.camera_needs
        assert needs is not None  # C1 has a partner
        return needs

    @property
    def beyond_part(self) -> float:
        """Return the part beyond the volume that `GrayNeeds.twins_beyond` is counted with."""
        return BEYOND if self.beyond is None else self.beyond

    @property
    def bits(self) -> int:
        """Return the bits to take: surfaces beyond the volume count if the user spoke of them."""
        return self.needs.bits if self.beyond is None else self.needs.bits_beyond

    def _repr_html_(self) -> str:
        angles = {"C1 to C2": self.angle_c1c2, "C1 to projector": self.angle_c1p}
        rows = [(name, f"{np.degrees(a):.1f} deg") for name, a in angles.items() if np.isfinite(a)]
        rows += [
            ("period", f"{self.period_px:g} projector px at {np.degrees(self.angle):g} deg"),
            ("code", f"{self.bits} cyclic images" if self.bits else "none needed"),
        ]
        return table("design of a rig", rows)


def _silent(_stage: str) -> None:
    """Tell nobody."""


def assess(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
    quality: Quality | None = None,
    camera_period_px: float | None = None,
    beyond: float | None = None,
    stage: Callable[[str], None] = _silent,
) -> Assessment:
    """Count periods, code, uncertainty and ambiguity margin of a rig.

    Parameters
    ----------
    rig : Rig with a volume, and a second device beside C1
    period_px, angle : float, projector px and rad; of the fringes
    quality : Quality or None (1 % noise, four images, 0.1 px)
    camera_period_px : float or None, px; the period that C2 sees: needed where the rig has two
        cameras and no projector
    beyond : float or None; part of a segment beyond each end of the volume in which surfaces are
        seen, too. If None, `gray.BEYOND` for `GrayNeeds.twins_beyond`, and none for the margins
    stage : called with the name of each stage

    Raises
    ------
    RigError
        If something is missing, or if the devices do not see the volume together.
    """
    quality = quality or Quality()
    reference = reference_of(rig)
    partner_of(rig)  # or it says what is missing
    fringes = _Fringes(period_px, angle, camera_period_px)
    step = max(1, math.ceil(math.sqrt(math.prod(rig.cameras[0].shape) / MAX_PIXELS)))
    sigma = phase_noise(quality.n_shifts, quality.noise)
    guard = guard_periods(sigma, quality.calibration_px, period_px)
    stage("periods per segment")
    on_projector, segments = _periods(rig, fringes, step)
    needs = [_needs(on_projector, guard, beyond),
             _needs(segments.periods if segments else None, guard, beyond)]  # fmt: skip
    coarse, coarser = _coarse_steps(on_projector, segments, step)
    stage("angle without code")
    place = _place(rig, reference, fringes, guard, beyond or 0.0, coarse)
    stage("uncertainty")
    uncertainty = predict_uncertainty(rig, period_px=fringes.period_seen(rig), angle=angle,
                                      sigma_phase=sigma, step=coarse)  # fmt: skip
    stage("ambiguity margin")
    margins = _margins(rig, fringes, quality, guard, beyond or 0.0, coarser)
    angles, counted = _angles(rig, reference), needs[0] or needs[1]
    assert counted is not None  # C1 has a partner
    return Assessment(
        rig=rig, period_px=period_px, angle=angle, camera_period_px=camera_period_px,
        quality=quality, guard=guard, beyond=beyond, step=step, reference=reference,
        angle_c1c2=angles[0], angle_c1p=angles[1], angle_c2p=angles[2],
        equations=compare(rig, reference, period_px=period_px, angle=angle, segments=segments,
                          needs=counted, free_angle=place.free_angle if place else math.nan),
        projector_periods=on_projector, projector_needs=needs[0], segments=segments,
        camera_needs=needs[1], place=place, uncertainty=uncertainty, margins=margins,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Fringes:
    """What is projected, or what C2 sees of it; see `assess`."""

    period_px: float
    angle: float
    camera_period_px: float | None

    def period_seen(self, rig: Rig) -> float:
        """Return the period of the projector, of C2 where there is none."""
        if rig.projector is not None:
            return self.period_px
        assert self.camera_period_px is not None  # else `periods_in_camera` has refused
        return self.camera_period_px


def _periods(rig: Rig, fringes: _Fringes, step: int) -> tuple[Map | None, SegmentMap | None]:
    """Return the periods on the segments of the projector and of C2, where there are any."""
    on_projector = segments = None
    if rig.projector is not None:
        on_projector = periods_on_projector(
            rig, period_px=fringes.period_px, angle=fringes.angle, step=step, edges=True
        )
    if len(rig.cameras) > 1:
        segments = periods_in_camera(
            rig,
            period_px=fringes.period_px,
            angle=fringes.angle,
            camera_period_px=fringes.camera_period_px,
            step=step,
            edges=True,
        )
    return on_projector, segments


def _needs(periods: Map | None, guard: float, beyond: float | None) -> GrayNeeds | None:
    if periods is None:
        return None
    return gray_needs(periods, guard=guard, beyond=BEYOND if beyond is None else beyond)


def _coarse_steps(
    on_projector: Map | None, segments: SegmentMap | None, step: int
) -> tuple[int, int]:
    """Return the steps of coarser grids, by the number of pixels that see the volume."""
    counted = on_projector if on_projector is not None else segments.periods if segments else None
    assert counted is not None  # C1 has a partner
    seen = int(np.isfinite(counted).sum())
    coarse, coarser = (
        step * max(1, int(math.sqrt(seen / n))) for n in (COARSE_PIXELS, MARGIN_PIXELS)
    )
    return coarse, coarser


def _margins(
    rig: Rig, fringes: _Fringes, quality: Quality, guard: float, beyond: float, step: int
) -> AmbiguityMap | None:
    """Return the ambiguity margins; None without a second camera or a projector."""
    if rig.projector is None or len(rig.cameras) < 2:
        return None
    return ambiguity_margins(
        rig, period_px=fringes.period_px, angle=fringes.angle, slopes_deg=SLOPES_DEG,
        quality=quality, pixels=spread_pixels(rig.cameras[0].shape, step), beyond=beyond,
        guard=2 * guard,
    )  # fmt: skip


def _place(
    rig: Rig, reference: Reference, fringes: _Fringes, guard: float, beyond: float, step: int
) -> ProjectorPlace | None:
    if rig.projector is None:
        return None
    period, angle = fringes.period_px, fringes.angle
    crossing, square = fringe_crossing(rig, reference.point_mm, period_px=period, angle=angle)
    return ProjectorPlace(
        free_angle=angle_without_code(
            rig, period_px=period, angle=angle, guard=guard, step=step, beyond=beyond
        ),
        crossing=crossing,
        square_angle=square,
    )


def _angles(rig: Rig, reference: Reference) -> tuple[float, float, float]:
    """Return the triangulation angles C1-C2, C1-P and C2-P, rad; NaN where a device is missing."""
    c1, *others = rig.cameras
    c2 = others[0] if others else None
    pairs = ((c1, c2), (c1, rig.projector), (c2, rig.projector))
    first, second, third = (
        math.nan if a is None or b is None else triangulation_angle(a, b, reference.point_mm)
        for a, b in pairs
    )
    return first, second, third
