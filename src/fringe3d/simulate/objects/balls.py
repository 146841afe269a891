"""Exact spheres: one alone, and two on a bar."""

from __future__ import annotations

import math

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects.solid import (
    SPHERE_STEP,
    Points,
    ball_profile,
    cylinder,
    outline,
    positive,
    to_mesh,
    turned,
    union,
)

SPHERE_SEGMENTS = 4 * math.ceil(math.pi / SPHERE_STEP / 2)


def sphere(*, radius_mm: float = 10.0, seat_mm: float = 0.0) -> Mesh:
    """Return a sphere that rests on the ground; its centre is at (0, 0, radius).

    Parameters
    ----------
    radius_mm : float
    seat_mm : float; height of a ring to stand in, less than the radius; 0 for none
        It hides the lowest part of the sphere.

    Examples
    --------
    >>> sphere(radius_mm=8.0).spheres
    array([[0., 0., 8., 8.]])
    """
    positive(radius_mm=radius_mm)
    if not 0 <= seat_mm < radius_mm:
        raise ValueError(f"seat_mm: expected 0 to {radius_mm} (the radius), found {seat_mm}")
    neck = math.sqrt(seat_mm * (2 * radius_mm - seat_mm))
    ball = ball_profile(radius_mm, radius_mm, neck)
    profile = np.concatenate([_seat(neck, seat_mm), ball]) if seat_mm else ball
    solid = turned(profile, n_segments=SPHERE_SEGMENTS)
    return to_mesh(solid, [((0.0, 0.0, radius_mm), radius_mm)])


def _seat(neck_mm: float, height_mm: float) -> Points:
    """Return the (r, z) of a ring around the foot of a ball, below the ball."""
    rim = neck_mm + 0.3 * height_mm
    foot = neck_mm + 0.8 * height_mm
    return outline([(0.0, 0.0), (foot, 0.0), (foot, 0.3 * height_mm), (rim, height_mm)])


def ball_bar(
    *,
    radius_mm: float = 8.0,
    distance_mm: float = 50.0,
    center_z_mm: float = 15.0,
    bar_mm: float = 4.0,
) -> Mesh:
    """Return two equal spheres on short posts on a bar along x.

    Parameters
    ----------
    radius_mm : float; of both spheres
    distance_mm : float; between their centres
    center_z_mm : float; height of their centres above the ground
    bar_mm : float; thickness of the bar; below the spheres

    Examples
    --------
    >>> len(ball_bar().spheres)
    2
    """
    positive(bar_mm=bar_mm)
    spheres = ball_bar_spheres(
        radius_mm=radius_mm, distance_mm=distance_mm, center_z_mm=center_z_mm
    )
    if bar_mm >= center_z_mm - radius_mm:
        raise ValueError(
            f"bar_mm: expected less than {center_z_mm - radius_mm:.4g} (the lowest point of the "
            f"spheres), found {bar_mm}"
        )
    solid = _bar(radius_mm, distance_mm, bar_mm) + union(
        ball_on_post(radius_mm, center_z_mm, bar_mm, at=(x, y)) for x, y, _, _ in spheres
    )
    return to_mesh(solid, [(ball[:3], float(ball[3])) for ball in spheres])


def ball_bar_spheres(
    *, radius_mm: float = 8.0, distance_mm: float = 50.0, center_z_mm: float = 15.0
) -> NDArray[np.float64]:
    """Return centre and radius of the spheres of `ball_bar`, (2, 4), mm, -x first.

    Examples
    --------
    >>> ball_bar_spheres(distance_mm=40.0)
    array([[-20.,   0.,  15.,   8.],
           [ 20.,   0.,  15.,   8.]])
    """
    positive(radius_mm=radius_mm, distance_mm=distance_mm, center_z_mm=center_z_mm)
    if distance_mm <= 2 * radius_mm:
        raise ValueError(
            f"distance_mm: expected more than {2 * radius_mm} (two radii), found {distance_mm}"
        )
    half = distance_mm / 2
    return np.array([[-half, 0.0, center_z_mm, radius_mm], [half, 0.0, center_z_mm, radius_mm]])


def ball_on_post(
    radius_mm: float,
    center_z_mm: float,
    ground_z_mm: float,
    /,
    *,
    at: tuple[float, float] = (0.0, 0.0),
) -> Manifold:
    """Return a ball on a post with a filleted foot, sunk a little into its ground.

    Parameters
    ----------
    radius_mm, center_z_mm : float; of the ball
    ground_z_mm : float; below the ball
    at : (x, y), mm
    """
    post = 0.45 * radius_mm
    ball = ball_profile(radius_mm, center_z_mm, post)
    fillet = min(0.25 * radius_mm, 0.8 * (ball[0, 1] - ground_z_mm))
    sunk = ground_z_mm - 0.5 * fillet
    foot = outline(
        [
            (0.0, sunk),
            (post + fillet, sunk),
            (post + fillet, ground_z_mm),
            (post, ground_z_mm, fillet),
            (post, ball[0, 1]),
        ]
    )
    return turned(np.concatenate([foot[:-1], ball]), at=at, n_segments=SPHERE_SEGMENTS)


def _bar(radius_mm: float, distance_mm: float, thickness_mm: float) -> Manifold:
    """Return a bar with round ends and, where there is room, a window in its middle."""
    end = 0.85 * radius_mm
    edge = min(0.15 * thickness_mm, 0.1 * radius_mm)
    plate = cylinder(end, (0.0, thickness_mm), stretch=(distance_mm, 0.0), chamfer_mm=edge)
    free = distance_mm - 3.2 * radius_mm
    if free <= 0:
        return plate
    through = (-thickness_mm, 2 * thickness_mm)
    return plate - cylinder(0.35 * end, through, stretch=(free, 0.0))
