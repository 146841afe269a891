"""Light that reaches a pixel by way of one other surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import Device
from fringe3d.simulate._sampling import collect
from fringe3d.simulate.caster import Hits, above_surface
from fringe3d.simulate.footprint import illuminate
from fringe3d.simulate.optics import ProjectorOptics
from fringe3d.simulate.scene import Scene
from fringe3d.simulate.truth import Truth

STEP_PX = 8
"""Indirect light is smooth: it is sought at every eighth pixel and row."""

N_DIRECTIONS = 48
PLANE_MM_PER_PX = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Bounce:
    """Paths of indirect light at a coarse grid, and how pixels mix them.

    Parameters
    ----------
    u, v, blur, direct : (n_coarse, n_directions) float32; as in `Footprint`
    neighbours : (n_pixels, 4) int32; coarse points around each pixel
    weights : (n_pixels, 4) float32; of points on the same surface; their sum is 1 or 0
    """

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    blur: NDArray[np.float32]
    direct: NDArray[np.float32]
    neighbours: NDArray[np.int32]
    weights: NDArray[np.float32]

    def light(
        self, levels: tuple[NDArray[np.float32], float, float], shift: NDArray[np.float64], /
    ) -> NDArray[np.float32]:
        """Return the indirect irradiance of each pixel, (n_pixels,)."""
        coarse = np.empty(len(self.u), np.float32)
        images, first, step = levels
        collect(
            images, first, step, self.u, self.v, self.blur, self.direct, shift[0], shift[1], coarse
        )
        return np.asarray((coarse[self.neighbours] * self.weights).sum(axis=1), np.float32)


def bounce(
    camera: Device,
    projector: Device,
    scene: Scene,
    light: ProjectorOptics,
    truth: Truth,
    /,
    *,
    reference_mm: NDArray[np.float64],
) -> Bounce:
    """Follow diffuse light from the pixels of a camera to other surfaces and the projector.

    Irradiance ``E = mean(albedo_j E_j)`` over directions j drawn with Lambert's cosine: the
    one-bounce term of the rendering equation for diffuse surfaces.
    """
    rows = np.arange(0, camera.n_rows + STEP_PX - 1, STEP_PX).clip(max=camera.n_rows - 1)
    cols = np.arange(0, camera.n_cols + STEP_PX - 1, STEP_PX).clip(max=camera.n_cols - 1)
    points = truth.points_mm[np.ix_(rows, cols)].reshape(-1, 3)
    normals = truth.normals[np.ix_(rows, cols)].reshape(-1, 3)
    u, v, blur, direct = _gather(projector, scene, light, points, normals, reference_mm)
    neighbours, weights = _mixing(truth, rows, cols)
    return Bounce(u, v, blur, direct, neighbours, weights)


def _gather(
    projector: Device,
    scene: Scene,
    light: ProjectorOptics,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    reference: NDArray[np.float64],
) -> tuple[NDArray[np.float32], ...]:
    directions = _cosine_directions(normals)
    away = np.linalg.norm(projector.center_world - points, axis=1)
    start = above_surface(points, normals, away)
    origins = np.broadcast_to(start[:, None], directions.shape).reshape(-1, 3)
    hits = scene.caster.cast(origins, directions.reshape(-1, 3))
    towards = (hits.normals * directions.reshape(-1, 3)).sum(axis=1) < 0  # not from inside
    u, v, blur, irradiance, albedo, _ = illuminate(projector, scene, light, _only(hits, towards),
                                                   reference)  # fmt: skip
    shape = directions.shape[:2]
    direct = np.nan_to_num(irradiance * albedo)
    return tuple(a.reshape(shape).astype(np.float32) for a in (u, v, blur, direct))


def _only(hits: Hits, kept: NDArray[np.bool_]) -> Hits:
    points = np.where(kept[:, None], hits.points_mm, np.nan)
    return Hits(points, hits.normals, np.where(kept, hits.face, -1).astype(np.int32), hits.albedo)


def _cosine_directions(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions around normals, (n, N_DIRECTIONS, 3), with density cos / pi.

    A golden-angle spiral on the disc, lifted to the hemisphere; turned from point to point, so
    that no pattern repeats.
    """
    index = np.arange(N_DIRECTIONS)
    radius = np.sqrt((index + 0.5) / N_DIRECTIONS)
    golden = np.pi * (3 - np.sqrt(5))
    angle = index * golden + np.arange(len(normals))[:, None] * 2.399
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    up = np.sqrt(1 - radius**2)
    spread: NDArray[np.float64] = (
        x[..., None] * first[:, None]
        + y[..., None] * second[:, None]
        + up[None, :, None] * normals[:, None]
    )
    return spread


def _mixing(
    truth: Truth, rows: NDArray[np.intp], cols: NDArray[np.intp]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return bilinear weights from the coarse grid, only between points of one surface."""
    n_rows, n_cols = truth.lit.shape
    row, col = (index.ravel() for index in np.mgrid[:n_rows, :n_cols])
    points, normals = truth.points_mm.reshape(-1, 3), truth.normals.reshape(-1, 3)
    near_row, near_col = row // STEP_PX, col // STEP_PX
    neighbours = np.empty((len(row), 4), np.int32)
    weights = np.empty((len(row), 4), np.float32)
    spacing = PLANE_MM_PER_PX * STEP_PX
    for place, (down, right) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        i = np.minimum(near_row + down, len(rows) - 1)
        j = np.minimum(near_col + right, len(cols) - 1)
        part = (1 - np.abs(row - (near_row + down) * STEP_PX) / STEP_PX) * (
            1 - np.abs(col - (near_col + right) * STEP_PX) / STEP_PX
        )
        there = rows[i] * n_cols + cols[j]
        gap = ((points[there] - points) * normals).sum(axis=1)
        alike = np.maximum((normals[there] * normals).sum(axis=1), 0.0) ** 8
        weights[:, place] = np.nan_to_num((part + 1e-3) * alike * np.exp(-((gap / spacing) ** 2)))
        neighbours[:, place] = i * len(cols) + j
    total = weights.sum(axis=1, keepdims=True)
    return neighbours, np.asarray(weights / np.where(total > 0, total, 1), np.float32)
