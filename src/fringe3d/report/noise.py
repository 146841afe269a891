"""A picture of the noise of sensors: the photon transfer curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fringe3d.decode import SensorNoise
from fringe3d.report.saving import save_figure


def write_noise_picture(path: Path, found: Sequence[SensorNoise], /) -> None:
    """Draw the variance of grey values over their brightness, with the line of the model."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4.4), dpi=110, layout="constrained")
    axis = figure.subplots()
    for number, one in enumerate(found):
        model, colour = one.model, f"C{number}"
        line = np.array([0.0, float(one.signal_dn.max())])
        axis.plot(one.signal_dn, one.variance_dn2, "o", ms=4, color=colour)
        axis.plot(line, model.read_noise_dn**2 + model.gain_dn_per_e * line, color=colour,
                  label=f"{one.device_name}: {model.read_noise_dn:.3g}$^2$ + "
                  f"{model.gain_dn_per_e:.3g} signal")  # fmt: skip
    axis.set(xlabel="signal above black (DN)", ylabel="variance (DN$^2$)", ylim=(0, None),
             title=f"noise, from {found[0].source}")  # fmt: skip
    axis.legend(fontsize=9)
    save_figure(path, figure, overwrite=True)
