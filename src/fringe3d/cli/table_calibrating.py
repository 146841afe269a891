"""``fringe3d calibrate table``: the axis of a rotary table from a ball that goes around on it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fringe3d.cli.calibrating import calibrate
from fringe3d.cli.console import say
from fringe3d.cli.parameters import Json, Overwrite, at_least


@calibrate.command
def table(
    *,
    ball: Annotated[list[Path], Parameter(negative=())],
    diameter: Annotated[float, Parameter(validator=at_least(1e-6))],
    out: Path,
    turns: str | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the axis of a rotary table from a ball at three positions or more.

    Leaves table.toml for fringe3d merge --axis. A merge of any body finds the axis as well, and
    leaves a table.toml, too.
    Example: fringe3d calibrate table --ball r0 --ball r1 --ball r2 --diameter 20.003
    --turns 0,120,240 --out table.toml

    Parameters
    ----------
    ball
        A result that shows the ball (fringe3d measure, or a cloud of any program), in the order in
        which the table turned; repeat it.
    diameter
        Of the ball, mm.
    out
        The table file.
    turns
        Angles of the table, degrees, with commas between, where they are known.
    """
    import numpy as np

    from fringe3d.cli.merge_run import parse_turns
    from fringe3d.errors import MethodError
    from fringe3d.evaluate import probe_spheres
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.clouds import read_cloud
    from fringe3d.io.tablefile import table_text
    from fringe3d.register import axis_of_points

    require_writable(out, overwrite=overwrite, inputs=ball)
    told = parse_turns(turns)
    if told is not None and len(told) != len(ball):
        raise MethodError(
            f"--turns: expected an angle for each of the {len(ball)} balls, found {len(told)}"
        )
    centers = np.array([
        probe_spheres(read_cloud(path).points_mm, diameter)[0].fit.surface.center_mm
        for path in ball
    ])  # fmt: skip
    axis = axis_of_points(centers, angles=None if told is None else np.radians(told))
    radii = axis.distance_mm(centers)
    heights = centers @ axis.direction
    beside = 1000 * float(np.hypot(radii - radii.mean(), heights - heights.mean()).max())
    write_text(out, table_text(axis), overwrite=overwrite)
    record = {
        "point_mm": axis.point_mm.tolist(), "direction": axis.direction.tolist(),
        "radius_mm": float(radii.mean()), "beside_um": beside, "out": str(out),
    }  # fmt: skip
    point, way = (
        ", ".join(f"{round(x, 4) + 0.0:.4f}" for x in v) for v in (axis.point_mm, axis.direction)
    )
    say(
        f"axis through ({point}) mm, direction ({way}); {len(ball)} places of the ball on a circle "
        f"of {radii.mean():.3f} mm, at most {beside:.1f} um beside\n-> {out}",
        record, as_json=as_json,
    )  # fmt: skip
