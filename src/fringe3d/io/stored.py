"""Reading back what a measurement left."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Rejection, Rig
from fringe3d.model.html import picture, table

MAPS = ("points_mm", "sigma_mm", "skew_mm", "offset", "modulation", "order_probability")
RECORD = ("summary", "time", "versions", "method", "why_this_method", "images_used", "images",
          "decoding", "health", "options", "seconds")  # fmt: skip
"""What every result holds in ``points.npz`` and ``measure.toml``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredResult:
    """A result folder.

    Parameters
    ----------
    folder : Path
    record : dict; what ``measure.toml`` says
    maps : dict of (row, col, ...) arrays; those of ``points.npz``
    rig : Rig or None; with which it was measured, where it was kept
    """

    folder: Path
    record: dict[str, Any]
    maps: dict[str, NDArray[Any]]
    rig: Rig | None

    @property
    def rejection(self) -> NDArray[np.uint32]:
        """Return the `Rejection` bits, (row, col)."""
        return np.asarray(self.maps["rejection"], np.uint32)

    def _repr_html_(self) -> str:
        rows = [(name, self.record[name]) for name in ("summary", "time", "why_this_method")]
        rows += [(f["level"], f["text"]) for f in self.record["health"] if f["level"] != "ok"]
        return table(f"result {self.folder}", rows, more=picture(self.maps["points_mm"][..., 2]))


def read_result(folder: Path, /) -> StoredResult:
    """Read the folder that ``fringe3d measure --out`` left.

    Raises
    ------
    MethodError
        If it is none, has phases alone, or is damaged.
    """
    to_do = "Name the folder that fringe3d measure --out left"
    if not folder.is_dir():
        raise MethodError(f"{folder}: expected the folder of a result, found none. {to_do}")
    if (folder / "phase.npz").is_file():
        raise MethodError(
            f"{folder}: expected points (points.npz), found phases alone (phase.npz): the scan has "
            "no rig. Measure it with --rig, or look at overview.png"
        )
    try:
        record = tomllib.loads((folder / "measure.toml").read_text(encoding="utf-8"))
        with np.load(folder / "points.npz", allow_pickle=False) as stored:
            maps = {name: stored[name] for name in stored.files}
        names = [str(name) for name in maps.pop("rejection_names")]
        _require_maps(maps, names)
        if missing_keys := [key for key in RECORD if key not in record]:
            raise ValueError(f"measure.toml: expected {', '.join(missing_keys)}")
    except FileNotFoundError as problem:
        missing = Path(str(problem.filename)).name
        raise MethodError(
            f"{folder}: expected the result of a measurement, found no {missing}. {to_do}"
        ) from None
    except (OSError, KeyError, ValueError, EOFError, BadZipFile) as problem:
        raise MethodError(
            f"{folder}: expected the result of a measurement, found a damaged one ({problem}). "
            "Measure again"
        ) from None
    rig = read_rig(folder / "rig.toml") if (folder / "rig.toml").is_file() else None
    return StoredResult(folder=folder, record=record, maps=maps, rig=rig)


def _require_maps(maps: dict[str, NDArray[Any]], names: list[str]) -> None:
    """Raise ValueError if maps are missing, do not fit each other, or mean something else."""
    known = [reason.name for reason in Rejection]
    if names != known[: len(names)]:
        raise ValueError(f"rejection_names: expected {known}, found {names}")
    shape = maps["rejection"].shape
    for name in MAPS:
        if len(shape) != 2 or maps[name].shape != shape + (3,) * (name == "points_mm"):
            raise ValueError(f"{name}: expected a map of {shape}, found {maps[name].shape}")


def angle_of(direction: str, /) -> float:
    """Return the angle of fringes, rad, from the name that the record gives their direction.

    Examples
    --------
    >>> angle_of("x"), angle_of("180deg") == np.pi
    (0.0, True)
    """
    named = {"x": 0.0, "y": np.pi / 2}
    return named[direction] if direction in named else math.radians(float(direction[:-3]))
