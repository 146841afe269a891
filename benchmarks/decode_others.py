"""Decoding beside other libraries: the same scene, the same noise, each checked against the truth.

    pip install opencv-contrib-python-headless fringes       in an environment of its own
    python benchmarks/decode_others.py [--sizes 640x512,1280x1024]     prints Markdown

`fringes` decodes four steps to phase, modulation and brightness; `structured_light` of OpenCV three
steps to a wrapped phase (SinusoidalPattern), and a Gray code in both directions, with inverses, to
projector pixels (GrayCodePattern, of two cameras at a time). Time is that of the processor, all
with one thread; fringe3d finds standard deviations and rejected pixels as well.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import cv2
import numba
import numpy as np
from _timing import machine, times
from decode import NOISE_DN, PERIOD_PX, PROJECTOR, Scene, recorded, scene
from fringes import Fringes
from numpy.typing import NDArray

from fringe3d.decode import decode
from fringe3d.model import ImageStack
from fringe3d.patterns import sequence

TWO_PI = 2 * np.pi
SAMPLE = 20_000
"""Pixels that OpenCV is asked for one by one."""


@dataclass(frozen=True)
class Decoder:
    """A way to decode a recording, and what comes out against the truth."""

    name: str
    run: Callable[[], object]
    truth: Callable[[], str]


def four_steps(seen: Scene) -> tuple[str, list[Decoder]]:
    """Return fringe3d and `fringes` on four steps of one period."""
    plan = sequence(PROJECTOR, periods_px=(PERIOD_PX,), n_shifts=4, gray="none")
    stack = recorded(seen, plan)
    other = Fringes(X=PROJECTOR[1], Y=PROJECTOR[0])
    other.axes, other.K, other.N = (1,), 1, 4
    other.v = PROJECTOR[1] / PERIOD_PX
    images = _shifted(seen, 4, start=np.pi)  # its first image is dark where the phase is nought

    def theirs(**options: bool) -> object:
        return other.decode(images, unwrap=False, threads=1, **options)

    return "4 steps", [
        Decoder("fringe3d", lambda: decode(stack), lambda: _ours(stack, seen)),
        Decoder(
            f"fringes {version('fringes')}",
            theirs,
            lambda: _noise(theirs(verbose=True).p[0, ..., 0], seen, at=0.0),  # type: ignore[attr-defined]
        ),
    ]


def three_steps(seen: Scene) -> tuple[str, list[Decoder]]:
    """Return fringe3d and OpenCV on three steps of one period."""
    plan = sequence(PROJECTOR, periods_px=(PERIOD_PX,), n_shifts=3, gray="none")
    stack = recorded(seen, plan)
    settings = cv2.structured_light.SinusoidalPattern.Params()
    settings.methodId, settings.setMarkers = cv2.structured_light.PSP, False
    other = cv2.structured_light.SinusoidalPattern_create(settings)
    images = list(_shifted(seen, 3, start=-TWO_PI / 3)[::-1])  # its fringes move backwards

    def theirs() -> NDArray[np.floating]:
        return np.asarray(other.computePhaseMap(images)[0])

    return "3 steps", [
        Decoder("fringe3d", lambda: decode(stack), lambda: _ours(stack, seen)),
        Decoder(f"OpenCV {cv2.__version__}", theirs, lambda: _noise(theirs(), seen, at=None)),
    ]


def gray_code(seen: Scene) -> tuple[str, list[Decoder]]:
    """Return fringe3d and OpenCV on a full Gray code in both directions, with inverses."""
    plan = sequence(
        PROJECTOR, periods_px=(1.0,), n_shifts=0, angles=(0.0, np.pi / 2), gray="plain",
        inverses=True, light_dark=True,
    )  # fmt: skip
    stack = recorded(seen, plan)
    other = cv2.structured_light.GrayCodePattern_create(PROJECTOR[1], PROJECTOR[0])
    dark = np.full(seen.x.shape, 10, np.uint8)
    light = np.clip(10 + 220 * seen.albedo, 0, 255).astype(np.uint8)
    images = list(_gray_images(seen, other))

    def theirs() -> object:
        both = [images, images]
        return other.decode(both, blackImages=[dark, dark], whiteImages=[light, light])

    return f"{len(stack.images)} of Gray code", [
        Decoder(
            "fringe3d", lambda: decode(stack, whole_cells=True), lambda: _our_cells(stack, seen)
        ),
        Decoder(
            f"OpenCV {cv2.__version__}, a pair of cameras", theirs,
            lambda: _their_cells(other, images, seen),
        ),
    ]  # fmt: skip


def _shifted(seen: Scene, n: int, *, start: float) -> NDArray[np.uint8]:
    """Return images of n steps, each later by a nth of a turn, from a first phase."""
    rng = np.random.default_rng(1)
    phase = TWO_PI * seen.x / PERIOD_PX - start
    steps = TWO_PI * np.arange(n)[:, None, None] / n
    grey = 10 + 220 * seen.albedo * (0.5 + 0.5 * np.cos(phase - steps))
    grey += NOISE_DN * rng.standard_normal(grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _gray_images(seen: Scene, code: Any) -> Iterator[NDArray[np.uint8]]:
    """Yield what the camera sees of OpenCV's own patterns: their first row."""
    rng = np.random.default_rng(1)
    cols = np.clip(np.rint(seen.x), 0, PROJECTOR[1] - 1).astype(int)
    for pattern in code.generate()[1]:
        grey = 10 + 220 * seen.albedo * (pattern[0, cols] / 255.0)
        grey += NOISE_DN * rng.standard_normal(grey.shape)
        yield np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def _noise(phase: NDArray[np.floating], seen: Scene, *, at: float | None) -> str:
    """Say how good a wrapped phase is where the scene is lit; `at`: phase of w = 0, if known."""
    lit = seen.albedo > 0
    turns = (phase / TWO_PI - seen.x / PERIOD_PX)[lit].astype(np.float64)
    if at is None:  # its zero is not documented
        at = float(np.angle(np.exp(1j * TWO_PI * turns).mean()))
    error = TWO_PI * (turns - at / TWO_PI - np.rint(turns - at / TWO_PI))
    return f"{np.isfinite(error).mean():.2%} found, {1e3 * np.nanstd(error):.1f} mrad"


