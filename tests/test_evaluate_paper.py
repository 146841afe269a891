"""``fringe3d evaluate paper``: the judge against OpenCV, the images it hands out, what it writes.

Cameras are small, so fringes are wide (48 px): a period then covers nine camera pixels, and a
segment holds 1.4 periods. What the methods reach is not tested here but printed in the docs.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

pytest.importorskip("embreex")

from cv_lens import cv_project
from fringe3d.cli.console import Reporter
from fringe3d.cli.paper import PaperOptions, _stage, parse_steps, run_paper
from fringe3d.cli.paper_judge import Judge, judge_of
from fringe3d.cli.paper_trials import SETTINGS, own_images, plans_of, union_of
from fringe3d.errors import Fringe3DError, MethodError, OutputError
from fringe3d.evaluate import Score, Verdict
from fringe3d.model import Device, PatternPlan, PointMap, Rejection, Uniform
from fringe3d.patterns import method_plan
from fringe3d.report.paper import (
    COLORS,
    PAPER_IMAGES,
    Entry,
    PlaneFigures,
    draw_error_maps,
    paper_markdown,
)
from fringe3d.simulate import PRESETS, Stage, record

Floats = NDArray[np.float64]

PERIOD_PX = 48.0


def options(**changes: object) -> PaperOptions:
    """Return options of a small and quick experiment."""
    small = PaperOptions(
        steps=(4,), objects=("plane",), noise=0.01, calibration_error_px=0.05, seed=1,
        camera_size=(160, 128), period_px=PERIOD_PX, out=None, overwrite=False, jobs=1,
    )  # fmt: skip
    return replace(small, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def stage() -> Stage:
    return _stage(PRESETS["kolibri"]((160, 128)), "machine-part", "table", options())


@pytest.fixture(scope="module")
def judge(stage: Stage) -> Judge:
    return judge_of(stage, PERIOD_PX)


def column(device: Device, points_mm: Floats) -> Floats:
    """Return OpenCV's x in the image of a device, px."""
    return cv_project(device, points_mm)[:, 0]


def measured(points_mm: Floats, sigma_mm: float = 0.01) -> PointMap:
    """Return a measurement with these points; NaN where there is none."""
    there = np.isfinite(points_mm).all(-1)
    return PointMap(
        points_mm=points_mm,
        sigma_mm=np.where(there, sigma_mm, np.nan).astype(np.float32),
        skew_mm=np.zeros(there.shape, np.float32),
        rejection=np.where(there, 0, np.uint16(Rejection.NO_MATCH)).astype(np.uint16),
    )


def nothing(stage: Stage) -> Floats:
    return np.full((*stage.rig.cameras[0].shape, 3), np.nan)


def moved(stage: Stage, steps: float) -> Floats:
    """Return the true points, moved away from C1 along their rays by so many periods.

    The distance is found by bisection on OpenCV's projection into the projector.
    """
    assert stage.rig.projector is not None
    true = stage.truths[0].points_mm
    origin = stage.rig.cameras[0].center_world
    points = true.reshape(-1, 3)[np.isfinite(true).all(-1).ravel()]
    rays = (points - origin) / np.linalg.norm(points - origin, axis=-1, keepdims=True)
    start = column(stage.rig.projector, points)
    # From C1 the projector stands towards +x: what is farther off is lit from more to its left.
    far = np.full(len(points), 40.0 * np.sign(steps))
    near = np.zeros(len(points))
    for _ in range(50):
        middle = (near + far) / 2
        passed = np.abs(column(stage.rig.projector, points + middle[:, None] * rays) - start)
        beyond = passed > abs(steps) * PERIOD_PX
        near, far = np.where(beyond, near, middle), np.where(beyond, middle, far)
    result = np.full(true.shape, np.nan)
    result[np.isfinite(true).all(-1)] = points + near[:, None] * rays
    return result


