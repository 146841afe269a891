"""How long a simulated scan takes, and how well a measurement of it agrees with its truth.

python benchmarks/simulate.py          about two minutes; prints Markdown
"""

import time

import numpy as np

from fringe3d.patterns import method_plan
from fringe3d.pipeline import MeasureOptions, measure
from fringe3d.simulate import OBJECTS, PRESETS, Setup, prepare, record

WRONG_MM = 0.5
OBJECTS_SHOWN = ("plane", "prism", "two-bodies", "machine-part", "teeth")


def main() -> None:
    """Print both tables."""
    print("| machine part on kolibri | s |\n|---|---|")
    preset = PRESETS["kolibri"]((1280, 1024))
    start = time.perf_counter()
    scene = preset.scene(OBJECTS["machine-part"]())
    stage = prepare(preset.rig, scene, Setup(n_rays=4))
    print(f"| rays and truth, two cameras 1280 x 1024 | {time.perf_counter() - start:.1f} |")
    plan = method_plan("m0", (768, 1024), period_px=16, n_shifts=16)
    start = time.perf_counter()
    record(stage, plan, seed=1)
    print(f"| {plan.n_images} images (M0, 16 steps) | {time.perf_counter() - start:.1f} |\n")

    print("| object | method | images | found | wrong | median error / sigma |")
    print("|---|---|---|---|---|---|")
    for name in OBJECTS_SHOWN:
        preset = PRESETS["kolibri"]((640, 512))
        stage = prepare(preset.rig, preset.scene(OBJECTS[name]()))
        truth = stage.truths[0]
        scan = record(stage, method_plan("m1", (768, 1024), period_px=16, n_shifts=4), seed=1)
        for gray_bits, n_images in ((None, 11), (4, 8), (3, 7)):
            result = measure(scan, MeasureOptions(gray_bits=gray_bits)).points
            assert result is not None
            good = result.is_valid
            reference = truth.lit & truth.in_volume & truth.seen_by["c2"]
            error = np.linalg.norm(result.points_mm - truth.points_mm, axis=-1)
            found = (good & reference & (error < WRONG_MM)).sum() / reference.sum()
            wrong = (error[good] > WRONG_MM).mean()
            pull = np.median(error[good & reference] / result.sigma_mm[good & reference])
            method = "m1" if gray_bits is None else "m2"
            print(f"| {name} | {method} | {n_images} | {found:.1%} | {wrong:.2%} | {pull:.2f} |")


if __name__ == "__main__":
    main()
