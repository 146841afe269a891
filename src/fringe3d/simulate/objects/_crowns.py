"""Crowns of lower teeth, each in its own frame.

u runs along the arch (away from the middle), v outwards (to the cheek), w up from the gum line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fringe3d.simulate.objects._implicit import Values, common, union

Cusp = tuple[float, float, float]
Line = tuple[tuple[float, float], ...]

ROOT_MM = 5.0
"""mm; how far a crown goes on below the gum line."""

CUSP_TIP_MM = 0.45
"""mm; radius of a cusp."""

FISSURE_MM = 0.24
"""mm; half-width of a fissure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crown:
    """Shape of a crown.

    Parameters
    ----------
    width_mm, depth_mm : largest extent along u and v
    height_mm : of the highest cusp or edge above the gum line
    neck : share of the width that is left at the gum line
    widest : share of the height at which the crown is widest
    edge_mm : thickness along v at the top; less than the depth makes a wedge
    squareness : exponent of the outline; 2 is an ellipse
    cusps : (u, v, height below the highest), mm; a single one is a canine; none an incisor
    slope : fall of a cusp per mm
    ridges : (u, height below the highest), mm; marginal ridges
    fissures : lines (u, v), mm
    fissure_mm : depth of the fissures
    """

    width_mm: float
    depth_mm: float
    height_mm: float
    neck: float = 0.74
    widest: float = 0.7
    edge_mm: float = 1.5
    squareness: float = 2.4
    cusps: tuple[Cusp, ...] = ()
    slope: float = 0.78
    ridges: tuple[tuple[float, float], ...] = ()
    fissures: tuple[Line, ...] = ()
    fissure_mm: float = 0.4


CENTRAL = Crown(
    width_mm=5.3, depth_mm=5.8, height_mm=8.6, neck=0.66, widest=0.88, edge_mm=1.5,
    squareness=2.7,
)  # fmt: skip
LATERAL = replace(CENTRAL, width_mm=5.8, depth_mm=6.1, height_mm=8.7)
CANINE = Crown(
    width_mm=6.9, depth_mm=7.4, height_mm=9.6, neck=0.72, edge_mm=1.7, squareness=2.1,
    cusps=((-0.3, 0.0, 0.0),), slope=0.55,
)  # fmt: skip
FIRST_PREMOLAR = Crown(
    width_mm=7.0, depth_mm=7.7, height_mm=8.3, edge_mm=5.6, squareness=2.2,
    cusps=((-0.1, 1.35, 0.0), (0.0, -2.2, 2.0)),
    ridges=((-2.6, 1.75), (2.6, 1.75)),
    fissures=(((-1.9, -0.7), (0.0, -1.05), (1.9, -0.7)),),
)  # fmt: skip
SECOND_PREMOLAR = Crown(
    width_mm=7.2, depth_mm=8.3, height_mm=7.9, edge_mm=6.2, squareness=2.4,
    cusps=((0.0, 1.8, 0.0), (-1.3, -2.2, 0.9), (1.5, -2.2, 1.15)),
    ridges=((-2.75, 1.4), (2.75, 1.4)),
    fissures=(((-2.0, 0.0), (0.0, -0.35), (2.0, 0.0)), ((0.0, -0.35), (0.1, -3.4))),
)  # fmt: skip
FIRST_MOLAR = Crown(
    width_mm=11.0, depth_mm=10.4, height_mm=7.5, neck=0.8, edge_mm=8.0, squareness=3.0,
    cusps=((-3.1, 2.35, 0.1), (0.4, 2.7, 0.2), (3.5, 1.6, 0.6), (-2.6, -2.7, 0.0),
           (2.3, -2.75, 0.15)),
    ridges=((-4.5, 0.9), (4.5, 1.1)),
    fissures=(((-3.6, 0.1), (-1.3, -0.2), (0.2, 0.2), (1.9, -0.1), (3.6, -0.1)),
              ((-1.4, -0.2), (-1.35, 5.0)), ((1.9, -0.1), (2.3, 5.0)),
              ((0.2, 0.2), (-0.1, -5.0))),
)  # fmt: skip
SECOND_MOLAR = Crown(
    width_mm=10.4, depth_mm=10.0, height_mm=7.1, neck=0.8, edge_mm=7.6, squareness=3.0,
    cusps=((-2.4, 2.45, 0.0), (2.3, 2.4, 0.2), (-2.3, -2.55, 0.05), (2.2, -2.5, 0.25)),
    ridges=((-4.2, 0.9), (4.2, 1.1)),
    fissures=(((-3.3, 0.1), (0.0, -0.1), (3.3, 0.1)), ((0.0, -0.1), (0.1, 5.0)),
              ((0.0, -0.1), (-0.1, -5.0))),
)  # fmt: skip

