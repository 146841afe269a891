"""Merged clouds and meshes to files: PLY, STL, OBJ, E57; lengths in mm (E57: m)."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import MergedCloud, SurfaceMesh

MESH_FORMATS = ("ply", "stl", "obj")

KINDS = {"<f4": "float", "u1": "uchar", "<u2": "ushort"}


def write_merged_ply(path: Path, cloud: MergedCloud, /, *, comment: str = "") -> None:
    """Write a merged cloud as binary PLY: position, normal, grey, sigma along the normal, views."""
    vertices = _table(cloud.points_mm, cloud.normals, cloud.grey, {
        "sigma_mm": (cloud.sigma_mm, "<f4"), "n_views": (cloud.n_views, "u1"),
        "view": (cloud.source, "<u2"),
    })  # fmt: skip
    path.write_bytes(_header(vertices, 0, comment) + vertices.tobytes())


def write_mesh(path: Path, mesh: SurfaceMesh, /, *, comment: str = "") -> None:
    """Write a mesh as PLY, STL or OBJ, by the ending of the path.

    PLY carries normals, grey and sigma of the vertices; OBJ normals and grey; STL the shape alone.

    Raises
    ------
    MethodError
        If the ending is another.
    """
    writers = {".ply": _ply_mesh, ".stl": _stl_mesh, ".obj": _obj_mesh}
    if path.suffix.lower() not in writers:
        raise MethodError(f"{path}: expected .ply, .stl or .obj, found '{path.suffix}'")
    path.write_bytes(writers[path.suffix.lower()](mesh, comment))


def _table(
    points: NDArray[np.float64], normals: NDArray[np.float32], grey: NDArray[np.uint8],
    more: dict[str, tuple[NDArray[Any], str]],
) -> NDArray[Any]:  # fmt: skip
    names = ("x", "y", "z", "nx", "ny", "nz")
    colours = ("red", "green", "blue")
    fields = [(n, "<f4") for n in names] + [(n, "u1") for n in colours]
    fields += [(name, kind) for name, (_, kind) in more.items()]
    table = np.empty(len(points), np.dtype(fields))
    for k in range(3):
        table[names[k]], table[names[k + 3]] = points[:, k], normals[:, k]
        table[colours[k]] = grey
    for name, (values, _) in more.items():
        table[name] = values
    return table


def _header(table: NDArray[Any], n_faces: int, comment: str) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {comment}"] if comment else []
    lines += [f"element vertex {len(table)}"]
    assert table.dtype.names is not None
    for name in table.dtype.names:
        kind = table.dtype[name].newbyteorder("<").str.replace("|", "")
        lines.append(f"property {KINDS[kind]} {name}")
    if n_faces:
        lines += [f"element face {n_faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header\n"]).encode("ascii")


def _ply_mesh(mesh: SurfaceMesh, comment: str) -> bytes:
    table = _table(mesh.vertices_mm, mesh.normals, mesh.grey, {"sigma_mm": (mesh.sigma_mm, "<f4")})
    faces = np.empty(len(mesh.faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, mesh.faces
    return _header(table, len(faces), comment) + table.tobytes() + faces.tobytes()


def _stl_mesh(mesh: SurfaceMesh, comment: str) -> bytes:
    corners = mesh.vertices_mm[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    table = np.zeros(len(corners), kind)
    table["normal"], table["corners"] = normals / np.maximum(lengths, 1e-30), corners
    head = f"binary STL, mm, {comment}".encode("ascii", "replace")[:80].ljust(80)
    return head + np.uint32(len(table)).tobytes() + table.tobytes()


def _obj_mesh(mesh: SurfaceMesh, comment: str) -> bytes:
    rows = np.column_stack([mesh.vertices_mm, mesh.grey / 255.0]).tolist()
    lines = [f"# {comment}, mm"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f} {c:.3f} {c:.3f} {c:.3f}" for x, y, z, c in rows]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (mesh.faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii", "replace")


def write_e57(path: Path, cloud: MergedCloud, /) -> None:
    """Write a merged cloud as E57 (ASTM E2807): positions in m, intensity, colour, normals.

    Raises
    ------
    MethodError
        If the library is missing.
    """
    try:
        library = importlib.import_module("pye57")
    except ImportError as problem:
        raise MethodError(
            f"--formats e57: expected the package pye57, found none ({problem}). Install it: pip "
            "install 'fringe3d[merge]'"
        ) from None
    metres = cloud.points_mm / 1000
    data: dict[str, NDArray[Any]] = {name: np.ascontiguousarray(metres[:, k])
            for k, name in enumerate(("cartesianX", "cartesianY", "cartesianZ"))}  # fmt: skip
    data["intensity"] = cloud.grey / 255.0
    data |= {f"color{c}": cloud.grey.copy() for c in ("Red", "Green", "Blue")}
    file = library.E57(str(path), mode="w")
    try:
        file.write_scan_raw(data, name="fringe3d merged")
    finally:
        file.close()
