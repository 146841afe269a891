"""Pictures of a simulated scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fringe3d.model import PatternPlan, Uniform
from fringe3d.simulate import Stage, record

WHITE = PatternPlan(patterns=(Uniform(level=1.0),))


def draw_scene(path: Path, stage: Stage, plan: PatternPlan, /, *, title: str) -> None:
    """Draw what each camera sees, with white light and with the first pattern, and the depth."""
    n_cameras = len(stage.rig.cameras)
    # Two single images: nothing is dropped from them, and nothing moves in between.
    recording = replace(
        stage.setup.recording, dropped=(), repeated=(), velocity_mm_s=(0.0, 0.0, 0.0), spin_deg_s=0
    )
    stage = replace(stage, setup=replace(stage.setup, recording=recording))
    figure = Figure(figsize=(12.5, 3.4 * n_cameras + 0.4), dpi=100, layout="constrained")
    axes = figure.subplots(n_cameras, 3, squeeze=False)
    white = record(stage, WHITE, seed=0)
    first = record(stage, plan.subset([0]), seed=0)
    for row, truth in enumerate(stage.truths):
        depth = np.where(truth.is_object, truth.points_mm[..., 2], np.nan)
        name = truth.device_name
        top = stage.setup.camera.top_dn
        axes[row, 0].imshow(white.stacks[row].images[0], cmap="gray", vmin=0, vmax=top)
        axes[row, 0].set_title(f"'{name}', white light", fontsize=10, loc="left")
        axes[row, 1].imshow(first.stacks[row].images[0], cmap="gray", vmin=0, vmax=top)
        axes[row, 1].set_title(f"'{name}', first pattern", fontsize=10, loc="left")
        image = axes[row, 2].imshow(depth, cmap="turbo", interpolation="nearest")
        axes[row, 2].set_title("true height z of the object, mm", fontsize=10, loc="left")
        figure.colorbar(image, ax=axes[row, 2], shrink=0.85, pad=0.01)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    figure.savefig(path)
