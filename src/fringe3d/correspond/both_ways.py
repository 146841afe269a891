"""The check both ways: C2, asked in its turn, must find the same orders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _around
from fringe3d.correspond.bias import Frame
from fringe3d.correspond.choice import Choice, Placed
from fringe3d.correspond.grid import spread
from fringe3d.correspond.limits import CLEAR, TWO_PI
from fringe3d.correspond.weighing import Task, TwoViews
from fringe3d.geometry import project, rays, sheet_crossing
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, CalibrationBias, Device, Rejection
from fringe3d.model.bias import terms_of
from fringe3d.patterns import across

SAME_ORDER = 0.5
"""Periods between what C1 and C2 decide for one point."""

ASKED_PX = 8
"""Pixels around those of C2 that are asked, whose phases have a say among their neighbours."""

BIAS_SAMPLE, AROUND = 4000, 0.1
"""Rays along which a smooth displacement is carried over to the other camera, and how far before
and behind the chosen points, of the depth in which surfaces are expected: over all of it the
displacement is not linear in the depth of the other camera."""


def swapped(views: TwoViews, /) -> TwoViews:
    """Return the views with C1 and C2 exchanged."""
    return TwoViews(
        camera1=views.camera2,
        camera2=views.camera1,
        phases1=views.phases2,
        phases2=views.phases1,
        second1=views.second2,
        second2=views.second1,
        periods1=views.periods2,
        periods2=views.periods1,
    )


def asked_of_c2(task: Task, chosen: Choice, /) -> TwoViews:
    """Return the views with C1 and C2 exchanged, but of the new C1 only the pixels that see points
    that may be accepted, and some around them: no one asks the others."""
    views = swapped(task.views)
    where = np.flatnonzero(chosen.is_inside & ~(chosen.cost > task.limit))
    claimed = np.zeros(views.phases1.phase.shape, np.bool_)
    rays_2 = (task.where[where], *task.rays_2[1:])
    over_rows(_around.claim, len(where), chosen.depth_mm[where], rays_2, task.camera2, claimed)
    left_out = np.where(spread(claimed, ASKED_PX), np.uint16(0), np.uint16(Rejection.NO_MATCH))
    return replace(views, phases1=views.phases1.rejecting(left_out))


def swapped_bias(
    bias: CalibrationBias, task: Task, chosen: Placed, projector: Device, frame: Frame
) -> CalibrationBias:
    """Return the same bias as C2 and the projector see it in C1, around the chosen points.

    A pixel of C1 and a light sheet place a point; C2 sees it displaced. From there, with the same
    sheet, C2 places another point, which C1 sees displaced against its pixel.
    """
    views, angle = task.views, task.views.phases1.angle
    pixels, depths = _places(task, chosen)
    origin, directions = rays(views.camera1, pixels)
    points = origin + depths[:, None] * directions
    x, y = project(projector, points).T
    seen = project(views.camera2, points) - bias.displacement(pixels, depths)
    origin2, directions2 = rays(views.camera2, seen)
    depths2 = sheet_crossing(projector, origin2, directions2, across(angle, x, y), angle)
    missed = project(views.camera1, origin2 + depths2[:, None] * directions2) - pixels
    usable = np.isfinite(missed).all(axis=1)
    terms = terms_of(seen[usable], depths2[usable], frame.middle, frame.scale)
    coefficients = np.linalg.lstsq(terms, missed[usable])[0].T.astype(np.float64)
    return frame.bias(coefficients.ravel(), scatter_px=bias.scatter_px)


def _places(task: Task, chosen: Placed) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return pixels (n, 2) and depths (n,), mm, at chosen points and a little around them."""
    known = np.flatnonzero(chosen.order != NO_ORDER)
    index = known[:: max(1, len(known) // BIAS_SAMPLE)]
    around = AROUND * np.diff(task.wide_ends(index)) * (-1, 0, 1)
    depths = chosen.depth_mm[index, None] + around
    return np.repeat(task.pixels[index], 3, axis=0), depths.ravel()


def agrees_with_c2(
    task: Task, chosen: Choice, back: Task, chosen_back: Choice, *, strict: bool
) -> NDArray[np.bool_]:
    """Tell whether C2, asked in its turn, found the same order where it sees the point.

    A point that something hides from C2 fits what C2 sees there by chance. One pixel around it
    that agrees is enough, and so is that none is certain of its order; if strict, one that is
    certain must agree. Of several candidates one is likelier to fit by chance: where there is one
    alone in the volume, only the pixel that sees the point can refute it. C2 sees many a steep wall
    one pixel wide, between surfaces of other orders.
    """
    camera2, phases2 = task.views.camera2, task.views.phases2
    turns1 = chosen.order + task.first[0] / TWO_PI
    decided = chosen_back.order != NO_ORDER
    certain = decided & (chosen_back.probability > CLEAR) & (chosen_back.cost <= task.limit)
    turns2, certain2 = np.full(camera2.shape, np.nan), np.zeros(camera2.shape, bool)
    turns2[back.valid] = np.where(
        decided, chosen_back.order + phases2.phase[back.valid] / TWO_PI, np.nan
    )
    certain2[back.valid] = certain
    is_alone = task.n_inside() < 2
    n_certain, n_agree = np.empty(len(turns1), np.int8), np.empty(len(turns1), np.int8)
    over_rows(
        _around.count, len(turns1), chosen.depth_mm, task.rays_2, task.camera2, turns1, is_alone,
        (turns2, certain2), SAME_ORDER, strict, n_certain, n_agree,
    )  # fmt: skip
    return np.asarray((n_agree > 0) | ((n_certain == 0) & (not strict)))
