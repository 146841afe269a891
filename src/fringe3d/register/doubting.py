"""Whether views that the shape of the body placed may lie at a wrong place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from fringe3d.errors import RegistrationError
from fringe3d.model import Registration, RigidTransform, SurfaceView
from fringe3d.register.agreement import Probes

MOST_NAMED = 6


def conflicts(
    views: Sequence[SurfaceView], poses: Sequence[RigidTransform], /
) -> list[tuple[int, int, float]]:
    """Return pairs of views that contradict each other: one looks through what the other sees.

    Parameters
    ----------
    views : sequence of SurfaceView
    poses : sequence of RigidTransform; ``body_from_view``

    Returns
    -------
    list of (int, int, float)
        Two views, and which part of what can be compared contradicts; the worst first.
    """
    probes = Probes(views)
    found = []
    for a, b in itertools.combinations(range(len(views)), 2):
        agreement = probes.pair(a, b, poses[a].inverse() @ poses[b])
        if not agreement.is_possible:
            found.append((a, b, agreement.conflict))
    return sorted(found, key=lambda pair: -pair[2])


def refuse_conflicts(views: Sequence[SurfaceView], found: Registration, /) -> None:
    """Refuse a registration whose views contradict each other.

    Raises
    ------
    RegistrationError
        It names the views that contradict most others.
    """
    pairs = conflicts(views, found.body_from_view)
    if not pairs:
        return
    counts = np.zeros(len(views))
    for a, b, part in pairs:
        counts[[a, b]] += part
    worst = [views[k].name for k in np.argsort(-counts)[:MOST_NAMED] if counts[k] > 0]
    a, b, part = pairs[0]
    raise RegistrationError(
        f"merge: expected views that agree, found {len(pairs)} pairs of which one looks through "
        f"what the other sees ({views[a].name} and {views[b].name}: {part:.0%} of it). Most "
        f"contradict: {', '.join(worst)}. They lie at a wrong place, or the body moved, or they "
        "hold many false points. Tell the angles of the table, if only roughly (--turns, --angles "
        "rough), leave these views out, or look at it all the same with --despite-conflicts"
    )
