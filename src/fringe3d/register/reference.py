"""A merged cloud onto a reference mesh: coarse by features, fine by least squares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fringe3d.errors import EmptyResultError
from fringe3d.model import MergedCloud, RigidTransform
from fringe3d.register.pairs import place_clouds
from fringe3d.register.small_motion import motion_of, tidy

Floats = NDArray[np.float64]

N_REFERENCE, N_CLOUD = 200_000, 20_000
ROUNDS = 40
SEED = 5
TUKEY = 4.685


def fitted_to_mesh(cloud: MergedCloud, triangles: Floats, /) -> RigidTransform:
    """Return ``mesh_from_body`` that fits a cloud best to a mesh.

    Parameters
    ----------
    cloud : MergedCloud
    triangles : (n, 3, 3) float, mm; corners of each, anticlockwise seen from outside

    Raises
    ------
    EmptyResultError
        If the cloud does not fit the mesh anywhere.

    Notes
    -----
    Points are sampled evenly on the mesh. Features and generalised ICP place the cloud roughly;
    then the distances along the normals of the mesh are made small, with Tukey's weights.
    """
    points, normals = sampled_mesh(triangles, N_REFERENCE)
    rng = np.random.default_rng(SEED)
    chosen = rng.choice(len(cloud.points_mm), min(N_CLOUD, len(cloud.points_mm)), replace=False)
    own = cloud.points_mm[chosen]
    rough = place_clouds(points, cloud.points_mm)
    if rough is None:
        raise EmptyResultError(
            "--reference: expected a mesh of this body, found none that fits the cloud. Check the "
            "file, and that its lengths are mm"
        )
    return _refined(own, cloud.normals[chosen].astype(np.float64), points, normals, rough)


def _refined(
    own: Floats, own_normals: Floats, points: Floats, normals: Floats, pose: RigidTransform
) -> RigidTransform:
    tree = cKDTree(points)
    for _ in range(ROUNDS):
        moved = pose.apply(own)
        places = np.asarray(tree.query(moved)[1])
        n = normals[places]
        faces_it = (pose.rotate(own_normals) * n).sum(axis=1) > 0.5
        distance = ((moved - points[places]) * n).sum(axis=1)
        scale = 1.4826 * float(np.median(np.abs(distance[faces_it])))
        part = (distance / max(TUKEY * scale, 1e-9)) ** 2
        weight = np.where(faces_it & (part < 1), (1 - part) ** 2, 0.0)
        middle = moved.mean(axis=0)
        rows = np.column_stack([np.cross(moved - middle, n), n])
        matrix = rows.T @ (weight[:, None] * rows) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(matrix, rows.T @ (weight * distance))
        pose = tidy(motion_of(step, middle) @ pose)
        if np.abs(step[3:]).max() < 1e-6:
            break
    return pose


def sampled_mesh(triangles: Floats, n: int, /) -> tuple[Floats, Floats]:
    """Return points spread evenly on a mesh, and their normals, (n, 3) each."""
    a, b, c = np.moveaxis(np.asarray(triangles, np.float64), 1, 0)
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(SEED)
    which = rng.choice(len(areas), n, p=areas / areas.sum())
    u, v = rng.random((2, n))
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u)[:, None], np.where(folded, 1 - v, v)[:, None]
    points = a[which] + u * (b - a)[which] + v * (c - a)[which]
    return points, normals[which] / np.maximum(areas[which], 1e-30)[:, None]
