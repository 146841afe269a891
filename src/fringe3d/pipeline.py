"""``measure``: from a recording to points. The abstract of the method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.combining import combined
from fringe3d.correspond import twin_share
from fringe3d.decode import CameraPhases
from fringe3d.decoding import Decoded, decoded
from fringe3d.devices_moved import check_moved
from fringe3d.errors import CalibrationError, EmptyResultError, Fringe3DError, MethodError
from fringe3d.health import (
    Finding,
    check_ambiguity,
    check_bias,
    check_epipolar,
    check_evidence,
    check_previous,
    check_probability,
    check_texture,
    check_trinocular,
    check_twins,
    check_yield,
)
from fringe3d.kernels import alongside
from fringe3d.matching import Matched, match
from fringe3d.measurement import Measurement, StageClock, point_cloud
from fringe3d.model import (
    Correspondences,
    Device,
    MeasuringVolume,
    PhaseMap,
    PointMap,
    Rig,
    Scan,
)
from fringe3d.model.rejection import count_by_reason
from fringe3d.options import MeasureOptions
from fringe3d.reflections import without_reflections
from fringe3d.segments import angles_without_code
from fringe3d.triangulate import (
    epipolar_limit_px,
    remove_edges,
    remove_isolated,
    remove_outliers,
    remove_repeated,
    triangulate,
    typical_gap_mm,
)

__all__ = ["MeasureOptions", "Measurement", "measure", "measure_decoded", "point_cloud"]

GAP_FACTOR = 10.0
"""Neighbouring pixels belong to one surface up to ten typical distances: slopes up to 84 deg."""

OUTLIER_SIGMA = {"light": 6.0, "medium": 4.5, "strong": 3.5}
"""Standard deviations in `remove_outliers`: a point of 8.4, 6.3 or 4.9 sigma of its own."""

MIN_PATCH_PIXELS = 30

SPARSE_REACH_PX = 3
"""Gray code alone leaves out the pixels on the edges of its cells."""


def measure(
    scan: Scan,
    options: MeasureOptions | None = None,
    /,
    *,
    stage: Callable[[str], object] = str,
    previous_mm: NDArray[np.float64] | None = None,
) -> Measurement:
    """Measure: decode, find correspondences, triangulate, check.

    Parameters
    ----------
    scan : Scan
    options : MeasureOptions or None (defaults)
    stage : called with the name of each stage as it begins
    previous_mm : (row, col, 3) float or None, mm; points of the frame before in the pixels of C1,
        NaN where there are none; method M6 prefers what goes on from them

    Returns
    -------
    Measurement
        Without a rig the phases alone.

    Raises
    ------
    MethodError
        If plan and rig do not support the method.
    CalibrationError
        If the images contradict the calibration.
    EmptyResultError
        If no pixel gave a point.
    """
    options = options or MeasureOptions()
    clock = StageClock(stage)
    with clock("decoding"):
        shown = decoded(scan, options)
    return measure_decoded(shown, options, clock=clock, previous_mm=previous_mm)


def measure_decoded(
    shown: Decoded,
    options: MeasureOptions,
    /,
    *,
    clock: StageClock | None = None,
    previous_mm: NDArray[np.float64] | None = None,
) -> Measurement:
    """Measure what is decoded already, as `measure`; orders that are carried on are taken."""
    clock, phases = clock or StageClock(str), shown.phases
    choice, volume, main = shown.choice, shown.volume, shown.main
    result = Measurement(method=choice.method, why=choice.why, phases=phases,
                         n_images=shown.n_images)  # fmt: skip
    if shown.rig is None:
        return _finish(replace(result, findings=tuple(shown.findings())), clock)

    _require_previous(previous_mm, main, choice.method)
    camera, other = shown.devices()
    rig, projector = _with_own_bias(shown.rig, camera, other), shown.rig.projector
    method, is_carried = choice.method, shown.carried is not None
    if shown.carried is not None:
        phases, method = shown.carried.phases, "m1"
        main = phases[0].directions[0].main
        result = replace(result, phases=phases, why="fringe orders go on from the frame before")
    with clock("finding correspondences"):
        matched = match(phases, camera, other, projector, volume, method=method,
                        options=options, bias=rig.bias, previous_mm=previous_mm,
                        cameras=_further_cameras(rig, phases),
                        is_carried=is_carried)  # fmt: skip
        matches = matched.matches
        findings = _check_orders(matched, main, rig, volume, method)
        if previous_mm is not None and projector is not None:
            findings += check_previous(matches, main, projector, previous_mm)
    with clock("triangulating"):
        is_checked = other.role == "camera" and not is_carried
        of_texture = alongside(_check_texture, matches, phases, camera, other, is_checked)
        points = _triangulated(matched, camera, other, volume)
        points = _with_projector(points, matches, phases, camera, other, projector, options)
    with clock("checking"):
        findings = [*shown.findings(), *findings, *check_epipolar(matches), *check_yield(points)]
        findings += of_texture()
        if is_checked:
            findings += _check_devices(findings, phases, matches, points, (camera, other), rig)
        points = _clean(points, matches, options, main, camera)
    result = replace(result, matches=matches, points=points, bias=matched.bias,
                     findings=tuple(findings))  # fmt: skip
    return _finish(result, clock)


def _triangulated(
    matched: Matched, camera: Device, other: Device, volume: MeasuringVolume | None
) -> PointMap:
    limit = epipolar_limit_px(matched.matches)
    return triangulate(matched.matches, camera, other, volume=volume, max_epipolar_px=limit,
                       known=matched.known)  # fmt: skip


def _with_projector(
    points: PointMap,
    matches: Correspondences,
    phases: Sequence[CameraPhases],
    camera: Device,
    other: Device,
    projector: Device | None,
    options: MeasureOptions,
) -> PointMap:
    """Let the projector judge and move the points, as asked for; refuse it where it cannot."""
    how, seeks = options.reflections, options.reflections != "none"
    names = " and ".join(["--best-estimate"] * options.best_estimate + ["--reflections"] * seeks)
    if not names:
        return points
    if projector is None or other.role != "camera":
        raise MethodError(
            f"{names}: expected two cameras and a calibrated projector, found "
            + ("one camera" if projector is not None else "no projector in the rig")
            + f". Leave {names} out, or calibrate the projector "
            "(fringe3d calibrate projector --from SCAN)"
        )
    if seeks:
        points = without_reflections(points, matches, phases, (camera, other), projector, how)
    if options.best_estimate:
        maps = [direction.main for direction in phases[0].directions]
        second = phases[1].directions[0].like(maps[0])
        points, _ = combined(points, matches, maps, second, (camera, other), projector)
    return points


def _check_texture(
    matches: Correspondences,
    phases: Sequence[CameraPhases],
    camera: Device,
    other: Device,
    is_asked: bool,
) -> Sequence[Finding]:
    if not is_asked:
        return []
    main = phases[0].directions[0].main
    return check_texture(matches, main, phases[1].directions[0].like(main), camera, other)


def _check_devices(
    before: Sequence[Finding],
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    points: PointMap,
    cameras: tuple[Device, Device],
    rig: Rig,
) -> list[Finding]:
    """Check what cameras and projector say of each other; `before`: findings so far."""
    if rig.projector is None:
        return []
    found = check_trinocular(points, phases[0].directions[0].main, rig.projector)
    devices = (*cameras, rig.projector)
    return [*found, *check_moved([*before, *found], phases, matches, devices, rig.covariance)]


def _check_orders(
    matched: Matched, main: PhaseMap, rig: Rig, volume: MeasuringVolume | None, method: str
) -> list[Finding]:
    """Check what the fringe orders rest on; too many that several fit are refused but by M6."""
    ambiguity: Sequence[Finding]
    if method == "m6":
        assert volume is not None
        ambiguity = check_evidence(
            matched.matches, matched.rival_shift, has_bias=rig.bias is not None,
            angles=lambda: angles_without_code(rig, volume, main),
        )  # fmt: skip
    else:
        ambiguity = _refuse(check_ambiguity(matched.matches, main), MethodError)
    twins: Sequence[Finding] = ()
    if method == "projector" and not main.is_absolute and volume is not None:
        assert rig.projector is not None
        camera = next(c for c in rig.cameras if c.name == main.device_name)
        twins = check_twins(twin_share(main, camera, rig.projector, volume))
    bias = check_bias(matched.bias, rig.bias)
    return [*matched.findings, *ambiguity, *bias, *check_probability(matched.matches), *twins]


def _with_own_bias(rig: Rig, camera: Device, other: Device) -> Rig:
    """Return the rig, without its bias where that belongs to another pair of cameras."""
    pair = [device.name for device in (camera, other)]
    is_own = other.role == "projector" or pair == [c.name for c in rig.cameras[:2]]
    return rig if is_own else replace(rig, bias=None)


def _require_previous(previous_mm: NDArray[np.float64] | None, main: PhaseMap, method: str) -> None:
    """Raise MethodError if there is a frame before, but of no use."""
    if previous_mm is None:
        return
    if previous_mm.shape != (*main.phase.shape, 3):
        raise MethodError(
            f"previous_mm: expected points on the pixels of C1, (row, col, 3) = "
            f"{(*main.phase.shape, 3)}, found {previous_mm.shape}"
        )
    if method != "m6":
        raise MethodError(
            f"--previous: expected method m6, which alone uses the frame before, found {method}. "
            "Add --method m6, or leave --previous out"
        )


def _further_cameras(rig: Rig, phases: Sequence[CameraPhases]) -> list[Device]:
    cameras = {camera.name: camera for camera in rig.cameras}
    return [cameras[seen.directions[0].main.device_name] for seen in phases[2:]]


def _clean(
    points: PointMap,
    matches: Correspondences,
    options: MeasureOptions,
    main: PhaseMap,
    camera: Device,
) -> PointMap:
    """Reject what belongs to no surface, or stands for others, too."""
    gap = GAP_FACTOR * typical_gap_mm(points)
    if np.isfinite(gap):
        points = _without_strays(points, options, main, camera, gap)
    return remove_repeated(points, matches) if main.is_quantised else points


def _without_strays(
    points: PointMap, options: MeasureOptions, main: PhaseMap, camera: Device, gap: float
) -> PointMap:
    if options.outliers != "none":
        points = remove_outliers(points, camera.center_world, max_gap_mm=gap,
                                 most_sigma=OUTLIER_SIGMA[options.outliers])  # fmt: skip
    if options.drop_edges:
        points = remove_edges(points, max_gap_mm=gap)
    reach = SPARSE_REACH_PX if main.is_quantised else 1
    return remove_isolated(points, max_gap_mm=gap, min_pixels=MIN_PATCH_PIXELS, reach_px=reach)


def _finish(result: Measurement, clock: StageClock) -> Measurement:
    """Refuse a result that contradicts the calibration, or that is empty."""
    _refuse(result.findings, CalibrationError)
    is_refused = any(f.name == "undecided_part" and f.level != "ok" for f in result.findings)
    if not (result.rejection == 0).any() and not is_refused:
        counts = count_by_reason(result.rejection).items()
        counted = ", ".join(f"{count} {name}" for name, count in counts)
        raise EmptyResultError(
            f"no pixel of camera '{result.main.device_name}' gave a "
            f"{'phase' if result.points is None else 'point'}: {counted}. "
            "Check exposure, plan, calibration and measuring volume"
        )
    return replace(result, seconds=clock.seconds)


def _refuse(findings: Sequence[Finding], error: type[Fringe3DError]) -> Sequence[Finding]:
    """Return the findings, unless one of them is an error."""
    errors = [finding.text for finding in findings if finding.level == "error"]
    if errors:
        raise error(". ".join(errors))
    return findings
