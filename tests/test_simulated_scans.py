"""Measurements of simulated scans against their truth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, Pattern, PatternPlan, Scan
from fringe3d.model.plan import fringes, gray_code
from fringe3d.options import Method
from fringe3d.patterns import method_plan, sequence
from fringe3d.pipeline import Measurement, MeasureOptions, measure

pytest.importorskip("embreex")

from fringe3d.rig_bias import learn_rig_bias
from fringe3d.simulate import OBJECTS, PRESETS, Stage, prepare, record
from fringe3d.simulate.perturb import perturbed

SIZE = (480, 384)
NOISE, MODULATION, FULL_WELL_E = 0.03, 96 / 255, 1e7
"""Part of the modulation, which is a part of the range; so large a well has no noise of its own."""

WRONG_MM = 0.5
"""Noise moves points by 0.01 to 0.02 mm; only a wrong match moves one that far."""


def stage_of(preset: str, thing: str) -> Stage:
    made = PRESETS[preset](SIZE)
    return prepare(made.rig, made.scene(OBJECTS[thing]()))


@pytest.fixture(scope="module")
def bodies() -> Stage:
    return stage_of("kolibri", "two-bodies")


def plan_of(stage: Stage, method: str) -> PatternPlan:
    assert stage.rig.projector is not None
    return method_plan(method, stage.rig.projector.shape, period_px=16.0, n_shifts=4)


def judged(stage: Stage, result: Measurement) -> tuple[float, float]:
    """Return the part of the reference pixels that have a point, and of points that are wrong."""
    assert result.points is not None
    truth = stage.truths[0]
    reference = truth.lit & truth.in_volume & truth.seen_by["c2"]
    error = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)
    good = result.points.is_valid
    return (
        float((good & reference).sum() / reference.sum()),
        float((error[good] > WRONG_MM).mean()),
    )


def test_a_depth_jump_of_several_periods_is_measured_with_a_full_and_a_reduced_code(
    bodies: Stage,
) -> None:
    """The table below the volume takes one bit more than the volume itself."""
    scan = record(bodies, plan_of(bodies, "m1"), seed=1)
    for gray_bits in (None, 4):
        found, wrong = judged(bodies, measure(scan, MeasureOptions(gray_bits=gray_bits)))
        assert found > 0.97
        assert wrong < 0.001


def test_a_code_too_short_for_the_segments_of_two_cameras_is_refused() -> None:
    """45 % of the points on teeth would be wrong, most of them hidden from C2, which shows a twin
    alone. Too few pixels are ambiguous to tell. Two images of half cells number 4 periods, three 8.
    """
    made = PRESETS["kolibri"](SIZE)
    teeth = prepare(made.rig, made.scene(OBJECTS["teeth"](), background="none"))
    scan = record(teeth, plan_of(teeth, "m1"), seed=1)
    alone = replace(scan, rig=replace(teeth.rig, projector=None))
    words = r"up to 4 periods.*in 'c2', found up to [78].*3 cyclic code images \(4 if over"
    for method in ("auto", "m2"):
        with pytest.raises(MethodError, match=words):
            measure(alone, MeasureOptions(gray_bits=2, method=method))
    found, wrong = judged(teeth, measure(alone, MeasureOptions(gray_bits=3)))
    found_m1, wrong_m1 = judged(teeth, measure(alone))
    assert found > found_m1 - 0.01
    assert wrong < wrong_m1 + 0.01


def test_the_projector_keeps_hidden_surfaces_out_of_two_cameras(bodies: Stage) -> None:
    """Without it C2's edge pixels, which mix two phases, pass for points that C2 does not see."""
    scan = record(bodies, plan_of(bodies, "m1"), seed=1)
    alone = replace(scan, rig=replace(bodies.rig, projector=None))
    found, wrong = judged(bodies, measure(scan))
    found_alone, wrong_alone = judged(bodies, measure(alone))
    assert wrong < 0.3 * wrong_alone
    assert found > found_alone - 0.001


def test_four_images_without_a_code_are_enough_where_the_segment_is_shorter_than_a_period() -> None:
    """M5. False points: surfaces outside the volume, as the table and the foot of the bust."""
    stage = stage_of("kolibri-m5", "bust")
    scan = record(stage, plan_of(stage, "m5"), seed=1)
    assert scan.stacks[0].plan.n_images == 4
    found, wrong = judged(stage, measure(scan))
    assert found > 0.9
    assert wrong < 0.07
    without_table = PRESETS["kolibri-m5"](SIZE)
    free = prepare(without_table.rig, without_table.scene(OBJECTS["bust"](), background="none"))
    found, wrong = judged(free, measure(record(free, plan_of(free, "m5"), seed=1)))
    assert found > 0.9
    assert wrong < 0.05


