"""What ``fringe3d view`` shows: results, or scans measured on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from fringe3d.cli.console import Reporter
from fringe3d.errors import MethodError
from fringe3d.io.atomic import require_writable, write_text
from fringe3d.io.stored import StoredResult, read_result
from fringe3d.model import PhaseMap

Shown = tuple[StoredResult, Callable[[], Mapping[str, PhaseMap]]]
"""A result, and a function that tells what the cameras saw."""


def shown_results(paths: Sequence[Path], /, *, quiet: bool = False) -> list[Shown]:
    """Read results; measure what is a scan.

    Raises
    ------
    Fringe3DError
        If one is neither, or has no points.
    """
    found = [_measured(path, quiet=quiet) if is_scan(path) else _read(path) for path in paths]
    for path, (stored, _) in zip(paths, found, strict=True):
        if stored.rejection.all():
            raise MethodError(f"{path}: expected points, found none. Look at overview.png")
    return found


def compared_with(reference: Path, stored: StoredResult, /) -> StoredResult:
    """Return a result that knows how far each of its points lies from a cloud or mesh.

    Raises
    ------
    Fringe3DError
        If the reference cannot be read, or nothing of it is near.
    """
    from fringe3d.cli.evaluating import deviations_of
    from fringe3d.io.clouds import CloudFile
    from fringe3d.report.cloud_data import DEVIATION

    valid = stored.rejection == 0
    center = None if stored.rig is None else stored.rig.cameras[0].center_world
    own = CloudFile(points_mm=stored.maps["points_mm"][valid].astype(float), viewpoint_mm=center)
    found, _ = deviations_of(own, reference, name=stored.folder)
    deviation = np.full(valid.shape, np.nan)
    deviation[valid] = found.signed_mm
    return replace(stored, maps=stored.maps | {DEVIATION: deviation})


def is_scan(path: Path, /) -> bool:
    """Tell whether a path is a scan file, or a folder with one and without a result."""
    if path.is_dir():
        return (path / "scan.toml").is_file() and not (path / "measure.toml").is_file()
    return path.suffix == ".toml"


def report_of(path: Path, /) -> tuple[str, list[Path]]:
    """Return the page of whatever is there to report, and the files that it must not replace.

    Raises
    ------
    MethodError
        If there is nothing to report.
    """
    from fringe3d.report.written import IN_FOLDERS, written_html, written_report

    if path.is_dir() and (path / "measure.toml").is_file():
        from fringe3d.report.measurement import report_html

        return report_html(read_result(path)), _inputs(path)
    written = written_report(path)
    if written is not None:
        return written_html(written), [path, written]
    if path.is_dir() or not path.exists():
        stored = read_result(path)  # says what is missing
        raise MethodError(f"{stored.folder}: expected one of {', '.join(IN_FOLDERS)}, found none")
    raise MethodError(
        f"{path}: expected a result folder, or a rig.toml with the report of its calibration "
        f"({path.stem}-board.md) beside, found neither. Name what fringe3d measure, design, "
        "calibrate or evaluate left"
    )


def _inputs(result: Path) -> list[Path]:
    """Return the files of a result that a page must not replace."""
    return [result / name for name in ("measure.toml", "points.npz", "rig.toml")]


def write_page(html: Path, found: Sequence[Shown], points: int, /, *, overwrite: bool) -> int:
    """Write the points of one result as a page; return its bytes.

    Raises
    ------
    MethodError
        If there are several.
    """
    from fringe3d.report.measurement import cloud_html

    if len(found) > 1:
        raise MethodError(
            f"--html: expected one result for a page, found {len(found)}. Write a page for each"
        )
    stored = found[0][0]
    require_writable(html, overwrite=overwrite, inputs=_inputs(stored.folder))
    text = cloud_html(stored, most_points=points)
    write_text(html, text, overwrite=overwrite)
    return len(text.encode())


def _read(path: Path) -> Shown:
    def phases(stored: StoredResult) -> Mapping[str, PhaseMap]:
        from fringe3d.view.phases import seen_phases

        return seen_phases(stored)

    stored = read_result(path)
    return stored, partial(phases, stored)


def _measured(path: Path, *, quiet: bool) -> Shown:
    from fringe3d.io.recording import read_scan
    from fringe3d.options import MeasureOptions
    from fringe3d.pipeline import measure
    from fringe3d.report.folder import stored_result

    options = MeasureOptions()
    with Reporter(quiet=quiet).running() as reporter:
        scan = read_scan(path, progress=reporter.step)
        result = measure(scan, options, stage=reporter.stage)
    if result.points is None:
        raise MethodError(
            f"{path}: expected points, found phases alone: the scan has no rig. Name one in its "
            "scan.toml"
        )
    stored = replace(stored_result(scan, options, result), folder=path)
    seen = {c.device_name: c.directions[0].main for c in result.phases}
    return stored, lambda: seen
