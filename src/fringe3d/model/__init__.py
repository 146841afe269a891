"""The nouns: frozen data, checked once when they are made."""

from fringe3d.model.bias import CalibrationBias
from fringe3d.model.board import Board
from fringe3d.model.cloud import PointCloud, PointMap
from fringe3d.model.correspondences import Correspondences
from fringe3d.model.covariance import RigCovariance
from fringe3d.model.device import Device
from fringe3d.model.merged import FATES, Fate, MergedCloud, SurfaceMesh
from fringe3d.model.phasemap import NO_ORDER, PhaseMap, WrappedPhaseMap, some_known
from fringe3d.model.plan import Fringe, GrayBit, Pattern, PatternPlan, Uniform, Unused
from fringe3d.model.pose import RigidTransform
from fringe3d.model.rejection import Rejection
from fringe3d.model.response import Response, Ripple
from fringe3d.model.rig import Rig
from fringe3d.model.scan import Scan
from fringe3d.model.stack import Fused, ImageStack, NoiseModel
from fringe3d.model.table import TableAxis, TablePosition
from fringe3d.model.view import FoundTable, PairResidual, Registration, SurfaceView
from fringe3d.model.volume import MeasuringVolume

__all__ = [
    "FATES",
    "NO_ORDER",
    "Board",
    "CalibrationBias",
    "Correspondences",
    "Device",
    "Fate",
    "FoundTable",
    "Fringe",
    "Fused",
    "GrayBit",
    "ImageStack",
    "MeasuringVolume",
    "MergedCloud",
    "NoiseModel",
    "PairResidual",
    "Pattern",
    "PatternPlan",
    "PhaseMap",
    "PointCloud",
    "PointMap",
    "Registration",
    "Rejection",
    "Response",
    "Rig",
    "RigCovariance",
    "RigidTransform",
    "Ripple",
    "Scan",
    "SurfaceMesh",
    "SurfaceView",
    "TableAxis",
    "TablePosition",
    "Uniform",
    "Unused",
    "WrappedPhaseMap",
    "some_known",
]
