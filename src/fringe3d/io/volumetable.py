"""The ``[volume]`` table of rig files: what is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Literal

import numpy as np
import tomlkit
from pydantic import Field, field_validator

from fringe3d.io.toml import StrictModel
from fringe3d.model import Device, MeasuringVolume, Rig
from fringe3d.model.volume import BoxShape, CylinderShape, Shape, SlabShape

Vector3 = tuple[float, float, float]

KINDS = {BoxShape: "box", CylinderShape: "cylinder", SlabShape: "depth_slab"}


class BoxTable(StrictModel):
    """An axis-parallel box of the world frame."""

    kind: Literal["box"]
    min_mm: Vector3
    max_mm: Vector3


class CylinderTable(StrictModel):
    """A cylinder."""

    kind: Literal["cylinder"]
    center_mm: Vector3
    axis: Vector3
    radius_mm: float
    height_mm: float

    @field_validator("axis")
    @classmethod
    def _has_direction(cls, axis: Vector3) -> Vector3:
        if not any(axis):
            raise ValueError("expected a direction")
        return axis


class SlabTable(StrictModel):
    """The depths between two distances along the principal ray of a device."""

    kind: Literal["depth_slab"]
    device: str
    depth_min_mm: float
    depth_max_mm: float


class HalfSpacesTable(StrictModel):
    """Any convex volume: ``normals @ point <= offsets_mm``."""

    kind: Literal["half_spaces"]
    normals: list[Vector3]
    offsets_mm: list[float]


VolumeTable = Annotated[
    BoxTable | CylinderTable | SlabTable | HalfSpacesTable, Field(discriminator="kind")
]


def volume_of(
    table: BoxTable | CylinderTable | SlabTable | HalfSpacesTable | None,
    devices: Sequence[Device],
    /,
) -> MeasuringVolume | None:
    """Return the volume of a table; ValueError where its device is none of the rig."""
    match table:
        case None:
            return None
        case BoxTable():
            return MeasuringVolume.box(table.min_mm, table.max_mm)
        case CylinderTable():
            return MeasuringVolume.cylinder(
                table.center_mm, table.axis, radius_mm=table.radius_mm, height_mm=table.height_mm
            )
        case HalfSpacesTable():
            return MeasuringVolume(normals=table.normals, offsets_mm=table.offsets_mm)
        case SlabTable():
            named = {device.name: device for device in devices}
            if table.device not in named:
                raise ValueError(
                    f"volume: expected one of the devices {sorted(named)}, found '{table.device}'"
                )
            return MeasuringVolume.depth_slab(
                named[table.device],
                depth_min_mm=table.depth_min_mm,
                depth_max_mm=table.depth_max_mm,
            )


def require_visible(rig: Rig) -> None:
    """Raise ValueError for a volume that lies behind a device."""
    if rig.volume is None:
        return
    for device in rig.devices:
        forward, offset = (
            device.device_from_world.rotation[2],
            device.device_from_world.translation[2],
        )
        if _highest(rig.volume, forward) + offset <= 0:
            raise ValueError(
                f"volume: expected it in front of device '{device.name}', found it wholly behind "
                "(is the rotation inverted, or the volume in another frame?)"
            )


def _highest(volume: MeasuringVolume, direction: np.ndarray) -> float:
    """Return the largest ``direction @ point`` over a volume; infinite where it is open."""
    from scipy.optimize import linprog

    # Presolve calls some open volumes empty, as the slab of a device that looks elsewhere.
    result = linprog(-direction, A_ub=volume.normals, b_ub=volume.offsets_mm,
                     bounds=(None, None), options={"presolve": False})  # fmt: skip
    if result.status == 2:
        raise ValueError("volume: expected some points inside, found none (it is empty)")
    return -float(result.fun or 0.0) if result.status == 0 else float("inf")


def volume_table(volume: MeasuringVolume, rig: Rig, /) -> tomlkit.items.Table:
    """Describe a volume as it was made; by its half-spaces if that is not known any more."""
    table = tomlkit.table()
    shape = volume.shape
    if shape is not None and _still_holds(shape, volume, rig):
        table["kind"] = KINDS[type(shape)]
        table.update(
            {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(shape).items()}
        )
        return table
    table["kind"] = "half_spaces"
    normals = tomlkit.array()
    normals.extend(volume.normals.tolist())
    table["normals"] = normals.multiline(True)
    table["offsets_mm"] = volume.offsets_mm.tolist()
    return table


def _still_holds(shape: Shape, volume: MeasuringVolume, rig: Rig) -> bool:
    """Tell whether a slab belongs to a device as it stands in the rig: it may have moved since."""
    if not isinstance(shape, SlabShape):
        return True
    devices = {device.name: device for device in rig.devices}
    if shape.device not in devices:
        return False
    slab = MeasuringVolume.depth_slab(
        devices[shape.device], depth_min_mm=shape.depth_min_mm, depth_max_mm=shape.depth_max_mm
    )
    return np.array_equal(slab.normals, volume.normals) and np.array_equal(
        slab.offsets_mm, volume.offsets_mm
    )


def slab_text(device_name: str, depth_mm: tuple[float, float], /) -> str:
    """Return a ``[volume]`` table for a depth range along the principal ray of a device."""
    volume = {
        "kind": "depth_slab",
        "device": device_name,
        "depth_min_mm": depth_mm[0],
        "depth_max_mm": depth_mm[1],
    }
    return "\n" + tomlkit.dumps({"volume": volume})
