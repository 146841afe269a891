"""A first scan: simulated images of a machine part, points with their uncertainty, a picture.

Leaves first-scan/ with the cloud, the maps and a report to open in a browser.
"""

from pathlib import Path

import numpy as np

from fringe3d import plot
from fringe3d.io.stored import read_result
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.report.folder import write_result
from fringe3d.report.measurement import report_html
from fringe3d.simulate import simulate

SIZE = (320, 256)  # take (640, 512) for a better look; it needs four times as long
OUT = Path("first-scan")

# Two cameras and a projector; 10 images each: 4 phase steps, a reduced Gray code, light and dark.
scan, truth = simulate("kolibri", "machine-part", "m2", size=SIZE, seed=1)
result = measure(scan)

points = result.points
good = points.is_valid  # (row, col), on the pixels of the first camera
error = np.linalg.norm(points.points_mm - truth.points_mm, axis=-1)[good]
print(f"{points.n_points:,} points by method {result.method}: {result.why}")
print(f"sigma {1000 * np.median(points.sigma_mm[good]):.1f} um (median, along the viewing ray)")
print(f"distance from the truth {1000 * np.median(error):.1f} um (median)")
for finding in result.warnings:
    print(f"{finding.level}: {finding.text}")

write_result(OUT, scan, MeasureOptions(), result, overwrite=True)
page = report_html(read_result(OUT))
(OUT / "report.html").write_text(page, encoding="utf-8")
plot.depth(result).save(OUT / "depth.png", overwrite=True)
