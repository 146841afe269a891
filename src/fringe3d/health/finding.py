"""The result of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check, in words, with its figure.

    Parameters
    ----------
    level : "ok", "warning" or "error"
    name : str; key of the figure, with its unit
    value : float
    text : str; what was found and what to do
    """

    level: Level
    name: str
    value: float
    text: str
