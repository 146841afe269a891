"""Many scans to views: measured in parallel, kept by hash, broken ones named."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringe3d.errors import Fringe3DError, MethodError
from fringe3d.io.viewfile import camera_of, camera_table, read_view, view_key, write_view
from fringe3d.model import SurfaceView, TablePosition
from fringe3d.options import MeasureOptions

if TYPE_CHECKING:
    from fringe3d.register import EdgePoints

THREADS = "NUMBA_NUM_THREADS"
DIGITS_OF_KEY = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A scan to measure, or a result that is there.

    Parameters
    ----------
    name : str; short, for pictures and messages
    path : Path; scan folder, scan file or result folder
    images, rig : Path or None; as for ``fringe3d measure``
    angle_deg : float or None; where the user told it
    """

    name: str
    path: Path
    images: Path | None = None
    rig: Path | None = None
    angle_deg: float | None = None

    @property
    def is_result(self) -> bool:
        """Tell whether it was measured already."""
        return (self.path / "measure.toml").is_file()


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What came of the sources: views in their order, what broke, and what the checks said.

    `edges` are points beside edges, apart from the views; None where views hold them.
    """

    views: list[SurfaceView]
    edges: list[EdgePoints] | None
    about: list[dict[str, Any]]
    broken: dict[str, str]
    n_kept: int


def measure_views(
    sources: Sequence[Source],
    options: MeasureOptions,
    folder: Path,
    /,
    *,
    jobs: int,
    finished: Callable[[str, int, int], object],
    keep_edges: bool = False,
) -> Measured:
    """Measure what was not measured before; each view is written as soon as it is there.

    Parameters
    ----------
    sources : sequence of Source
    options : MeasureOptions
    folder : Path; where views are kept
    jobs : int; processes
    finished : called with a name, how many are done and how many there are
    keep_edges : bool; leave points beside edges in the views, as if they were as good as others
    """
    from fringe3d.register import split_edges

    files = [folder / f"{s.name}-{_key(s, options)}.npz" for s in sources]
    todo = [k for k, file in enumerate(files) if read_view(file) is None]
    n_kept, done = len(sources) - len(todo), len(sources) - len(todo)
    broken: dict[str, str] = {}
    works = [(sources[k], options, files[k]) for k in todo]
    for k, problem in _run(works, jobs):
        done += 1
        if problem:
            broken[sources[todo[k]].name] = problem
        finished(sources[todo[k]].name, done, len(sources))
    views, edges, about = [], [], []
    for source, file in zip(sources, files, strict=True):
        if source.name not in broken:
            view, told = _view(source, file)
            if not keep_edges:
                view, beside = split_edges(view)
                edges.append(beside)
            views.append(view)
            about.append(told)
    return Measured(views, None if keep_edges else edges, about, broken, n_kept)


def _key(source: Source, options: MeasureOptions) -> str:
    told = asdict(options)
    return view_key(source.path, (source.images, source.rig), told)[:DIGITS_OF_KEY]


def _run(
    works: Sequence[tuple[Source, MeasureOptions, Path]], jobs: int
) -> Iterator[tuple[int, str]]:
    """Yield the number of each finished work, and what went wrong."""
    if jobs == 1 or len(works) < 2:
        for number, work in enumerate(works):
            yield number, measure_one(*work)
        return
    context = multiprocessing.get_context("spawn")  # threads of the kernels do not survive a fork
    with (
        _one_thread_each(),
        ProcessPoolExecutor(min(jobs, len(works)), mp_context=context,
                            initializer=_ignore_interrupt) as pool,
    ):  # fmt: skip
        try:
            futures = {pool.submit(measure_one, *work): n for n, work in enumerate(works)}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers


@contextmanager
def _one_thread_each() -> Iterator[None]:
    before = os.environ.get(THREADS)
    os.environ[THREADS] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[THREADS]
        else:
            os.environ[THREADS] = before


def measure_one(source: Source, options: MeasureOptions, file: Path, /) -> str:
    """Measure a scan and keep its view; return what went wrong, nothing if nothing did."""
    try:
        arrays, about = _from_result(source) if source.is_result else _from_scan(source, options)
        write_view(file, arrays, about)
    except Fringe3DError as problem:
        return str(problem)
    return ""


def _from_scan(source: Source, options: MeasureOptions) -> tuple[dict[str, Any], dict[str, Any]]:
    from fringe3d.correspond import keep_curves
    from fringe3d.io.cache import mapped
    from fringe3d.io.recording import read_scan
    from fringe3d.pipeline import measure
    from fringe3d.report.folder import summary

    keep_curves(mapped)
    scan = read_scan(source.path, images=source.images, rig=source.rig)
    if scan.rig is None:
        raise MethodError(f"{source.path}: expected a rig, found none. Name one with --rig")
    result = measure(scan, options)
    assert result.points is not None
    camera = next(c for c in scan.rig.cameras if c.name == result.main.device_name)
    angle = None if scan.table is None else scan.table.angle
    return {
        "points_mm": result.points.points_mm,
        "sigma_mm": result.points.sigma_mm,
        "grey": grey_of(result.main.offset, result.points.is_valid),
    }, {
        "camera": camera_table(camera), "summary": summary(result),
        "method": result.method, "images": result.n_images,
        "warnings": [f.text for f in result.warnings],
        "angle": angle, "tilt": None if scan.table is None else scan.table.tilt,
    }  # fmt: skip


def _from_result(source: Source) -> tuple[dict[str, Any], dict[str, Any]]:
    from fringe3d.io.stored import read_result

    stored = read_result(source.path)
    if stored.rig is None:
        raise MethodError(f"{source.path}: expected a result with its rig.toml, found none")
    table = stored.record.get("table", {})
    good = stored.rejection == 0
    return {
        "points_mm": stored.maps["points_mm"],
        "sigma_mm": stored.maps["sigma_mm"],
        "grey": grey_of(stored.maps["offset"], good),
    }, {
        "camera": camera_table(stored.rig.cameras[0]),
        "summary": stored.record["summary"], "method": stored.record["method"],
        "images": stored.record["images_used"],
        "warnings": [f["text"] for f in stored.record["health"] if f["level"] != "ok"],
        "angle": np.radians(table["angle_deg"]) if "angle_deg" in table else None,
        "tilt": np.radians(table["tilt_deg"]) if "tilt_deg" in table else None,
    }  # fmt: skip


def grey_of(offset: Any, good: Any, /) -> Any:
    """Return brightness as 0 to 255, (row, col) uint8; white is the brightest percent."""
    known = np.nan_to_num(offset)
    top = max(float(np.percentile(known[good], 99)), 1.0) if good.any() else 1.0
    return np.clip(255 * known / top, 0, 255).astype(np.uint8)


def _view(source: Source, file: Path) -> tuple[SurfaceView, dict[str, Any]]:
    from fringe3d.register import surface_view

    stored = read_view(file)
    if stored is None:
        raise MethodError(f"{file}: expected a view that was just written, found none. Try again")
    arrays, about = stored
    angle, tilt = about["angle"], about["tilt"]
    if source.angle_deg is not None:
        angle = float(np.radians(source.angle_deg))
    is_turned = angle is not None or tilt is not None
    view = surface_view(
        source.name,
        camera_of(about["camera"]),
        arrays["points_mm"],
        arrays["sigma_mm"],
        arrays["grey"],
        position=TablePosition(angle=angle, tilt=tilt or 0.0) if is_turned else None,
    )
    return view, about
