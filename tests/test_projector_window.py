"""The projector window on a virtual screen, compared with its patterns pixel by pixel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import ImageGrab, features

from fringe3d.errors import DeviceError

pytest.importorskip("glfw")
pytest.importorskip("moderngl")

WAIT_S = 20.0
SHOWN = """
import sys
import numpy as np
from fringe3d.devices.window import WindowProjector, outputs
from fringe3d.patterns import method_plan, pattern_image

x, y, width, height, n_random = (int(a) for a in sys.argv[1:6])
projector = WindowProjector(region=(x, y, width, height))
assert projector.open() == (height, width)
plan = method_plan("m0", (height, width), period_px=16.0, n_shifts=4)
images = [pattern_image(p, (height, width)) for p in plan.patterns]
rng = np.random.default_rng(7)
images += [rng.integers(0, 256, (height, width), dtype=np.uint8) for _ in range(n_random)]
projector.load(images)
print(len(images), flush=True)
for line in sys.stdin:
    if line == "all\\n":
        for number in range(len(images)):
            projector.show(number)
    else:
        projector.show(int(line))
    print("shown", flush=True)
projector.close()
"""


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """Start a virtual screen of 2304 x 1080 px."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb here (Debian packages xvfb, libgl1-mesa-dri)")
    if not features.check_feature("xcb"):
        pytest.skip("this Pillow takes no screenshots")
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "2304x1080x24", "-noreset",
               "-nolisten", "tcp"]  # fmt: skip
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    try:
        if not number:
            pytest.skip("Xvfb does not start here")
        yield f":{number}"
    finally:
        server.terminate()
        server.wait()


def screenshot(display: str, region: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    x, y, width, height = region
    whole = np.asarray(ImageGrab.grab(xdisplay=display).convert("RGB"))
    return whole[y : y + height, x : x + width]


def wanted(width: int, height: int, n_random: int) -> list[NDArray[np.uint8]]:
    """Return the patterns from their formulas: m0 has 2 x (4 + 7 or 8) images and two uniform."""
    rows, cols = np.mgrid[:height, :width]
    images = []
    for place, extent in ((cols, width), (rows, height)):
        for step in range(4):
            phase = 2 * np.pi * (place + 0.5) / 16 - step * np.pi / 2
            images.append(np.round(255 * (0.5 + 0.5 * np.cos(phase))))
        n_bits = int(np.ceil(np.log2(np.ceil(extent / 16)))) + 1
        cell = (place // 8) % 2**n_bits
        images += [255 * (((cell ^ (cell >> 1)) >> bit) & 1) for bit in reversed(range(n_bits))]
    images += [np.full((height, width), 255), np.zeros((height, width))]
    rng = np.random.default_rng(7)
    images += [rng.integers(0, 256, (height, width), dtype=np.uint8) for _ in range(n_random)]
    return [image.astype(np.uint8) for image in images]


@contextmanager
def shown_by_a_window(
    display: str, region: tuple[int, int, int, int], n_random: int
) -> Iterator[subprocess.Popen[str]]:
    """Open the window in a process of its own, to which the numbers of patterns are written."""
    window = subprocess.Popen(
        [sys.executable, "-c", SHOWN, *map(str, region), str(n_random)],
        env=os.environ | {"DISPLAY": display}, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert window.stdin is not None
    assert window.stdout is not None
    try:
        yield window
    finally:
        window.stdin.close()
        window.stdout.close()
        assert window.wait(WAIT_S) == 0


@pytest.mark.parametrize(
    ("region", "n_random"), [((1280, 0, 1024, 768), 3), ((0, 0, 1920, 1080), 1)]
)
def test_every_pattern_is_on_the_screen_pixel_by_pixel(
    display: str, region: tuple[int, int, int, int], n_random: int
) -> None:
    """By screenshots of the virtual screen; a screen of glass may still scale what it gets."""
    images = wanted(*region[2:], n_random)
    with shown_by_a_window(display, region, n_random) as window:
        assert window.stdin is not None
        assert window.stdout is not None
        assert int(window.stdout.readline()) == len(images)
        for number, image in enumerate(images):
            print(number, file=window.stdin, flush=True)
            assert window.stdout.readline() == "shown\n"
            _same_on_screen(display, region, image, number)


def test_no_pattern_is_torn(display: str) -> None:
    """While 100 patterns are shown one after the other, every screenshot holds one of them, whole.

    A virtual screen has no beam: what a real one does between two pictures it cannot show.
    """
    region, n_random = (1280, 0, 1024, 768), 76
    images = wanted(*region[2:], n_random)
    assert len(images) == 100
    with shown_by_a_window(display, region, n_random) as window:
        assert window.stdin is not None
        assert window.stdout is not None
        assert int(window.stdout.readline()) == len(images)
        print(0, "all", "all", sep="\n", file=window.stdin, flush=True)
        assert window.stdout.readline() == "shown\n"
        _same_on_screen(display, region, images[0], 0)
        seen, answers = set(), window.stdout
        ended = threading.Thread(target=lambda: [answers.readline() for _ in range(2)])
        ended.start()
        while ended.is_alive():
            shot = screenshot(display, region)
            candidates = [
                n for n, image in enumerate(images) if (image[384] == shot[384, :, 0]).all()
            ]
            assert any((images[n][..., None] == shot).all() for n in candidates)
            seen.update(candidates[:1])
        ended.join()
    assert len(seen) > 20


def _same_on_screen(
    display: str, region: tuple[int, int, int, int], image: NDArray[np.uint8], number: int
) -> None:
    """Compare all three colours; the server may need a moment to copy the picture."""
    until = time.monotonic() + WAIT_S
    while True:
        shot = screenshot(display, region)
        if np.array_equal(shot, np.repeat(image[..., None], 3, axis=2)):
            return
        if time.monotonic() > until:
            off = int((shot[..., 0] != image).sum())
            pytest.fail(f"image {number}: {off} pixels differ")


def test_without_a_display_server_it_says_so(tmp_path: Path) -> None:
    code = (
        "from fringe3d.devices.window import WindowProjector, outputs\n"
        "assert outputs() == ()\n"
        "WindowProjector('1').open()"
    )
    hidden = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([sys.executable, "-c", code], env=hidden, capture_output=True,
                          text=True, cwd=tmp_path, check=False)  # fmt: skip
    assert DeviceError.__name__ in done.stderr
    assert "expected a display server, found none" in done.stderr
