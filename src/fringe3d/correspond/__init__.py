"""Where another device sees what a pixel of C1 sees."""

from fringe3d.correspond.projector import match_projector
from fringe3d.correspond.stereo import match_cameras

__all__ = ["match_cameras", "match_projector"]
