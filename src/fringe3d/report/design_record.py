"""The design of a rig as plain data, for machines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fringe3d.design import Assessment, Equation, GrayNeeds
from fringe3d.report.design_words import (
    findings,
    n_images,
    patterns_command,
    recommendation,
)


def record(a: Assessment, /, *, name: str, command: str) -> dict[str, Any]:
    """Return all figures for machines; angles in degrees, with the unit in the key.

    Parameters
    ----------
    a : Assessment
    name, command : str; of the rig, and as typed
    """
    depths, u = a.reference.depths, a.uncertainty
    found: dict[str, Any] = {
        "command": command,
        "rig": name,
        "period_px": a.period_px if a.rig.projector else None,
        "camera_period_px": a.camera_period_px,
        "fringe_angle_deg": math.degrees(a.angle),
        "steps": a.quality.n_shifts,
        "noise": a.quality.noise,
        "calibration_error_px": a.quality.calibration_px,
        "guard_periods": a.guard,
        "beyond": a.beyond_part,
        "images": n_images(a, a.bits),
        "images_with_surfaces_beyond": n_images(a, a.needs.bits_beyond),
        "recommendation": recommendation(a),
        "patterns_command": patterns_command(a) or None,
        "depth_min_mm": depths.depth_min_mm,
        "depth_ref_mm": depths.depth_ref_mm,
        "depth_max_mm": depths.depth_max_mm,
        "angle_c1_c2_deg": math.degrees(a.angle_c1c2),
        "angle_c1_projector_deg": math.degrees(a.angle_c1p),
        "angle_c2_projector_deg": math.degrees(a.angle_c2p),
        "equations": [_equation_record(equation) for equation in a.equations],
        "gray_code": {where: _needs_record(needs) for where, needs in _named_searches(a)},
        "sigma_median_mm": u.median_mm,
        "sigma_5_percent_mm": u.low_mm,
        "sigma_95_percent_mm": u.high_mm,
        "findings": findings(a),
    }
    if a.place is not None:
        found |= {
            "angle_without_code_deg": math.degrees(a.place.free_angle),
            "fringe_crossing_deg": math.degrees(a.place.crossing),
            "fringe_angle_square_deg": math.degrees(a.place.square_angle),
        }
    if a.margins is not None:
        found["ambiguity_margin"] = {
            "slopes_deg": np.degrees(a.margins.slopes).tolist(),
            "worst_periods": a.margins.worst_margin.tolist(),
            "worst_ratio": a.margins.worst_ratio.tolist(),
            "worst_order": a.margins.worst_order.tolist(),
            "share_unsafe": a.margins.share_unsafe.tolist(),
        }
    cleaned: dict[str, Any] = _without_nan(found)
    return cleaned


def _named_searches(a: Assessment) -> list[tuple[str, GrayNeeds]]:
    pairs = (("projector_segment", a.projector_needs), ("camera_segment", a.camera_needs))
    return [(name, needs) for name, needs in pairs if needs is not None]


def _equation_record(equation: Equation) -> dict[str, Any]:
    turn = math.degrees if equation.unit == "rad" else float
    unit = {"rad": "_deg", "px": "_px"}.get(equation.unit, "")
    return {
        "number": equation.number,
        "quantity": equation.quantity,
        f"printed{unit}": turn(equation.printed),
        f"exact{unit}": turn(equation.exact),
        f"all_pixels{unit}": turn(equation.counted),
        "remark": equation.remark,
    }


def _needs_record(needs: GrayNeeds) -> dict[str, Any]:
    return {
        "max_periods": needs.max_periods,
        "max_orders": needs.max_orders,
        "bits": needs.bits,
        "bits_without_any_twin": needs.exact_bits,
        "bits_with_surfaces_beyond": needs.bits_beyond,
        "twin_share_by_bits": list(needs.twins),
        "twin_share_beyond_by_bits": list(needs.twins_beyond),
    }


def _without_nan(value: Any) -> Any:
    """Return the record with null for what is unknown or infinite: JSON has no such numbers."""
    if isinstance(value, dict):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
