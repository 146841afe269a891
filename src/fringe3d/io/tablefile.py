"""``table.toml``: where the axis of a rotary table is."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from fringe3d.errors import MethodError
from fringe3d.io.results import toml_document
from fringe3d.io.toml import StrictModel, read_toml
from fringe3d.model import TableAxis

FORMAT: Literal["fringe3d-table/1"] = "fringe3d-table/1"


class TableFile(StrictModel):
    """What the file holds; lengths in mm, in the world frame of the rig."""

    format: Literal["fringe3d-table/1"]
    point_mm: tuple[float, float, float]
    direction: tuple[float, float, float]
    shift_sigma_um: float | None = None
    lean_sigma_urad: float | None = None


def read_table_axis(path: Path, /) -> TableAxis:
    """Read the axis of a rotary table.

    Raises
    ------
    MethodError
        If the file is missing, or says something else.
    """
    table = read_toml(path, TableFile, MethodError)
    try:
        return TableAxis(point_mm=table.point_mm, direction=table.direction)
    except ValueError as problem:
        raise MethodError(f"{path}: {problem}. Correct it") from None


def table_text(axis: TableAxis, /, **more: float) -> str:
    """Return the axis as TOML, as `read_table_axis` reads it; `more` are its sigmas."""
    return toml_document({"format": FORMAT, "point_mm": axis.point_mm.tolist(),
                          "direction": axis.direction.tolist(), **more})  # fmt: skip
