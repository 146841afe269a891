"""``noise.toml``: the noise model of each camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import tomlkit
from pydantic import Field

from fringe3d.errors import PlanError
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import NoiseModel


class CameraNoiseTable(StrictModel):
    """The noise of a grey value: ``read_noise_dn**2 + gain_dn_per_e * signal``."""

    name: str
    read_noise_dn: float = Field(ge=0)
    gain_dn_per_e: float = Field(default=0.0, ge=0)
    source: str = ""


class NoiseFileTable(StrictModel):
    """The whole file."""

    format: Literal["fringe3d-noise/1"]
    cameras: Annotated[list[CameraNoiseTable], Field(min_length=1)]


def read_noise(path: Path, /) -> dict[str, NoiseModel]:
    """Read a noise file: a model for each camera."""
    table = read_toml(path, NoiseFileTable, PlanError)
    return {
        camera.name: NoiseModel(
            read_noise_dn=camera.read_noise_dn, gain_dn_per_e=camera.gain_dn_per_e
        )
        for camera in table.cameras
    }


def noise_for(path: Path, models: Mapping[str, NoiseModel], camera: str, /) -> NoiseModel:
    """Return the model of a camera.

    Raises
    ------
    PlanError
        If there is none.
    """
    if camera in models:
        return models[camera]
    raise PlanError(
        f"{path}: expected the noise of camera '{camera}', found {list(models)}. Find it with "
        "fringe3d noise"
    )


def noise_text(models: Mapping[str, tuple[NoiseModel, str]], /) -> str:
    """Return the text of the noise file: for each camera its model and where it comes from."""
    table = NoiseFileTable(
        format="fringe3d-noise/1",
        cameras=[
            CameraNoiseTable(
                name=name,
                read_noise_dn=round(model.read_noise_dn, 5),
                gain_dn_per_e=round(model.gain_dn_per_e, 7),
                source=source,
            )
            for name, (model, source) in models.items()
        ],
    )
    return tomlkit.dumps(table.model_dump())
