"""Each period of the fringes by itself, for methods that weigh what they say together."""

from __future__ import annotations

from dataclasses import replace

from fringe3d.decode.camera import CameraPhases, DirectionPhases, decode
from fringe3d.model import ImageStack
from fringe3d.model.plan import FringeSet


def decode_apart(
    stack: ImageStack,
    projector_shape: tuple[int, int] | None = None,
    /,
    *,
    min_modulation_dn: float | None = None,
) -> CameraPhases:
    """Decode one camera without comparing its periods.

    `decode` finds orders by the agreement of all periods, and rejects where they disagree. Here the
    finest period is decoded with the code, or as if there were no others, and of these only the
    wrapped phases are given.

    Parameters
    ----------
    stack, projector_shape, min_modulation_dn : see `decode`

    Returns
    -------
    CameraPhases; `wrapped` of each direction holds all periods, the finest first
    """
    if stack.plan.gray_sets:
        return decode(stack, projector_shape, min_modulation_dn=min_modulation_dn)
    directions = []
    for angle in stack.plan.angles:
        sets = [f for f in stack.plan.fringe_sets if f.angle == angle]
        finest, *others = (
            _direction(stack, fringe_set, projector_shape, min_modulation_dn)
            for fringe_set in sorted(sets, key=lambda f: f.period_px)
        )
        wrapped = (*finest.wrapped, *(w for other in others for w in other.wrapped))
        directions.append(replace(finest, wrapped=wrapped))
    return CameraPhases(stack.device_name, tuple(directions))


def _direction(
    stack: ImageStack,
    fringe_set: FringeSet,
    projector_shape: tuple[int, int] | None,
    min_modulation_dn: float | None,
) -> DirectionPhases:
    alone = stack.subset(list(fringe_set.indices))
    return decode(alone, projector_shape, min_modulation_dn=min_modulation_dn).directions[0]
