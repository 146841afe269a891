"""Where another device sees what a pixel of C1 sees."""

from fringe3d.correspond.borders import doubt_at_borders
from fringe3d.correspond.both_directions import match_both_directions
from fringe3d.correspond.candidates import FIT_SIGMA, choose_orders
from fringe3d.correspond.chosen import ChosenOrders
from fringe3d.correspond.curves import keep_curves, ray_curves
from fringe3d.correspond.direct import Located, locate
from fringe3d.correspond.following import lit_before, orders_of_before, seen_before
from fringe3d.correspond.near import match_near_sheets
from fringe3d.correspond.noise import variance_between, with_true_sigma
from fringe3d.correspond.placement import place_lost
from fringe3d.correspond.projector import (
    GUARD_PX,
    guard_px,
    match_projector,
    resolve_orders,
    twin_share,
)
from fringe3d.correspond.single import confirm_orders
from fringe3d.correspond.smoothing import averaged_phase, quiet
from fringe3d.correspond.solutions import DOUBT, Rivals, Solution, epipolar_direction, rivals
from fringe3d.correspond.solving import coarse_stride, tells_enough
from fringe3d.correspond.stereo import fringe_crossing, match_cameras
from fringe3d.correspond.weighing import Task, TwoViews
from fringe3d.correspond.witnesses import Witnesses

__all__ = [
    "DOUBT",
    "FIT_SIGMA",
    "GUARD_PX",
    "ChosenOrders",
    "Located",
    "Rivals",
    "Solution",
    "Task",
    "TwoViews",
    "Witnesses",
    "averaged_phase",
    "choose_orders",
    "coarse_stride",
    "confirm_orders",
    "doubt_at_borders",
    "epipolar_direction",
    "fringe_crossing",
    "guard_px",
    "keep_curves",
    "lit_before",
    "locate",
    "match_both_directions",
    "match_cameras",
    "match_near_sheets",
    "match_projector",
    "orders_of_before",
    "place_lost",
    "quiet",
    "ray_curves",
    "resolve_orders",
    "rivals",
    "seen_before",
    "tells_enough",
    "twin_share",
    "variance_between",
    "with_true_sigma",
]
