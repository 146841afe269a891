"""Gamma: found from images, taken out of the phase, and put into the patterns.

The oracles are closed forms: images are made here from true phases by a power, and the phase of a
fringe is known.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import SphereScene, record_scene
from fringe3d.cli.run import main
from fringe3d.decode import (
    decode,
    ramp_of,
    response_from_fringes,
    response_from_ramp,
    wrapped_phase,
)
from fringe3d.decode.ripple import gamma_curve, ripple_of_curve
from fringe3d.errors import MethodError, PlanError
from fringe3d.health import period_disagreement
from fringe3d.io.recording import read_scan
from fringe3d.io.responsefile import mean_curve, read_responses, response_text
from fringe3d.io.scanfile import plan_text, read_plan
from fringe3d.model import Fringe, GrayBit, ImageStack, PatternPlan, Response, Rig, Uniform
from fringe3d.model.plan import fringes, gray_code
from fringe3d.options import MeasureOptions
from fringe3d.patterns import grey_ramp, pattern_image, sequence
from fringe3d.pipeline import measure

EXAMPLES = Path(__file__).parent.parent / "examples" / "captures"
SHAPE = (120, 160)
Floats = NDArray[np.float64]


def true_w() -> Floats:
    """Return w of each pixel, projector px: about 23 fringes of 16 px, a little curved."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    w: Floats = 40 + 2.3 * x + 0.13 * y + 0.002 * (y - 60) ** 2
    return w


