"""A session gives what `measure` gives, from several threads and from kept files, too."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from closed_form import Recording
from fringe3d.correspond import curves
from fringe3d.errors import MethodError
from fringe3d.io.cache import SWITCH
from fringe3d.model import Rig, Scan
from fringe3d.pipeline import Measurement, MeasureOptions, measure
from fringe3d.session import Session

M2 = MeasureOptions(method="m2", gray_bits=3)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep what sessions keep in a folder of the test, and nothing in memory."""
    monkeypatch.setenv(SWITCH, str(tmp_path / "cache"))
    monkeypatch.setattr(curves, "_STORE", curves._Store())
    return tmp_path / "cache"


@pytest.fixture
def scan(recording: Recording, rig: Rig) -> Scan:
    return replace(recording[0], rig=rig)


def assert_same(one: Measurement, other: Measurement) -> None:
    assert one.points is not None
    assert other.points is not None
    np.testing.assert_array_equal(one.points.points_mm, other.points.points_mm)
    np.testing.assert_array_equal(one.points.sigma_mm, other.points.sigma_mm)
    np.testing.assert_array_equal(one.points.rejection, other.points.rejection)


@pytest.mark.parametrize("options", [MeasureOptions(), M2])
def test_results_are_those_of_measure(scan: Scan, options: MeasureOptions) -> None:
    expected = measure(scan, options)
    session = Session(scan.rig, scan.stacks[0].plan, options)
    for _ in range(2):
        assert_same(session.measure(scan.stacks), expected)


def test_what_the_rig_fixes_is_read_from_the_file_of_a_former_run(
    scan: Scan, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = scan.stacks[0].plan
    first = Session(scan.rig, plan).measure(scan.stacks)
    assert list(folder.glob("*-curves.npy"))
    monkeypatch.setattr(curves, "_STORE", curves._Store())
    monkeypatch.setattr(curves, "_traced", None)  # computing again would fail
    assert_same(Session(scan.rig, plan).measure(scan.stacks), first)


def test_another_rig_has_other_files(scan: Scan, folder: Path) -> None:
    assert scan.rig is not None
    plan, projector = scan.stacks[0].plan, scan.rig.projector
    assert projector is not None
    Session(scan.rig, plan).measure(scan.stacks)
    n = len(list(folder.iterdir()))
    other = replace(scan.rig, projector=replace(projector, focal_px=projector.focal_px * 1.0001))
    Session(other, plan).measure(scan.stacks)
    assert len(list(folder.iterdir())) == 2 * n


def test_several_threads_measure_at_the_same_time(scan: Scan) -> None:
    session = Session(scan.rig, scan.stacks[0].plan, M2)
    dark = tuple(replace(s, images=s.images - s.images // 8) for s in scan.stacks)
    expected = [measure(replace(scan, stacks=s), M2) for s in (scan.stacks, dark)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(session.measure, [scan.stacks, dark] * 4))
    for number, result in enumerate(found):
        assert_same(result, expected[number % 2])


@pytest.mark.parametrize("options", [MeasureOptions(), M2])
def test_results_do_not_depend_on_the_number_of_threads(
    scan: Scan, options: MeasureOptions
) -> None:
    """Bit for bit."""
    if numba.config.NUMBA_NUM_THREADS < 2:  # type: ignore[attr-defined]
        pytest.skip("one processor")
    before, found = numba.get_num_threads(), []
    try:
        for n_threads in (1, 2):
            numba.set_num_threads(n_threads)
            found.append(measure(scan, options))
    finally:
        numba.set_num_threads(before)
    assert_same(*found)


def test_images_of_another_plan_are_refused(scan: Scan) -> None:
    session = Session(scan.rig, scan.stacks[0].plan)
    stacks = [stack.subset(range(4)) for stack in scan.stacks]
    with pytest.raises(MethodError, match="another plan of 4"):
        session.measure(stacks)
