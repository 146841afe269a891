"""Whether poses from a measurement can be trusted, and what they leave open."""

from __future__ import annotations

import numpy as np

from fringe3d.calibrate.poses import FittedPoses
from fringe3d.health import Finding

CONTRADICTION_PX = 0.1
"""Projector px; with true lenses and orders the noise of the phases alone is left, 0.02 to 0.04."""

CONTRADICTION_NOISE = 4.0
"""Times the predicted noise."""

LEAST_KNOWN = 0.5
"""Shares of the least known combination that are named add up to so much."""


def check_poses(fitted: FittedPoses, /) -> list[Finding]:
    """Judge what is left of the contradictions, and say which numbers are determined.

    That a number is not determined is no fault: no residual, and of two cameras hardly any point,
    depends on it then.
    """
    left = (
        f"self-calibration: {fitted.n_points:,} homologous points contradict each other by "
        f"{fitted.residual_px:.3f} px (before: {fitted.residual_before_px:.3f} px)"
    )
    findings = [Finding("ok", "self_calibration_px", fitted.residual_px, left)]
    wrong = fitted.residual_px > CONTRADICTION_PX and fitted.noise_factor > CONTRADICTION_NOISE
    if wrong:
        text = (
            f"{left}, {fitted.noise_factor:.0f} times their noise: no poses bring them together. "
            "Lenses have changed (calibrate with a board), fringe orders are wrong (record a full "
            "Gray code), or devices moved during the recording"
        )
        findings = [Finding("warning", "self_calibration_px", fitted.residual_px, text)]
    return [*findings, Finding("ok", "determined_part", _part(fitted), determined_text(fitted))]


def _part(fitted: FittedPoses) -> float:
    return fitted.n_determined / fitted.n_numbers


def determined_text(fitted: FittedPoses, /) -> str:
    """Say which numbers of the poses the data determine."""
    text = (
        f"the data determine {fitted.n_determined} of {fitted.n_numbers} numbers of the poses "
        f"(scale: distance {fitted.distance_kept})"
    )
    if not fitted.is_determined:
        kept = [f"{c.device}.{c.number}" for c in fitted.changes if c.held_by == "former"]
        together = np.cumsum([share for _, share in fitted.weakest])
        count = int(np.searchsorted(together, LEAST_KNOWN)) + 1
        named = kept or [name for name, _ in fitted.weakest[:count]]
        text += f"; the former calibration holds {', '.join(named)}"
    return f"{text}. The form of the points is known to {1000 * fitted.form_sigma_mm:.1f} um"
