"""Pictures to files."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from matplotlib.figure import Figure

from fringe3d.errors import OutputError
from fringe3d.io.atomic import require_writable


def save_figure(path: Path, figure: Figure, /, *, overwrite: bool) -> None:
    """Write a picture, completely or not at all."""
    require_writable(path, overwrite=overwrite)
    aside = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(aside, format="png")
        aside.replace(path)
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem}") from problem
    finally:
        with suppress(OSError):
            aside.unlink()
