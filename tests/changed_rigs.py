"""Rigs and their devices with changes: in another world frame, turned, cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform


def moved_device(device: Device, new_from_old: RigidTransform) -> Device:
    pose = device.device_from_world @ new_from_old.inverse()
    return replace(device, device_from_world=pose)


def moved_volume(volume: MeasuringVolume, new_from_old: RigidTransform) -> MeasuringVolume:
    normals = volume.normals @ new_from_old.rotation.T
    return MeasuringVolume(
        normals=normals, offsets_mm=volume.offsets_mm + normals @ new_from_old.translation
    )


def moved_rig(rig: Rig, new_from_old: RigidTransform) -> Rig:
    """Return a rig of two cameras, projector and volume after the world was moved."""
    assert rig.projector is not None
    assert rig.volume is not None
    return replace(
        rig,
        cameras=tuple(moved_device(camera, new_from_old) for camera in rig.cameras),
        projector=moved_device(rig.projector, new_from_old),
        volume=moved_volume(rig.volume, new_from_old),
    )


def turned(device: Device, axis: str, degrees: float) -> Device:
    """Return a device turned about an axis of its own frame: a wrong calibration."""
    rotation = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    turn = RigidTransform(rotation=rotation, translation=np.zeros(3))
    return replace(device, device_from_world=turn @ device.device_from_world)


def cut_rig(rig: Rig, half_height_mm: float) -> Rig:
    """Return `kolibri` with 160 x 128 px in the middle of C1's image and a flat, wide volume.

    Of its 640 x 512 px all other devices see them, whatever the height; and every ray enters the
    volume at its top and leaves it at its bottom.
    """
    c1, *others = rig.cameras
    middle = replace(c1, n_rows=128, n_cols=160, center_px=c1.center_px - [240.0, 192.0])
    volume = MeasuringVolume.box([-80, -80, -half_height_mm], [80, 80, half_height_mm])
    return replace(rig, cameras=(middle, *others), volume=volume)


def with_wide_c2(rig: Rig) -> Rig:
    """Return a `small_rig` whose C2, a pinhole of 280 x 200 px, sees more than C1.

    Whatever order is taken for a pixel, its point is in the image of C2.
    """
    c1, c2 = rig.cameras
    c2 = replace(c2, n_cols=280, n_rows=200, center_px=c2.center_px + np.array([60.0, 36.0]),
                 distortion=np.zeros(4))  # fmt: skip
    return replace(rig, cameras=(c1, c2))
