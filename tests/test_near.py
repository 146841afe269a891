"""The passes of M1 beside what does the same step by step, and beside the closed form."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import Surface, grid_of, phase_map, seen_points, small_rig, visible
from cv_lens import cv_project
from fringe3d.correspond import TwoViews, choose_orders, confirm_orders, match_near_sheets
from fringe3d.model import Correspondences, PointMap, Rejection, Rig
from fringe3d.triangulate import triangulate

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
    found = confirm_orders(views, rig.projector, rig.volume, bias=chosen.bias, plain=True)
    same = found.rejection == chosen.phases.rejection
    assert same.mean() > 0.999
    both = (found.rejection == 0) & (chosen.phases.rejection == 0)
    assert both.mean() > 0.3
    # One looks C2 up in single precision: the place may fall into the pixel next to it.
    apart = np.abs(found.half_px[both] / chosen.half_px[both] - 1)
    assert (apart < 1e-5).mean() > 0.999
    assert apart.max() < 0.05
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


def located(views: TwoViews, rig: Rig, *, plain: bool) -> tuple[Correspondences, PointMap]:
    """Return matches and points of a full code, by the one pass or one pixel at a time."""
    assert rig.projector is not None
    assert rig.volume is not None
    c1, c2 = rig.cameras
    confirmed = confirm_orders(views, rig.projector, rig.volume, plain=plain)
    matches = match_near_sheets(
        views.phases1, views.phases2, c1, c2, rig.projector, rig.volume, confirmed.half_px,
        rejection=confirmed.rejection, located=confirmed.located,
    )  # fmt: skip
    at_once = confirmed.located
    known = None if at_once is None else (at_once.met, at_once.todo)
    if at_once is not None:
        assert at_once.todo.sum() < 0.4 * (matches.rejection == 0).sum()
    before = matches.rejection.copy()
    points = triangulate(matches, c1, c2, volume=rig.volume, known=known)
    np.testing.assert_array_equal(matches.rejection, before)
    return matches, points


@pytest.mark.parametrize("holes", [False, True])
def test_one_pass_finds_what_is_found_one_pixel_at_a_time(holes: bool) -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    views = views_of(rig)
    if holes:  # single pixels and the border of a hole need the long way
        lost = np.random.default_rng(2).random(rig.cameras[1].shape) < 0.02
        lost[40:80, 60:100] = True
        bits = lost.astype(np.uint16) * np.uint16(Rejection.LOW_MODULATION)
        views = replace(views, phases2=views.phases2.rejecting(bits))
    plain, points = located(views, rig, plain=True)
    found, at_once = located(views, rig, plain=False)
    np.testing.assert_array_equal(found.rejection, plain.rejection)
    np.testing.assert_array_equal(at_once.rejection, points.rejection)
    good = points.is_valid
    assert good.mean() > 0.3
    # The last step is linear: it errs by far less than the noise, 0.03 px.
    np.testing.assert_allclose(found.pixels[good], plain.pixels[good], atol=1e-3)
    np.testing.assert_allclose(found.sigma_px[good], plain.sigma_px[good], rtol=0.02)
    apart = np.linalg.norm(at_once.points_mm - points.points_mm, axis=-1)[good]
    assert (apart < 0.02 * points.sigma_mm[good]).all()
    np.testing.assert_allclose(at_once.sigma_mm[good], points.sigma_mm[good], rtol=0.02)


def test_two_threads_find_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = small_rig(projector_azimuth_deg=-18.0)
    views = views_of(rig)
    alone = located(views, rig, plain=False)[1]
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)
    together = located(views, rig, plain=False)[1]
    np.testing.assert_array_equal(together.points_mm, alone.points_mm)
    np.testing.assert_array_equal(together.sigma_mm, alone.sigma_mm)
