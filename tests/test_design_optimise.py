"""Places of the projector: found, and what the command says about them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from cv_lens import cv_project
from fringe3d.cli import optimiser
from fringe3d.cli.console import Reporter
from fringe3d.cli.optimiser import legend, recommendation, table
from fringe3d.decode import wrapped_phase
from fringe3d.design.counts import (
    angle_without_code,
    periods_on_projector,
)
from fringe3d.design.margin import ambiguity_margins
from fringe3d.design.optimise import Candidate, Optimisation, optimise
from fringe3d.design.refine import Kind, refine
from fringe3d.design.residual import Quality, wrong_order_residuals
from fringe3d.design.search import survey
from fringe3d.design.stand import stand_of
from fringe3d.design.task import Limits, Task
from fringe3d.design.uncertainty import phase_noise, predict_uncertainty
from fringe3d.errors import RigError
from fringe3d.io.rigfile import read_rig
from fringe3d.model import PatternPlan, Rig
from fringe3d.model.plan import fringes
from fringe3d.options import MeasureOptions, Method
from fringe3d.patterns import sequence
from fringe3d.pipeline import measure

pytest.importorskip("embreex")

from fringe3d.simulate import OBJECTS, PRESETS, Setup, prepare, record
from fringe3d.simulate.perturb import perturbed

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]

PERIOD = 16.0
COARSE = Limits(spacing=math.radians(10.0), n_starts=1)
QUALITY = Quality()


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"]((640, 512)).rig


@pytest.fixture(scope="module")
def found(kolibri: Rig) -> Optimisation:
    return optimise(kolibri, period_px=PERIOD, slopes_deg=(0.0, 20.0, 40.0), limits=COARSE)


def by_name(found: Optimisation, name: str) -> Candidate:
    return next(c for c in found.candidates if c.name == name)


def test_four_images_are_found_to_be_enough(found: Optimisation) -> None:
    best = found.best
    assert best.is_enough
    assert best.ratio >= 6
    assert best.n_images == 4
    assert best.is_single
    assert not len(best.margins.orders)
    assert best.price < 1.15  # 1.05 with a finer search
    assert best.sigma_mm == pytest.approx(best.price * found.given.sigma_mm)
    given = found.given
    assert not given.is_enough
    assert given.n_images == 4 + 3  # two bits and the over-determined one
    assert given.ratio == 0


def test_all_candidates_but_the_papers_keep_the_limits(found: Optimisation) -> None:
    for candidate in found.candidates[1:]:
        separation = found.stand.separation(candidate.rig)
        assert candidate.separation == pytest.approx(separation)
        if candidate.name == "next to C1":
            assert not candidate.is_allowed
            continue
        assert candidate.is_allowed
        assert candidate.price <= 1.501
        if candidate.name != "turned":  # the given place need not respect them
            assert separation >= math.radians(8.0) - 1e-3
            assert candidate.tilt <= math.radians(35.0) + 1e-3
        assert found.limits is COARSE


@pytest.mark.parametrize(("kind", "limits"), [
    ("turned", Limits(spacing=0.2, n_starts=1, max_price=1.1)),
    ("moved and turned", Limits(spacing=0.2, n_starts=1, min_separation=math.radians(20.0))),
])  # fmt: skip
def test_narrow_limits_are_kept_while_places_are_refined(
    kolibri: Rig, kind: Kind, limits: Limits
) -> None:
    """Without them 1.16 times the standard deviation and 8 deg would be taken."""
    task = Task.of(kolibri, period_px=PERIOD, angle=0.0, slopes_deg=(20.0,), quality=QUALITY,
                   limits=limits, beyond=0.0)  # fmt: skip
    place = refine(task, kind, survey(task))[0]
    assert place.is_moved == (kind != "turned")
    moved = task.stand.placed(kolibri, place.tilt, place.azimuth) if place.is_moved else kolibri
    sigma = predict_uncertainty(moved, period_px=PERIOD, sigma_phase=phase_noise(4, 0.01),
                                angle=place.angle, step=32)  # fmt: skip
    assert sigma.median_mm / task.sigma_mm <= limits.max_price + 1e-3
    if place.is_moved:
        assert task.stand.separation(moved) >= limits.min_separation - 1e-3
        assert place.tilt <= limits.max_tilt + 1e-3


def test_each_kind_changes_only_what_it_may(kolibri: Rig, found: Optimisation) -> None:
    assert kolibri.projector is not None
    assert by_name(found, "turned").rig is kolibri
    assert by_name(found, "turned").angle != 0
    assert by_name(found, "moved").angle == 0
    for candidate in found.candidates:
        assert candidate.rig.cameras == kolibri.cameras
        assert candidate.rig.volume is kolibri.volume
    free = by_name(found, "moved and turned")
    assert free.ratio >= max(by_name(found, n).ratio for n in ("turned", "moved")) - 0.1
    one, several = by_name(found, "one period"), by_name(found, "several periods")
    assert one.periods < 1
    assert one.price <= free.price + 0.01
    assert several.periods >= 2
    assert not several.is_single


def test_several_periods_are_told_apart_where_they_can_be() -> None:
    """A face at 1.15 m: more than 4 periods at next to no price, by the margins of other pixels."""
    preset = PRESETS["face"]((640, 512))
    task = Task.of(preset.rig, period_px=PERIOD, angle=0.0, slopes_deg=(0.0, 20.0), quality=QUALITY,
                   limits=COARSE, beyond=0.0)  # fmt: skip
    place = refine(task, "several periods", survey(task))[0]
    rig = place.rig(task)
    periods = periods_on_projector(rig, period_px=PERIOD, angle=place.angle, step=8)
    assert np.nanmax(periods) > 2
    assert task.allows(rig, task.sigma_of(rig, place.angle) / task.sigma_mm)
    assert task.sigma_of(rig, place.angle) < 1.1 * task.sigma_mm
    margins = ambiguity_margins(
        rig, period_px=PERIOD, angle=place.angle, step_px=16, slopes_deg=(0, 10, 20)
    )
    assert len(margins.orders) >= 4
    assert margins.worst_ratio[-1] >= 6


def test_the_designed_preset_does_without_a_code() -> None:
    """As the optimiser promises: no wrong order, and enough certainty for slopes up to 40 deg."""
    preset = PRESETS["designed"]((640, 512))
    margins = ambiguity_margins(
        preset.rig, period_px=PERIOD, angle=preset.fringe_angle, slopes_deg=(0, 40), step_px=64
    )
    assert not len(margins.orders)
    assert margins.worst_ratio[-1] >= 6
    stand = stand_of(preset.rig)
    assert stand.separation(preset.rig) >= math.radians(8.0)


def test_the_papers_way_is_the_angle_without_code(kolibri: Rig, found: Optimisation) -> None:
    """As long as guard and the fringe period allow: max m + 2 guard is 1, and not above."""
    paper = by_name(found, "next to C1")
    guard = 3 * phase_noise(4, 0.01) / (2 * math.pi) + 0.1 / PERIOD
    # The angle is found to 2e-6 rad of 0.056: 4e-5 of a period.
    assert 1 - 1e-4 < paper.periods + 2 * guard < 1
    assert paper.is_single
    tau = angle_without_code(kolibri, period_px=PERIOD, guard=guard, step=8)
    assert paper.separation == pytest.approx(tau, abs=1e-6)


def test_a_bad_calibration_is_not_glossed_over(
    kolibri: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 0.5 px no place tells the orders apart, and that is said."""
    monkeypatch.setattr("fringe3d.design.refine.STEPS", 12)  # there is nothing to be found
    poor = Quality(calibration_px=0.5)
    coarser = Limits(spacing=math.radians(17.0), n_starts=1)
    found = optimise(kolibri, period_px=PERIOD, quality=poor, slopes_deg=(40.0,), limits=coarser)
    assert not found.best.is_enough
    assert all(c.n_images > 4 for c in found.candidates)
    said = recommendation(found, poor).replace("\n", " ")
    assert "No place was found where 4 images" in said
    assert "calibrate better than 0.5 px" in said
    assert "designed-rig.toml" not in optimiser.write_files(tmp_path, found)
    assert not (tmp_path / "designed-rig.toml").exists()


