"""A recording: the stacks of all cameras, and the rig if it is known."""

from __future__ import annotations

from dataclasses import dataclass

from fringe3d.model.rig import Rig
from fringe3d.model.stack import ImageStack


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scan:
    """Everything that one measurement starts from.

    Parameters
    ----------
    stacks : tuple of ImageStack, one for each camera; the first is C1
    rig : Rig or None; without a rig there are phases but no points
    title : str
    """

    stacks: tuple[ImageStack, ...]
    rig: Rig | None = None
    title: str = ""
