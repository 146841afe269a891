"""Arrays that take long to compute and depend on their inputs alone, kept on disk."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d import __version__

MAX_BYTES = 2_000_000_000
SWITCH = "FRINGE3D_CACHE"
"""Environment variable: a folder, or "off"."""

UNREADABLE = (OSError, ValueError, EOFError, KeyError, TypeError, AttributeError, zlib.error,
              zipfile.BadZipFile)  # fmt: skip
"""What NumPy raises for files that were cut off, spoiled or of another kind."""

Arrays = dict[str, NDArray[Any]]


def key_of(parts: Iterable[str | bytes | NDArray[Any]], /) -> str:
    """Return a name for what follows from these inputs and this version of the package."""
    digest = hashlib.sha256(__version__.encode())
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        data = data if isinstance(data, bytes) else np.ascontiguousarray(data).tobytes()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]


def cached(key: str, make: Callable[[], Arrays], /) -> Arrays:
    """Return arrays from the cache, or make and keep them.

    A cache that cannot be read or written is no error: the arrays are made anew.
    """
    folder = _folder()
    if folder is None:
        return make()
    file = folder / f"{key}.npz"
    with suppress(*UNREADABLE), file.open("rb") as handle, np.load(handle) as stored:
        arrays = {name: stored[name] for name in stored.files}
        os.utime(file)
        return arrays
    arrays = make()
    with suppress(OSError):
        _keep(file, arrays)
    return arrays


def mapped(parts: Iterable[str | bytes | NDArray[Any]], make: Callable[[], Arrays], /) -> Arrays:
    """Return arrays as `cached` does, mapped into memory: read only, and shared by all processes.

    What another run has written halfway is not found, and what was cut off is made anew.
    """
    folder, key = _folder(), key_of(parts)
    if folder is None:
        return make()
    with suppress(*UNREADABLE):
        names = (folder / f"{key}.names").read_text(encoding="utf-8").split()
        return {name: _map(folder / f"{key}-{name}.npy") for name in names}
    arrays = make()
    with suppress(OSError):
        for name, array in arrays.items():
            _write_aside(folder / f"{key}-{name}.npy", partial(np.save, arr=array))
        # The names come last: they tell that all is there.
        _write_aside(folder / f"{key}.names", partial(_save_text, text=" ".join(arrays)))
        _drop_oldest(folder, but=key)
    return arrays


def _map(file: Path) -> NDArray[Any]:
    array: NDArray[Any] = np.load(file, mmap_mode="r")
    os.utime(file)
    return array.view(np.ndarray)


def _save_text(file: str, *, text: str) -> None:
    Path(file).write_text(text, encoding="utf-8")


def _folder() -> Path | None:
    choice = os.environ.get(SWITCH, "")
    if choice == "off":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(choice) if choice else Path(home) / "fringe3d"


def _keep(file: Path, arrays: Arrays) -> None:
    """Write aside, rename, and drop the entries that were used longest ago."""
    _write_aside(file, lambda name: np.savez(name, allow_pickle=False, **arrays))
    _drop_oldest(file.parent, but=file.stem)


def _write_aside(file: Path, write: Callable[[str], object]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".partial-", suffix=file.suffix, dir=file.parent)
    os.close(handle)
    try:
        write(name)
        Path(name).replace(file)
    finally:
        with suppress(OSError):
            Path(name).unlink()


def _drop_oldest(folder: Path, *, but: str) -> None:
    files = [f for f in folder.iterdir() if f.suffix in (".npz", ".npy")]
    entries = sorted(files, key=lambda p: p.stat().st_mtime, reverse=True)
    total = 0
    for entry in entries:
        total += entry.stat().st_size
        if total > MAX_BYTES and not entry.name.startswith(but):
            entry.unlink(missing_ok=True)
