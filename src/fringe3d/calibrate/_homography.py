"""Homographies of a plane, and what they tell of lens and pose (Zhang)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def homography(source: Floats, target: Floats, /) -> Floats:
    """Return H with target ~ H source, (3, 3), by least squares of the normalised equations.

    Parameters
    ----------
    source, target : (n, 2), n >= 4, not all on a line
    """
    from_source, to_target = _normaliser(source), _normaliser(target)
    x, y = _mapped(from_source, source).T
    u, v = _mapped(to_target, target).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = np.concatenate([
        np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
        np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
    ])  # fmt: skip
    _, vectors = np.linalg.eigh(rows.T @ rows)
    found = np.linalg.inv(to_target) @ vectors[:, 0].reshape(3, 3) @ from_source
    return np.asarray(found / found[2, 2]) if abs(found[2, 2]) > 1e-12 else found


def _normaliser(points: Floats) -> Floats:
    middle = points.mean(axis=0)
    spread = max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean() / 2)), 1e-12)
    return np.array([[1 / spread, 0, -middle[0] / spread], [0, 1 / spread, -middle[1] / spread],
                     [0, 0, 1]])  # fmt: skip


def _mapped(matrix: Floats, points: Floats) -> Floats:
    return points @ matrix[:2, :2].T + matrix[:2, 2]


def apply_homography(matrix: Floats, points: Floats, /) -> Floats:
    """Return the images of points, (n, 2)."""
    full = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(full[:, :2] / full[:, 2:])


def orientation(matrix: Floats, at: Floats, /) -> float:
    """Return the determinant of the derivative of a homography at a point (2,): its sign tells
    whether it mirrors."""
    x, y, w = matrix @ np.r_[at, 1.0]
    top = matrix[:2, :2] * w - np.outer([x, y], matrix[2, :2])
    return float(np.linalg.det(top / w**2))


def focal_lengths(homographies: list[Floats], center: Floats, /) -> Floats | None:
    """Return the focal lengths (2,), px, of a camera with this principal point, or None.

    Notes
    -----
    Zhang's two equations for each plane: its axes are perpendicular and have equal lengths.
    """
    rows, right = [], []
    for matrix in homographies:
        moved = np.array([[1, 0, -center[0]], [0, 1, -center[1]], [0, 0, 1]]) @ matrix
        a, b = (moved[:, k] / np.linalg.norm(moved[:, k]) for k in (0, 1))
        # Other pairs of perpendicular axes make the equations alike in size.
        c, d = (moved[:, 0] + moved[:, 1]) / 2, (moved[:, 0] - moved[:, 1]) / 2
        c, d = c / np.linalg.norm(c), d / np.linalg.norm(d)
        rows += [[a[0] * b[0], a[1] * b[1]], [c[0] * d[0], c[1] * d[1]]]
        right += [-a[2] * b[2], -c[2] * d[2]]
    found, *_ = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)
    if not (np.isfinite(found).all() and (found > 0).all()):
        return None
    return np.asarray(1 / np.sqrt(found))


def plane_pose(matrix: Floats, focal: Floats, center: Floats, /) -> tuple[Floats, Floats]:
    """Return rotation (3, 3) and shift (3,) of ``device_from_plane``, the plane in front."""
    lens = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    axes = np.linalg.solve(lens, matrix)
    axes = axes / np.sqrt(np.linalg.norm(axes[:, 0]) * np.linalg.norm(axes[:, 1]))
    axes = axes if axes[2, 2] > 0 else -axes
    left, _, right = np.linalg.svd(
        np.stack([axes[:, 0], axes[:, 1], np.cross(axes[:, 0], axes[:, 1])], axis=1)
    )
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return np.asarray(rotation), axes[:, 2]