def test_what_is_missing_is_said(kolibri: Rig) -> None:
    for rig, what in (
        (replace(kolibri, cameras=kolibri.cameras[:1]), "two cameras"),
        (replace(kolibri, projector=None), "a projector"),
        (replace(kolibri, volume=None), "a measuring volume"),
    ):
        with pytest.raises(RigError, match=f"expected {what}"):
            optimise(rig, period_px=PERIOD)
    with pytest.raises(ValueError, match="limits: expected"):
        Limits(max_price=0.5)


def test_the_command_writes_the_rig_and_the_picture(
    kolibri: Rig, found: Optimisation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, object] = {}

    def known(_rig: Rig, **options: object) -> Optimisation:
        asked.update(options)
        return found

    monkeypatch.setattr(optimiser, "optimise", known)
    told = optimiser.run_optimise(kolibri, period_px=PERIOD, angle=0.3, quality=QUALITY, beyond=0.1,
                                  out=tmp_path, reporter=Reporter(quiet=True))  # fmt: skip
    assert (asked["period_px"], asked["angle"], asked["quality"]) == (PERIOD, 0.3, QUALITY)
    assert asked["beyond"] == 0.1
    assert "0 given" in told.text
    assert "next to C1 *" in told.text
    assert max(map(len, told.text.splitlines())) <= 105
    assert told.record["recommended"] == "one period"
    assert [c["name"] for c in told.record["candidates"]] == [c.name for c in found.candidates]
    json.dumps(told.record, allow_nan=False)
    said = told.advice
    assert said.startswith("4 images without a code, at tilt ")
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    rig = read_rig(tmp_path / "designed-rig.toml")
    assert rig.projector is not None
    tilt, azimuth = np.degrees(stand_of(rig).angles_of(rig.projector))
    assert f"tilt {tilt:.1f} deg, azimuth {azimuth:.1f} deg" in said.replace("\n", " ")
    assert rig.provenance.endswith("design --optimise")


