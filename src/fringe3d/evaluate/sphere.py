"""Spheres through points, and where in a cloud they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fringe3d.errors import EmptyResultError
from fringe3d.evaluate.fitting import Bools, Fit, Floats, checked_points, settled, trimmed

N_SEEDS = 400
"""Places of a cloud from which spheres are sought."""

SEED_OF_RADIUS = 0.5
"""Radius of the neighbourhood of such a place, part of the sphere's."""

LEAST_SEED_POINTS = 12
LIKE_RADIUS = 0.1
"""A sphere may differ from its nominal radius by this part of it while it is sought."""

NEAR_OF_RADIUS = 0.05
"""Points so near to a sphere, part of its radius, belong to it, right or wrong."""

LEAST_SPHERE_POINTS = 100
GROWING_ROUNDS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sphere:
    """A sphere; its numbers are those of the centre and the radius, mm.

    Parameters
    ----------
    center_mm : (3,) float, mm
    radius_mm : float, mm
    """

    center_mm: Floats
    radius_mm: float

    @property
    def n_parameters(self) -> int:
        """Return 4."""
        return 4

    def distances(self, points_mm: Floats, /) -> Floats:
        """Return signed distances, positive outside, mm."""
        return np.asarray(np.linalg.norm(points_mm - self.center_mm, axis=-1) - self.radius_mm)

    def slopes(self, points_mm: Floats, /) -> Floats:
        """Return the derivatives of the distances, (n, 4)."""
        return np.column_stack([-self.normals(points_mm), -np.ones(len(points_mm))])

    def normals(self, points_mm: Floats, /) -> Floats:
        """Return the outward normals next to points, (n, 3)."""
        away = points_mm - self.center_mm
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def moved(self, step: Floats, /) -> Self:
        """Return the sphere with another centre and radius."""
        return type(self)(
            center_mm=self.center_mm + step[:3], radius_mm=self.radius_mm + float(step[3])
        )


def fit_sphere(points_mm: ArrayLike, /, *, rejected_part: float = 0.0) -> Fit[Sphere]:
    """Fit the sphere, of any radius, with the smallest sum of squared distances.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite, n >= 4, not all on one plane
    rejected_part : float, 0 <= part < 0.5; see `fit_plane`

    Returns
    -------
    Fit of a Sphere

    Raises
    ------
    ValueError
        If the points are too few, not finite, or all on one plane.

    Examples
    --------
    >>> fit = fit_sphere([[2, 0, 0], [-2, 0, 0], [0, 2, 0], [0, 0, 2.0]])
    >>> round(fit.surface.radius_mm, 6), round(fit.form_mm, 6)
    (2.0, 0.0)
    """
    points = checked_points(points_mm, "sphere", 4)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[2] <= 1e-9 * spread[0]:
        raise ValueError("sphere: expected points in space, found them all on one plane")
    return trimmed(
        points, lambda own: settled(algebraic_sphere(own), own), rejected_part, kind="sphere"
    )


def algebraic_sphere(points: Floats, /) -> Sphere:
    """Return the sphere through points (n, 3) whose squared distances fit best: a linear fit."""
    middle = points.mean(axis=0)
    near = points - middle
    basis = np.column_stack([2 * near, np.ones(len(near))])
    linear, *_ = np.linalg.lstsq(basis, (near**2).sum(axis=1), rcond=None)
    squared = max(float(linear[3] + linear[:3] @ linear[:3]), 1e-12)
    return Sphere(center_mm=middle + linear[:3], radius_mm=float(np.sqrt(squared)))


def find_spheres(points_mm: ArrayLike, radius_mm: float, n_spheres: int, /) -> tuple[Sphere, ...]:
    """Find spheres of a known radius in a cloud, whatever else is in it.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite
    radius_mm : float, mm; nominal
    n_spheres : int, >= 1

    Returns
    -------
    tuple of Sphere
        Roughly fitted, those with the most points first.

    Raises
    ------
    EmptyResultError
        If there are fewer.

    Notes
    -----
    From places spread over the cloud spheres are fitted to the neighbourhood; one whose radius is
    like the nominal one grows until its points stay. The one with the most points counts, and its
    points are taken away before the next is sought.
    """
    points = np.asarray(points_mm, np.float64)
    found: list[Sphere] = []
    left = np.ones(len(points), bool)
    for _ in range(n_spheres):
        grown = _most_points(points[left], radius_mm)
        if grown is None:
            raise EmptyResultError(
                f"spheres: expected {n_spheres} with a diameter near {2 * radius_mm:g} mm, found "
                f"{len(found)} among {len(points):,} points. Check the diameter and the cloud"
            )
        found.append(grown)
        away = np.linalg.norm(points - grown.center_mm, axis=1)
        left &= away > (1 + 2 * NEAR_OF_RADIUS) * radius_mm
    return tuple(found)


def _most_points(points: Floats, radius_mm: float) -> Sphere | None:
    """Return the sphere near the nominal radius with the most points, or None."""
    best, most = None, LEAST_SPHERE_POINTS - 1
    claimed = np.zeros(len(points), bool)
    for sphere, own in _seeds(points, radius_mm, claimed):
        grown, n = _grown(points, sphere, radius_mm)
        claimed |= own
        if n > most:
            best, most = grown, n
            claimed |= _near(points, grown)
    return best


def _seeds(points: Floats, radius_mm: float, claimed: Bools) -> Iterator[tuple[Sphere, Bools]]:
    """Yield spheres like the nominal one through neighbourhoods that no sphere claims yet."""
    if len(points) < LEAST_SEED_POINTS:
        return
    tree = cKDTree(points)
    order = np.random.default_rng(len(points)).permutation(len(points))[:N_SEEDS]
    for place in order:
        if claimed[place]:
            continue
        near = tree.query_ball_point(points[place], SEED_OF_RADIUS * radius_mm)
        if len(near) < LEAST_SEED_POINTS:
            continue
        sphere = algebraic_sphere(points[near])
        if abs(sphere.radius_mm - radius_mm) < LIKE_RADIUS * radius_mm:
            yield sphere, _near(points, sphere)


def _grown(points: Floats, sphere: Sphere, radius_mm: float) -> tuple[Sphere, int]:
    """Add what lies near the sphere until that stays; return it with the number of its points."""
    own = _near(points, sphere)
    for _ in range(GROWING_ROUNDS):
        if own.sum() < LEAST_SPHERE_POINTS:
            return sphere, 0
        sphere = settled(algebraic_sphere(points[own]), points[own])
        before, own = own, _near(points, sphere)
        if np.array_equal(before, own):
            break
    like = abs(sphere.radius_mm - radius_mm) < LIKE_RADIUS * radius_mm
    return sphere, int(own.sum()) if like else 0


def _near(points: Floats, sphere: Sphere) -> Bools:
    return np.abs(sphere.distances(points)) < NEAR_OF_RADIUS * sphere.radius_mm
