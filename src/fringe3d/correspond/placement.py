"""Points that C1 and the projector place, where the search in C2 finds no single crossing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fringe3d.correspond.chosen import ChosenOrders
from fringe3d.geometry import grid_rays, project, sheet_crossing
from fringe3d.model import Correspondences, Device, Rejection

LOST = np.uint16(Rejection.NO_MATCH | Rejection.AMBIGUOUS)


def place_lost(
    matches: Correspondences,
    chosen: ChosenOrders,
    camera1: Device,
    camera2: Device,
    projector: Device,
    /,
) -> Correspondences:
    """Place what the search in C2 lost by C1 and the light sheet of the chosen order.

    C2 has shown the order there, but next to edges, dark spots and steep walls its phase crosses
    that of C1 not at all or several times within the window.

    Parameters
    ----------
    matches : Correspondences
    chosen : ChosenOrders
    camera1, camera2, projector : Device

    Returns
    -------
    Correspondences; the places in C2 of these points are computed, the calibration's bias included,
        and their `sigma_px` is that of phase and bias in C1 and the projector
    """
    lost = (chosen.phases.rejection == 0) & (matches.rejection & LOST != 0)
    turns = chosen.phases.order_class[lost] + chosen.phases.phase[lost] / (2 * np.pi)
    w = turns * chosen.phases.period_px + chosen.place_px[lost]
    origin, directions = grid_rays(camera1)
    directions = directions[lost]
    angle, half = chosen.phases.angle, chosen.place_sigma_px[lost].astype(np.float64)
    here, there = (
        project(camera2, origin + depth[:, None] * directions)
        for depth in (
            sheet_crossing(projector, origin, directions, w + step, angle) for step in (0, half)
        )
    )
    sigma = np.linalg.norm(there - here, axis=1)
    good = np.isfinite(sigma) & (sigma > 0)
    lost[lost] = good
    pixels, sigmas = matches.pixels.copy(), matches.sigma_px.copy()
    rejection = matches.rejection.copy()
    pixels[lost], sigmas[lost], rejection[lost] = here[good], sigma[good], 0
    return replace(
        matches,
        pixels=pixels,
        sigma_px=sigmas,
        rejection=rejection,
        order_probability=None,
    )
