"""The passes of M1 beside what does the same step by step, and beside the closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import Surface, grid_of, phase_map, seen_points, small_rig, visible
from cv_lens import cv_project
from fringe3d.correspond import TwoViews, choose_orders, confirm_orders, match_near_sheets
from fringe3d.model import Correspondences, Rejection, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

SURFACE = Surface()
STD_RAD = 0.01


def views_of(rig: Rig) -> TwoViews:
    """Return noisy phases with a full code."""
    assert rig.projector is not None
    rng = np.random.default_rng(5)
    one, two = (phase_map(c, rig.projector, SURFACE, std=STD_RAD, rng=rng) for c in rig.cameras)
    return TwoViews(camera1=rig.cameras[0], camera2=rig.cameras[1], phases1=one, phases2=two)


def test_a_confirmed_order_is_the_one_that_would_be_chosen() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    views = views_of(rig)
    assert views.phases1.is_absolute
    assert rig.projector is not None
    assert rig.volume is not None
    chosen = choose_orders(views, rig.projector, rig.volume)
    found = confirm_orders(views, rig.projector, rig.volume, bias=chosen.bias)
    same = found.rejection == chosen.phases.rejection
    assert same.mean() > 0.999
    both = (found.rejection == 0) & (chosen.phases.rejection == 0)
    assert both.mean() > 0.3
    np.testing.assert_allclose(found.half_px[both], chosen.half_px[both], rtol=1e-5)
    assert np.isnan(found.half_px[found.rejection != 0]).all()


def test_an_order_off_by_one_is_not_confirmed() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    views = views_of(rig)
    assert rig.projector is not None
    assert rig.volume is not None
    good = confirm_orders(views, rig.projector, rig.volume)
    wrong = replace(views.phases1, order_class=views.phases1.order_class + 1)
    found = confirm_orders(replace(views, phases1=wrong), rig.projector, rig.volume, bias=good.bias)
    assert (good.rejection == 0).sum() > 5000
    assert (found.rejection == 0).sum() < 0.01 * (good.rejection == 0).sum()


def searched(rig: Rig, half: float, holes: NDArray[np.bool_] | None = None) -> Correspondences:
    views = views_of(rig)
    assert rig.projector is not None
    assert rig.volume is not None
    two = views.phases2
    if holes is not None:
        two = two.rejecting(holes.astype(np.uint16) * np.uint16(Rejection.LOW_MODULATION))
    shape = views.phases1.phase.shape
    return match_near_sheets(
        views.phases1, two, rig.cameras[0], rig.cameras[1], rig.projector, rig.volume,
        np.full(shape, half, np.float32),
    )  # fmt: skip


def test_points_lie_where_c2_sees_the_surface() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    found = searched(rig, 2.0)
    seen = visible(rig, SURFACE)
    truth = cv_project(rig.cameras[1], seen_points(rig.cameras[0], grid_of(rig.cameras[0]),
                                                   SURFACE)[0])  # fmt: skip
    good = seen & (found.rejection == 0)
    assert good.sum() > 0.98 * seen.sum()
    error = (found.pixels - truth)[good]
    pull = np.linalg.norm(error, axis=1) / found.sigma_px[good]
    assert np.sqrt((np.minimum(pull, 5) ** 2).mean()) == pytest.approx(1.0, abs=0.1)


def test_a_hole_in_c2_is_no_match_and_a_wide_window_may_hold_several() -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    everywhere = searched(rig, 2.0)
    n_rows, n_cols = rig.cameras[1].shape
    hole = np.zeros((n_rows, n_cols), bool)
    hole[40:80, 60:100] = True
    found = searched(rig, 2.0, hole)
    x, y = np.moveaxis(np.nan_to_num(everywhere.pixels), -1, 0)
    inside = (everywhere.rejection == 0) & (np.abs(x - 79.5) < 17) & (np.abs(y - 59.5) < 17)
    assert inside.sum() > 500
    assert (found.rejection[inside] == Rejection.NO_MATCH).all()
    outside = (everywhere.rejection == 0) & ((np.abs(x - 79.5) > 26) | (np.abs(y - 59.5) > 23))
    np.testing.assert_array_equal(found.pixels[outside], everywhere.pixels[outside])
    twice = searched(rig, 8.0)
    lit = everywhere.rejection == 0
    assert (twice.rejection[lit] == Rejection.AMBIGUOUS).mean() > 0.5
