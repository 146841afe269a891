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

DRIFTS = (0.0, 0.05, 0.10, 0.15, 0.20)


def main() -> None:
    """Print a table for each number of images and direction of the motion."""
    closed_form._albedo = lambda points: np.full(points.shape[:-1], MATT)
    print(
        "| images | drift, periods for each image | error, mrad | with --motion, mrad | less by |"
    )
    print("|---|---|---|---|---|")
    for n_images in (4, 8):
        for sign in (1, -1):
            for drift in DRIFTS:
                if drift == 0 and sign < 0:
                    continue
                errors = drifting(n_images, sign * drift)
                print(row(n_images, sign * drift, errors))


def row(n_images: int, drift: float, errors: Errors) -> str:
    """Return a line of the table."""
    less = errors.moving / errors.stilled
    return (
        f"| {n_images} | {drift:+.2f} | {1000 * errors.moving:.0f} | {1000 * errors.stilled:.0f} | "
        f"{less:.1f} |"
    )


if __name__ == "__main__":
    main()
