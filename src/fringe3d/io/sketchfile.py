"""A sketch of a rig: distances, angles and chip sizes, for planning without a calibration."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from fringe3d.errors import Fringe3DError, RigError
from fringe3d.geometry import above, looking_at
from fringe3d.io.rigfile import read_rig
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import Device, MeasuringVolume, Rig

FORMAT = "fringe3d-sketch/1"

Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class SketchDevice(StrictModel):
    """One ``[[devices]]`` entry: where a camera or projector stands and what chip it has."""

    name: str
    role: Literal["camera", "projector"]
    size: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    pixel_um: Positive | None = None
    focal_mm: Positive | None = None
    field_mm: Positive | None = None
    center_px: tuple[float, float] | None = None
    distance_mm: Positive | None = None
    tilt_deg: float | None = None
    azimuth_deg: float | None = None
    position_mm: Vector3 | None = None
    look_at_mm: Vector3 | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> SketchDevice:
        metric, field = (self.pixel_um, self.focal_mm), (self.field_mm,)
        _require_one("pixel_um and focal_mm", metric, "field_mm", field)
        angles = (self.distance_mm, self.tilt_deg, self.azimuth_deg)
        _require_one("distance_mm, tilt_deg and azimuth_deg", angles, "position_mm",
                     (self.position_mm,))  # fmt: skip
        if self.look_at_mm is not None and self.position_mm is None:
            raise ValueError("look_at_mm: expected it beside position_mm, found it without")
        return self

    def device(self) -> Device:
        """Return the device: without distortion, its rows along x, at the place of the sketch."""
        width, height = self.size
        target = np.asarray(self.look_at_mm or (0.0, 0.0, 0.0))
        if self.position_mm is not None:
            place = np.asarray(self.position_mm, np.float64)
        else:
            assert self.tilt_deg is not None
            assert self.azimuth_deg is not None
            assert self.distance_mm is not None
            place = above(self.tilt_deg, self.azimuth_deg, self.distance_mm)
        if self.field_mm is not None:
            focal = width * float(np.linalg.norm(place - target)) / self.field_mm
        else:
            assert self.focal_mm is not None
            assert self.pixel_um is not None
            focal = 1000 * self.focal_mm / self.pixel_um
        try:
            pose = looking_at(place, target)
        except ValueError as problem:
            raise ValueError(f"device '{self.name}': {problem}") from None
        return Device(
            name=self.name,
            role=self.role,
            n_rows=height,
            n_cols=width,
            focal_px=[focal, focal],
            center_px=self.center_px or ((width - 1) / 2, (height - 1) / 2),
            device_from_world=pose,
        )


def _require_one(
    first: str, values: tuple[object, ...], second: str, others: tuple[object, ...]
) -> None:
    """Refuse anything but all of the one kind of values and none of the other."""
    given, other = ([v is not None for v in group] for group in (values, others))
    if (all(given) and not any(other)) or (all(other) and not any(given)):
        return
    if any(given) and any(other):
        found = "some of both"
    elif any(given) or any(other):
        found = "only a part"
    else:
        found = "none of them"
    raise ValueError(f"expected either {first}, or {second}, found {found}")


class BoxSketch(StrictModel):
    """A box about the world's origin, its edges along the axes."""

    kind: Literal["box"]
    size_mm: tuple[Positive, Positive, Positive]


class CylinderSketch(StrictModel):
    """An upright cylinder about the world's origin."""

    kind: Literal["cylinder"]
    diameter_mm: Positive
    height_mm: Positive


class DepthSketch(StrictModel):
    """The depths between two distances along the principal ray of the first camera."""

    kind: Literal["depth"]
    depth_min_mm: Positive
    depth_max_mm: Positive


VolumeSketch = Annotated[BoxSketch | CylinderSketch | DepthSketch, Field(discriminator="kind")]


class FringesSketch(StrictModel):
    """What is to be projected."""

    period_px: Annotated[float, Field(ge=2)]
    angle_deg: float = 0.0
    steps: Annotated[int, Field(ge=3)] = 4


class SketchTable(StrictModel):
    """The whole file."""

    format: Literal["fringe3d-sketch/1"]
    title: str = ""
    devices: list[SketchDevice]
    volume: VolumeSketch | None = None
    fringes: FringesSketch | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sketch:
    """A rig to plan with, and the fringes meant for it.

    Parameters
    ----------
    rig : Rig
    period_px : float or None, projector px
    angle : float, rad; of the fringes
    n_shifts : int or None; phase steps
    """

    rig: Rig
    period_px: float | None = None
    angle: float = 0.0
    n_shifts: int | None = None


