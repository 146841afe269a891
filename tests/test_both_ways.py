"""C2, asked in its turn: what it is certain of refutes, what it leaves open does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closed_phases import PLANE, grid_of, phase_map, seen_points, small_rig, task_of, visible
from cv_lens import cv_project
from fringe3d.correspond import TwoViews
from fringe3d.correspond.both_ways import agrees_with_c2, swapped
from fringe3d.correspond.choice import Weighed
from fringe3d.correspond.solving import nothing_known

pytestmark = pytest.mark.usefixtures("one_thread")

SLIVER_PX = 5
"""Every so many columns of C2, one is not certain of its order."""


@pytest.mark.parametrize("n_classes", [4, 1])
@pytest.mark.parametrize("strict", [False, True])
def test_only_the_pixel_that_sees_a_lone_candidate_refutes_it(n_classes: int, strict: bool) -> None:
    """C2 is certain of orders that are four off, but for columns of one pixel.

    With four classes each pixel of C1 has one candidate in the volume, without a code several.
    """
    rig = small_rig()
    assert rig.projector is not None
    maps = [phase_map(c, rig.projector, PLANE, n_classes=n_classes, std=0.01) for c in rig.cameras]
    views = TwoViews(
        camera1=rig.cameras[0], camera2=rig.cameras[1], phases1=maps[0], phases2=maps[1]
    )
    task, back = (task_of(rig, v, (1, 1)) for v in (views, swapped(views)))
    chosen, other = (t.decide(nothing_known(t)) for t in (task, back))
    sees = visible(rig, PLANE)
    assert agrees_with_c2(task, chosen, back, other, strict=False)[sees[task.valid]].mean() > 0.85
    open_ = back.pixels[:, 0] % SLIVER_PX == 2
    wrong = replace(
        other,
        table=Weighed(
            replace(back.listed, orders=back.listed.orders + np.int32(4)),
            np.zeros(back.listed.orders.shape, np.float32),
        ),
        probability=np.where(open_, 0.6, 1.0),
    )
    agrees = np.zeros(task.valid.shape, bool)
    agrees[task.valid] = agrees_with_c2(task, chosen, back, wrong, strict=strict)
    points, _, _ = seen_points(rig.cameras[0], grid_of(rig.cameras[0]), PLANE)
    column = cv_project(rig.cameras[1], points)[..., 0]
    from_sliver = np.abs(column % SLIVER_PX - 2)
    assert (sees & (from_sliver < 0.4)).sum() > 1000
    found = agrees[sees & (from_sliver < 0.4)]
    assert found.all() if n_classes == 4 and not strict else not found.any()
    assert not agrees[sees & (from_sliver > 0.6)].any()
