"""How sure is a point, why has this pixel one, and why has that one none."""

from pathlib import Path

import numpy as np

from fringe3d import plot
from fringe3d.io.stored import read_result
from fringe3d.model import Rejection
from fringe3d.model.rejection import count_by_reason
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.report.folder import write_result
from fringe3d.simulate import simulate
from fringe3d.view.pixel import pixel_story

scan, _ = simulate("kolibri", "step-gauge", "m2", size=(320, 256), seed=6)
result = measure(scan)
points = result.points

# Every pixel has a point or a reason; the lowest bit is the one that counts.
for name, count in count_by_reason(points.rejection).items():
    print(f"{count:7,} px {name}: {Rejection[name].meaning}")

# Three columns of a surface: height, standard deviation, probability of the fringe order.
row = points.rejection.shape[0] // 2
for col in np.flatnonzero(points.is_valid[row])[::40]:
    z, sigma = points.points_mm[row, col, 2], points.sigma_mm[row, col]
    order = result.matches.order_probability[row, col]
    print(f"row {row}, column {col}: z {z:.3f} mm, sigma {1000 * sigma:.1f} um, p {order:.4f}")

# The viewing ray of one of them, its candidates, and the one that was taken.
write_result(Path("step-gauge"), scan, MeasureOptions(), result, overwrite=True)
story = pixel_story(read_result(Path("step-gauge")), row, int(col))
print(story.words)
for candidate in story.candidates:
    taken = " <- taken" if candidate.is_taken else ""
    print(f"  order {candidate.order}: {candidate.depth_mm:.2f} mm along the ray{taken}")

plot.rejected(result).save("rejected.png", overwrite=True)
plot.sigma(result).save("sigma.png", overwrite=True)
