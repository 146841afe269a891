"""A scene: the object, what it stands on, and how both reflect light."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import RigidTransform
from fringe3d.simulate.caster import Caster, Hits
from fringe3d.simulate.mesh import Mesh, join
from fringe3d.simulate.optics import Surface

PAPER = Surface(albedo=0.45, texture="mottled", contrast=0.3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What the devices look at.

    Parameters
    ----------
    thing : Mesh; the object, in its own frame
    surface : Surface; of the object
    world_from_object : RigidTransform
    surroundings : Mesh or None; in the world frame; what is lit and seen besides, as the table
    background : Surface; of the surroundings
    """

    thing: Mesh
    surface: Surface = field(default_factory=Surface)
    world_from_object: RigidTransform = field(default_factory=RigidTransform.identity)
    surroundings: Mesh | None = None
    background: Surface = PAPER

    @cached_property
    def caster(self) -> Caster:
        """Return the scene, prepared for ray casting (made once)."""
        moved = self.thing.moved(self.world_from_object)
        return Caster(moved if self.surroundings is None else join([moved, self.surroundings]))

    def placed(self, world_from_object: RigidTransform, /) -> Scene:
        """Return the scene with the object somewhere else."""
        return replace(self, world_from_object=world_from_object)

    def is_thing(self, hits: Hits, /) -> NDArray[np.bool_]:
        """Tell which hits lie on the object."""
        return np.asarray((hits.face >= 0) & (hits.face < len(self.thing.faces)))

    def reflectance(self, hits: Hits, /) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the albedo (0 in empty space) and the strength of gloss at hits, each (n,)."""
        on_thing = self.is_thing(hits)
        own = self.world_from_object.inverse().apply(hits.points_mm)
        albedo = np.where(
            on_thing,
            _albedo(self.surface, own, hits.albedo),
            _albedo(self.background, hits.points_mm, hits.albedo),
        )
        gloss = np.where(on_thing, self.surface.gloss, self.background.gloss)
        return np.where(hits.is_hit, albedo, 0.0), gloss


def _albedo(
    surface: Surface, points: NDArray[np.float64], painted: NDArray[np.float32]
) -> NDArray[np.float64]:
    base = np.where(np.isnan(painted), surface.albedo, painted)
    return np.asarray(base * (1 - surface.contrast * _texture(surface, points)))


def _texture(surface: Surface, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how dark a solid texture is at points of the object, 0 to 1."""
    x, y, z = np.moveaxis(points, -1, 0) / surface.texture_mm
    match surface.texture:
        case "mottled":
            waves = np.sin(1.9 * x + 0.7 * y + 0.4 * z) * np.sin(1.3 * y - 0.6 * x + z)
            return np.asarray(0.5 + 0.5 * waves * np.sin(0.9 * z + 0.8 * x - 0.5 * y))
        case "checker":
            return np.asarray((np.floor(x) + np.floor(y) + np.floor(z)) % 2)
        case "speckle":
            # A hash of the cell: the same dot whatever the ray.
            cell = np.floor(np.stack([x, y, z]) * 4)
            mixed = np.sin(cell[0] * 12.9898 + cell[1] * 78.233 + cell[2] * 37.719) * 43758.5453
            return np.asarray(mixed - np.floor(mixed))
        case _:
            return np.zeros(len(points))


def table(*, height_mm: float, width_mm: float) -> Mesh:
    """Return a slab whose top lies at z = `height_mm`, world frame."""
    half, top = width_mm / 2, height_mm
    x, y, z = np.array([(x, y, z) for z in (top - 0.02 * width_mm, top)
                        for y in (-half, half) for x in (-half, half)]).T  # fmt: skip
    faces = [(4, 5, 7), (4, 7, 6), (0, 3, 1), (0, 2, 3), (0, 1, 5), (0, 5, 4),
             (2, 7, 3), (2, 6, 7), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)]  # fmt: skip
    return Mesh(vertices_mm=np.stack([x, y, z], axis=1), faces=np.array(faces, np.int32))