def test_the_advice_tells_the_price_of_each_way(found: Optimisation) -> None:
    """One period, several periods, the paper's small angle; with the slopes each is good for."""
    said = recommendation(found, QUALITY)
    assert "('one period', sigma " in said
    assert ": no wrong order lies in the volume." in said
    paper, several = by_name(found, "next to C1"), by_name(found, "several periods")
    assert (
        f"The paper's way (M5), {math.degrees(paper.separation):.1f} deg from C1: 4 images on "
        f"slopes up to {math.degrees(paper.enough_slope):.0f} deg, sigma +2 %, beyond the limits."
    ) in said
    if not math.isnan(several.enough_slope):
        assert f"With {several.periods:.1f} periods on a segment (tilt " in said


def test_the_legend_says_why_a_code_helps_where_no_wrong_order_fits(found: Optimisation) -> None:
    """The paper's way is enough up to 20 deg; steeper, the calibration may cost C2 a period."""
    paper = by_name(found, "next to C1")
    assert paper.enough.tolist() == [True, True, False]
    assert paper.n_images == 4 + 2
    number = found.candidates.index(paper)
    said = " ".join(legend(found, QUALITY).split())
    assert f"{number} no wrong order fits, but a calibration error of 0.1 px" in said
    assert "* beyond the limits: nearer than 8 deg to a camera" in said


def test_the_table_has_a_row_for_each_candidate(found: Optimisation) -> None:
    lines = table(found).splitlines()
    assert len(lines) == 2 + len(found.candidates)
    assert lines[2].split()[:4] == ["0", "given", "22.0", "0.0"]
    assert lines[2].split()[-1] == "7"
    assert "+-4" in lines[2]
    assert "none" in lines[-1]


