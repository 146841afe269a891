"""Places of the projector around the reference point, by tilt and azimuth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.reference import reference_of, require_volume
from fringe3d.design.residual import cameras_of, unit
from fringe3d.model import Device, Rig, RigidTransform
from fringe3d.model.volume import BoxShape, CylinderShape

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stand:
    """Directions by which places around a rig are named.

    Tilt is counted from the upright, azimuth from where the cameras' middle leans to, towards
    the line from C1 to C2: as `geometry.above` has it for a rig above a table (upright z, cameras
    on the side of -y, C2 on that of +x).

    Parameters
    ----------
    point_mm : (3,) float, mm; the reference point
    upright : (3,) float; unit vector: the axis of a cylinder, the side of a box that faces the
        cameras, else the direction in which the rig faces
    sideways : (3,) float; unit vector from C1 to C2, square to the upright
    """

    point_mm: Array
    upright: Array
    sideways: Array

    @property
    def ahead(self) -> Array:
        """Return the unit vector at azimuth 0, (3,)."""
        return np.asarray(np.cross(self.sideways, self.upright))

    def direction(self, tilt: float, azimuth: float) -> Array:
        """Return the unit vector, (3,), from the reference point to a place; angles in rad."""
        level = np.sin(azimuth) * self.sideways + np.cos(azimuth) * self.ahead
        return np.asarray(np.sin(tilt) * level + np.cos(tilt) * self.upright)

    def angles_of(self, device: Device) -> tuple[float, float]:
        """Return tilt and azimuth of a device, rad."""
        towards = unit(device.center_world - self.point_mm)
        level = float(towards @ self.ahead), float(towards @ self.sideways)
        tilt = np.arctan2(np.hypot(*level), float(towards @ self.upright))
        return float(tilt), float(np.arctan2(level[1], level[0]))

    def separation(self, rig: Rig) -> float:
        """Return the angle, rad, at the reference point between projector and nearest camera."""
        light = unit(projector_of(rig).center_world - self.point_mm)
        towards = [unit(camera.center_world - self.point_mm) for camera in rig.cameras]
        sines = [float(np.linalg.norm(np.cross(light, camera))) for camera in towards]
        return float(min(np.arctan2(s, light @ c) for s, c in zip(sines, towards, strict=True)))

    def placed(self, rig: Rig, tilt: float, azimuth: float) -> Rig:
        """Return the rig with its projector at a place; distance, aim and roll stay as they are."""
        projector = projector_of(rig)
        away = projector.center_world - self.point_mm
        given = self._aimed(unit(away))
        direction = self.direction(tilt, azimuth)
        rotation = projector.device_from_world.rotation @ given.T @ self._aimed(direction)
        place = self.point_mm + np.linalg.norm(away) * direction
        pose = RigidTransform(rotation=rotation, translation=-rotation @ place)
        moved = replace(projector, device_from_world=pose)
        return replace(rig, projector=moved, covariance=None)

    def _aimed(self, direction: Array) -> Array:
        """Return the rotation (3, 3) into a frame that looks here, its rows along `sideways`."""
        forward = -direction
        right = unit(self.sideways - (self.sideways @ forward) * forward)
        return np.stack([right, np.cross(forward, right), forward])


def stand_of(rig: Rig, /) -> Stand:
    """Return the directions by which places around a rig are named.

    Raises
    ------
    RigError
        If there is no volume, no second camera, or if C1 does not see the volume.
    """
    camera1, camera2 = cameras_of(rig)
    reference, volume = reference_of(rig), require_volume(rig)
    match volume.shape:
        case CylinderShape(axis=axis):
            upright = unit(np.array(axis))
        case BoxShape():
            upright = np.eye(3)[np.argmax(np.abs(reference.facing))]
        case _:
            upright = reference.facing
    upright = upright * (1.0 if upright @ reference.facing >= 0 else -1.0)
    base = camera2.center_world - camera1.center_world
    sideways = unit(base - (base @ upright) * upright)
    return Stand(point_mm=reference.point_mm, upright=upright, sideways=sideways)
