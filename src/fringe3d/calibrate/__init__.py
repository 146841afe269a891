"""Calibrate devices from boards and from measurements."""

from fringe3d.calibrate._board_lens import BOARD_LENSES, BoardLens, BoardLensTrial
from fringe3d.calibrate._board_shape import SHAPES, BoardShape, ShapeTrial
from fringe3d.calibrate._lens import LENSES, Lens, LensTrial
from fringe3d.calibrate._parameters import Parameter
from fringe3d.calibrate._pose_problem import first_depths
from fringe3d.calibrate.bad_poses import BadPose, bad_poses
from fringe3d.calibrate.ball import ball_center
from fringe3d.calibrate.board import BoardCalibration, BoardOptions, DeviceSize, calibrate_board
from fringe3d.calibrate.board_judging import (
    PoseLeftOut,
    check_board,
    focal_sigma_by_poses,
    leave_poses_out,
    typical_rms_px,
)
from fringe3d.calibrate.board_view import BoardView
from fringe3d.calibrate.circle_centers import circle_centers
from fringe3d.calibrate.comparing import RigComparison, compare_rigs
from fringe3d.calibrate.corner_light import light_on_corners
from fringe3d.calibrate.expected import expected_contradiction
from fringe3d.calibrate.homologous import Homologous, Sight, homologous_points
from fringe3d.calibrate.judging import Rest, check_fit, region_points, rests
from fringe3d.calibrate.lit_points import LitPoints, lit_points
from fringe3d.calibrate.moved import Moved, Mover, contradiction, moved_text, which_moved
from fringe3d.calibrate.point_error import form_covariance, point_covariance
from fringe3d.calibrate.poses import FittedPoses, PoseChange, fit_poses, located
from fringe3d.calibrate.poses_judging import check_poses
from fringe3d.calibrate.projector import (
    FittedProjector,
    depth_part,
    fit_projector,
    residual_px,
)
from fringe3d.calibrate.rig_numbers import (
    RigNumber,
    beforehand,
    changed,
    contradictions,
    covariance_of,
    numbers_of,
    placed,
    placing,
    point_shifts,
)

__all__ = [
    "BOARD_LENSES",
    "LENSES",
    "SHAPES",
    "BadPose",
    "BoardCalibration",
    "BoardLens",
    "BoardLensTrial",
    "BoardOptions",
    "BoardShape",
    "BoardView",
    "DeviceSize",
    "FittedPoses",
    "FittedProjector",
    "Homologous",
    "Lens",
    "LensTrial",
    "LitPoints",
    "Moved",
    "Mover",
    "Parameter",
    "PoseChange",
    "PoseLeftOut",
    "Rest",
    "RigComparison",
    "RigNumber",
    "ShapeTrial",
    "Sight",
    "bad_poses",
    "ball_center",
    "beforehand",
    "calibrate_board",
    "changed",
    "check_board",
    "check_fit",
    "check_poses",
    "circle_centers",
    "compare_rigs",
    "contradiction",
    "contradictions",
    "covariance_of",
    "depth_part",
    "expected_contradiction",
    "first_depths",
    "fit_poses",
    "fit_projector",
    "focal_sigma_by_poses",
    "form_covariance",
    "homologous_points",
    "leave_poses_out",
    "light_on_corners",
    "lit_points",
    "located",
    "moved_text",
    "numbers_of",
    "placed",
    "placing",
    "point_covariance",
    "point_shifts",
    "region_points",
    "residual_px",
    "rests",
    "typical_rms_px",
    "which_moved",
]
