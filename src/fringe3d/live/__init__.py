"""Clouds as a stream: record, measure and show in a loop."""

from fringe3d.live.loop import Figures, Frame, Live, Steps, measuring
from fringe3d.live.sources import running, shown
from fringe3d.live.window import Moment, SlidingWindow

__all__ = [
    "Figures", "Frame", "Live", "Moment", "SlidingWindow", "Steps", "measuring", "running", "shown",
]  # fmt: skip
