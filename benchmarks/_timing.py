"""What the benchmarks share: times of many runs, memory, the floor, and the machine."""

import platform
import statistics
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numba import njit
from numpy.typing import NDArray

MIN_RUNS = 5


@dataclass(frozen=True)
class Times:
    """Times of many runs, ms. On a busy machine the least one counts."""

    least: float
    median: float


def times(
    tasks: Sequence[Callable[[], object]],
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Times]:
    """Run tasks in turns for this long after a first run of each; return the times of each.

    On a busy machine `time.thread_time` as clock tells what one thread computes.
    """
    for task in tasks:
        task()
    found: list[list[float]] = [[] for _ in tasks]
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(found[0]) < MIN_RUNS:
        for task, runs in zip(tasks, found, strict=True):
            start = clock()
            task()
            runs.append(1e3 * (clock() - start))
    return [Times(min(runs), statistics.median(runs)) for runs in found]


def peak_bytes(task: Callable[[], object]) -> int:
    """Return the most memory that one run holds beside what there was before."""
    tracemalloc.start()
    task()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


@njit
def _sum(values):
    total = np.uint64(0)
    for value in values:
        total += value
    return total


@njit
def _write(values):
    for i in range(len(values)):
        values[i] = 1.0


def read_once(images: NDArray[np.unsignedinteger]) -> Callable[[], object]:
    """Return the floor: every byte read once by one thread."""
    flat = np.ascontiguousarray(images).reshape(-1).view(np.uint8)
    return lambda: _sum(flat)


def write_once(n_bytes: int) -> Callable[[], object]:
    """Return a task that writes so many bytes of memory in use by one thread."""
    flat = np.ones(n_bytes // 4, np.float32)
    return lambda: _write(flat)


def machine() -> str:
    """Describe the machine in one line."""
    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if line.startswith("model name")
    ]
    return (
        f"{names[0] if names else platform.processor()}, {len(names)} cores, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
    )
