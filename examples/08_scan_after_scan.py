"""Many scans with one rig: what depends on the rig alone is computed once, threads share it."""

import time
from concurrent.futures import ThreadPoolExecutor

from fringe3d.patterns import method_plan
from fringe3d.pipeline import MeasureOptions
from fringe3d.session import Session
from fringe3d.simulate import OBJECTS, PRESETS, prepare, record

N_SCANS = 3

preset = PRESETS["kolibri"]((320, 256))
plan = method_plan("m2", preset.rig.projector.shape, period_px=16, reduced_bits=3)
stage = prepare(preset.rig, preset.scene(OBJECTS["machine-part"]()))
scans = [record(stage, plan, seed=8, position=number) for number in range(N_SCANS)]

session = Session(preset.rig, plan, MeasureOptions(method="m2"))
session.measure(scans[0].stacks)  # the first one pays for the rig

start = time.perf_counter()
with ThreadPoolExecutor(max_workers=2) as threads:
    results = list(threads.map(session.measure, [scan.stacks for scan in scans]))
seconds = time.perf_counter() - start

for number, result in enumerate(results):
    print(f"scan {number}: {result.points.n_points:,} points, {len(result.warnings)} warnings")
print(f"{N_SCANS / seconds:.1f} scans a second")
