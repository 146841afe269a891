"""Solid modelling for the simulator: turned and stretched profiles, holes, and their meshes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from manifold3d import CrossSection, Error, Manifold
from numpy.typing import ArrayLike, NDArray

from fringe3d.simulate.mesh import ON_SPHERE_MM, Mesh

Points = NDArray[np.float64]
Corner = tuple[float, float] | tuple[float, float, float]
"""Corner of an outline, mm: two coordinates and, if it is rounded, its radius."""

SAGITTA_MM = 0.0015
"""Largest distance of a facet from the round surface that it stands for."""

SPHERE_STEP = 1 / 40
"""Edge of a triangle on a sphere, in radii."""

THROUGH_MM = 1.0
"""How far a cutting tool reaches beyond the surface, so that no skin stays behind."""

DRILL_TIP = math.tan(math.radians(31.0))
"""Depth of the tip of a drill of 118 deg, in radii."""


def positive(**sizes_mm: float) -> None:
    """Refuse sizes that are not positive.

    Raises
    ------
    ValueError
        If a size is zero, negative, infinite or not a number.

    Examples
    --------
    >>> positive(radius_mm=-3.0)
    Traceback (most recent call last):
    ...
    ValueError: radius_mm: expected a positive size, found -3.0
    """
    for name, size in sizes_mm.items():
        if not (math.isfinite(size) and size > 0):
            raise ValueError(f"{name}: expected a positive size, found {size}")


def segments(radius_mm: float, sagitta_mm: float = SAGITTA_MM) -> int:
    """Return how many chords make a circle, a multiple of four.

    Examples
    --------
    >>> segments(10.0)
    184
    """
    angle = math.acos(max(1 - sagitta_mm / radius_mm, 0.0))
    return max(4 * math.ceil(math.pi / angle / 4), 12)


def outline(corners: Sequence[Corner]) -> Points:
    """Return a closed polygon, some of its corners rounded, (n, 2), mm.

    A convex corner becomes a rounded edge, a concave one a fillet.

    Raises
    ------
    ValueError
        If the roundings of two neighbours overlap.

    Examples
    --------
    >>> outline([(0, 0), (4, 0), (4, 3), (0, 3)]).shape
    (4, 2)
    """
    points = np.array([corner[:2] for corner in corners], np.float64)
    radii = [float(corner[2]) if len(corner) == 3 else 0.0 for corner in corners]
    sides = np.roll(points, -1, axis=0) - points
    lengths = np.linalg.norm(sides, axis=1)
    ahead = sides / lengths[:, None]
    turns = [_turn(ahead[i - 1], ahead[i]) for i in range(len(points))]
    tangents = np.array([r * abs(math.tan(turn / 2)) for r, turn in zip(radii, turns, strict=True)])
    free = lengths - tangents - np.roll(tangents, -1)
    if free.min() < -1e-9:
        i = int(free.argmin())
        raise ValueError(
            f"outline: the roundings at both ends of side {i} need {-free[i]:.3g} mm more room"
        )
    arcs = [
        _arc(points[i] - tangents[i] * ahead[i - 1], ahead[i - 1], radii[i], turns[i])
        for i in range(len(points))
    ]
    return np.concatenate(arcs)


def _turn(before: Points, after: Points) -> float:
    """Return the angle from one direction to the next, rad, positive to the left."""
    cross = before[0] * after[1] - before[1] * after[0]
    return math.atan2(cross, float(before @ after))


def _arc(start: Points, heading: Points, radius_mm: float, turn: float) -> Points:
    """Return the points of an arc that leaves `start` along `heading`."""
    if radius_mm == 0:
        return start[None]
    n_chords = math.ceil(segments(radius_mm) * abs(turn) / (2 * math.pi))
    left = np.array([-heading[1], heading[0]]) * math.copysign(1.0, turn)
    angle = np.linspace(0.0, abs(turn), n_chords + 1)[:, None]
    return start + radius_mm * (np.sin(angle) * heading + (1 - np.cos(angle)) * left)


def ball_profile(radius_mm: float, center_z_mm: float, neck_radius_mm: float = 0.0) -> Points:
    """Return the (r, z) of a ball from its neck, or its lowest point, up to its pole, (n, 2), mm.

    Raises
    ------
    ValueError
        If the neck is as thick as the ball.
    """
    if not 0 <= neck_radius_mm < radius_mm:
        raise ValueError(
            f"neck: expected a radius of 0 to {radius_mm} mm (that of the ball), "
            f"found {neck_radius_mm}"
        )
    latitude = np.linspace(
        -math.acos(neck_radius_mm / radius_mm),
        math.pi / 2,
        math.ceil(math.pi / SPHERE_STEP) + 1,
    )
    arc = radius_mm * np.column_stack([np.cos(latitude), np.sin(latitude)])
    arc[-1, 0] = 0.0
    arc[0, 0] = neck_radius_mm
    arc[:, 1] += center_z_mm
    return arc


def turned(
    profile: ArrayLike,
    /,
    *,
    at: tuple[float, float] = (0.0, 0.0),
    stretch: tuple[float, float] = (0.0, 0.0),
    n_segments: int | None = None,
) -> Manifold:
    """Return a solid turned about the z axis, then stretched to a rounded rectangle.

    Parameters
    ----------
    profile : (n, 2), mm; counter-clockwise outline (r, z), closed along the axis
    at : (x, y), mm; where its axis stands
    stretch : (x, y), mm; how far the quarters are pulled apart
        The faces between them are plane and stand exactly where the profile puts them.
    n_segments : int or None; None chooses by `SAGITTA_MM`
    """
    rz = np.asarray(profile, np.float64)
    n = n_segments or segments(float(rz[:, 0].max()))
    solid = CrossSection([rz]).revolve(n)
    if any(stretch):
        half = np.array(stretch) / 2
        # Chords that are parallel to an axis become the plane sides, so they go to the radius.
        grow = 1 / math.cos(math.pi / n)
        solid = solid.rotate((0.0, 0.0, 180 / n)).scale((grow, grow, 1.0))
        solid = solid.warp_batch(lambda p: p + np.pad(half * _side(p[:, :2]), ((0, 0), (0, 1))))
    return solid.translate((*at, 0.0))


def _side(xy: Points) -> Points:
    """Return the sign of each coordinate; zero on the axis, whatever rounding left there."""
    return np.sign(np.where(np.abs(xy) < 1e-9, 0.0, xy))


def cylinder(
    radius_mm: float,
    z_mm: tuple[float, float],
    /,
    *,
    at: tuple[float, float] = (0.0, 0.0),
    stretch: tuple[float, float] = (0.0, 0.0),
    chamfer_mm: float = 0.0,
    fillet_mm: float = 0.0,
) -> Manifold:
    """Return an upright cylinder or rounded block from z_mm[0] to z_mm[1].

    Parameters
    ----------
    radius_mm : float; of the cylinder, or of the vertical edges of a stretched one
    z_mm : (bottom, top)
    chamfer_mm : float; at the upper edge
    fillet_mm : float; where it stands on a surface at its bottom; 0 for none
        With a fillet the solid reaches `THROUGH_MM` into what it stands on.
    """
    r, (bottom, top), c, f = radius_mm, z_mm, chamfer_mm, fillet_mm
    sunk = bottom - THROUGH_MM if f else bottom
    foot: list[Corner] = [(r + f, sunk), (r + f, bottom), (r, bottom, f)] if f else [(r, bottom)]
    head: list[Corner] = [(r, top - c), (r - c, top)] if c else [(r, top)]
    profile = outline([(0.0, sunk), *foot, *head, (0.0, top)])
    return turned(profile, at=at, stretch=stretch)


def bore(
    radius_mm: float,
    z_mm: tuple[float, float],
    /,
    *,
    at: tuple[float, float] = (0.0, 0.0),
    stretch: tuple[float, float] = (0.0, 0.0),
    chamfer_mm: float = 0.0,
    tip: bool = False,
) -> Manifold:
    """Return what a drill or end mill takes away between z_mm[0] and the surface at z_mm[1].

    Parameters
    ----------
    radius_mm : float
    z_mm : (bottom, surface)
    chamfer_mm : float; of the edge at the surface
    tip : bool; end in the cone of a drill, below the bottom
    """
    r, (bottom, top), c = radius_mm, z_mm, chamfer_mm
    lowest = bottom - (r * DRILL_TIP if tip else 0.0)
    mouth: list[Corner] = [(r, top - c), (r + c, top)] if c else []
    over = top + THROUGH_MM
    profile = outline([(0.0, lowest), (r, bottom), *mouth, (r + c, over), (0.0, over)])
    return turned(profile, at=at, stretch=stretch)


def prismatic(corners: Sequence[Corner], y_mm: tuple[float, float], /) -> Manifold:
    """Return the outline (x, z), counter-clockwise, drawn out along y from y_mm[0] to y_mm[1]."""
    front, back = y_mm
    solid = CrossSection([outline(corners)]).extrude(back - front)
    return solid.rotate((90.0, 0.0, 0.0)).translate((0.0, back, 0.0))


def union(solids: Iterable[Manifold], /) -> Manifold:
    """Return solids as one."""
    return sum(solids, Manifold())


def to_mesh(solid: Manifold, /, spheres: Sequence[tuple[ArrayLike, float]] = ()) -> Mesh:
    """Return the surface of a solid; its vertices on each sphere (centre, radius) made exact.

    Raises
    ------
    ValueError
        If the solid is empty or invalid.
    """
    if solid.status() != Error.NoError or solid.is_empty():
        raise ValueError(f"solid: expected a closed body, found none ({solid.status().name})")
    surface = solid.to_mesh64()
    vertices = np.array(surface.vert_properties[:, :3], np.float64)
    for center, radius in spheres:
        _snap(vertices, np.asarray(center, np.float64), radius)
    mesh = Mesh(vertices_mm=vertices, faces=surface.tri_verts.astype(np.int32))
    for center, radius in spheres:
        mesh = mesh.with_sphere(center, radius)
    return mesh


def _snap(vertices: Points, center: Points, radius_mm: float) -> None:
    """Move vertices that miss a sphere by rounding alone onto it, in place."""
    arm = vertices - center
    distance = np.linalg.norm(arm, axis=1)
    near = np.abs(distance - radius_mm) < ON_SPHERE_MM
    vertices[near] = center + arm[near] * (radius_mm / distance[near])[:, None]