def read_sketch(path: Path, /) -> Sketch:
    """Read a rig sketch (``format = "fringe3d-sketch/1"``) or a rig file.

    A sketch has one ``[[devices]]`` entry for each camera and projector: `name`, `role`, `size`
    (px), the lens (`pixel_um` and `focal_mm`, or `field_mm`: what the image's width covers at the
    distance of the point looked at), the place (`distance_mm`, `tilt_deg` from the vertical z,
    `azimuth_deg` from -y towards x, looking at the origin; or `position_mm` and `look_at_mm`).
    ``[volume]`` is a box, a cylinder or a depth range, ``[fringes]`` what to project.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Sketch
        Of a rig file, which says nothing of fringes, the rig alone.

    Raises
    ------
    RigError
        Where, what was expected, what was found.
    """
    if not _is_sketch(path):
        return Sketch(rig=read_rig(path))
    _require_known_keys(path)
    table = read_toml(path, SketchTable, RigError)
    try:
        rig = _rig(table)
    except Fringe3DError:
        raise
    except ValueError as problem:
        raise RigError(f"{path}: {problem}. Correct the sketch") from None
    if table.fringes is None:
        return Sketch(rig=rig)
    return Sketch(
        rig=rig,
        period_px=table.fringes.period_px,
        angle=math.radians(table.fringes.angle_deg),
        n_shifts=table.fringes.steps,
    )


def _is_sketch(path: Path) -> bool:
    """Tell whether a file says that it is a sketch; any doubt is left to the rig reader."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    return str(table.get("format", "")).startswith("fringe3d-sketch")


VOLUMES: dict[str, type[StrictModel]] = {
    "box": BoxSketch,
    "cylinder": CylinderSketch,
    "depth": DepthSketch,
}


def _require_known_keys(path: Path) -> None:
    """Refuse keys that the table in which they stand does not have, though another one may."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    if table["format"] != FORMAT:
        return  # another version: its keys are not known here
    for where, of, schema, values in _tables(table):
        for key in values:
            if key in schema.model_fields:
                continue
            known = sorted(schema.model_fields)
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"Did you mean '{close[0]}'?" if close else f"The keys {of}: {', '.join(known)}"
            raise RigError(f"{path}: unknown key '{where}{key}'. {hint}")


def _tables(table: dict[str, Any]) -> Iterator[tuple[str, str, type[StrictModel], dict[str, Any]]]:
    """Yield the tables of a sketch: where they stand, what they are, schema and values."""
    yield "", "of a sketch", SketchTable, table
    devices = table.get("devices")
    for number, values in enumerate(devices if isinstance(devices, list) else []):
        if isinstance(values, dict):
            yield f"devices[{number}].", "of a device", SketchDevice, values
    volume, fringes = table.get("volume"), table.get("fringes")
    kind = volume.get("kind") if isinstance(volume, dict) else None
    if isinstance(volume, dict) and isinstance(kind, str) and kind in VOLUMES:
        yield "volume.", f"of the kind '{kind}'", VOLUMES[kind], volume
    if isinstance(fringes, dict):
        yield "fringes.", "of the fringes", FringesSketch, fringes


def _rig(table: SketchTable) -> Rig:
    devices = [entry.device() for entry in table.devices]
    cameras = tuple(device for device in devices if device.role == "camera")
    projectors = [device for device in devices if device.role == "projector"]
    if len(projectors) > 1:
        raise ValueError(f"rig: expected at most one projector, found {len(projectors)}")
    rig = Rig(
        cameras=cameras,
        projector=projectors[0] if projectors else None,
        provenance=f"sketch {table.title}".strip(),
    )
    return replace(rig, volume=_volume(table, rig.cameras[0]))


def _volume(table: SketchTable, first: Device) -> MeasuringVolume | None:
    match table.volume:
        case None:
            return None
        case BoxSketch(size_mm=size):
            return MeasuringVolume.box(-np.asarray(size) / 2, np.asarray(size) / 2)
        case CylinderSketch(diameter_mm=diameter, height_mm=height):
            return MeasuringVolume.cylinder(
                [0, 0, 0], [0, 0, 1], radius_mm=diameter / 2, height_mm=height
            )
        case DepthSketch(depth_min_mm=low, depth_max_mm=high):
            return MeasuringVolume.depth_slab(first, depth_min_mm=low, depth_max_mm=high)
