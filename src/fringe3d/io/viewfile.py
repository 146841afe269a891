"""Views of a body on disk: what ``merge`` keeps of each scan, named by a hash of its sources."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fringe3d import __version__
from fringe3d.io.atomic import new_file
from fringe3d.model import Device, RigidTransform

READ = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".npy", ".toml")
NOT_READ = ("overview.png", "true-rig.toml", "simulation.toml")

Floats = NDArray[np.float64]


def view_key(scan: Path, more: Iterable[Path | None], options: dict[str, Any], /) -> str:
    """Return a name for what follows from a scan, further files or folders, and options."""
    digest = hashlib.sha256(f"{__version__} {json.dumps(options, sort_keys=True)}".encode())
    for path in (scan, *more):
        for file in _files(path) if path is not None else ():
            digest.update(str(file.name).encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    found = (f for f in path.rglob("*") if f.suffix.lower() in READ and f.name not in NOT_READ)
    return sorted(f for f in found if f.is_file())


def write_view(path: Path, arrays: dict[str, NDArray[Any]], about: dict[str, Any], /) -> None:
    """Write a view, completely or not at all.

    Parameters
    ----------
    path : Path; NPZ; replaced where it is there
    arrays : dict; ``points_mm`` (row, col, 3), ``sigma_mm``, ``grey`` (row, col)
    about : dict; plain data: the rig as text, the table, what was measured and found
    """
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    with new_file(path, overwrite=True) as aside, aside.open("wb") as file:
        np.savez(file, allow_pickle=False, about=text, **arrays)


def read_view(path: Path, /) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Read what `write_view` wrote; None where it is not there, or not whole."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return arrays, json.loads(arrays.pop("about").tobytes())
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def camera_table(camera: Device, /) -> dict[str, Any]:
    """Return a device as plain data, to the last bit; see `camera_of`."""
    pose = camera.device_from_world
    return {
        "name": camera.name, "role": camera.role, "n_rows": camera.n_rows, "n_cols": camera.n_cols,
        "focal_px": camera.focal_px.tolist(), "center_px": camera.center_px.tolist(),
        "distortion": camera.distortion.tolist(), "rotation": pose.rotation.tolist(),
        "translation": pose.translation.tolist(),
    }  # fmt: skip


def camera_of(table: dict[str, Any], /) -> Device:
    """Return the device that `camera_table` describes."""
    pose = RigidTransform(rotation=table["rotation"], translation=table["translation"])
    rest = {k: v for k, v in table.items() if k not in ("rotation", "translation")}
    return Device(device_from_world=pose, **rest)
