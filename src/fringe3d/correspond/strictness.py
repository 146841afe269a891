"""Points whose light may be that of two surfaces: most are left out, all where it matters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from fringe3d.correspond.choice import Choice
from fringe3d.correspond.visibility import is_hidden
from fringe3d.correspond.weighing import Task
from fringe3d.geometry import project
from fringe3d.model import Device, Rejection

Bools = NDArray[np.bool_]

MARGIN_PX = 1.0
"""Of C2 and the projector, next to what they do not see: light from there, and what the bias and
the depth of the surface leave unknown of the place."""

LACK, LACK_IN_C2, MISFIT, ALONE = 1.0, 0.5, 0.6, 0.6
"""What speaks against a pixel at a border, 0 to 1 each: the modulation that it lacks against its
brightest neighbour in C1, and in C2; its residual's square against the limit; and the part of its
neighbours that have no point."""

MOST_DOUBT, MOST_DOUBT_STRICT = 1.5, 0.98
"""What together may speak against a pixel. Of those beyond the first more are false than right."""

LEAST_MISSING = 0.01
"""Above the rounding of sums: one of nine is more."""

NEXT_PX = 3
"""Width of a pixel with its neighbours."""


def doubtful(
    task: Task,
    chosen: Choice,
    rejection: NDArray[np.uint16],
    surface: Bools,
    projector: Device,
    /,
    *,
    strict: bool,
) -> Iterator[tuple[Bools, Rejection]]:
    """Yield which pixels to do without, (row, col), and why.

    Parameters
    ----------
    task : Task
    chosen : Choice; orders (n,)
    rejection : (row, col) uint16; of what is refused in any case
    surface : (n,) bool; pixels whose order is well founded; the others hide nothing
    projector : Device
    strict : bool; without doubts that others may live with, too, as metrology does

    Notes
    -----
    At the border of what is measured a pixel's light is that of two surfaces, or of one in the
    light and one in the shadow: it is fainter than its neighbours, C2 sees another phase, and its
    point lies next to what the devices do not see. Together this tells such pixels, of which no
    sign alone is sure.
    """
    kept = task.valid & (rejection == 0)
    missing = 1 - uniform_filter(kept.astype(np.float64), NEXT_PX)
    border = kept & (missing > LEAST_MISSING)
    if strict:
        hidden = is_hidden(task, chosen, surface, projector, margin_px=MARGIN_PX)
        yield border & _spread(task, hidden), Rejection.HIDDEN
    misfit = _spread(task, np.nan_to_num(chosen.cost / task.limit, nan=1.0))
    lack1, lack2 = _lacks(task, chosen)
    doubt = LACK * lack1 + LACK_IN_C2 * lack2 + MISFIT * misfit + ALONE * missing
    yield border & (doubt > (MOST_DOUBT_STRICT if strict else MOST_DOUBT)), Rejection.EDGE


def _lacks(task: Task, chosen: Choice) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return which part of their brightest neighbour's modulation pixels lack, and their points in
    C2; (row, col) each, 0 where C2 does not see them."""
    views = task.views
    lack1, lack2 = (_lack(phases.modulation) for phases in (views.phases1, views.phases2))
    points = task.origin + chosen.depth_mm[:, None] * task.directions()
    places = project(views.camera2, points)
    col, row = np.rint(np.nan_to_num(places, nan=-1)).astype(np.int64).T
    is_inside = (row >= 0) & (col >= 0) & (row < lack2.shape[0]) & (col < lack2.shape[1])
    there = np.zeros(len(points))
    there[is_inside] = lack2[row[is_inside], col[is_inside]]
    return lack1, _spread(task, there)


def _lack(modulation: NDArray[np.float32]) -> NDArray[np.float64]:
    known = np.nan_to_num(modulation).astype(np.float64)
    brightest = maximum_filter(known, NEXT_PX)
    return 1 - np.divide(known, brightest, out=np.ones(known.shape), where=brightest > 0)


def _spread(task: Task, values: NDArray[Any]) -> NDArray[Any]:
    full = np.zeros(task.valid.shape, values.dtype)
    full[task.valid] = values
    return full
