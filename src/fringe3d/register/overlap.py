"""Where the points of one view land on the surface that another one saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import project
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register._grid import land
from fringe3d.register.views import REACH

Floats = NDArray[np.float64]

SAME_SIDE = 0.5
"""Least cosine between normals of the same surface: 60 deg. A thin wall's other side has -1."""

SMOOTH = 0.985
"""Least length of the mean of neighbouring normals: across sharper bends (20 deg between pixels)
nothing is interpolated where views are registered."""

ENOUGH = 4
"""Times as many points are looked at as are wanted: most lie inside the surface."""

LEAST_COSINE = 0.25
"""A surface seen flatter than 14 deg says little of a distance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """Points of a view that registration rests on.

    Parameters
    ----------
    points_mm, normals : (n, 3) float64; in the frame of the view
    sigma_mm : (n,) float64, mm; standard deviation along the normal
    """

    points_mm: Floats
    normals: Floats
    sigma_mm: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Landed:
    """Points on another view's surface.

    Parameters
    ----------
    distance_mm : (n,) float, mm; along the surface's normal; NaN where there is no surface, or one
        that faces elsewhere
    normals : (n, 3) float; of the surface, in the frame of the other view
    sigma_mm : (n,) float, mm; of the surface along its normal
    behind_mm : (n,) float, mm; how much farther on the ray of the other camera the point lies than
        the nearest of the surface there; NaN where there is none, and where the surface lies behind
        but beside a pixel without a point: this may be what is seen past an outline
    is_smooth : (n,) bool; the surface does not bend sharply there
    cosine : (n,) float; between the ray of the other camera and the surface's normal
    """

    distance_mm: Floats
    normals: Floats
    sigma_mm: Floats
    behind_mm: Floats
    is_smooth: NDArray[np.bool_]
    cosine: Floats


def all_points(view: SurfaceView, /) -> Sample:
    """Return all points of a view that have a normal."""
    return sample_at(view, np.isfinite(view.normals[..., 0]))


def sample_of(view: SurfaceView, n_points: int, /, *, seed: int = 0) -> Sample:
    """Return at most so many points of a view, at random, inside its surface.

    What is seen flatly, and what lies on a border, is left out.
    """
    good = np.isfinite(view.normals[..., 0])
    good[[0, -1], :] = good[:, [0, -1]] = False
    places = np.flatnonzero(good)
    rng = np.random.default_rng(seed)
    if len(places) > ENOUGH * n_points:  # what lies inside is asked of a few alone
        places = rng.choice(places, ENOUGH * n_points, replace=False)
    places = places[_is_inner(view.normals, places)]
    if len(places) > n_points:
        places = rng.choice(places, n_points, replace=False)
    chosen = np.zeros(good.shape, bool)
    chosen.flat[places] = True
    sample = sample_at(view, chosen)
    rays = sample.points_mm - view.camera.center_world
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    steep = np.abs((rays * sample.normals).sum(axis=1)) > LEAST_COSINE
    return Sample(points_mm=sample.points_mm[steep], normals=sample.normals[steep],
                  sigma_mm=sample.sigma_mm[steep])  # fmt: skip


def _is_inner(normals: NDArray[np.float32], places: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell for pixels whether all four neighbours have a normal, and the surface does not bend."""
    n_cols = normals.shape[1]
    flat = normals.reshape(-1, 3)
    around = sum(flat[places + step] for step in (1, -1, n_cols, -n_cols))
    return np.asarray(np.linalg.norm(np.asarray(around), axis=-1) > 4 * SMOOTH)


def sample_at(view: SurfaceView, chosen: NDArray[np.bool_], /) -> Sample:
    """Return the points of a view at chosen pixels, (row, col) bool; all must have a normal."""
    points = view.points_mm[chosen]
    normals = view.normals[chosen].astype(np.float64)
    rays = points - view.camera.center_world
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosine = np.abs((rays * normals).sum(axis=1))
    return Sample(points_mm=points, normals=normals,
                  sigma_mm=view.sigma_mm[chosen].astype(np.float64) * cosine)  # fmt: skip


def land_on(other: SurfaceView, points_mm: Floats, normals: Floats | None = None, /) -> Landed:
    """Find where points land on the surface of a view, along the rays of its camera.

    Parameters
    ----------
    other : SurfaceView
    points_mm : (n, 3) float, mm; in its frame
    normals : (n, 3) float or None; of the points; where they differ by more than 60 deg from those
        of the surface, it is another surface

    Notes
    -----
    The surface is interpolated between the four pixels around the point's image, as far as they
    belong together: midway between the bilinear chord and the four tangent planes, whose errors on
    a curved surface are opposite and equal up to the second order.
    """
    points = np.ascontiguousarray(points_mm, np.float64)
    pixels = np.ascontiguousarray(project(other.camera, points))
    out = np.empty((len(points), 8))
    over_rows(
        land, len(points), points, pixels, other.points_mm, other.normals, other.sigma_mm,
        other.camera.center_world, REACH * other.spacing_mm, out, least=POINTS,
    )  # fmt: skip
    distance = out[:, 0].copy()
    distance[out[:, 6] < LEAST_COSINE] = np.nan
    if normals is not None:
        distance[(out[:, 1:4] * normals).sum(axis=1) < SAME_SIDE] = np.nan
    return Landed(distance_mm=distance, normals=out[:, 1:4], sigma_mm=out[:, 4],
                  behind_mm=out[:, 5], is_smooth=out[:, 7] >= SMOOTH, cosine=out[:, 6])  # fmt: skip


def land_sample(
    sample: Sample,
    body_from_own: RigidTransform,
    other: SurfaceView,
    body_from_other: RigidTransform,
    /,
) -> Landed:
    """Land the points of a sample on another view, both placed in the body frame."""
    other_from_own = body_from_other.inverse() @ body_from_own
    return land_on(other, other_from_own.apply(sample.points_mm),
                   other_from_own.rotate(sample.normals))  # fmt: skip
