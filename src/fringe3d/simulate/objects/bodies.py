"""Bodies that are hard to measure: two at different heights, and a thin wire."""

from __future__ import annotations

import math

import numpy as np
from manifold3d import Manifold, Mesh64
from numpy.typing import NDArray

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects.solid import (
    Points,
    cylinder,
    outline,
    positive,
    segments,
    to_mesh,
    turned,
)

WIRE_SAGITTA_MM = 0.004
"""Largest distance of a facet of the wire from its round surface."""

WIRE_TURNS = 2.75
WIRE_EASE = 12.0
WIRE_RADII_MM = (6.0, 35.0)
WIRE_Z_MM = (7.0, 21.0)
WIRE_BEND_MM = 2.5
BASE_RADIUS_MM, BASE_Z = 8.5, 3.0


def two_bodies(
    *,
    high_mm: float = 22.0,
    low_mm: float = 7.0,
    gap_mm: float = 5.0,
    rounding_mm: float = 3.0,
) -> Mesh:
    """Return a high rounded block on the left and a low truncated cone on the right.

    Parameters
    ----------
    high_mm, low_mm : float; height of the block; of the cone
    gap_mm : float; between the two at the ground, along x
    rounding_mm : float; radius of the upper edges of the block

    Examples
    --------
    >>> two_bodies(high_mm=20.0, low_mm=5.0).vertices_mm[:, 2].max().round(6)
    np.float64(20.0)
    """
    positive(high_mm=high_mm, low_mm=low_mm, gap_mm=gap_mm, rounding_mm=rounding_mm)
    corner = 6.0
    limit = min(corner, high_mm)
    if rounding_mm > limit:
        raise ValueError(f"rounding_mm: expected up to {limit}, found {rounding_mm}")
    width, depth = 27.0, 38.0
    cone = 16.0
    profile = outline([(0.0, 0.0), (corner, 0.0), (corner, high_mm, rounding_mm), (0.0, high_mm)])
    block = turned(
        profile,
        at=(-(width + gap_mm) / 2, 0.0),
        stretch=(width - 2 * corner, depth - 2 * corner),
    )
    return to_mesh(block + _truncated_cone(cone, low_mm, at=(cone + gap_mm / 2, 0.0)))


def _truncated_cone(radius_mm: float, height_mm: float, *, at: tuple[float, float]) -> Manifold:
    """Return a cone that narrows to 60 % of its radius."""
    top = 0.6 * radius_mm
    profile = outline([(0.0, 0.0), (radius_mm, 0.0), (top, height_mm), (0.0, height_mm)])
    return turned(profile, at=at)


def thin_wire(*, diameter_mm: float = 1.0) -> Mesh:
    """Return a wire wound to a conical spiral that rises from a small base.

    Parameters
    ----------
    diameter_mm : float; of the wire; at most half the distance between two turns

    Examples
    --------
    >>> thin_wire(diameter_mm=0.5).spheres.shape
    (0, 4)
    """
    positive(diameter_mm=diameter_mm)
    pitch = (WIRE_RADII_MM[1] - WIRE_RADII_MM[0]) / WIRE_TURNS
    if diameter_mm > pitch / 2:
        raise ValueError(
            f"diameter_mm: expected up to {pitch / 2:.3g} (half the distance between two "
            f"turns), found {diameter_mm}"
        )
    base = cylinder(BASE_RADIUS_MM, (0.0, BASE_Z), chamfer_mm=0.5)
    return to_mesh(base + tube(_wire_path(), diameter_mm / 2))


