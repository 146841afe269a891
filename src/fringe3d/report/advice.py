"""What a user can do better, from the reasons for which pixels were rejected."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import Rejection
from fringe3d.model.rejection import count_by_reason

LEAST_PART = 0.02
"""Of the pixels; fewer are no reason to record again."""

ADVICE = {
    Rejection.SATURATED: "Expose shorter, close the aperture, dim the projector, or spray shiny "
    "places.",
    Rejection.LOW_MODULATION: "If these pixels belong to the object: expose longer, darken the "
    "room, focus the projector, or take coarser fringes. Background is rightly left out.",
    Rejection.INCONSISTENT_CODE: "Check that nothing moved during the recording and that the plan "
    "is in recorded order; expose longer; an over-determined code forgives edges.",
    Rejection.OUTSIDE_PROJECTOR: "Check the projector's size and the first coordinate of the plan, "
    "and that bits are in recorded order.",
    Rejection.OUTSIDE_VIEW: "Move the object to where both cameras see it, or turn the cameras "
    "towards each other.",
    Rejection.NO_MATCH: "Turn the object and measure again: the second camera does not see these "
    "places. If they lie in plain view, check the calibration and the depth range.",
    Rejection.AMBIGUOUS: "Add an image of code, narrow the depth range (--depth MIN:MAX), or store "
    "the calibration's bias (fringe3d calibrate bias); fringe3d design says what the rig needs.",
    Rejection.RAYS_MISS: "Calibrate again, or find the poses from this scan (--self-calibrate).",
    Rejection.BEHIND_DEVICE: "Check the poses in the rig file: which way does each device look?",
    Rejection.OUTSIDE_VOLUME: "If these pixels belong to the object: widen the measuring volume "
    "(--depth MIN:MAX). Table and background are rightly left out.",
    Rejection.UNCERTAIN: "Place the devices at a wider angle.",
    Rejection.ISOLATED: "Stray points are rightly left out; many of them tell of noise: expose "
    "longer or take more phase steps.",
    Rejection.EDGE: "Leave out --drop-edges to keep points next to edges; they are less exact.",
    Rejection.SAME_POINT: "Project fringes besides the code: they resolve the projector's pixels.",
    Rejection.HIDDEN: "Turn the object and measure again: it hides these places from the second "
    "camera or the light.",
    Rejection.OUTLIER: "Single points that stand out are rightly left out. Many of them on a "
    "surface that shines, or in a corner, tell of reflections: matt the surface, or turn it.",
    Rejection.REFLECTION: "Rightly left out. Matt the surface (scanning spray), or turn it so that "
    "no other surface shines on it; many on a matt one tell of a projector that is no longer "
    "calibrated.",
}


class ReasonRow(NamedTuple):
    """One reason: its name in words, the pixels, their part, what it means and what to do."""

    name: str
    n_pixels: int
    part: float
    meaning: str
    advice: str


def reason_rows(rejection: NDArray[np.unsignedinteger[Any]], /) -> list[ReasonRow]:
    """Return the reasons that occur, the most frequent first.

    Examples
    --------
    >>> row, = reason_rows(np.array([[0, 1, 1, 0]], np.uint16))
    >>> row.name, row.n_pixels, row.part
    ('saturated', 2, 0.5)
    """
    rows = [
        ReasonRow(
            name=name.replace("_", " ").lower(),
            n_pixels=count,
            part=count / rejection.size,
            meaning=Rejection[name].meaning,
            advice=ADVICE[Rejection[name]],
        )
        for name, count in count_by_reason(rejection).items()
    ]
    return sorted(rows, key=lambda row: -row.n_pixels)
