"""Where another device sees what a pixel of C1 sees."""

from fringe3d.correspond.projector import (
    depths_of_orders,
    guard_px,
    match_projector,
    resolve_orders,
    twin_share,
)
from fringe3d.correspond.stereo import fringe_crossing, match_cameras

__all__ = [
    "depths_of_orders",
    "fringe_crossing",
    "guard_px",
    "match_cameras",
    "match_projector",
    "resolve_orders",
    "twin_share",
]
