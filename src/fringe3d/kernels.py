"""Machine code of the compiled functions: told of when it is made, forgotten when it is stale, and
run by several threads."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

STAMP = "kernels.sha256"
MARK = b"njit"
CONSTANTS = "model"
"""Folder of the constants that are compiled into code."""

COMPILING = "compiling, once after installation or an update: about a minute"

PARTS, LEAST_ROWS, POINTS = 8, 16, 4096
"""Parts of an image for each thread, which so end nearly together, and rows of the least part, or
points of the least part of a list."""

HELPER: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
"""How functions are compiled that others call and that make no arrays: counting who uses those that
they are given would cost up to three quarters of their time."""

OWN_FOLDER = "NUMBA_CACHE_DIR"
"""Environment variable by which Numba keeps its code elsewhere."""


def forget_stale_kernels(package: Path, /) -> None:
    """Delete cached machine code of a package's compiled functions where a source has changed.

    Numba compares the file of a function alone, but its code holds that of functions of other
    files, too: after an update it would go on with theirs as they were.

    Parameters
    ----------
    package : Path; folder of the sources. Numba keeps its code beside them in ``__pycache__``, or,
        where that cannot be written, in the user's cache, or where NUMBA_CACHE_DIR says
    """
    sources = sorted(package.rglob("*.py"))
    digest = hashlib.sha256()
    for source in sources:
        text = source.read_bytes()
        is_private = source.name.startswith("_")  # what helps to compile
        if is_private or source.parent.name == CONSTANTS or MARK in text:
            digest.update(source.name.encode() + text)
    root = _root_elsewhere(package)
    folders = [_cache_of(folder, root) for folder in dict.fromkeys(s.parent for s in sources)]
    with suppress(OSError):  # where nothing can be written there is no code, either
        stamp = _cache_of(package, root) / STAMP
        if stamp.exists() and stamp.read_text() == digest.hexdigest():
            return
        for folder in folders:
            for kept in _code_in(folder):
                kept.unlink(missing_ok=True)
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.write_text(digest.hexdigest())


def _root_elsewhere(package: Path) -> Path | None:
    """Return the folder under which Numba keeps its code, None for beside the sources."""
    if os.environ.get(OWN_FOLDER):
        return Path(os.environ[OWN_FOLDER])
    if os.access(package, os.W_OK):
        return None
    home = os.environ.get("XDG_CACHE_HOME")
    if sys.platform == "darwin":
        home = str(Path.home() / "Library" / "Caches")
    elif sys.platform == "win32":
        home = os.environ.get("LOCALAPPDATA")
    root = Path(home) if home else Path.home() / ".cache"
    return root / "numba" / "Cache" if sys.platform == "win32" else root / "numba"


def _cache_of(folder: Path, root: Path | None) -> Path:
    """Return where Numba keeps the code of a folder of sources; elsewhere as it names it there."""
    if root is None:
        return folder / "__pycache__"
    name = hashlib.sha1(str(folder).encode(), usedforsecurity=False).hexdigest()
    return root / f"{folder.name}_{name}"


def _code_in(folder: Path) -> Iterator[Path]:
    yield from folder.glob("*.nb[ci]")


def n_threads() -> int:
    """Return how many threads compiled functions, and other libraries, may use."""
    from numba import get_num_threads

    return int(get_num_threads())


@contextmanager
def sharing(n: int, /) -> Iterator[None]:
    """Let the calling thread use no more than its part of the threads, where n do their own work.

    Parts of rows that wait for each other's threads cost more than they win.

    Parameters
    ----------
    n : int; threads of the program that compute at the same time, each within such a block

    Examples
    --------
    >>> before = n_threads()
    >>> with sharing(before):
    ...     n_threads()
    1
    >>> n_threads() == before
    True
    """
    from numba import get_num_threads, set_num_threads

    before = get_num_threads()
    set_num_threads(max(1, before // n))
    try:
        yield
    finally:
        set_num_threads(before)


def over_rows(
    kernel: Callable[..., object], n_rows: int, /, *args: object, least: int = LEAST_ROWS
) -> None:
    """Run a compiled function over all rows, parts of them in threads of their own.

    Threads that compiled code starts itself (``parallel=True``) make it compile five times as long,
    and wait for each other at each end of a loop.

    Parameters
    ----------
    kernel : compiled function that releases the interpreter; takes `args` and, last, (first row,
        last row but one); what it writes to a row depends on no other row
    n_rows : int
    args : of the function
    least : int; rows of the least part, `POINTS` where a row is a single point
    """
    from numba import get_num_threads

    n_threads = get_num_threads()
    step = max(least, -(-n_rows // (PARTS * n_threads)))
    if n_threads == 1 or n_rows <= step:
        kernel(*args, (0, n_rows))
        return
    parts = [(first, min(first + step, n_rows)) for first in range(0, n_rows, step)]
    waiting = iter(parts)
    lock = Lock()

    def work() -> None:
        while True:
            with lock:
                part = next(waiting, None)
            if part is None:
                return
            kernel(*args, part)

    others = [_threads().submit(work) for _ in range(n_threads - 1)]
    work()
    for other in others:
        if not other.cancel():  # it may wait behind others, with nothing left to do
            other.result()


def alongside(function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Callable[[], T]:
    """Begin a call in a thread of its own, and return what waits for its result.

    The call takes one thread; where there is but one it is made at once.

    Parameters
    ----------
    function : callable
    args, kwargs : of the function

    Examples
    --------
    >>> wait = alongside(sum, [1, 2])
    >>> wait()
    3
    """
    from numba import get_num_threads, set_num_threads

    if get_num_threads() == 1:
        found = function(*args, **kwargs)
        return lambda: found

    def alone() -> T:
        set_num_threads(1)
        return function(*args, **kwargs)

    return _threads().submit(alone).result


@cache  # forgotten in a forked process, which has none of them
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="fringe3d")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)


def tell_of_compiling(package: str = "fringe3d", /) -> None:
    """Say on standard error, once, when functions of a package are compiled: it takes a while.

    Nothing is said where Numba finds the code that it has kept.

    Parameters
    ----------
    package : str; its name
    """
    from numba.core import event

    class Teller(event.Listener):
        def on_start(self, started: Any) -> None:
            function = started.data["dispatcher"].py_func
            if package in _LISTENING and str(function.__module__).startswith(f"{package}."):
                _LISTENING.remove(package)
                if sys.stderr is not None:
                    sys.stderr.write(f"{package}: {COMPILING}\n")
                    sys.stderr.flush()

        def on_end(self, ended: Any) -> None:
            pass

    if package not in _KNOWN:
        _KNOWN.add(package)
        _LISTENING.add(package)
        event.register("numba:compile", Teller())  # type: ignore[no-untyped-call]


_KNOWN: set[str] = set()
_LISTENING: set[str] = set()
