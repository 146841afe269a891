"""Wrapped phase against the phase from which the images were made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.decode import wrapped_phase
from fringe3d.errors import MethodError
from fringe3d.model import (
    Fringe,
    ImageStack,
    NoiseModel,
    PatternPlan,
    Rejection,
    Uniform,
    WrappedPhaseMap,
)
from fringe3d.model.plan import fringes
from fringe3d.patterns import intensity

Floats = NDArray[np.float64]

PERIOD_PX = 16.0
FULL_SCALE = {8: 255.0, 16: 65535.0}
EQUAL_STEPS = (3, 4, 5, 8, 12, 16)

ROUNDING_DN = 1.5
"""Grey values are off by at most 0.5 DN. C and S are then off by 0.5 sum|row of the solver|,
at most 1 DN for steps within 20 % of equal ones, and the phase by sqrt(2) of that over B."""

FLOAT32_DN = 0.1
"""Float32 sums of 16 values up to 65535: 16 * 65535 * 6e-8."""

SIGMA_TOLERANCE = 0.03
"""Asked for; sampling 90 000 pixels adds 0.25 %."""

SAMPLES = (300, 300)


def unequal_shifts(n_shifts: int) -> list[float]:
    """Return steps up to 20 % off equal ones, in no order."""
    rng = np.random.default_rng(n_shifts)
    shifts = 2 * np.pi * (np.arange(n_shifts) + rng.uniform(-0.2, 0.2, n_shifts)) / n_shifts
    return [float(s) for s in rng.permutation(shifts)]


def plan_of(shifts: Sequence[float]) -> PatternPlan:
    return PatternPlan(patterns=tuple(Fringe(period_px=PERIOD_PX, shift=s) for s in shifts))


def grey_values(phase: Floats, shifts: Sequence[float], offset: float, modulation: float) -> Floats:
    """Return the definition of the fringes, not rounded: A + B cos(phase - shift)."""
    return np.stack([offset + modulation * np.cos(phase - shift) for shift in shifts])


def stack_of(
    grey: Floats,
    shifts: Sequence[float],
    *,
    bits: int = 16,
    black: float = 0.0,
    noise: NoiseModel | None = None,
) -> ImageStack:
    """Return images of rounded grey values, as a camera would record them."""
    images = np.clip(np.rint(grey), 0, FULL_SCALE[bits])
    return ImageStack(
        images=images.astype(np.uint8 if bits == 8 else np.uint16),
        plan=plan_of(shifts),
        device_name="c1",
        saturation_dn=FULL_SCALE[bits],
        black_level_dn=black,
        noise=noise,
    )


def decoded(stack: ImageStack, *, min_modulation_dn: float | None = None) -> WrappedPhaseMap:
    return wrapped_phase(stack, stack.plan.fringe_sets[0], min_modulation_dn=min_modulation_dn)


def turn_error(found: NDArray[np.float32], true: Floats) -> Floats:
    """Return the phase error, rad, without whole turns."""
    return np.asarray(np.angle(np.exp(1j * (found.astype(np.float64) - true))))


def all_phases(shape: tuple[int, int] = (40, 50)) -> Floats:
    """Return phases that fill a turn evenly, not at the multiples of the steps."""
    return (np.linspace(-np.pi, np.pi, shape[0] * shape[1], endpoint=False) + 1e-3).reshape(shape)


@pytest.mark.parametrize("n_shifts", EQUAL_STEPS)
@pytest.mark.parametrize("steps", ["equal", "reverse", "unequal"])
def test_phase_offset_modulation_equal_those_of_which_the_images_were_made(
    n_shifts: int, steps: str
) -> None:
    """Say nothing about noise."""
    shifts = {
        "equal": [2 * np.pi * n / n_shifts for n in range(n_shifts)],
        "reverse": [-2 * np.pi * n / n_shifts for n in range(n_shifts)],
        "unequal": unequal_shifts(n_shifts),
    }[steps]
    true = all_phases()
    result = decoded(stack_of(grey_values(true, shifts, 30000.0, 25000.0), shifts))
    tolerance = (ROUNDING_DN + FLOAT32_DN) / 25000.0
    assert np.abs(turn_error(result.phase, true)).max() < tolerance
    # In (-pi, pi] itself, not only up to whole turns; the tolerance may step over the end.
    inner = np.abs(true) < np.pi - tolerance
    np.testing.assert_allclose(true[inner], result.phase[inner], rtol=0, atol=tolerance)
    np.testing.assert_allclose(30000.0, result.offset, rtol=0, atol=ROUNDING_DN)
    np.testing.assert_allclose(25000.0, result.modulation, rtol=0, atol=ROUNDING_DN)
    assert (result.rejection == 0).all()


def test_plus_x_on_the_projector_raises_the_phase_by_one_turn_per_period() -> None:
    """The sign and the origin of the phase: 2 pi (x + 1/2) / period."""
    x = np.arange(64)[None] + 0.0
    for reverse in (False, True):
        plan = PatternPlan(patterns=fringes(PERIOD_PX, 4, reverse=reverse))
        light = np.stack([intensity(p, x, 0 * x) for p in plan.patterns])
        stack = stack_of(1000 + 50000 * light, [f.shift for f in fringes(PERIOD_PX, 4)])
        result = decoded(replace(stack, plan=plan))
        expected = (2 * np.pi * (x + 0.5) / PERIOD_PX + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(expected - result.phase).max() < (ROUNDING_DN + FLOAT32_DN) / 25000.0


def test_a_flipped_sign_or_a_dropped_half_turn_would_be_seen() -> None:
    """The oracle itself: the two commonest mistakes are far above the tolerance."""
    shifts = [2 * np.pi * n / 4 for n in range(4)]
    true = all_phases()
    result = decoded(stack_of(grey_values(true, shifts, 30000.0, 25000.0), shifts))
    for wrong in (-true, true + np.pi, true / 2):
        assert np.abs(turn_error(result.phase, wrong)).max() > 1.0


def test_phase_ignores_gain_and_ambient_light() -> None:
    """Within rounding; gain and offset are exact multiples, so that rounding is the same."""
    shifts = unequal_shifts(5)
    true = all_phases()
    grey = np.rint(grey_values(true, shifts, 8000.0, 6000.0))
    plain = decoded(stack_of(grey, shifts))
    brighter = decoded(stack_of(grey + 20000, shifts))
    stronger = decoded(stack_of(grey * 3, shifts))
    tolerance = 3 * FLOAT32_DN / 6000.0
    assert np.abs(turn_error(brighter.phase, plain.phase.astype(float))).max() < tolerance
    assert np.abs(turn_error(stronger.phase, plain.phase.astype(float))).max() < tolerance
    np.testing.assert_allclose(plain.offset + 20000.0, brighter.offset, rtol=0, atol=FLOAT32_DN)
    np.testing.assert_allclose(plain.modulation * 3.0, stronger.modulation, rtol=1e-5)


def test_order_of_the_images_is_irrelevant_given_the_plan() -> None:
    """Also with images of another kind in between."""
    shifts = unequal_shifts(5)
    stack = stack_of(grey_values(all_phases(), shifts, 30000.0, 25000.0), shifts)
    plain = decoded(stack)
    order = [3, 0, 4, 2, 1]
    images = np.concatenate([np.full((1, *stack.shape), 7, np.uint16), stack.images[order]])
    patterns = (Uniform(level=0.0), *stack.plan.subset(order).patterns)
    shuffled = decoded(replace(stack, images=images, plan=PatternPlan(patterns=patterns)))
    tolerance = FLOAT32_DN / 25000.0
    assert np.abs(turn_error(shuffled.phase, plain.phase.astype(float))).max() < tolerance


def test_a_step_more_in_every_shift_lowers_the_phase_by_it() -> None:
    """The plan's shifts absorb the origin of the phase."""
    true, step = all_phases(), 0.7
    shifts = unequal_shifts(4)
    stack = stack_of(grey_values(true, shifts, 30000.0, 25000.0), shifts)
    moved = replace(stack, plan=plan_of([s + step for s in shifts]))
    assert np.abs(turn_error(decoded(moved).phase, true + step)).max() < (
        ROUNDING_DN + FLOAT32_DN
    ) / 25000.0  # fmt: skip


