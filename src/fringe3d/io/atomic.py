"""Output that is there completely or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fringe3d.errors import OutputError


def require_writable(target: Path, /, *, overwrite: bool = False) -> None:
    """Raise OutputError unless `target` can be made; call it before the work starts."""
    if target.exists() and not overwrite:
        raise OutputError(
            f"{target}: expected a path that does not exist yet, found an existing "
            f"{'folder' if target.is_dir() else 'file'}. Choose another, or add --overwrite"
        )
    parent = target.absolute().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"{target}: expected a writable folder, but {parent} "
            f"{'is not a folder' if not parent.is_dir() else 'is read-only for you'}. "
            "Choose another output path"
        )


@contextmanager
def new_folder(target: Path, /, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that becomes `target` when the block ends without an error.

    With `overwrite`, an existing `target` is replaced as a whole, and only then.
    """
    require_writable(target, overwrite=overwrite)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    except OSError as problem:
        raise OutputError(f"{target}: cannot be written: {problem}") from problem
    try:
        aside.chmod(0o755)
        yield aside
        _replace(aside, target)
    except OSError as problem:
        raise OutputError(f"{target}: cannot be written: {problem}") from problem
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _replace(aside: Path, target: Path) -> None:
    if not target.exists():
        aside.rename(target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old-", dir=target.parent))
    target.rename(old / target.name)
    aside.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def write_text(target: Path, text: str, /, *, overwrite: bool = False) -> None:
    """Write a text file aside, then rename it."""
    require_writable(target, overwrite=overwrite)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = target.with_name(f".{target.name}.partial")
        aside.write_text(text, encoding="utf-8")
        aside.replace(target)
    except OSError as problem:
        raise OutputError(f"{target}: cannot be written: {problem}") from problem
