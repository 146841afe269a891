"""Simulated recordings, and what is true of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fringe3d.cli.paper import EXPOSURE, FULL_WELL_E, PLANE_MODULATION
from fringe3d.cli.paper_judge import BORDER_PX
from fringe3d.cli.stage_cache import prepare_cached
from fringe3d.evaluate import Verdict, errors_along_rays, verdicts
from fringe3d.geometry import pixel_grid, rays, sheet_crossing
from fringe3d.model import PointMap, Rig, Scan
from fringe3d.patterns import across, method_plan
from fringe3d.simulate import OBJECTS, PRESETS, CameraOptics, Preset, Setup, Truth, record

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

STEPS = 4
RECORDING_SEED = 1


@dataclass(frozen=True, slots=True, order=True)
class Scene:
    """An object on a lit table before a rig; noise is a part of the fringes' modulation."""

    preset: str
    thing: str
    noise: float = 0.01
    size: tuple[int, int] = (640, 512)

    def __str__(self) -> str:
        return f"{self.preset}, {self.thing}, noise {100 * self.noise:g} %"


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Images of a scene for M1 (a full Gray code); the true rig is that of the scan."""

    scan: Scan
    rig: Rig
    angle: float
    reference: Reference


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What is true of a scene, seen from C1.

    Parameters
    ----------
    origin_mm : (3,) float; centre of projection of C1
    points_mm : (row, col, 3) float; next to the object's border, where a pixel mixes its light with
        that around, at the depth of the nearest pixel that sees it
    step_mm : (row, col) float; by which one fringe order moves a point along its ray
    seen : (row, col) bool; a lit point of the object in the volume which C2 sees, too
    is_near : (row, col) bool; next to the object's border
    """

    origin_mm: Floats
    points_mm: Floats
    step_mm: Floats
    seen: Bools
    is_near: Bools

    def is_right(self, points: PointMap, /) -> Bools:
        """Tell which points lie within half a step of the true ones."""
        errors = errors_along_rays(points.points_mm, self.points_mm, self.origin_mm)
        verdict = verdicts(errors, points.is_valid, self.step_mm / 2)
        return np.asarray(verdict == Verdict.RIGHT)

    def is_false(self, points: PointMap, /) -> Bools:
        """Tell which points should not be: outside the volume, not lit or not seen by C2."""
        excused = self.is_near & self.is_right(points)
        return np.asarray(points.is_valid & ~self.seen & ~excused)


def recorded(scene: Scene, /) -> Recording:
    """Simulate a scene, or read it from the cache."""
    preset = PRESETS[scene.preset](scene.size)
    projector = preset.rig.projector
    assert projector is not None
    optics = CameraOptics(
        exposure=EXPOSURE,
        full_well_e=FULL_WELL_E,
        read_noise_e=scene.noise * PLANE_MODULATION * FULL_WELL_E,
    )
    stage = prepare_cached(
        preset.rig, preset.scene(OBJECTS[scene.thing]()), Setup(camera=optics), progress=_silent
    )
    plan = method_plan(
        "m1", projector.shape, period_px=preset.period_px, n_shifts=STEPS, angle=preset.fringe_angle
    )
    return Recording(
        scan=record(stage, plan, seed=RECORDING_SEED),
        rig=preset.rig,
        angle=preset.fringe_angle,
        reference=reference_of(preset, stage.truths[0]),
    )


def reference_of(preset: Preset, truth: Truth, /) -> Reference:
    """Return what is true, from the truth of C1."""
    camera = preset.rig.cameras[0]
    origin, directions = rays(camera, pixel_grid(camera.shape))
    own = truth.is_object & truth.in_volume
    distance, (rows, cols) = distance_transform_edt(~own, return_indices=True)
    near = (distance > 0) & (distance <= BORDER_PX)
    depths = np.linalg.norm(truth.points_mm - origin, axis=-1)
    borrowed = origin + depths[rows, cols, None] * directions
    steps = _order_steps(preset, truth, origin, directions, depths)
    return Reference(
        origin_mm=origin,
        points_mm=np.where(near[..., None], borrowed, truth.points_mm),
        step_mm=np.where(near, steps[rows, cols], steps),
        seen=truth.lit & own & truth.seen_by[preset.rig.cameras[1].name],
        is_near=near,
    )


def _order_steps(
    preset: Preset, truth: Truth, origin: Floats, directions: Floats, depths: Floats
) -> Floats:
    """Return how far the next fringe order is along the viewing rays, mm, the shorter way."""
    projector = preset.rig.projector
    assert projector is not None
    seen = np.isfinite(truth.projector_xy).all(axis=-1)
    x, y = truth.projector_xy[seen].T
    w = across(preset.fringe_angle, x, y)
    away = [
        np.abs(
            sheet_crossing(projector, origin, directions[seen], w + shift, preset.fringe_angle)
            - depths[seen]
        )
        for shift in (-preset.period_px, preset.period_px)
    ]
    steps = np.full(seen.shape, np.nan)
    steps[seen] = np.fmin(*away)
    return steps


def _silent(_work: str, _done: int, _total: int) -> None:
    pass
