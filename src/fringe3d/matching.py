"""Which search finds the correspondences: what the code, the cameras and the projector allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import (
    FIT_SIGMA,
    Located,
    Task,
    TwoViews,
    Witnesses,
    choose_orders,
    coarse_stride,
    confirm_orders,
    doubt_at_borders,
    fringe_crossing,
    lit_before,
    locate,
    match_both_directions,
    match_cameras,
    match_near_sheets,
    match_projector,
    orders_of_before,
    place_lost,
    quiet,
    seen_before,
    with_true_sigma,
)
from fringe3d.decode import CameraPhases, has_mirrored_neighbours
from fringe3d.design.gray import BEYOND
from fringe3d.errors import MethodError
from fringe3d.geometry import project
from fringe3d.geometry.meeting import Met
from fringe3d.health import Finding, check_trinocular, check_twins
from fringe3d.kernels import alongside
from fringe3d.model import (
    NO_ORDER,
    CalibrationBias,
    Correspondences,
    Device,
    MeasuringVolume,
    PhaseMap,
)
from fringe3d.options import MeasureOptions
from fringe3d.patterns import across
from fringe3d.segments import (
    MOST_TWINS,
    code_in_words,
    segments_in_camera,
    told_apart,
    too_long,
)
from fringe3d.triangulate import triangulate

MIN_CROSSING_SINE = 0.05
"""3 degrees between fringes and epipolar lines; sigma is twenty times that of a square crossing."""

TURN = 2 * np.pi

SAMPLE_STEP_PX, SAMPLE_ROWS = 8, 40

MAX_TRINOCULAR_PX = 3.0
"""A projector that is further off judges nothing; the search window is half a period."""

MIN_PROBABILITY, STRICT_PROBABILITY = 0.9, 0.99
"""A fringe order that is less probable is AMBIGUOUS."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """Correspondences, and what was learnt on the way.

    Parameters
    ----------
    matches : Correspondences
    bias : CalibrationBias or None; with which the orders were chosen, stored or learnt
    rival_shift : int; periods between the orders taken and those of the best other solution that
        the images leave possible; 0 where there is none
    findings : tuple of Finding; what the search itself gave reason to say
    located : Located or None; points that were found on the way
    """

    matches: Correspondences
    bias: CalibrationBias | None = None
    rival_shift: int = 0
    findings: tuple[Finding, ...] = ()
    located: Located | None = None

    @property
    def known(self) -> tuple[Met, NDArray[np.bool_]] | None:
        """Return the points that are known, and the pixels that are left."""
        return None if self.located is None else (self.located.met, self.located.todo)


def best_direction_first(
    phases: tuple[CameraPhases, ...], camera: Device, other: Device, /
) -> tuple[CameraPhases, ...]:
    """Put the direction first whose phase changes fastest along the epipolar curves of C2."""
    crossings = [
        fringe_crossing(direction.main, camera, other) for direction in phases[1].directions
    ]
    best = max(range(len(crossings)), key=lambda i: np.nan_to_num(crossings[i][0]))
    if crossings[best][1] < MIN_CROSSING_SINE:
        raise MethodError(
            f"two cameras: the fringes run along the epipolar lines of '{other.name}' (angle "
            f"{np.degrees(np.arcsin(crossings[best][1])):.1f} degrees) and do not mark points on "
            "them. Project fringes of the other direction"
        )
    return tuple(
        replace(camera_phases, directions=(
            camera_phases.directions[best],
            *(d for i, d in enumerate(camera_phases.directions) if i != best),
        ))
        for camera_phases in phases
    )  # fmt: skip


def followed(
    phases: Sequence[CameraPhases], before: Sequence[CameraPhases], /
) -> tuple[CameraPhases, ...]:
    """Give two cameras the fringe orders that go on from those of the frame before.

    Pixels without a point go on, too: they were of no use then, and may be now; without them each
    frame would lose a little more along the edges.
    """
    return _ordered(phases, [p.directions[0].main.absolute_phase / TURN for p in before[:2]])


def followed_from_points(
    phases: Sequence[CameraPhases], other: Device, projector: Device, points_mm: NDArray[np.float64]
) -> tuple[CameraPhases, ...]:
    """Give two cameras the fringe orders that go on from points (row, col, 3), mm, of C1."""
    lit = lit_before(phases[0].directions[0].main, projector, points_mm)
    return _ordered(phases, [lit, seen_before(lit, points_mm, other)])


def _ordered(
    phases: Sequence[CameraPhases], turns: Sequence[NDArray[np.float64]]
) -> tuple[CameraPhases, ...]:
    """Return the phases with the orders that are nearest to absolute phases of before, turns."""
    main = phases[0].directions[0].main
    firsts = [own.directions[0].like(main) for own in phases[:2]]
    second = alongside(orders_of_before, firsts[1], turns[1])
    orders = [orders_of_before(firsts[0], turns[0]), second()]
    found = []
    for own, known in zip(phases, orders, strict=False):
        first, *more = own.directions
        found.append(replace(own, directions=(replace(first, main=known), *more)))
    return tuple(found)


def match(
    phases: Sequence[CameraPhases],
    camera: Device,
    other: Device,
    projector: Device | None,
    volume: MeasuringVolume | None,
    /,
    *,
    method: str,
    options: MeasureOptions,
    bias: CalibrationBias | None = None,
    cameras: Sequence[Device] = (),
    previous_mm: NDArray[np.float64] | None = None,
    is_carried: bool = False,
) -> Matched:
    """Find the correspondences of C1 with the second camera, or with the projector.

    Parameters
    ----------
    phases : CameraPhases of each camera; the best direction first
    camera, other : Device; C1, and the second camera or the projector
    projector : Device or None; where it is calibrated it helps two cameras, too
    volume : MeasuringVolume or None
    method : str; as settled, see `fringe3d.methods`
    options : MeasureOptions; how strict
    bias : CalibrationBias or None; of the rig, where it is known
    cameras : Device of further cameras, whose phases follow those of `camera` and `other`; M6 asks
        them, too
    previous_mm : (row, col, 3) float or None; points of the frame before, for M6
    is_carried : bool; the orders go on from a frame before, in which all was asked

    Returns
    -------
    Matched

    Raises
    ------
    MethodError
        If the code does not tell neighbouring periods apart, and nothing else does; or if it tells
        too few apart for the segments in C2, which are searched where there is no projector.
    """
    if other.role == "projector":
        maps = [direction.main for direction in phases[0].directions[:2]]
        return Matched(match_projector(maps, camera, other, volume))
    views = two_views(phases, camera, other)
    if method == "m0":
        assert views.second1 is not None
        assert views.second2 is not None
        first, second = (views.phases1, views.second1), (views.phases2, views.second2)
        return Matched(match_both_directions(first, second, camera, other))
    if method not in ("m4", "m6"):
        views = replace(views, second1=None, second2=None)
    if method != "m6":
        views = replace(views, periods1=(), periods2=())
    if (
        projector is not None
        and volume is not None
        and (is_carried or _may_judge(views, projector, volume))
    ):
        witnesses = None
        if method == "m6":
            seen = [p.directions[0].like(views.phases1) for p in phases[2:]]
            turns = _turns_of(previous_mm, projector, views.phases1)
            witnesses = Witnesses(
                cameras=tuple(zip(cameras, seen, strict=True)), previous_turns=turns
            )
        return _match_three(views, projector, volume, method, options, bias, witnesses)
    if has_mirrored_neighbours(views.phases1):
        raise MethodError(
            "--gray-bits: the finest images of a plain code repeat mirrored and do not tell all "
            "neighbouring periods apart; a calibrated projector and the depth range would tell "
            "where. Keep all, or record an over-determined code (cells of half a period) or a "
            "cyclic one"
        )
    findings = _require_short_segments(views, volume, method)
    matches = match_cameras(
        views.phases1, views.phases2, camera, other, volume, second=views.second
    )
    return Matched(matches, findings=tuple(findings))


def _require_short_segments(
    views: TwoViews, volume: MeasuringVolume | None, method: str
) -> list[Finding]:
    """Raise MethodError where C2 holds more periods than the code tells apart.

    Points that C2 does not see would take their twin on the segment, and nothing shows it. What
    lies beyond the volume is not refused, for it may not be there: the finding tells.
    """
    if views.phases1.is_absolute or views.second is not None or volume is None:
        return []
    gradient, _ = fringe_crossing(views.phases2, views.camera1, views.camera2)
    if not gradient > 0:
        return []  # nothing is decoded
    segments = segments_in_camera(
        views.camera1,
        views.camera2,
        volume,
        period_px=views.phases1.period_px,
        camera_period_px=2 * np.pi / gradient,
    )
    n = told_apart(views.phases1.class_of_order)
    if segments.twins(n) > MOST_TWINS:
        raise MethodError(too_long(method, segments, views.phases1))
    return check_twins(
        segments.twins(n, beyond=BEYOND),
        code=code_in_words(segments.needs.bits_beyond, views.phases1),
    )


def two_views(phases: Sequence[CameraPhases], camera: Device, other: Device, /) -> TwoViews:
    """Return what both cameras see of the first direction, and of the second if there is one."""
    first1, *more1 = phases[0].directions
    first2, *more2 = phases[1].directions
    second1 = more1[0].main if more1 and more2 else None
    return TwoViews(
        camera1=camera,
        camera2=other,
        phases1=first1.main,
        phases2=first2.like(first1.main),
        second1=second1,
        second2=more2[0].like(second1) if second1 is not None else None,
        periods1=first1.other_periods,
        periods2=first2.other_periods,
    )


def search_task(
    phases: Sequence[CameraPhases],
    camera: Device,
    other: Device,
    projector: Device,
    volume: MeasuringVolume,
    /,
) -> Task:
    """Return the candidates of a scan on a coarse grid, by its first fringes alone, as the bias is
    learnt from."""
    views = replace(two_views(phases, camera, other), second1=None, second2=None,
                    periods1=(), periods2=())  # fmt: skip
    stride = coarse_stride(views.phases1.phase)
    return Task(quiet(views), projector, volume, FIT_SIGMA**2, together=True, stride=stride)


def _match_three(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    method: str,
    options: MeasureOptions,
    bias: CalibrationBias | None,
    witnesses: Witnesses | None,
) -> Matched:
    """Choose the order by projector and C2 together, then find its point in C2."""
    bias = bias if bias is not None and bias.fits(views.phases1.angle) else None
    if method == "m1" and views.phases1.is_absolute:
        # The reference: order by the code, place by the cameras alone.
        confirmed = confirm_orders(views, projector, volume, bias=bias)
        matches = match_near_sheets(
            views.phases1, views.phases2, views.camera1, views.camera2, projector, volume,
            confirmed.half_px, rejection=confirmed.rejection, located=confirmed.located,
        )  # fmt: skip
        matches, found = with_true_sigma(matches, views.phases1, views.phases2, confirmed.located)
        return Matched(matches, confirmed.bias, located=found)
    least = options.min_order_probability
    if least is None:
        least = STRICT_PROBABILITY if options.strict else MIN_PROBABILITY
    chosen = choose_orders(
        views,
        projector,
        volume,
        bias=bias,
        search=method == "m6",
        witnesses=witnesses,
        min_probability=least,
        together=method != "m3",
        strict=options.strict,
    )
    views = replace(views, phases1=chosen.phases)
    located = locate(views, projector, volume, half_px=chosen.half_px)
    matches = match_near_sheets(
        chosen.phases, views.phases2, views.camera1, views.camera2, projector, volume,
        chosen.half_px, rejection=located.met.rejection, located=located,
    )  # fmt: skip
    matches, found = with_true_sigma(matches, chosen.phases, views.phases2, located)
    matches = place_lost(matches, chosen, views.camera1, views.camera2, projector)
    good = matches.rejection == 0
    matches = replace(
        matches,
        fringe_order=np.where(good, chosen.phases.order_class, NO_ORDER),
        order_probability=np.where(good, doubt_at_borders(chosen.probability, good), np.nan),
    )
    return Matched(matches, chosen.bias, chosen.rival_shift, located=found)


def _turns_of(
    points_mm: NDArray[np.float64] | None, projector: Device, phases: PhaseMap
) -> NDArray[np.float64] | None:
    """Return the absolute phase, periods, that the projector gives points (row, col, 3)."""
    if points_mm is None:
        return None
    x, y = np.moveaxis(project(projector, points_mm), -1, 0)
    return across(phases.angle, x, y) / phases.period_px


def _may_judge(views: TwoViews, projector: Device, volume: MeasuringVolume) -> bool:
    """Tell whether the projector's calibration belongs to the cameras': a full code shows it."""
    if not views.phases1.is_absolute:
        return True
    step = max(SAMPLE_STEP_PX, len(views.phases1.phase) // SAMPLE_ROWS)
    sample = views.phases1.every(step)
    matches = match_cameras(
        sample, views.phases2, views.camera1, views.camera2, volume, beyond=False, step=step
    )
    points = triangulate(matches, views.camera1, views.camera2, volume=volume)
    limit = min(MAX_TRINOCULAR_PX, views.phases1.period_px / 4)
    return all(f.value < limit for f in check_trinocular(points, sample, projector))
