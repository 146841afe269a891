"""Devices that a knock moved since the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.model import Rig, RigidTransform


def knocked(
    rig: Rig, name: str, /, *, turn_deg: float, shift_mm: float, seed: int | Sequence[int]
) -> Rig:
    """Return a rig with one device turned about its centre and shifted, in random directions.

    Parameters
    ----------
    rig : Rig
    name : str; the device
    turn_deg : float, deg
    shift_mm : float, mm
    seed : int, or several; of the directions, as of ``numpy.random.default_rng``

    Raises
    ------
    ValueError
        If the rig has no such device.

    Examples
    --------
    >>> from fringe3d.simulate import PRESETS
    >>> rig = PRESETS["kolibri"]((640, 512)).rig
    >>> moved = knocked(rig, "c2", turn_deg=0.0, shift_mm=0.1, seed=0).cameras[1]
    >>> float(np.linalg.norm(moved.center_world - rig.cameras[1].center_world).round(6))
    0.1
    """
    names = [device.name for device in rig.devices]
    if name not in names:
        raise ValueError(f"knock: expected one of the devices {', '.join(names)}, found '{name}'")
    axis, way = np.random.default_rng(seed).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.radians(turn_deg) * axis / np.linalg.norm(axis)).as_matrix()
    knock = RigidTransform(rotation=turn, translation=shift_mm * way / np.linalg.norm(way))
    moved = [replace(d, device_from_world=knock @ d.device_from_world) if d.name == name else d
             for d in rig.devices]  # fmt: skip
    n_cameras = len(rig.cameras)
    return replace(
        rig,
        cameras=tuple(moved[:n_cameras]),
        projector=moved[n_cameras] if rig.projector is not None else None,
    )
