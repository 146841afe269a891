"""Parts of one surface get one fringe order; parts that a true edge divides do not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from closed_form import sphere_distance
from closed_phases import Surface, grid_of, phase_map, seen_points, small_rig, true_turns
from closed_phases import task_of as solid_task
from fringe3d.correspond import TwoViews, _orders, whole
from fringe3d.correspond.choice import Candidates, Choice, Weighed
from fringe3d.correspond.grid import index_of, rises_of
from fringe3d.correspond.pieces import cut_apart
from fringe3d.correspond.surfaces import no_surer_than_most
from fringe3d.correspond.whole import made_whole
from fringe3d.model import NO_ORDER

Floats = NDArray[np.float64]

SHAPE = (60, 80)
LABELS = np.arange(-4, 5)
"""Orders of the candidates, against the true one."""

ROWS, COLS = np.mgrid[: SHAPE[0], : SHAPE[1]]
FLAT = 0.037 * COLS + 0.021 * ROWS + 20.0
"""Turns: three periods over the image, wraps at a slant."""

PATCH = (ROWS > 20) & (ROWS < 40) & (COLS > 50)
RAGGED = PATCH & ~((ROWS + COLS) % 3 == 0) | (PATCH & (COLS > 54))


def task_of(turns: Floats, *, std: float = 0.01, valid: Any = None) -> Any:
    phase: Any = 2 * np.pi * (turns - np.floor(turns))
    phase = np.where(phase > np.pi, phase - 2 * np.pi, phase).astype(np.float32)
    valid = np.ones(turns.shape, bool) if valid is None else valid
    phase = np.where(valid, phase, np.nan).astype(np.float32)
    sigma = np.full(valid.sum(), std, np.float32)
    return SimpleNamespace(
        phase=phase,
        valid=valid,
        first=(phase[valid], sigma),
        index=index_of(valid),
        rises=rises_of(phase, valid, sigma),
        stride=(2, 2),
    )


def choice_of(task: Any, turns: Floats, off: Any, cost: Any = 0.0) -> Choice:
    """Return a choice that is wrong by `off` orders; costs (n, label) or one for all."""
    valid = task.valid
    true = np.rint(turns - task.phase.astype(np.float64) / (2 * np.pi))[valid].astype(np.int32)
    n = len(true)
    orders = true[:, None] + LABELS.astype(np.int32)
    shown = np.zeros((n, len(LABELS), _orders.N_SHOWN), np.float32)
    costs = np.broadcast_to(np.asarray(cost, np.float32), (n, len(LABELS))).copy()
    first = orders[:, 0].copy()
    inside = np.ones_like(costs, bool)
    candidates = Candidates(first, 1, orders, shown, np.zeros_like(costs), inside)
    place = np.broadcast_to(off, valid.shape)[valid].astype(np.intp) + 4
    return Choice(Weighed(candidates, costs), place, np.full(n, 0.999), np.zeros(n))


def listed_of(chosen: Choice) -> Candidates:
    assert isinstance(chosen.table, Weighed)
    return chosen.table.candidates


def off_of(task: Any, turns: Floats, chosen: Choice) -> NDArray[np.int64]:
    true = np.rint(turns - task.phase.astype(np.float64) / (2 * np.pi))
    off = np.full(task.valid.shape, 99)
    off[task.valid] = chosen.order - true[task.valid]
    return np.asarray(off, np.int64)


def test_no_patch_of_a_surface_is_surer_than_most_of_it() -> None:
    """The step between two surfaces divides them; so does a patch of other orders."""
    two = FLAT + np.where(COLS < 30, 0.0, 1.4)
    task = task_of(two)
    chosen = choice_of(task, two, 0)
    certainty = np.where(PATCH, 0.99, 0.6)
    certainty[COLS < 30] = 0.8
    found = no_surer_than_most(task, chosen, certainty.ravel()).reshape(SHAPE)
    np.testing.assert_array_equal(found, np.where(COLS < 30, 0.8, 0.6))
    lone = np.where(PATCH, 0.2, 0.9).ravel()
    np.testing.assert_array_equal(no_surer_than_most(task, chosen, lone), lone)


@pytest.mark.parametrize("wrong", [-2, -1, 1, 3])
def test_a_part_of_a_smooth_surface_gets_the_order_of_the_rest(wrong: int) -> None:
    task = task_of(FLAT)
    healed = made_whole(task, choice_of(task, FLAT, wrong * RAGGED))
    assert (off_of(task, FLAT, healed) == 0).all()
    share = 1 - RAGGED.mean()
    assert np.median(healed.probability[RAGGED.ravel()]) == pytest.approx(share, abs=1e-3)
    odds = (share / (1 - share)) ** 3
    rest = np.median(healed.probability[~RAGGED.ravel()])
    assert rest == pytest.approx(odds / (1 + odds), abs=1e-3)
    trusting = made_whole(task, choice_of(task, FLAT, wrong * RAGGED), doubts=False)
    assert (trusting.probability[~RAGGED.ravel()] == 0.999).all()


def test_halves_that_disagree_are_both_in_doubt() -> None:
    task = task_of(FLAT)
    healed = made_whole(task, choice_of(task, FLAT, COLS >= 41))
    assert (off_of(task, FLAT, healed) == 0).all()
    assert (healed.probability < 0.6).all()


def test_orders_that_follow_the_phase_stay() -> None:
    task = task_of(FLAT)
    assert np.ptp(np.floor(FLAT)) >= 3  # the orders themselves do change
    chosen = choice_of(task, FLAT, 0)
    healed = made_whole(task, chosen)
    np.testing.assert_array_equal(healed.order, chosen.order)
    np.testing.assert_array_equal(healed.probability, chosen.probability)


def test_levels_add_up_along_a_chain() -> None:
    """Strips that are 0, 1, 2, 3 orders off, of which only neighbours touch."""
    off = np.digitize(COLS, [40, 54, 67])
    task = task_of(FLAT)
    healed = made_whole(task, choice_of(task, FLAT, off))
    assert (off_of(task, FLAT, healed) == 0).all()


@pytest.mark.parametrize("step", [0.3, 0.5, -0.37, 1.2])
def test_a_depth_edge_divides(step: float) -> None:
    """Where the phase jumps by a part of a period, the other side may have any order."""
    turns = FLAT + step * PATCH
    task = task_of(turns)
    chosen = choice_of(task, turns, 2 * PATCH)
    assert (off_of(task, turns, made_whole(task, chosen)) == 2 * PATCH).all()


@pytest.mark.parametrize("step", [1.0, 1.015])
def test_a_step_of_a_whole_period_stays_where_c2_sees_it(step: float) -> None:
    """Between parallel planes the phase is smooth all along the edge."""
    turns = FLAT + step * PATCH
    task = task_of(turns)
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[PATCH.ravel(), 3] = 8.9
    chosen = choice_of(task, turns, 0 * PATCH, cost)
    assert (off_of(task, turns, made_whole(task, chosen)) == 0).all()


def test_surfaces_that_touch_by_chance_are_not_joined() -> None:
    """A patch of wrong order on one surface meets another in a few pixels of equal phase."""
    other = COLS >= 60
    turns = FLAT + 0.37 * other - np.where(other & (ROWS == 30) & (COLS < 64), 0.37, 0.0)
    task = task_of(turns)
    off = np.where(other, 1, 0) + ((ROWS > 10) & (ROWS < 50) & (COLS >= 50) & ~other)
    found = off_of(task, turns, made_whole(task, choice_of(task, turns, off)))
    assert (found[COLS < 60] == 0).mean() > 0.99
    assert (found[other & (np.abs(ROWS - 30) > 2)] == 1).all()


def test_a_few_clear_pixels_do_not_carry_the_others() -> None:
    task = task_of(FLAT)
    large = COLS >= 4
    chosen = choice_of(task, FLAT, large)
    chosen.probability[large.ravel()] = 0.98
    np.testing.assert_array_equal(made_whole(task, chosen).order, chosen.order)


def test_other_evidence_refutes_as_well() -> None:
    task = task_of(FLAT)
    chosen = choice_of(task, FLAT, PATCH)
    listed_of(chosen).extras[PATCH.ravel(), 4] = 100.0
    assert (off_of(task, FLAT, made_whole(task, chosen)) == PATCH).all()


def test_a_bend_divides_unless_it_is_noise() -> None:
    """A roof of 0.5 rad in the second difference, with little noise and with much."""
    turns = 0.05 * np.abs(COLS - 40) + 10.0
    off = (COLS >= 40).astype(int)
    sharp, noisy = task_of(turns, std=0.005), task_of(turns, std=0.2)
    assert (off_of(sharp, turns, made_whole(sharp, choice_of(sharp, turns, off))) == off).all()
    healed = made_whole(noisy, choice_of(noisy, turns, off))
    assert len(np.unique(off_of(noisy, turns, healed))) == 1


def test_what_c2_refutes_does_not_move() -> None:
    task = task_of(FLAT)
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[PATCH.ravel(), 4] = 50.0  # the order of the rest
    chosen = choice_of(task, FLAT, PATCH, cost)
    assert (off_of(task, FLAT, made_whole(task, chosen)) == PATCH).all()
    few = (ROWS > 25) & (ROWS < 29) & (COLS > 50) & (COLS < 56)  # 15 px, less than a patch
    healed = made_whole(task, choice_of(task, FLAT, few, cost))
    assert (off_of(task, FLAT, healed) == 0).all()


def test_a_patch_that_hangs_on_its_surface_by_a_chain_of_pixels_is_made_whole() -> None:
    """Along one row the phase rises by two periods without a bend: the patch is two orders off
    there, and all is one part."""
    along = np.clip((COLS - 10.0) / 40, 0, 1)
    chain = (ROWS == 30) & (COLS <= 50)
    turns = FLAT + 2 * PATCH + np.where(chain, 2 * (3 * along**2 - 2 * along**3), 0.0)
    task = task_of(turns)
    off = off_of(task, turns, made_whole(task, choice_of(task, turns, 0)))
    assert (off[PATCH] == -2).all()
    assert (off[~PATCH & ~chain] == 0).all()


@pytest.mark.parametrize("hides", [0.0, 0.5, 1.0])
def test_what_something_hides_from_c2_refutes_nothing(
    hides: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the patch belongs C2 sees another surface in three quarters of its pixels."""
    task = task_of(FLAT)
    task.stride = (1, 1)
    before = PATCH & (COLS > 57)
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[before.ravel(), 4] = 50.0
    hidden = before & (57 + 22 * (1 - hides) < COLS)
    monkeypatch.setattr(whole, "_hidden_from_c2", lambda *_: hidden.ravel())
    off = off_of(task, FLAT, made_whole(task, choice_of(task, FLAT, PATCH, cost)))
    assert (off[PATCH] == (0 if hides == 1.0 else 1)).all()


