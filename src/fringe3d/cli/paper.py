"""The source paper's experiment, simulated: every method on the same images, judged by the truth.

Images are rendered with the true rig and measured with one that has small calibration errors.
One recording holds the images of all methods; each method gets exactly those of its own plan.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.cli.console import Reporter
from fringe3d.cli.paper_judge import judge_of, points_of
from fringe3d.cli.paper_trials import SETTINGS, Setting, own_images, plans_of, union_of
from fringe3d.cli.stage_cache import prepare_cached
from fringe3d.errors import Fringe3DError, MethodError
from fringe3d.evaluate import Verdict
from fringe3d.io.atomic import new_folder, require_writable
from fringe3d.model import Rig
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import measure
from fringe3d.report.paper import Entry, paper_markdown, paper_record, write_paper
from fringe3d.simulate import OBJECTS, PRESETS, CameraOptics, Preset, Setup, Stage, record
from fringe3d.simulate.perturb import perturbed

EXPOSURE = 1.15
"""A surface that faces the projector then reaches 0.95 of the highest grey value."""

PLANE_MODULATION = 96 / 255
"""Of the highest grey value, at that exposure; the noise is a part of it."""

FULL_WELL_E = 1e7
"""Electrons: the shot noise (0.06 DN) is small beside the noise that is asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperOptions:
    """What the user said on the command line; see ``fringe3d evaluate paper --help``.

    `jobs` is the number of processes that share the work; None for one on each core.
    """

    steps: tuple[int, ...]
    objects: tuple[str, ...]
    noise: float
    calibration_error_px: float
    seed: int
    camera_size: tuple[int, int]
    period_px: float | None
    out: Path | None
    overwrite: bool
    jobs: int | None = None


