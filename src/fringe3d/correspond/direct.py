"""The points of most pixels, whose fringe order is known, in one pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _direct
from fringe3d.correspond.curves import ray_curves
from fringe3d.correspond.limits import MOST_SIGMA
from fringe3d.correspond.projector import GUARD_PX, GUARD_SIGMA
from fringe3d.correspond.weighing import TwoViews
from fringe3d.geometry import grid_rays
from fringe3d.geometry.meeting import Met
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import over_rows
from fringe3d.model import CalibrationBias, Device, MeasuringVolume

f4 = np.float32

TWO_PI = 2 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Points that are known, and the pixels that are left.

    Parameters
    ----------
    pixels : (row, col, 2) float64, px; in C2; NaN where not known
    sigma_px : (row, col) float32, px; along the epipolar curve
    met : Met; the points
    todo : (row, col) bool; pixels that have neither a point nor a reason yet
    """

    pixels: NDArray[np.float64]
    sigma_px: NDArray[np.float32]
    met: Met
    todo: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Judging:
    """How C2 confirms an order: see `fringe3d.correspond.candidates.choose_orders`."""

    bias: CalibrationBias
    most_cost: float
    search_turns: tuple[float, float]
    least_ratio: float


def locate(
    views: TwoViews,
    projector: Device,
    volume: MeasuringVolume,
    /,
    *,
    half_px: NDArray[np.float32] | None = None,
    judging: Judging | None = None,
) -> Located:
    """Find the points of the pixels whose way to them is an easy one.

    From where the light sheet of the order demands the point in C2, a few steps lead to where the
    phase is that of C1. Easy is what has all neighbours, no jump among them, and no other crossing
    within the window.

    Parameters
    ----------
    views : TwoViews; the phases of C1 absolute
    projector : Device
    volume : MeasuringVolume
    half_px : (row, col) float32 or None, projector px; how far around its phase C2 sees the point
    judging : Judging or None; one of both is given: whether C2 sees the point there is judged, and
        pixels are rejected

    Notes
    -----
    The curves of `ray_curves` are exact to a thousandth of a pixel; the last step is one on the
    exact curve. ``sigma = sqrt(sigma_1**2 + 4/9 sigma_2**2) / |d phi_2 / d t|``.
    """
    phases1, phases2 = views.phases1, views.phases2
    tables = ray_curves(views.camera1, views.camera2, projector, volume, phases1.angle)
    origin, rays = grid_rays(views.camera1)
    to_2 = views.camera2.device_from_world
    shape = phases1.rejection.shape
    pixels, sigma_px, todo = np.empty((*shape, 2)), np.empty(shape, f4), np.empty(shape, np.bool_)
    met = Met(
        points_mm=np.empty((*shape, 3)),
        sigma_mm=np.empty(shape, f4),
        skew_mm=np.empty(shape, f4),
        rejection=phases1.rejection.copy(),
    )
    over_rows(
        _direct.locate,
        shape[0],
        (phases1.phase, phases1.order_class, phases1.phase_std, f4(phases1.period_px)),
        np.empty((0, 0), f4) if half_px is None else half_px,
        (tables.ends, tables.curves, tables.wide, tables.inner, rays),
        tuple(origin),
        (*to_2.apply(origin), *to_2.rotation.ravel(), *lens_of(views.camera2)),
        (phases2.phase, phases2.phase_std, phases2.order_class),
        (f4(GUARD_SIGMA * phases1.period_px / TWO_PI), f4(GUARD_PX)),
        *numbers_of_judging(judging),
        (pixels, sigma_px, *met, todo),
    )
    return Located(pixels, sigma_px, met, todo)


def numbers_of_judging(judging: Judging | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return bias and limits as the pass takes them, in single precision."""
    if judging is None:
        return np.zeros(24, f4), np.zeros(6, f4)
    bias = judging.bias
    limits = (bias.scatter_px, judging.most_cost, MOST_SIGMA**2, *judging.search_turns,
              judging.least_ratio)  # fmt: skip
    return (
        np.concatenate([bias.middle, 1 / bias.scale, bias.coefficients_px.ravel()]).astype(f4),
        np.array(limits, f4),
    )
