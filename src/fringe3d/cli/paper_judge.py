"""Judge measurements of simulated scans by their truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt

from fringe3d.evaluate import (
    REJECTED_PART,
    Verdict,
    errors_along_rays,
    false_share,
    fit_plane,
    score,
    sigma_without_bend,
    verdicts,
)
from fringe3d.geometry import pixel_grid, rays, sheet_crossing
from fringe3d.model import PointMap, Rig
from fringe3d.patterns import across
from fringe3d.pipeline import Measurement
from fringe3d.report.paper import Entry, PlaneFigures
from fringe3d.simulate import Stage, Truth

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

GROSS_MM = 0.5
"""Noise moves points by 0.01 mm."""

BORDER_PX = 2.0
"""Pixels so near to the object mix its light with that around."""

PLANE_MARGIN_PX = 3
LEVEL = math.cos(math.radians(0.5))
"""Surfaces that are level to half a degree belong to the plane's top."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judge:
    """What is true of a scene, seen from C1, as far as it judges points.

    Parameters
    ----------
    truth : Truth; of C1
    origin_mm : (3,) float, mm; centre of projection of C1
    points_mm : (row, col, 3) float, mm; the true points. Next to the object's border, where a pixel
        mixes its light with that around, those at the depth of the nearest pixel that sees it
    step_mm : (row, col) float, mm; by which one fringe order moves a point along its ray
    seen : (row, col) bool; a lit point of the object in the volume which C2 sees, too
    """

    truth: Truth
    origin_mm: Floats
    points_mm: Floats
    step_mm: Floats
    seen: Bools

    def verdicts(self, points: PointMap, /) -> NDArray[np.int8]:
        """Tell right from wrong orders, (row, col) `Verdict`."""
        return verdicts(self._errors(points), points.is_valid, self.step_mm / 2)

    def judged(self, entry: Entry, points: PointMap, reference: Bools, /) -> Entry:
        """Return the entry with all its figures; `reference` is what M1 measured right."""
        verdict = self.verdicts(points)
        there = points.is_valid & self.seen
        gross = np.abs(self._errors(points)[there]) > GROSS_MM
        own = self.truth.is_object & self.truth.in_volume
        shown = np.where(points.is_valid, verdict, np.where(self.seen, Verdict.MISSING, -1))
        return replace(
            entry,
            against_m1=score(verdict, reference),
            of_seen=score(verdict, self.seen),
            gross_part=float(gross.mean()) if len(gross) else math.nan,
            false_share=false_share(points.is_valid, own, verdict == Verdict.RIGHT),
            verdict=shown.astype(np.int8),
            shade=np.nan_to_num(self.truth.normals[..., 2]).astype(np.float32),
        )

    def plane(self, points: PointMap, /) -> PlaneFigures:
        """Return the figures of a level plane: of the points on its top, without the border."""
        top = self.seen & (self.truth.normals[..., 2] > LEVEL)
        top = binary_erosion(top, iterations=PLANE_MARGIN_PX)
        top &= self.verdicts(points) == Verdict.RIGHT
        found = points.points_mm[top]
        fit = fit_plane(found, rejected_part=REJECTED_PART)
        rays_mm = found - self.origin_mm
        slant = np.abs(rays_mm @ fit.surface.normal) / np.linalg.norm(rays_mm, axis=-1)
        predicted = (slant * points.sigma_mm[top])[fit.is_used]
        return PlaneFigures(
            sigma_um=1000 * fit.sigma_mm,
            noise_um=1000 * sigma_without_bend(found, fit),
            flatness_um=1000 * fit.form_mm,
            predicted_um=1000 * float(np.sqrt((predicted**2).mean())),
            n_points=fit.n_used,
        )

    def _errors(self, points: PointMap) -> Floats:
        return errors_along_rays(points.points_mm, self.points_mm, self.origin_mm)


def judge_of(stage: Stage, period_px: float, /) -> Judge:
    """Return the judge of a scene that is lit with vertical fringes of a period, px."""
    truth, camera = stage.truths[0], stage.rig.cameras[0]
    origin, directions = rays(camera, pixel_grid(camera.shape))
    own = truth.is_object & truth.in_volume
    distance, (rows, cols) = distance_transform_edt(~own, return_indices=True)
    near = (distance > 0) & (distance <= BORDER_PX)
    depths = np.linalg.norm(truth.points_mm - origin, axis=-1)
    borrowed = origin + depths[rows, cols, None] * directions
    steps = order_steps(stage.rig, truth, period_px)
    return Judge(
        truth=truth,
        origin_mm=origin,
        points_mm=np.where(near[..., None], borrowed, truth.points_mm),
        step_mm=np.where(near, steps[rows, cols], steps),
        seen=truth.lit & own & truth.seen_by[stage.rig.cameras[1].name],
    )


def order_steps(rig: Rig, truth: Truth, period_px: float, /) -> Floats:
    """Return by how far the next fringe order is away along the viewing ray of C1.

    Parameters
    ----------
    rig : Rig with a projector
    truth : Truth; of C1
    period_px : float, projector px; of vertical fringes

    Returns
    -------
    (row, col) float64, mm
        The shorter of the steps up and down; NaN where nothing is seen.
    """
    camera, projector = rig.cameras[0], rig.projector
    assert projector is not None
    origin, directions = rays(camera, pixel_grid(camera.shape))
    seen = np.isfinite(truth.projector_xy).all(axis=-1)
    x, y = truth.projector_xy[seen].T
    w, depths = across(0.0, x, y), np.linalg.norm(truth.points_mm[seen] - origin, axis=-1)
    crossings = [
        sheet_crossing(projector, origin, directions[seen], w + shift, 0.0)
        for shift in (-period_px, period_px)
    ]
    steps = np.full(camera.shape, np.nan)
    steps[seen] = np.fmin(*(np.abs(crossing - depths) for crossing in crossings))
    return steps


def points_of(result: Measurement, /) -> PointMap:
    """Return the points of a measurement with a rig."""
    assert result.points is not None
    return result.points
