"""The source paper's equations, as printed, beside what is exact for a calibrated rig."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.design import paper
from fringe3d.design.counts import SegmentMap
from fringe3d.design.gray import GrayNeeds
from fringe3d.design.reference import Reference, require_volume
from fringe3d.design.uncertainty import image_speed, phase_gradient, view
from fringe3d.geometry import depth_interval, frustum, pixel_grid, rays, triangulation_angle
from fringe3d.model import Device, Rig

Map = NDArray[np.float64]

AZIMUTHS = 8
"""Directions of slope in which the shortest period is looked for."""

GRID = 40
"""Pixels along the longer side of C1 for it: it varies slowly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Equation:
    """One equation of the source paper, beside what is exact.

    Parameters
    ----------
    number : int; 1 to 5
    quantity : str
    unit : str; "px", "rad" or ""
    printed : float; NaN where the equation gives nothing
    exact : float; on C1's principal ray, for fringes square to the epipolar plane and no
        distortion; NaN where there is nothing to say
    counted : float; from the rig, the worst of all pixels; NaN where nothing is counted
    remark : str; why the printed form does not hold, or what it leaves out
    """

    number: int
    quantity: str
    unit: str
    printed: float
    exact: float
    counted: float
    remark: str


def compare(
    rig: Rig,
    reference: Reference,
    /,
    *,
    period_px: float,
    angle: float,
    segments: SegmentMap | None,
    needs: GrayNeeds,
    free_angle: float,
) -> tuple[Equation, ...]:
    """Return equations (1) to (5) for a rig, with a remark where the printed form does not hold.

    Parameters
    ----------
    rig : Rig
    reference : Reference of the rig
    period_px : float, projector px
    angle : float, rad; of the fringes
    segments : SegmentMap or None; in C2
    needs : GrayNeeds; on the projector segments, on C2's where there is no projector
    free_angle : float, rad; see `angle_without_code`

    Returns
    -------
    tuple of Equation
        Those that the rig's devices allow: (1) and (2) need C2, (1) and (5) a projector.
    """
    second = rig.cameras[1] if len(rig.cameras) > 1 else None
    found: list[Equation] = []
    printed = exact = nominal = math.nan
    if rig.projector is not None and second is not None:
        found.append(_first(rig, reference, rig.projector, period_px, angle))
    if segments is not None and second is not None:
        found.append(_second(rig, reference, segments))
        length = found[-1].printed
        if rig.projector is None:
            printed = length / float(np.nanmin(segments.period_px))
            exact = found[-1].exact / float(np.nanmin(segments.period_px))
        else:
            printed = paper.periods_printed(length, found[0].printed)
            focal_p, focal_c2 = _focal(rig.projector), _focal(second)
            nominal = length / paper.nominal_period(period_px, focal_p, focal_c2)
    if rig.projector is not None:
        exact = _periods_exact(rig, reference, rig.projector, period_px)
    found.append(_third(printed, exact, needs, nominal))
    found.append(_fourth(printed, exact, needs))
    if rig.projector is not None:
        found.append(_fifth(reference, rig.projector, period_px, free_angle))
    return tuple(found)


def _focal(device: Device) -> float:
    return float(device.focal_px.mean())


def _distance(device: Device, reference: Reference) -> float:
    return float(np.linalg.norm(device.center_world - reference.point_mm))


def _first(
    rig: Rig, reference: Reference, projector: Device, period_px: float, angle: float
) -> Equation:
    second = rig.cameras[1]
    tau = triangulation_angle(second, projector, reference.point_mm)
    focal_p, focal_c2 = _focal(projector), _focal(second)
    printed = paper.shortest_period_printed(period_px, focal_p, focal_c2, tau, reference.depths)
    exact = paper.shortest_period_exact(
        period_px, focal_p, focal_c2, tau, _distance(projector, reference),
        _distance(second, reference),
    )  # fmt: skip
    slope = f"{math.degrees(paper.MAX_SLOPE):g} deg"
    if printed <= 0:
        times = printed / paper.nominal_period(period_px, focal_p, focal_c2)
        remark = (
            f"does not hold: {times:.1f} times the nominal period. It lets the depth jump through "
            "the whole range within one period, so it is positive only where that moves the light "
            f"by less than a period; exact is the shortest on surfaces that slope up to {slope}"
        )
    else:
        remark = (
            "holds, but lets the depth jump through the whole range within one period; exact is "
            f"the shortest on surfaces that slope up to {slope}"
        )
    counted = shortest_period(rig, period_px=period_px, angle=angle, max_slope=paper.MAX_SLOPE)
    return Equation(
        number=1, quantity="shortest period in C2", unit="px", printed=printed, exact=exact,
        counted=counted, remark=remark,
    )  # fmt: skip


