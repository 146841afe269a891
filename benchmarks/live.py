"""How many clouds a second `fringe3d live` gives, how old they are, and what it holds in memory.

python benchmarks/live.py [--methods m2,m5,m6] [--seconds 30]     prints Markdown

File cameras play a simulated scan of 640 x 512 px (machine part on a lit table) round and round,
faster than anyone could measure it; nothing is shown. Clouds count from the third one: the first
waits for the compiler, the second finds the fringe orders anew. "points": of the first cloud and
of the last; "memory": of the process after a tenth of the time, at the end, and its growth for
each minute between, by a straight line (Linux alone).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from _timing import machine

from fringe3d.cli import main as fringe3d
from fringe3d.devices import CameraSettings, SystemClock, replayed
from fringe3d.io.recording import read_scan
from fringe3d.live import Live, SlidingWindow, measuring, running
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement
from fringe3d.session import Session

PRESETS = {"m2": "kolibri", "m5": "kolibri-m5", "m6": "kolibri"}
FRAME_S, RENEWING = 0.02, 0.1
HEADER = (
    "method", "images", "clouds/s", "latency, ms", "dropped", "without a cloud",
    "points", "memory, MB", "growth, MB/min",
)  # fmt: skip


class Watch:
    """What `Live` shows: when, how old, how many points, and the memory then."""

    def __init__(self, loop_begin: float, seconds: float) -> None:
        self.end = loop_begin + seconds
        self.times: list[float] = []
        self.points: list[int] = []
        self.memory: list[float] = []
        self.loop: Live | None = None

    def __call__(self, found: Measurement, *_: object) -> None:
        """Note a cloud; stop the loop when there are enough."""
        assert found.points is not None
        self.times.append(time.monotonic())
        self.points.append(found.points.n_points)
        self.memory.append(_memory_mb())
        if self.times[-1] > self.end and self.loop is not None:
            self.loop.stop()


def line(method: str, folder: Path, seconds: float) -> str:
    """Measure a scan round and round; return a line of the table."""
    scan = read_scan(folder)
    clock, plan = SystemClock(), scan.stacks[0].plan
    cameras, _ = replayed(scan, clock=clock, period_s=FRAME_S)
    for camera in cameras:
        camera.apply(CameraSettings(trigger="free"))
    infos = {camera.name: camera.open() for camera in cameras}
    session = Session(scan.rig, plan, MeasureOptions(method=method))
    steps = measuring(session, clock, uses_previous=method == "m6", renewing=RENEWING)
    session.measure(scan.stacks)  # what is compiled is compiled now
    watch = Watch(time.monotonic(), seconds)
    watch.loop = Live(running(cameras, clock), SlidingWindow(plan, infos), steps, clock)
    figures = watch.loop.run(watch)
    passed = watch.times[-1] - watch.times[1]
    minutes = (np.array(watch.times) - watch.times[0]) / 60
    later = minutes > minutes[-1] / 10
    growth = np.polyfit(minutes[later], np.array(watch.memory)[later], 1)[0]
    cells = (
        method, plan.n_images, f"{(len(watch.times) - 2) / passed:.1f}",
        f"{figures.latency_ms:.0f}", figures.dropped, figures.failed,
        f"{watch.points[0]}, {watch.points[-1]}",
        f"{np.array(watch.memory)[later][0]:.0f}, {watch.memory[-1]:.0f}", f"{growth:+.2f}",
    )  # fmt: skip
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _memory_mb() -> float:
    """Return what the process holds in memory, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Simulate the scans, measure them, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", default="m2,m5,m6")
    parser.add_argument("--seconds", type=float, default=30.0)
    asked = parser.parse_args()
    print(machine(), "\n\n| " + " | ".join(HEADER) + " |\n" + "|---" * len(HEADER) + "|")
    with tempfile.TemporaryDirectory() as made:
        for method in asked.methods.split(","):
            folder = Path(made) / method
            command = f"simulate {PRESETS[method]} --object machine-part --camera-size 640x512"
            command += f" --plan {method} --rays 1 --out {folder}"
            with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
                fringe3d(command.split())
            print(line(method, folder, asked.seconds), flush=True)


if __name__ == "__main__":
    main()
