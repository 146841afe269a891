"""One mesh of a merged cloud: Poisson's, or one through the points that keeps edges."""

from __future__ import annotations

import ctypes
import importlib
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.kernels import n_threads
from fringe3d.model import MergedCloud, SurfaceMesh
from fringe3d.register.holes import closed_holes

Floats = NDArray[np.float64]
MeshKind = Literal["poisson", "edges"]

LEAST_DEPTH, MOST_DEPTH = 5, 9
"""Of the octree: 512 cells along each side at most."""

CELLS = 1.5
"""Typical distances of points in a cell."""

BOX = 1.3
"""Side of the box of the octree over that of the cloud: what was not seen bulges out."""

BALLS = (1.0, 2.0, 4.0)
"""Radii of the balls that roll over the points, typical distances."""

NEAR = 3.0
"""Typical distances of points: vertices farther from all points close a hole."""

AROUND = 4
"""Points whose sigma and brightness a vertex has."""


def open3d() -> Any:
    """Return the library of meshes.

    Raises
    ------
    MethodError
        If it is missing.
    """
    n_threads()  # Numba chooses its threads before Open3D loads an older library of threads
    try:
        return importlib.import_module("open3d")
    except ImportError as problem:
        found = str(problem)
    if "libusb" in found:  # it is linked with a library that many systems lack; a package has it
        try:
            usb = importlib.import_module("libusb_package")
            ctypes.CDLL(str(usb.get_library_path()), mode=ctypes.RTLD_GLOBAL)
            return importlib.import_module("open3d")
        except (ImportError, OSError) as problem:
            found = str(problem)
    raise MethodError(
        f"--mesh: expected the packages of meshing, found no open3d ({found}). Install them: "
        "pip install 'fringe3d[mesh]', or leave --mesh out"
    )


def mesh_of(
    cloud: MergedCloud, /, *, kind: MeshKind = "poisson", closed: bool = False
) -> SurfaceMesh:
    """Make a mesh of a merged cloud.

    Parameters
    ----------
    cloud : MergedCloud
    kind : "poisson", smooth, of as many vertices as the points need; or "edges", through the points
        themselves (ball pivoting), so that edges stay as they were measured
    closed : bool; close all holes, also where nothing was seen; else they stay open

    Raises
    ------
    MethodError
        If the library is missing.
    EmptyResultError
        If no surface comes out.

    Notes
    -----
    Kazhdan and Hoppe (2013); Bernardini and others (1999), both by Open3D. Sigma and brightness of
    a vertex are the means of its four nearest points; where a hole was closed there is no sigma.
    """
    library = open3d()
    spacing = spacing_of(cloud.points_mm)
    make = _poisson if kind == "poisson" else _pivoted
    vertices, faces = make(library, cloud, spacing, closed)
    if not len(faces):
        raise EmptyResultError(
            f"--mesh {kind}: expected a surface, found none: {len(cloud.points_mm):,} points, "
            f"typically {spacing:.3g} mm apart. Look at the cloud"
        )
    return _dressed(cloud, vertices, faces, spacing)


def spacing_of(points_mm: Floats, /) -> float:
    """Return the median distance of points from their nearest neighbours, mm."""
    chosen = points_mm[:: max(1, len(points_mm) // 20_000)]
    distance = np.asarray(cKDTree(points_mm).query(chosen, k=2)[0])
    return float(np.median(distance[:, 1]))


def _cloud(library: Any, cloud: MergedCloud) -> Any:
    made = library.geometry.PointCloud()
    made.points = library.utility.Vector3dVector(np.array(cloud.points_mm))
    made.normals = library.utility.Vector3dVector(cloud.normals.astype(np.float64))
    return made


def _arrays(mesh: Any) -> tuple[Floats, NDArray[np.int32]]:
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32)


def _poisson(
    library: Any, cloud: MergedCloud, spacing: float, closed: bool
) -> tuple[Floats, NDArray[np.int32]]:
    extent = float(np.ptp(cloud.points_mm, axis=0).max())
    depth = int(
        np.clip(math.ceil(math.log2(BOX * extent / (CELLS * spacing))), LEAST_DEPTH, MOST_DEPTH)
    )
    mesh, _ = library.geometry.TriangleMesh.create_from_point_cloud_poisson(
        _cloud(library, cloud), depth=depth, scale=BOX, n_threads=n_threads()
    )
    mesh = _largest(mesh)
    if not closed:
        vertices = np.asarray(mesh.vertices)
        far = cKDTree(cloud.points_mm).query(vertices)[0] > NEAR * spacing
        mesh.remove_vertices_by_mask(far)
        return _arrays(_largest(mesh, least=0.01))
    return closed_holes(*_arrays(mesh))


def _largest(mesh: Any, least: float = 1.0) -> Any:
    """Leave only the pieces with at least that part of the faces of the largest."""
    which, counts, _ = mesh.cluster_connected_triangles()
    if len(counts):
        counts = np.asarray(counts)
        mesh.remove_triangles_by_mask((counts < least * counts.max())[np.asarray(which)])
        mesh.remove_unreferenced_vertices()
    return mesh


def _pivoted(
    library: Any, cloud: MergedCloud, spacing: float, closed: bool
) -> tuple[Floats, NDArray[np.int32]]:
    even = _cloud(library, cloud).voxel_down_sample(spacing)
    even.normalize_normals()
    radii = library.utility.DoubleVector([factor * spacing for factor in BALLS])
    mesh = library.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(even, radii)
    mesh.remove_degenerate_triangles()
    mesh.remove_non_manifold_edges()
    mesh.remove_unreferenced_vertices()
    mesh.orient_triangles()
    if closed:
        return closed_holes(*_arrays(_largest(mesh)))
    return _arrays(_largest(mesh, least=0.01))


def _dressed(
    cloud: MergedCloud, vertices: Floats, faces: NDArray[np.int32], spacing: float
) -> SurfaceMesh:
    """Give vertices normals, sigma and brightness."""
    found = cKDTree(cloud.points_mm).query(vertices, k=AROUND)
    distance, places = np.asarray(found[0]), np.asarray(found[1])
    sigma = cloud.sigma_mm[places].mean(axis=1)
    sigma[distance[:, 0] > NEAR * spacing] = np.nan
    return SurfaceMesh(
        vertices_mm=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        sigma_mm=sigma.astype(np.float32),
        grey=cloud.grey[places].mean(axis=1).round().astype(np.uint8),
    )


def vertex_normals(vertices: Floats, faces: NDArray[np.int32], /) -> NDArray[np.float32]:
    """Return unit normals (n, 3), the means of those of the faces around, by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    of_faces = np.cross(b - a, c - a)
    total = np.zeros(vertices.shape)
    for k in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], of_faces[:, axis], len(vertices))
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.maximum(lengths, 1e-30), np.float32)
