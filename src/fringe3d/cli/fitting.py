"""``fringe3d evaluate fit``: a plane, sphere, cylinder or cone through the points of a cloud."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, at_least
from fringe3d.cli.simulated import evaluate
from fringe3d.errors import MethodError

if TYPE_CHECKING:
    from fringe3d.evaluate import Fit
    from fringe3d.io.clouds import CloudFile

REJECTED_PART = 0.003
"""As acceptance allows."""


@evaluate.command
def fit(
    cloud: Path,
    surface: Literal["plane", "sphere", "cylinder", "cone"],
    /,
    *,
    box: str | None = None,
    left_out: Annotated[float, Parameter(validator=at_least(0, 0.49))] = REJECTED_PART,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Fit a plane, sphere, cylinder or cone to a cloud: its numbers, their sigma, and its form.

    All points count, so cut the cloud to the surface, with --box or before. Leaves fit.md,
    fit.json (with the covariance), overview.png and deviations.ply (coloured) in OUT.
    Example: fringe3d evaluate fit result cylinder --box=-20:20,-15:15,5:30 --out bore

    Parameters
    ----------
    cloud
        A result folder, or a cloud of any program (PLY, XYZ, NPZ), mm.
    surface
        What is fitted.
    box
        X0:X1,Y0:Y1,Z0:Z1, mm: only points within count; an end may be left away.
    left_out
        Part of the points that may be left out, those that lie farthest off: 0.003 as acceptance
        allows.
    out
        Folder for report and picture; must not exist yet.
    """
    from fringe3d.evaluate import fit_cone, fit_cylinder, fit_plane, fit_sphere
    from fringe3d.io.atomic import require_writable
    from fringe3d.io.clouds import read_cloud
    from fringe3d.report.fitted import fit_record, fit_text, write_fit

    if out is not None:
        require_writable(out, overwrite=overwrite, inputs=(cloud,))
    points = _within(read_cloud(cloud), box, cloud)
    fits: dict[str, Callable[..., Fit[Any]]] = {
        "plane": fit_plane,
        "sphere": fit_sphere,
        "cylinder": fit_cylinder,
        "cone": fit_cone,
    }
    with Reporter(quiet=as_json).running() as reporter:
        reporter.step(f"fitting a {surface} to {len(points.points_mm):,} points", 0, 1)
        try:
            found = fits[surface](points.points_mm, rejected_part=left_out)
        except ValueError as problem:
            raise MethodError(f"{cloud}: {problem}. Cut the cloud to the surface (--box)") from None
    record = fit_record(points, found)
    record |= {"cloud": str(cloud), "box": box}
    if out is not None:
        view = np.zeros(3) if points.viewpoint_mm is None else points.viewpoint_mm
        command = shlex.join(["fringe3d", *sys.argv[1:]])
        write_fit(out, points.points_mm, view, found, record, command, overwrite=overwrite)
    place = f"\n-> {out}" if out is not None else ""
    say(fit_text(record) + place, record, as_json=as_json)


def _within(cloud: CloudFile, box: str | None, path: Path) -> CloudFile:
    """Return the points of a cloud within a box."""
    from fringe3d.io.clouds import CloudFile

    if box is None:
        return cloud
    ends = _ends(box)
    inside = ((cloud.points_mm >= ends[:, 0]) & (cloud.points_mm <= ends[:, 1])).all(axis=1)
    if not inside.any():
        low, high = cloud.points_mm.min(axis=0), cloud.points_mm.max(axis=0)
        spans = ",".join(f"{a:.1f}:{b:.1f}" for a, b in zip(low, high, strict=True))
        raise MethodError(f"--box: expected points of {path} within {box}, found none. The cloud "
                          f"fills {spans}")  # fmt: skip
    return CloudFile(
        points_mm=cloud.points_mm[inside],
        sigma_mm=None if cloud.sigma_mm is None else cloud.sigma_mm[inside],
        normals=None if cloud.normals is None else cloud.normals[inside],
        viewpoint_mm=cloud.viewpoint_mm,
    )


def _ends(box: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the ends (3, 2) of a box, infinite where none is given."""
    sides = [side.split(":") for side in box.split(",")]
    try:
        ends = np.array([
            [float(end) if end.strip() else infinite
             for end, infinite in zip(side, (-np.inf, np.inf), strict=True)]
            for side in sides
        ])  # fmt: skip
    except ValueError:
        ends = np.empty(0)
    if ends.shape != (3, 2) or not (ends[:, 0] < ends[:, 1]).all():
        raise MethodError(f"--box: expected X0:X1,Y0:Y1,Z0:Z1 in mm, as --box=-20:20,-15:15,5:, "
                          f"each end above its beginning, found '{box}'")  # fmt: skip
    return ends
