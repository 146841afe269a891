"""Method M6 with more than four images or two cameras, on simulated scans against their truth."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fringe3d.cli.run import main
from fringe3d.errors import MethodError
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import PatternPlan, Rig, RigidTransform
from fringe3d.model.plan import fringes
from fringe3d.pipeline import Measurement, MeasureOptions, measure

pytest.importorskip("embreex")

from scipy.spatial.transform import Rotation

from fringe3d.simulate import OBJECTS, PRESETS, Stage, prepare, record
from fringe3d.simulate.perturb import perturbed

SIZE = (320, 256)
WRONG_MM = 0.5
"""Noise moves points by 0.02 mm; a wrong order by 6 mm and more."""

M6 = MeasureOptions(method="m6")


@pytest.fixture(scope="module")
def plane() -> Stage:
    """An isolated plane, on which C2 of a symmetric rig hardly tells orders apart."""
    made = PRESETS["kolibri"](SIZE)
    return prepare(made.rig, made.scene(OBJECTS["plane"](), background="none"))


def off(rig: Rig) -> Rig:
    """Return the rig calibrated 0.2 px off, but for a third camera."""
    wrong = perturbed(replace(rig, cameras=rig.cameras[:2]), rms_px=0.2, seed=1)
    return replace(wrong, cameras=(*wrong.cameras, *rig.cameras[2:]))


def judged(stage: Stage, result: Measurement) -> tuple[float, float]:
    """Return the part of the reference pixels that have a right point, and a wrong one."""
    assert result.points is not None
    truth = stage.truths[0]
    reference = truth.lit & truth.in_volume & truth.seen_by["c2"]
    error = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)[reference]
    return float((error < WRONG_MM).mean()), float((error >= WRONG_MM).mean())


def plan_of(stage: Stage, *periods_px: float) -> PatternPlan:
    assert stage.rig.projector is not None
    patterns = [p for period in periods_px for p in fringes(period, 4)]
    return PatternPlan(patterns=tuple(patterns), projector_shape=stage.rig.projector.shape)


def test_a_second_period(plane: Stage) -> None:
    scan = replace(record(plane, plan_of(plane, 16.0, 18.7), seed=1), rig=off(plane.rig))
    result = measure(scan, M6)
    right, wrong = judged(plane, result)
    assert right > 0.99
    assert wrong < 3e-4  # pixels on the border of the plane
    assert result.main.period_px == 16.0
    assert result.n_images == 8


def test_the_frame_before_goes_with_it(plane: Stage) -> None:
    scan = replace(record(plane, plan_of(plane, 16.0), seed=1), rig=off(plane.rig))
    # The plane came 0.4 mm nearer since: a tenth of the way that one order makes.
    before = plane.truths[0].points_mm + np.array([0.0, 0.0, -0.4])
    result = measure(scan, M6, previous_mm=before)
    right, wrong = judged(plane, result)
    assert right > 0.99
    assert wrong < 3e-4  # pixels on the border of the plane
    (told,) = (f for f in result.findings if f.name == "previous_part")
    assert (told.level, told.value > 0.99) == ("ok", True)


def test_a_frame_before_of_another_scene_is_outvoted_and_said(plane: Stage) -> None:
    """Two periods off along the rays of C1: the points are those of the images alone."""
    scan = replace(record(plane, plan_of(plane, 16.0), seed=1), rig=off(plane.rig))
    eye = plane.rig.cameras[0].center_world
    before = eye + 1.04 * (plane.truths[0].points_mm - eye)
    result = measure(scan, M6, previous_mm=before)
    _, wrong = judged(plane, result)
    assert wrong < 3e-4
    (told,) = (f for f in result.findings if f.name == "previous_part")
    assert told.level == "warning"


def test_a_frame_before_that_is_of_no_use_is_refused(plane: Stage) -> None:
    scan = record(plane, plan_of(plane, 16.0), seed=1)
    before = plane.truths[0].points_mm
    with pytest.raises(
        MethodError, match=r"expected points on the pixels of C1.*found \(9, 9, 3\)"
    ):
        measure(scan, M6, previous_mm=before[:9, :9])
    with pytest.raises(MethodError, match=r"expected method m6.*found m3"):
        measure(scan, MeasureOptions(method="m3"), previous_mm=before)


def test_a_third_camera() -> None:
    made = PRESETS["kolibri"](SIZE)
    c1 = made.rig.cameras[0]
    turn = RigidTransform(
        rotation=Rotation.from_euler("z", 100.0, degrees=True).as_matrix(), translation=np.zeros(3)
    )
    third = replace(c1, name="c3", device_from_world=c1.device_from_world @ turn.inverse())
    rig = replace(made.rig, cameras=(*made.rig.cameras, third))
    stage = prepare(rig, made.scene(OBJECTS["plane"](), background="none"))
    scan = record(stage, plan_of(stage, 16.0), seed=1)
    right, wrong = judged(stage, measure(replace(scan, rig=off(rig)), M6))
    assert right > 0.9
    assert wrong < 0.005


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "found none"), ((10, 12, 3), "256 x 320 pixels.*found 10 x 12")],
)
def test_a_frame_before_that_is_none_is_named(
    content: tuple[int, ...] | None, words: str, plane: Stage, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    scan = record(plane, plan_of(plane, 16.0), seed=1)
    write_scan(tmp_path / "scan", scan)
    before = tmp_path / "before"
    before.mkdir()
    if content is not None:
        np.savez(before / "points.npz", points_mm=np.zeros(content))
    with pytest.raises(SystemExit) as stop:
        main(["measure", str(tmp_path / "scan"), "--out", str(tmp_path / "out"), "--previous",
              str(before)])  # fmt: skip
    assert stop.value.code == 2
    assert re.search(words, " ".join(capsys.readouterr().err.split()))
    assert not (tmp_path / "out").exists()