def stack_of(
    plan: PatternPlan, *, gamma: float, noise: float = 0.0, seed: int = 0, top: float = 60_000
) -> ImageStack:
    """Return 16-bit images of a plan, shown with ``level**gamma``."""
    w, rng = true_w(), np.random.default_rng(seed)
    images = []
    for pattern in plan.patterns:
        match pattern:
            case Fringe():
                level = 0.5 + 0.5 * np.cos(2 * np.pi * w / pattern.period_px - pattern.shift)
            case GrayBit():
                cell = (w // pattern.cell_px).astype(int)
                level = (((cell ^ (cell >> 1)) >> pattern.bit) & 1).astype(np.float64)
            case Uniform(level=grey):
                level = np.full(SHAPE, grey)
        light = 3000 + (top - 3000) * level**gamma + noise * top / 2 * rng.standard_normal(SHAPE)
        images.append(np.rint(light).astype(np.uint16))
    return ImageStack(images=np.stack(images), plan=plan, device_name="c1", saturation_dn=65535)


def phase_error(phase: NDArray[np.float32], period_px: float = 16.0) -> Floats:
    error = phase - 2 * np.pi * true_w() / period_px
    return np.asarray((error + np.pi) % (2 * np.pi) - np.pi)


def curve(gamma: float) -> Response:
    levels, values = gamma_curve(gamma)
    return Response(device_name="c1", levels=levels, values=values, gamma=gamma)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize(("n_shifts", "before"), [(3, 0.2), (4, 0.007)])
def test_a_known_gamma_is_taken_out_of_the_phase(n_shifts: int, before: float, plain: bool) -> None:
    stack = stack_of(PatternPlan(patterns=fringes(16.0, n_shifts)), gamma=2.2)
    fringe_set = stack.plan.fringe_sets[0]
    raw = phase_error(wrapped_phase(stack, fringe_set, plain=plain).phase)
    assert np.std(raw) > before
    done = stack.with_response(curve(2.2))
    error = phase_error(wrapped_phase(done, fringe_set, plain=plain).phase)
    assert np.abs(error).max() < 0.002


@pytest.mark.parametrize("origin", [0.0, 0.7])
@pytest.mark.parametrize("gamma", [1.5, 2.2])
def test_the_images_themselves_tell_the_ripple(gamma: float, origin: float) -> None:
    steps = tuple(replace(f, shift=f.shift + origin) for f in fringes(16.0, 3))
    stack = stack_of(PatternPlan(patterns=steps), gamma=gamma, noise=0.01)
    found = response_from_fringes(stack)
    assert found.gamma == pytest.approx(gamma, abs=0.03)
    phases = wrapped_phase(stack.with_response(found), stack.plan.fringe_sets[0])
    noise = math.sqrt(2 / 3) * 0.01
    assert np.std(phase_error(phases.phase)) < math.hypot(0.01, 1.4 * noise)
    assert abs(np.mean(phase_error(phases.phase))) < 0.005


def test_the_ripple_of_the_doctrine() -> None:
    # Of level**g: c2 / c1 = (g-1)/(g+2), c4 / c1 = (g-1)(g-2)(g-3) / ((g+2)(g+3)(g+4)). Of three
    # steps both turn the phase three times per period, in opposite directions.
    gamma = 1.05
    second = (gamma - 1) / (gamma + 2)
    fourth = second * (gamma - 2) * (gamma - 3) / ((gamma + 3) * (gamma + 4))
    three = PatternPlan(patterns=fringes(16.0, 3)).fringe_sets[0]
    assert ripple_of_curve(curve(gamma), three).sines[0] == pytest.approx(second - fourth, rel=0.01)


def test_sigma_of_a_corrected_phase_is_that_of_its_scatter() -> None:
    plan = PatternPlan(patterns=fringes(16.0, 3))
    scatter, sigma = [], []
    for seed in range(12):
        stack = stack_of(plan, gamma=2.2, noise=0.01, seed=seed).with_response(curve(2.2))
        found = wrapped_phase(stack, plan.fringe_sets[0])
        scatter.append(phase_error(found.phase))
        sigma.append(found.phase_std)
    # The modulation here is that of the first harmonic; sigma changes tenfold along a fringe.
    pull = np.array(scatter) / np.array(sigma)
    part = np.mod(true_w(), 16.0) // 2
    for eighth in range(8):
        assert np.std(pull[:, part == eighth]) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("n_shifts", [3, 4, 8])
def test_gamma_follows_from_light_dark_and_mean(n_shifts: int) -> None:
    light = (Uniform(level=1.0), Uniform(level=0.0))
    stack = stack_of(PatternPlan(patterns=fringes(16.0, n_shifts) + light), gamma=2.2)
    assert response_from_fringes(stack).gamma == pytest.approx(2.2, abs=0.01)


@pytest.mark.parametrize("n_shifts", [4, 5, 8])
def test_gamma_follows_from_the_second_harmonic(n_shifts: int) -> None:
    stack = stack_of(PatternPlan(patterns=fringes(16.0, n_shifts)), gamma=1.8, noise=0.01)
    assert response_from_fringes(stack).gamma == pytest.approx(1.8, abs=0.02)


def test_a_linear_response_is_left_alone() -> None:
    stack = stack_of(PatternPlan(patterns=fringes(16.0, 3)), gamma=1.0, noise=0.01)
    found = response_from_fringes(stack)
    assert found.ripples[0].amplitude < 0.003


def test_orders_are_right_with_the_corrected_phase() -> None:
    plan = PatternPlan(patterns=fringes(16.0, 3) + gray_code(8.0, 6))
    stack = stack_of(plan, gamma=2.2)
    stack = stack.with_response(response_from_fringes(stack))
    for plain in (False, True):
        main = decode(stack, plain=plain).directions[0].main
        good = main.rejection == 0
        assert good.mean() > 0.999
        assert np.abs(main.position_px - true_w())[good].max() < 0.05


def test_a_grey_ramp_gives_the_curve() -> None:
    stack = stack_of(PatternPlan(patterns=grey_ramp(9)), gamma=2.2, noise=0.005)
    levels, places = ramp_of(stack.plan)
    found = response_from_ramp(stack, levels, places)
    assert found.gamma == pytest.approx(2.2, abs=0.01)
    np.testing.assert_allclose(found.values, np.linspace(0, 1, 9) ** 2.2, atol=0.001)


def test_a_ramp_out_of_order_is_refused() -> None:
    stack = stack_of(PatternPlan(patterns=grey_ramp(9)), gamma=2.2)
    mixed = replace(stack, images=stack.images[[0, 1, 2, 6, 4, 5, 3, 7, 8]])
    levels, places = ramp_of(stack.plan)
    with pytest.raises(MethodError, match="order of the plan"):
        response_from_ramp(mixed, levels, places)


def test_unequal_steps_and_other_steps_are_refused() -> None:
    uneven = PatternPlan(patterns=tuple(Fringe(period_px=16, shift=s) for s in (0.0, 1.0, 2.5)))
    with pytest.raises(MethodError, match="equal steps"):
        response_from_fringes(stack_of(uneven, gamma=2.2))
    three = response_from_fringes(stack_of(PatternPlan(patterns=fringes(16.0, 3)), gamma=2.2))
    no_curve = replace(three, levels=(), values=())
    four = stack_of(PatternPlan(patterns=fringes(16.0, 4)), gamma=2.2).with_response(no_curve)
    with pytest.raises(MethodError, match="4 steps of 16 px"):
        wrapped_phase(four, four.plan.fringe_sets[0])


def test_patterns_make_up_for_the_response() -> None:
    pattern = fringes(16.0, 3)[1]
    shown = pattern_image(pattern, (1, 64), bit_depth=16, response=curve(2.2))[0] / 65535
    wanted = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(64) + 0.5) / 16 - 2 * np.pi / 3)
    np.testing.assert_allclose(shown**2.2, wanted, atol=0.001)