HALF = PATCH & (COLS > 64)
"""The right half of the patch: 15 px wide; the patch is 29 px wide, 19 px high, and ends where the
image ends."""


@pytest.mark.parametrize(
    ("moves", "parts", "bent", "holes", "healed"),
    [
        pytest.param(PATCH, PATCH, None, None, [1.0], id="all of it"),
        pytest.param(HALF, HALF, None, None, [(30 - 19) / (30 + 19)], id="tears a half off"),
        pytest.param(PATCH, HALF, None, None, [30 / 30], id="what moves with it is no border"),
        pytest.param(PATCH, PATCH * 1 + HALF, None, None, [1.0, 1.0], id="two that move"),
        pytest.param(~PATCH, ~PATCH, None, None, [0.0], id="no nearer"),
        pytest.param(PATCH, PATCH, 29, None, [48 / 77], id="an edge"),
        pytest.param(PATCH, PATCH, None, (30, 60), [1.0], id="a hole"),
        pytest.param(PATCH, PATCH, None, (np.s_[:], 50), [58 / 77], id="a gap along it"),
    ],
)
def test_which_part_of_a_border_is_healed(
    moves: Any, parts: Any, bent: Any, holes: Any, healed: list[float]
) -> None:
    """Counted by hand: 19 px to the left of the patch, 29 above and below."""
    turns = FLAT + (0.37 * (ROWS > 39) if bent else 0.0)
    valid = np.ones(SHAPE, bool)
    if holes is not None:
        valid[holes] = False
    task = task_of(turns, valid=valid)
    chosen = choice_of(task, turns, PATCH * 1)
    wanted = choice_of(task, turns, PATCH * 1 - moves)
    of = np.asarray(parts * 1 - 1)[valid]
    found = whole._healed(task, chosen, wanted, of)
    np.testing.assert_allclose(found, healed)


