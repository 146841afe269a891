"""How long a whole measurement takes beside the floor, and what comes out against the truth.

python benchmarks/measure.py [--sizes 640x512,1280x1024] [--methods "M1;M2"]     prints Markdown

From images in memory to organised points with their standard deviations, two cameras. The floor is
reading the same images once with one thread, in the same run. The scene is simulated (an object on
a lit table, rig `kolibri`, for M5 `kolibri-m5`) with a calibration that is wrong by 0.2 px; for
"M6, stored bias" the bias is what M6 learnt from the same images; "followed": the fringe orders go
on from the frame before, which shows the same. "found" and "wrong" are parts of
the object's pixels that are lit and seen by both cameras. With --busy the processor's time counts:
other programs then disturb less; that of two threads is the sum of both. "memory" is what one
measurement takes at most beside its images and beside "kept": tables of the rig that later
measurements use again. --plot FILE draws how the times grow with the pixels.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import matplotlib.pyplot as plt
import numba
import numpy as np
from _timing import Times, machine, peak_bytes, read_once, times
from orders.scenes import Recording, Scene, recorded

from fringe3d.correspond import curves
from fringe3d.model import Rig, Scan
from fringe3d.options import MeasureOptions, keep_images
from fringe3d.pipeline import Measurement, measure
from fringe3d.session import Session
from fringe3d.simulate.perturb import perturbed

PRESET, M5_PRESET = "kolibri", "kolibri-m5"
CALIBRATION_PX, SEED = 0.2, 3

NO_CODE = MeasureOptions(gray_bits=0, light_dark=False)
METHODS = {
    "M1": MeasureOptions(method="m1"),
    "M2": MeasureOptions(method="m2", gray_bits=3, light_dark=False),
    "M5": replace(NO_CODE, method="m5"),
    "M6, stored bias": replace(NO_CODE, method="m6"),
    "M6": replace(NO_CODE, method="m6"),
    "M2, followed": MeasureOptions(method="m2", gray_bits=3, light_dark=False),
    "M5, followed": replace(NO_CODE, method="m5"),
    "M6, followed": replace(NO_CODE, method="m6"),
}


@dataclass(frozen=True)
class Task:
    """A measurement to be timed, and the scene's truth."""

    recording: Recording
    scan: Scan
    options: MeasureOptions
    before: Measurement | None = None

    def run(self) -> Measurement:
        """Measure once, or follow the frame before."""
        if self.before is None:
            return measure(self.scan, self.options)
        session = Session(self.scan.rig, self.scan.stacks[0].plan, self.options, keep=False)
        return session.follow(self.scan.stacks, self.before)

    def truth(self, found: Measurement) -> tuple[float, float]:
        """Return which parts of the reference have a right and a wrong point."""
        assert found.points is not None
        reference = self.recording.reference
        right = reference.is_right(found.points)
        there = found.points.is_valid & reference.seen
        n = reference.seen.sum()
        return float((there & right).sum() / n), float((there & ~right).sum() / n)


def task_of(method: str, recording: Recording) -> Task:
    """Return a measurement of the images that the method needs; others are not in memory."""
    rig: Rig = perturbed(recording.rig, rms_px=CALIBRATION_PX, seed=SEED, angle=recording.angle)
    options = METHODS[method]
    stacks = tuple(keep_images(stack, options) for stack in recording.scan.stacks)
    stacks = tuple(replace(s, images=np.ascontiguousarray(s.images)) for s in stacks)
    scan = replace(recording.scan, rig=rig, stacks=stacks)
    if method == "M6, stored bias":
        learnt = measure(scan, options).bias
        scan = replace(scan, rig=replace(rig, bias=learnt))
    before = measure(scan, options) if method.endswith("followed") else None
    return Task(recording, scan, options, before)


HEADER = (
    "size", "method", "images", "threads", "floor, ms", "measure, ms", "Mpx/s", "measure / floor",
    "one thread / this", "memory, MB", "memory / images", "kept, MB", "found", "wrong",
    "stages, ms",
)  # fmt: skip


