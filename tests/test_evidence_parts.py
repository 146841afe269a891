"""Each part of the evidence on its own scene: without that part the answer is another one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from changed_rigs import turned, with_wide_c2
from closed_form import SphereScene, record_scene
from closed_phases import (
    PLANE,
    Surface,
    choose,
    grid_of,
    moved,
    phase_map,
    seen_points,
    small_rig,
    task_of,
    true_turns,
    turns_off,
    visible,
)
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import Rivals, Task, TwoViews, rivals
from fringe3d.correspond.visibility import takes_foreign_light
from fringe3d.decode import decode
from fringe3d.io.rigfile import read_rig, rig_text
from fringe3d.matching import match
from fringe3d.model import NO_ORDER, CalibrationBias, Device, MeasuringVolume, Rejection, Rig, Scan
from fringe3d.pipeline import MeasureOptions, measure

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEED = 4
PERIOD_PX = 16.0
SCENE = Surface()
MIDDLE = Surface(plane_z_mm=0.0, radius_mm=0.0)
"""A plane in the middle of the volume: one period up or down is inside, too."""


@cache
def wide_rig(azimuth_deg: float) -> Rig:
    return with_wide_c2(small_rig(projector_azimuth_deg=azimuth_deg))


@cache
def views_of(rig: Rig, surface: Surface, axis: str = "y", deg: float = 0.0, std: float = 0.01
             ) -> TwoViews:  # fmt: skip
    """Return noisy phases without code, and C2 turned against its calibration."""
    assert rig.projector is not None
    rng = np.random.default_rng(SEED)
    c1, c2 = rig.cameras
    maps = [phase_map(c, rig.projector, surface, n_classes=1, std=std, rng=rng) for c in (c1, c2)]
    return TwoViews(camera1=c1, camera2=turned(c2, axis, deg), phases1=maps[0], phases2=maps[1])


def is_right(rig: Rig, views: TwoViews, surface: Surface, order: NDArray[np.int32]) -> Mask:
    return np.asarray(turns_off(rig, views, surface, order) == 0)


def known_bias(rig: Rig, turned_c2: Device, *, times: float = 1.0) -> CalibrationBias:
    """Return where the calibration expects points in C2, less where they are."""
    c1, c2 = rig.cameras
    pixels = np.tile(grid_of(c1)[::8, ::8].reshape(-1, 2), (2, 1))
    depths = np.repeat([325.0, 350.0], len(pixels) // 2)
    origin, directions = cv_rays(c1, pixels)
    points = origin + depths[:, None] * directions
    missed = cv_project(turned_c2, points) - cv_project(c2, points)
    middle = np.array([c1.n_cols / 2, c1.n_rows / 2, 337.5])
    scale = np.array([c1.n_cols / 2, c1.n_rows / 2, 20.0])
    x, y, t = ((np.column_stack([pixels, depths]) - middle) / scale).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, t, t * x, t * y], axis=1)
    coefficients = np.linalg.lstsq(terms, missed)[0].T
    assert np.abs(terms @ coefficients.T - missed).max() < 0.01
    return CalibrationBias(coefficients_px=times * coefficients, middle=middle, scale=scale,
                           scatter_px=0.05)  # fmt: skip


def right_part(found: Rivals, rig: Rig, views: TwoViews, surface: Surface, number: int = 0
               ) -> float:  # fmt: skip
    """Return of the visible pixels those to which a solution gives their order."""
    (task,) = found.tasks
    grid = np.full(task.valid.shape, NO_ORDER, np.int32)
    grid[task.valid] = found.solutions[number].orders[0]
    full = np.full(rig.cameras[0].shape, NO_ORDER, np.int32)
    full[task.grid] = grid
    seen = visible(rig, surface) & (full != NO_ORDER)
    assert seen.sum() > 500
    return float(is_right(rig, views, surface, full)[seen].mean())


# --- a bias that is known --------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "deg"), [("y", 0.01), ("y", -0.01), ("x", 0.06), ("x", -0.06)])
@pytest.mark.parametrize("surface", [SCENE, MIDDLE])
def test_c2_is_asked_with_the_bias_as_it_sees_it(surface: Surface, axis: str, deg: float) -> None:
    """Strictly, C2 must be certain of the same order: with any other bias it finds others.

    The cameras see fringes tilted to opposite sides: so does C1 what C2 sees displaced along them.
    """
    rig = wide_rig(-1.0)
    views, seen = views_of(rig, surface, axis, deg), visible(rig, surface)
    result = choose(rig, views, bias=known_bias(rig, views.camera2), strict=True)
    good = result.phases.rejection == 0
    assert good[seen].mean() > 0.98
    assert is_right(rig, views, surface, result.phases.order_class)[good & seen].all()


@pytest.mark.parametrize("times", [-1.0, 0.0])
def test_another_bias_gives_other_orders(times: float) -> None:
    rig = wide_rig(-1.0)
    views, seen = views_of(rig, MIDDLE, "y", 0.01), visible(rig, MIDDLE)
    result = choose(rig, views, bias=known_bias(rig, views.camera2, times=times))
    right = is_right(rig, views, MIDDLE, result.phases.order_class)
    assert (right & (result.phases.rejection == 0))[seen].mean() < 0.02


@pytest.mark.parametrize("together", [True, False])
def test_a_volume_tells_orders_that_nothing_else_tells(together: bool) -> None:
    """Symmetrically seen all orders fit a plane; of three one lies inside."""
    rig = wide_rig(0.0)
    views, seen = views_of(rig, MIDDLE), visible(rig, MIDDLE)
    few = np.full(views.phases1.rejection.shape, np.uint16(Rejection.LOW_MODULATION))
    few[60:64, 60:100] = 0  # a whole surface may outweigh any volume
    part = replace(views, phases1=views.phases1.rejecting(few))
    bias = known_bias(rig, views.camera2)
    thin = MeasuringVolume.box([-40, -40, -3], [40, 40, 3])
    for volume, is_open in ((thin, False), (None, True)):
        result = choose(rig, part, volume, bias=bias, together=together)
        good = result.phases.rejection == 0
        at = seen & (few == 0)
        assert at.sum() > 100
        assert good[at].mean() < 0.05 if is_open else good[at].mean() > 0.95
        assert is_right(rig, views, MIDDLE, result.phases.order_class)[good].all()


# --- a bias that is looked for ---------------------------------------------------------------

BALL = Surface(plane_z_mm=-10.0, center_mm=(0, 0, -4), radius_mm=5.0)
CAP = Surface(plane_z_mm=-6.0, center_mm=(6, -2, -46), radius_mm=43.0)


@cache
def searched(azimuth_deg: float, surface: Surface, axis: str, deg: float, stride: tuple[int, int]
             ) -> tuple[Rivals, TwoViews]:  # fmt: skip
    rig = wide_rig(azimuth_deg)
    views = views_of(rig, surface, axis, deg)
    found = rivals([task_of(rig, views, stride)])
    assert found is not None
    return found, views


MIXED = (0.0, CAP, "y", 0.01, (4, 1))
"""Solutions of which a part is a period off fit nearly as well, but for the edge in its middle. The
best one is that to which a single surface leads."""

NEARLY_ALIKE = (0.5, BALL, "y", -0.01, (8, 1))

TURNED_ROUND = (-0.5, BALL, "z", -0.3, (4, 2))
"""C2 errs to one side above and to the other below: no start is right for all of the plane."""


@pytest.mark.parametrize("case", [MIXED, NEARLY_ALIKE, TURNED_ROUND])
def test_what_is_found_is_right_for_all_surfaces(case: tuple[Any, ...]) -> None:
    found, views = searched(*case)
    assert right_part(found, wide_rig(case[0]), views, case[1]) > 0.99
    assert found.weights[0] > 0.9  # and so it is accepted


def test_rivals_are_kept_down_to_one_in_ten_thousand() -> None:
    for case in (MIXED, NEARLY_ALIKE):
        found = searched(*case)[0]
        energies = np.array([solution.energy for solution in found.solutions])
        odds = np.exp((energies[0] - energies) / 4)
        assert odds.min() > 1e-4
        np.testing.assert_allclose(found.weights, odds / odds.sum())


# --- what a measurement makes of it ----------------------------------------------------------


@cache
def flat_rig() -> Rig:
    """Return a rig whose C1 has 64 rows."""
    rig = wide_rig(-1.0)
    c1 = moved(rig.cameras[0], n_rows=64, center_px=rig.cameras[0].center_px - [0, 32])
    return replace(rig, cameras=(c1, rig.cameras[1]))


@cache
def recorded(deg: float) -> Scan:
    """Return four images of a plane, and a rig whose C2 is turned against its calibration."""
    rig = flat_rig()
    buried = SphereScene(plane_z_mm=0.0, center_mm=(0, 0, -50), radius_mm=1.0)
    scan, _ = record_scene(rig, buried, seed=SEED, gray="none")
    c1, c2 = rig.cameras
    return replace(scan, rig=replace(rig, cameras=(c1, turned(c2, "y", deg))))


def test_method_m6_looks_for_rivals_and_leaves_a_plane_open() -> None:
    scan = recorded(0.01)
    assert scan.rig is not None
    (c1, c2), projector, volume = scan.rig.cameras, scan.rig.projector, scan.rig.volume
    phases = [decode(stack) for stack in scan.stacks]
    found = match(phases, c1, c2, projector, volume, method="m6", options=MeasureOptions())
    seen = visible(flat_rig(), MIDDLE)
    assert found.rival_shift == 1
    assert ((found.matches.rejection & Rejection.AMBIGUOUS) > 0)[seen].mean() > 0.95


@pytest.mark.parametrize(("deg", "times"), [(0.01, 1.0), (-0.01, 1.0), (0.01, -1.0)])
def test_a_measurement_takes_the_bias_of_the_file(deg: float, times: float, tmp_path: Path) -> None:
    """Written, read and applied; the opposite one would give other orders, or none."""
    scan, rig = recorded(deg), flat_rig()
    assert scan.rig is not None
    bias = known_bias(rig, scan.rig.cameras[1], times=times)
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(replace(scan.rig, bias=bias)), encoding="utf-8")
    result = measure(replace(scan, rig=read_rig(path)), MeasureOptions(method="m6"))
    assert result.points is not None
    seen, good = visible(rig, MIDDLE), result.points.is_valid
    height = result.points.points_mm[..., 2]
    right = good & (np.abs(height) < 0.5)  # mm; a period is 7
    if times > 0:
        assert right[seen].mean() > 0.97
        assert right[good].all()
    else:
        assert right[seen].mean() < 0.02


# --- one ray of light meets one surface ------------------------------------------------------


def depth_on_sheet(rig: Rig, turns: Floats) -> Floats:
    """Return where rays of C1 meet light sheets (row, col), mm, by bisection."""
    c1, projector = rig.cameras[0], rig.projector
    assert projector is not None
    origin, directions = cv_rays(c1, grid_of(c1))

    def ahead(depth: Floats) -> Floats:
        place = cv_project(projector, origin + depth[..., None] * directions)
        return np.asarray((place[..., 0] + 0.5) / PERIOD_PX - turns, np.float64)

    low, high = np.full(turns.shape, 230.0), np.full(turns.shape, 450.0)
    rising = ahead(high) > ahead(low)
    assert (rising == (ahead(low) < 0)).all()
    for _ in range(40):
        middle = (low + high) / 2
        is_low = (ahead(middle) < 0) == rising
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return np.asarray((low + high) / 2)


@cache
def flat_task() -> tuple[Rig, Task, Floats, Floats]:
    """Return a rig, exact phases of a plane that all pixels see, the absolute ones, and depths."""
    rig = small_rig()
    assert rig.projector is not None
    c1, c2 = rig.cameras
    maps = [phase_map(c, rig.projector, PLANE, n_classes=1) for c in (c1, c2)]
    views = TwoViews(camera1=c1, camera2=c2, phases1=maps[0], phases2=maps[1])
    turns = true_turns(c1, rig.projector, PLANE, grid_of(c1))
    assert (views.phases1.rejection == 0).all()
    return rig, task_of(rig, views, (1, 1)), turns, seen_points(c1, grid_of(c1), PLANE)[1]


def foreign(by: NDArray[np.int64], depth: Floats, claims: Mask) -> Mask:
    """Ask for orders that are wrong by (row, col), at depths that need not go with them."""
    rig, task, turns, _ = flat_task()
    order = np.floor(turns).astype(np.int32) + by.astype(np.int32)
    chosen: Any = SimpleNamespace(order=order.ravel(), depth_mm=depth.ravel())
    assert rig.projector is not None
    return takes_foreign_light(task, chosen, claims.ravel(), rig.projector).reshape(claims.shape)


def light_of(depth: Floats) -> Floats:
    """Return the projector column that lights points at depths along the rays of C1."""
    rig = flat_task()[0]
    assert rig.projector is not None
    origin, directions = cv_rays(rig.cameras[0], grid_of(rig.cameras[0]))
    return np.asarray(cv_project(rig.projector, origin + depth[..., None] * directions)[..., 0])


@pytest.mark.parametrize(("part", "is_wrong"), [(0.4, False), (0.6, True), (0.9, True)])
def test_a_surface_is_wrong_whose_light_is_mostly_that_of_a_larger_one(
    part: float, is_wrong: bool
) -> None:
    """A patch nine periods off; of the plane all is there whose light is right of a line."""
    rig, _, turns, true_depth = flat_task()
    patch = np.zeros(turns.shape, bool)
    patch[45:80, 105:150] = True
    away = -9 if turns[0, -1] > turns[0, 0] else 9
    depth = np.where(patch, depth_on_sheet(rig, turns + away), true_depth)
    light = light_of(depth)
    line = np.quantile(light[patch] * -away, 1 - part) / -away
    claims = patch | ((light - line) * -away > 0)
    wrong = foreign(np.where(patch, away, 0), depth, claims)
    assert (claims & ~patch).sum() > 3 * patch.sum()
    assert not wrong[~patch].any()
    assert (wrong[patch] == is_wrong).all()


@pytest.mark.parametrize(("periods", "is_wrong"), [(0.4, False), (0.65, True), (-0.4, False),
                                                   (-0.65, True)])  # fmt: skip
def test_what_lies_within_half_a_period_is_the_same_surface(periods: float, is_wrong: bool) -> None:
    """A line of pixels, cut off by its order, whose points are moved along their rays."""
    rig, _, turns, true_depth = flat_task()
    line = np.zeros(turns.shape, bool)
    line[30:100, 80] = True
    moved_depth = depth_on_sheet(rig, turns + periods)
    depth = np.where(line, moved_depth, true_depth)
    wrong = foreign(line.astype(np.int64), depth, np.ones(line.shape, bool))
    assert not wrong[~line].any()
    assert (wrong[line] == is_wrong).all()


def test_what_is_not_trusted_claims_no_light() -> None:
    rig, _, turns, true_depth = flat_task()
    line = np.zeros(turns.shape, bool)
    line[30:100, 80] = True
    depth = np.where(line, depth_on_sheet(rig, turns + 1.0), true_depth)
    for claims in (line, ~line):
        assert not foreign(line.astype(np.int64), depth, claims).any()
    assert foreign(line.astype(np.int64), depth, np.ones(line.shape, bool)).sum() == 70
