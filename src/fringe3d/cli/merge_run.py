"""What ``fringe3d merge`` does, step by step."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringe3d import __version__
from fringe3d.cli.console import Reporter
from fringe3d.cli.measuring_views import Measured, Source, measure_views
from fringe3d.cli.recalibrating import (
    RIG_FILE,
    axis_if_known,
    recalibrated,
    require_scans,
    with_rig,
)
from fringe3d.errors import MethodError
from fringe3d.io.atomic import new_folder, require_writable
from fringe3d.model import MergedCloud, Registration, Rig, SurfaceMesh
from fringe3d.options import MeasureOptions

if TYPE_CHECKING:
    from fringe3d.evaluate import Deviations
    from fringe3d.register.registering import Angles
    from fringe3d.rig_from_views import RigFromViews

FORMATS = ("ply", "stl", "obj", "e57")
SCAN_MARKS = ("scan.toml", "measure.toml")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeOptions:
    """What the user said on the command line; see ``fringe3d merge --help``."""

    scans: Sequence[Path]
    out: Path
    angles: Angles
    turns_deg: tuple[float, ...] | None
    axis: Path | None
    rig: Path | None
    images: Path | None
    mesh: str
    closed: bool
    formats: tuple[str, ...]
    reference: Path | None
    jobs: int | None
    skip_broken: bool
    keep_edges: bool
    despite_conflicts: bool
    recalibrate: bool
    overwrite: bool
    command: str
    measuring: MeasureOptions


def run_merge(options: MergeOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Measure, register, fuse, mesh, write; return what to print and the record."""
    from fringe3d.io.meshes import read_triangles
    from fringe3d.register import fuse, mesh_of, with_edges
    from fringe3d.report.deviations import deviation_record
    from fringe3d.report.merging import merge_record, merge_text, mesh_record, odd_texts
    from fringe3d.report.recalibration import recalibration_record

    sources = find_sources(options)
    inputs = [*options.scans, options.axis, options.reference]
    require_writable(options.out, overwrite=options.overwrite, inputs=inputs)
    triangles = read_triangles(options.reference) if options.reference else None
    measured, found, refound = _registered(sources, options, reporter)
    cloud = fuse(measured.views, found.body_from_view, noise_factor=found.noise_factor,
                 step=reporter.step)  # fmt: skip
    if measured.edges is not None:
        cloud = with_edges(cloud, measured.views, found.body_from_view, measured.edges)
    record = merge_record(measured.views, found, cloud)
    record |= {"title": f"{len(measured.views)} views merged", "command": options.command,
               "versions": {"fringe3d": __version__}, "broken": measured.broken,
               "kept_views": measured.n_kept, "out": str(options.out)}  # fmt: skip
    for view, about in zip(record["views"], measured.about, strict=True):
        view |= {key: about[key] for key in ("summary", "method", "images", "warnings")}
    if refound is not None:
        record["recalibration"] = recalibration_record(refound)
    record["warnings"] = [f"{name}: left out: {text}" for name, text in measured.broken.items()]
    mesh = None
    if options.mesh != "none":
        reporter.step("meshing", 0, 1)
        mesh = mesh_of(cloud, kind=options.mesh, closed=options.closed)  # type: ignore[arg-type]
        record["mesh"] = mesh_record(mesh, options.mesh)
    reference = None
    if triangles is not None:
        reporter.step("comparing", 0, 1)
        reference = _compared(cloud, triangles)
        record["reference"] = deviation_record(reference[1]) | {"file": str(options.reference)}
    rig = refound.rig if refound is not None and refound.is_off else None
    write_merge(options, measured, found, cloud, mesh, reference, record, rig=rig)
    for text in (*odd_texts(record), *record["warnings"]):
        reporter.warn(text)
    return f"{merge_text(record)}\n-> {options.out}", record


