"""Meshes of triangles from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError


def read_triangles(path: Path, /) -> NDArray[np.float64]:
    """Read the triangles of a mesh (STL, PLY, OBJ), lengths in mm.

    Returns
    -------
    (n, 3, 3) float64, mm; the corners of each

    Raises
    ------
    MethodError
        If the file holds no triangles, or cannot be read.
    """
    import trimesh

    if not path.is_file():
        raise MethodError(f"{path}: expected a mesh (STL, PLY, OBJ), found none. Check the path")
    try:
        loaded = trimesh.load_mesh(path, file_type=path.suffix.lower().lstrip("."))
    except Exception as problem:  # noqa: BLE001  (trimesh raises many kinds)
        raise MethodError(f"{path}: expected STL, PLY or OBJ, cannot read it: {problem}") from None
    if not isinstance(loaded, trimesh.Trimesh) or not len(loaded.faces):
        raise MethodError(f"{path}: expected a mesh of triangles, found none. Check the file")
    return np.asarray(loaded.triangles, np.float64)
