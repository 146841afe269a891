"""Where all views lie, roughly: from the table's angles, or from the shape of the body alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.errors import RegistrationError
from fringe3d.model import RigidTransform, SurfaceView, TableAxis
from fringe3d.register.axis import axis_of_motions
from fringe3d.register.blocks import Blocks, blocks_of, links_of
from fringe3d.register.pairs import (
    is_possible,
    match_pair,
)
from fringe3d.register.table_model import groups_of
from fringe3d.register.turning import joined_by_turns, tuned_turns

Step = Callable[[str, int, int], object]

ANGLE_FITS = math.radians(3.0)
"""How far the turn of two views may lie from the table's, beside the uncertainty of its angles."""

ENOUGH_MOTIONS = 4
"""Pairs of views whose turns fit the table's angles: they give its axis."""

ROUGH = math.radians(0.2)
"""Angles known worse than this are made finer before tilts are joined."""

LEAST_STEP, MOST_STEP = math.radians(5), math.radians(100)


def place_by_angles(
    views: Sequence[SurfaceView],
    /,
    *,
    angle_sigma: float,
    axis: TableAxis | None = None,
    step: Step = lambda *_: None,
) -> tuple[RigidTransform, ...] | None:
    """Place views by the angles of their table, whose axis the shape of the body tells.

    Parameters
    ----------
    views : sequence of SurfaceView; all with a known angle
    angle_sigma : float, rad; of these angles
    axis : TableAxis or None; where it is known, as from a calibration object
    step : called with the work, what is done and what there is to do

    Returns
    -------
    tuple of RigidTransform, or None
        ``body_from_view``; None where the axis cannot be found, or a tilt cannot be joined.
    """
    groups = groups_of(views)
    axis = axis or _axis(views, groups, angle_sigma, step)
    if axis is None:
        return None
    placed = {}
    for group in groups:
        for k in group:
            turned = _angle(views[k]) - _angle(views[group[0]])
            placed[k] = axis.turn(-turned)  # group's first view from view k
    blocks = blocks_of(views, [{k: placed[k] for k in group} for group in groups])
    if angle_sigma > ROUGH:
        for group in groups:
            tuned_turns(blocks, group, axis, 3 * angle_sigma)
    blocks.join_by_clouds(step)
    if len(blocks.blocks) > 1:
        blocks.join_by(links_of(views, _open_pairs(blocks), step))
    return _in_first(blocks) if len(blocks.blocks) == 1 else None


def _in_first(blocks: Blocks) -> tuple[RigidTransform, ...]:
    """Return where all views of one block lie in the frame of the first view."""
    block = blocks.blocks[0]
    first = block[0].inverse()
    return tuple(first @ block[k] for k in range(len(block)))


def _angle(view: SurfaceView) -> float:
    assert view.position is not None
    assert view.position.angle is not None
    return view.position.angle


def _axis(
    views: Sequence[SurfaceView], groups: Sequence[Sequence[int]], angle_sigma: float, step: Step
) -> TableAxis | None:
    """Return the axis of a few turns that fit the table's angles."""
    allowed = ANGLE_FITS + 3 * angle_sigma
    motions, angles = [], []
    pairs = list(_near_pairs(views, groups))
    for number, (a, b) in enumerate(pairs):
        step("finding the table's axis", number, len(pairs))
        fit = match_pair(views[a], views[b])
        if fit is None or not is_possible(fit):
            continue
        motion = fit.first_from_second.inverse()  # of the body, from its place in a to that in b
        turned = float(np.linalg.norm(Rotation.from_matrix(motion.rotation).as_rotvec()))
        told = _angle(views[b]) - _angle(views[a])
        if abs(turned - abs(math.remainder(told, 2 * math.pi))) > allowed:
            continue
        motions.append(motion)
        angles.append(told)
        axis = _agreed(motions, angles)
        if axis is not None:
            return axis
    return _agreed(motions, angles, least=1)


