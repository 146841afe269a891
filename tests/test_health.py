"""The checks notice what is wrong, with the right figure, and are silent where nothing is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from changed_rigs import turned
from closed_form import Recording, SphereScene, record_scene
from fringe3d.errors import CalibrationError, MethodError
from fringe3d.health import check_course
from fringe3d.health._correlate import profile
from fringe3d.model import Fringe, ImageStack, PatternPlan, PhaseMap, Rig, Scan
from fringe3d.options import Method
from fringe3d.pipeline import Measurement, MeasureOptions, measure

FIGURE_TOLERANCE_PX = 0.03
"""The median of 60 000 residuals of 0.02 px is far better; the lens turns 1 px into 0.98-1.02."""


def figure(result: Measurement, name: str) -> float:
    figures = [{finding.name: finding.value, **finding.figures} for finding in result.findings]
    return next(each[name] for each in figures if name in each)


def with_device(rig: Rig, index: int, **changes: Any) -> Rig:
    """Return the rig with another camera `index` (or projector, for -1)."""
    device = rig.devices[index]
    changed = replace(device, **changes)
    if device.role == "projector":
        return replace(rig, projector=changed)
    cameras = list(rig.cameras)
    cameras[index] = changed
    return replace(rig, cameras=tuple(cameras))


def phases_of(turns: NDArray[np.float64], *, n_orders: int = 20) -> PhaseMap:
    """Return a decoded map with these absolute phases, in turns."""
    order = np.floor(turns).astype(np.int32)
    blank = np.ones(turns.shape, np.float32)
    return PhaseMap(
        phase=(2 * np.pi * (turns - order)).astype(np.float32),
        order_class=order,
        class_of_order=np.arange(n_orders, dtype=np.int32),
        phase_std=0.02 * blank,
        offset=100 * blank,
        modulation=50 * blank,
        rejection=np.zeros(turns.shape, np.uint16),
        period_px=16.0,
        angle=0.0,
        device_name="c1",
    )


TURNS = np.tile(0.5 + np.arange(160) / 11.0, (90, 1)) + 0.01 * np.arange(90)[:, None]


def backwards_in_half_periods(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a phase of wrong direction and offset makes of them with a code of half periods:
    the code holds, and within each of its cells the phase falls."""
    cell = np.floor(2 * turns) / 2
    return np.asarray(cell + (0.5 - (turns - cell)) * 0.999)


@pytest.mark.parametrize("view", [lambda t: t, lambda t: t[:, ::-1], lambda t: t.T,
                                  lambda t: t.T[::-1]])  # fmt: skip
def test_a_phase_that_runs_against_its_code_is_an_error(view: Any) -> None:
    """Whichever way the camera is held; a phase that runs with its code is none."""
    noise = np.random.default_rng(0).normal(0, 0.003, TURNS.shape)
    assert check_course(phases_of(view(TURNS + noise))) == []
    (found,) = check_course(phases_of(view(backwards_in_half_periods(TURNS + noise))))
    assert found.level == "error"
    assert "runs against the code" in found.text
    assert check_course(phases_of(view(TURNS + 40 * noise))) == []  # too noisy to tell


def test_a_true_calibration_gives_no_warning(recording: Recording) -> None:
    result = measure(recording[0])
    assert result.warnings == ()
    assert abs(figure(result, "trinocular_residual_px")) < FIGURE_TOLERANCE_PX


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("degrees", [-1.0, 1.0])
def test_a_turned_camera_is_noticed(recording: Recording, axis: str, degrees: float) -> None:
    scan = recording[0]
    assert scan.rig is not None
    c1, c2 = scan.rig.cameras
    wrong = replace(scan.rig, cameras=(c1, turned(c2, axis, degrees)))
    assert_noticed(replace(scan, rig=wrong))


def test_exchanged_camera_poses_are_noticed(recording: Recording) -> None:
    scan = recording[0]
    assert scan.rig is not None
    a, b = (camera.device_from_world for camera in scan.rig.cameras)
    wrong = with_device(with_device(scan.rig, 0, device_from_world=b), 1, device_from_world=a)
    assert_noticed(replace(scan, rig=wrong))


def assert_noticed(scan: Scan) -> None:
    """Assert an error, or a warning that names the calibration."""
    try:
        result = measure(scan)
    except CalibrationError:
        return
    assert any("calibra" in finding.text for finding in result.warnings)


def test_trinocular_residual_is_the_shift_of_the_projector(recording: Recording) -> None:
    """A principal point 1 px to the right moves every prediction by +1 px."""
    scan = recording[0]
    assert scan.rig is not None
    assert scan.rig.projector is not None
    center = scan.rig.projector.center_px + np.array([1.0, 0.0])
    result = measure(replace(scan, rig=with_device(scan.rig, -1, center_px=center)))
    found = figure(result, "trinocular_residual_px")
    assert found == pytest.approx(1.0, abs=FIGURE_TOLERANCE_PX)
    assert any("trinocular" in finding.text for finding in result.warnings)


@pytest.mark.parametrize(("method", "gray_bits"), [("m3", 0), ("m2", 1)])
def test_a_code_too_short_for_the_volume_is_refused(
    recording: Recording, method: Method, gray_bits: int
) -> None:
    with pytest.raises(MethodError, match=r"Record a reduced Gray code|cyclic code images"):
        measure(recording[0], MeasureOptions(method=method, gray_bits=gray_bits))