@pytest.mark.parametrize(
    ("steps", "verdict"), [(-0.48, 1), (-0.53, 2), (0.42, 1), (0.5, 2), (1.0, 2), (0.0, 1)]
)
def test_half_a_period_in_the_projector_tells_right_from_wrong(
    stage: Stage, judge: Judge, steps: float, verdict: int
) -> None:
    """Towards C1 a period is a shorter step in depth, and sets the limit; here by 12 %."""
    seen = judge.seen
    found = judge.verdicts(measured(moved(stage, steps)))[seen]
    assert seen.sum() > 3000
    assert (found == verdict).mean() > 0.999


def test_the_pixels_that_count_are_those_lit_in_the_volume_and_seen_by_both(
    stage: Stage, judge: Judge
) -> None:
    truth = stage.truths[0]
    for part in (truth.lit, truth.in_volume, truth.is_object, truth.seen_by["c2"]):
        assert part[judge.seen].all()
        without = np.ones_like(part)
        for other in (truth.lit, truth.in_volume, truth.is_object, truth.seen_by["c2"]):
            without &= True if other is part else other
        assert (judge.seen == (without & part)).all()


def test_a_pixel_on_the_border_is_judged_by_the_nearest_that_sees_the_object(
    stage: Stage, judge: Judge
) -> None:
    """It mixes the light of both. Farther off, a point of the object is a false one."""
    truth = stage.truths[0]
    own = truth.is_object & truth.in_volume
    row, col = next(
        (r, c) for r, c in np.argwhere(own)
        if 8 < c < 150 and own[r - 2 : r + 3, c - 3 : c + 1].all()
        and not own[r - 4 : r + 5, c + 1 : c + 6].any()
    )  # fmt: skip
    depth = np.linalg.norm(truth.points_mm[row, col] - judge.origin_mm)
    points = nothing(stage)
    for beside in (1, 2, 4):
        ray = truth.points_mm[row, col + beside] - judge.origin_mm
        points[row, col + beside] = judge.origin_mm + depth * ray / np.linalg.norm(ray)
    found = judge.verdicts(measured(points))
    assert found[row, col + 1 : col + 5].tolist() == [1, 1, 0, 2]


def test_figures_of_a_measurement_are_counts_of_its_pixels(stage: Stage, judge: Judge) -> None:
    """Every third seen pixel is missing, every fifth a period too far; ten points on the table."""
    truth = stage.truths[0]
    seen = np.argwhere(judge.seen)
    points = nothing(stage)
    true, wrong = truth.points_mm, moved(stage, 1.0)
    for number, (row, col) in enumerate(seen):
        if number % 3:
            points[row, col] = (wrong if number % 5 == 0 else true)[row, col]
    away = ~binary_dilation(truth.is_object & truth.in_volume, iterations=4)
    table = np.argwhere(away & np.isfinite(true[..., 0]))[:10]
    points[tuple(table.T)] = true[tuple(table.T)] + [0, 0, 20]
    n = len(seen)
    n_points = sum(1 for i in range(n) if i % 3)
    n_wrong = sum(1 for i in range(n) if i % 3 and i % 5 == 0)
    reference = judge.seen.copy()
    reference[tuple(seen[1::3].T)] = False
    entry = judge.judged(
        Entry(method="M2", group="paper", thing="x", steps=4, n_images=9), measured(points),
        reference,
    )  # fmt: skip
    assert entry.of_seen is not None
    assert entry.against_m1 is not None
    assert entry.of_seen.completeness == pytest.approx((n_points - n_wrong) / n)
    assert entry.of_seen.n_wrong == n_wrong
    assert entry.of_seen.n_wrong_anywhere == n_wrong + 10
    assert entry.gross_part == pytest.approx(n_wrong / n_points)
    assert entry.false_share == pytest.approx(10 / n_points)
    wanted = [i for i in range(n) if i % 3 != 1]
    right = [i for i in wanted if i % 3 and i % 5]
    assert entry.against_m1.completeness == pytest.approx(len(right) / len(wanted))
    assert entry.verdict is not None
    assert (entry.verdict == Verdict.MISSING).sum() == n - n_points
    assert (entry.verdict == -1).sum() == entry.verdict.size - n - 10


