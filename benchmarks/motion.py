"""How much of the phase error of moving objects is left, for four and eight images.

A ball before a plane, in closed form, moves towards the rig. Run it from the project's folder:

    python benchmarks/motion.py
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import numpy as np

import closed_form
from moving_scene import MATT, Errors, drifting

DRIFTS = (0.05, 0.10, 0.15, 0.20)


def main() -> None:
    """Print a line for each surface, number of images and motion."""
    print("| surface | images | drift, periods for each image | error, mrad | with --motion, mrad "
          "| less by |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    textured = closed_form._albedo
    for name in ("plain", "textured"):
        if name == "plain":
            closed_form._albedo = lambda points: np.full(points.shape[:-1], MATT)
        else:
            closed_form._albedo = textured
        for n_images in (4, 8):
            for drift in [0.0, *DRIFTS, *(-d for d in DRIFTS)]:
                print(row(name, n_images, drift, drifting(n_images, drift)), flush=True)


def row(name: str, n_images: int, drift: float, errors: Errors) -> str:
    """Return a line of the table."""
    less = errors.moving / errors.stilled
    return (
        f"| {name} | {n_images} | {drift:+.2f} | {1000 * errors.moving:.0f} | "
        f"{1000 * errors.stilled:.0f} | {less:.1f} |"
    )


if __name__ == "__main__":
    main()
