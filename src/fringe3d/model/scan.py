"""A recording: the stacks of all cameras, and the rig if it is known."""

from __future__ import annotations

from dataclasses import dataclass

from fringe3d.model.html import table
from fringe3d.model.plan import PatternPlan
from fringe3d.model.rig import Rig
from fringe3d.model.stack import ImageStack
from fringe3d.model.table import TablePosition


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scan:
    """Everything that one measurement starts from.

    Parameters
    ----------
    stacks : tuple of ImageStack, one for each camera; the first is C1
    rig : Rig or None; without a rig there are phases but no points
    title : str
    table : TablePosition or None; where the rotary table stood
    """

    stacks: tuple[ImageStack, ...]
    rig: Rig | None = None
    title: str = ""
    table: TablePosition | None = None

    def _repr_html_(self) -> str:
        parts: list[Rig | ImageStack | PatternPlan] = [*self.stacks, self.stacks[0].plan]
        parts += [self.rig] if self.rig else []
        more = "".join(part._repr_html_() for part in parts)
        return table(f"scan {self.title}".strip(), [("cameras", len(self.stacks))], more=more)
