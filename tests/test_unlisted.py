"""Candidates that are looked up when asked for are those that are listed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closed_phases import Surface, phase_map, small_rig
from fringe3d.correspond import TwoViews
from fringe3d.correspond.solving import nothing_known
from fringe3d.correspond.weighing import Task
from fringe3d.model import NO_ORDER, Rejection

pytestmark = pytest.mark.usefixtures("one_thread")

RIG = small_rig(projector_azimuth_deg=-18.0)


def tasks(n_classes: int, holes: float, *, mirrored: bool = False) -> tuple[Task, Task]:
    """Return a task whose candidates are listed, and the same whose are not."""
    assert RIG.projector is not None
    assert RIG.volume is not None
    rng = np.random.default_rng(5)
    one, two = (
        phase_map(c, RIG.projector, Surface(), n_classes=n_classes, std=0.01, rng=rng)
        for c in RIG.cameras
    )
    lost = rng.random(two.phase.shape) < holes
    two = two.rejecting(lost.astype(np.uint16) * np.uint16(Rejection.LOW_MODULATION))
    if mirrored:  # the orders of a class do not follow each other at one distance
        number = np.arange(len(one.class_of_order), dtype=np.int32) % 4
        names = np.minimum(number, 3 - number)
        one, two = (replace(m, class_of_order=names) for m in (one, two))
    views = TwoViews(camera1=RIG.cameras[0], camera2=RIG.cameras[1], phases1=one, phases2=two)
    listed, unlisted = (
        Task(views, RIG.projector, RIG.volume, 36.0, together=True, keeps=keeps)
        for keeps in (True, False)
    )
    return listed, unlisted


@pytest.mark.parametrize("n_classes", [1, 2, 4])
@pytest.mark.parametrize("holes", [0.0, 0.1])
def test_looked_up_candidates_are_those_that_are_listed(n_classes: int, holes: float) -> None:
    listed, unlisted = tasks(n_classes, holes)
    assert listed.keeps
    assert not unlisted.keeps
    np.testing.assert_array_equal(listed.n_labels(), unlisted.n_labels())
    np.testing.assert_array_equal(listed.n_inside(), unlisted.n_inside())
    square = np.eye(18) * 0.01
    square[0, 3] = square[3, 0] = square[2, 7] = square[7, 2] = 0.004
    bias = replace(
        nothing_known(listed), coefficients_px=np.linspace(-0.2, 0.3, 18).reshape(2, 9),
        covariance_px2=square,
    )  # fmt: skip
    one, other = listed.decide(bias), unlisted.decide(bias)
    assert (one.order != NO_ORDER).sum() > 5000
    assert (one.order == other.order).mean() > 0.9995
    same = one.order == other.order
    np.testing.assert_array_equal(one.is_inside[same], other.is_inside[same])
    np.testing.assert_allclose(other.probability[same], one.probability[same], atol=0.02)
    # A place on the border of two pixels of C2 may fall to the other one.
    np.testing.assert_allclose(
        np.nanpercentile(np.abs(other.shown - one.shown)[same], 99.9, axis=0), 0, atol=2e-3
    )
    assert (np.isnan(other.shown) == np.isnan(one.shown))[same].mean() > 0.999
    far = np.abs(other.cost - one.cost)[same] > 1e-2 + 1e-2 * one.cost[same]
    assert far.mean() < 1e-3
    some = np.arange(0, len(one.place), 7)
    place, found = one.table.place_of(one.order[some] + 1, some)
    other_place, other_found = other.table.place_of(one.order[some] + 1, some)
    known = one.order[some] != NO_ORDER
    np.testing.assert_array_equal(found[known], other_found[known])
    np.testing.assert_array_equal(place[known & found], other_place[known & found])


def test_settled_pixels_have_no_other_order() -> None:
    _, task = tasks(1, 0.0)
    free = task.decide(nothing_known(task))
    wanted = np.where(np.arange(len(free.order)) % 2 == 0, free.order, NO_ORDER).astype(np.int32)
    settled = wanted != NO_ORDER
    assert settled.sum() > 5000
    for other in tasks(1, 0.0):
        other.settle(wanted)
        chosen = other.decide(nothing_known(other))
        np.testing.assert_array_equal(chosen.order[settled], wanted[settled])
        assert (chosen.probability[settled] == 1).all()


def test_candidates_of_a_code_without_a_distance_are_listed() -> None:
    """Where orders between those of a class are another's, columns hold those of several."""
    _, task = tasks(1, 0.0, mirrored=True)
    assert task.keeps