def test_response_files_are_read_back(tmp_path: Path) -> None:
    found = response_from_fringes(stack_of(PatternPlan(patterns=fringes(16.0, 3)), gamma=2.2))
    file = tmp_path / "response.toml"
    file.write_text(response_text([found]), encoding="utf-8")
    (again,) = read_responses(file)
    np.testing.assert_allclose(again.ripples[0].sines, found.ripples[0].sines, atol=1e-6)
    np.testing.assert_allclose(again.values, found.values, atol=1e-6)
    np.testing.assert_allclose(mean_curve(file).values, found.values, atol=1e-6)
    file.write_text(file.read_text().replace("levels = [0.0,", "levels = [0.5,"), encoding="utf-8")
    with pytest.raises(PlanError, match=r"camera 'c1': response: levels: .* rise from 0 to 1"):
        read_responses(file)


def test_a_plan_with_a_ramp_is_read_back(tmp_path: Path) -> None:
    plan = sequence((48, 64), periods_px=(16.0,), n_shifts=3, n_ramp=5)
    (tmp_path / "plan.toml").write_text(plan_text(plan), encoding="utf-8")
    assert read_plan(tmp_path / "plan.toml") == plan


def test_points_of_one_camera_and_the_projector(rig: Rig) -> None:
    one = Rig(cameras=rig.cameras[:1], projector=rig.projector, volume=rig.volume)
    scan, truths = record_scene(one, SphereScene(gamma=2.2), seed=1, n_shifts=3)
    lit = truths[0].lit
    missed = []
    for own in (False, True):
        points = measure(scan, MeasureOptions(own_response=own)).points
        assert points is not None
        good = points.is_valid & lit
        away = points.points_mm[good] - truths[0].points_mm[good]
        missed.append(float(np.median(np.linalg.norm(away, axis=-1))))
    assert missed[1] < missed[0] / 4


def test_from_images_to_response_to_measurement(
    tmp_path: Path, captures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = EXAMPLES / "phaseshift-bricks.toml"
    out = tmp_path / "response.toml"
    main(["calibrate", "response", str(scan), "--images", str(captures), "--out", str(out)])
    assert "gamma 2.6" in capsys.readouterr().out
    assert out.with_suffix(".png").is_file()
    recording = read_scan(scan, images=captures, response=out)
    for direction in measure(recording).phases[0].directions:
        difference = period_disagreement(direction.main, direction.others[0])
        assert np.nanmedian(np.abs(difference)) < 0.7  # 4.2 before
