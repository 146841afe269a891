"""Planning a rig: which images it needs, where the projector should stand, how well it measures."""

from fringe3d.design.assessment import Assessment, ProjectorPlace, assess
from fringe3d.design.counts import (
    SegmentMap,
    angle_without_code,
    periods_in_camera,
    periods_on_projector,
    with_projector_at,
)
from fringe3d.design.equations import Equation, compare
from fringe3d.design.gray import GrayNeeds, gray_needs, guard_periods, order_counts, twin_part
from fringe3d.design.margin import AmbiguityMap, ambiguity_margins
from fringe3d.design.optimise import Candidate, Optimisation, optimise
from fringe3d.design.reference import Reference, reference_of, with_depth
from fringe3d.design.residual import Quality, wrong_order_residuals
from fringe3d.design.task import Limits
from fringe3d.design.uncertainty import (
    UncertaintyMap,
    fringe_crossing,
    phase_noise,
    point_sigma,
    predict_uncertainty,
)

__all__ = [
    "AmbiguityMap",
    "Assessment",
    "Candidate",
    "Equation",
    "GrayNeeds",
    "Limits",
    "Optimisation",
    "ProjectorPlace",
    "Quality",
    "Reference",
    "SegmentMap",
    "UncertaintyMap",
    "ambiguity_margins",
    "angle_without_code",
    "assess",
    "compare",
    "fringe_crossing",
    "gray_needs",
    "guard_periods",
    "optimise",
    "order_counts",
    "periods_in_camera",
    "periods_on_projector",
    "phase_noise",
    "point_sigma",
    "predict_uncertainty",
    "reference_of",
    "twin_part",
    "with_depth",
    "with_projector_at",
    "wrong_order_residuals",
]