@pytest.mark.parametrize("method", ["m3", "m5"])
def test_four_images_do_on_the_rig_of_the_optimiser(method: Method) -> None:
    """Against M1 on the same rig; each pixel alone (M3), and with its neighbours (M5)."""
    stage = stage_of("designed", "machine-part")
    assert stage.rig.projector is not None
    angle = PRESETS["designed"](SIZE).fringe_angle
    plan = method_plan("m1", stage.rig.projector.shape, period_px=16.0, n_shifts=4, angle=angle)
    scan = record(stage, plan, seed=1)
    full, _ = judged(stage, measure(scan))
    options = MeasureOptions(method=method, min_order_probability=0.0)
    found, wrong = judged(stage, measure(scan, options))
    assert found > 0.97 * full
    assert wrong < 0.02


@pytest.mark.parametrize("strict", [False, True])
def test_fringes_of_two_directions_keep_the_table_out(bodies: Stage, strict: bool) -> None:
    """M4: eight images, no code."""
    scan = record(bodies, plan_of(bodies, "m4"), seed=1)
    result = measure(scan, MeasureOptions(strict=strict))
    assert (result.method, result.n_images) == ("m4", 8)
    found, wrong = judged(bodies, result)
    assert found > 0.97
    assert wrong < 0.005


def test_points_of_the_table_are_said_to_be_outside_the_volume(bodies: Stage) -> None:
    result = measure(record(bodies, plan_of(bodies, "m1"), seed=1))
    assert result.points is not None
    truth = bodies.truths[0]
    table = ~truth.is_object & truth.lit & truth.seen_by["c2"]
    outside = (result.rejection & 512) != 0
    assert outside[table].mean() > 0.98
    assert not result.warnings


def test_fringes_along_the_epipolar_lines_are_refused_between_two_cameras(bodies: Stage) -> None:
    assert bodies.rig.projector is not None
    # The kolibri's epipolar lines are not quite horizontal; these fringes follow them.
    angle = np.radians(90.0)
    plan = sequence(bodies.rig.projector.shape, periods_px=(16.0,), n_shifts=4, angles=(angle,))
    parallel = PRESETS["face"](SIZE)
    stage = prepare(parallel.rig, parallel.scene(OBJECTS["plane"]()))
    with pytest.raises(MethodError, match="fringes run along the epipolar lines of 'c2'"):
        measure(record(stage, plan, seed=1))


def test_jpeg_images_are_told_to_hide_their_noise(bodies: Stage) -> None:
    """And they do: sigma falls although the points do not get better."""
    scan = record(bodies, plan_of(bodies, "m1"), seed=1)

    def compressed(stack: ImageStack) -> ImageStack:
        files = (cv2.imencode(".jpg", i, [cv2.IMWRITE_JPEG_QUALITY, 90])[1] for i in stack.images)
        images = np.stack([np.asarray(cv2.imdecode(file, 0), np.uint8) for file in files])
        return replace(stack, images=images, noise=None, is_lossy=True)

    result = measure(Scan(stacks=tuple(compressed(s) for s in scan.stacks), rig=scan.rig))
    assert [f.name for f in result.warnings] == ["lossy_cameras"]
    plain = measure(scan)
    assert plain.points is not None
    assert result.points is not None
    truth = bodies.truths[0].points_mm
    errors, sigmas = [], []
    for points in (plain.points, result.points):
        errors.append(np.nanmedian(np.linalg.norm(points.points_mm - truth, axis=-1)))
        sigmas.append(np.nanmedian(points.sigma_mm))
    assert errors[1] > errors[0]
    assert sigmas[1] < 0.7 * sigmas[0]


def test_a_table_below_the_volume_is_not_folded_into_it(bodies: Stage) -> None:
    """Two bits number 4 periods, the segment holds 4.1; the table stands just below the volume."""
    result = measure(record(bodies, plan_of(bodies, "m2"), seed=1))  # 2 bits
    assert result.method == "m2"
    found, wrong = judged(bodies, result)
    assert found > 0.97
    assert wrong < 0.02


