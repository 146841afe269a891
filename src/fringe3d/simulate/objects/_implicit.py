"""Solids as signed fields (negative inside, about a distance in mm) and their triangle meshes.

Points are coordinates first, (3, n): that keeps x, y and z contiguous.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.measure import marching_cubes

from fringe3d.simulate.mesh import Mesh

Values = NDArray[np.float64]
Solid = Callable[[Values], Values]

BLOCK = 4
"""Grid nodes along the edge of a block that is evaluated or skipped as a whole."""

STEEPEST = 1.6
"""Largest slope of a field; products of stretched ellipsoids and displacements exceed 1."""

CHUNK = 1 << 14
"""Points evaluated at once; some dozen temporaries of that size stay in the cache."""

RELAXATION, RELAXATION_STEPS = 0.5, 2
NEWTON_STEPS = 3
GRADIENT_STEP_MM = 1e-4
TINY = 1e-9

FAR_MM = 10.0
"""Margin of the box of `within`; added outside, so that no blend reaches there."""


def ellipsoid(points: Values, center: ArrayLike, radii: ArrayLike) -> Values:
    """Return the field of an ellipsoid along the axes; exact to first order at the surface."""
    scaled = (points - _column(center)) / _column(radii)
    level = _norm(scaled)
    return np.asarray(level * (level - 1) / (_norm(scaled / _column(radii)) + TINY))


def capsule(
    points: Values, start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float
) -> Values:
    """Return the distance from the hull of two balls, at most one inside the other."""
    origin, axis = np.asarray(start, np.float64), np.subtract(end, start)
    length = float(np.linalg.norm(axis))
    slope = (end_radius - start_radius) / length
    offset = points - origin[:, None]
    along = (axis / length) @ offset
    across = np.sqrt(np.maximum(_dot(offset, offset) - along * along, 0.0))
    # The ball that touches a point next sits where the normal of the cone meets the axis.
    foot = along + across * (slope / np.sqrt(max(1 - slope**2, TINY)))
    np.clip(foot, 0.0, length, out=foot)
    return np.asarray(np.hypot(along - foot, across) - (start_radius + slope * foot))


def within(solid: Solid, points: Values, lower: ArrayLike, upper: ArrayLike) -> Values:
    """Evaluate a solid inside a box only; farther away return a bound, the distance to the box.

    The box has to exceed the solid, and the blends it takes part in, by `FAR_MM`.
    """
    middle, half = np.add(lower, upper) / 2, np.subtract(upper, lower) / 2
    outside = np.maximum(np.abs(points - _column(middle)) - _column(half), 0.0)
    values = _norm(outside)
    inside = values == 0
    if inside.any():
        values[inside] = solid(np.ascontiguousarray(points[:, inside]))
    values[~inside] += FAR_MM
    return values


def union(first: Values, second: Values, blend_mm: float) -> Values:
    """Return the union of two fields; where they differ by less than the blend, rounded."""
    overlap = np.maximum(blend_mm - np.abs(first - second), 0.0)
    return np.asarray(np.minimum(first, second) - overlap**2 / (4 * blend_mm))


def common(first: Values, second: Values, blend_mm: float) -> Values:
    """Return the intersection of two fields with a rounded edge."""
    return -union(-first, -second, blend_mm)


def carved(body: Values, tool: Values, blend_mm: float) -> Values:
    """Return a body without a tool, with a rounded edge."""
    return common(body, -tool, blend_mm)


def bump(points: Values, center: ArrayLike, widths: ArrayLike) -> Values:
    """Return a Gaussian hill of height 1, for displacements; widths are standard deviations."""
    return np.asarray(np.exp(-0.5 * (((points - _column(center)) / _column(widths)) ** 2).sum(0)))


def rotation(axis: int, angle_deg: float) -> Values:
    """Return the matrix of a turn about a coordinate axis, right-handed."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    matrix[a, a] = matrix[b, b] = cosine
    matrix[b, a], matrix[a, b] = sine, -sine
    return matrix


def in_chunks(solid: Solid, points: Values) -> Values:
    """Evaluate a field some points at a time."""
    values = np.empty(points.shape[1])
    for start in range(0, len(values), CHUNK):
        part = slice(start, start + CHUNK)
        values[part] = solid(np.ascontiguousarray(points[:, part]))
    return values