@pytest.mark.parametrize("bits", [8, 16])
def test_black_level_lowers_the_offset_only(bits: int) -> None:
    """The offset counts light; phase and modulation do not know of the black level."""
    full, black = FULL_SCALE[bits], 0.05 * FULL_SCALE[bits]
    shifts = unequal_shifts(8)
    grey = grey_values(all_phases(), shifts, 0.5 * full, 0.4 * full)
    plain = decoded(stack_of(grey, shifts, bits=bits))
    raised = decoded(stack_of(grey, shifts, bits=bits, black=black))
    np.testing.assert_array_equal(plain.phase, raised.phase)
    np.testing.assert_array_equal(plain.modulation, raised.modulation)
    np.testing.assert_allclose(plain.offset - black, raised.offset, rtol=0, atol=1e-5 * full)


@pytest.mark.parametrize("bits", [8, 16])
def test_saturated_and_faint_pixels_are_rejected_with_their_reasons_and_no_others(
    bits: int,
) -> None:
    """One bright step is enough; one DN below saturation is not; NaN exactly where rejected."""
    full = FULL_SCALE[bits]
    shifts = [2 * np.pi * n / 4 for n in range(4)]
    grey = grey_values(all_phases(), shifts, 0.5 * full, 0.4 * full)
    grey[2, 0, :10] = full
    grey[2, 1, :10] = full - 1
    grey[:, 2, :10] = 0.5 * full  # no fringes at all
    grey[:, 3, :10] = full  # neither
    result = decoded(stack_of(grey, shifts, bits=bits, noise=NoiseModel(read_noise_dn=0.5)))
    expected = np.zeros((40, 50), np.uint16)
    expected[0, :10] = Rejection.SATURATED
    expected[2, :10] = Rejection.LOW_MODULATION
    expected[3, :10] = Rejection.SATURATED | Rejection.LOW_MODULATION
    np.testing.assert_array_equal(expected, result.rejection)
    np.testing.assert_array_equal(expected != 0, np.isnan(result.phase))