def _registered(
    sources: Sequence[Source], options: MergeOptions, reporter: Reporter, /
) -> tuple[Measured, Registration, RigFromViews | None]:
    """Measure and register; with a rig that was off, and is found again, once more."""
    from fringe3d.register import RegisterOptions, register, table_prior

    if options.recalibrate:
        require_scans(sources)
    wanted = RegisterOptions(angles=options.angles, axis=axis_if_known(options.axis),
                             despite_conflicts=options.despite_conflicts)  # fmt: skip
    measured = _measured(sources, options, reporter)
    found = register(measured.views, wanted, step=reporter.step)
    if not options.recalibrate:
        return measured, found, None
    whole = [source for source in sources if source.name not in measured.broken]
    prior = table_prior(measured.views, wanted)
    again = recalibrated(whole, measured.views, found, prior, options.measuring, reporter)
    if again.is_off:
        measured = _measured(with_rig(sources, again.rig, _views_folder(options)), options,
                             reporter)  # fmt: skip
        start = found.body_from_view if len(measured.views) == len(whole) else None
        found = register(measured.views, wanted, start=start, step=reporter.step)
    return measured, found, again


def find_sources(options: MergeOptions, /) -> list[Source]:
    """Return the scans that are named, in their order; folders of several are opened.

    Raises
    ------
    MethodError
        If there are none, or a number of angles that does not fit.
    """
    paths = [path for named in options.scans for path in _scans_in(named)]
    if len(paths) < 2:
        raise MethodError(
            f"merge: expected two scans or more, found {len(paths)}. Name scan folders, results of "
            "fringe3d measure, or a folder that holds them"
        )
    turns = options.turns_deg
    if turns is not None and len(turns) != len(paths):
        raise MethodError(
            f"--turns: expected an angle for each of the {len(paths)} scans, found {len(turns)}"
        )
    names = _names(paths)
    return [
        Source(name=name, path=path, images=options.images, rig=options.rig,
               angle_deg=None if turns is None else turns[k])
        for k, (name, path) in enumerate(zip(names, paths, strict=True))
    ]  # fmt: skip


