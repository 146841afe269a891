"""Pattern images, their plan and a contact sheet."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from fringe3d.errors import PlanError
from fringe3d.io.atomic import new_folder
from fringe3d.io.images import write_png
from fringe3d.io.scanfile import plan_text
from fringe3d.model import Fringe, GrayBit, Pattern, PatternPlan, Response, Uniform
from fringe3d.patterns import pattern_image

SHEET_COLUMNS = 6
THUMBNAIL_STEP_PX = 512
FRAME = "0.6"


def write_patterns(
    out: Path,
    plan: PatternPlan,
    /,
    *,
    bit_depth: int = 8,
    response: Response | None = None,
    overwrite: bool = False,
) -> None:
    """Write the images to project, ``plan.toml`` and the contact sheet ``overview.png``."""
    shape = plan.projector_shape
    if shape is None:
        raise PlanError("plan: expected the size of the projector, found none")
    with new_folder(out, overwrite=overwrite) as folder:
        for index, pattern in enumerate(plan.patterns):
            image = pattern_image(pattern, shape, bit_depth=bit_depth, response=response)
            write_png(folder / f"{index:03d}.png", image)
        (folder / "plan.toml").write_text(plan_text(plan), encoding="utf-8")
        _contact_sheet(folder / "overview.png", plan, shape)


def _contact_sheet(path: Path, plan: PatternPlan, shape: tuple[int, int]) -> None:
    n_rows = -(-plan.n_images // SHEET_COLUMNS)
    n_cols = min(SHEET_COLUMNS, plan.n_images)
    figure = Figure(figsize=(2.4 * n_cols, 2.2 * n_rows + 0.5), dpi=100, layout="constrained")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    step = max(1, max(shape) // THUMBNAIL_STEP_PX)
    for axis in axes[plan.n_images :]:
        axis.set_visible(False)
    for index, (axis, pattern) in enumerate(zip(axes, plan.patterns, strict=False)):
        axis.imshow(pattern_image(pattern, shape)[::step, ::step], cmap="gray", vmin=0, vmax=255)
        axis.set(xticks=[], yticks=[])
        # A light image is white on white without a frame.
        axis.spines[:].set(linewidth=0.5, color=FRAME)
        axis.set_title(f"{index:03d}  {_label(pattern)}", fontsize=7.5)
    figure.suptitle(f"{plan.n_images} images, {shape[1]} x {shape[0]} px", fontsize=10)
    figure.savefig(path)


def _label(pattern: Pattern) -> str:
    match pattern:
        case Fringe():
            return f"{pattern.period_px:g} px, shift {pattern.shift / 3.141592653589793:+.2f} pi"
        case GrayBit():
            return f"Gray bit {pattern.bit}{' inverse' if pattern.inverted else ''}"
        case Uniform(level=level):
            return {0.0: "dark", 1.0: "light"}.get(level, f"grey {level:.3g}")
        case _:
            return "unused"
