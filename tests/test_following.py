"""Fringe orders that go on from the frame before, against moved surfaces in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import Recording
from closed_phases import Surface, grid_of, phase_map, seen_points, small_rig, true_turns, visible
from fringe3d.correspond import following, lit_before, orders_of_before, seen_before
from fringe3d.decoding import carried_from_points, carried_on
from fringe3d.errors import MethodError
from fringe3d.model import NO_ORDER, PhaseMap, Rejection, Rig, Scan
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.session import Session

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]
BALL = Surface()
N_CLASSES = 4


@cache
def rig_of() -> Rig:
    return small_rig()


def raised(mm: float) -> Surface:
    """Return ball and table, nearer to the cameras."""
    x, y, z = BALL.center_mm
    return Surface(plane_z_mm=BALL.plane_z_mm + mm, center_mm=(x, y, z + mm))


def beside(mm: float) -> Surface:
    """Return the ball moved over the table."""
    x, y, z = BALL.center_mm
    return replace(BALL, center_mm=(x + mm, y, z))


def points_of(surface: Surface) -> Floats:
    camera = rig_of().cameras[0]
    return seen_points(camera, grid_of(camera), surface)[0]


def points_before() -> Floats:
    """Return what was measured before: where C2 and the projector see the surface."""
    return np.where(visible(rig_of(), BALL)[..., None], points_of(BALL), np.nan)


def followed(
    number: int, now: Surface, before: Floats | None = None, n_classes: int = N_CLASSES
) -> tuple[PhaseMap, Floats]:
    """Return the phases of a camera with the orders from before, and the true orders now."""
    rig = rig_of()
    camera, projector = rig.cameras[number], rig.projector
    assert projector is not None
    phases = phase_map(camera, projector, now, n_classes=n_classes)
    points = points_before() if before is None else before
    turns = lit_before(phases, projector, points)
    found = orders_of_before(phases, seen_before(turns, points, camera) if number else turns)
    return found, np.floor(true_turns(camera, projector, now, grid_of(camera)))


def motion_of(now: Surface) -> Floats:
    """Return by how many periods the phase of each pixel of C1 moves, (row, col)."""
    rig = rig_of()
    assert rig.projector is not None
    grid = grid_of(rig.cameras[0])
    return true_turns(rig.cameras[0], rig.projector, now, grid) - true_turns(
        rig.cameras[0], rig.projector, BALL, grid
    )


def test_orders_that_the_code_contradicts_are_none() -> None:
    """Everything seems to have moved by a whole period; of four classes none agrees."""
    rig, before = rig_of(), points_before()
    assert rig.projector is not None
    next_one = phase_map(rig.cameras[0], rig.projector, BALL, n_classes=N_CLASSES)
    shifted = replace(next_one, order_class=np.where(
        next_one.order_class == NO_ORDER, NO_ORDER, (next_one.order_class + 1) % N_CLASSES
    ).astype(np.int32))  # fmt: skip
    found = orders_of_before(shifted, lit_before(shifted, rig.projector, before))
    assert (found.order_class == NO_ORDER).all()


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("mm", [0.0, 0.15, -0.4])
def test_orders_go_on_where_all_move_alike(number: int, mm: float) -> None:
    """0.4 mm are some 0.4 periods; that of all pixels alike is no riddle."""
    found, true = followed(number, raised(mm))
    known = found.order_class != NO_ORDER
    assert found.is_absolute
    seen = visible(rig_of(), raised(mm)) if number == 0 else np.ones(known.shape, bool)
    assert known[seen].mean() > (0.99 if number == 0 else 0.8)
    assert (found.order_class == true)[known & seen].mean() > 0.995


def test_a_thing_moves_before_another_that_does_not() -> None:
    """Along the slopes of the ball the phase moves by up to a tenth of a period and more."""
    now = beside(1.2)
    motion = np.abs(motion_of(now))[visible(rig_of(), now) & visible(rig_of(), BALL)]
    assert motion.max() > 0.1
    found, true = followed(0, now)
    known = visible(rig_of(), now) & (found.order_class != NO_ORDER)
    assert known.sum() > 0.95 * visible(rig_of(), now).sum()
    assert (found.order_class == true)[known].mean() > 0.99


def test_what_nothing_was_known_of_is_ambiguous_but_near_what_was() -> None:
    before, col = points_before(), 60
    before[:, col:] = np.nan
    found, true = followed(0, raised(0.1), before)
    seen = visible(rig_of(), raised(0.1))
    far = seen & (np.arange(seen.shape[1]) >= col + following.REACH_PX)
    assert far.sum() > 1000
    assert (found.rejection[far] == np.uint16(Rejection.AMBIGUOUS)).all()
    near = seen & (np.arange(seen.shape[1]) >= col) & (found.order_class != NO_ORDER)
    assert near.sum() > 1000
    assert (found.order_class == true)[near].mean() > 0.98


def test_without_a_code_holes_are_closed_but_no_border_grows() -> None:
    before = points_before()
    known = np.isfinite(before[..., 0])
    hole = (30, 50)
    assert known[29:32, 49:52].all()
    before[hole] = np.nan
    found, true = followed(0, BALL, before, n_classes=1)
    has_order = found.order_class != NO_ORDER
    assert has_order[hole]
    assert found.order_class[hole] == true[hole]
    grown = has_order & ~known
    assert grown.sum() < 0.02 * known.sum()  # notches of the border are holes, too
    wider = np.where((known | grown)[..., None], points_of(BALL), np.nan)
    again, _ = followed(0, BALL, wider, n_classes=1)
    assert (again.order_class != NO_ORDER).sum() < 1.02 * known.sum()


def test_a_single_wrong_point_before_is_outvoted() -> None:
    before = points_before()
    row, col = 20, 60
    assert visible(rig_of(), BALL)[row, col]
    direction = before[row, col] - rig_of().cameras[0].center_world
    before[row, col] += 1.5 * direction / np.linalg.norm(direction)
    found, true = followed(0, BALL, before)
    assert found.order_class[row, col] == true[row, col]


def test_a_session_follows(recording: Recording, rig: Rig) -> None:
    """The same scene twice: the same orders, and nearly all points."""
    plan = recording[0].stacks[0].plan
    session = Session(rig, plan, MeasureOptions(method="m2", gray_bits=3), keep=False)
    first = session.measure(recording[0].stacks)
    again = session.follow(recording[0].stacks, first)
    assert first.points is not None
    assert again.points is not None
    assert "frame before" in again.why
    assert again.points.n_points > 0.97 * first.points.n_points
    assert first.matches is not None
    assert again.matches is not None
    both = first.points.is_valid & again.points.is_valid
    np.testing.assert_array_equal(
        first.matches.fringe_order[both], again.matches.fringe_order[both]
    )


def test_no_points_get_lost_from_frame_to_frame(recording: Recording, rig: Rig) -> None:
    """Without a code, along edges; a pixel wide each time, if orders of points alone went on."""
    by_code = measure(Scan(stacks=recording[0].stacks, rig=rig))
    stacks = [stack.subset(range(4)) for stack in recording[0].stacks]
    session = Session(rig, stacks[0].plan, MeasureOptions(method="m6"), keep=False)
    frame, counts = replace(by_code, method="m6"), []
    for _ in range(6):
        frame = session.follow(stacks, frame)
        assert "frame before" in frame.why
        assert frame.points is not None
        counts.append(frame.points.n_points)
    assert by_code.points is not None
    assert counts[0] > 0.95 * by_code.points.n_points
    assert counts[-1] > 0.998 * counts[0]


def test_what_is_lost_is_measured_anew(recording: Recording, rig: Rig) -> None:
    plan = recording[0].stacks[0].plan
    session = Session(rig, plan, MeasureOptions(method="m2", gray_bits=3), keep=False)
    first = session.measure(recording[0].stacks)
    assert first.points is not None
    # Half a period and more: the code of both cameras contradicts what is nearest then.
    elsewhere = replace(first.points, points_mm=first.points.points_mm + np.array([0.0, 0.0, 4.0]))
    again = session.follow(recording[0].stacks, replace(first, points=elsewhere))
    assert again.points is not None
    assert "frame before" not in again.why
    np.testing.assert_array_equal(again.points.points_mm, first.points.points_mm)


def test_orders_that_are_carried_on_beforehand_give_the_same(
    recording: Recording, rig: Rig
) -> None:
    """While the frame before is being measured; those of another frame are not taken."""
    stacks = recording[0].stacks
    session = Session(rig, stacks[0].plan, MeasureOptions(method="m2", gray_bits=3), keep=False)
    first = session.follow(stacks, session.measure(stacks))
    wanted = session.follow(stacks, first)
    shown = session.decode(stacks)
    early, stale = carried_on(shown, first.phases), carried_on(shown, wanted.phases)
    assert session.carry_on(early, first) is early
    assert session.carry_on(stale, first) is not stale
    for frame in (early, stale):
        found = session.follow(frame, first)
        assert found.points is not None
        assert wanted.points is not None
        np.testing.assert_array_equal(found.points.points_mm, wanted.points.points_mm)


def test_to_follow_points_takes_a_projector(recording: Recording, rig: Rig) -> None:
    alone = replace(rig, projector=None)
    session = Session(alone, recording[0].stacks[0].plan, MeasureOptions(method="m1"), keep=False)
    shown = session.decode(recording[0].stacks)
    with pytest.raises(MethodError, match="calibrated projector"):
        carried_from_points(shown, shown.phases, np.zeros((*shown.main.phase.shape, 3)))
