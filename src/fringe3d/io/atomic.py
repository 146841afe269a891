"""Output that is there completely or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fringe3d.errors import OutputError

RESULT_MARKS = ("overview.png", "result/overview.png", "design.json")
"""Files by which a folder is known as one that may be replaced."""


def require_writable(
    target: Path, /, *, overwrite: bool = False, inputs: Iterable[Path | None] = ()
) -> None:
    """Raise OutputError unless `target` can be made; call it before the work starts.

    With `overwrite`, a file, an empty folder or an earlier result may be replaced, but neither
    another folder nor one that holds an input.
    """
    _require_kept(target, inputs)
    if target.exists() and not overwrite:
        raise OutputError(
            f"{target}: expected a path that does not exist yet, found an existing "
            f"{'folder' if target.is_dir() else 'file'}. Choose another, or add --overwrite"
        )
    if target.is_dir() and not _is_result(target):
        raise OutputError(
            f"{target}: expected an earlier result to replace (it would hold an overview.png), "
            "found another folder. Choose another path, or remove it yourself"
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


def _require_kept(target: Path, inputs: Iterable[Path | None]) -> None:
    place = target.resolve()
    for path in inputs:
        if path is not None and place in (path.resolve(), *path.resolve().parents):
            raise OutputError(
                f"{target}: expected a path apart from the input, found that it holds {path}. "
                "Choose another path"
            )


def _is_result(folder: Path) -> bool:
    is_empty = next(folder.iterdir(), None) is None
    return is_empty or any((folder / mark).is_file() for mark in RESULT_MARKS)


@contextmanager
def new_folder(target: Path, /, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that becomes `target` when the block ends without an error.

    With `overwrite`, an existing `target` is replaced as a whole, and only then.
    """
    require_writable(target, overwrite=overwrite)
    if target.is_file():
        raise OutputError(
            f"{target}: expected a folder or a new path, found a file. Choose another path"
        )
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
    try:
        target.rename(old / target.name)
        aside.rename(target)
    except BaseException:
        if not target.exists():
            (old / target.name).rename(target)
        old.rmdir()
        raise
    shutil.rmtree(old, ignore_errors=True)


def write_text(target: Path, text: str, /, *, overwrite: bool = False) -> None:
    """Write a text file aside, then rename it."""
    with new_file(target, overwrite=overwrite) as aside:
        aside.write_text(text, encoding="utf-8")


@contextmanager
def new_file(target: Path, /, *, overwrite: bool = False) -> Iterator[Path]:
    """Give the path of a file to write aside, which then gets the name `target`.

    Raises
    ------
    OutputError
        If the file exists and must not be replaced, or cannot be written.
    """
    require_writable(target, overwrite=overwrite)
    aside = target.with_name(f".{target.name}.partial")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        aside.replace(target)
    except OSError as problem:
        raise OutputError(f"{target}: cannot be written: {problem}") from problem
    finally:
        with suppress(OSError):
            aside.unlink()
