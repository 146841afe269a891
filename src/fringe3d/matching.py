"""Which search finds the correspondences: what the code, the cameras and the projector allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fringe3d.correspond import (
    depths_of_orders,
    fringe_crossing,
    guard_px,
    match_cameras,
    match_projector,
    resolve_orders,
)
from fringe3d.decode import CameraPhases, has_mirrored_neighbours
from fringe3d.errors import MethodError
from fringe3d.health import check_trinocular
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    MeasuringVolume,
    PhaseMap,
    Rejection,
)
from fringe3d.triangulate import triangulate

MIN_CROSSING_SINE = 0.05
"""3 degrees between fringes and epipolar lines; sigma is twenty times that of a square crossing."""

SAMPLE_STEP_PX = 8

MAX_TRINOCULAR_PX = 3.0
"""A projector that is further off judges nothing; the search window is half a period."""


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two cameras with their phases, and the volume that they measure."""

    phases1: PhaseMap
    phases2: PhaseMap
    camera1: Device
    camera2: Device
    volume: MeasuringVolume | None


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


def match(
    phases: Sequence[CameraPhases],
    camera: Device,
    other: Device,
    projector: Device | None,
    volume: MeasuringVolume | None,
    /,
) -> Correspondences:
    """Find the correspondences of C1 with the second camera, or with the projector.

    Parameters
    ----------
    phases : CameraPhases of each camera; the best direction first
    camera, other : Device; C1, and the second camera or the projector
    projector : Device or None; where it is calibrated it helps two cameras, too
    volume : MeasuringVolume or None

    Returns
    -------
    Correspondences

    Raises
    ------
    MethodError
        If the code does not tell neighbouring periods apart, and nothing else does.
    """
    if other.role == "projector":
        maps = [direction.main for direction in phases[0].directions[:2]]
        return match_projector(maps, camera, other, volume)
    main1 = phases[0].directions[0].main
    pair = _Pair(main1, phases[1].directions[0].like(main1), camera, other, volume)
    if projector is not None and _projector_helps(pair, projector):
        return _match_three(pair, projector)
    if has_mirrored_neighbours(main1):
        raise MethodError(
            "--gray-bits: the finest images of a plain code repeat mirrored and do not tell all "
            "neighbouring periods apart; a calibrated projector and the depth range would tell "
            "where. Keep all, or record an over-determined code (cells of half a period) or a "
            "cyclic one"
        )
    return match_cameras(pair.phases1, pair.phases2, camera, other, volume)


def _match_three(pair: _Pair, projector: Device) -> Correspondences:
    """Match two cameras where the projector tells which order can be, and at what depth."""
    phases1 = pair.phases1
    resolved = resolve_orders(phases1, pair.camera1, projector, pair.volume)
    half_px = guard_px(phases1)
    if len(np.unique(phases1.class_of_order)) > 1:
        # With a code C2 knows the order, too: leave the projector room for errors.
        half_px = np.full_like(half_px, phases1.period_px / 2)
    depths = depths_of_orders(resolved, pair.camera1, projector, half_px)
    matches = match_cameras(
        phases1.rejecting(resolved.rejection),
        pair.phases2,
        pair.camera1,
        pair.camera2,
        pair.volume,
        depths_mm=depths,
    )
    order = np.where(matches.rejection == 0, resolved.order_class, NO_ORDER)
    return replace(matches, fringe_order=order)


def _projector_helps(pair: _Pair, projector: Device) -> bool:
    """Tell whether the projector may judge: a full code shows if it belongs to the cameras."""
    if pair.phases1.is_absolute:
        return _projector_agrees(pair, projector)
    return pair.volume is not None


def _projector_agrees(pair: _Pair, projector: Device) -> bool:
    """Tell from a few pixels whether the projector's calibration belongs to the cameras'."""
    left_out = np.full(pair.phases1.rejection.shape, np.uint16(Rejection.NO_MATCH))
    left_out[::SAMPLE_STEP_PX, ::SAMPLE_STEP_PX] = 0
    sample = pair.phases1.rejecting(left_out)
    matches = match_cameras(sample, pair.phases2, pair.camera1, pair.camera2, pair.volume)
    points = triangulate(matches, pair.camera1, pair.camera2, volume=pair.volume)
    limit = min(MAX_TRINOCULAR_PX, pair.phases1.period_px / 4)
    return all(f.value < limit for f in check_trinocular(points, pair.phases1, projector))
