"""Arrays that take long to compute and depend on their inputs alone, kept on disk."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
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


def _folder() -> Path | None:
    choice = os.environ.get(SWITCH, "")
    if choice == "off":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(choice) if choice else Path(home) / "fringe3d"


def _keep(file: Path, arrays: Arrays) -> None:
    """Write aside, rename, and drop the entries that were used longest ago."""
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".partial-", suffix=".npz", dir=file.parent)
    os.close(handle)
    try:
        np.savez(name, allow_pickle=False, **arrays)
        Path(name).replace(file)
    finally:
        with suppress(OSError):
            Path(name).unlink()
    entries = sorted(file.parent.glob("*.npz"), key=lambda p: p.stat().st_mtime, reverse=True)
    total = 0
    for entry in entries:
        total += entry.stat().st_size
        if total > MAX_BYTES and entry != file:
            entry.unlink(missing_ok=True)
