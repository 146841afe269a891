"""Checks of the image files themselves."""

from __future__ import annotations

from collections.abc import Sequence

from fringe3d.health.finding import Finding
from fringe3d.model import ImageStack


def check_files(stacks: Sequence[ImageStack], /) -> list[Finding]:
    """Warn of images that were compressed with loss: their noise cannot be estimated."""
    lossy = [s.device_name for s in stacks if s.is_lossy and s.noise is None]
    if not lossy:
        return []
    text = (
        f"the images of {', '.join(repr(name) for name in lossy)} are JPEG: compression hides the "
        "noise of the pixels, so that sigma comes out too small (2 to 5 times, with few steps). "
        "Record PNG or TIFF, or give the camera's noise in the scan file ([noise])"
    )
    return [Finding("warning", "lossy_cameras", float(len(lossy)), text)]
