"""``fringe3d merge --recalibrate``: the rig again from the overlaps of its own views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fringe3d.cli.console import Reporter
from fringe3d.errors import MethodError
from fringe3d.model import Registration, Rig, Scan, SurfaceView, TableAxis
from fringe3d.options import MeasureOptions

if TYPE_CHECKING:
    from fringe3d.cli.measuring_views import Source
    from fringe3d.register import TablePrior
    from fringe3d.rig_from_views import RigFromViews

RIG_FILE = "rig.toml"


def require_scans(sources: Sequence[Source], /) -> None:
    """Raise MethodError where a source holds points alone: what the cameras saw is needed."""
    results = [source.name for source in sources if source.is_result]
    if results:
        raise MethodError(
            f"--recalibrate: expected scans with their images, found results: {', '.join(results)}."
            " Name the scan folders"
        )


def recalibrated(
    sources: Sequence[Source],
    views: Sequence[SurfaceView],
    found: Registration,
    prior: TablePrior | None,
    options: MeasureOptions,
    reporter: Reporter,
    /,
) -> RigFromViews:
    """Decode all scans, and find their rig again.

    Parameters
    ----------
    sources : sequence of Source; scans, one for each view
    views : sequence of SurfaceView; registered
    found : Registration
    prior : TablePrior or None; how good the table is
    options : MeasureOptions
    reporter : Reporter

    Raises
    ------
    MethodError
        If scans have different rigs.
    """
    from fringe3d.io.recording import read_scan
    from fringe3d.rig_from_views import rig_from_views
    from fringe3d.self_calibration import recorded_homologous

    points, rig = [], None
    for number, source in enumerate(sources):
        reporter.step("decoding scans", number, len(sources))
        scan = read_scan(source.path, images=source.images, rig=source.rig)
        rig = _same(source, scan, rig)
        points.append(recorded_homologous(scan, rig, options))
    assert rig is not None
    result = rig_from_views(points, views, rig, found, prior, step=reporter.step)
    told = f"{rig.provenance}; recalibrated from {len(views)} views".removeprefix("; ")
    return replace(result, rig=replace(result.rig, provenance=told))


def _same(source: Source, scan: Scan, rig: Rig | None) -> Rig:
    from fringe3d.io.rigfile import rig_text

    if scan.rig is None:
        raise MethodError(f"{source.path}: expected a rig, found none. Name one with --rig")
    if rig is not None and rig_text(scan.rig) != rig_text(rig):
        raise MethodError(
            f"--recalibrate: expected one rig for all scans, found another in {source.path}. Name "
            "one with --rig"
        )
    return scan.rig


def with_rig(sources: Sequence[Source], rig: Rig, folder: Path, /) -> list[Source]:
    """Return the sources with a rig that is kept in a folder."""
    from fringe3d.io.atomic import write_text
    from fringe3d.io.rigfile import rig_text

    path = folder / RIG_FILE
    write_text(path, rig_text(rig), overwrite=True)
    return [replace(source, rig=path) for source in sources]


def axis_if_known(path: Path | None, /) -> TableAxis | None:
    """Return the axis of a table file; None where there is no file."""
    from fringe3d.io.tablefile import read_table_axis

    return read_table_axis(path) if path is not None else None
