"""Work for several processes."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

In = TypeVar("In")
Out = TypeVar("Out")


def mapped(
    function: Callable[[In], Out], items: Sequence[In], /, *, jobs: int, what: str
) -> list[Out]:
    """Return what a function makes of each item; say on stderr which are done."""
    began = time.monotonic()

    def tell(done: int, item: In) -> None:
        seconds = time.monotonic() - began
        text = f"{what} {done}/{len(items)} {item} ({seconds:.0f} s)"
        print(text, file=sys.stderr, flush=True)

    if jobs <= 1 or len(items) <= 1:
        results = []
        for number, item in enumerate(items):
            results.append(function(item))
            tell(number + 1, item)
        return results
    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // jobs)))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")  # threads of the kernels do not survive a fork
    with ProcessPoolExecutor(min(jobs, len(items)), mp_context=context) as executor:
        futures = {executor.submit(function, item): item for item in items}
        try:
            for number, future in enumerate(as_completed(futures)):
                future.result()
                tell(number + 1, futures[future])
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]
