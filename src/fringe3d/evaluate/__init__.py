"""Results against truth or each other, fitted surfaces, acceptance; of any program's points."""

from fringe3d.evaluate.acceptance import (
    Decision,
    Probed,
    decide,
    probe_plane,
    probe_spheres,
    spacing_mm,
)
from fringe3d.evaluate.axial import Cone, fit_cone, fit_cylinder
from fringe3d.evaluate.compare import (
    Score,
    Verdict,
    errors_along_rays,
    false_share,
    score,
    verdicts,
    verdicts_of_orders,
)
from fringe3d.evaluate.deviations import (
    Deviations,
    deviations_from_cloud,
    deviations_from_mesh,
)
from fringe3d.evaluate.fitting import (
    REJECTED_PART,
    Fit,
    fit_covariance,
    settled,
    shortest_interval,
)
from fringe3d.evaluate.plane import Plane, fit_plane, sigma_without_bend
from fringe3d.evaluate.sphere import Sphere, algebraic_sphere, find_spheres, fit_sphere

__all__ = [
    "REJECTED_PART",
    "Cone",
    "Decision",
    "Deviations",
    "Fit",
    "Plane",
    "Probed",
    "Score",
    "Sphere",
    "Verdict",
    "algebraic_sphere",
    "decide",
    "deviations_from_cloud",
    "deviations_from_mesh",
    "errors_along_rays",
    "false_share",
    "find_spheres",
    "fit_cone",
    "fit_covariance",
    "fit_cylinder",
    "fit_plane",
    "fit_sphere",
    "probe_plane",
    "probe_spheres",
    "score",
    "settled",
    "shortest_interval",
    "sigma_without_bend",
    "spacing_mm",
    "verdicts",
    "verdicts_of_orders",
]