def test_fringes_shifted_the_other_way_are_noticed(recording: Recording) -> None:
    scan = recording[0]
    assert scan.rig is not None
    stacks = tuple(reversed_shifts(stack) for stack in scan.stacks)
    with pytest.raises(CalibrationError, match="shift_direction"):
        measure(Scan(stacks=stacks, rig=scan.rig))


def reversed_shifts(stack: ImageStack) -> ImageStack:
    """Return the stack with a plan that states the steps with the wrong sign."""
    patterns = tuple(
        replace(p, shift=-p.shift) if isinstance(p, Fringe) else p for p in stack.plan.patterns
    )
    plan = PatternPlan(patterns=patterns, projector_shape=stack.plan.projector_shape)
    return ImageStack(
        images=stack.images,
        plan=plan,
        device_name=stack.device_name,
        saturation_dn=stack.saturation_dn,
    )


@pytest.mark.parametrize(("n_shifts", "n_warnings"), [(3, 2), (4, 0), (8, 0)])
def test_gamma_is_a_warning_where_it_disturbs_the_phase(
    rig: Rig, n_shifts: int, n_warnings: int
) -> None:
    """With 4 steps gamma 2.2 leaves its third harmonic (1 %), with 8 nothing worth mentioning."""
    scan, _ = record_scene(rig, SphereScene(gamma=2.2), seed=5, n_shifts=n_shifts)
    assert len([f for f in measure(scan).warnings if "gamma" in f.text]) == n_warnings


def test_gamma_that_does_no_harm_is_told_with_its_figure(rig: Rig) -> None:
    """(1 + cos)**g has a second harmonic of (g - 1) / (g + 2) of the first: 0.286."""
    scan, _ = record_scene(rig, SphereScene(gamma=2.2), seed=5, n_shifts=8)
    result = measure(scan)
    told = [f.text for f in result.findings if f.level == "ok" and "gamma" in f.text]
    assert len(told) == 2
    assert all("Harmless with 8 steps; with 3" in text for text in told)
    assert figure(result, "c1_x_16px_harmonic") == pytest.approx(1.2 / 4.2, abs=0.01)


def test_one_camera_gets_one_warning_of_gamma_with_every_figure(rig: Rig) -> None:
    """Two directions and two periods, as two cameras of any recording may have them."""
    scan, _ = record_scene(
        rig,
        SphereScene(gamma=2.2),
        seed=5,
        periods_px=(16.0, 21.0),
        n_shifts=3,
        angles=(0.0, np.pi / 2),
    )
    result = measure(Scan(stacks=scan.stacks[:1]))
    ripples = [f for f in result.warnings if f.name == "c1_ripple_rad"]
    periods = [f for f in result.warnings if f.name == "c1_period_disagreement_px"]
    assert (len(ripples), len(periods)) == (1, 1)
    assert "4 fringe sets (x 16 px, x 21 px, y 16 px, y 21 px)" in ripples[0].text
    assert {f"c1_{axis}_{period}px_ripple_rad" for axis in "xy" for period in (16, 21)} == set(
        ripples[0].figures
    )
    assert len(periods[0].figures) == 2
    assert all("gamma" in finding.text for finding in (*ripples, *periods))
    for finding in (*ripples, *periods):
        assert finding.value == max(finding.figures.values())


@pytest.mark.parametrize("n_shifts", [3, 4, 8])
def test_a_linear_response_gives_no_warning(rig: Rig, n_shifts: int) -> None:
    scan, _ = record_scene(rig, SphereScene(), seed=5, n_shifts=n_shifts)
    assert measure(scan).warnings == ()


def test_ripple_with_three_steps_is_the_second_harmonic(rig: Rig) -> None:
    """A second harmonic of part q of the first ripples the phase by q for three steps.

    For ``v**2`` the ratio is 1/4 exactly: (1 + cos)**2 / 4 = 3/8 + cos / 2 + cos(2.) / 8. The
    mean of exp(i N phi) is the Bessel-like series N a / 2 - ..., a few per cent off at 0.25.
    """
    scan, _ = record_scene(rig, SphereScene(gamma=2.0), seed=5, n_shifts=3)
    assert figure(measure(scan), "c1_x_16px_ripple_rad") == pytest.approx(0.25, rel=0.12)


def test_correlation_over_a_shift_equals_numpys() -> None:
    rng = np.random.default_rng(3)
    texture = rng.standard_normal((60, 80))
    texture[rng.random((60, 80)) < 0.1] = np.nan
    pixels = rng.uniform(-5, 85, (900, 2))
    pixels[::50] = np.nan
    values = rng.standard_normal(900)
    values[5::70] = np.nan
    normal, shifts = np.array([0.6, 0.8]), np.arange(-40, 41, 4)
    found = np.empty(len(shifts))
    profile(values, pixels, texture, normal, shifts, 300, found, (0, len(shifts)))
    for k, shift in enumerate(shifts):
        col, row = np.rint(np.nan_to_num(pixels + shift * normal, nan=-9)).astype(int).T
        inside = (row >= 0) & (row < 60) & (col >= 0) & (col < 80)
        row, col = np.where(inside, row, 0), np.where(inside, col, 0)
        other = np.where(inside, texture[row, col], np.nan)
        both = np.isfinite(values + other)
        expected = np.corrcoef(values[both], other[both])[0, 1] if both.sum() >= 300 else 0.0
        assert found[k] == pytest.approx(expected, abs=1e-12)
    assert (found == 0).any()
    assert (found != 0).any()