def run_paper(options: PaperOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Simulate, measure and judge; return the report and its figures, and write them if asked.

    Parameters
    ----------
    options : PaperOptions
    reporter : Reporter

    Returns
    -------
    str, dict
        Markdown, and the same figures as plain data.

    Raises
    ------
    MethodError
        If the options make no experiment.
    OutputError
        If the folder cannot be written.
    """
    _check(options)
    if options.out is not None:
        require_writable(options.out, overwrite=options.overwrite)
    entries = _all_tried(options, reporter)
    figures = paper_record(entries, conditions=_conditions(options))
    markdown = paper_markdown(
        entries, conditions=_sentences(options), with_pictures=options.out is not None
    )
    if options.out is not None:
        with new_folder(options.out, overwrite=options.overwrite) as folder:
            write_paper(folder, entries, markdown, figures)
    return markdown, figures


def parse_steps(text: str, /) -> tuple[int, ...]:
    """Return the numbers of ``--steps``, the largest first.

    Examples
    --------
    >>> parse_steps("4,16")
    (16, 4)
    """
    try:
        numbers = sorted({int(part) for part in text.split(",")}, reverse=True)
    except ValueError:
        numbers = []
    if not numbers or numbers[-1] < 3:
        raise MethodError(
            "--steps: expected numbers of phase steps from 3 on with commas between, as 16,4, "
            f"found '{text}'"
        )
    return tuple(numbers)


def _check(options: PaperOptions) -> None:
    unknown = [thing for thing in options.objects if thing not in OBJECTS]
    if unknown or not options.objects:
        raise MethodError(
            f"--objects: expected some of {', '.join(OBJECTS)} with commas between, found "
            f"'{','.join(unknown)}'. Correct the names"
        )


def _all_tried(options: PaperOptions, reporter: Reporter) -> list[Entry]:
    """Try everything, on all cores; the result does not depend on their number."""
    works = [(thing, number) for thing in options.objects for number in range(len(SETTINGS))]
    jobs = min(len(works), options.jobs or _n_cores())
    progress = _Progress(reporter, len(works))
    progress.begins(jobs)
    if jobs == 1:
        entries: list[Entry] = []
        for thing, number in works:
            entries += _work(options, thing, number)
            progress.finished(thing, number)
        return entries
    context = multiprocessing.get_context("spawn")  # threads of the kernels do not survive a fork
    with (
        _threads_for_each(jobs),
        ProcessPoolExecutor(jobs, mp_context=context, initializer=_ignore_interrupt) as pool,
    ):
        try:
            futures = {pool.submit(_work, options, *work): work for work in works}
            for future in as_completed(futures):
                future.result()
                progress.finished(*futures[future])
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise
    return [entry for future in futures for entry in future.result()]


class _Progress:
    """A bar on a terminal, a line for each finished part elsewhere: in a log, a pipe."""

    def __init__(self, reporter: Reporter, total: int) -> None:
        self._reporter, self._total, self._done = reporter, total, 0
        self._began = time.monotonic()

    def begins(self, jobs: int) -> None:
        """Tell how much there is to do."""
        self._tell(f"{self._total} scans to simulate and measure, {jobs} at a time")

    def finished(self, thing: str, number: int) -> None:
        """Tell which part is done."""
        self._done += 1
        setting, seconds = SETTINGS[number], time.monotonic() - self._began
        on = " on a table" if setting.background == "table" else ""
        self._tell(
            f"{self._done}/{self._total} {thing}{on}, rig {setting.preset} ({seconds:.0f} s)"
        )

    def _tell(self, text: str) -> None:
        self._reporter.step("simulating and measuring", self._done, self._total)
        if not self._reporter.console.is_terminal:
            self._reporter.note(text)


def _work(options: PaperOptions, thing: str, number: int) -> list[Entry]:
    return list(_tried(options, thing, SETTINGS[number]))


def _n_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers


@contextmanager
def _threads_for_each(jobs: int) -> Iterator[None]:
    """Let the processes started here share the cores: threads that outnumber them only wait."""
    before = dict(os.environ)
    threads = str(max(1, _n_cores() // jobs))
    os.environ |= {"NUMBA_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": "1"}
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _tried(options: PaperOptions, thing: str, setting: Setting) -> Iterator[Entry]:
    """Record one object on one rig, and yield what each method makes of it."""
    preset = PRESETS[setting.preset](options.camera_size)
    period = options.period_px or preset.period_px
    stage = _stage(preset, thing, setting.background, options)
    assert preset.rig.projector is not None
    shape = preset.rig.projector.shape
    plans = plans_of(setting.trials, options.steps, shape, period)
    together = union_of(plans.values())
    scan = record(stage, together, seed=options.seed)
    scan = replace(scan, rig=_calibrated(preset.rig, options))
    judge = judge_of(stage, period)
    reference: dict[int, NDArray[np.bool_]] = {}
    for (trial, steps), plan in plans.items():
        entry = Entry(method=trial.name, group=trial.group, thing=thing, steps=steps,
                      n_images=plan.n_images)  # fmt: skip
        try:
            points = points_of(
                measure(
                    own_images(scan, together, plan, trial),
                    MeasureOptions(
                        method=trial.method,
                        strict=trial.strict,
                        min_order_probability=trial.min_order_probability,
                    ),
                )
            )
        except Fringe3DError as problem:
            if steps not in reference:  # without M1 there is nothing to compare with
                raise
            yield replace(entry, failure=str(problem))
            continue
        reference.setdefault(steps, judge.verdicts(points) == Verdict.RIGHT)
        entry = judge.judged(entry, points, reference[steps])
        if thing == "plane" and trial.group == "paper":
            entry = replace(entry, plane=judge.plane(points))
        yield entry


def _stage(preset: Preset, thing: str, background: str, options: PaperOptions) -> Stage:
    noise = options.noise * PLANE_MODULATION
    optics = CameraOptics(
        exposure=EXPOSURE, full_well_e=FULL_WELL_E, read_noise_e=noise * FULL_WELL_E
    )
    scene = preset.scene(OBJECTS[thing](), background=background)
    return prepare_cached(preset.rig, scene, Setup(camera=optics), progress=_silent)


def _calibrated(rig: Rig, options: PaperOptions) -> Rig:
    """Return the rig as a calibration with small errors gives it."""
    try:
        return perturbed(rig, rms_px=options.calibration_error_px, seed=options.seed)
    except ValueError as problem:
        raise MethodError(f"--calibration-error-px: {problem}. Choose a smaller one") from None


def _silent(_work: str, _done: int, _total: int) -> None:
    pass


def _conditions(options: PaperOptions) -> dict[str, Any]:
    plain = asdict(options)
    return {key: plain[key] for key in plain if key not in ("out", "overwrite", "jobs")}


def _sentences(options: PaperOptions) -> str:
    width, height = options.camera_size
    sigma_dn = options.noise * PLANE_MODULATION * 255
    return (
        f"Rig `kolibri` (M5: `kolibri-m5`), cameras of {width} x {height} px, 8 bit. The noise of "
        f"a grey value is {100 * options.noise:g} % of the modulation of the fringes on the plane "
        f"({sigma_dn:.2g} of 255 grey values). Images are rendered with the true rig and measured "
        "with one whose poses and lenses have random errors: they displace points in C2 by "
        f"{options.calibration_error_px:g} px (rms over the volume). Seed {options.seed}. The "
        "object hangs in empty space, as in the paper nothing else is lit; the lit table has its "
        "own section."
    )
