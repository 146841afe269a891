"""Objects to measure, as watertight meshes that stand on z = 0 and fit a cylinder.

The cylinder has a diameter of 76 mm and a height of 24 mm; `scaled` fits them to other volumes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects.balls import ball_bar, ball_bar_spheres, sphere
from fringe3d.simulate.objects.bodies import thin_wire, two_bodies
from fringe3d.simulate.objects.bust import bust
from fringe3d.simulate.objects.gauges import flat_plate, plane, prism, step_gauge
from fringe3d.simulate.objects.hand import hand
from fringe3d.simulate.objects.machined import machine_part
from fringe3d.simulate.objects.teeth import teeth

__all__ = [
    "DIAMETER_MM",
    "HEIGHT_MM",
    "OBJECTS",
    "ball_bar",
    "ball_bar_spheres",
    "bust",
    "flat_plate",
    "from_file",
    "hand",
    "machine_part",
    "plane",
    "prism",
    "sphere",
    "step_gauge",
    "teeth",
    "thin_wire",
    "two_bodies",
]

DIAMETER_MM, HEIGHT_MM = 76.0, 24.0

OBJECTS: dict[str, Callable[[], Mesh]] = {
    "plane": plane,
    "prism": prism,
    "machine-part": machine_part,
    "teeth": teeth,
    "sphere": sphere,
    "ball-bar": ball_bar,
    "flat-plate": flat_plate,
    "step-gauge": step_gauge,
    "bust": bust,
    "two-bodies": two_bodies,
    "thin-wire": thin_wire,
    "hand": hand,
}

MESH_SUFFIXES = (".stl", ".ply", ".obj")


def from_file(path: Path, /) -> Mesh:
    """Read a mesh (STL, PLY, OBJ), lengths in mm, and stand it on z = 0 above the origin.

    Colours of its vertices become albedo (luminance).

    Raises
    ------
    ValueError
        If the file holds no triangles, or cannot be read.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "none"
        raise ValueError(f"{path}: expected a mesh file, found {found}. Check the path")
    try:
        loaded = trimesh.load_mesh(path, file_type=path.suffix.lower().lstrip("."))
    except Exception as problem:  # noqa: BLE001  (trimesh raises many kinds)
        raise ValueError(f"{path}: expected STL, PLY or OBJ, cannot read it: {problem}") from None
    if not isinstance(loaded, trimesh.Trimesh) or not len(loaded.faces):
        raise ValueError(f"{path}: expected a mesh of triangles, found none. Check the file")
    vertices = np.asarray(loaded.vertices, np.float64)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    base = np.r_[(lower + upper)[:2] / 2, lower[2]]
    return Mesh(
        vertices_mm=vertices - base,
        faces=np.asarray(loaded.faces, np.int32),
        albedo=_luminance(loaded),
    )


def _luminance(loaded: trimesh.Trimesh) -> NDArray[np.float32] | None:
    visual: Any = loaded.visual
    if visual.kind != "vertex":
        return None
    colors = np.asarray(visual.vertex_colors, np.float64)[:, :3] / 255
    return (colors @ [0.299, 0.587, 0.114]).astype(np.float32)
