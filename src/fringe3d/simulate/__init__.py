"""Recordings with exact truth; never imports, nor is imported by, the estimator."""

from fringe3d.simulate.closed_form import SphereScene, Truth, demo_rig, simulate

__all__ = ["SphereScene", "Truth", "demo_rig", "simulate"]