HALF_ARCH = (
    CENTRAL,
    LATERAL,
    CANINE,
    FIRST_PREMOLAR,
    SECOND_PREMOLAR,
    FIRST_MOLAR,
    SECOND_MOLAR,
)


def crown_field(local: Values, crown: Crown) -> Values:
    """Return the field of a crown at points (u, v, w), mm."""
    u, v, w = local
    return common(_walls(u, v, w, crown), _below_top(u, v, w, crown), 0.7)


def _walls(u: Values, v: Values, w: Values, crown: Crown) -> Values:
    """Return the field of the sides: widest above the middle, narrow at the neck and the top."""
    part = np.clip(w / crown.height_mm, -ROOT_MM / crown.height_mm, 1.2)
    half_u = crown.width_mm / 2 * _belly(part, crown.neck, crown.widest, 0.93)
    if len(crown.cusps) > 1:
        half_v = crown.depth_mm / 2 * _belly(part, 0.86, 0.42, crown.edge_mm / crown.depth_mm)
        middle = np.zeros_like(part)
    else:
        outer = 0.5 * crown.depth_mm * _belly(part, 0.86, 0.25, 0.3)
        # The tongue side is hollow above the cingulum.
        fall = np.clip((part - 0.12) / 0.75, 0.0, 1.0)
        inner = 0.5 * crown.depth_mm * (0.88 - 0.8 * fall * (1.3 - 0.3 * fall))
        inner = np.maximum(inner, crown.edge_mm - outer)
        half_v, middle = (outer + inner) / 2, (outer - inner) / 2
    return _superellipse(u, v - middle, half_u, half_v, crown.squareness)


def _belly(part: Values, at_neck: float, widest: float, at_top: float) -> Values:
    """Return a profile that is 1 at its widest height and bends to both ends."""
    below = np.clip((widest - part) / widest, 0.0, 2.0)
    above = np.clip((part - widest) / (1 - widest), 0.0, 1.5)
    return np.asarray(1 - (1 - at_neck) * below**1.6 - (1 - at_top) * above**2)


def _superellipse(u: Values, v: Values, half_u: Values, half_v: Values, power: float) -> Values:
    """Return about the distance from a cylinder with a rounded square outline."""
    a, b = np.abs(u) / half_u + 1e-6, np.abs(v) / half_v + 1e-6
    level = (a**power + b**power) ** (1 / power)
    slope = np.hypot(a ** (power - 1) / half_u, b ** (power - 1) / half_v) / level ** (power - 1)
    return np.asarray((level - 1) / slope)


def _below_top(u: Values, v: Values, w: Values, crown: Crown) -> Values:
    """Return the field of all that is below the chewing surface."""
    if not crown.cusps:
        lobes = 0.08 * np.cos(2 * np.pi * u / (0.36 * crown.width_mm))
        top = crown.height_mm - 0.012 * u**2 + lobes
        return np.asarray(w - top)
    deep = np.full_like(u, np.inf)
    for cusp in crown.cusps:
        deep = union(deep, _cusp(u, v, cusp, crown.slope), 0.2)
    for at, below in crown.ridges:
        ridge = below + 1.1 * (np.hypot(u - at, 0.3) - 0.3) + 0.02 * v**2
        deep = union(deep, ridge, 0.5)
    for line in crown.fissures:
        deep = deep + crown.fissure_mm * np.exp(-((_distance(u, v, line) / FISSURE_MM) ** 2) / 2)
    return np.asarray((w - crown.height_mm + deep) / np.hypot(1.0, crown.slope))


def _cusp(u: Values, v: Values, cusp: Cusp, slope: float) -> Values:
    """Return how deep a cone is below its tip; it sends a ridge towards the middle."""
    du, dv = u - cusp[0], v - cusp[1]
    length = np.hypot(cusp[0], cusp[1]) + 1e-9
    along = -(du * cusp[0] + dv * cusp[1]) / length
    across = (du * cusp[1] - dv * cusp[0]) / length
    ridge = np.where(along > 0, 0.8, 1.1) * along
    return np.asarray(
        cusp[2] + slope * (np.sqrt(ridge**2 + 1.9 * across**2 + CUSP_TIP_MM**2) - CUSP_TIP_MM)
    )


def _distance(u: Values, v: Values, line: Line) -> Values:
    """Return the distance from a line of several pieces."""
    nearest = np.full_like(u, np.inf)
    for (u0, v0), (u1, v1) in pairwise(line):
        du, dv = u1 - u0, v1 - v0
        part = np.clip(((u - u0) * du + (v - v0) * dv) / (du**2 + dv**2), 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(u - u0 - part * du, v - v0 - part * dv))
    return nearest