def test_lowest_modulation_is_8_thousandths_of_the_range_or_what_is_asked_for() -> None:
    """Range is what is left above the black level."""
    shifts = [2 * np.pi * n / 8 for n in range(8)]
    modulation = np.linspace(50, 1500, 2000).reshape(40, 50)
    grey = np.stack([20000 + modulation * np.cos(1.0 - s) for s in shifts])
    noise = NoiseModel(read_noise_dn=1.0)
    stack = stack_of(grey, shifts, black=5535.0, noise=noise)
    lowest = 0.008 * (65535 - 5535)
    for limit, asked in ((lowest, None), (900.0, 900.0), (0.0, 0.0)):
        accepted = decoded(stack, min_modulation_dn=asked).rejection == 0
        clear = np.abs(modulation - limit) > ROUNDING_DN
        np.testing.assert_array_equal((modulation >= limit)[clear], accepted[clear])


def test_fringes_drowned_in_noise_are_rejected_beyond_a_quarter_radian() -> None:
    """The limit of the noise: sqrt(2 / 4) sigma / B > 0.25, whatever the contrast asked for."""
    shifts = [2 * np.pi * n / 4 for n in range(4)]
    modulation = np.linspace(5, 60, 2000).reshape(40, 50)
    grey = np.stack([100 + modulation * np.cos(1.0 - s) for s in shifts])
    stack = stack_of(grey, shifts, bits=8, noise=NoiseModel(read_noise_dn=8.0))
    accepted = decoded(stack, min_modulation_dn=0.0).rejection == 0
    limit = np.sqrt(0.5) * 8.0 / 0.25
    clear = np.abs(modulation - limit) > ROUNDING_DN
    np.testing.assert_array_equal((modulation > limit)[clear], accepted[clear])