def _wire_path() -> Points:
    """Return points up from inside the base, round a bend and along a spiral, (n, 3)."""
    r0, z0 = WIRE_RADII_MM[0], WIRE_Z_MM[0]
    bend = np.linspace(0.0, np.pi / 2, segments(WIRE_BEND_MM, WIRE_SAGITTA_MM) // 2)
    azimuth = WIRE_BEND_MM * (1 - np.cos(bend)) / r0
    z = z0 - WIRE_BEND_MM * (1 - np.sin(bend))
    arc = np.column_stack([r0 * np.cos(azimuth), r0 * np.sin(azimuth), z])
    foot = np.array([[r0, 0.0, h] for h in np.linspace(BASE_Z / 2, z[0], 5)])
    return np.concatenate([foot, arc[1:], _spiral(azimuth[-1])[1:]])


def _spiral(start_rad: float) -> Points:
    """Return points along a spiral that sets out level on a circle, then rises outwards, (n, 3)."""
    (r0, r1), (z0, z1) = WIRE_RADII_MM, WIRE_Z_MM
    n = math.ceil(WIRE_TURNS * segments(r1, WIRE_SAGITTA_MM))
    t = np.linspace(0.0, 1.0, n + 1)
    # Without an eased start the wire would have a kink where the bend ends.
    eased = t + np.expm1(-WIRE_EASE * t) / WIRE_EASE
    eased /= eased[-1]
    angle = start_rad + 2 * np.pi * WIRE_TURNS * t
    r, z = r0 + (r1 - r0) * eased, z0 + (z1 - z0) * eased
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def tube(path_mm: NDArray[np.float64], radius_mm: float, /) -> Manifold:
    """Return a round tube along a path, its ends rounded.

    Parameters
    ----------
    path_mm : (n, 3), mm; without sharp bends
    radius_mm : float

    Examples
    --------
    >>> straight = tube(np.array([[0.0, 0, 0], [0, 0, 10]]), 1.0)
    >>> straight.volume() / (np.pi * 10 + 4 / 3 * np.pi) > 0.98
    True
    """
    n = segments(radius_mm, WIRE_SAGITTA_MM)
    along = np.gradient(path_mm, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    centers, radii, headings = _with_round_ends(path_mm, along, radius_mm, n // 4)
    across = _carried(headings)
    upward = np.cross(headings, across)
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * upward[:, None]
    vertices = (centers[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    poles = path_mm[[0, -1]] + radius_mm * np.array([-along[0], along[-1]])
    faces = _tube_faces(len(centers), n)
    return Manifold(Mesh64(np.concatenate([vertices, poles]), faces.astype(np.uint64)))


def _with_round_ends(
    path: Points, along: Points, radius_mm: float, n_rings: int
) -> tuple[Points, Points, Points]:
    """Return centres, radii and headings of all rings, those of the two half balls included."""
    latitude = np.linspace(0.0, np.pi / 2, n_rings, endpoint=False)[1:]
    reach, shrink = radius_mm * np.sin(latitude), radius_mm * np.cos(latitude)
    start = path[0] - reach[::-1, None] * along[0]
    end = path[-1] + reach[:, None] * along[-1]
    centers = np.concatenate([start, path, end])
    radii = np.concatenate([shrink[::-1], np.full(len(path), radius_mm), shrink])
    headings = np.concatenate(
        [np.tile(along[0], (len(start), 1)), along, np.tile(along[-1], (len(end), 1))]
    )
    return centers, radii, headings


def _carried(headings: Points) -> Points:
    """Return directions across the headings that turn no more than they must, (n, 3)."""
    across = np.empty_like(headings)
    current = np.eye(3)[np.abs(headings[0]).argmin()]
    for i, heading in enumerate(headings):
        current = current - (current @ heading) * heading
        current = current / np.linalg.norm(current)
        across[i] = current
    return across


def _tube_faces(n_rings: int, n: int) -> NDArray[np.int64]:
    """Return the triangles between rings of n vertices, and to a pole at each end."""
    first = np.arange(n)
    second = np.roll(first, -1)
    start = n * np.arange(n_rings - 1)[:, None]
    a, b, c, d = (start + first, start + second, start + n + first, start + n + second)
    sides = [np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]
    low = np.full(n, n_rings * n)
    last = (n_rings - 1) * n
    caps = [
        np.column_stack([second, first, low]),
        np.column_stack([last + first, last + second, low + 1]),
    ]
    return np.concatenate([*(side.reshape(-1, 3) for side in sides), *caps])
