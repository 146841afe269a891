"""``measure``: from a recording to points. The abstract of the method."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import twin_share
from fringe3d.decode import CameraPhases, decode
from fringe3d.errors import CalibrationError, EmptyResultError, Fringe3DError, MethodError
from fringe3d.health import (
    Finding,
    check_ambiguity,
    check_epipolar,
    check_files,
    check_phases,
    check_texture,
    check_trinocular,
    check_twins,
    check_yield,
)
from fringe3d.matching import best_direction_first, match
from fringe3d.model import (
    Correspondences,
    Device,
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    PatternPlan,
    PhaseMap,
    PointCloud,
    PointMap,
    Rig,
    Scan,
)
from fringe3d.model.rejection import count_by_reason
from fringe3d.triangulate import (
    remove_edges,
    remove_isolated,
    remove_repeated,
    triangulate,
    typical_gap_mm,
)

Method = Literal["auto", "m1", "m2", "projector"]
Direction = Literal["auto", "x", "y"]

GAP_FACTOR = 10.0
"""Neighbouring pixels belong to one surface up to ten typical distances: slopes up to 84 deg."""

MIN_PATCH_PIXELS, STRICT_PATCH_PIXELS = 30, 200

SPARSE_REACH_PX = 3
"""Gray code alone leaves out the pixels on the edges of its cells."""

EPIPOLAR_SIGMA = 6.0
EPIPOLAR_FLOOR_PX = 0.5
MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureOptions:
    """How to measure. The defaults use all images and take the best method.

    Parameters
    ----------
    method : "auto", "m1" (two cameras, full Gray code), "m2" (two cameras, reduced code, unique
        on the epipolar segment) or "projector" (one camera and the calibrated projector)
    direction : "auto", "x" or "y"; keep only the fringes and code of this direction. "auto" keeps
        all: one camera and the projector use two directions, two cameras that one whose fringes
        cross the epipolar lines best
    n_shifts : int or None; keep that many of the phase steps of every set
    gray_bits : int or None; keep the finest images of every Gray code; 0 for none
    depth_mm : (min, max) or None, mm; depth range along the principal ray of C1, besides the
        rig's volume
    strict : bool; metrology: larger patches, no points next to depth edges
    min_modulation_dn : float or None, DN
    """

    method: Method = "auto"
    direction: Direction = "auto"
    n_shifts: int | None = None
    gray_bits: int | None = None
    depth_mm: tuple[float, float] | None = None
    strict: bool = False
    min_modulation_dn: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """The answer and the evidence.

    Parameters
    ----------
    method : str; the method used, or "phase" where there is no rig
    phases : tuple of CameraPhases
    matches : Correspondences or None
    points : PointMap or None
    findings : tuple of Finding; what the checks found
    seconds : dict; time of each stage
    """

    method: str
    phases: tuple[CameraPhases, ...]
    matches: Correspondences | None = None
    points: PointMap | None = None
    findings: tuple[Finding, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def main(self) -> PhaseMap:
        """Return the phase map of C1 that the points rest on."""
        return self.phases[0].directions[0].main

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Return the findings that are not ok."""
        return tuple(f for f in self.findings if f.level != "ok")

    @property
    def rejection(self) -> NDArray[np.uint16]:
        """Return the rejection map of C1."""
        return self.main.rejection if self.points is None else self.points.rejection


