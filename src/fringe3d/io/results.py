"""What a measurement leaves: NPZ, PLY and TOML."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import tomlkit
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import PointCloud, Rejection

VIEWPOINT = "viewpoint_mm"
"""Comment in PLY files: from where the points were seen."""


def write_ply(
    path: Path,
    cloud: PointCloud,
    /,
    *,
    comment: str = "",
    viewpoint_mm: NDArray[np.float64] | None = None,
    **more: NDArray[np.floating[Any]],
) -> None:
    """Write a cloud as binary PLY: position in mm, grey as colour, sigma along the ray, and more.

    Coordinates are single precision: 0.03 um at 500 mm. A comment holds the viewpoint, the centre
    of C1 from which the rays start.
    """
    comments = ([comment] if comment else []) + _viewpoint(viewpoint_mm)
    colours = np.repeat(cloud.grey[:, None], 3, axis=1)
    _write_vertices(path, cloud.points_mm, colours, {"sigma_mm": cloud.sigma_mm, **more}, comments)


def write_coloured_ply(
    path: Path,
    points_mm: NDArray[np.float64],
    colours: NDArray[np.uint8],
    /,
    *,
    viewpoint_mm: NDArray[np.float64] | None = None,
    **values: NDArray[np.floating[Any]],
) -> None:
    """Write points (n, 3) with colours (n, 3) and further values (n,) as binary PLY."""
    _write_vertices(path, points_mm, colours, values, _viewpoint(viewpoint_mm))


def _viewpoint(viewpoint_mm: NDArray[np.float64] | None) -> list[str]:
    """Return the comment that holds from where points were seen, if that is known."""
    if viewpoint_mm is None:
        return []
    return [" ".join([VIEWPOINT, *(f"{value:.9g}" for value in viewpoint_mm)])]


def _write_vertices(
    path: Path,
    points_mm: NDArray[np.float64],
    colours: NDArray[np.uint8],
    values: Mapping[str, NDArray[np.floating[Any]]],
    comments: list[str],
) -> None:
    fields = [*((name, "<f4") for name in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    fields += [(name, "<f4") for name in values]
    vertices = np.empty(len(points_mm), np.dtype(fields))
    for column, name in enumerate("xyz"):
        vertices[name] = points_mm[:, column]
    for column, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours[:, column]
    for name, column_values in values.items():
        vertices[name] = column_values
    kinds = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {c}" for c in comments)]
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields]
    path.write_bytes("\n".join([*header, "end_header\n"]).encode("ascii") + vertices.tobytes())


def write_points(path: Path, maps: dict[str, NDArray[Any]], /, **more: NDArray[Any]) -> None:
    """Write maps on the grid of C1 as NPZ, with the names of the rejection bits, and more."""
    names = np.array([reason.name for reason in Rejection])
    np.savez_compressed(path, allow_pickle=False, rejection_names=names, **maps, **more)


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
    return tomlkit.dumps(toml_plain(table))


def toml_plain(value: Any) -> Any:
    """Return a value as it is read back from TOML: no tuples, no NumPy, no None or NaN."""
    if isinstance(value, dict):
        return {key: toml_plain(v) for key, v in value.items() if v is not None and v == v}
    if isinstance(value, list | tuple):
        return [toml_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
