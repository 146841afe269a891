"""Pixels that decide alone, beside the choice among all pixels, and beside the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closed_phases import Surface, phase_map, small_rig, turns_off, visible
from fringe3d.correspond import TwoViews, choose_orders
from fringe3d.correspond.clear import is_regular
from fringe3d.model import NO_ORDER, Rejection, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

SURFACE = Surface()
STD_RAD = 0.01


@pytest.fixture(scope="module")
def rig() -> Rig:
    return small_rig(projector_azimuth_deg=-18.0)


def views_of(rig: Rig, n_classes: int) -> TwoViews:
    assert rig.projector is not None
    rng = np.random.default_rng(5)
    one, two = (
        phase_map(c, rig.projector, SURFACE, n_classes=n_classes, std=STD_RAD, rng=rng)
        for c in rig.cameras
    )
    return TwoViews(camera1=rig.cameras[0], camera2=rig.cameras[1], phases1=one, phases2=two)


@pytest.mark.parametrize("n_classes", [2, 4])
@pytest.mark.parametrize("holes", [False, True])
def test_orders_are_those_of_the_choice_among_all_pixels(
    rig: Rig, n_classes: int, holes: bool
) -> None:
    views = views_of(rig, n_classes)
    assert is_regular(views.phases1)
    if holes:
        lost = np.random.default_rng(2).random(rig.cameras[1].shape) < 0.02
        lost[40:80, 60:100] = True
        bits = lost.astype(np.uint16) * np.uint16(Rejection.LOW_MODULATION)
        views = replace(views, phases2=views.phases2.rejecting(bits))
    assert rig.projector is not None
    assert rig.volume is not None
    plain = choose_orders(views, rig.projector, rig.volume, plain=True)
    found = choose_orders(views, rig.projector, rig.volume, bias=plain.bias)
    same = found.phases.rejection == plain.phases.rejection
    assert same.mean() > 0.998  # borders of holes
    both = (found.phases.rejection == 0) & (plain.phases.rejection == 0)
    assert both.sum() > 0.99 * (plain.phases.rejection == 0).sum() > 3000
    np.testing.assert_array_equal(found.phases.order_class[both], plain.phases.order_class[both])
    # In single precision a place on the border of two pixels of C2 may fall to the other one.
    np.testing.assert_allclose(found.half_px[both], plain.half_px[both], rtol=0.02)
    np.testing.assert_allclose(found.place_px[both], plain.place_px[both], atol=5e-3)
    np.testing.assert_allclose(found.place_sigma_px[both], plain.place_sigma_px[both], rtol=0.02)
    assert (found.probability[both] >= 0.9).all()
    assert np.isnan(found.probability[found.phases.rejection != 0]).all()


def test_orders_are_right(rig: Rig) -> None:
    views = views_of(rig, 4)
    assert rig.projector is not None
    assert rig.volume is not None
    found = choose_orders(views, rig.projector, rig.volume)
    order = np.where(found.phases.rejection == 0, found.phases.order_class, NO_ORDER)
    seen = visible(rig, SURFACE)
    good = seen & (order != NO_ORDER)
    assert good.sum() > 0.99 * seen.sum()
    assert (np.abs(turns_off(rig, views, SURFACE, order)[good]) < 0.5).all()


def test_a_code_cut_short_is_not_regular(rig: Rig) -> None:
    phases = views_of(rig, 4).phases1
    mirrored = np.array([0, 1, 1, 0] * (len(phases.class_of_order) // 4), np.int32)
    classes = np.zeros_like(phases.class_of_order)
    classes[: len(mirrored)] = mirrored
    assert not is_regular(replace(phases, class_of_order=classes))
    assert not is_regular(phases.without_orders())