def test_the_plane_is_measured_square_to_it_and_predicted_so() -> None:
    """Noise along the rays of 5 um: across the plane it is less, by the cosine of the slant."""
    stage = _stage(PRESETS["kolibri"]((320, 256)), "plane", "none", options())
    judge = judge_of(stage, PERIOD_PX)
    truth = stage.truths[0]
    noise = 0.005 * np.random.default_rng(8).standard_normal(truth.points_mm.shape[:2])
    rays = truth.points_mm - judge.origin_mm
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    plane = judge.plane(measured(truth.points_mm + noise[..., None] * rays, 0.005))
    # The axis of C1 is 27 degrees from the plane's normal. A normal distribution without 3 per
    # mille in its tails (beyond 2.968 sigma) has 0.985 of its sigma.
    expected = 5 * math.cos(math.radians(27.0))
    assert plane.n_points > 30_000
    assert plane.predicted_um == pytest.approx(expected, rel=0.01)
    assert plane.sigma_um == pytest.approx(0.985 * expected, rel=0.015)
    assert plane.noise_um == pytest.approx(plane.sigma_um, rel=0.001)
    assert 5.5 * expected < plane.flatness_um < 6.5 * expected


def test_each_method_gets_exactly_its_own_images_of_one_recording() -> None:
    stage = _stage(PRESETS["kolibri"]((32, 24)), "plane", "none", options())
    assert stage.rig.projector is not None
    shape = stage.rig.projector.shape
    plans = plans_of(SETTINGS[0].trials, (16, 4), shape, 16.0)
    together = union_of(plans.values())
    # Fringes and full code of both directions, light and dark, reduced codes with 3 and 2 images;
    # four steps are every fourth of sixteen.
    assert together.n_images == 2 * 16 + 2 * 7 + 2 + 3 + 2
    scan = record(stage, together, seed=1)
    for (trial, steps), plan in plans.items():
        own = own_images(scan, together, plan, trial)
        assert own.rig is not None
        assert (own.rig.projector is None) == (trial.name == "M2, no projector")
        for whole, part in zip(scan.stacks, own.stacks, strict=True):
            assert part.plan == plan
            for image, pattern in zip(part.images, part.plan.patterns, strict=True):
                assert (image == whole.images[together.patterns.index(pattern)]).all()
        if trial.group == "paper":
            assert plan.n_images == PAPER_IMAGES[steps][trial.name]
            assert plan == method_plan(trial.method, shape, period_px=16.0, n_shifts=steps)
    counts = {t.name: p.n_images for (t, n), p in plans.items() if n == 4}
    assert (counts["M2, no light, dark"], counts["M2, plain code"]) == (7, 6)


def test_the_modulation_on_the_plane_is_the_one_that_the_noise_refers_to() -> None:
    """96 grey values with 16 px on 640 x 512 px; here what blurs the fringes is told apart.

    Over a length of p px, a blur of s px leaves exp(-2 (pi s / p)^2) and a pixel sinc(1 / p).
    """
    stage = _stage(PRESETS["kolibri"]((320, 256)), "plane", "none", options(noise=0.0))
    assert stage.rig.projector is not None
    plan = method_plan("m3", stage.rig.projector.shape, period_px=PERIOD_PX, n_shifts=4)
    images = record(stage, plan, seed=1).stacks[0].images.astype(float)
    modulation = np.hypot(images[0] - images[2], images[1] - images[3]) / 2
    top = stage.truths[0].normals[..., 2] > 0.999

    def contrast(period_px: float, on_camera_px: float) -> float:
        blurs = ((0.5, period_px), (0.4, on_camera_px))
        left = math.prod(math.exp(-2 * (math.pi * s / p) ** 2) for s, p in blurs)
        return left * float(np.sinc(1 / period_px) * np.sinc(1 / on_camera_px))

    # A period of 16 px is 16 * 0.02 mm / 64.3 mm * 335 mm = 1.667 mm; a pixel is 93 mm / 640.
    expected = 96 * contrast(48, 3 * 1.667 * 320 / 93) / contrast(16, 1.667 * 640 / 93)
    assert np.median(modulation[top]) == pytest.approx(expected, rel=0.02)
    assert images.max() < 250


