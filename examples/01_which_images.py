"""Which images does a rig need, and how well will it measure? Before anything is built."""

import numpy as np

from fringe3d import plot
from fringe3d.design import Quality, assess
from fringe3d.simulate import PRESETS

for name in ("kolibri", "designed"):
    preset = PRESETS[name]((320, 256))  # or read_rig(Path("rig.toml")) of fringe3d.io.rigfile
    design = assess(
        preset.rig,
        period_px=preset.period_px,
        angle=preset.fringe_angle,
        quality=Quality(n_shifts=4, noise=0.01),  # 1 % of the modulation
    )
    print(f"{name}: {preset.about}")
    print(f"  angle between the cameras {np.degrees(design.angle_c1c2):.1f} deg")
    print(
        f"  periods on a segment in the projector: up to {np.nanmax(design.projector_periods):.2f}"
    )
    print(f"  Gray code that tells them apart: {design.bits} cyclic images")
    print(f"  predicted sigma of a point {1000 * design.uncertainty.median_mm:.1f} um (median)")
    margin = np.nanmedian(design.margins.margin[0])  # surfaces that face the rig
    print(f"  without a code, C2 misses a wrong order by {margin:.3f} periods (median)")
    plot.rig(preset.rig).save(f"rig-{name}.png", overwrite=True)
