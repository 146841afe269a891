"""Which points cannot be what they seem: their light is another's, or they are hidden."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _light
from fringe3d.correspond.choice import Choice, Placed
from fringe3d.correspond.limits import TWO_PI
from fringe3d.correspond.occlusion import hidden_from
from fringe3d.correspond.surfaces import surfaces
from fringe3d.correspond.weighing import Task
from fringe3d.geometry import sheet_crossing
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import NO_ORDER, Device

Bools = NDArray[np.bool_]

APART = 0.5
"""Of the way that a ray of C1 goes in one period; what lies closer is one surface."""

CONTESTED = 0.5
"""Part of a surface whose light a larger one takes: borders of true surfaces stay below."""

SAMPLE = 2000

GAP_COLS = 8
"""Every eighth column tells how far apart pixels of C1 lie in the projector image."""


def takes_foreign_light(task: Task, chosen: Placed, trusted: Bools, projector: Device, /) -> Bools:
    """Tell which pixels belong to a surface that cannot be, as a larger one has its light.

    A surface of wrong order that both cameras agree on, for each sees there what is hidden from the
    other, lies in the light of another surface, or behind it. Where two surfaces claim most of the
    same light the smaller one is wrong.

    Parameters
    ----------
    task : Task
    chosen : Choice; orders (n,)
    trusted : (n,) bool; pixels whose order is well founded; the others claim nothing
    projector : Device

    Returns
    -------
    (n,) bool
    """
    claims = trusted & (chosen.order != NO_ORDER)
    wrong = np.zeros(len(claims), bool)
    if not claims.any():
        return wrong
    surface = surfaces(task, chosen.order, claims)
    sizes = np.bincount(surface)
    claimed = np.flatnonzero(claims)
    ray, light = np.empty(len(claimed)), np.empty((len(claimed), 2))
    over_rows(_light.write_light, len(claimed), claimed, chosen.depth_mm, task.rays_p,
              task.projector[:2], ray, light, least=POINTS)  # fmt: skip
    cell, n_cells = _cells(light, task, claims)
    owner = np.empty(n_cells, np.int64)
    _light.find_owners(cell, sizes[surface], owner)
    apart = np.abs(ray - ray[owner[cell]]) > APART * _way_in_a_period(task, chosen, projector)
    contested = apart & (surface != surface[owner[cell]])
    share = np.bincount(surface, contested) / np.maximum(sizes, 1)
    wrong[claims] = share[surface] > CONTESTED
    return wrong


def is_hidden(
    task: Task, chosen: Choice, trusted: Bools, projector: Device, /, *, margin_px: float = 0.0
) -> Bools:
    """Tell which pixels show a point that C2 does not see, or that the projector does not light.

    C1 and the light sheets of the chosen orders place the surface: C2, where it sees two of its
    parts in one pixel, would place it wrongly.

    Parameters
    ----------
    task : Task
    chosen : Choice; orders (n,)
    trusted : (n,) bool; pixels whose order is well founded; the others hide nothing
    projector : Device
    margin_px : float; see `hidden_from`

    Returns
    -------
    (n,) bool
    """
    if not trusted.any():
        return np.zeros(len(trusted), bool)
    depths, noise = np.full((2, *task.valid.shape), np.nan)
    depths[task.valid] = np.where(trusted, chosen.depth_mm, np.nan)
    noise[task.valid] = task.first[1] / TWO_PI * _way_in_a_period(task, chosen, projector)
    devices = task.views.camera2, projector
    hidden = hidden_from(devices, task.views.camera1, depths, noise, margin_px=margin_px)
    return np.asarray(hidden[task.valid])


def _cells(light: NDArray[np.float64], task: Task, claims: Bools) -> tuple[NDArray[np.intp], int]:
    """Return the cell of the projector image of each point, and how many there are.

    Cells are twice as wide as pixels of C1 lie apart there: surfaces leave hardly any empty.
    """
    place = np.full(len(claims), -1)
    place[claims] = np.arange(len(light))
    number = task.index[:, ::GAP_COLS]
    pairs = np.stack([number[:-1], number[1:]], axis=-1)
    pairs = place[pairs[(pairs >= 0).all(axis=-1)]]
    first, second = pairs[(pairs >= 0).all(axis=-1)].T
    gaps = np.linalg.norm(light[first] - light[second], axis=-1)
    gap = float(np.nanmedian(gaps)) if np.isfinite(gaps).any() else 1.0
    found = np.nan_to_num(np.floor(light / max(2 * gap, 1.0)), nan=0.0).astype(np.int64)
    found -= found.min(axis=0)
    n_rows, n_cols = found[:, 1].max() + 1, found[:, 0].max() + 1
    return found[:, 1] * n_cols + found[:, 0], int(n_rows * n_cols)


def _way_in_a_period(task: Task, chosen: Placed, projector: Device) -> float:
    """Return how far a ray of C1 goes from one light sheet of its phase to the next, mm."""
    known = np.flatnonzero(chosen.order != NO_ORDER)
    index = known[:: max(1, len(known) // SAMPLE)]
    phases = task.views.phases1
    turns = chosen.order[index] + task.first[0][index] / (2 * np.pi)
    next_one = sheet_crossing(
        projector, task.origin, task.directions(index), (turns + 1) * phases.period_px, phases.angle
    )
    return float(np.nanmedian(np.abs(next_one - chosen.depth_mm[index])))
