"""``rig.toml``: the calibration of a rig."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import Field

from fringe3d.errors import RigError
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.io.volumetable import VolumeTable, require_visible, volume_of, volume_table
from fringe3d.model import (
    CalibrationBias,
    Device,
    Rig,
    RigCovariance,
    RigidTransform,
)
from fringe3d.model.bias import N_TERMS

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]

FORMAT = "fringe3d-rig/1"


class DeviceTable(StrictModel):
    """One ``[[devices]]`` entry; `rotation` and `translation_mm` are ``device_from_world``."""

    name: str
    role: Literal["camera", "projector"]
    size: tuple[int, int]
    focal_px: Vector2
    center_px: Vector2
    distortion: list[float] = Field(default_factory=list)
    rotation: tuple[Vector3, Vector3, Vector3] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    translation_mm: Vector3 = (0, 0, 0)

    def device(self) -> Device:
        """Return the device."""
        try:
            pose = RigidTransform(rotation=self.rotation, translation=self.translation_mm)
        except ValueError as problem:
            raise ValueError(f"device '{self.name}': {problem}") from None
        width, height = self.size
        return Device(
            name=self.name,
            role=self.role,
            n_rows=height,
            n_cols=width,
            focal_px=self.focal_px,
            center_px=self.center_px,
            distortion=self.distortion,
            device_from_world=pose,
        )


Terms = Annotated[list[float], Field(min_length=N_TERMS, max_length=N_TERMS)]


class BiasTable(StrictModel):
    """``[bias]``: what the calibration of these devices misses; see `CalibrationBias`."""

    devices: str
    angle_deg: float
    coefficients_px: tuple[Terms, Terms]
    middle: Vector3
    scale: Vector3
    scatter_px: float = Field(ge=0)
    sigma_px: float = Field(ge=0)
    covariance_px2: list[list[float]] | None = None
    source: str = ""

    def bias(self, devices: Sequence[Device]) -> CalibrationBias:
        """Return the bias, if it belongs to the devices."""
        if self.devices != fingerprint(devices):
            raise ValueError(
                "bias: expected one that was learnt with the devices of this file "
                f"({fingerprint(devices)}), found one of other devices ({self.devices}). Take the "
                "[bias] table out, or learn it again (fringe3d calibrate bias)"
            )
        return CalibrationBias(
            coefficients_px=np.array(self.coefficients_px),
            middle=np.array(self.middle),
            scale=np.array(self.scale),
            scatter_px=self.scatter_px,
            sigma_px=self.sigma_px,
            covariance_px2=None
            if self.covariance_px2 is None
            else _symmetric("bias: covariance_px2", self.covariance_px2, 2 * N_TERMS),
            angle=math.radians(self.angle_deg),
            source=self.source,
        )


class CovarianceTable(StrictModel):
    """``[covariance]``: how certain the numbers of these devices are; see `RigCovariance`."""

    devices: str
    names: list[str]
    lower_triangle: list[list[float]]

    def covariance(self, devices: Sequence[Device]) -> RigCovariance:
        """Return the covariance, if it belongs to the devices."""
        if self.devices != fingerprint(devices):
            raise ValueError(
                "covariance: expected that of the devices of this file "
                f"({fingerprint(devices)}), found one of other devices ({self.devices}). Take the "
                "[covariance] table out, or calibrate again"
            )
        size = len(self.names)
        matrix = _symmetric("covariance: lower_triangle", self.lower_triangle, size)
        return RigCovariance(names=tuple(self.names), matrix=matrix)


def _symmetric(name: str, lower_triangle: list[list[float]], size: int) -> NDArray[np.float64]:
    """Return a matrix of which the file has the rows up to the diagonal."""
    if [len(row) for row in lower_triangle] != list(range(1, size + 1)):
        raise ValueError(
            f"{name}: expected rows of 1 to {size} numbers, found {len(lower_triangle)} rows of "
            f"{', '.join(str(len(row)) for row in lower_triangle)} numbers"
        )
    matrix = np.zeros((size, size))
    for number, row in enumerate(lower_triangle):
        matrix[number, : number + 1] = matrix[: number + 1, number] = row
    return matrix


def _rows(matrix: NDArray[np.float64]) -> tomlkit.items.Array:
    rows = tomlkit.array()
    rows.extend([
        [float(f"{number:.9g}") for number in row[: place + 1]]
        for place, row in enumerate(matrix.tolist())
    ])  # fmt: skip
    return rows.multiline(True)


def fingerprint(devices: Sequence[Device], /) -> str:
    """Return a short text that differs where calibrated devices differ."""
    numbers = [
        np.concatenate([d.focal_px, d.center_px, d.distortion, d.device_from_world.translation,
                        d.device_from_world.rotation.ravel(), [d.n_rows, d.n_cols]])
        for d in devices
    ]  # fmt: skip
    return hashlib.sha256(np.concatenate(numbers).astype("<f8").tobytes()).hexdigest()[:16]


class RigTable(StrictModel):
    """The whole file."""

    format: Literal["fringe3d-rig/1"]
    provenance: str = ""
    devices: list[DeviceTable]
    volume: VolumeTable | None = None
    bias: BiasTable | None = None
    covariance: CovarianceTable | None = None


def read_rig(path: Path, /) -> Rig:
    """Read a rig.

    Raises
    ------
    RigError
        Where, what was expected, what was found.
    """
    table = read_toml(path, RigTable, RigError)
    try:
        devices = [entry.device() for entry in table.devices]
        projectors = [device for device in devices if device.role == "projector"]
        if len(projectors) > 1:
            raise ValueError(f"rig: expected at most one projector, found {len(projectors)}")
        rig = Rig(
            cameras=tuple(device for device in devices if device.role == "camera"),
            projector=projectors[0] if projectors else None,
            volume=volume_of(table.volume, devices),
            provenance=table.provenance,
        )
        if table.bias is not None:
            rig = replace(rig, bias=table.bias.bias(rig.devices))
        if table.covariance is not None:
            rig = replace(rig, covariance=table.covariance.covariance(rig.devices))
        require_visible(rig)
    except ValueError as problem:
        raise RigError(f"{path}: {problem}. Correct the file") from None
    return rig


def rig_text(rig: Rig, /) -> str:
    """Return the text of the rig file that `read_rig` reads back."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Lengths in mm, pixels with (0, 0) at the centre of the first."))
    document.add(tomlkit.comment("rotation, translation_mm: X_device = R X_world + T"))
    document["format"] = FORMAT
    if rig.provenance:
        document["provenance"] = rig.provenance
    devices = tomlkit.aot()
    for device in rig.devices:
        table = tomlkit.table()
        table["name"] = device.name
        table["role"] = device.role
        table["size"] = [device.n_cols, device.n_rows]
        table["focal_px"] = device.focal_px.tolist()
        table["center_px"] = device.center_px.tolist()
        table["distortion"] = _trimmed(device)
        rotation = tomlkit.array()
        rotation.extend(device.device_from_world.rotation.tolist())
        table["rotation"] = rotation.multiline(True)
        table["translation_mm"] = device.device_from_world.translation.tolist()
        devices.append(table)
    document["devices"] = devices
    if rig.volume is not None:
        document["volume"] = volume_table(rig.volume, rig)
    if rig.bias is not None:
        document["bias"] = _bias_table(rig.bias, rig)
    if rig.covariance is not None:
        document["covariance"] = _covariance_table(rig.covariance, rig)
    return tomlkit.dumps(document)