def test_predicted_residuals_are_found_in_images() -> None:
    """A prism, the projector beside C2, true normals. Next to its edges, on one pixel of ten, C2
    looks past the facet that is predicted from."""
    preset = PRESETS["kolibri"]((320, 256))
    rig = stand_of(preset.rig).placed(preset.rig, *np.radians([30.0, 23.0]))
    assert rig.projector is not None
    stage = prepare(rig, preset.scene(OBJECTS["prism"]()), Setup(n_rays=1))
    plan = PatternPlan(patterns=fringes(PERIOD, 4), projector_shape=rig.projector.shape)
    stacks = record(stage, plan, seed=1).stacks
    first, second = (
        np.asarray(wrapped_phase(stack, stack.plan.fringe_sets[0]).phase / (2 * np.pi), np.float64)
        for stack in stacks
    )
    truth = stage.truths[0]
    usable = truth.lit & truth.in_volume & truth.seen_by["c2"] & np.isfinite(first)
    points, normals = truth.points_mm[usable][::50], truth.normals[usable][::50]
    for j in (1, -1):
        predicted = wrong_order_residuals(rig, points, normals, [j], period_px=PERIOD)[:, 0]
        off = seen_residuals(rig, points, first[usable][::50], second, j) - predicted
        off = np.abs(off - np.rint(off))[np.isfinite(off)]
        assert len(off) > 400
        assert np.median(off) < 0.005
        assert (off < 0.02).mean() > 0.85


def seen_residuals(rig: Rig, points: Floats, phase: Floats, phase2: Floats, j: int) -> Floats:
    """Return the phase of C2 where the wrong order leads less that of C1, (n,) periods."""
    assert rig.projector is not None
    eye = rig.cameras[0].center_world
    along = (points - eye) / np.linalg.norm(points - eye, axis=-1, keepdims=True)
    steps = np.linspace(-15, 15, 301)
    places = np.empty_like(points)
    for number, point in enumerate(points):
        u = cv_project(rig.projector, point + steps[:, None] * along[number])[:, 0]
        periods = (u + 0.5) / PERIOD - phase[number]
        wanted = np.rint(np.interp(0.0, steps, periods)) + j
        up = 1 if periods[-1] > periods[0] else -1
        places[number] = point + np.interp(wanted, periods[::up], steps[::up]) * along[number]
    x, y = cv_project(rig.cameras[1], places).T
    phasor = np.exp(2j * np.pi * phase2)
    real, imaginary = (
        map_coordinates(part, [y, x], order=1, cval=np.nan) for part in (phasor.real, phasor.imag)
    )
    return np.asarray(np.arctan2(imaginary, real) / (2 * np.pi) - phase)


@pytest.mark.parametrize(("place", "method"), [
    ((19.6, -38.6, -12.6), "m5"),
    ((25.8, 48.9, 26.9), "m3"),
])  # fmt: skip
def test_four_images_measure_what_the_optimiser_found(
    place: tuple[float, float, float], method: Method
) -> None:
    """What it finds for `kolibri` with one period and with several (8): a plane, as the camera
    sees it, a calibration that is 0.1 px off, no code. Next to edges pixels mix two surfaces."""
    tilt, azimuth, angle = np.radians(place)
    preset = PRESETS["kolibri"]((640, 512))
    rig = stand_of(preset.rig).placed(preset.rig, tilt, azimuth)
    assert rig.projector is not None
    stage = prepare(rig, replace(preset, rig=rig).scene(OBJECTS["plane"](), background="none"),
                    Setup(n_rays=1))  # fmt: skip
    plan = sequence(rig.projector.shape, periods_px=(PERIOD,), n_shifts=4, angles=(float(angle),),
                    gray="none")  # fmt: skip
    assert plan.n_images == 4
    scan = replace(record(stage, plan, seed=3), rig=perturbed(rig, rms_px=0.1, seed=3))
    points = measure(scan, MeasureOptions(method=method)).points
    assert points is not None
    truth = stage.truths[0]
    seen = truth.lit & truth.is_object & truth.in_volume & truth.seen_by["c2"]
    # A wrong order is 3 mm off and more.
    off = np.linalg.norm(points.points_mm - truth.points_mm, axis=-1)
    assert (off[seen] < 0.3).mean() > 0.99
    assert (off[seen & points.is_valid] >= 0.3).mean() < 0.001
