"""Pages as PDF, printed by a browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from fringe3d.errors import MethodError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome",
            "msedge", "microsoft-edge")  # fmt: skip
PATIENCE_S = 180
DRAWING_MS = 6000
"""Of the page's own time, for the 3D view to be drawn."""

FLAGS = (
    "--headless", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader",
    "--no-pdf-header-footer", f"--virtual-time-budget={DRAWING_MS}",
)  # fmt: skip


def pdf_of(html: str, /) -> bytes:
    """Print a page that needs no network.

    Raises
    ------
    MethodError
        If there is no browser that can, or it fails.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise MethodError(
            "--pdf: expected a browser that prints (Chromium, Chrome or Edge), found none. Install "
            "one, or write the page without --pdf and print it from any browser"
        )
    with tempfile.TemporaryDirectory() as place:
        source, target = Path(place) / "page.html", Path(place) / "page.pdf"
        source.write_text(html, encoding="utf-8")
        as_root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        command = [browser, *FLAGS, *as_root, f"--user-data-dir={place}/profile",
                   f"--print-to-pdf={target}", source.as_uri()]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False)
        except subprocess.TimeoutExpired:
            raise MethodError(
                f"--pdf: expected {browser} to print within {PATIENCE_S} s, it did not. Write the "
                "page without --pdf and print it from any browser"
            ) from None
        if not target.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise MethodError(
                f"--pdf: expected {browser} to print, it failed ({' '.join(said)}). Write the page "
                "without --pdf and print it from any browser"
            )
        return target.read_bytes()