def measure(
    scan: Scan, options: MeasureOptions | None = None, /, *, stage: Callable[[str], object] = str
) -> Measurement:
    """Measure: decode, find correspondences, triangulate, check.

    Parameters
    ----------
    scan : Scan
    options : MeasureOptions or None (defaults)
    stage : called with the name of each stage as it begins

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
    clock = _Clock(stage)
    stacks = [keep_images(stack, options) for stack in scan.stacks]
    method = choose_method(scan.rig, stacks, options)

    with clock("decoding"):
        phases = tuple(_decode(stack, scan.rig, method, options) for stack in stacks)
        findings = check_files(stacks) + check_phases(phases)
        if scan.rig is not None and method != "projector":
            phases = best_direction_first(phases, *_devices(scan.rig, stacks, method))
    main = phases[0].directions[0].main
    method = _settle(method, options, main)
    if scan.rig is None:
        return _finish(Measurement(method="phase", phases=phases, findings=tuple(findings)), clock)

    camera, other = _devices(scan.rig, stacks, method)
    volume = _volume(scan.rig, camera, options)
    with clock("finding correspondences"):
        matches = match(phases, camera, other, scan.rig.projector, volume)
        findings += _refuse(check_ambiguity(matches, main), MethodError)
        if not main.is_absolute and scan.rig.projector is not None and volume is not None:
            share = twin_share(main, camera, scan.rig.projector, volume)
            findings += check_twins(share)
    with clock("triangulating"):
        points = triangulate(
            matches, camera, other, volume=volume, max_epipolar_px=_epipolar_limit(matches)
        )
    with clock("checking"):
        findings += check_epipolar(matches) + check_yield(points)
        if other.role == "camera":
            main2 = phases[1].directions[0].like(main)
            findings += check_texture(matches, main, main2, camera, other)
            if scan.rig.projector is not None:
                findings += check_trinocular(points, main, scan.rig.projector)
        points = remove_repeated(_clean(points, options, main), matches)
    result = Measurement(method=method, phases=phases, matches=matches, points=points,
                         findings=tuple(findings))  # fmt: skip
    return _finish(result, clock)


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
    return stack.subset(sorted(kept))


def _other_directions(plan: PatternPlan, direction: Direction) -> set[int]:
    """Return the places of the images whose stripes run the other way."""
    if direction == "auto":
        return set()
    wanted = {angle for angle in plan.angles if _axis(angle) == direction}
    if not wanted:
        raise MethodError(
            f"--direction {direction}: expected one of the recorded directions "
            f"{sorted({_axis(angle) for angle in plan.angles})}, found none such in the plan"
        )
    return {
        index
        for index, pattern in enumerate(plan.patterns)
        if isinstance(pattern, Fringe | GrayBit) and pattern.angle not in wanted
    }


def _axis(angle: float) -> Direction:
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


def choose_method(rig: Rig | None, stacks: Sequence[ImageStack], options: MeasureOptions, /) -> str:
    """Return the method that options, rig and cameras allow; say why if none does."""
    if rig is None:
        if options.method != "auto":
            raise MethodError(
                f"--method {options.method}: expected a calibrated rig, found none. Name one with "
                "--rig, or leave --method out to get the phase maps"
            )
        return "phase"
    two_cameras = len(stacks) >= 2 and len(rig.cameras) >= 2
    asked = options.method
    if asked == "auto":
        asked = "m1" if two_cameras else "projector"
    if asked in ("m1", "m2") and not two_cameras:
        raise MethodError(
            f"--method {asked}: expected images and calibration of two cameras, found "
            f"{len(stacks)} camera(s) in the scan and {len(rig.cameras)} in the rig. "
            "Use --method projector"
        )
    if asked == "projector" and rig.projector is None:
        raise MethodError(
            "--method projector: expected a calibrated projector in the rig, found none. "
            + ("Use --method m1" if two_cameras else "Add the projector to the rig file, or "
               "record with a second camera")
        )  # fmt: skip
    return asked


def _settle(method: str, options: MeasureOptions, main: PhaseMap) -> str:
    """Tell M1 from M2, now that it is known what the code tells apart."""
    if method not in ("m1", "m2"):
        return method
    settled = "m1" if main.is_absolute else "m2"
    if options.method == "m1" and settled == "m2":
        raise MethodError(
            f"--method m1: expected a full Gray code, found one that tells "
            f"{len(np.unique(main.class_of_order))} of {len(main.class_of_order)} periods apart. "
            "Keep more bits, or use --method m2 with the depth range of the object (--depth)"
        )
    if options.method == "m2" and settled == "m1":
        raise MethodError(
            "--method m2: expected a reduced Gray code, found a full one. Use --method m1, or "
            "keep fewer bits with --gray-bits"
        )
    return settled


def _devices(rig: Rig, stacks: Sequence[ImageStack], method: str) -> tuple[Device, Device]:
    cameras = {camera.name: camera for camera in rig.cameras}
    camera = cameras[stacks[0].device_name]
    if method == "projector":
        assert rig.projector is not None
        return camera, rig.projector
    return camera, cameras[stacks[1].device_name]


def _volume(rig: Rig, camera: Device, options: MeasureOptions) -> MeasuringVolume | None:
    if options.depth_mm is None:
        return rig.volume
    try:
        slab = MeasuringVolume.depth_slab(
            camera, depth_min_mm=options.depth_mm[0], depth_max_mm=options.depth_mm[1]
        )
    except ValueError as problem:
        raise MethodError(f"--depth: {problem}") from None
    return slab if rig.volume is None else rig.volume.intersection(slab)


def _decode(
    stack: ImageStack, rig: Rig | None, method: str, options: MeasureOptions
) -> CameraPhases:
    """Decode one camera; two directions of Gray code alone give the projector's whole pixels."""
    return decode(
        stack,
        rig.projector.shape if rig is not None and rig.projector is not None else None,
        min_modulation_dn=options.min_modulation_dn,
        whole_cells=method == "projector" and len(stack.plan.angles) > 1,
    )


def _epipolar_limit(matches: Correspondences) -> float | None:
    """Return 6 robust sigma of the epipolar residual, px; None where there is no residual."""
    residual = np.abs(matches.epipolar_residual_px[np.isfinite(matches.epipolar_residual_px)])
    if not len(residual):
        return None
    return max(EPIPOLAR_FLOOR_PX, EPIPOLAR_SIGMA * MAD_TO_SIGMA * float(np.median(residual)))


def _clean(points: PointMap, options: MeasureOptions, main: PhaseMap) -> PointMap:
    gap = GAP_FACTOR * typical_gap_mm(points)
    if not np.isfinite(gap):
        return points
    if options.strict:
        points = remove_edges(points, max_gap_mm=gap)
    size = STRICT_PATCH_PIXELS if options.strict else MIN_PATCH_PIXELS
    reach = SPARSE_REACH_PX if main.is_quantised else 1
    return remove_isolated(points, max_gap_mm=gap, min_pixels=size, reach_px=reach)


def _finish(result: Measurement, clock: _Clock) -> Measurement:
    """Refuse a result that contradicts the calibration, or that is empty."""
    _refuse(result.findings, CalibrationError)
    if not (result.rejection == 0).any():
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


def point_cloud(result: Measurement, /) -> PointCloud:
    """Return the points of a measurement as a plain cloud, coloured by the surface's brightness."""
    assert result.points is not None
    good = result.points.is_valid
    offset = np.nan_to_num(result.main.offset[good])
    top = max(float(np.percentile(offset, 99)), 1.0)
    return PointCloud(
        points_mm=result.points.points_mm[good],
        sigma_mm=result.points.sigma_mm[good],
        grey=np.clip(255 * offset / top, 0, 255).astype(np.uint8),
        source_index=np.argwhere(good).astype(np.int32),
    )


class _Clock:
    """Times the stages and tells of each as it begins."""

    def __init__(self, stage: Callable[[str], object]) -> None:
        self._stage = stage
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._stage(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
