"""Whether devices have moved since their calibration, and which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fringe3d.calibrate import (
    Homologous,
    contradiction,
    expected_contradiction,
    moved_text,
    which_moved,
)
from fringe3d.decode import CameraPhases
from fringe3d.errors import EmptyResultError
from fringe3d.health import EPIPOLAR_WARNING_PX, Finding
from fringe3d.health.finding import Level
from fringe3d.model import (
    Correspondences,
    Device,
    PhaseMap,
    Rejection,
    RigCovariance,
)
from fringe3d.recorded_points import freely_matched, homologous_of

CONTRADICTIONS = ("epipolar_residual_px", "trinocular_residual_px", "lost_part")
"""Findings after which it is asked which device moved."""

SPARSE_POINTS = 30_000
"""Pixels of C1 that are enough to tell which device moved."""

FEW_POINTS = 4_000
"""Pixels of C1 that are enough to tell whether one did."""

LIMIT_FACTOR, LEAST_LIMIT_PX = 3.0, 0.1
"""Of what calibration and noise let expect; and what response and interreflection may add."""


def check_moved(
    findings: Sequence[Finding],
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    covariance: RigCovariance | None = None,
    /,
) -> list[Finding]:
    """Say which device moved, where devices contradict each other by more than the calibration.

    Parameters
    ----------
    findings : what the other checks found
    phases : CameraPhases of two cameras; the direction that was matched first
    matches : Correspondences of the second camera
    devices : the cameras of `phases`, then the projector if there is one
    covariance : RigCovariance or None
        Of the calibration: the limit of the contradictions follows from it. Without one what other
        checks found is asked, and the limit is 0.5 px.
    """
    found = [f for f in findings if f.name in CONTRADICTIONS and f.level != "ok"]
    maps = [direction.main for direction in phases[0].directions]
    if len(devices) < 3 or any(m.is_quantised for m in maps):
        return []
    limit, judged = EPIPOLAR_WARNING_PX, []
    try:
        if covariance is not None:
            limit, value = _limit(phases, matches, devices, covariance)
            if value < limit:
                text = f"devices contradict each other by {value:.2f} px, at most {limit:.2f} px"
                judged = [Finding("ok", "contradiction_px", value, f"{text} by the calibration")]
            elif not found:
                return _moved(phases, matches, devices, limit, level="warning")
        if not found or judged:
            return judged
    except EmptyResultError:
        pass
    is_error = any(f.level == "error" for f in found)
    return _moved(phases, matches, devices, limit, level="error" if is_error else "warning")


def _limit(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    covariance: RigCovariance,
) -> tuple[float, float]:
    """Return how far devices may contradict each other, and how far they do, px."""
    few = np.zeros(matches.rejection.shape, bool)
    step = max(1, round(np.sqrt(few.size / FEW_POINTS)))
    few[::step, ::step] = True
    sparse = replace(matches, rejection=np.where(few, matches.rejection, Rejection.NO_MATCH))
    points = homologous_of(phases[:2], sparse, devices)
    value = contradiction([points], devices)
    if value < LEAST_LIMIT_PX:
        return LEAST_LIMIT_PX, value
    expected = LIMIT_FACTOR * expected_contradiction(points, devices, covariance)
    return float(np.clip(expected, LEAST_LIMIT_PX, EPIPOLAR_WARNING_PX)), value


def _moved(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    limit_px: float,
    *,
    level: Level,
) -> list[Finding]:
    """Say which device moved; nothing below the limit."""
    try:
        few, _ = _searched_freely(phases, matches, devices, FEW_POINTS)
        if contradiction([few], devices) < limit_px:
            return []
        points, is_free = _searched_freely(phases, matches, devices, SPARSE_POINTS)
        moved = replace(which_moved([points], devices), is_free=is_free)
    except EmptyResultError:
        return []
    if moved.residual_px < limit_px:
        return []  # so say more points
    if moved.residual_px < EPIPOLAR_WARNING_PX and not moved.is_of_poses:
        return []  # what is left is that of fringes, not of poses
    if moved.left_px >= moved.residual_px:
        return []  # the best poses are no better: stray points, as of edges, contradict each other
    again = "Calibrate again (--self-calibrate)" if moved.is_of_poses else "Calibrate with a board"
    advice = f"{again}. Limit: {limit_px:.2f} px"
    return [Finding(level, "moved_px", moved.residual_px, f"{moved_text(moved)}. {advice}")]


def _searched_freely(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    n_pixels: int,
) -> tuple[Homologous, bool]:
    """Return the points of about so many pixels, searched without projector and volume where a code
    allows it, and whether two directions found them so."""
    maps = [direction.main for direction in phases[0].directions]
    pairs = zip(phases[1].directions, maps, strict=True)
    sparse = [_sparse(m, n_pixels) for m in maps]
    free = freely_matched(sparse, [d.like(m) for d, m in pairs], devices)
    points = homologous_of(phases[:2], free or matches, devices)
    return points, free is not None and len(maps) > 1


def _sparse(phases: PhaseMap, n_pixels: int) -> PhaseMap:
    """Return the phases of about so many pixels on a grid."""
    step = max(1, round(np.sqrt(phases.rejection.size / n_pixels)))
    left_out = np.full(phases.rejection.shape, np.uint16(Rejection.NO_MATCH))
    left_out[::step, ::step] = 0
    return phases.rejecting(left_out)
