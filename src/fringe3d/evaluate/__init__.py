"""Results against the truth: completeness, errors, planes. Knows neither rig nor phases."""

from fringe3d.evaluate.compare import (
    Score,
    Verdict,
    errors_along_rays,
    false_share,
    score,
    verdicts,
    verdicts_of_orders,
)
from fringe3d.evaluate.plane import (
    REJECTED_PART,
    PlaneFit,
    fit_plane,
    sigma_without_bend,
)

__all__ = [
    "REJECTED_PART",
    "PlaneFit",
    "Score",
    "Verdict",
    "errors_along_rays",
    "false_share",
    "fit_plane",
    "score",
    "sigma_without_bend",
    "verdicts",
    "verdicts_of_orders",
]
