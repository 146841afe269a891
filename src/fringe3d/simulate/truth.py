"""What is true for the centre of each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import pixel_grid, project, rays
from fringe3d.model import Device, Rig
from fringe3d.simulate.footprint import inside
from fringe3d.simulate.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What a camera sees at its pixel centres, (row, col, ...); NaN where it sees nothing.

    Parameters
    ----------
    device_name : str; the camera
    points_mm : (row, col, 3) float64; world frame
    normals : (row, col, 3) float64; unit length, outwards
    projector_xy : (row, col, 2) float64, px
    lit : (row, col) bool; the projector lights the point
    in_volume : (row, col) bool; all True without a measuring volume
    is_object : (row, col) bool; the point lies on the object, not on its surroundings
    pixels : dict of str to (row, col, 2) float64, px; where the other cameras see the point
    seen_by : dict of str to (row, col) bool; whether they see it: in view, and nothing between
    """

    device_name: str
    points_mm: NDArray[np.float64]
    normals: NDArray[np.float64]
    projector_xy: NDArray[np.float64]
    lit: NDArray[np.bool_]
    in_volume: NDArray[np.bool_]
    is_object: NDArray[np.bool_]
    pixels: dict[str, NDArray[np.float64]]
    seen_by: dict[str, NDArray[np.bool_]]


def trace(camera: Device, rig: Rig, scene: Scene, /) -> Truth:
    """Follow the ray of each pixel centre (an ideal pinhole, no aperture).

    Parameters
    ----------
    camera : Device; one of the rig's
    rig : Rig with a projector
    scene : Scene
    """
    assert rig.projector is not None
    origin, directions = rays(camera, pixel_grid(camera.shape).reshape(-1, 2))
    hits = scene.caster.cast(origin, directions)

    def seen_by(device: Device) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        pixels = project(device, hits.points_mm)
        seen = inside(device, pixels)
        seen[seen] = scene.caster.sees(hits.points_mm[seen], hits.normals[seen],
                                       device.center_world)  # fmt: skip
        return pixels.reshape(*camera.shape, 2), seen.reshape(camera.shape)

    projector_xy, lit = seen_by(rig.projector)
    others = {other.name: seen_by(other) for other in rig.cameras if other.name != camera.name}
    in_volume = hits.is_hit
    if rig.volume is not None:
        in_volume = rig.volume.contains(hits.points_mm)
    return Truth(
        device_name=camera.name,
        points_mm=hits.points_mm.reshape(*camera.shape, 3),
        normals=hits.normals.reshape(*camera.shape, 3),
        projector_xy=projector_xy,
        lit=lit,
        in_volume=in_volume.reshape(camera.shape),
        is_object=scene.is_thing(hits).reshape(camera.shape),
        pixels={name: pixels for name, (pixels, _) in others.items()},
        seen_by={name: seen for name, (_, seen) in others.items()},
    )
