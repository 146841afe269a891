"""Make the screenshot of the view: python docs/screenshot.py RESULT docs/images/view.png.

Needs the extra view, playwright and chromium.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from browser import browser
from fringe3d.io.stored import read_result
from fringe3d.view.live import LiveView

SIZE = {"width": 1400, "height": 1150}
PIXEL = (294, 201)
COLOURS = 160


def main(result: Path, target: Path) -> None:
    """Show the result and one of its pixels, and keep what the browser shows."""
    live = LiveView(read_result(result), host="127.0.0.1", port=8780)
    with browser() as chromium:
        page = chromium.new_page(viewport=SIZE)
        page.goto(live.address)
        page.wait_for_selector("canvas")
        page.wait_for_timeout(4000)
        live.show_pixel(*PIXEL)
        page.get_by_text("Software WebGL").locator("xpath=../..").get_by_role("button").click()
        page.wait_for_timeout(2000)
        shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        shot.quantize(COLOURS).save(target, optimize=True)
    live.server.stop()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
