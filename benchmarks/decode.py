"""How long decoding takes beside the floor and NumPy, and how well it agrees with the truth.

python benchmarks/decode.py [--all] [--seconds 3] [--busy]        prints Markdown

The floor is reading the same bytes once with one thread. "pass" is the compiled pass alone, into
maps that are used again; "decode" is all that a measurement calls: noise, new maps, the pass.
With --busy the processor's time counts, and one thread only: other programs then disturb less.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np
from _timing import Times, machine, peak_bytes, read_once, times, write_once
from numpy.typing import NDArray

from fringe3d.decode import decode
from fringe3d.decode.camera import numbering_of
from fringe3d.decode.fit import fringe_fit
from fringe3d.decode.fused import allocated, fill
from fringe3d.model import ImageStack, PatternPlan
from fringe3d.patterns import intensity, sequence

SIZES = ((640, 512), (1280, 1024), (2048, 1536))
LARGEST = (4096, 3000)
PROJECTOR = (768, 1024)
PERIOD_PX = 16.0
NOISE_DN = 1.0
PLANS = {
    "4 steps + 7 Gray + light/dark": sequence(
        PROJECTOR, periods_px=(PERIOD_PX,), n_shifts=4, light_dark=True
    ),
    "4 steps": sequence(PROJECTOR, periods_px=(PERIOD_PX,), n_shifts=4, gray="none"),
    "16 steps": sequence(PROJECTOR, periods_px=(PERIOD_PX,), n_shifts=16, gray="none"),
}


@dataclass(frozen=True)
class Scene:
    """What a camera sees: projector coordinate x, and brightness from 0 to 1, both (row, col)."""

    x: NDArray[np.float32]
    albedo: NDArray[np.float32]


def scene(size: tuple[int, int]) -> Scene:
    """Return two surfaces, the front one round, before a dark background; with texture."""
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float32) / np.float32(size[0])
    x = 970 * u + 12 * np.sin(9 * v) + 14
    round_part = (u - 0.45) ** 2 + (v - 0.4) ** 2 < 0.2**2
    x = np.where(round_part, 40 + 0.9 * x, x)
    albedo = 0.35 + 0.6 * np.abs(np.sin(23 * v) * np.cos(17 * u))
    albedo[(v < 0.05) | (u > 0.95)] = 0
    return Scene(x, albedo)


def recorded(seen: Scene, plan: PatternPlan) -> ImageStack:
    """Return its 8-bit images, with noise of 1 DN."""
    rng = np.random.default_rng(1)
    images = np.empty((plan.n_images, *seen.x.shape), np.uint8)
    for image, pattern in zip(images, plan.patterns, strict=True):
        light = intensity(pattern, seen.x, np.zeros_like(seen.x)).astype(np.float32)
        grey = 10 + 220 * seen.albedo * light
        grey += NOISE_DN * rng.standard_normal(grey.shape, np.float32)
        image[:] = np.clip(np.rint(grey), 0, 255)
    return ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=255)


def accuracy(stack: ImageStack, seen: Scene) -> str:
    """Say how many lit pixels have a phase, how many a wrong one, and how good it is."""
    main = decode(stack).directions[0].main
    lit, good = seen.albedo > 0, main.rejection == 0
    turns = main.phase / (2 * np.pi) - (seen.x.astype(np.float64) + 0.5) / PERIOD_PX
    if main.is_absolute:
        turns += main.order_class
    else:
        turns -= np.rint(turns)
    right = np.abs(turns) < 0.25
    error = 2 * np.pi * turns[lit & good & right]
    pull = error / main.phase_std[lit & good & right]
    return (
        f"{(good & lit).sum() / lit.sum():.2%} found, {(good & lit & ~right).sum() / lit.sum():.3%}"
        f" wrong, {1e3 * error.std():.1f} mrad, pull {pull.std():.2f}"
    )


def one_pass(stack: ImageStack) -> tuple[Callable[[], object], int]:
    """Return the compiled pass as a task, and the number of bytes that it writes."""
    (angle,) = stack.plan.angles
    found = numbering_of(stack, angle, (0.0, float(PROJECTOR[1])))
    assert found is not None
    fringe_set, numbering = found
    fit = fringe_fit(stack, fringe_set, None)
    maps = allocated(stack.shape, numbering)
    n_bytes = sum(array.nbytes for array in maps)
    return (lambda: fill(maps, stack, fringe_set, fit, numbering)), n_bytes


@dataclass(frozen=True)
class Line:
    """One line of the table."""

    name: str
    n_threads: int
    floor: Times
    write: Times
    one_pass: Times
    whole: Times
    plain: Times
    gain: float
    memory: float
    truth: str

    def text(self, size: tuple[int, int]) -> str:
        """Return it as Markdown."""
        cells = [
            f"{size[0]}x{size[1]}",
            self.name,
            self.n_threads,
            f"{self.floor.least:.2f}",
            f"{self.write.least:.2f}",
            f"{self.one_pass.least:.2f} ({self.one_pass.median:.2f})",
            f"{self.one_pass.least / self.floor.least:.1f}",
            f"{self.gain:.2f}",
            f"{self.whole.least:.1f} ({self.whole.median:.1f})",
            f"{self.whole.least / self.floor.least:.1f}",
            f"{self.plain.least:.0f} ({self.plain.median:.0f})",
            f"{self.plain.least / self.whole.least:.1f}",
            f"{self.memory:.1f}",
            self.truth,
        ]
        return "| " + " | ".join(str(cell) for cell in cells) + " |"


HEADER = (
    "size", "images", "threads", "floor", "write the maps", "pass", "pass / floor",
    "one thread / this", "decode", "decode / floor", "NumPy", "NumPy / decode",
    "memory / images", "against the truth",
)  # fmt: skip


def lines(size: tuple[int, int], seconds: float, busy: bool) -> Iterator[Line]:
    """Yield the lines of the table for one size."""
    seen = scene(size)
    clock = time.thread_time if busy else time.perf_counter
    for name, plan in PLANS.items():
        stack = recorded(seen, plan)
        task, n_written = one_pass(stack)
        whole = partial(decode, stack)
        tasks = [read_once(stack.images), write_once(n_written), task, whole]
        (plain,) = times([partial(decode, stack, plain=True)], seconds / 2, clock)
        memory = peak_bytes(whole) / stack.images.nbytes
        truth = accuracy(stack, seen)
        alone = None
        for n_threads in (1,) if busy else (1, 2):
            numba.set_num_threads(n_threads)
            found = times(tasks, seconds, clock)
            alone = alone or found[2].least
            gain = alone / found[2].least
            yield Line(name, n_threads, *found, plain, gain, memory, truth)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--all", action="store_true", help="also 4096x3000")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each line")
    parser.add_argument("--busy", action="store_true", help="time of one thread's processor")
    options = parser.parse_args()
    print(f"{machine()}; ms: least (median)\n")
    print("| " + " | ".join(HEADER) + " |")
    print("|" + "---|" * len(HEADER))
    for size in (*SIZES, LARGEST) if options.all else SIZES:
        for line in lines(size, options.seconds, options.busy):
            print(line.text(size), flush=True)


if __name__ == "__main__":
    main()
