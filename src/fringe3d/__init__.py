"""fringe3d: fringe-projection 3D measurement with few images."""

__version__ = "0.1.0"
