"""Calibrate devices from measurements."""

from fringe3d.calibrate._lens import LENSES, Lens, LensTrial
from fringe3d.calibrate._parameters import Parameter
from fringe3d.calibrate.judging import Rest, check_fit, region_points, rests
from fringe3d.calibrate.lit_points import LitPoints, lit_points
from fringe3d.calibrate.projector import FittedProjector, fit_projector, residual_px

__all__ = [
    "LENSES",
    "FittedProjector",
    "Lens",
    "LensTrial",
    "LitPoints",
    "Parameter",
    "Rest",
    "check_fit",
    "fit_projector",
    "lit_points",
    "region_points",
    "residual_px",
    "rests",
]
