"""Two calibrations of a rig, side by side in the measuring volume: in numbers and words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import RigComparison

EXPECTED = 3.0
"""Sigmas, rms over the volume: few numbers move all points together, so they rarely reach it."""


def comparison_record(comparison: RigComparison, /, *, unit: str = "mm") -> dict[str, Any]:
    """Return the figures as plain data, and in words."""
    moved, form = (
        np.linalg.norm(vectors, axis=-1) for vectors in (comparison.moved_mm, comparison.form_mm)
    )
    ratios = [
        _rms(size / sigma) if comparison.counted else None
        for size, sigma in ((moved, comparison.moved_sigma_mm), (form, comparison.form_sigma_mm))
    ]
    sigmas = [
        f" (sigma {_rms(sigma):.2g})" if comparison.counted else ""
        for sigma in (comparison.moved_sigma_mm, comparison.form_sigma_mm)
    ]
    text = (
        f"compared with the former calibration ({' and '.join(comparison.devices)}, over the "
        f"measuring volume): points move by {comparison.moved_rms_mm:.3g} {unit} rms{sigmas[0]}, "
        f"{np.nanmax(moved):.3g} at most; their form by {comparison.form_rms_mm:.3g} "
        f"rms{sigmas[1]}, {np.nanmax(form):.3g} at most; lengths by "
        f"{100 * (comparison.scale - 1):+.3f} %. {_judged(comparison, ratios)}"
    )
    return {
        "text": text,
        "devices": list(comparison.devices),
        "moved_rms": comparison.moved_rms_mm,
        "moved_largest": float(np.nanmax(moved)),
        "form_rms": comparison.form_rms_mm,
        "form_largest": float(np.nanmax(form)),
        "scale": comparison.scale,
        "sigma_of": list(comparison.counted),
        "moved_in_sigmas": ratios[0],
        "form_in_sigmas": ratios[1],
    }


def _judged(comparison: RigComparison, ratios: list[float | None]) -> str:
    """Say whether the calibrations are as uncertain as they differ."""
    whose = " and the ".join(comparison.counted)
    known = [ratio for ratio in ratios if ratio is not None]
    if not known:
        return "No calibration says how certain it is"
    told = f"{known[0]:.1f} and {known[1]:.1f} times the sigma of the {whose} calibration"
    if max(known) < EXPECTED:
        return f"That is {told}: no more than to be expected"
    return f"That is {told}: the rig has changed, or one of them is wrong"


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
