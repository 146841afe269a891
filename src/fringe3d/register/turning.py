"""Views on a table whose angles nobody knows: all turns are about one axis, and can be tried."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import RigidTransform, TableAxis
from fringe3d.register.axis import LEAST_TURN, axis_of_motions
from fringe3d.register.blocks import Blocks, Poses
from fringe3d.register.table_model import near_point

STEP_RAD = math.radians(1.5)
"""Of the turns that are tried; a fifth of it where one is made finer."""

SAME_DIRECTION, SAME_PLACE = math.radians(1.5), 0.03
"""By which axes of one table may differ: direction, and place as part of the body's size."""

NO_ALTERNATIVE = 0.9
"""Another turn that agrees as well as this part of the best one leaves doubt."""

FINE = 0.3
"""Part of the usual distance within which surfaces agree once their turns are nearly right."""

OTHER_TURN = 4.0
"""Steps from which on a turn is another one."""


def joined_by_turns(blocks: Blocks, group: Sequence[int], axis: TableAxis | None, /) -> None:
    """Join the blocks of one tilt: all their views are turns about one axis.

    The axis is that on which the turns of the largest block agree; a view of it that does not is
    taken out. Then all turns of every other block are tried, and the one that agrees best with all
    views is taken, if no other one agrees nearly as well.

    Parameters
    ----------
    blocks : Blocks; of the views of this tilt, and others
    group : sequence of int; views of the tilt
    axis : TableAxis or None; where it is known
    """
    body = _body(np.concatenate([blocks.cloud({k: RigidTransform.identity()}) for k in group]))
    told = axis
    while True:
        one = _largest(blocks, group)
        axis = told or axis_of_block(one, body)
        others = [b for b in blocks.blocks if b is not one and set(b) <= set(group)]
        if axis is None:
            return
        for view in _beside(one, axis, body):
            others.append({view: one.pop(view)})
            blocks.blocks.append(others[-1])
        if not others:
            return
        tried = [(*best_turn(blocks, one, two, axis, body.size_mm), two) for two in others]
        _, joined, two = max(tried, key=lambda found: found[0])
        if joined is None:
            return
        blocks.merge(one, two, joined)
        if len(one) == len(group):
            tuned_turns(blocks, group, told or axis_of_block(one, body) or axis, 2 * STEP_RAD)
            return


def _largest(blocks: Blocks, group: Sequence[int]) -> Poses:
    return max((b for b in blocks.blocks if set(b) <= set(group)), key=len)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Where the body is and how large, in the world frame."""

    middle_mm: NDArray[np.float64]
    size_mm: float


def _body(points_mm: NDArray[np.float64]) -> Body:
    size = float(np.linalg.norm(np.ptp(points_mm, axis=0)))
    return Body(points_mm.mean(axis=0), size)


def axis_of_block(block: Poses, body: Body, /) -> TableAxis | None:
    """Return the axis about which most views of a block are turned; None where none is."""
    motions = [block[b].inverse() @ block[a] for a, b in itertools.combinations(block, 2)]
    motions = [m for m in motions if _turn(m) > LEAST_TURN]
    if not motions:
        return None
    singles = [axis_of_motions([m]) for m in motions]
    best = max(([m for m in motions if _is_about(axis, m, body)] for axis in singles), key=len)
    return axis_of_motions(best) if best else None


def _turn(motion: RigidTransform) -> float:
    return float(np.linalg.norm(Rotation.from_matrix(motion.rotation).as_rotvec()))


def _is_about(axis: TableAxis, motion: RigidTransform, body: Body) -> bool:
    """Tell whether a motion is a turn about an axis, nearly."""
    place, allowed = near_point(axis, body.middle_mm), SAME_PLACE * body.size_mm
    if _turn(motion) < LEAST_TURN:
        return bool(np.linalg.norm(motion.apply(place) - place) < allowed)
    own = axis_of_motions([motion])
    lean = float(np.linalg.norm(np.cross(own.direction, axis.direction)))
    rise = abs(float(own.direction @ motion.translation))
    apart = float(np.linalg.norm(near_point(own, place) - place))
    least = math.sin(min(_turn(motion), math.pi / 2))  # small turns tell their axis badly
    return lean * least < SAME_DIRECTION and rise < allowed and apart * least < allowed


def _beside(block: Poses, axis: TableAxis, body: Body) -> list[int]:
    """Return the views of a block that are not turned about the axis as most others are."""
    found = []
    for k, pose in block.items():
        agree = [_is_about(axis, other.inverse() @ pose, body)
                 for j, other in block.items() if j != k]  # fmt: skip
        if len(agree) > 1 and sum(agree) < len(agree) / 2:
            found.append(k)
    return found if len(found) < len(block) / 2 else []


def best_turn(
    blocks: Blocks, one: Poses, two: Poses, axis: TableAxis, size_mm: float, /
) -> tuple[float, RigidTransform | None]:
    """Try all turns of a block about the axis; return how well the best agrees, and the place.

    Returns
    -------
    float, RigidTransform or None
        None where nothing agrees, or several turns do.
    """
    a, b = next(iter(one)), next(iter(two))

    def place(turn: float) -> RigidTransform:
        return one[a] @ axis.turn(-turn) @ two[b].inverse()

    # Between two steps the surface moves by so much at the rim of the body.
    reach = max(blocks.probes.near_mm, 0.3 * STEP_RAD * size_mm)
    turns = np.arange(0, 2 * math.pi, STEP_RAD)
    rough = np.array([blocks.quality(one, two, place(turn), near_mm=reach) for turn in turns])
    best = int(rough.argmax())
    if rough[best] <= 0:
        return 0.0, None
    away = np.abs(np.remainder(turns - turns[best] + math.pi, 2 * math.pi) - math.pi)
    others = rough[away > OTHER_TURN * STEP_RAD]
    if others.max() > NO_ALTERNATIVE * rough[best]:
        return 0.0, None
    fine = turns[best] + STEP_RAD * np.linspace(-1, 1, 11)
    sharp = [blocks.quality(one, two, place(turn)) for turn in fine]
    k = int(np.argmax(sharp))
    return (sharp[k], place(fine[k])) if sharp[k] > 0 else (0.0, None)


def tuned_turns(blocks: Blocks, group: Sequence[int], axis: TableAxis, span: float, /) -> None:
    """Turn each view of a placed tilt about the axis by up to so much (rad), until all agree.

    The first view stays. Steps become smaller, from a quarter of the span to 0.05 degrees.
    """
    block = next(b for b in blocks.blocks if group[0] in b)
    size = _body(blocks.cloud({group[0]: RigidTransform.identity()})).size_mm
    while span > STEP_RAD / 10:
        near = max(FINE * blocks.probes.near_mm, 0.3 * span * size)
        for k in group[1:]:
            others = {j: pose for j, pose in block.items() if j != k}
            tried = [block[k] @ axis.turn(turn) for turn in span * np.linspace(-1, 1, 9)]
            scores = [blocks.score(others, {k: pose}, near_mm=near) for pose in tried]
            block[k] = tried[int(np.argmax(scores))]
        span /= 2.5
