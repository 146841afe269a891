"""fringe3d: fringe-projection 3D measurement with few images."""

from pathlib import Path

from fringe3d.kernels import forget_stale_kernels

__version__ = "0.1.0"

forget_stale_kernels(Path(__file__).parent)
