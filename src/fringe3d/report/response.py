"""A picture of responses: the curves, and the ripples of the phase."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fringe3d.model import Response
from fringe3d.report.saving import save_figure


def write_response_picture(path: Path, found: Sequence[Response], /, *, title: str) -> None:
    """Draw brightness over pattern level, and the correction of the phase."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.8), dpi=110, layout="constrained")
    curves, ripples = figure.subplots(1, 2)
    curves.plot([0, 1], [0, 1], color="0.7", lw=1, label="linear")
    ripples.axhline(0, color="0.7", lw=1)
    phase = np.linspace(0, 2 * np.pi, 721)
    for response in found:
        name = response.device_name
        if response.has_curve:
            mark = "o-" if len(response.levels) < 40 else "-"
            curves.plot(response.levels, response.values, mark, ms=3,
                        label=f"{name}: gamma {response.gamma:.2f}")  # fmt: skip
        for ripple in response.ripples:
            ripples.plot(np.degrees(phase), 1000 * ripple.correction(phase),
                         label=f"{name}: {ripple.n_shifts} steps of {ripple.period_px:.4g} px, "
                         f"{1000 * ripple.amplitude:.0f} mrad rms")  # fmt: skip
    curves.set(xlabel="level of the pattern", ylabel="brightness", title="response")
    ripples.set(xlabel="measured phase, degrees", ylabel="added to it, mrad",
                title="correction of the phase")  # fmt: skip
    for axis in (curves, ripples):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    figure.suptitle(title)
    save_figure(path, figure, overwrite=True)