def shortest_period(
    rig: Rig, /, *, period_px: float, angle: float = 0.0, max_slope: float
) -> float:
    """Return the shortest period along its segments that C2 sees on smooth surfaces.

    Surfaces slope up to `max_slope` (rad) against C2's viewing direction, in `AZIMUTHS`
    directions; where C1 or the projector would see them flatter than 3 degrees, they do not
    count. Places are the middles of the segments of a grid of C1's pixels.

    Returns
    -------
    float, px of C2: ``2 pi |d pi_2 / dt| / |f'|``, see `point_sigma`; NaN if no place counts
    """
    camera, second, projector = rig.cameras[0], rig.cameras[1], rig.projector
    assert projector is not None
    step = max(1, max(camera.shape) // GRID)
    volume = require_volume(rig).intersection(frustum(second)).intersection(frustum(projector))
    origin, directions = rays(camera, pixel_grid(camera.shape)[::step, ::step].reshape(-1, 2))
    near, far = depth_interval(origin, directions, volume)
    there = (near < far) & np.isfinite(far)
    points = origin + ((near + far)[there] / 2)[:, None] * directions[there]
    gradient = phase_gradient(projector, points, period_px=period_px, angle=angle)
    speed = image_speed(second, points, directions[there])
    least = math.inf
    for normals in _sloping(second.center_world - points, max_slope):
        d1, cosine1 = view(camera, points, normals)
        d2, cosine2 = view(second, points, normals)
        _, lit = view(projector, points, normals)
        rate = (gradient * (d1 - d2 * (cosine1 / cosine2)[..., None])).sum(-1)
        with np.errstate(divide="ignore"):
            periods = np.where(np.isfinite(lit), 2 * np.pi * speed / np.abs(rate), np.nan)
        if np.isfinite(periods).any():
            least = min(least, float(np.nanmin(periods)))
    return least if math.isfinite(least) else math.nan


def _sloping(toward: Map, max_slope: float) -> list[Map]:
    """Return unit normals (n, 3) towards a device, and tilted against that in all directions."""
    axis = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    other = np.cross(axis, across)
    turns = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    tilted = [np.cos(turn) * across + np.sin(turn) * other for turn in turns]
    return [axis, *(math.cos(max_slope) * axis + math.sin(max_slope) * side for side in tilted)]


def _second(rig: Rig, reference: Reference, segments: SegmentMap) -> Equation:
    second = rig.cameras[1]
    tau = triangulation_angle(rig.cameras[0], second, reference.point_mm)
    printed = paper.segment_length_printed(_focal(second), tau, reference.depths)
    exact = paper.segment_length_exact(
        _focal(second), tau, reference.depths, _distance(second, reference)
    )
    return Equation(
        number=2, quantity="length of the segment in C2", unit="px", printed=printed, exact=exact,
        counted=float(np.nanmax(segments.length_px)),
        remark=(
            f"holds for parallel axes; {100 * (printed / exact - 1):.1f} % too long at "
            f"{math.degrees(tau):.1f} deg"
        ),
    )  # fmt: skip


def _periods_exact(rig: Rig, reference: Reference, projector: Device, period_px: float) -> float:
    tau = triangulation_angle(rig.cameras[0], projector, reference.point_mm)
    length = paper.segment_length_exact(
        _focal(projector), tau, reference.depths, _distance(projector, reference)
    )
    return length / period_px


def _third(printed: float, exact: float, needs: GrayNeeds, nominal: float) -> Equation:
    if math.isfinite(nominal) and math.isnan(printed):
        remark = (
            f"undefined where (1) is not positive (the nominal period would give {nominal:.1f}); "
            "exact are the periods on the projector segment"
        )
    elif math.isfinite(nominal):
        remark = "counts along C2's segment; exact are the periods on the projector segment"
    elif math.isnan(printed):
        remark = "needs a second camera; exact are the periods on the projector segment"
    else:
        remark = "with the period given for C2"
    return Equation(
        number=3, quantity="periods on a segment", unit="", printed=printed, exact=exact,
        counted=needs.max_periods, remark=remark,
    )  # fmt: skip


def _fourth(m: float, exact: float, needs: GrayNeeds) -> Equation:
    printed = math.nan if math.isnan(m) else float(paper.gray_bits_printed(m))
    by_count = paper.gray_bits_printed(needs.max_periods)
    bits = "1 bit" if by_count == 1 else f"{by_count} bits"
    remark = (
        f"no guard band, and m periods hold up to floor(m) + 1 orders: here {needs.max_orders}. "
        f"Of the counted m = {needs.max_periods:.2f} it makes {bits}"
    )
    if needs.bits < needs.exact_bits:
        share = 100 * needs.twins[needs.bits]
        remark += (
            f"; {needs.bits or 'none'} will do, for only {share:.1f} % of the points then have a "
            "twin on their segment, near its ends"
        )
    return Equation(
        number=4, quantity="bits of a cyclic Gray code", unit="", printed=printed,
        exact=float(max(0, math.ceil(math.log2(math.floor(exact) + 1)))),
        counted=float(needs.exact_bits), remark=remark,
    )  # fmt: skip


def _fifth(
    reference: Reference, projector: Device, period_px: float, free_angle: float
) -> Equation:
    focal = _focal(projector)
    return Equation(
        number=5, quantity="angle C1-projector for one period", unit="rad",
        printed=paper.angle_for_one_period_printed(period_px, focal, reference.depths),
        exact=paper.angle_for_one_period_exact(
            period_px, focal, reference.depths, _distance(projector, reference)
        ),
        counted=free_angle,
        remark=(
            "holds for C1's principal ray and fringes square to the epipolar plane; all pixels and "
            "a guard for noise and calibration leave less"
        ),
    )  # fmt: skip
