"""Views whose angles nobody knows: turns that are tried, fits that contradict, wrong places."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ball_views import AXIS, ball_views, camera, seen_balls
from fringe3d.errors import RegistrationError
from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register import AdjustOptions, TablePrior, adjust, surface_view, vector_of
from fringe3d.register.blocks import Blocks, Link, blocks_of
from fringe3d.register.doubting import conflicts, refuse_conflicts
from fringe3d.register.turning import joined_by_turns, tuned_turns

TURNS = (0.0, 50.0, 113.0, 200.0, 290.0)
MIDDLE = np.array([0.0, 0.0, 2.0])

Series = tuple[list[SurfaceView], list[RigidTransform]]


@pytest.fixture(scope="module")
def series() -> Series:
    return ball_views(TURNS, sigma_mm=0.005, seed=4, shape=(72, 96))


def alone(n: int) -> list[dict[int, RigidTransform]]:
    return [{k: RigidTransform.identity()} for k in range(n)]


def off(found: dict[int, RigidTransform], true: list[RigidTransform]) -> np.ndarray:
    """Return how far views lie from the true places, as seen from the first: (n, 6)."""
    first = found[0].inverse()
    return np.asarray([vector_of(first @ found[k] @ true[k].inverse(), MIDDLE)
                     for k in sorted(found)])  # fmt: skip


def settled(blocks: Blocks, true: list[RigidTransform]) -> np.ndarray:
    """Return how far views lie from the true places after the adjustment, mm and rad."""
    (block,) = blocks.blocks
    # Coarse: within two pixels (0.35 mm) at the rim of the body (16 mm): 2.5 deg.
    assert np.degrees(np.abs(off(block, true)[:, :3])).max() < 2.5
    first = block[0].inverse()
    start = [first @ block[k] for k in range(len(block))]
    prior = TablePrior(angle_sigma=math.inf)
    found = adjust(blocks.views[: len(block)], start, AdjustOptions(table=prior, n_samples=1000))
    return np.asarray(np.abs(off(dict(enumerate(found.body_from_view)), true)))


def test_unknown_turns_about_a_known_axis_are_found(series: Series) -> None:
    """All turns are tried; a wrong sense of the axis would place every view wrongly."""
    views, true = series[0][:3], series[1][:3]
    blocks = blocks_of(views, alone(3))
    joined_by_turns(blocks, range(3), AXIS)
    errors = settled(blocks, true)
    # Noise and interpolation between pixels, as for the adjustment of all views in test_register.
    assert errors[:, 3:].max() < 8e-3
    assert errors[:, :3].max() < 1e-3


def test_the_others_tell_the_axis_and_a_view_beside_it_is_placed_again(series: Series) -> None:
    """Three views were joined rightly, one wrongly: turned about another axis."""
    views, true = series[0][:4], series[1][:4]
    aside = RigidTransform(rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]], translation=[0, 0, 0])
    blocks = blocks_of(views, [{0: true[0], 1: true[1], 2: true[2], 3: true[3] @ aside}])
    joined_by_turns(blocks, range(4), None)
    errors = settled(blocks, true)
    assert errors[:, 3:].max() < 8e-3
    assert errors[:, :3].max() < 1e-3


def test_a_ball_on_the_axis_does_not_tell_its_turns() -> None:
    device = camera((72, 96))
    center = AXIS.point_mm - AXIS.point_mm[2] / AXIS.direction[2] * AXIS.direction
    points = seen_balls(device, np.array([[*center, 12.0]]))
    views = [surface_view(name, device, points, np.full(device.shape, 0.005)) for name in "ab"]
    blocks = blocks_of(views, alone(2))
    joined_by_turns(blocks, range(2), AXIS)
    assert len(blocks.blocks) == 2


def test_rough_angles_are_made_finer(series: Series) -> None:
    views, true = series
    rng = np.random.default_rng(1)
    about = true[0].inverse()  # the first view stands at 0 deg: its frame is the world's
    placed = {k: about @ pose @ AXIS.turn(math.radians(rng.uniform(-2, 2)) if k else 0.0)
              for k, pose in enumerate(true)}  # fmt: skip
    before = np.degrees(np.abs(off(placed, true)[:, :3])).max()
    blocks = blocks_of(views, [placed])
    tuned_turns(blocks, range(5), AXIS, math.radians(6))
    after = np.degrees(np.abs(off(blocks.blocks[0], true)[:, :3])).max()
    # A pixel (0.35 mm) at the rim of the body (16 mm) is 1.2 deg.
    assert after < 1.0 < 1.5 < before


def test_a_wrong_fit_joins_nothing_that_other_views_contradict(series: Series) -> None:
    """The wrong fit of two neighbours comes first; with a third view it contradicts."""
    views, true = series
    wrong = Link(0, 1, AXIS.turn(math.radians(40)))
    right = [Link(a, b, true[a].inverse() @ true[b]) for a, b in ((0, 1), (1, 2), (2, 3), (3, 4))]
    blocks = blocks_of(views, alone(5))
    blocks.join_by([wrong, *right])
    assert len(blocks.blocks) == 1
    assert np.abs(off(blocks.blocks[0], true)).max() < 1e-9
    blocks = blocks_of(views, [{0: true[0]}, {k: true[k] for k in range(1, 5)}])
    blocks.join_by([wrong])
    assert len(blocks.blocks) == 2


def test_wrong_places_are_refused_and_small_errors_are_not(series: Series) -> None:
    """A view turned by 30 deg is named; one that lies 0.1 mm beside is no conflict."""
    views, true = series
    found = adjust(views, true, AdjustOptions(n_samples=500))
    assert conflicts(views, true) == []
    refuse_conflicts(views, found)
    beside = RigidTransform(rotation=np.eye(3), translation=[0.1, 0, 0])
    assert conflicts(views, [*true[:4], beside @ true[4]]) == []
    turned = [*true[:2], true[2] @ AXIS.turn(math.radians(30)), *true[3:]]
    pairs = conflicts(views, turned)
    assert pairs
    assert all(2 in pair[:2] for pair in pairs)
    object.__setattr__(found, "body_from_view", tuple(turned))
    with pytest.raises(RegistrationError, match=f"Most contradict: {views[2].name}, "):
        refuse_conflicts(views, found)
