"""What a measurement leaves: NPZ, PLY and TOML."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import tomlkit
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import PointCloud, Rejection

PLY_VERTEX = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
     ("sigma_mm", "<f4")]
)  # fmt: skip


def write_ply(path: Path, cloud: PointCloud, /, *, comment: str = "") -> None:
    """Write a cloud as binary PLY: position in mm, grey as colour, sigma along the ray.

    Coordinates are single precision: 0.03 um at 500 mm.
    """
    vertices = np.empty(len(cloud.points_mm), PLY_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = cloud.points_mm[:, axis]
    for name in ("red", "green", "blue"):
        vertices[name] = cloud.grey
    vertices["sigma_mm"] = cloud.sigma_mm
    kinds = {"<f4": "float", "|u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {comment}"] if comment else []
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {kinds[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()]
    path.write_bytes("\n".join([*header, "end_header\n"]).encode("ascii") + vertices.tobytes())


def write_points(path: Path, maps: dict[str, NDArray[Any]], /) -> None:
    """Write maps on the grid of C1 as NPZ, with the names of the rejection bits."""
    names = np.array([reason.name for reason in Rejection])
    np.savez_compressed(path, allow_pickle=False, rejection_names=names, **maps)


def read_points_mm(path: Path, /, *, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Read the points of an earlier result, (row, col, 3) mm; NaN where there are none.

    Parameters
    ----------
    path : Path; folder of the result, or its points.npz
    shape : (n_rows, n_cols) of C1

    Raises
    ------
    MethodError
        If there are none, or they belong to another camera.
    """
    path = path / "points.npz" if path.is_dir() else path
    try:
        with np.load(path, allow_pickle=False) as maps:
            points = np.asarray(maps["points_mm"], np.float64)
    except (OSError, KeyError, ValueError, BadZipFile):
        raise MethodError(
            f"{path}: expected the points of an earlier measurement (points.npz), found none. Name "
            "the folder that fringe3d measure --out left"
        ) from None
    if points.shape != (*shape, 3):
        raise MethodError(
            f"{path}: expected points on the {shape[0]} x {shape[1]} pixels (rows x columns) of "
            f"C1, found {' x '.join(map(str, points.shape[:2]))}. Name a result of the same camera"
        )
    return points


def toml_document(table: dict[str, Any], /) -> str:
    """Return nested tables as TOML text; None and NaN values are left out."""
    return tomlkit.dumps(_plain(table))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items() if v is not None and v == v}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
