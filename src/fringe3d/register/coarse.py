"""Where all views lie, roughly: from the table's angles, or from the shape of the body alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fringe3d.errors import EmptyResultError
from fringe3d.model import RigidTransform, SurfaceView, TableAxis
from fringe3d.register.axis import axis_of_motions
from fringe3d.register.pairs import (
    PairFit,
    is_possible,
    is_sure,
    judge_pair,
    match_pair,
)
from fringe3d.register.table_model import groups_of

Step = Callable[[str, int, int], object]

ANGLE_FITS = math.radians(3.0)
"""How far the turn of two views may lie from the table's, beside the uncertainty of its angles."""

ENOUGH_MOTIONS = 4
"""Pairs of views whose turns fit the table's angles: they give its axis."""

LEAST_STEP, MOST_STEP = math.radians(5), math.radians(100)


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Pairs of views that fit, by their numbers."""

    fits: dict[tuple[int, int], PairFit]

    def motion(self, a: int, b: int, /) -> RigidTransform:
        """Return ``a_from_b``."""
        if (a, b) in self.fits:
            return self.fits[a, b].first_from_second
        return self.fits[b, a].first_from_second.inverse()


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
    poses = {k: placed[k] for k in groups[0]}
    for number, group in enumerate(groups[1:]):
        step("joining tilts", number, len(groups) - 1)
        joined = _joined(views, groups[0], group, placed)
        if joined is None:
            return None
        poses |= {k: joined @ placed[k] for k in group}
    return tuple(poses[k] for k in range(len(views)))


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


def _joined(
    views: Sequence[SurfaceView],
    first: Sequence[int],
    group: Sequence[int],
    placed: dict[int, RigidTransform],
) -> RigidTransform | None:
    """Return where a tilt lies: the first view of `first` from the first view of `group`."""
    best: tuple[float, RigidTransform] | None = None
    for a in first:
        for b in (group[0], group[len(group) // 3], group[2 * len(group) // 3]):
            fit = match_pair(views[a], views[b])
            if fit is None or not is_possible(fit):
                continue
            joined = placed[a] @ fit.first_from_second @ placed[b].inverse()
            if best is None or fit.quality > best[0]:
                best = fit.quality, joined
            if is_sure(fit) and _holds(views, first, group, placed, joined):
                return joined
    return best[1] if best else None


def _holds(
    views: Sequence[SurfaceView], first: Sequence[int], group: Sequence[int],
    placed: dict[int, RigidTransform], joined: RigidTransform,
) -> bool:  # fmt: skip
    """Tell whether other views of both tilts agree with it, too."""
    judged = []
    for k in range(3):
        a, b = first[k * len(first) // 3], group[k * len(group) // 3]
        judged.append(judge_pair(views[a], views[b], placed[a].inverse() @ joined @ placed[b]))
    return all(fit.contradiction < 0.2 for fit in judged)


def place_by_shape(
    views: Sequence[SurfaceView], /, *, step: Step = lambda *_: None
) -> tuple[RigidTransform, ...]:
    """Place views by the shape of the body alone.

    Views recorded one after the other are likely to overlap most: they are tried first, then
    others, until a tree of fits that leave no doubt holds all together.

    Returns
    -------
    tuple of RigidTransform; ``body_from_view``

    Raises
    ------
    EmptyResultError
        If a view fits no other; it names the view.
    """
    n = len(views)
    links = Links({})
    order = sorted(itertools.combinations(range(n), 2), key=lambda p: _away(p, n))
    for number, (a, b) in enumerate(order):
        step("matching views", number, len(order))
        if _away((a, b), n) > 1 and len(_tree(n, links, sure=True)) == n:
            break
        fit = match_pair(views[a], views[b])
        if fit is not None and is_possible(fit):
            links.fits[a, b] = fit
    poses = _tree(n, links, sure=False)
    lost = [views[k].name for k in range(n) if k not in poses]
    if lost:
        raise EmptyResultError(
            f"merge: expected views that overlap, found none that fits {', '.join(lost)}. Turn the "
            "body by less between scans, tell the angles, or leave these out"
        )
    return tuple(poses[k] for k in range(n))


def _away(pair: tuple[int, int], n: int) -> int:
    """Return how far two views lie from each other in the order of recording, around the table."""
    apart = pair[1] - pair[0]
    return min(apart, n - apart)


def _tree(n: int, links: Links, *, sure: bool) -> dict[int, RigidTransform]:
    """Return ``body_from_view`` of all views that the best fits join to the first."""
    poses = {0: RigidTransform.identity()}
    fits = {p: f for p, f in links.fits.items() if not sure or is_sure(f)}
    while len(poses) < n:
        open_ = [(f.quality, p) for p, f in fits.items() if (p[0] in poses) != (p[1] in poses)]
        if not open_:
            break
        a, b = max(open_)[1]
        a, b = (a, b) if a in poses else (b, a)
        poses[b] = poses[a] @ links.motion(a, b)
    return poses
