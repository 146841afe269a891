"""Projection, rays, epipolar curves and segments."""

from fringe3d.geometry.epipolar import (
    closest_depths,
    depth_interval,
    epipolar_curve,
    epipolar_segment,
    frustum,
    grid_intervals,
    sheet_crossing,
)
from fringe3d.geometry.outlines import frustum_lines, volume_lines
from fringe3d.geometry.placing import above, looking_at, looking_at_origin
from fringe3d.geometry.projection import (
    grid_rays,
    normalize,
    pixel_centres,
    pixel_grid,
    project,
    rays,
    triangulation_angle,
    unproject,
)
from fringe3d.kernels import tell_of_compiling

__all__ = [
    "above",
    "closest_depths",
    "depth_interval",
    "epipolar_curve",
    "epipolar_segment",
    "frustum",
    "frustum_lines",
    "grid_intervals",
    "grid_rays",
    "looking_at",
    "looking_at_origin",
    "normalize",
    "pixel_centres",
    "pixel_grid",
    "project",
    "rays",
    "sheet_crossing",
    "triangulation_angle",
    "unproject",
    "volume_lines",
]

tell_of_compiling()