def _bias_table(bias: CalibrationBias, rig: Rig) -> tomlkit.items.Table:
    table = tomlkit.table()
    table["devices"] = fingerprint(rig.devices)
    table["angle_deg"] = math.degrees(bias.angle)
    table["coefficients_px"] = bias.coefficients_px.tolist()
    table["middle"], table["scale"] = bias.middle.tolist(), bias.scale.tolist()
    table["scatter_px"], table["sigma_px"] = bias.scatter_px, bias.sigma_px
    table["source"] = bias.source
    if bias.covariance_px2 is not None:
        table["covariance_px2"] = _rows(bias.covariance_px2)
    return table


def _covariance_table(covariance: RigCovariance, rig: Rig) -> tomlkit.items.Table:
    table = tomlkit.table()
    table["devices"] = fingerprint(rig.devices)
    table["names"] = list(covariance.names)
    table["lower_triangle"] = _rows(covariance.matrix)
    return table


def _trimmed(device: Device) -> list[float]:
    """Return the distortion without the zeros at its end, in a length that OpenCV knows."""
    used = int(np.flatnonzero(device.distortion).max(initial=-1)) + 1
    length = next(n for n in (0, 4, 5, 8, 12, 14) if n >= used)
    coefficients: list[float] = device.distortion[:length].tolist()
    return coefficients
