"""Surfaces of a scene: triangles, exact spheres among them, and brightness."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model import RigidTransform

FLAT = -1
"""Stands in `Mesh.sphere_of_face` for a plane triangle."""

ON_SPHERE_MM = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """Triangles in the frame of the object.

    Parameters
    ----------
    vertices_mm : (n, 3) float64, mm
    faces : (m, 3) int32; counter-clockwise from outside
    albedo : (n,) float32 or None; brightness of each vertex, 0 to 1; None for the scene's surface
    spheres : (k, 4) float64, mm; centre and radius of the spheres that faces stand for
    sphere_of_face : (m,) int32; which sphere a face stands for, `FLAT` for none
        Rays that hit such a face are traced on to the sphere itself, without facets.

    Raises
    ------
    ValueError
        If an index points nowhere.
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    albedo: NDArray[np.float32] | None = None
    spheres: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    sphere_of_face: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, np.int32))

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "vertices_mm", np.ascontiguousarray(self.vertices_mm, np.float64))
        set_(self, "faces", np.ascontiguousarray(self.faces, np.int32))
        if not len(self.sphere_of_face):
            set_(self, "sphere_of_face", np.full(len(self.faces), FLAT, np.int32))
        if not (0 <= self.faces.min(initial=0) <= self.faces.max(initial=0) < self.n_vertices):
            raise ValueError("mesh: a face names a vertex that does not exist")
        if not np.isfinite(self.vertices_mm).all():
            raise ValueError("mesh: expected finite vertices, found NaN or infinity")

    @property
    def n_vertices(self) -> int:
        """Return the number of vertices."""
        return len(self.vertices_mm)

    def with_sphere(self, center_mm: ArrayLike, radius_mm: float) -> Self:
        """Let the faces whose vertices all lie on a sphere stand for that sphere."""
        center = np.asarray(center_mm, np.float64)
        distance = np.linalg.norm(self.vertices_mm - center, axis=1)
        on_sphere = (np.abs(distance - radius_mm) <= ON_SPHERE_MM)[self.faces].all(axis=1)
        owner = np.where(on_sphere, np.int32(len(self.spheres)), self.sphere_of_face)
        spheres = np.vstack([self.spheres, [*center, radius_mm]])
        return replace(self, spheres=spheres, sphere_of_face=owner)

    def moved(self, new_from_old: RigidTransform, /) -> Self:
        """Return the mesh after a rigid motion."""
        centers = new_from_old.apply(self.spheres[:, :3])
        return replace(
            self,
            vertices_mm=new_from_old.apply(self.vertices_mm),
            spheres=np.column_stack([centers, self.spheres[:, 3]]),
        )

    def scaled(self, factor: float, /) -> Self:
        """Return the mesh enlarged about its origin."""
        return replace(self, vertices_mm=self.vertices_mm * factor, spheres=self.spheres * factor)


def join(meshes: list[Mesh], /) -> Mesh:
    """Return several meshes as one."""
    first_vertex = np.cumsum([0, *(m.n_vertices for m in meshes[:-1])])
    first_sphere = np.cumsum([0, *(len(m.spheres) for m in meshes[:-1])])
    owners = [
        np.where(m.sphere_of_face == FLAT, FLAT, m.sphere_of_face + start)
        for m, start in zip(meshes, first_sphere, strict=True)
    ]
    brightness = None
    if any(m.albedo is not None for m in meshes):
        brightness = np.concatenate(
            [np.full(m.n_vertices, np.nan) if m.albedo is None else m.albedo for m in meshes]
        ).astype(np.float32)
    return Mesh(
        vertices_mm=np.concatenate([m.vertices_mm for m in meshes]),
        faces=np.concatenate([m.faces + i for m, i in zip(meshes, first_vertex, strict=True)]),
        albedo=brightness,
        spheres=np.concatenate([m.spheres for m in meshes]),
        sphere_of_face=np.concatenate(owners).astype(np.int32),
    )
