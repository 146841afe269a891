"""What do I project? Images as PNG files, and the plan that travels with them."""

from pathlib import Path

import numpy as np

from fringe3d.patterns import numbering, pattern_image, sequence
from fringe3d.report.patterns import write_patterns

SHAPE = (768, 1024)  # rows and columns of the projector

plans = {
    "full code": sequence(SHAPE, periods_px=(16.0,), n_shifts=4),
    "reduced code": sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray_bits=2),
    "four images": sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray="none"),
    "two directions": sequence(SHAPE, periods_px=(16.0,), n_shifts=4, angles=(0.0, np.pi / 2)),
    "three periods": sequence(SHAPE, periods_px=(16.0, 18.0, 21.0), n_shifts=4, gray="none"),
}
for name, plan in plans.items():
    print(f"{name}: {plan.n_images} images")
    for note in numbering(plan):
        print(f"  {note}")

write_patterns(Path("patterns"), plans["reduced code"], bit_depth=8, overwrite=True)

# A pattern is a function of projector coordinates; an image of it is an array like any other.
first = pattern_image(plans["four images"].patterns[0], SHAPE)
print(f"grey values {first.min()} to {first.max()}, {first.shape[1]} x {first.shape[0]} px")
