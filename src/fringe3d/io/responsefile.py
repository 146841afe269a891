"""``response.toml``: how the grey values of each camera follow the patterns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tomlkit
from pydantic import Field, PositiveFloat

from fringe3d.errors import PlanError
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import Response, Ripple

DIGITS = 7


class RippleTable(StrictModel):
    """The ripple of one set of fringes: ``sum_k sines_rad[k - 1] sin(k n_shifts (phase - origin))``
    is added to its phase."""

    period_px: PositiveFloat
    angle_deg: float = 0.0
    n_shifts: Annotated[int, Field(ge=3)]
    origin_deg: float = 0.0
    sines_rad: list[float]

    def ripple(self) -> Ripple:
        """Return the ripple."""
        return Ripple(
            period_px=self.period_px,
            angle=math.radians(self.angle_deg),
            n_shifts=self.n_shifts,
            origin=math.radians(self.origin_deg),
            sines=tuple(self.sines_rad),
        )


class CameraResponseTable(StrictModel):
    """The response of one camera."""

    name: str
    source: str = ""
    gamma: float | None = None
    levels: list[float] = Field(default_factory=list)
    values: list[float] = Field(default_factory=list)
    ripples: list[RippleTable] = Field(default_factory=list)

    def response(self) -> Response:
        """Return the response."""
        return Response(
            device_name=self.name,
            levels=tuple(self.levels),
            values=tuple(self.values),
            ripples=tuple(table.ripple() for table in self.ripples),
            gamma=float("nan") if self.gamma is None else self.gamma,
            source=self.source,
        )


class ResponseTable(StrictModel):
    """The whole file."""

    format: Literal["fringe3d-response/1"]
    cameras: Annotated[list[CameraResponseTable], Field(min_length=1)]


def read_responses(path: Path, /) -> tuple[Response, ...]:
    """Read a response file, one response for each camera.

    Raises
    ------
    PlanError
        If it cannot be read, or a curve does not rise from 0 to 1.
    """
    table = read_toml(path, ResponseTable, PlanError)
    found = []
    for camera in table.cameras:
        try:
            found.append(camera.response())
        except ValueError as problem:
            raise PlanError(f"{path}: camera '{camera.name}': {problem}. Correct it") from None
    return tuple(found)


def response_for(path: Path, responses: Sequence[Response], camera: str, /) -> Response:
    """Return the response of a camera.

    Raises
    ------
    PlanError
        If there is none.
    """
    for response in responses:
        if response.device_name == camera:
            return response
    raise PlanError(
        f"{path}: expected the response of camera '{camera}', found "
        f"{[response.device_name for response in responses]}. Find it with fringe3d calibrate "
        "response"
    )


def mean_curve(path: Path, /) -> Response:
    """Return the curve with which patterns are projected: the mean of all cameras' curves.

    Raises
    ------
    PlanError
        If the file has no curve.
    """
    curves = [response for response in read_responses(path) if response.has_curve]
    if not curves:
        raise PlanError(
            f"{path}: expected the curve of a camera (levels and values), found ripples alone. "
            "Find it from a grey ramp (fringe3d patterns --ramp 17)"
        )
    levels = curves[0].levels
    values = np.mean([np.interp(levels, c.levels, c.values) for c in curves], axis=0)
    return Response(device_name="", levels=levels, values=tuple(values.tolist()))


def response_text(responses: Sequence[Response], /) -> str:
    """Return the text of the response file that `read_responses` reads back."""
    table = ResponseTable(
        format="fringe3d-response/1", cameras=[_camera_table(response) for response in responses]
    )
    return tomlkit.dumps(table.model_dump(exclude_defaults=True, exclude_none=True))


def _camera_table(response: Response) -> CameraResponseTable:
    return CameraResponseTable(
        name=response.device_name,
        source=response.source,
        gamma=round(response.gamma, 4) if math.isfinite(response.gamma) else None,
        levels=[round(level, DIGITS) for level in response.levels],
        values=[round(value, DIGITS) for value in response.values],
        ripples=[
            RippleTable(
                period_px=ripple.period_px,
                angle_deg=math.degrees(ripple.angle),
                n_shifts=ripple.n_shifts,
                origin_deg=math.degrees(ripple.origin),
                sines_rad=[round(float(sine), DIGITS) for sine in ripple.sines],
            )
            for ripple in response.ripples
        ],
    )
