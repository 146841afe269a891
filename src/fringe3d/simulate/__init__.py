"""Scans with exact truth: scenes, ray casting, sensors. A stranger to the estimator."""

from fringe3d.simulate.knock import knocked
from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects import OBJECTS, from_file
from fringe3d.simulate.optics import CameraOptics, ProjectorOptics, Recording, Surface
from fringe3d.simulate.presets import PRESETS, Preset
from fringe3d.simulate.quick import simulate
from fringe3d.simulate.render import (
    Setup,
    Stage,
    hot_of,
    prepare,
    record,
    record_exposures,
)
from fringe3d.simulate.scene import Scene
from fringe3d.simulate.shown import Shown, see, show
from fringe3d.simulate.truth import Truth
from fringe3d.simulate.turntable import table_axis, table_positions, turntable

__all__ = [
    "OBJECTS",
    "PRESETS",
    "CameraOptics",
    "Mesh",
    "Preset",
    "ProjectorOptics",
    "Recording",
    "Scene",
    "Setup",
    "Shown",
    "Stage",
    "Surface",
    "Truth",
    "from_file",
    "hot_of",
    "knocked",
    "prepare",
    "record",
    "record_exposures",
    "see",
    "show",
    "simulate",
    "table_axis",
    "table_positions",
    "turntable",
]
