"""Check that the images agree with the calibration and with each other."""

from fringe3d.health.finding import Finding
from fringe3d.health.geometry import (
    EPIPOLAR_WARNING_PX,
    check_ambiguity,
    check_bias,
    check_epipolar,
    check_evidence,
    check_previous,
    check_probability,
    check_trinocular,
    check_twins,
    check_yield,
)
from fringe3d.health.recording import check_files
from fringe3d.health.response import (
    axis_name,
    check_course,
    check_phases,
    period_disagreement,
)
from fringe3d.health.texture import CORRELATION, check_texture

__all__ = [
    "CORRELATION",
    "EPIPOLAR_WARNING_PX",
    "Finding",
    "axis_name",
    "check_ambiguity",
    "check_bias",
    "check_course",
    "check_epipolar",
    "check_evidence",
    "check_files",
    "check_phases",
    "check_previous",
    "check_probability",
    "check_texture",
    "check_trinocular",
    "check_twins",
    "check_yield",
    "period_disagreement",
]