def _scans_in(named: Path) -> list[Path]:
    if named.is_dir() and not any((named / mark).is_file() for mark in SCAN_MARKS):
        inside = [f for f in sorted(named.iterdir())
                  if any((f / mark).is_file() for mark in SCAN_MARKS)]  # fmt: skip
        if not inside:
            raise MethodError(
                f"{named}: expected a scan (scan.toml), a result (measure.toml) or a folder of "
                "them, found none. Check the path"
            )
        return inside
    if not named.exists():
        raise MethodError(f"{named}: expected a scan or a result, found nothing. Check the path")
    return [named]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that tell them apart."""
    plain = [path.stem if path.is_file() else path.name for path in paths]
    if len(set(plain)) == len(plain):
        return plain
    return [f"{k:03d}-{name}" for k, name in enumerate(plain)]


def _measured(sources: Sequence[Source], options: MergeOptions, reporter: Reporter) -> Measured:
    folder = _views_folder(options)

    def finished(name: str, done: int, total: int) -> None:
        reporter.step("measuring scans", done, total)
        if not reporter.console.is_terminal:
            reporter.note(f"{done}/{total} {name}")

    jobs = options.jobs or _n_cores()
    measured = measure_views(
        sources,
        options.measuring,
        folder,
        jobs=jobs,
        finished=finished,
        keep_edges=options.keep_edges,
    )
    if measured.broken and not options.skip_broken:
        told = "; ".join(f"{name}: {text}" for name, text in measured.broken.items())
        raise MethodError(
            f"merge: expected scans that can be measured, found {len(measured.broken)} broken: "
            f"{told}. Mend them, or leave them out with --skip-broken; the others are kept in "
            f"{folder}"
        )
    return measured


def _views_folder(options: MergeOptions) -> Path:
    folder = _kept_beside(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _kept_beside(out: Path) -> Path:
    return out.with_name(f"{out.name}-views")


@contextmanager
def telling_what_is_kept(out: Path, /) -> Iterator[None]:
    """Let an interrupt say that the views that are measured are kept."""
    try:
        yield
    except KeyboardInterrupt as stop:
        folder = _kept_beside(out)
        if folder.is_dir() and any(folder.iterdir()):
            stop.add_note(f"the views measured so far are kept in {folder}: the same command goes "
                          "on with them")  # fmt: skip
        raise


def _n_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _compared(cloud: MergedCloud, triangles: Any) -> tuple[MergedCloud, Deviations]:
    """Fit the cloud to a reference mesh, and compare."""
    from fringe3d.evaluate.deviations import deviations_from_mesh
    from fringe3d.register.reference import fitted_to_mesh

    moved = fitted_to_mesh(cloud, triangles)
    placed = replace(cloud, points_mm=moved.apply(cloud.points_mm),
                     normals=moved.rotate(cloud.normals).astype(np.float32))  # fmt: skip
    reach = max(20 * float(np.median(cloud.sigma_mm)), 0.02 * float(np.ptp(triangles)))
    return placed, deviations_from_mesh(placed.points_mm, triangles, reach_mm=reach)


def write_merge(
    options: MergeOptions,
    measured: Measured,
    found: Registration,
    cloud: MergedCloud,
    mesh: SurfaceMesh | None,
    reference: tuple[MergedCloud, Deviations] | None,
    record: dict[str, Any],
    /,
    *,
    rig: Rig | None = None,
) -> None:
    """Write the body, completely or not at all; a rig that was found again beside it."""
    from fringe3d.io.rigfile import rig_text
    from fringe3d.io.surfaces import MESH_FORMATS, write_e57, write_merged_ply, write_mesh
    from fringe3d.io.tablefile import table_text
    from fringe3d.report.deviations import deviation_text
    from fringe3d.report.merge_pictures import draw_body, draw_overlaps, draw_reference, write_turn
    from fringe3d.report.merging import merge_markdown, merge_text
    from fringe3d.report.written import written_html

    comment = f"fringe3d {__version__}, mm"
    up = found.table.axis.direction if found.table is not None else UP
    up = up if up @ _towards_camera(measured) >= 0 else -up
    names = [view.name for view in measured.views]
    with new_folder(options.out, overwrite=options.overwrite) as folder:
        write_merged_ply(folder / "cloud.ply", cloud, comment=comment)
        if "e57" in options.formats:
            write_e57(folder / "cloud.e57", cloud)
        for kind in MESH_FORMATS:
            if mesh is not None and (kind in options.formats or kind == "ply"):
                write_mesh(folder / f"mesh.{kind}", mesh, comment=comment)
        if found.table is not None:
            sigmas = {key: record["table"][key] for key in ("shift_sigma_um", "lean_sigma_urad")}
            text = table_text(found.table.axis, **sigmas)
            (folder / "table.toml").write_text(text, encoding="utf-8")
        if rig is not None:
            (folder / RIG_FILE).write_text(rig_text(rig), encoding="utf-8")
        draw_body(folder / "overview.png", cloud, up, title=merge_text(record))
        draw_overlaps(folder / "overlaps.png", found, names)
        write_turn(folder / "turn.gif", cloud, up)
        pictures = [("From all sides", "turn.gif"), ("Surface", "overview.png"),
                    ("Overlaps", "overlaps.png")]  # fmt: skip
        if reference is not None:
            draw_reference(folder / "reference.png", *reference, up,
                           title=deviation_text(record["reference"]))  # fmt: skip
            pictures.append(("Deviation from the reference", "reference.png"))
        text = merge_markdown(record, pictures)
        (folder / "merge.md").write_text(text, encoding="utf-8")
        (folder / "merge.json").write_text(json.dumps(plain(record), indent=1) + "\n", "utf-8")
        (folder / "report.html").write_text(written_html(folder / "merge.md"), encoding="utf-8")


def _towards_camera(measured: Measured) -> Any:
    view = measured.views[0]
    return view.camera.center_world - np.nanmean(view.points_mm.reshape(-1, 3), axis=0)


def plain(value: Any, /) -> Any:
    """Return a record as JSON can hold it: no NaN."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def parse_turns(text: str | None, /) -> tuple[float, ...] | None:
    """Return the angles of ``--turns``, degrees.

    Examples
    --------
    >>> parse_turns("0,30,60")
    (0.0, 30.0, 60.0)
    """
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise MethodError(
            f"--turns: expected degrees with commas between, as 0,30,60, found '{text}'"
        ) from None


def parse_formats(text: str, /) -> tuple[str, ...]:
    """Return the formats of ``--formats``.

    Examples
    --------
    >>> parse_formats("ply,e57")
    ('ply', 'e57')
    """
    found = tuple(part.strip().lower() for part in text.split(","))
    unknown = [part for part in found if part not in FORMATS]
    if unknown:
        raise MethodError(
            f"--formats: expected some of {', '.join(FORMATS)} with commas between, found "
            f"'{unknown[0]}'"
        )
    return found
