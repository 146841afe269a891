"""Homologous points to points in space, with an uncertainty for each."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.geometry import closest_depths, pixel_grid, project, rays
from fringe3d.geometry.components import patch_sizes
from fringe3d.geometry.meeting import Met, meet
from fringe3d.geometry.spikes import stands_out
from fringe3d.model import Correspondences, Device, MeasuringVolume, PointMap, Rejection
from fringe3d.model.rejection import reject

DEPTH_STEP = 1e-4
"""Part of the depth by which a point is moved to find its speed in the other image; as in
`geometry.meeting`."""

GAP_ROWS = 96
"""Rows from which the typical distance of neighbours is taken."""

MAX_SIGMA_OF_DEPTH = 0.02
"""Part of the depth: a point less certain than 2 % of its distance is no measurement."""

EPIPOLAR_SIGMA, EPIPOLAR_FLOOR_PX = 6.0, 0.5
"""Robust standard deviations of the epipolar residual, and the least limit."""

MAD_TO_SIGMA = 1.4826


def triangulate(
    matches: Correspondences,
    camera: Device,
    other: Device,
    /,
    *,
    volume: MeasuringVolume | None = None,
    max_epipolar_px: float | None = None,
    known: tuple[Met, NDArray[np.bool_]] | None = None,
    plain: bool = False,
) -> PointMap:
    """Intersect the viewing rays of homologous points.

    The point is the middle of the shortest line between the two rays.

    Parameters
    ----------
    matches : Correspondences
    camera : Device; C1
    other : Device; the second camera, or the projector
    volume : MeasuringVolume or None; points outside are rejected as OUTSIDE_VOLUME
    max_epipolar_px : float or None, px; larger distances of the point in the other device from
        the epipolar curve are rejected as RAYS_MISS
    known : (Met, (row, col) bool) or None; points that are known and not computed again, and the
        pixels that are left; the others are added to it
    plain : bool; compute with NumPy alone: slow, and the same within rounding. For comparison.

    Returns
    -------
    PointMap

    Notes
    -----
    ``sigma = sigma_px / |d pixel / d t|``, t the distance along the viewing ray.
    """
    if plain:
        return _triangulate_plainly(matches, camera, other, volume, max_epipolar_px)
    limit = inf if max_epipolar_px is None else max_epipolar_px
    met, todo = known or (None, None)
    if met is not None and todo is not None:
        met = met._replace(rejection=np.where(todo, matches.rejection, met.rejection))
    met = meet(matches, camera, other, volume, max_epipolar_px=limit,
               max_sigma_part=MAX_SIGMA_OF_DEPTH, met=met, todo=todo)  # fmt: skip
    return PointMap(**met._asdict())


def _triangulate_plainly(
    matches: Correspondences,
    camera: Device,
    other: Device,
    volume: MeasuringVolume | None,
    max_epipolar_px: float | None,
) -> PointMap:
    """Do what `geometry.meeting.meet` does, step by step."""
    valid = matches.rejection == 0
    origin, directions = rays(camera, matches.pixels_c1[valid])
    origin2, directions2 = rays(other, matches.pixels[valid])
    t, t2 = closest_depths(origin, directions, origin2, directions2)
    on_ray, on_other = origin + t[:, None] * directions, origin2 + t2[:, None] * directions2
    points = (on_ray + on_other) / 2
    skew = np.linalg.norm(on_ray - on_other, axis=-1)
    moved = project(other, points + (DEPTH_STEP * t)[:, None] * directions)
    speed = np.linalg.norm(moved - project(other, points), axis=-1) / (DEPTH_STEP * t)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = matches.sigma_px[valid] / speed

    in_front = (t > 0) & (t2 > 0)
    problems = [
        (~in_front, Rejection.BEHIND_DEVICE),
        (in_front & ~(sigma <= MAX_SIGMA_OF_DEPTH * np.abs(t)), Rejection.UNCERTAIN),
    ]
    if max_epipolar_px is not None:
        apart = np.abs(matches.epipolar_residual_px[valid]) > max_epipolar_px
        problems.append((apart, Rejection.RAYS_MISS))
    if volume is not None:
        problems.append((~volume.contains(points), Rejection.OUTSIDE_VOLUME))
    return _point_map(matches.rejection, valid, points, sigma, skew, problems)


def _point_map(
    rejection: NDArray[np.uint16],
    valid: NDArray[np.bool_],
    points: NDArray[np.float64],
    sigma: NDArray[np.float64],
    skew: NDArray[np.float64],
    problems: list[tuple[NDArray[np.bool_], Rejection]],
) -> PointMap:
    rejection = rejection.copy()
    for where, reason in problems:
        full = np.zeros(valid.shape, bool)
        full[valid] = where
        reject(rejection, full, reason)
    points_map = np.full((*valid.shape, 3), np.nan)
    sigma_map = np.full(valid.shape, np.nan, np.float32)
    skew_map = np.full(valid.shape, np.nan, np.float32)
    points_map[valid], sigma_map[valid], skew_map[valid] = points, sigma, skew
    bad = rejection != 0
    points_map[bad] = sigma_map[bad] = skew_map[bad] = np.nan
    return PointMap(points_mm=points_map, sigma_mm=sigma_map, skew_mm=skew_map, rejection=rejection)


def epipolar_limit_px(matches: Correspondences, /) -> float | None:
    """Return how far rays may miss each other in C2, px: 6 robust sigma of the epipolar residual.

    None where there is no residual: fringes of one direction show none.
    """
    residual = np.abs(matches.epipolar_residual_px[np.isfinite(matches.epipolar_residual_px)])
    if not len(residual):
        return None
    return max(EPIPOLAR_FLOOR_PX, EPIPOLAR_SIGMA * MAD_TO_SIGMA * float(np.median(residual)))


def remove_isolated(
    points: PointMap, /, *, max_gap_mm: float, min_pixels: int, reach_px: int = 1
) -> PointMap:
    """Reject points that do not belong to a surface patch.

    Neighbouring pixels are joined where their points are closer than `max_gap_mm`; patches of
    fewer than `min_pixels` pixels are rejected as ISOLATED.

    Parameters
    ----------
    points : PointMap
    max_gap_mm : float, mm, > 0
    min_pixels : int
    reach_px : int, >= 1; how far apart, in rows and columns, neighbours may be
    """
    sizes = patch_sizes(points.points_mm, max_gap_mm, reach_px)
    return without(points, sizes < min_pixels, Rejection.ISOLATED)


def remove_outliers(
    points: PointMap, origin_mm: NDArray[np.float64], /, *, max_gap_mm: float, most_sigma: float
) -> PointMap:
    """Reject points that stand out of the surface of their neighbours as OUTLIER.

    Along each line through a pixel (rows, columns and diagonals, neighbours one or two pixels
    apart) the fourth difference of the depths is compared with its standard deviation. It is zero
    on any surface that is a cubic there, so bends stay; a thin wire stays for its own direction. A
    line on which the neighbours themselves are less even than the point is off them, as at edges
    and creases, tells nothing. What stands out along all others, three at least, and to the same
    side, is noise, a reflection, or a mixed pixel.

    Parameters
    ----------
    points : PointMap
    origin_mm : (3,) float, mm; centre of C1, from which depths are counted
    max_gap_mm : float, mm, > 0; neighbours of one surface are no further apart
    most_sigma : float; standard deviations of the fourth difference, of which a single point off by
        a makes up 6 a: 6 of them are 8.4 of the point's own sigma

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    >>> place = np.stack([x, y, 100 + 0 * x], axis=-1)
    >>> place[4, 4, 2] += 0.5
    >>> points = PointMap(points_mm=place, sigma_mm=0.01 + 0 * x, skew_mm=0 * x, rejection=0 * x)
    >>> left = remove_outliers(points, np.zeros(3), max_gap_mm=3.0, most_sigma=6.0)
    >>> np.argwhere(left.rejection != 0).tolist()
    [[4, 4]]
    """
    depth = np.linalg.norm(points.points_mm - origin_mm, axis=-1)
    out = stands_out(depth, points.sigma_mm, most_sigma=most_sigma, max_gap_mm=max_gap_mm)
    return without(points, out, Rejection.OUTLIER)


def remove_edges(points: PointMap, /, *, max_gap_mm: float) -> PointMap:
    """Reject points within two pixels of a missing or far neighbour as EDGE.

    One pixel mixes the light of two surfaces; the next interpolates with it.

    Parameters
    ----------
    points : PointMap
    max_gap_mm : float, mm, > 0
    """
    joined = np.ones(points.rejection.shape, bool)
    for here, there in _neighbours(1):
        gap = np.linalg.norm(points.points_mm[here] - points.points_mm[there], axis=-1)
        far = ~(gap <= max_gap_mm)
        joined[here] &= ~far
        joined[there] &= ~far
    inner = ndimage.binary_erosion(joined, np.ones((3, 3), bool))
    return without(points, ~inner, Rejection.EDGE)


def remove_repeated(points: PointMap, matches: Correspondences, /) -> PointMap:
    """Keep one pixel for each point that several pixels share; the others are SAME_POINT.

    The pixel nearest to the middle of its code cell stays. Points from fringes are never shared.

    Parameters
    ----------
    points : PointMap
    matches : Correspondences from which the points were made
    """
    good = np.flatnonzero(points.is_valid)
    places = matches.pixels_c1.reshape(-1, 2)[good]
    grid = pixel_grid(points.rejection.shape).reshape(-1, 2)[good]
    away = np.linalg.norm(places - grid, axis=1)
    if not away.any():
        return points
    nearest_first = np.lexsort((away, places[:, 1], places[:, 0]))
    ordered = places[nearest_first]
    is_first = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)]
    repeated = np.zeros(points.rejection.size, bool)
    repeated[good[nearest_first[~is_first]]] = True
    return without(points, repeated.reshape(points.rejection.shape), Rejection.SAME_POINT)


def typical_gap_mm(points: PointMap, /) -> float:
    """Return the median distance between points of neighbouring pixels, mm; NaN without any."""
    rows = slice(None, None, max(1, len(points.points_mm) // GAP_ROWS))
    gaps = np.linalg.norm(np.diff(points.points_mm[rows], axis=1), axis=-1)
    gaps = gaps[gaps > 0]  # pixels that share a point have no gap
    return float(np.median(gaps)) if len(gaps) else float("nan")


Window = tuple[slice, slice]


def _neighbours(reach_px: int) -> Iterator[tuple[Window, Window]]:
    """Yield pairs of windows that lay each pixel upon a neighbour, each pair once."""
    for down in range(reach_px + 1):
        for right in range(-reach_px, reach_px + 1):
            if (down, right) > (0, 0) and (reach_px > 1 or down * right == 0):
                yield (
                    (
                        slice(None, -down or None),
                        slice(max(-right, 0), -right if right > 0 else None),
                    ),
                    (slice(down, None), slice(max(right, 0), right if right < 0 else None)),
                )


def without(points: PointMap, where: NDArray[np.bool_], reason: Rejection, /) -> PointMap:
    """Return the points without some of them, (row, col) bool, which are rejected for a reason."""
    bad = (points.rejection == 0) & where
    if not bad.any():
        return points
    rejection = points.rejection.copy()
    reject(rejection, bad, reason)
    return PointMap(
        points_mm=_emptied(points.points_mm, bad),
        sigma_mm=_emptied(points.sigma_mm, bad),
        skew_mm=_emptied(points.skew_mm, bad),
        rejection=rejection,
    )


def _emptied(image: NDArray[Any], where: NDArray[np.bool_]) -> NDArray[Any]:
    emptied = image.copy()
    emptied[where] = np.nan
    return emptied