def test_the_noise_is_the_part_of_that_modulation_that_was_asked_for() -> None:
    """Two images of one pattern: 2 % of 96 grey values, with 1/12 for the quantisation.

    The shot noise of 1e7 electrons adds 0.06 grey values to 2; 1 % for the sample of 80,000.
    """
    stage = _stage(PRESETS["kolibri"]((320, 256)), "plane", "none", options(noise=0.02))
    plan = PatternPlan(patterns=(Uniform(level=1.0),), projector_shape=(768, 1024))
    one, other = (record(stage, plan, seed=n).stacks[0].images[0].astype(float) for n in (1, 2))
    top = stage.truths[0].normals[..., 2] > 0.999
    sigma = float(np.std((one - other)[top])) / math.sqrt(2)
    assert sigma == pytest.approx(math.hypot(0.02 * 96, 12**-0.5), rel=0.01)


def score(n: int, right: int, wrong: int, anywhere: int = 0) -> Score:
    """Return a score; `anywhere` wrong points lie outside the reference."""
    return Score(n_reference=n, n_right=right, n_wrong=wrong,
                 n_accepted_anywhere=right + wrong + anywhere,
                 n_wrong_anywhere=wrong + anywhere)  # fmt: skip


def entries() -> list[Entry]:
    """Return two objects, measured by M1 and M3, with figures that are easy to reckon."""
    m1 = Entry(method="M1", group="paper", thing="plane", steps=4, n_images=13, gross_part=0.0,
               against_m1=score(900, 900, 0), of_seen=score(1000, 900, 0, 100), false_share=0.0,
               plane=PlaneFigures(sigma_um=2.5, noise_um=2.25, flatness_um=17.4, predicted_um=2.3,
                                  n_points=15000))  # fmt: skip
    m3 = replace(m1, method="M3", n_images=4, against_m1=score(900, 450, 50), gross_part=0.1,
                 of_seen=score(1000, 450, 50), plane=None)  # fmt: skip
    teeth = [
        replace(m1, thing="teeth", of_seen=score(3000, 1500, 0), plane=None),
        replace(m3, thing="teeth", against_m1=None, of_seen=None, failure="too few periods"),
    ]
    lit = replace(m1, group="table", false_share=0.0125, plane=None)
    return [m1, m3, *teeth, lit]


