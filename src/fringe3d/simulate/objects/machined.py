"""A milled part with the features of a real one: bores, bosses, fillets, slots, an undercut."""

from __future__ import annotations

import math

from manifold3d import Manifold

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects.balls import ball_on_post
from fringe3d.simulate.objects.solid import (
    THROUGH_MM,
    Corner,
    bore,
    cylinder,
    outline,
    prismatic,
    to_mesh,
    turned,
    union,
)

DECK_Z = 8.0
"""Upper face of the base."""

FLANGE_XY, FLANGE_Z, HUB_Z = (-13.0, 6.5), 11.5, 20.0
BLOCK_XY, BLOCK_Z, STEP_Z = (18.25, 3.0), 19.0, 13.5
KNOB_XYZ = (9.0, -15.0, 16.5)
BOLTS_XY = ((-26.5, -17.0), (26.5, -17.0), (-26.5, 17.0), (26.5, 17.5))
TAPPED_XY = ((18.0, -12.0), (18.0, -18.0))


def machine_part(*, knob_radius_mm: float = 4.5) -> Mesh:
    """Return a milled part, 64 x 46 mm and 23 mm high.

    A base with chamfered edges and counterbored bolt holes; a flanged hub with a bore, a
    counterbore, blind bores and ribs; a block with a step and a T-slot; a ball knob, two pins,
    a long hole in a pocket; fillets where parts meet.

    Parameters
    ----------
    knob_radius_mm : float; of the ball, an exact sphere; 1 to 5

    Examples
    --------
    >>> machine_part().spheres
    array([[  9. , -15. ,  16.5,   4.5]])
    """
    if not 1 <= knob_radius_mm <= 5:
        raise ValueError(f"knob_radius_mm: expected 1 to 5, found {knob_radius_mm}")
    x, y, z = KNOB_XYZ
    knob = ball_on_post(knob_radius_mm, z, DECK_Z, at=(x, y))
    solid = union([_base(), _flanged_hub(), _block(), _pins()]) - _cuts()
    return to_mesh(solid + knob, [(KNOB_XYZ, knob_radius_mm)])


def _base() -> Manifold:
    profile = outline(
        [
            (0.0, 0.0),
            (5.5, 0.0),
            (6.0, 0.5),
            (6.0, DECK_Z - 0.8),
            (5.2, DECK_Z),
            (0.0, DECK_Z),
        ]
    )
    return turned(profile, stretch=(52.0, 34.0))


def _flanged_hub() -> Manifold:
    flange = cylinder(11.5, (DECK_Z, FLANGE_Z), at=FLANGE_XY, chamfer_mm=0.5, fillet_mm=1.5)
    hub = cylinder(6.0, (FLANGE_Z, HUB_Z), at=FLANGE_XY, chamfer_mm=0.7, fillet_mm=1.2)
    rib = prismatic(
        [(4.0, FLANGE_Z - 1.0), (10.5, FLANGE_Z - 1.0), (10.5, FLANGE_Z), (5.5, 18.0), (4.0, 18.0)],
        (-0.9, 0.9),
    )
    ribs = union(rib.rotate((0.0, 0.0, azimuth)) for azimuth in (30.0, 150.0, 270.0))
    return flange + hub + ribs.translate((*FLANGE_XY, 0.0))


def _block() -> Manifold:
    corner, fillet, edge = 2.5, 1.5, 1.0
    r = corner + fillet
    profile = outline(
        [
            (0.0, DECK_Z - THROUGH_MM),
            (r, DECK_Z - THROUGH_MM),
            (r, DECK_Z),
            (corner, DECK_Z, fillet),
            (corner, BLOCK_Z, edge),
            (0.0, BLOCK_Z),
        ]
    )
    return turned(profile, at=BLOCK_XY, stretch=(17.0, 11.0))


def _pins() -> Manifold:
    high = cylinder(2.5, (DECK_Z, 23.0), at=(4.0, 17.5), chamfer_mm=0.5, fillet_mm=1.0)
    low = cylinder(2.0, (DECK_Z, 18.0), at=(13.0, 18.0), chamfer_mm=0.5, fillet_mm=1.0)
    return high + low


def _cuts() -> Manifold:
    return union([_hub_bores(), _deck_holes(), _t_slot(), _step(), _long_hole(), _notches()])


def _hub_bores() -> Manifold:
    through = bore(3.0, (-THROUGH_MM, HUB_Z), at=FLANGE_XY)
    counter = bore(4.2, (HUB_Z - 4.0, HUB_Z), at=FLANGE_XY, chamfer_mm=0.4)
    azimuths = [math.radians(60.0 * k) for k in range(6)]
    blind = union(
        bore(
            1.1,
            (FLANGE_Z - 5.0, FLANGE_Z),
            at=(FLANGE_XY[0] + 9.0 * math.cos(a), FLANGE_XY[1] + 9.0 * math.sin(a)),
            chamfer_mm=0.25,
            tip=True,
        )
        for a in azimuths
    )
    return through + counter + blind


def _deck_holes() -> Manifold:
    """Return counterbored holes for bolts and blind ones for a thread."""
    bolts = union(
        bore(2.2, (-THROUGH_MM, DECK_Z), at=xy)
        + bore(3.7, (DECK_Z - 3.5, DECK_Z), at=xy, chamfer_mm=0.3)
        for xy in BOLTS_XY
    )
    return bolts + union(
        bore(1.6, (1.5, DECK_Z), at=xy, chamfer_mm=0.5, tip=True) for xy in TAPPED_XY
    )


def _t_slot() -> Manifold:
    """Return the tool path of a T-slot along y: narrow at the top, wide below."""
    x, neck, head = BLOCK_XY[0] + 3.0, 2.5, 4.7
    floor, shoulder, top = BLOCK_Z - 8.0, BLOCK_Z - 4.5, BLOCK_Z + THROUGH_MM
    corners: list[Corner] = [
        (x - head, floor, 0.4),
        (x + head, floor, 0.4),
        (x + head, shoulder, 0.4),
        (x + neck, shoulder),
        (x + neck, BLOCK_Z - 0.4),
        (x + neck + 0.4 + THROUGH_MM, top),
        (x - neck - 0.4 - THROUGH_MM, top),
        (x - neck, BLOCK_Z - 0.4),
        (x - neck, shoulder),
        (x - head, shoulder, 0.4),
    ]
    return prismatic(corners, (-12.0, 14.0))


def _step() -> Manifold:
    """Return what makes the left part of the block lower, with a fillet in its corner."""
    x, top = 14.0, BLOCK_Z + THROUGH_MM
    corners: list[Corner] = [(0.0, STEP_Z), (x, STEP_Z, 1.0), (x, top), (0.0, top)]
    return prismatic(corners, (-12.0, 14.0))


def _long_hole() -> Manifold:
    at, along = (-10.0, -15.0), (13.0, 0.0)
    pocket = bore(4.0, (DECK_Z - 3.0, DECK_Z), at=at, stretch=along, chamfer_mm=0.4)
    return pocket + bore(2.0, (-THROUGH_MM, DECK_Z), at=at, stretch=along)


def _notches() -> Manifold:
    """Return open slots for clamps in the left and the right side of the base."""
    height = (-THROUGH_MM, DECK_Z)
    left = bore(2.6, height, at=(-32.5, -4.5), stretch=(5.0, 0.0), chamfer_mm=0.4)
    right = bore(2.6, height, at=(32.5, -8.5), stretch=(5.0, 0.0), chamfer_mm=0.4)
    return left + right
