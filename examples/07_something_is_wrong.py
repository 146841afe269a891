"""What is wrong with a scan, and what can be mended afterwards."""

from dataclasses import replace

import numpy as np

from fringe3d.diagnosis import diagnose
from fringe3d.pipeline import measure
from fringe3d.self_calibration import self_calibrate
from fringe3d.simulate import knocked, simulate

scan, truth = simulate("kolibri", "machine-part", "m0", size=(320, 256), seed=7)

# Two images of one camera were exchanged on their way to the disk.
first, second = (stack.subset(range(11)) for stack in scan.stacks)  # one direction is enough here
images = first.images[[0, 2, 1, *range(3, 11)]]
for fault in diagnose(replace(scan, stacks=(replace(first, images=images), second))).faults:
    print(f"{fault.kind.value}: {fault.text}. {fault.cure}")

# The second camera was knocked after the calibration: the rig says where it stood before.
old = knocked(scan.rig, "c2", turn_deg=0.05, shift_mm=0.1, seed=7)
moved = replace(scan, rig=old)
result = measure(moved)
for finding in result.warnings:
    print(f"{finding.level}: {finding.text}")


def error_um(points_mm: np.ndarray) -> float:
    """Return the median distance from the truth."""
    return 1000 * float(np.nanmedian(np.linalg.norm(points_mm - truth.points_mm, axis=-1)))


# The scan itself tells where all devices stand now; no target is needed.
mended = self_calibrate([moved], old)
again = measure(replace(scan, rig=mended.rig))
print(f"from the truth: {error_um(result.points.points_mm):.0f} um with the old calibration,")
print(f"{error_um(again.points.points_mm):.0f} um with the poses that the scan shows")