def cells(markdown: str, start: str) -> list[list[str]]:
    """Return the cells of all table rows that begin with a word."""
    rows = [line for line in markdown.splitlines() if line.startswith(f"| {start}")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_tables_hold_the_figures_beside_the_papers() -> None:
    markdown = paper_markdown(entries(), conditions="Nowhere.", with_pictures=False)
    # Over both objects: 900 + 1500 of 4000; 100 wrong of 2500 points; none gross.
    assert cells(markdown, "M1 ")[0] == [
        "M1", "13", "100.00 (0.00)", "100.00 (0.00)", "60.0", "4.00", "0.00",
    ]  # fmt: skip
    assert cells(markdown, "M1 in")[0][:4] == ["M1 in the paper", "13", "100", "100"]
    assert cells(markdown, "M3 ")[0] == [
        "M3", "4", "50.00 (10.00)", "failed", "45.0", "10.00", "10.00",
    ]  # fmt: skip
    assert cells(markdown, "M3 in")[0][1:4] == ["4", "98", "81"]
    assert ["M3", "4", "4"] in cells(markdown, "M3 ")
    assert ["M1", "4", "2.50", "2.25", "2.30", "17", "15,000", "-"] in cells(markdown, "M1 ")
    assert ["M1", "13", "1.25 (100.00)"] in cells(markdown, "M1 ")
    assert "- M3, teeth, 4 steps: too few periods" in markdown
    assert "![" not in markdown
    for line in markdown.splitlines():
        assert not line.startswith("|") or line.count("|") == line.strip().count("|") > 2


def test_error_maps_show_each_verdict_in_its_colour(tmp_path: Path) -> None:
    verdict = np.full((60, 80), -1, np.int8)
    verdict[10:50, 10:30], verdict[10:50, 30:50], verdict[10:50, 50:70] = 0, 1, 2
    shown = replace(entries()[0], verdict=verdict, shade=np.ones((60, 80), np.float32))
    draw_error_maps(tmp_path / "maps.png", [shown, replace(shown, verdict=None, failure="none")])
    picture = cv2.imread(str(tmp_path / "maps.png"))
    assert picture is not None
    counts = []
    for value in Verdict:
        rgb = [int(COLORS[value][i : i + 2], 16) for i in (1, 3, 5)]
        counts.append(int((np.abs(picture[..., ::-1].astype(int) - rgb).max(-1) < 3).sum()))
    assert min(counts) > 2000
    assert max(counts) < 1.2 * min(counts)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("paper") / "out"
    text, _ = run_paper(options(out=out), Reporter(quiet=True))
    return out, text


def test_the_command_leaves_its_report_figures_and_pictures(run: tuple[Path, str]) -> None:
    out, text = run
    files = {path.name for path in out.iterdir()}
    assert files == {"paper.md", "paper.json", "overview.png", "errors-plane.png"}
    assert (out / "paper.md").read_text(encoding="utf-8") == text
    record = json.loads((out / "paper.json").read_text(encoding="utf-8"))
    assert record["conditions"]["noise"] == 0.01
    n_trials = sum(len(setting.trials) for setting in SETTINGS)
    assert len(record["results"]) == n_trials
    for result in record["results"]:
        if result["method"] == "M1" or result["method"].startswith("M1 on"):
            assert result["completeness"] == 1.0
            assert result["error_rate"] == 0.0
            assert result["of_seen"] > 0.9


def test_m2_is_as_complete_as_m1(run: tuple[Path, str]) -> None:
    record = json.loads((run[0] / "paper.json").read_text(encoding="utf-8"))
    m2 = next(r for r in record["results"] if r["method"] == "M2")
    assert m2["images"] == 9
    assert m2["completeness"] > 0.99
    assert m2["error_rate"] < 0.001


def test_two_processes_find_the_same_as_one(run: tuple[Path, str]) -> None:
    """To the last digit, in the same order; and leave the environment as it was."""
    before = dict(os.environ)
    text, figures = run_paper(options(jobs=2), Reporter(quiet=True))
    alone = json.loads((run[0] / "paper.json").read_text(encoding="utf-8"))
    assert json.loads(json.dumps(figures)) == alone
    assert text == run[1].replace("![Right, wrong and missing points](overview.png)\n\n", "")
    assert dict(os.environ) == before


def test_an_earlier_result_is_replaced_only_when_asked(run: tuple[Path, str]) -> None:
    with pytest.raises(OutputError, match="found an existing folder"):
        run_paper(options(out=run[0]), Reporter(quiet=True))


def test_what_makes_no_experiment_is_said() -> None:
    with pytest.raises(MethodError, match=r"--objects: expected some of plane, .*found 'planet'"):
        run_paper(options(objects=("plane", "planet")), Reporter(quiet=True))
    with pytest.raises(MethodError, match=r"--steps: expected numbers .* found '4,x'"):
        parse_steps("4,x")
    with pytest.raises(MethodError, match=r"--steps: .* found '2'"):
        parse_steps("2")
    with pytest.raises(Fringe3DError, match="calibration"):
        run_paper(options(calibration_error_px=50.0), Reporter(quiet=True))
