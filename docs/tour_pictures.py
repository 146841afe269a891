"""Draw the pictures of docs/tour.md: python docs/tour_pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from fringe3d import plot
from fringe3d.pipeline import measure
from fringe3d.simulate import simulate

OUT = Path(__file__).parent / "images" / "tour"
COLOURS = 128
PIXEL = (254, 178)


def main() -> None:
    """Record and measure one scan, and draw each stage of it."""
    scan, truth = simulate("kolibri", "machine-part", "m2", size=(640, 512), seed=7)
    result = measure(scan)
    assert scan.rig is not None
    assert result.points is not None
    pictures = {
        "rig": plot.rig(scan.rig),
        "patterns": plot.patterns(scan.stacks[0].plan),
        "images": plot.images(scan.stacks[0]),
        "phase": plot.phase(result.main),
        "pixel": plot.pixel(scan, result, *PIXEL),
        "depth": plot.depth(result),
        "sigma": plot.sigma(result),
        "rejected": plot.rejected(result),
    }
    OUT.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        path = OUT / f"{name}.png"
        picture.save(path, overwrite=True)
        small = Image.open(path).convert("RGB").quantize(COLOURS)
        small.save(path, optimize=True)
    good = result.points.is_valid
    error = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)[good]
    low, high = np.percentile(1000 * result.points.sigma_mm[good], [50, 95])
    print(f"{good.sum():,} points; sigma {low:.1f} um, 95 % below {high:.1f} um")  # noqa: T201
    print(f"from the truth {1000 * np.median(error):.1f} um (median)")  # noqa: T201
    for finding in result.findings:
        print(f"{finding.level}: {finding.text}")  # noqa: T201


if __name__ == "__main__":
    main()