@pytest.mark.parametrize("edge", [0.0, 0.37])
def test_what_is_smooth_along_one_side_alone_stays(edge: float) -> None:
    """A patch goes on smoothly to the left; above and below it is, or is not, another surface."""
    right = (COLS > 50) & ~PATCH
    turns = FLAT + edge * right
    task = task_of(turns)
    off = off_of(task, turns, made_whole(task, choice_of(task, turns, PATCH)))
    np.testing.assert_array_equal(off, PATCH * 1 if edge else 0)


def test_specks_without_a_phase_do_not_hold_a_patch() -> None:
    valid = np.random.default_rng(1).random(SHAPE) > 0.05
    task = task_of(FLAT, valid=valid)
    off = off_of(task, FLAT, made_whole(task, choice_of(task, FLAT, PATCH)))
    assert (off[PATCH & valid] == 0).mean() > 0.99


def test_a_patch_that_is_hidden_as_a_whole_is_not_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of(FLAT)
    task.stride = (1, 1)
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[PATCH.ravel(), 4] = 50.0
    monkeypatch.setattr(whole, "_hidden_from_c2", lambda *_: PATCH.ravel())
    off = off_of(task, FLAT, made_whole(task, choice_of(task, FLAT, PATCH, cost)))
    assert (off == 0).all()


