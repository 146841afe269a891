"""Is the system as good as it should be? A ball bar and a plate, judged as VDI/VDE 2634 does."""

import numpy as np

from fringe3d.evaluate import decide, probe_plane, probe_spheres, spacing_mm
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.simulate import PRESETS, simulate

# The artefact's certificate: here that of the simulator, made to fit into the volume.
SCALE = PRESETS["kolibri"]().scale()
DIAMETER_MM, DISTANCE_MM, UNCERTAINTY_MM = 16.0 * SCALE, 50.0 * SCALE, 0.001
MAX_FORM_MM, MAX_SIZE_MM, MAX_SPACING_MM, MAX_FLATNESS_MM = 0.15, 0.05, 0.02, 0.15


def points_of(thing: str, seed: int) -> np.ndarray:
    """Measure an artefact; return its points (n, 3), mm."""
    scan, _ = simulate("kolibri", thing, "m1", size=(320, 256), seed=seed)
    result = measure(scan, MeasureOptions(drop_edges=True))
    return result.points.points_mm[result.points.is_valid]


def judge(name: str, value_mm: float, limit_mm: float) -> None:
    """Print a value and whether it keeps its limit with all of the uncertainty."""
    verdict = decide(value_mm, limit_mm, UNCERTAINTY_MM).value
    print(f"{name:28}{1000 * value_mm:8.1f} um, limit {1000 * limit_mm:.0f} um: {verdict}")


bar = points_of("ball-bar", seed=9)
balls = probe_spheres(bar, DIAMETER_MM, 2)
for number, ball in enumerate(balls):
    judge(f"ball {number}, form", ball.fit.form_mm, MAX_FORM_MM)
    judge(f"ball {number}, size", 2 * ball.fit.surface.radius_mm - DIAMETER_MM, MAX_SIZE_MM)
judge("sphere spacing", spacing_mm(*balls) - DISTANCE_MM, MAX_SPACING_MM)

plate = probe_plane(points_of("flat-plate", seed=9))
judge("flatness", plate.fit.form_mm, MAX_FLATNESS_MM)
print(f"sigma of a point of the plate {1000 * plate.fit.sigma_mm:.1f} um")