@pytest.mark.parametrize("method", ["auto", "projector"])
def test_a_reduced_code_for_one_of_two_periods_finds_the_orders_of_that_one(
    bodies: Stage, method: Method
) -> None:
    """8 cells of 16 px repeat after 128 px, no multiple of 17 px: only 16 px suits the code."""
    assert bodies.rig.projector is not None
    shape = bodies.rig.projector.shape
    plan = sequence(shape, periods_px=(16.0, 17.0), n_shifts=4, gray_bits=3)
    result = measure(record(bodies, plan, seed=1), MeasureOptions(method=method))
    found, wrong = judged(bodies, result)
    assert result.main.period_px == 16.0
    assert found > 0.97
    assert wrong < 0.005


def test_a_code_with_cells_wider_than_the_period_is_refused(bodies: Stage) -> None:
    """Cells of 24 px do not tell the periods of 16 px apart that share a cell."""
    assert bodies.rig.projector is not None
    patterns: tuple[Pattern, ...] = (*fringes(16.0, 4), *gray_code(24.0, 6))
    plan = PatternPlan(patterns=patterns, projector_shape=bodies.rig.projector.shape)
    with pytest.raises(MethodError, match=r"cells of the code are 24 px wide, the fringes 16 px"):
        measure(record(bodies, plan, seed=1), MeasureOptions(method="projector"))


def test_a_projector_that_is_off_by_more_than_a_fringe_allows_is_left_out(bodies: Stage) -> None:
    """1.5 px of 4.5 px would put the search window beside the point."""
    rig = bodies.rig
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(9.0,), n_shifts=4)
    scan = record(bodies, plan, seed=1)
    moved = replace(rig.projector, center_px=rig.projector.center_px + np.array([2.7, 0.0]))
    shifted = measure(replace(scan, rig=replace(rig, projector=moved)))
    alone = measure(replace(scan, rig=replace(rig, projector=None)))
    assert shifted.points is not None
    assert alone.points is not None
    assert shifted.points.n_points > 0.98 * alone.points.n_points


def test_four_images_of_a_symmetric_rig_with_calibration_errors(bodies: Stage) -> None:
    """M6. The bias is found with the orders, or learnt from another scan and stored with the rig.

    With these errors a search that starts along the epipolar lines alone ends with half the orders
    wrong; M3 measures one point in ten.
    """
    preset = PRESETS["kolibri"](SIZE)
    rig = perturbed(preset.rig, rms_px=0.2, seed=3)
    scan = replace(record(bodies, plan_of(bodies, "m6"), seed=1), rig=rig)
    result = measure(scan)
    assert result.method == "m6"
    other = stage_of("kolibri", "machine-part")
    learnt = learn_rig_bias([record(other, plan_of(other, "m6"), seed=2)], rig)
    assert learnt.certainty > 0.99
    stored = measure(replace(scan, rig=replace(rig, bias=learnt.bias)))
    for found, wrong in (judged(bodies, result), judged(bodies, stored)):
        assert found > 0.97  # M1: 0.99
        assert wrong < 0.01  # calibration errors move points by 0.1 mm, the border of the object


def test_noise_does_not_bend_the_bias(bodies: Stage) -> None:
    """Noise of 3 % of the modulation; with phases as they are, the bias that fits best leaves a
    third of the orders wrong, 10 of its deviations away from the true one."""
    electrons = NOISE * MODULATION * FULL_WELL_E
    optics = replace(bodies.setup.camera, full_well_e=FULL_WELL_E, read_noise_e=electrons)
    noisy = replace(bodies, setup=replace(bodies.setup, camera=optics))
    rig = perturbed(bodies.rig, rms_px=0.2, seed=1)
    four, coded = (record(noisy, plan_of(bodies, method), seed=1) for method in ("m6", "m1"))
    by_code = learn_rig_bias([coded], rig).bias
    learnt = learn_rig_bias([four], rig)
    apart = (learnt.bias.coefficients_px - by_code.coefficients_px).ravel()
    assert learnt.certainty > 0.99
    assert learnt.bias.covariance_px2 is not None
    assert by_code.covariance_px2 is not None
    covariance = learnt.bias.covariance_px2 + by_code.covariance_px2
    assert apart @ np.linalg.solve(covariance, apart) < chi2.ppf(0.999, len(apart))
