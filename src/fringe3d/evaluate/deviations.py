"""Signed deviations of a cloud from another cloud or from a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fringe3d.evaluate.fitting import Floats, shortest_interval

NEIGHBOURS = 12
"""Points of the reference through which its plane goes, next to a point."""

CHUNK = 20_000
FIRST_LOOK = 4
"""Triangles of each size that are looked at first: how far is the nearest at most?"""

PARTS, MOST_PARTS = 20_000, 500_000
"""Triangles longer than those of a mesh of that many equal ones are cut, so that few are near a
point; but not into more than the other number."""

SAME = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deviations:
    """How far points lie from a reference.

    Parameters
    ----------
    signed_mm : (n,) float, mm; positive in front of the reference, NaN where there is none near
    reach_mm : float, mm; how far a reference was sought
    covered : float, 0 to 1, or NaN; part of the reference's points with a point that near
    """

    signed_mm: Floats
    reach_mm: float
    covered: float

    @property
    def known(self) -> Floats:
        """Return the deviations that are known, mm."""
        return self.signed_mm[np.isfinite(self.signed_mm)]

    @property
    def n_alone(self) -> int:
        """Return how many points have no reference near them."""
        return len(self.signed_mm) - len(self.known)

    @property
    def mean_mm(self) -> float:
        """Return the mean deviation, mm; NaN without any."""
        return float(self.known.mean()) if len(self.known) else float("nan")

    @property
    def rms_mm(self) -> float:
        """Return the root of the mean square, mm; NaN without any."""
        return float(np.sqrt((self.known**2).mean())) if len(self.known) else float("nan")

    @property
    def width95_mm(self) -> float:
        """Return the width of the shortest interval with 95 % of the deviations, mm."""
        return shortest_interval(self.known, 0.95) if len(self.known) else float("nan")

    def quantile_mm(self, part: float, /) -> float:
        """Return the size that a part of the deviations does not exceed, mm."""
        return float(np.quantile(np.abs(self.known), part)) if len(self.known) else float("nan")

    def within(self, tolerance_mm: float, /) -> float:
        """Return the part of the known deviations within a tolerance; NaN without any."""
        known = np.abs(self.known)
        return float((known <= tolerance_mm).mean()) if len(known) else float("nan")


def deviations_from_cloud(
    points_mm: ArrayLike,
    reference_mm: ArrayLike,
    /,
    *,
    reach_mm: float,
    viewpoint_mm: ArrayLike,
    normals: ArrayLike | None = None,
) -> Deviations:
    """Measure points against the local planes of another cloud.

    Parameters
    ----------
    points_mm, reference_mm : (n, 3), (m, 3) float, mm; finite, in one frame, m >= 3
    reach_mm : float, mm; a point without a reference so near has no deviation
    viewpoint_mm : (3,) float, mm; deviations towards it are positive
    normals : (m, 3) float or None; of the reference, which then tell the sign

    Returns
    -------
    Deviations

    Notes
    -----
    The plane goes through the twelve points of the reference nearest to the point, so its noise
    counts with about a third; on a surface of radius R it lies up to r^2 / 4 R beside it, where r
    is the radius of their neighbourhood. A point farther beside its neighbours than they lie from
    each other (beyond a border) has no deviation.

    Examples
    --------
    >>> grid = np.array([[x, y, 0.0] for x in range(5) for y in range(5)])
    >>> found = deviations_from_cloud([[2.2, 2.1, 0.3], [2, 2, 9.0]], grid, reach_mm=2.0,
    ...                               viewpoint_mm=[0, 0, 100])
    >>> found.signed_mm.round(6).tolist()
    [0.3, nan]
    """
    points, reference = np.asarray(points_mm, np.float64), np.asarray(reference_mm, np.float64)
    tree = cKDTree(reference)
    signed = np.full(len(points), np.nan)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        own = points[part]
        nearest = tree.query(own, k=np.arange(1, min(NEIGHBOURS, len(reference)) + 1))
        distance, index = np.asarray(nearest[0]), np.asarray(nearest[1])
        near = distance[:, 0] <= reach_mm
        signed[part][near] = _from_planes(
            own[near], reference[index[near]], np.asarray(viewpoint_mm, np.float64),
            None if normals is None else np.asarray(normals, np.float64)[index[near, 0]],
        )  # fmt: skip
    covered = _covered(reference, points, reach_mm)
    return Deviations(signed_mm=signed, reach_mm=reach_mm, covered=covered)


def _from_planes(
    points: Floats, neighbours: Floats, viewpoint: Floats, normals: Floats | None
) -> Floats:
    """Return signed distances from planes through neighbours (n, k, 3)."""
    middle = neighbours.mean(axis=1)
    near = neighbours - middle[:, None]
    _, axes = np.linalg.eigh(np.swapaxes(near, 1, 2) @ near)
    normal = axes[..., 0]
    front = viewpoint - middle if normals is None else normals
    normal = normal * np.where((normal * front).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    away = points - middle
    off = (away * normal).sum(axis=1)
    beside = np.sqrt(np.maximum((away**2).sum(axis=1) - off**2, 0))
    reach = np.linalg.norm(near, axis=-1).max(axis=1)
    return np.asarray(np.where(beside <= reach, off, np.nan))


def deviations_from_mesh(
    points_mm: ArrayLike, triangles_mm: ArrayLike, /, *, reach_mm: float
) -> Deviations:
    """Measure points against a mesh: exact distances to its triangles.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite
    triangles_mm : (m, 3, 3) float, mm; corners, counter-clockwise seen from outside
    reach_mm : float, mm; a point without a triangle so near has no deviation

    Returns
    -------
    Deviations
        Positive outside. `covered` is NaN: which part of a mesh can be seen is not known.

    Notes
    -----
    Long triangles are cut, and all sorted by size. The nearest of a few bounds the distance; then
    all count whose middle is no farther than that and the largest distance of a corner from its
    middle. Where several triangles are equally near, the sum of their normals tells the sign.

    Examples
    --------
    >>> square = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0.0]]]
    >>> deviations_from_mesh([[0.2, 0.1, -0.5], [1.3, 0.5, 0.4]], square,
    ...                      reach_mm=1.0).signed_mm.tolist()
    [-0.5, 0.5]
    """
    points = np.asarray(points_mm, np.float64)
    groups = _by_size(_cut(np.asarray(triangles_mm, np.float64)))
    signed = np.full(len(points), np.nan)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        signed[part] = _from_triangles(points[part], groups, reach_mm)
    return Deviations(signed_mm=signed, reach_mm=reach_mm, covered=float("nan"))


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """Triangles of like size: corners (n, 3, 3), unit normals, a tree of their middles."""

    corners: Floats
    normals: Floats
    tree: cKDTree
    radius: float


def _by_size(triangles: Floats) -> list[_Triangles]:
    """Group triangles by octaves of the distance from middle to corner."""
    middles = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - middles[:, None], axis=2).max(axis=1)
    octave = np.ceil(np.log2(np.maximum(radius, 1e-12 * radius.max())))
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    return [
        _Triangles(triangles[own], normals[own], cKDTree(middles[own]), float(radius[own].max()))
        for own in (octave == size for size in np.unique(octave))
    ]


def _cut(triangles: Floats) -> Floats:
    """Halve long edges."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    longest = 2 * np.sqrt(np.linalg.norm(across, axis=1).sum() / 2 / PARTS)
    while len(triangles) < MOST_PARTS:
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        is_long = edges.max(axis=1) > longest
        if not is_long.any():
            break
        turn = (edges[is_long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        own = np.take_along_axis(triangles[is_long], turn[..., None], axis=1)
        a, b, c = np.moveaxis(own, 1, 0)
        half = (a + b) / 2
        halves = [np.stack([a, half, c], 1), np.stack([half, b, c], 1)]
        triangles = np.concatenate([triangles[~is_long], *halves])
    return triangles


def _from_triangles(points: Floats, groups: list[_Triangles], reach_mm: float) -> Floats:
    """Return signed distances from the nearest triangle, NaN beyond the reach."""
    bound = np.full(len(points), reach_mm)
    for group in groups:
        _, index = group.tree.query(points, k=np.arange(1, min(FIRST_LOOK, len(group.corners)) + 1))
        for column in np.asarray(index).T:
            foot = closest_on_triangles(group.corners[column], points)
            bound = np.minimum(bound, np.linalg.norm(points - foot, axis=1))
    least, towards = np.full(len(points), np.inf), np.zeros(len(points))
    for group in groups:
        lists = group.tree.query_ball_point(points, bound * (1 + SAME) + group.radius + SAME)
        counts = np.array([len(found) for found in lists])
        number = np.repeat(np.arange(len(points)), counts)
        index = np.fromiter((place for found in lists for place in found), np.intp, counts.sum())
        away = points[number] - closest_on_triangles(group.corners[index], points[number])
        size, front = np.linalg.norm(away, axis=1), (away * group.normals[index]).sum(axis=1)
        before = least.copy()
        np.minimum.at(least, number, size)
        towards[least < before * (1 - SAME) - SAME] = 0.0  # nearer than all of other sizes
        is_least = size <= least[number] * (1 + SAME) + SAME
        np.add.at(towards, number[is_least], front[is_least])
    signed = np.where(towards < 0, -least, least)
    return np.asarray(np.where(least <= reach_mm, signed, np.nan))


def closest_on_triangles(triangles: Floats, points: Floats, /) -> Floats:
    """Return the point of each triangle that is nearest to a point, (n, 3).

    Parameters
    ----------
    triangles : (n, 3, 3) float; corners
    points : (n, 3) float; one for each triangle

    Notes
    -----
    The foot of the perpendicular where it lies inside, else the nearest of the points on the
    three edges.
    """
    corner, edges = triangles[:, 0], triangles[:, 1:] - triangles[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    squared = np.maximum((normal**2).sum(axis=1), 1e-300)
    away = points - corner
    height = (away * normal).sum(axis=1) / squared
    second = (np.cross(edges[:, 0], away) * normal).sum(axis=1) / squared
    first = (np.cross(away, edges[:, 1]) * normal).sum(axis=1) / squared
    inside = (first >= 0) & (second >= 0) & (first + second <= 1)
    answer = points - height[:, None] * normal
    best = np.where(inside, -1.0, np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        along = triangles[:, end] - triangles[:, start]
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        part = ((points - triangles[:, start]) * along).sum(axis=1) / length
        on_edge = triangles[:, start] + np.clip(part, 0, 1)[:, None] * along
        distance = ((points - on_edge) ** 2).sum(axis=1)
        nearer = distance < best
        answer[nearer], best = on_edge[nearer], np.minimum(best, distance)
    return np.asarray(answer)


def _covered(reference: Floats, points: Floats, reach_mm: float) -> float:
    distance, _ = cKDTree(points).query(reference, distance_upper_bound=reach_mm)
    return float(np.isfinite(distance).mean())
