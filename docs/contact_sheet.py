"""Draw every object on every preset of the simulator: docs/images/simulator.png."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fringe3d.model import Fringe, PatternPlan
from fringe3d.simulate import OBJECTS, PRESETS, Setup, Surface, prepare, record

OUT = Path(__file__).parent / "images" / "simulator.png"
SIZE = (320, 256)
SURFACE = Surface(texture="mottled", contrast=0.1)


def main() -> None:
    """Render and draw; about two minutes."""
    figure = Figure(figsize=(2.0 * len(OBJECTS), 1.75 * len(PRESETS) + 0.4), dpi=80,
                    layout="constrained")  # fmt: skip
    axes = figure.subplots(len(PRESETS), len(OBJECTS))
    meshes = {name: build() for name, build in OBJECTS.items()}
    for row, (preset_name, build) in enumerate(PRESETS.items()):
        preset = build(SIZE)
        # A fringe that can be seen at this size, four times as wide as that of a measurement.
        plan = PatternPlan(patterns=(Fringe(period_px=4 * preset.period_px, shift=0.0),))
        for col, (object_name, mesh) in enumerate(meshes.items()):
            stage = prepare(preset.rig, preset.scene(mesh, SURFACE), Setup(n_rays=4))
            image = record(stage, plan, seed=0).stacks[0].images[0]
            axis = axes[row, col]
            axis.imshow(np.minimum(1.6 * image, 255), cmap="gray", vmin=0, vmax=255)
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(object_name, fontsize=11)
            if col == 0:
                axis.set_ylabel(preset_name, fontsize=11)
    figure.savefig(OUT)


if __name__ == "__main__":
    main()
