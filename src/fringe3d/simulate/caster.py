"""Rays against meshes: Embree finds the triangle, double precision the point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from fringe3d.simulate.mesh import FLAT, Mesh

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SURFACE_GAP = 1e-5
"""Rays from a surface start this part of the distance to the light above it, so that single
precision does not let a surface shade itself."""

SINGLE_PRECISION = 4e-7
"""Part of the coordinates, the same for scenes far from the origin."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where rays meet the scene; NaN and -1 where they miss it.

    Parameters
    ----------
    points_mm : (n, 3) float64
    normals : (n, 3) float64, unit length; outwards
    face : (n,) int32
    albedo : (n,) float32; of meshes with their own brightness, else NaN
    """

    points_mm: Floats
    normals: Floats
    face: NDArray[np.int32]
    albedo: NDArray[np.float32]

    @property
    def is_hit(self) -> Bools:
        """Return (n,); True where the ray met something."""
        return np.asarray(self.face >= 0)


class Caster:
    """A mesh, prepared for ray casting.

    Parameters
    ----------
    mesh : Mesh
    """

    def __init__(self, mesh: Mesh, /) -> None:
        self.mesh = mesh
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, mesh.vertices_mm.astype(np.float32), mesh.faces)
        corners = mesh.vertices_mm[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.where(length > 0, length, 1.0)
        self._first_corner = corners[:, 0]

    def cast(self, origins: Floats, directions: Floats, /) -> Hits:
        """Return the first surface point on each ray.

        Parameters
        ----------
        origins : (n, 3) or (3,) float64, mm
        directions : (n, 3) float64, unit length; NaN misses

        Notes
        -----
        The triangle comes from a single-precision search; the point is the ray's intersection
        with the triangle's plane, or with the sphere that it stands for, in double precision.
        """
        origins = np.broadcast_to(origins, directions.shape)
        usable = np.asarray(np.isfinite(directions).all(axis=1))
        face = self._scene.run(
            origins.astype(np.float32),
            np.where(usable[:, None], directions, [0.0, 0.0, 1.0]).astype(np.float32),
        )
        face[~usable] = -1
        hit = np.asarray(face >= 0)
        points, normals = np.full((2, *directions.shape), np.nan)
        points[hit], normals[hit] = self._refine(origins[hit], directions[hit], face[hit])
        albedo = np.full(len(face), np.nan, np.float32)
        if self.mesh.albedo is not None:
            albedo[hit] = self._interpolate(self.mesh.albedo, points[hit], face[hit])
        return Hits(points, normals, face, albedo)

    def _refine(
        self, origins: Floats, directions: Floats, face: NDArray[np.int32]
    ) -> tuple[Floats, Floats]:
        normals = self._normals[face]
        room = ((self._first_corner[face] - origins) * normals).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = room / (directions * normals).sum(axis=1)
        owner = self.mesh.sphere_of_face[face]
        on_sphere = owner != FLAT
        if on_sphere.any():
            sphere = self.mesh.spheres[owner[on_sphere]]
            exact = _to_sphere(origins[on_sphere], directions[on_sphere], sphere)
            distance[on_sphere] = np.where(np.isnan(exact), distance[on_sphere], exact)
        points = origins + distance[:, None] * directions
        if on_sphere.any():
            normals[on_sphere] = (points[on_sphere] - sphere[:, :3]) / sphere[:, 3:]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return points, normals

    def _interpolate(
        self, values: NDArray[np.float32], points: Floats, face: NDArray[np.int32]
    ) -> NDArray[np.float32]:
        """Return values of vertices, linear within the triangles."""
        a, b, c = np.moveaxis(self.mesh.vertices_mm[self.mesh.faces[face]], 1, 0)
        normal = self._normals[face]
        area = (np.cross(b - a, c - a) * normal).sum(axis=1)
        part_b = (np.cross(points - a, c - a) * normal).sum(axis=1) / area
        part_c = (np.cross(b - a, points - a) * normal).sum(axis=1) / area
        at_a, at_b, at_c = values[self.mesh.faces[face]].T
        mixed: NDArray[np.float32] = (
            at_a + part_b * (at_b - at_a) + part_c * (at_c - at_a)
        ).astype(np.float32)
        return mixed

    def sees(self, points: Floats, normals: Floats, place: Floats, /) -> Bools:
        """Tell for surface points whether they face a place (3,) and nothing stands between."""
        away = place - points
        distance = np.linalg.norm(away, axis=1)
        with np.errstate(invalid="ignore"):
            facing = (away * normals).sum(axis=1) > 0
        free = np.zeros(len(points), bool)
        if not facing.any():
            return free
        away, distance = away[facing], distance[facing]
        start = above_surface(points[facing], normals[facing], distance)
        hit = self._scene.run(
            start.astype(np.float32),
            (away / distance[:, None]).astype(np.float32),
            (distance * (1 - SURFACE_GAP)).astype(np.float32),
            query="OCCLUDED",
        )
        free[facing] = hit < 0
        return free


def above_surface(points: Floats, normals: Floats, distance_mm: Floats, /) -> Floats:
    """Return where rays from surface points start; `distance_mm` (n,) sets the scale."""
    gap = SURFACE_GAP * distance_mm + SINGLE_PRECISION * np.abs(points).max(axis=1)
    return np.asarray(points + gap[:, None] * normals)


def _to_sphere(origins: Floats, directions: Floats, sphere: Floats) -> Floats:
    """Return the distance to the near side of a sphere along each ray; NaN for a miss."""
    to_center = sphere[:, :3] - origins
    along = (to_center * directions).sum(axis=1)
    # The distance of the ray from the centre, not a difference of large squares.
    beside = to_center - along[:, None] * directions
    with np.errstate(invalid="ignore"):
        half_chord = np.sqrt(sphere[:, 3] ** 2 - (beside**2).sum(axis=1))
    return np.asarray(along - half_chord)