def _agreed(
    motions: Sequence[RigidTransform], angles: Sequence[float], *, least: int = ENOUGH_MOTIONS
) -> TableAxis | None:
    """Return the axis of those motions that agree; None if they are too few."""
    if len(motions) < least:
        return None
    singles = [axis_of_motions([m], angles=[a]) for m, a in zip(motions, angles, strict=True)]
    best: list[int] = []
    for one in singles:
        near = [k for k, other in enumerate(singles) if one.direction @ other.direction > 0.995]
        best = near if len(near) > len(best) else best
    if len(best) < least:
        return None
    return axis_of_motions([motions[k] for k in best], angles=[angles[k] for k in best])


def _near_pairs(
    views: Sequence[SurfaceView], groups: Sequence[Sequence[int]]
) -> Iterable[tuple[int, int]]:
    """Yield pairs of one tilt that the table turned little, spread around, the nearest first."""
    every = []
    for group in groups:
        for a, b in itertools.combinations(group, 2):
            turned = abs(math.remainder(_angle(views[b]) - _angle(views[a]), 2 * math.pi))
            if LEAST_STEP <= turned <= MOST_STEP:
                every.append((round(turned, 3), (a * 7) % len(views), a, b))
    yield from ((a, b) for _, _, a, b in sorted(every)[: 4 * ENOUGH_MOTIONS])


def place_by_shape(
    views: Sequence[SurfaceView],
    /,
    *,
    on_table: bool = False,
    axis: TableAxis | None = None,
    step: Step = lambda *_: None,
) -> tuple[RigidTransform, ...]:
    """Place views by the shape of the body alone.

    Parameters
    ----------
    views : sequence of SurfaceView
    on_table : bool; views of one tilt are turns about one axis
    axis : TableAxis or None; where it is known
    step : called with the work, what is done and what there is to do

    Returns
    -------
    tuple of RigidTransform; ``body_from_view``

    Raises
    ------
    RegistrationError
        If views cannot be joined without doubt; it names them.

    Notes
    -----
    Views recorded one after the other are likely to overlap most: they are matched first. Fits
    join them to blocks that no view contradicts. What features do not join is tried in all turns
    about the table's axis, on which the turns of the others agree; tilts are joined by the shape
    of all their views together.
    """
    blocks = blocks_of(views, [{k: RigidTransform.identity()} for k in range(len(views))])
    groups = groups_of(views) if on_table else [list(range(len(views)))]
    links = links_of(views, [pair for group in groups for pair in _next_pairs(group)], step)
    blocks.join_by(links)
    if on_table:
        for number, group in enumerate(groups):
            step("trying turns of the table", number, len(groups))
            joined_by_turns(blocks, group, axis)
    blocks.join_by_clouds(step)
    if len(blocks.blocks) > 1:
        links += links_of(views, _open_pairs(blocks), step)
        blocks.join_by(links)
        blocks.join_by_clouds(step)
    if len(blocks.blocks) > 1:
        told = "; ".join(", ".join(views[k].name for k in sorted(b)) for b in blocks.blocks)
        raise RegistrationError(
            "merge: expected views that the shape of the body joins without doubt, found "
            f"{len(blocks.blocks)} groups that nothing joins, or several places equally well: "
            f"{told}. Tell the angles of the table, if only roughly (--turns, --angles rough); "
            "turn the body by less between scans; put something beside it that does not repeat "
            "itself; or leave some out"
        )
    return _in_first(blocks)


def _next_pairs(group: Sequence[int]) -> list[tuple[int, int]]:
    """Return the views recorded one after the other, and the last with the first."""
    pairs = list(itertools.pairwise(group))
    return [*pairs, (group[0], group[-1])] if len(group) > 2 else pairs


MOST_PAIRS = 40
"""Of views of different blocks that are matched where neighbours in the recording do not do."""


def _open_pairs(blocks: Blocks) -> list[tuple[int, int]]:
    """Return pairs of views of different blocks, those recorded soon after each other first."""
    n = len(blocks.views)
    block_of = {k: number for number, block in enumerate(blocks.blocks) for k in block}
    pairs = [p for p in itertools.combinations(range(n), 2) if block_of[p[0]] != block_of[p[1]]]
    return sorted(pairs, key=lambda p: min(p[1] - p[0], n - p[1] + p[0]))[:MOST_PAIRS]
