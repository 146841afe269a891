"""What strict measurements do without, and what a search finds hidden; against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import PLANE, Surface, choose, phase_map, small_rig, task_of, visible
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import Task, TwoViews
from fringe3d.correspond.choice import Choice
from fringe3d.correspond.strictness import doubtful
from fringe3d.correspond.surfaces import is_fragment
from fringe3d.model import Rejection, Rig

pytestmark = pytest.mark.usefixtures("one_thread")

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

BALL = Surface(center_mm=(2.0, -2.0, 2.0), radius_mm=6.0)
"""Before the plane: it hides a part of it from C2, and another from the light."""

INSIDE = np.s_[40:80, 50:100]
"""Pixels that have points; so those along its sides are at a border."""


def views_of(rig: Rig, surface: Surface) -> TwoViews:
    assert rig.projector is not None
    maps = [phase_map(c, rig.projector, surface, n_classes=1) for c in rig.cameras]
    return TwoViews(camera1=rig.cameras[0], camera2=rig.cameras[1], phases1=maps[0],
                    phases2=maps[1])  # fmt: skip


def plane_task() -> tuple[Rig, Task, Choice]:
    rig = small_rig()
    task = task_of(rig, views_of(rig, PLANE), (1, 1))
    none = task.frame.constant((0.0, 0.0), scatter_px=0.05)
    return rig, task, task.decide(none)


def refused(
    *,
    faint: Any = (),
    left: float = 1.0,
    misfit: float = 0.0,
    left2: float = 1.0,
    strict: bool = True,
) -> dict[Rejection, Mask]:
    """Return what is doubtful of a plane of which only INSIDE has points.

    The pixels `faint` have but a part of the modulation, in C1 (`left`) or where C2 sees their
    points (`left2`), and all residuals the same misfit.
    """
    rig, task, chosen = plane_task()
    phases1 = task.views.phases1
    modulation = phases1.modulation.copy()
    modulation[faint] *= left
    task.views = replace(task.views, phases1=replace(phases1, modulation=modulation))
    even = np.full(task.views.camera2.shape, 80.0)
    if left2 < 1:
        col, row = np.rint(place_in_c2(task, chosen, faint)).astype(int)
        even[row, col] *= left2
    task.views = replace(task.views, phases2=replace(task.views.phases2, modulation=even))
    chosen.__dict__["cost"] = np.full(len(chosen.place), misfit * task.limit)
    rejection = np.full(task.valid.shape, np.uint16(Rejection.OUTSIDE_VOLUME))
    rejection[INSIDE] = 0
    assert rig.projector is not None
    surface = np.ones(len(chosen.place), bool)
    found = doubtful(task, chosen, rejection, surface, rig.projector, strict=strict)
    return {reason: where for where, reason in found}


def place_in_c2(task: Task, chosen: Choice, pixel: Any) -> Floats:
    number = np.flatnonzero(mask(pixel)[task.valid])[0]
    origin, directions = cv_rays(task.views.camera1, np.array([[pixel[1], pixel[0]]], float))
    point = origin + chosen.depth_mm[number] * directions
    return np.asarray(cv_project(task.views.camera2, point)[0])


def mask(where: Any) -> Mask:
    full = np.zeros(task_shape(), bool)
    full[where] = True
    return full


def task_shape() -> tuple[int, int]:
    return small_rig().cameras[0].shape


def test_nothing_speaks_against_a_plane() -> None:
    assert not any(where.any() for where in refused().values())


@pytest.mark.parametrize(("left", "is_refused"), [(0.5, False), (0.1, True)])
def test_a_faint_pixel_at_a_border_is_refused(left: float, is_refused: bool) -> None:
    """It has three neighbours of nine without a point: 0.2 of 1; 0.8 of its light may be gone."""
    found = refused(faint=np.s_[40, 70], left=left)
    np.testing.assert_array_equal(found[Rejection.EDGE], mask(np.s_[40, 70]) & is_refused)


@pytest.mark.parametrize(("left", "is_refused"), [(0.8, False), (0.1, True)])
def test_so_is_one_whose_point_c2_sees_faintly(left: float, is_refused: bool) -> None:
    """0.2 for the neighbours, 0.4 for C1: what C2 lacks counts half, and 0.4 are left."""
    pixel = np.s_[40, 70]
    found = refused(faint=pixel, left=0.6, left2=left)[Rejection.EDGE]
    np.testing.assert_array_equal(found, mask(pixel) & is_refused)


def test_a_faint_pixel_in_the_middle_stays() -> None:
    assert not refused(faint=np.s_[60, 70], left=0.01)[Rejection.EDGE].any()


@pytest.mark.parametrize(("misfit", "is_refused"), [(0.5, False), (0.95, True)])
def test_signs_add_up(misfit: float, is_refused: bool) -> None:
    """0.2 for the neighbours, 0.4 for the modulation: 0.4 is left for the residual."""
    found = refused(faint=np.s_[40, 70], left=0.6, misfit=misfit)[Rejection.EDGE]
    assert found[40, 70] == is_refused
    assert not found[41:79, 51:99].any()


@pytest.mark.parametrize(("misfit", "is_refused"), [(0.5, False), (0.95, True)])
def test_half_as_much_again_must_speak_against_a_point_that_is_not_for_metrology(
    misfit: float, is_refused: bool
) -> None:
    """0.2 for the neighbours, 0.9 for the modulation: 0.4 is left for the residual."""
    found = refused(faint=np.s_[40, 70], left=0.1, misfit=misfit, strict=False)
    assert found[Rejection.EDGE][40, 70] == is_refused
    assert Rejection.HIDDEN not in found


@pytest.mark.parametrize(("part", "is_refused"), [(0.6, False), (0.9, True)])
def test_what_is_left_of_a_surface_that_is_mostly_refused(part: float, is_refused: bool) -> None:
    _, task, chosen = plane_task()
    rejection = np.full(task.valid.shape, np.uint16(Rejection.OUTSIDE_VOLUME))
    rejection[INSIDE] = 0  # what lies outside the volume is decided as well
    assert not is_fragment(task, chosen, rejection).any()
    rejection[: int(part * task.valid.shape[0])] = np.uint16(Rejection.NO_MATCH)
    np.testing.assert_array_equal(is_fragment(task, chosen, rejection), task.valid & is_refused)


@pytest.mark.parametrize("strict", [False, True])
def test_a_search_finds_what_is_hidden(strict: bool) -> None:
    """Without it, some such points are measured: C2 sees there by chance what fits."""
    rig = small_rig()
    views = views_of(rig, BALL)
    none = task_of(rig, views).frame.constant((0.0, 0.0), scatter_px=0.05)
    with_search, without = (
        choose(rig, views, bias=none, search=search, strict=strict).phases.rejection
        for search in (True, False)
    )
    hidden = (with_search & np.uint16(Rejection.HIDDEN)) != 0
    assert hidden.sum() >= 5
    assert not hidden[visible(rig, BALL, margin_px=1.0)].any()
    assert (without[hidden] == 0).all()
    assert (with_search[visible(rig, BALL)] == 0).mean() > 0.999
