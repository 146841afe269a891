"""Machine code that was compiled from other sources than those that are here now."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

STAMP = "kernels.sha256"
MARK = b"njit"
CONSTANTS = "model"
"""Folder of the constants that are compiled into code."""


def forget_stale_kernels(package: Path, /) -> None:
    """Delete cached machine code of a package's compiled functions where a source has changed.

    Numba compares the file of a function alone, but its code holds that of functions of other
    files, too: after an update it would go on with theirs as they were.

    Parameters
    ----------
    package : Path; folder of the sources, beside which Numba keeps its code in ``__pycache__``
    """
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        is_private = source.name.startswith("_")  # what helps to compile
        if is_private or source.parent.name == CONSTANTS or MARK in text:
            digest.update(source.name.encode() + text)
    stamp = package / "__pycache__" / STAMP
    with suppress(OSError):  # where nothing can be written Numba keeps its code elsewhere
        if stamp.exists() and stamp.read_text() == digest.hexdigest():
            return
        for kept in package.rglob("__pycache__/*.nb[ci]"):
            kept.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(digest.hexdigest())
