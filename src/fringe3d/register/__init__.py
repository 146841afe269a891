"""Views of a body into one frame, and one surface."""

from fringe3d.register.adjust import AdjustOptions, adjust
from fringe3d.register.axis import axis_of_motions, axis_of_points
from fringe3d.register.coarse import place_by_angles, place_by_shape
from fringe3d.register.edging import EdgePoints, split_edges, with_edges
from fringe3d.register.fusing import fuse
from fringe3d.register.holes import border_loops, closed_holes
from fringe3d.register.judging import OddView, odd_views
from fringe3d.register.meshing import mesh_of
from fringe3d.register.overlap import Landed, Sample, all_points, land_on, sample_of
from fringe3d.register.pairs import PairFit, judge_pair, match_pair, refine_pair
from fringe3d.register.registering import RegisterOptions, register, table_prior
from fringe3d.register.rig_system import OverlapSystem
from fringe3d.register.small_motion import motion_of, vector_of
from fringe3d.register.table_model import TablePrior
from fringe3d.register.views import surface_view

__all__ = [
    "AdjustOptions",
    "EdgePoints",
    "Landed",
    "OddView",
    "OverlapSystem",
    "PairFit",
    "RegisterOptions",
    "Sample",
    "TablePrior",
    "adjust",
    "all_points",
    "axis_of_motions",
    "axis_of_points",
    "border_loops",
    "closed_holes",
    "fuse",
    "judge_pair",
    "land_on",
    "match_pair",
    "mesh_of",
    "motion_of",
    "odd_views",
    "place_by_angles",
    "place_by_shape",
    "refine_pair",
    "register",
    "sample_of",
    "split_edges",
    "surface_view",
    "table_prior",
    "vector_of",
    "with_edges",
]