def lines(
    size: tuple[int, int], thing: str, methods: Sequence[str], seconds: float, busy: bool
) -> Iterator[str]:
    """Yield the lines of the table for one size."""
    clock: Callable[[], float] = time.process_time if busy else time.perf_counter
    recordings: dict[str, Recording] = {}
    for method in methods:
        preset = M5_PRESET if method.startswith("M5") else PRESET
        if preset not in recordings:
            recordings[preset] = recorded(Scene(preset, thing, size=size))
        curves._STORE.kept.clear()
        task = task_of(method, recordings[preset])
        images = [stack.images for stack in task.scan.stacks]
        n_bytes = sum(i.nbytes for i in images)
        found = task.run()
        memory, alone = peak_bytes(task.run), None
        floors = [read_once(i) for i in images]
        for n_threads in (1, 2):
            numba.set_num_threads(n_threads)
            floor, whole = times([partial(_each, floors), task.run], seconds, clock)
            alone = alone or whole.least
            right, wrong = task.truth(found)
            stages = ", ".join(f"{k} {1e3 * v:.0f}" for k, v in task.run().seconds.items())
            n_threads_cells = [
                f"{size[0]}x{size[1]}", method, len(images[0]), n_threads, f"{floor.least:.2f}",
                _text(whole), f"{size[0] * size[1] / whole.least / 1e3:.2f}",
                f"{whole.least / floor.least:.0f}", f"{alone / whole.least:.2f}",
                f"{memory / 1e6:.0f}", f"{memory / n_bytes:.1f}", f"{_kept_bytes() / 1e6:.0f}",
                f"{right:.2%}", f"{wrong:.3%}", stages,
            ]  # fmt: skip
            yield "| " + " | ".join(str(cell) for cell in n_threads_cells) + " |"


def _kept_bytes() -> int:
    """Return the size of the tables of all rays that are kept for the rig."""
    kept = curves._STORE.kept.values()
    tables = sum(t.curves.nbytes + t.wide.nbytes + t.inner.nbytes for t in kept)
    rays = sum(t.ends.size // 2 * (3 * 8 + 4 * 4) for t in kept)  # directions and intervals
    return tables + rays


def _text(found: Times) -> str:
    return f"{found.least:.0f} ({found.median:.0f})"


def _each(tasks: Sequence[Callable[[], object]]) -> None:
    for task in tasks:
        task()


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default="640x512,1280x1024", help="also 2048x1536, 4096x3000")
    parser.add_argument("--methods", default=";".join(METHODS), help="separated by ;")
    parser.add_argument("--object", default="machine-part")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each line")
    parser.add_argument("--busy", action="store_true", help="time of the processor")
    parser.add_argument("--plot", help="draw the times over the pixels into this file")
    options = parser.parse_args()
    rows = []
    print(f"{machine()}; times: least (median)\n")
    print("| " + " | ".join(HEADER) + " |")
    print("|" + "---|" * len(HEADER))
    for size in map(_size, options.sizes.split(",")):
        methods = options.methods.split(";")
        for line in lines(size, options.object, methods, options.seconds, options.busy):
            print(line, flush=True)
            rows.append([cell.strip() for cell in line.split("|")[1:-1]])
    if options.plot:
        plot(rows, options.plot)


def plot(rows: Sequence[Sequence[str]], file: str) -> None:
    """Draw how the times of one thread grow with the pixels; dotted: proportional to them."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for method in dict.fromkeys(row[1] for row in rows):
        own = [row for row in rows if row[1] == method and row[3] == "1"]
        pixels = np.array([np.prod(_size(row[0])) for row in own]) / 1e6
        times_ms = np.array([float(row[5].split()[0]) for row in own])
        axes.loglog(pixels, times_ms, "o-", label=f"{method}, {own[0][2]} images")
        axes.loglog(pixels, times_ms[0] * pixels / pixels[0], ":", color="0.6")
    axes.set(xlabel="Mpx of C1", ylabel="ms, one thread", title="A whole measurement")
    axes.legend(frameon=False)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
