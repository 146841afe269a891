"""How few images do? The same recording measured by several methods, against the truth."""

import numpy as np

from fringe3d.errors import Fringe3DError
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.simulate import simulate

FRINGES_ALONE = {"direction": "x", "gray_bits": 0, "light_dark": False}
WRONG_MM = 0.5  # noise moves points by 0.01 mm, a wrong fringe order by 6 mm

# `designed` has its projector where four images tell the fringe orders apart.
# The full code is recorded once; each method leaves out the images that it does without.
scan, truth = simulate("designed", "machine-part", "m1", size=(320, 256), seed=5)
there = truth.lit & truth.in_volume & truth.seen_by["c2"]

wanted = {
    "full code": MeasureOptions(method="m1"),
    "reduced code": MeasureOptions(method="m2", gray_bits=4),
    "fringes alone, each pixel": MeasureOptions(method="m3", **FRINGES_ALONE),
    "fringes alone, all pixels": MeasureOptions(method="m6", **FRINGES_ALONE),
}
print(f"{'':28}images  complete  wrong")
for name, options in wanted.items():
    try:
        result = measure(scan, options)
    except Fringe3DError as problem:  # it says what would do
        print(f"{name:28}{problem}")
        continue
    good = result.points.is_valid
    off = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)[good]
    complete = (good & there).sum() / there.sum()
    print(f"{name:28}{result.n_images:6}{complete:10.1%}{(off > WRONG_MM).mean():7.2%}")
