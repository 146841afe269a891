"""What a self-calibration found, in words and as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from fringe3d.calibrate import PoseChange, check_poses
from fringe3d.self_calibration import SelfCalibrated


def self_calibration_record(found: SelfCalibrated, /) -> dict[str, Any]:
    """Return the figures as plain data."""
    fitted = found.fitted
    return {
        "points": fitted.n_points,
        "directions": found.n_directions,
        "residual_before_px": fitted.residual_before_px,
        "residual_px": fitted.residual_px,
        "noise_factor": fitted.noise_factor,
        "crowding": fitted.crowding,
        "form_sigma_mm": fitted.form_sigma_mm,
        "numbers": fitted.n_numbers,
        "determined": fitted.n_determined,
        "known_least": [{"number": name, "share": share} for name, share in fitted.weakest],
        "scale": "known length" if found.length_factor != 1 else f"distance {fitted.distance_kept}",
        "length_factor": found.length_factor,
        "changes": [_change(change) for change in fitted.changes],
        "health": [
            {"level": f.level, "name": f.name, "value": f.value, "text": f.text}
            for f in check_poses(fitted)
        ],
    }


def _change(change: PoseChange) -> dict[str, Any]:
    is_turn = change.number.startswith("turn")
    factor, unit = (float(np.degrees(1.0)), "deg") if is_turn else (1.0, "mm")
    return {
        "number": f"{change.device}.{change.number}_{unit}",
        "value": change.value * factor,
        "sigma": change.sigma * factor,
        "held_by": change.held_by,
    }


def self_calibration_text(record: dict[str, Any], /) -> str:
    """Return the figures for people."""
    lines = [finding["text"] for finding in record["health"]]
    lines += ["", f"{'change of the pose':<28}{'value':>10}{'sigma':>10}  held by"]
    lines += [
        f"{change['number']:<28}{change['value']:>10.4f}{change['sigma']:>10.4f}  "
        f"{change['held_by']}"
        for change in record["changes"]
    ]
    return "\n".join(lines)
