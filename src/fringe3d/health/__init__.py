"""Check that the images agree with the calibration and with each other."""

from fringe3d.health.exposure import (
    Light,
    check_exposure,
    check_focus,
    check_response,
    light_of,
)
from fringe3d.health.fault import Fault, Kind
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
from fringe3d.health.sampling import LitMap, lit_map
from fringe3d.health.sequence import check_sequence
from fringe3d.health.steadiness import Steps, check_steadiness, steps_of
from fringe3d.health.texture import CORRELATION, check_texture

__all__ = [
    "CORRELATION",
    "EPIPOLAR_WARNING_PX",
    "Fault",
    "Finding",
    "Kind",
    "Light",
    "LitMap",
    "Steps",
    "axis_name",
    "check_ambiguity",
    "check_bias",
    "check_course",
    "check_epipolar",
    "check_evidence",
    "check_exposure",
    "check_files",
    "check_focus",
    "check_phases",
    "check_previous",
    "check_probability",
    "check_response",
    "check_sequence",
    "check_steadiness",
    "check_texture",
    "check_trinocular",
    "check_twins",
    "check_yield",
    "light_of",
    "lit_map",
    "period_disagreement",
    "steps_of",
]