def mesh_of(
    solid: Solid, lower_mm: ArrayLike, upper_mm: ArrayLike, resolution_mm: float, /
) -> Mesh:
    """Return the surface of a solid above the plane z = 0, closed by that plane.

    Parameters
    ----------
    solid : maps points (3, n), mm, to a field (n,), mm
    lower_mm, upper_mm : corners (3,) of a box around the solid, mm; the lower z is not used
    resolution_mm : edge of the grid, mm
    """

    def standing(points: Values) -> Values:
        return np.asarray(np.maximum(solid(points), -points[2]))

    lower, upper = np.array(lower_mm, np.float64), np.asarray(upper_mm, np.float64)
    # Nodes half a cell off z = 0 make the linear interpolation of the plane exact.
    lower[:2] -= 2 * resolution_mm
    lower[2] = -2.5 * resolution_mm
    n_blocks = [int(np.ceil(n)) for n in (upper - lower) / (resolution_mm * BLOCK) + 0.5]
    field = _sampled(standing, lower, n_blocks, resolution_mm)
    surface = marching_cubes(field, 0.0, gradient_direction="descent")  # type: ignore[no-untyped-call]
    nodes, faces = surface[:2]
    vertices = lower[:, None] + nodes.T.astype(np.float64) * resolution_mm
    vertices = _projected(standing, _relaxed(vertices, faces, resolution_mm), resolution_mm)
    vertices[2, vertices[2] < GRADIENT_STEP_MM] = 0.0
    return Mesh(vertices_mm=vertices.T, faces=faces)


def _sampled(solid: Solid, lower: Values, n_blocks: list[int], step: float) -> NDArray[np.float32]:
    """Return the field on a grid; far from the surface only its sign is right."""
    corners = np.indices(n_blocks).reshape(3, -1) * BLOCK
    middle = in_chunks(solid, lower[:, None] + (corners + (BLOCK - 1) / 2) * step)
    reach = STEEPEST * step * BLOCK * np.sqrt(3) / 2
    near = np.flatnonzero(np.abs(middle) < reach)
    blocks = np.repeat(middle.astype(np.float32)[:, None], BLOCK**3, axis=1)
    cell = np.indices((BLOCK,) * 3).reshape(3, 1, -1)
    nodes = (corners[:, near, None] + cell).reshape(3, -1)
    blocks[near] = in_chunks(solid, lower[:, None] + nodes * step).reshape(len(near), -1)
    # A node on the surface itself would give triangles without area.
    blocks[np.abs(blocks) < GRADIENT_STEP_MM * step] = GRADIENT_STEP_MM * step
    shape = (*n_blocks, BLOCK, BLOCK, BLOCK)
    return blocks.reshape(shape).transpose(0, 3, 1, 4, 2, 5).reshape([n * BLOCK for n in n_blocks])


def _relaxed(vertices: Values, faces: NDArray[np.int32], resolution_mm: float) -> Values:
    """Even out the slivers of marching cubes; the sharp edge at the table stays."""
    start, end = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    count = np.bincount(start, minlength=vertices.shape[1])
    share = np.where(vertices[2] > 1.5 * resolution_mm, RELAXATION, 0.0)
    relaxed = vertices
    for _ in range(RELAXATION_STEPS):
        sums = [np.bincount(start, row[end], minlength=vertices.shape[1]) for row in relaxed]
        relaxed = relaxed + share * (np.stack(sums) / count - relaxed)
    return np.asarray(relaxed)


def _projected(solid: Solid, vertices: Values, resolution_mm: float) -> Values:
    """Move vertices onto the zero set, at most half a cell."""
    value = in_chunks(solid, vertices)
    shifts = GRADIENT_STEP_MM * np.eye(3)
    shifted = [in_chunks(solid, vertices + shift[:, None]) for shift in shifts]
    gradient = (np.stack(shifted) - value) / GRADIENT_STEP_MM
    gradient /= np.maximum(_dot(gradient, gradient), 0.1)
    limit = 0.5 * resolution_mm / (_norm(gradient) + TINY)
    # The way is short: the first gradient serves all steps.
    way = np.clip(value, -limit, limit)
    for _ in range(NEWTON_STEPS - 1):
        way = np.clip(way + in_chunks(solid, vertices - way * gradient), -limit, limit)
    return np.asarray(vertices - way * gradient)


def _column(vector: ArrayLike) -> Values:
    """Return three numbers as (3, 1)."""
    return np.asarray(vector, np.float64).reshape(3, 1)


def _norm(vectors: Values) -> Values:
    """Return the lengths of vectors (3, n)."""
    return np.asarray(np.sqrt(_dot(vectors, vectors)))


def _dot(first: Values, second: Values) -> Values:
    """Return the products of vectors (3, n)."""
    return np.asarray(np.einsum("ij,ij->j", first, second))
