"""Gauges with plane faces: a plane, a flat plate, a prism, a step gauge."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects.solid import Corner, cylinder, positive, prismatic, to_mesh


def plane(
    *,
    width_mm: float = 76.0,
    depth_mm: float = 60.0,
    thickness_mm: float = 4.0,
    tilt_deg: float = 0.0,
    azimuth_deg: float = 0.0,
) -> Mesh:
    """Return a round disc with two flats whose top is an exact plane.

    Parameters
    ----------
    width_mm, depth_mm : float; diameter of the disc; distance between its flats
    thickness_mm : float
    tilt_deg : float; angle between the top and the ground, less than 90
    azimuth_deg : float; direction in which the top rises, from x towards y

    Examples
    --------
    >>> float(plane().vertices_mm[:, 2].max())
    4.0
    """
    positive(width_mm=width_mm, depth_mm=depth_mm, thickness_mm=thickness_mm)
    if not 0 <= tilt_deg < 90:
        raise ValueError(f"tilt_deg: expected 0 to 90, found {tilt_deg}")
    disc = cylinder(width_mm / 2, (0.0, thickness_mm))
    band = Manifold.cube((width_mm, depth_mm, 3 * thickness_mm), True)
    solid = (disc ^ band).rotate((0.0, 0.0, -azimuth_deg)).rotate((0.0, -tilt_deg, 0.0))
    solid = solid.rotate((0.0, 0.0, azimuth_deg))
    return to_mesh(solid.translate((0.0, 0.0, -solid.bounding_box()[2])))


def flat_plate(
    *,
    width_mm: float = 62.0,
    depth_mm: float = 42.0,
    thickness_mm: float = 8.0,
    chamfer_mm: float = 1.0,
) -> Mesh:
    """Return a ground plate for tests of flatness; all its edges are chamfered at 45 deg.

    Examples
    --------
    >>> plate = flat_plate(thickness_mm=5.0)
    >>> [round(float(size), 6) for size in np.ptp(plate.vertices_mm, axis=0)]
    [62.0, 42.0, 5.0]
    """
    size = np.array([width_mm, depth_mm, thickness_mm])
    positive(width_mm=width_mm, depth_mm=depth_mm, thickness_mm=thickness_mm)
    if not 0 <= chamfer_mm < size.min() / 2:
        raise ValueError(
            f"chamfer_mm: expected 0 to {size.min() / 2:.4g} (half the smallest size), "
            f"found {chamfer_mm}"
        )
    # Each corner of the box makes way for three, one on each of its faces.
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    corners = [signs * (size / 2 - chamfer_mm * (np.arange(3) != axis)) for axis in range(3)]
    solid = Manifold.hull_points(np.concatenate(corners))
    return to_mesh(solid.translate((0.0, 0.0, thickness_mm / 2)))


def prism(
    *,
    width_mm: float = 44.0,
    length_mm: float = 46.0,
    slope_deg: float = 30.0,
    base_mm: float = 4.0,
    ledge_mm: float = 4.0,
) -> Mesh:
    """Return a symmetric roof on a base; its ridge runs along y.

    Parameters
    ----------
    width_mm, length_mm : float; of the roof, across and along the ridge
    slope_deg : float; angle of both roof faces to the ground
    base_mm : float; height of the base
    ledge_mm : float; how far the base stands out on all sides

    Examples
    --------
    >>> roof = prism(width_mm=40.0, slope_deg=45.0, base_mm=4.0)
    >>> round(float(roof.vertices_mm[:, 2].max()), 6)
    24.0
    """
    positive(width_mm=width_mm, length_mm=length_mm, base_mm=base_mm, ledge_mm=ledge_mm)
    if not 0 < slope_deg < 90:
        raise ValueError(f"slope_deg: expected 0 to 90, found {slope_deg}")
    half, end = width_mm / 2, length_mm / 2
    ridge = base_mm + half * math.tan(math.radians(slope_deg))
    roof: list[Corner] = [
        (-half, base_mm / 2),
        (half, base_mm / 2),
        (half, base_mm),
        (0.0, ridge),
        (-half, base_mm),
    ]
    edge = min(1.0, base_mm / 4, ledge_mm / 2)
    base = cylinder(ledge_mm, (0.0, base_mm), stretch=(width_mm, length_mm), chamfer_mm=edge)
    return to_mesh(base + prismatic(roof, (-end, end)))


def step_gauge(
    *,
    heights_mm: Sequence[float] = (3.0, 5.0, 9.0, 12.0, 17.0, 23.0),
    step_mm: float = 10.0,
    depth_mm: float = 40.0,
    chamfer_mm: float = 0.2,
) -> Mesh:
    """Return flat steps side by side along x, each of its own height.

    Parameters
    ----------
    heights_mm : of each step above the ground, from -x to +x
    step_mm : float; width of a step
    depth_mm : float; along y
    chamfer_mm : float; of the edge where a step ends above its neighbour; 0 for none

    Examples
    --------
    >>> gauge = step_gauge(heights_mm=(2.0, 4.0), chamfer_mm=0.0)
    >>> sorted({float(z) for z in gauge.vertices_mm[:, 2]})
    [0.0, 2.0, 4.0]
    """
    if len(heights_mm) < 1:
        raise ValueError("heights_mm: expected the height of at least one step, found none")
    for height in heights_mm:
        positive(height_mm=height)
    positive(step_mm=step_mm, depth_mm=depth_mm)
    levels = [0.0, *heights_mm, 0.0]
    rises = np.abs(np.diff(levels))
    smallest = min(step_mm, float(rises[rises > 0].min()))
    if not 0 <= chamfer_mm < smallest / 2:
        raise ValueError(
            f"chamfer_mm: expected 0 to {smallest / 2:.4g} (half the smallest step), "
            f"found {chamfer_mm}"
        )
    left = -step_mm * len(heights_mm) / 2
    corners: list[Corner] = [(left, 0.0), (-left, 0.0)]
    for i in reversed(range(len(heights_mm))):
        before, height, after = levels[i : i + 3]
        x = left + step_mm * i
        corners += _right_edge(x + step_mm, height, chamfer_mm, height - after)
        mirrored = _right_edge(-x, height, chamfer_mm, height - before)
        corners += [(-x_mirrored, z) for x_mirrored, z in reversed(mirrored)]
    return to_mesh(prismatic(corners, (-depth_mm / 2, depth_mm / 2)))


def _right_edge(
    x_mm: float, z_mm: float, chamfer_mm: float, drop_mm: float
) -> list[tuple[float, float]]:
    """Return the corners where a step ends on its right, counter-clockwise."""
    if drop_mm == 0:
        return []
    if drop_mm < 0 or chamfer_mm == 0:
        return [(x_mm, z_mm)]
    return [(x_mm, z_mm - chamfer_mm), (x_mm - chamfer_mm, z_mm)]
