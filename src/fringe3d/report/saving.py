"""Pictures to files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from fringe3d.io.atomic import new_file


def save_figure(path: Path, figure: Figure, /, *, overwrite: bool) -> None:
    """Write a picture, completely or not at all."""
    with new_file(path, overwrite=overwrite) as aside:
        figure.savefig(aside, format="png")
