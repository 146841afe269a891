"""Points beside the edges of what a view saw: they count only where no other view saw the place.

There a pixel mixes the light of two surfaces, or lens and interpolation do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from fringe3d.model import Fate, MergedCloud, RigidTransform, SurfaceView
from fringe3d.register.overlap import SAME_SIDE, Sample, all_points, land_on, sample_at
from fringe3d.register.views import LEAST_POINTS, surface_view

Bools = NDArray[np.bool_]

GAP = 10.0
"""Typical distances up to which neighbouring pixels belong to one surface: slopes up to 84 deg."""

SURE = 2.5
"""Times the usual sigma along the normal up to which a pixel next to an edge is of use: of the
machine part 1.7 % of what is then added lies off by more than 0.1 mm, of all of them 9.5 %."""

HOLE_PIXELS, MOST_HOLES = 4, 0.015
"""Missing pixels that are a hole and no edge, and how many holes a view may have for each of its
points. Simulated teeth have 0.005, `sltk-shell` from Gray code alone 0.03."""

COVERED = 1.5
"""Typical distances of points within which a place is covered by a point that faces its way."""

FRONT = 6.0
"""Typical distances by which another view must have looked through a point to drop it."""


NEIGHBOURS, NEIGHBOURHOOD, LEAST_NEIGHBOURS = 12, 3.0, 3
"""Points around one beside an edge, within so many typical distances, that must confirm it, and how
many at least: of those that stand alone 15 % lie off by more than 0.1 mm, of the others 3 %."""

BESIDE, BESIDE_SPACING = 3.0, 0.2
"""Sigmas along the normal, or typical distances of points, by which it may lie beside them: a ninth
of the points beside edges of simulated teeth are dropped so, and half of those that are off by more
than 0.1 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Points of a view beside its edges.

    Parameters
    ----------
    pixels : (n,) int; flat indices on the grid of the view
    unsure : (m,) int; those of points that are too uncertain, or have no normal
    sample : Sample; in the frame of the view
    grey : (n,) uint8
    """

    pixels: NDArray[np.int64]
    unsure: NDArray[np.int64]
    sample: Sample
    grey: NDArray[np.uint8]


def border(points_mm: NDArray[np.float64], max_gap_mm: float, /) -> Bools:
    """Tell which points have a missing or far neighbour, (row, col)."""
    valid = np.isfinite(points_mm[..., 0])
    joined = valid.copy()
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            far = ~(np.linalg.norm(np.diff(points_mm, axis=axis), axis=-1) <= max_gap_mm)
        here, there = [slice(None)] * 2, [slice(None)] * 2
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        joined[tuple(here)] &= ~far
        joined[tuple(there)] &= ~far
    return np.asarray(valid & ~joined)


def _is_full_of_holes(valid: Bools) -> bool:
    labels, _ = ndimage.label(~valid, np.ones((3, 3), bool))
    sizes = np.bincount(labels.ravel())[1:]
    return bool((sizes <= HOLE_PIXELS).sum() > MOST_HOLES * valid.sum())


def split_edges(view: SurfaceView, /) -> tuple[SurfaceView, EdgePoints]:
    """Part a view into what lies inside its surface, and what lies within two pixels of edges.

    Of the pixels next to an edge only those that are nearly as certain as others are of use. A
    view that is full of holes, as one from Gray code alone, stays whole.

    Parameters
    ----------
    view : SurfaceView

    Returns
    -------
    SurfaceView, EdgePoints
    """
    next_ = border(view.points_mm, GAP * view.spacing_mm)
    valid = view.is_valid
    edge = valid & ndimage.binary_dilation(next_ | ~valid, np.ones((3, 3), bool))
    if (valid & ~edge).sum() < LEAST_POINTS or _is_full_of_holes(valid):
        edge = next_ = np.zeros_like(edge)
    points = np.where(edge[..., None], np.nan, view.points_mm)
    inner = surface_view(view.name, view.camera, points, view.sigma_mm, view.grey,
                         position=view.position)  # fmt: skip
    chosen = edge & np.isfinite(view.normals[..., 0])
    sample = sample_at(view, chosen)
    usual = float(np.median(all_points(inner).sigma_mm))
    sure = ~next_[chosen] | (sample.sigma_mm < SURE * usual)
    places = np.flatnonzero(chosen)
    rest = np.flatnonzero(edge & ~chosen)
    return inner, EdgePoints(
        pixels=places[sure],
        unsure=np.concatenate([places[~sure], rest]),
        sample=Sample(points_mm=sample.points_mm[sure], normals=sample.normals[sure],
                      sigma_mm=sample.sigma_mm[sure]),
        grey=view.grey[chosen][sure],
    )  # fmt: skip


def with_edges(
    cloud: MergedCloud,
    views: Sequence[SurfaceView],
    body_from_view: Sequence[RigidTransform],
    edges: Sequence[EdgePoints],
    /,
) -> MergedCloud:
    """Add points beside edges where the merged cloud has none.

    Of several at one place the one of the least sigma stands for it. What another view looked
    through is dropped, and what its neighbours do not confirm.

    Parameters
    ----------
    cloud : MergedCloud; of the inner views
    views : sequence of SurfaceView; these inner views
    body_from_view : sequence of RigidTransform
    edges : sequence of EdgePoints; of each view
    """
    spacing = float(np.median([view.spacing_mm for view in views]))
    tree = cKDTree(cloud.points_mm)
    fates = [fate.copy() for fate in cloud.fates]
    points, normals, sigma, grey, source, pixels = [], [], [], [], [], []
    for k, edge in enumerate(edges):
        own, way = (move(v) for move, v in (
            (body_from_view[k].apply, edge.sample.points_mm),
            (body_from_view[k].rotate, edge.sample.normals)))  # fmt: skip
        through = _looked_through(views, body_from_view, k, own, FRONT * spacing)
        covered = _is_covered(tree, cloud, own, way, COVERED * spacing)
        fates[k].flat[edge.pixels] = np.where(through, Fate.SEEN_THROUGH, Fate.EDGE)
        fates[k].flat[edge.unsure] = Fate.EDGE
        open_ = ~covered & ~through
        points.append(own[open_])
        normals.append(way[open_])
        sigma.append(edge.sample.sigma_mm[open_])
        grey.append(edge.grey[open_])
        source.append(np.full(int(open_.sum()), k, np.uint16))
        pixels.append(edge.pixels[open_])
    places, ways, spread = np.concatenate(points), np.concatenate(normals), np.concatenate(sigma)
    views_of, at = np.concatenate(source), np.concatenate(pixels)
    best = _one_for_each_place(places, ways, spread, spacing)
    best = best[_is_confirmed(cloud, places[best], ways[best], spread[best], spacing)]
    for k in range(len(views)):
        fates[k].flat[at[best][views_of[best] == k]] = Fate.KEPT
    return replace(
        cloud,
        points_mm=np.concatenate([cloud.points_mm, places[best]]),
        normals=np.concatenate([cloud.normals, ways[best].astype(np.float32)]),
        sigma_mm=np.concatenate([cloud.sigma_mm, spread[best].astype(np.float32)]),
        grey=np.concatenate([cloud.grey, np.concatenate(grey)[best]]),
        n_views=np.concatenate([cloud.n_views, np.ones(len(best), np.uint8)]),
        source=np.concatenate([cloud.source, views_of[best]]),
        fates=tuple(fates),
    )


def _is_covered(
    tree: cKDTree, cloud: MergedCloud, points: NDArray[np.float64], normals: NDArray[np.float64],
    reach_mm: float,
) -> Bools:  # fmt: skip
    """Tell where a point of the cloud that faces the same way lies near."""
    if not len(points):
        return np.zeros(0, bool)
    distance, nearest = (np.asarray(v) for v in tree.query(points, distance_upper_bound=reach_mm))
    near = np.isfinite(distance)
    same = np.zeros(len(points), bool)
    same[near] = (cloud.normals[nearest[near]] * normals[near]).sum(axis=1) > SAME_SIDE
    return same


def _is_confirmed(
    cloud: MergedCloud, points: NDArray[np.float64], normals: NDArray[np.float64],
    sigma: NDArray[np.float64], spacing_mm: float,
) -> Bools:  # fmt: skip
    """Tell which points lie on the surface of their neighbours, of the cloud and among themselves.

    The distance from a neighbour is taken along the mean of both normals: on a curved surface the
    tangent planes of both err in opposite directions.
    """
    if not len(points):
        return np.zeros(0, bool)
    places = np.concatenate([points, cloud.points_mm])
    ways = np.concatenate([normals, cloud.normals.astype(np.float64)])
    apart, near = (np.asarray(v)[:, 1:] for v in cKDTree(places).query(
        points, NEIGHBOURS + 1, distance_upper_bound=NEIGHBOURHOOD * spacing_mm))  # fmt: skip
    known = np.isfinite(apart)
    near = np.where(known, near, 0)
    both = ways[near] + normals[:, None]
    known &= (ways[near] * normals[:, None]).sum(axis=-1) > SAME_SIDE
    away = 0.5 * (both * (points[:, None] - places[near])).sum(axis=-1)
    enough = known.sum(axis=1) >= LEAST_NEIGHBOURS
    beside = np.full(len(points), np.inf)
    beside[enough] = np.abs(np.nanmedian(np.where(known, away, np.nan)[enough], axis=1))
    return np.asarray(beside <= np.maximum(BESIDE * sigma, BESIDE_SPACING * spacing_mm))


def _looked_through(
    views: Sequence[SurfaceView], poses: Sequence[RigidTransform], k: int,
    points: NDArray[np.float64], depth_mm: float,
) -> Bools:  # fmt: skip
    """Tell which points lie clearly before what another view saw, on its rays."""
    through = np.zeros(len(points), bool)
    for j, view in enumerate(views):
        if j != k and len(points):
            landed = land_on(view, poses[j].inverse().apply(points))
            with np.errstate(invalid="ignore"):
                through |= landed.behind_mm < -depth_mm
    return through


def _one_for_each_place(
    points: NDArray[np.float64], normals: NDArray[np.float64], sigma: NDArray[np.float64],
    spacing_mm: float,
) -> NDArray[np.int64]:  # fmt: skip
    """Return one point for each cube of the typical distance, and each side of a thin wall."""
    sides = np.sign(normals[np.arange(len(normals)), np.abs(normals).argmax(axis=1)])
    cubes = np.floor(points / spacing_mm)
    which = np.unique(np.column_stack([cubes, sides]), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((sigma, which))
    first = np.flatnonzero(np.diff(which[order], prepend=-1))
    return np.asarray(np.sort(order[first]))
