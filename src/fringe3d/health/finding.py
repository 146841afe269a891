"""The result of a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from fringe3d.model.html import table

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check, in words, with its figure.

    Parameters
    ----------
    level : "ok", "warning" or "error"
    name : str; key of the figure, with its unit
    value : float; the worst, where there are several figures
    text : str; what was found and what to do
    figures : mapping of str to float; the single figures behind `value`, where there are several
    """

    level: Level
    name: str
    value: float
    text: str
    figures: Mapping[str, float] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [(self.level, self.text)]
        return table(self.name, rows + [(k, f"{v:.4g}") for k, v in self.figures.items()])
