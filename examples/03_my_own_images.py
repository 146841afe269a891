"""Measure images that another program recorded: one file beside them says what was projected.

Here they are simulated. With your own, write scan.toml by hand, or let `fringe3d import` ask.
"""

from pathlib import Path

import cv2

from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import rig_text
from fringe3d.pipeline import measure
from fringe3d.report.folder import summary
from fringe3d.simulate import simulate

SCAN_TOML = """
format = "fringe3d-scan/1"
title = "a prism, recorded by another program"
rig = "rig.toml"

[[cameras]]
name = "c1"
images = "left/shot{index:02d}.png"
first_index = 1

[[cameras]]
name = "c2"
images = "right/shot{index:02d}.png"
first_index = 1

[[sequence]]
kind = "fringes"
period_px = 16
n_shifts = 4

[[sequence]]
kind = "gray"    # cells of half a period, the most significant bit first
cell_px = 8
n_bits = 7
"""

# Somebody's folder: left/shot01.png ... right/shot11.png, and a calibration.
folder = Path("my-images")
recorded, _ = simulate("kolibri", "prism", "m1", size=(320, 256), seed=3)
for camera, stack in zip(("left", "right"), recorded.stacks, strict=True):
    (folder / camera).mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(stack.images[:11], start=1):
        cv2.imwrite(str(folder / camera / f"shot{number:02d}.png"), image)
(folder / "rig.toml").write_text(rig_text(recorded.rig), encoding="utf-8")

(folder / "scan.toml").write_text(SCAN_TOML, encoding="utf-8")
scan = read_scan(folder)
result = measure(scan)
print(summary(result))
for finding in result.findings:  # does the description fit the images?
    print(f"{finding.level}: {finding.text}")
