"""A full code leaves one order; C2 confirms it or not (method M1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _single
from fringe3d.correspond.candidates import FIT_SIGMA, learnt_coarsely
from fringe3d.correspond.chosen import LEAST_RATIO, SEARCH_TURNS
from fringe3d.correspond.curves import ray_curves
from fringe3d.correspond.direct import Judging, Located, locate
from fringe3d.correspond.limits import MOST_SIGMA, TWO_PI
from fringe3d.correspond.projector import GUARD_PX, GUARD_SIGMA
from fringe3d.correspond.weighing import TwoViews
from fringe3d.geometry import grid_rays
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import over_rows
from fringe3d.model import CalibrationBias, Device, MeasuringVolume


class Confirmed(NamedTuple):
    """Which orders C2 confirms.

    Parameters
    ----------
    rejection : (row, col) uint16; with the reasons of C1's phases
    half_px : (row, col) float32, projector px; how far around its phase C2 sees the point; NaN
        where it is located already
    bias : CalibrationBias; as given, or learnt
    located : Located or None; the points that were found at once
    """

    rejection: NDArray[np.uint16]
    half_px: NDArray[np.float32]
    bias: CalibrationBias
    located: Located | None


def confirm_orders(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    /,
    *,
    bias: CalibrationBias | None = None,
    fit_sigma: float = FIT_SIGMA,
    plain: bool = False,
) -> Confirmed:
    """Ask C2 whether it sees the phase of each pixel where its order puts the point.

    What `choose_orders` does, where there is nothing to choose, in one pass over the pixels.

    Parameters
    ----------
    views : TwoViews; the phases of C1 absolute
    projector : Device
    volume : MeasuringVolume
    bias : CalibrationBias or None; of the rig; None learns it from the images
    fit_sigma : float; residuals beyond are no fit
    plain : bool; one pixel at a time, without `locate`: slow, and the same. For comparison
    """
    phases1, phases2 = views.phases1, views.phases2
    bias = learnt_coarsely(views, projector, volume, fit_sigma, known=bias)
    origin, rays = grid_rays(views.camera1)
    tables = ray_curves(views.camera1, views.camera2, projector, volume, phases1.angle)
    to_p, to_2 = projector.device_from_world, views.camera2.device_from_world
    axis = np.array([np.cos(phases1.angle), np.sin(phases1.angle)])
    located, rejection = None, phases1.rejection.copy()
    todo = np.ones(rejection.shape, np.bool_)
    if not plain:
        judging = Judging(bias, fit_sigma**2, SEARCH_TURNS, LEAST_RATIO)
        located = locate(views, projector, volume, judging=judging)
        rejection, todo = located.met.rejection, located.todo
    half = np.empty(rejection.shape, np.float32)
    over_rows(
        _single.confirm,
        len(rejection),
        (phases1.phase, phases1.order_class, phases1.phase_std, phases1.period_px),
        (tables.ends, tables.curves, tables.wide, tables.inner, rays, to_p.rotation,
         to_2.rotation),
        (to_p.apply(origin), lens_of(projector), axis),
        (to_2.apply(origin), lens_of(views.camera2)),
        (phases2.phase, phases2.phase_std, phases2.order_class),
        (phases1.class_of_order, phases1.first_order, GUARD_SIGMA * phases1.period_px / TWO_PI,
         GUARD_PX),
        (bias.coefficients_px, bias.middle, bias.scale, bias.scatter_px),
        (fit_sigma**2, MOST_SIGMA, *SEARCH_TURNS, LEAST_RATIO),
        todo,
        rejection,
        half,
    )  # fmt: skip
    return Confirmed(rejection, half, bias, located)
