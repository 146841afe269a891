"""Homologous points of recordings: what all devices see of the same light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import (
    Homologous,
    homologous_points,
)
from fringe3d.correspond import match_both_directions, match_cameras
from fringe3d.decode import CameraPhases
from fringe3d.geometry import closest_depths, pixel_grid, project, rays
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    PhaseMap,
)
from fringe3d.patterns import across

Floats = NDArray[np.float64]


def homologous_of(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    /,
    *,
    name: str = "",
) -> Homologous:
    """Return the homologous points of a measurement by two cameras or more.

    Parameters
    ----------
    phases : CameraPhases of each camera; the direction that was matched first
    matches : Correspondences of the second camera
    devices : the cameras of `phases`, then the projector if there is one
    name : str; of the scan
    """
    maps = [direction.main for direction in phases[0].directions]
    good = matches.rejection == 0
    origin, directions = rays(devices[0], pixel_grid(good.shape)[good])
    depths, _ = closest_depths(origin, directions, *rays(devices[1], matches.pixels[good]))
    points = np.full((*good.shape, 3), np.nan)
    points[good] = origin + depths[:, None] * directions
    projector = devices[-1] if devices[-1].role == "projector" else None
    seen = []
    for own, device in zip(phases[1:], devices[1:], strict=False):
        pixels = matches.pixels if device is devices[1] else project(device, points)
        pairs = zip(own.directions, maps, strict=True)
        seen.append((device.name, pixels, [direction.like(main) for direction, main in pairs]))
    orders: list[NDArray[np.int32] | None] = [matches.fringe_order, *[None] * (len(maps) - 1)]
    positions = [_position(m, o, points, projector) for m, o in zip(maps, orders, strict=True)]
    return homologous_points(maps, positions, seen, good, name=name)


def _position(
    phases: PhaseMap,
    orders: NDArray[np.int32] | None,
    points: Floats,
    projector: Device | None,
) -> Floats:
    """Return the coordinate w of the light in C1, (row, col); orders not known: the likeliest."""
    if phases.is_absolute:
        return phases.position_px
    turns = phases.phase.astype(np.float64) / (2 * np.pi)
    if projector is None:
        return np.asarray(turns * phases.period_px)  # only differences count
    if orders is not None:
        return np.asarray(np.where(orders == NO_ORDER, np.nan, turns + orders) * phases.period_px)
    x, y = np.moveaxis(project(projector, points), -1, 0)
    predicted = across(phases.angle, x, y) / phases.period_px
    return np.asarray((turns + np.rint(predicted - turns)) * phases.period_px)


def freely_matched(
    maps: Sequence[PhaseMap], maps2: Sequence[PhaseMap], devices: Sequence[Device]
) -> Correspondences | None:
    """Return the points of the second camera without projector and volume; None without a code."""
    c1, c2 = devices[:2]
    if len(maps) > 1 and all(m.is_absolute for m in (*maps[:2], *maps2[:2])):
        return match_both_directions((maps[0], maps[1]), (maps2[0], maps2[1]), c1, c2)
    return match_cameras(maps[0], maps2[0], c1, c2, None) if maps[0].is_absolute else None
