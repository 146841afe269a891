"""A headless browser with WebGL by software, where there is one."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

FLAGS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader",
    "--disable-gpu-watchdog",  # on a busy machine it takes a slow frame for a dead process
)  # fmt: skip
OTHERS_REMARKS = ("GPU stall due to ReadPixels", "THREE.Clock: This module has been deprecated")
"""What the software renderer says of being read, and three.js of viser: no faults of the page."""


@contextmanager
def browser() -> Iterator[Any]:
    """Yield a Chromium, or skip the test."""
    sync_api = pytest.importorskip("playwright.sync_api")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("no chromium; on Debian: apt-get install chromium")
    with sync_api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=path, args=list(FLAGS))
        yield chromium
        chromium.close()


def watched_page(chromium: Any) -> tuple[Any, list[str]]:
    """Return a page, and the list to which all that it complains of is added."""
    page = chromium.new_page(viewport={"width": 900, "height": 700})
    said: list[str] = []

    def note(message: Any) -> None:
        if message.type in ("error", "warning") and not any(
            remark in message.text for remark in OTHERS_REMARKS
        ):
            said.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("requestfailed", lambda request: said.append(request.url))
    return page, said


def pixels_of(element: Any) -> NDArray[np.uint8]:
    """Return what an element shows, (row, col, rgb)."""
    with Image.open(io.BytesIO(element.screenshot())) as image:
        return np.asarray(image.convert("RGB"))
