"""One picture that shows a measurement at a glance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fringe3d.health import axis_name, period_disagreement
from fringe3d.model import PhaseMap
from fringe3d.pipeline import Measurement
from fringe3d.report.maps import Drawer, colour_map, reasons, relief, window_of, wrapped_phase


def write_overview(path: Path, result: Measurement, /, *, title: str) -> None:
    """Write the overview of a measurement as PNG; see `overview`."""
    overview(result, title=title).savefig(path)


def overview(result: Measurement, /, *, title: str) -> Figure:
    """Draw a measurement at a glance.

    With points: image, modulation, wrapped phase, order, depth, rejected pixels by reason.
    Without a rig: the wrapped phase of every period and direction, and how the periods agree.
    """
    panels = _phase_panels(result) if result.points is None else _point_panels(result)
    n_cols = 3
    n_rows = -(-len(panels) // n_cols)
    window = window_of(np.isfinite(result.main.phase))
    height, width = (s.stop - s.start for s in window)
    aspect = float(np.clip(height / width, 0.5, 1.5))
    size = (16.5, 1.0 + n_rows * (5.0 * aspect + 0.75))
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    axes = figure.subplots(n_rows, n_cols, squeeze=False).ravel()
    for axis, draw in zip(axes, panels, strict=False):
        draw(axis, window)
        axis.set_facecolor("#101216")
        axis.tick_params(labelsize=8)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    return figure


def _point_panels(result: Measurement) -> list[Drawer]:
    main = result.main
    assert result.points is not None
    assert result.matches is not None
    depth = result.points.points_mm[..., 2]
    order = np.where(result.matches.rejection == 0, result.matches.fringe_order, np.nan)
    is_code = main.is_quantised
    wrapped = (
        colour_map("projector column, px", main.position_px, "viridis")
        if is_code
        else wrapped_phase("wrapped phase, rad", main.phase)
    )
    return [
        colour_map(f"image: mean brightness of '{main.device_name}', DN", main.offset, "gray"),
        colour_map("modulation (fringe contrast), DN", main.modulation, "magma"),
        wrapped,
        colour_map("code cell" if main.is_quantised else "fringe order", order, "nipy_spectral"),
        relief("depth z, mm (shaded)", depth),
        reasons(result.rejection),
    ]


def _phase_panels(result: Measurement) -> list[Drawer]:
    panels: list[Drawer] = [
        colour_map(f"image: mean brightness of '{result.main.device_name}', DN", result.main.offset,
             "gray"),
        colour_map("modulation (fringe contrast), DN", result.main.modulation, "magma"),
        reasons(result.rejection),
    ]  # fmt: skip
    for direction in result.phases[0].directions:
        axis = axis_name(direction.main.angle)
        for phases in (direction.main, *direction.others):
            label = f"{axis}, period {phases.period_px:g} px"
            panels.append(wrapped_phase(f"wrapped phase, rad: {label}", phases.phase))
        if direction.main.is_absolute:
            panels.append(
                colour_map(
                    f"projector coordinate, px: {axis}", direction.main.position_px, "viridis"
                )
            )
        panels += [_disagreement(direction.main, other) for other in direction.others]
    return panels


def _disagreement(main: PhaseMap, other: PhaseMap) -> Drawer:
    title = (
        f"disagreement of the periods, px: {axis_name(main.angle)}, "
        f"{main.period_px:g} - {other.period_px:g}"
    )
    difference = period_disagreement(main, other)
    limit = float(np.nanpercentile(np.abs(difference), 99)) if np.isfinite(difference).any() else 1
    return colour_map(title, difference, "RdBu_r", limits=(-limit, limit))