def noisy_phase(
    n_shifts: int, sigma_dn: float, gain: float, *, noise: NoiseModel | None
) -> tuple[WrappedPhaseMap, Floats]:
    """Return phases of noisy 8-bit images of a tilted plane, and their errors in rad."""
    rng = np.random.default_rng(100 + n_shifts)
    rows, cols = np.mgrid[: SAMPLES[0], : SAMPLES[1]]
    true = 2 * np.pi * (0.0531 * cols + 0.0123 * rows)
    shifts = [2 * np.pi * n / n_shifts for n in range(n_shifts)]
    grey = grey_values(true, shifts, 120.0, 60.0)
    grey += np.sqrt(sigma_dn**2 + gain * grey) * rng.standard_normal(grey.shape)
    result = decoded(stack_of(grey, shifts, bits=8, noise=noise))
    return result, turn_error(result.phase, true)


@pytest.mark.parametrize("n_shifts", [3, 4, 8, 16])
def test_sigma_phase_equals_the_sampled_one_with_a_given_noise_model(n_shifts: int) -> None:
    """Read and shot noise; the model counts quantisation as read noise."""
    model = NoiseModel(read_noise_dn=float(np.hypot(1.5, np.sqrt(1 / 12))), gain_dn_per_e=0.02)
    result, error = noisy_phase(n_shifts, 1.5, 0.02, noise=model)
    formula = np.sqrt(2 / n_shifts) * np.sqrt(model.read_noise_dn**2 + 0.02 * 120) / 60
    assert float(error.std()) == pytest.approx(formula, rel=SIGMA_TOLERANCE)
    assert float(np.median(result.phase_std)) == pytest.approx(formula, rel=SIGMA_TOLERANCE)
    assert float((error / result.phase_std).std()) == pytest.approx(1, rel=SIGMA_TOLERANCE)


@pytest.mark.parametrize("sigma_dn", [0.7, 1.0, 1.6])
@pytest.mark.parametrize("n_shifts", [3, 4, 5, 8, 16])
def test_sigma_phase_equals_the_sampled_one_with_noise_estimated_from_8_bit_images(
    n_shifts: int, sigma_dn: float
) -> None:
    """Noise of about one grey value: the steps of the grey values are as large as the noise."""
    result, error = noisy_phase(n_shifts, sigma_dn, 0.0, noise=None)
    total = np.sqrt(sigma_dn**2 + 1 / 12)
    assert total == pytest.approx(result.noise_dn, rel=SIGMA_TOLERANCE)
    formula = np.sqrt(2 / n_shifts) * total / 60
    assert formula == pytest.approx(float(np.median(result.phase_std)), rel=SIGMA_TOLERANCE)
    assert float((error / result.phase_std).std()) == pytest.approx(1, rel=SIGMA_TOLERANCE)


def test_sigma_phase_of_unequal_steps_equals_the_sampled_one_over_all_phases() -> None:
    """Unequal steps: sigma depends on the phase; the figure is its quadratic mean."""
    rng = np.random.default_rng(3)
    shifts = [0.0, 1.2, 2.0, 4.0]
    true = all_phases(SAMPLES)
    grey = grey_values(true, shifts, 30000.0, 20000.0) + 300 * rng.standard_normal((4, *SAMPLES))
    result = decoded(stack_of(grey, shifts, noise=NoiseModel(read_noise_dn=300.0)))
    error = turn_error(result.phase, true)
    assert float((error / result.phase_std).std()) == pytest.approx(1, rel=SIGMA_TOLERANCE)


@pytest.mark.parametrize("gamma", [1.0, 1.4, 2.2])
@pytest.mark.parametrize("n_shifts", [12, 16])
def test_harmonic_of_a_gamma_curve_equals_closed_form(n_shifts: int, gamma: float) -> None:
    """((1 + cos) / 2)**g has a second harmonic of (g - 1) / (g + 2) of the first."""
    shifts = [2 * np.pi * n / n_shifts for n in range(n_shifts)]
    true = all_phases()
    grey = np.stack([2000 + 60000 * (0.5 + 0.5 * np.cos(true - s)) ** gamma for s in shifts])
    result = decoded(stack_of(grey, shifts))
    assert (gamma - 1) / (gamma + 2) == pytest.approx(result.harmonic_ratio, abs=1e-4)
    # Twelve and more steps do not let these harmonics into the phase.
    assert np.abs(turn_error(result.phase, true)).max() < 1e-4


