"""Whether a fitted projector holds beyond the points that it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate.lit_points import LitPoints
from fringe3d.calibrate.projector import FLAT_PART, ROBUST_RANGE, FittedProjector
from fringe3d.geometry import depth_interval, frustum, pixel_grid, project, rays
from fringe3d.health import Finding
from fringe3d.health.finding import Level
from fringe3d.model import MeasuringVolume, Rig
from fringe3d.patterns import across, extent_px

Floats = NDArray[np.float64]

VOLUME_WARNING_PX = 0.1
"""Ten times the noise of a good phase; a third of what a bare board leaves on other scenes."""

PATTERN_WARNING_PX = 0.1
"""Good rigs stay below 0.05 px."""

OUTLIER_SIGMA = 6.0
OUTLIER_FLOOR_PX = 0.2
MAD_TO_SIGMA = 1.4826

REGION_GRID = (9, 12)
REGION_DEPTHS = 4

BEYOND = 0.05
"""Of the distance, by which the depth range of the points is widened where no volume is known."""

MIN_BLOCK_POINTS = 20


@dataclass(frozen=True, slots=True)
class Rest:
    """What a projector leaves unexplained of one scan, in one direction.

    Parameters
    ----------
    scan : str
    angle : float, rad
    n_points : int
    median_px : float, px; median of ``|r|``
    rms_px : float, px; without outliers
    outliers : float; part of the points beyond six sigma (at least 0.2 px): edges, reflections
    pattern_px : float, px; rms of what neighbouring points share, which is not noise
    """

    scan: str
    angle: float
    n_points: int
    median_px: float
    rms_px: float
    outliers: float
    pattern_px: float


def rests(fitted: FittedProjector, scans: Sequence[LitPoints], /) -> tuple[Rest, ...]:
    """Return what is left of each scan and direction."""
    return tuple(
        _rest(scan, scan.angles[place], residual[:, place])
        for scan, residual in zip(scans, fitted.residual_px, strict=True)
        for place in range(len(scan.angles))
    )


def _rest(scan: LitPoints, angle: float, residual: Floats) -> Rest:
    known = np.isfinite(residual)
    left, block = residual[known], scan.block[known]
    typical = float(np.median(np.abs(left)))
    kept = np.abs(left) < max(OUTLIER_FLOOR_PX, OUTLIER_SIGMA * MAD_TO_SIGMA * typical)
    _, where = np.unique(block[kept], return_inverse=True)
    count = np.bincount(where)
    mean = np.bincount(where, left[kept]) / count
    # The mean of n independent errors has the n-th part of their variance.
    chance = float(left[kept].var()) / count
    full = count >= MIN_BLOCK_POINTS
    shared = float(np.mean((mean**2 - chance)[full])) if full.any() else 0.0
    return Rest(
        scan=scan.name,
        angle=angle,
        n_points=int(known.sum()),
        median_px=typical,
        rms_px=float(np.sqrt(np.mean(left[kept] ** 2))),
        outliers=float(1 - kept.mean()),
        pattern_px=float(np.sqrt(max(shared, 0.0))),
    )


def region_points(rig: Rig, scans: Sequence[LitPoints], fitted: FittedProjector, /) -> Floats:
    """Return points (n, 3), mm, all over where the rig measures and the projector lights.

    That is the rig's volume; without one the depth range of the scans, and a little beyond.
    """
    camera = rig.cameras[0]
    scale = np.array([camera.n_cols / REGION_GRID[1], camera.n_rows / REGION_GRID[0]])
    pixels = ((pixel_grid(REGION_GRID) + 0.5) * scale - 0.5).reshape(-1, 2)
    origin, directions = rays(camera, pixels)
    volume = rig.volume or _range_of(rig, scans)
    for other in rig.cameras[1:2]:
        volume = volume.intersection(frustum(other))
    near, far = depth_interval(origin, directions, volume)
    hit = (near < far) & np.isfinite(far)
    parts = np.linspace(0, 1, REGION_DEPTHS)
    depths = near[hit, None] + parts * (far - near)[hit, None]
    points = np.reshape(origin + depths[..., None] * directions[hit, None], (-1, 3))
    lit = np.ones(len(points), bool)
    pixel = project(fitted.device, points)
    for angle in {angle for scan in scans for angle in scan.angles}:
        low, high = extent_px(fitted.device.shape, angle)
        w = across(angle, pixel[:, 0], pixel[:, 1])
        lit &= (w >= low) & (w <= high)
    return np.asarray(points[lit])


def _range_of(rig: Rig, scans: Sequence[LitPoints]) -> MeasuringVolume:
    to_camera = rig.cameras[0].device_from_world
    depths = np.concatenate([to_camera.apply(scan.points_mm)[:, 2] for scan in scans])
    low, high = np.percentile(depths, ROBUST_RANGE)
    return MeasuringVolume.depth_slab(
        rig.cameras[0],
        depth_min_mm=float(low - BEYOND * np.median(depths)),
        depth_max_mm=float(high + BEYOND * np.median(depths)),
    )


def check_fit(fitted: FittedProjector, scans: Sequence[LitPoints], rig: Rig, /) -> list[Finding]:
    """Judge residuals, structure of the scans, and what the projector says of the whole volume.

    Parameters
    ----------
    fitted : FittedProjector
    scans : sequence of LitPoints that it was fitted to
    rig : Rig; its cameras, and the volume in which the projector shall hold

    Returns
    -------
    list of Finding
    """
    return [
        _pattern_finding(rests(fitted, scans)),
        _structure_finding(fitted.depth_part),
        _volume_finding(fitted, scans, region_points(rig, scans, fitted)),
    ]


def _pattern_finding(left: Sequence[Rest]) -> Finding:
    worst = max(left, key=lambda rest: rest.pattern_px)
    text = f"what neighbouring points share of the residual: {worst.pattern_px:.3f} px (rms)"
    if worst.pattern_px <= PATTERN_WARNING_PX:
        return Finding("ok", "pattern_px", worst.pattern_px, text)
    text += (
        f" in '{worst.scan}': no projector explains it. Look at the residual map: a smooth pattern "
        "is the calibration of the cameras, or a rig that moved between the scans; stripes are a "
        "projector that is not linear (gamma): use more phase steps"
    )
    return Finding("warning", "pattern_px", worst.pattern_px, text)


def _structure_finding(part: float) -> Finding:
    text = f"the points leave their common plane by {part:.1%} of their distance"
    if part >= FLAT_PART:
        return Finding("ok", "depth_part", part, text)
    text += (
        ": a flat scene does not tell where the projector stands; on other scenes the projector "
        "may be wrong by far more than its sigma says. Record an object that fills the measuring "
        "volume, or the board at several distances and tilts, and name all scans (--from A --from "
        "B)"
    )
    return Finding("warning", "depth_part", part, text)


def _volume_finding(fitted: FittedProjector, scans: Sequence[LitPoints], points: Floats) -> Finding:
    angles = {angle for scan in scans for angle in scan.angles}
    level: Level = "ok"
    if not len(points):
        text = "the measuring volume has no point that both cameras see and the projector lights"
        return Finding("warning", "volume_sigma_px", float("nan"), f"{text}: check the volume")
    sigma = max(
        float(np.sqrt(np.mean(fitted.position_sigma_px(points, angle, any_lens=True) ** 2)))
        for angle in angles
    )
    text = f"noise leaves the projector uncertain by {sigma:.3f} px over the measuring volume"
    if sigma > VOLUME_WARNING_PX:
        level = "warning"
        held = [p.name for p in fitted.parameters if p.held_by == "prior"]
        text += (
            ": the scans do not reach all of it, or have too little depth"
            + (f" (not held by the data: {', '.join(held)})" if held else "")
            + ". Add scans of objects in its other parts (--from A --from B)"
        )
    return Finding(level, "volume_sigma_px", sigma, text)
