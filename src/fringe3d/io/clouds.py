"""Clouds of points from files: our own results, and those of other programs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.io.results import VIEWPOINT

Floats = NDArray[np.float64]

SUFFIXES = (".ply", ".npz", ".npy", ".xyz", ".txt", ".asc", ".csv", ".pts")

PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
DECIMAL_COMMAS = re.compile(r"\d,\d+[;\s]+[-+]?\d+,\d")
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CloudFile:
    """Points as a file holds them.

    Parameters
    ----------
    points_mm : (n, 3) float64, mm; finite
    sigma_mm : (n,) float64 or None, mm; standard deviation along the line to the viewpoint
    normals : (n, 3) float64 or None; unit length
    viewpoint_mm : (3,) float64 or None, mm; from where the points were seen
    deviation_mm : (n,) float64 or None, mm; from what they were compared with, NaN where unknown
    """

    points_mm: Floats
    sigma_mm: Floats | None = None
    normals: Floats | None = None
    viewpoint_mm: Floats | None = None
    deviation_mm: Floats | None = None

    @property
    def noise_mm(self) -> Floats | None:
        """Return standard deviations as vectors along the viewing rays, (n, 3) mm.

        None where they, or the viewpoint, are not known (all of them).
        """
        if self.sigma_mm is None or self.viewpoint_mm is None:
            return None
        if not np.isfinite(self.sigma_mm).all():
            return None
        rays = self.points_mm - self.viewpoint_mm
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(rays * self.sigma_mm[:, None])


def read_cloud(path: Path, /) -> CloudFile:
    """Read a cloud: a result folder, or a file that holds points, lengths in mm.

    Parameters
    ----------
    path : Path
        Folder that ``fringe3d measure`` left (or its points.npz); PLY (ASCII or binary); text with
        x, y, z in the first columns (.xyz, .txt, .asc, .csv, .pts); .npy of shape (..., 3).

    Returns
    -------
    CloudFile
        Points that are not finite are left out.

    Raises
    ------
    MethodError
        If there is no such file, or it holds no points.
    """
    file = path / "points.npz" if path.is_dir() else path
    if not file.is_file():
        raise MethodError(
            f"{path}: expected a result folder or a cloud ({', '.join(SUFFIXES)}), found "
            f"{'a folder without points.npz' if path.is_dir() else 'none'}. Check the path"
        )
    readers = {".ply": _from_ply, ".npz": _from_npz, ".npy": _from_npy}
    kind = file.suffix.lower()
    if kind not in SUFFIXES:
        raise MethodError(
            f"{path}: expected a cloud as {', '.join(SUFFIXES)}, found '{file.suffix}'. Convert it"
        )
    try:
        cloud = readers.get(kind, _from_text)(file)
    except (OSError, EOFError, ValueError, KeyError, BadZipFile) as problem:
        raise MethodError(
            f"{path}: expected a cloud of points, cannot read it: {problem}. Check the file"
        ) from None
    good = np.isfinite(cloud.points_mm).all(axis=1)
    if not good.any():
        raise MethodError(f"{path}: expected points, found none. Check the file")
    if good.all():
        return cloud
    return CloudFile(
        points_mm=cloud.points_mm[good],
        sigma_mm=None if cloud.sigma_mm is None else cloud.sigma_mm[good],
        normals=None if cloud.normals is None else cloud.normals[good],
        viewpoint_mm=cloud.viewpoint_mm,
        deviation_mm=None if cloud.deviation_mm is None else cloud.deviation_mm[good],
    )


def _from_npz(path: Path) -> CloudFile:
    with np.load(path, allow_pickle=False) as maps:
        points = _rows_of_three(maps["points_mm"])
        sigma = np.asarray(maps["sigma_mm"], np.float64).ravel() if "sigma_mm" in maps else None
        view = np.asarray(maps["camera_center_mm"]) if "camera_center_mm" in maps else None
    if sigma is not None and len(sigma) != len(points):
        raise ValueError(f"it holds {len(points)} points and {len(sigma)} sigmas")
    return CloudFile(points_mm=points, sigma_mm=sigma, viewpoint_mm=view)


def _from_npy(path: Path) -> CloudFile:
    return CloudFile(points_mm=_rows_of_three(np.load(path, allow_pickle=False)))


def _rows_of_three(array: NDArray[Any]) -> Floats:
    if array.shape[-1:] != (3,) or array.dtype.kind not in "iuf":
        raise ValueError(f"it holds {array.dtype} {array.shape}, not numbers (..., 3)")
    return np.asarray(array, np.float64).reshape(-1, 3)


def _from_text(path: Path) -> CloudFile:
    """Read the first three columns of lines of numbers; other lines are left out."""
    rows = []
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            if DECIMAL_COMMAS.search(line):
                raise ValueError("its numbers have decimal commas, not points")
            parts = re.split(r"[,;\s]+", line.strip())[:3]
            try:
                rows.append([float(part) for part in parts])
            except ValueError:
                continue  # a header or a comment
    return CloudFile(points_mm=np.array([row for row in rows if len(row) == 3]).reshape(-1, 3))


def _from_ply(path: Path) -> CloudFile:
    raw = path.read_bytes()
    end = raw.find(b"end_header")
    if not raw.startswith(b"ply") or end < 0:
        raise ValueError("it does not begin as a PLY file does")
    header = raw[:end].decode("ascii", "replace").splitlines()
    body = raw[raw.index(b"\n", end) + 1 :]
    table = _vertices(header, body)
    columns = {name: np.asarray(table[name], np.float64) for name in table.dtype.names or ()}
    normals = None
    if {"nx", "ny", "nz"} <= set(columns):
        normals = np.column_stack([columns[name] for name in ("nx", "ny", "nz")])
    return CloudFile(
        points_mm=np.column_stack([columns[name] for name in "xyz"]),
        sigma_mm=columns.get("sigma_mm"),
        normals=normals,
        viewpoint_mm=_viewpoint(header),
        deviation_mm=columns.get("deviation_mm"),
    )


def _vertices(header: list[str], body: bytes) -> NDArray[Any]:
    """Return the vertices of a PLY file as a structured array; they must come first."""
    try:
        form, count, fields = _layout(header)
    except (IndexError, KeyError):
        raise ValueError("its header is damaged") from None
    if count < 0 or not {"x", "y", "z"} <= {name for name, _ in fields}:
        raise ValueError(f"it says {count} vertices with {[name for name, _ in fields]}")
    if form == "ascii":
        rows = body.decode("ascii").split("\n")[:count]
        numbers = np.array([row.split()[: len(fields)] for row in rows if row.strip()], np.float64)
        if len(numbers) < count:
            raise ValueError(f"it says {count} vertices and holds {len(numbers)}")
        plain = np.dtype([(name, "f8") for name, _ in fields])
        return np.ascontiguousarray(numbers).view(plain)[:, 0] if count else np.zeros(0, plain)
    kind = np.dtype([(name, BYTE_ORDERS[form] + code) for name, code in fields])
    if len(body) < count * kind.itemsize:
        raise ValueError(f"it says {count} vertices and holds {len(body) // kind.itemsize}")
    return np.frombuffer(body, kind, count)


def _layout(header: list[str]) -> tuple[str, int, list[tuple[str, str]]]:
    """Return format, number of vertices and their fields (name, type)."""
    fields: list[tuple[str, str]] = []
    form, count, element = "", 0, ""
    for words in (line.split() for line in header):
        if words[:1] == ["element"]:
            if not element and words[1] != "vertex":
                raise ValueError(f"its first element is '{words[1]}', not 'vertex'")
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] == "list":
                raise ValueError("its vertices have lists")
            fields.append((words[2], PLY_TYPES[words[1]]))
        elif words[:1] == ["format"]:
            form = words[1]
    if form != "ascii" and form not in BYTE_ORDERS:
        raise ValueError(f"its format is '{form}', not ascii or binary")
    return form, count, fields


def _viewpoint(header: list[str]) -> Floats | None:
    for words in (line.split() for line in header):
        if words[:2] == ["comment", VIEWPOINT]:
            return np.array([float(word) for word in words[2:5]])
    return None