@pytest.mark.parametrize("n_shifts", [3, 4, 5, 6, 8])
def test_gamma_is_not_taken_for_noise(n_shifts: int) -> None:
    """A second harmonic of 29 % beside noise of 1 DN: no pixel may be lost to it."""
    rng = np.random.default_rng(8)
    rows, cols = np.mgrid[: SAMPLES[0], : SAMPLES[1]]
    true = 2 * np.pi * (0.0331 * cols + 0.0053 * rows)
    shifts = [2 * np.pi * n / n_shifts for n in range(n_shifts)]
    grey = np.stack([20 + 180 * (0.5 + 0.5 * np.cos(true - s)) ** 2.2 for s in shifts])
    result = decoded(stack_of(grey + rng.standard_normal(grey.shape), shifts, bits=8))
    assert (result.rejection == 0).all()
    # Harmonics above the fourth remain, and the curvature of the fringes for three steps.
    assert result.noise_dn == pytest.approx(np.sqrt(1 + 1 / 12), rel=0.1)


def test_second_harmonic_equals_that_of_the_images_from_five_unequal_steps_on() -> None:
    """Fewer steps cannot tell it from the rest."""
    true = all_phases()
    for n_shifts in (5, 6, 8):
        shifts = unequal_shifts(n_shifts)
        grey = grey_values(true, shifts, 30000.0, 20000.0)
        grey += np.stack([2000 * np.cos(2 * (true - s) + 0.4) for s in shifts])
        ratio = decoded(stack_of(grey, shifts)).harmonic_ratio
        # Unequal steps let the second harmonic into the first: 10 % of it at most.
        assert ratio == pytest.approx(0.1, rel=0.1)
    for n_shifts in (3, 4):
        shifts = unequal_shifts(n_shifts)
        stack = stack_of(grey_values(true, shifts, 30000.0, 20000.0), shifts)
        assert np.isnan(decoded(stack).harmonic_ratio)


@pytest.mark.parametrize(
    "shifts",
    [
        (0.0, np.pi),
        (0.0, 0.0, 0.0),
        (0.0, np.pi, 2 * np.pi),
        (0.0, 2 * np.pi / 3, 2 * np.pi / 3 - 2 * np.pi),
        (0.3, 0.3 + np.pi, 0.3, 0.3 - np.pi),
    ],
)
def test_shifts_with_fewer_than_three_different_steps_raise(shifts: tuple[float, ...]) -> None:
    """Two steps fix two of three unknowns."""
    stack = stack_of(np.full((len(shifts), 4, 5), 100.0), shifts)
    with pytest.raises(MethodError, match=r"camera 'c1'.*three different steps"):
        decoded(stack)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (2, 2)])
@pytest.mark.parametrize("n_shifts", [3, 4])
def test_tiny_images_decode_to_the_true_phase(shape: tuple[int, int], n_shifts: int) -> None:
    """Too few pixels to estimate any noise: quantisation is what is left."""
    shifts = [2 * np.pi * n / n_shifts for n in range(n_shifts)]
    true = np.full(shape, 1.2345)
    result = decoded(stack_of(grey_values(true, shifts, 30000.0, 25000.0), shifts))
    assert np.abs(turn_error(result.phase, true)).max() < (ROUNDING_DN + FLOAT32_DN) / 25000.0


def test_all_dark_and_all_saturated_images_give_no_phase_and_no_warning() -> None:
    """Bad pixels never raise."""
    shifts = [2 * np.pi * n / 5 for n in range(5)]
    for level, reason in ((0.0, Rejection.LOW_MODULATION), (65535.0, Rejection.SATURATED)):
        result = decoded(stack_of(np.full((5, 6, 7), level), shifts))
        assert ((result.rejection & reason) != 0).all()
        assert np.isnan(result.phase).all()
        assert np.isnan(result.noise_dn)