def _ours(stack: ImageStack, seen: Scene) -> str:
    main = decode(stack).directions[0].main
    good = (main.rejection == 0)[seen.albedo > 0].mean()
    lit = Scene(seen.x, np.where(main.rejection == 0, seen.albedo, 0).astype(np.float32))
    return f"{good:.2%} found, " + _noise(main.phase, lit, at=np.pi / PERIOD_PX).split(", ")[1]


def _our_cells(stack: ImageStack, seen: Scene) -> str:
    main = decode(stack, whole_cells=True).directions[0].main
    found = (main.rejection == 0) & (seen.albedo > 0)
    return _cells(main.order_class[found], seen.x[found], (seen.albedo > 0).sum())


def _their_cells(code: Any, images: list[NDArray[np.uint8]], seen: Scene) -> str:
    rows, cols = np.nonzero(seen.albedo > 0)
    chosen = np.random.default_rng(2).choice(len(rows), SAMPLE)
    asked = [
        code.getProjPixel(images, int(c), int(r))
        for r, c in zip(rows[chosen], cols[chosen], strict=True)
    ]
    found = np.array([not is_wrong for is_wrong, _ in asked])
    cells = np.array([pixel[0] for _, pixel in asked])
    return _cells(cells[found], seen.x[rows[chosen], cols[chosen]][found], SAMPLE)


def _cells(cells: NDArray[Any], x: NDArray[np.floating], n: int) -> str:
    """Say how many cells are found, and how many are more than one off."""
    wrong = (np.abs(cells - x) > 1.01).sum()
    return f"{len(cells) / n:.2%} found, {wrong / n:.3%} wrong"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default="640x512,1280x1024")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each line")
    options = parser.parse_args()
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    print(f"{machine()}; processor time, ms: least (median)\n")
    print("| size | images | decoder | time | time / fringe3d | against the truth |")
    print("|---|---|---|---:|---:|---|")
    for size in options.sizes.split(","):
        width, height = (int(part) for part in size.split("x"))
        seen = scene((width, height))
        for name, decoders in (four_steps(seen), three_steps(seen), gray_code(seen)):
            found = times([d.run for d in decoders], options.seconds, time.process_time)
            for decoder, own in zip(decoders, found, strict=True):
                print(
                    f"| {size} | {name} | {decoder.name} | {own.least:.1f} ({own.median:.1f}) | "
                    f"{own.least / found[0].least:.1f} | {decoder.truth()} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