@pytest.mark.parametrize("has_other", [False, True])
def test_what_is_hidden_acquits_and_never_convicts(
    has_other: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six in ten pixels fit by chance what hides them: a patch goes, whatever else is refuted."""
    task = task_of(FLAT)
    task.stride = (1, 1)
    other = has_other & (ROWS > 20) & (ROWS < 40) & (COLS < 20)
    hidden = PATCH & (COLS > 61)
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[(other | (PATCH & ~hidden)).ravel(), 4] = 50.0
    monkeypatch.setattr(whole, "_hidden_from_c2", lambda *_: hidden.ravel())
    off = off_of(task, FLAT, made_whole(task, choice_of(task, FLAT, PATCH | other, cost)))
    np.testing.assert_array_equal(off, other * 1)


@pytest.mark.parametrize(("seam", "bridge", "level"), [(20, 1, 2), (9, 2, 2), (12, 4, 0)])
def test_a_bond_outweighs_a_seam_that_is_not_much_longer(
    seam: int, bridge: int, level: int
) -> None:
    """Two pieces of a part: by the seam they are two orders apart, by the bridge none."""
    parts = np.zeros((40, 60), np.int64)
    higher, smooth = np.zeros((2, 40, 60), np.int64), np.ones((2, 40, 60), bool)
    higher[1, :seam, 29], parts[seam + bridge :] = 2, -1
    pieces = cut_apart(parts, higher, smooth)
    assert pieces.max() == 1
    _, found = whole._levels(*whole._seams(pieces, parts, higher, smooth), 2)
    assert found.tolist() == [0, level]


def test_levels_are_those_of_the_longest_borders() -> None:
    """Three groups of pieces, of known levels; borders that say otherwise are shorter."""
    rng = np.random.default_rng(4)
    true, group = rng.integers(-3, 4, 300), np.arange(300) % 3
    pairs = rng.integers(0, 300, (4000, 2))
    pairs = pairs[(group[pairs[:, 0]] == group[pairs[:, 1]]) & (pairs[:, 0] != pairs[:, 1])]
    first, second = np.sort(pairs, axis=1).T
    wrong = rng.random(len(pairs)) < 0.3
    higher = true[second] - true[first] + wrong
    length = np.where(wrong, rng.integers(4, 20, len(pairs)), rng.integers(21, 90, len(pairs)))
    surface, level = whole._levels(first, second, higher, length, 300)
    np.testing.assert_array_equal(surface, group)
    np.testing.assert_array_equal(level, true - true[group])


def test_what_stands_before_a_table_hides_it_from_c2() -> None:
    """Of the true orders; against the shadow of a sphere in closed form, but for its border."""
    rig, ball = small_rig(), Surface()
    assert rig.projector is not None
    views = TwoViews(camera1=rig.cameras[0], camera2=rig.cameras[1],
                     phases1=phase_map(rig.cameras[0], rig.projector, ball),
                     phases2=phase_map(rig.cameras[1], rig.projector, ball))  # fmt: skip
    task = solid_task(rig, views, (1, 1))
    chosen = task.decide(task.frame.constant((0.0, 0.0), scatter_px=0.05))
    grid = grid_of(rig.cameras[0])
    turns = true_turns(rig.cameras[0], rig.projector, ball, grid)
    true = np.floor(turns)[task.valid].astype(np.int32)
    place, listed = chosen.table.place_of(true, np.arange(len(true)))
    found = np.zeros(task.valid.shape, bool)
    found[task.valid] = whole._hidden_from_c2(task, replace(chosen, place=place))
    points, _, on_ball = seen_points(rig.cameras[0], grid, ball)
    origin = rig.cameras[1].center_world
    away = points - origin
    distance = np.linalg.norm(away, axis=-1)
    first = sphere_distance(origin, away / distance[..., None], ball.center_mm, ball.radius_mm)
    hidden = first < distance - 1e-6
    unsure = maximum_filter(hidden, 5) & ~minimum_filter(hidden, 5)
    sure = task.valid & ~unsure & ~on_ball
    sure[task.valid] &= listed
    assert (hidden & sure).sum() > 100
    np.testing.assert_array_equal(found[sure], hidden[sure])


def test_most_clear_pixels_elect_the_order_not_the_largest_part() -> None:
    """The larger part is not seen by C2: it follows the smaller one, which is."""
    task = task_of(FLAT)
    large = COLS >= 30  # of 80
    cost = np.zeros((FLAT.size, len(LABELS)))
    cost[large.ravel()] = np.nan
    healed = made_whole(task, choice_of(task, FLAT, large, cost))
    assert (off_of(task, FLAT, healed) == 0).all()


def test_gaps_and_missing_candidates() -> None:
    valid = ~((COLS == 40) | (ROWS == 3))
    task = task_of(FLAT, valid=valid)
    chosen = choice_of(task, FLAT, 4 * (COLS > 40))
    assert (off_of(task, FLAT, made_whole(task, chosen))[valid] == (4 * (COLS > 40))[valid]).all()
    # Two steps below the lowest candidate there is nothing to move to.
    task = task_of(FLAT)
    chosen = choice_of(task, FLAT, np.where(PATCH, 3, -3))
    listed_of(chosen).orders[PATCH.ravel(), :4] = NO_ORDER
    off = off_of(task, FLAT, made_whole(task, chosen))
    assert (off[PATCH] == 3).all()
    assert (off[~PATCH] == -3).all()


def test_nothing_known() -> None:
    task = task_of(FLAT)
    chosen = choice_of(task, FLAT, 0)
    listed_of(chosen).orders[:] = NO_ORDER
    assert made_whole(task, chosen) is chosen
