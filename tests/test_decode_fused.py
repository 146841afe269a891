"""The compiled decoder: its arctangent against NumPy's, its maps against the plain decoder's.

What both make of a closed form stands in test_decode_phase.py and test_decode_code.py, which
test_decode_fused_reference.py repeats for the plain one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest
from numba import njit, prange
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.decode import CameraPhases, decode, wrapped_phase
from fringe3d.decode._fused import TILE, TWO_PI, ZERO, arctangent
from fringe3d.decode._mend import nearest_column, nearest_rows
from fringe3d.decode.gray import code_words
from fringe3d.decode.noise import NOISE_SAMPLE
from fringe3d.model import (
    NO_ORDER,
    Fringe,
    GrayBit,
    ImageStack,
    NoiseModel,
    PatternPlan,
    Rejection,
    WrappedPhaseMap,
)
from fringe3d.model.plan import fringes, gray_code
from fringe3d.patterns import intensity, sequence

ARCTANGENT_RAD = 4e-7
"""Stated bound. The polynomial is off by 3.8e-8 rad, float32 numbers up to pi by 1.2e-7, and the
quotient, eight terms and two differences are rounded once each."""

SUM_ROUNDING = 2e-6
"""Relative: sums of up to 16 products of float32, in another order."""

PROJECTOR = (768, 1024)


@njit(parallel=True)
def _arctangents(y, x, full_turn, result):  # type: ignore[no-untyped-def]
    for i in prange(len(y)):
        result[i] = arctangent(y[i], x[i], full_turn)


def arctangents(
    y: NDArray[np.float32], x: NDArray[np.float32], full_turn: np.float32 = ZERO
) -> NDArray[np.float32]:
    result = np.empty_like(y)
    _arctangents(y, x, full_turn, result)
    return result


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = numba.get_num_threads()
    if before < 2:
        pytest.skip("one processor")
    yield
    numba.set_num_threads(before)


@pytest.mark.parametrize("length", [1e-3, 1.0, 127.3, 3e4])
def test_arctangent_equals_that_of_numpy_within_its_bound(length: float) -> None:
    """A million directions, of the single-precision numbers that it is given."""
    angle = np.linspace(-np.pi, np.pi, 1_000_003)
    y = np.asarray(length * np.sin(angle), np.float32)
    x = np.asarray(length * np.cos(angle), np.float32)
    expected = np.arctan2(y.astype(np.float64), x.astype(np.float64))
    found = arctangents(y, x)
    assert np.abs(expected - found).max() < ARCTANGENT_RAD
    assert found.max() <= np.float32(np.pi)
    assert found.min() >= -np.float32(np.pi)


def test_arctangent_of_a_full_turn_starts_at_zero_and_stays_below_two_pi() -> None:
    """Also so little below zero that float32 makes it a full turn."""
    angle = np.concatenate([np.linspace(-np.pi, np.pi, 100_003), [-1e-7, -1e-9, -1e-20]])
    y, x = np.asarray(np.sin(angle), np.float32), np.asarray(np.cos(angle), np.float32)
    found = arctangents(y, x, TWO_PI)
    assert found.min() >= 0
    assert found.max() < TWO_PI
    expected = np.arctan2(y.astype(np.float64), x.astype(np.float64))
    turns = (found - expected) / (2 * np.pi)
    assert np.abs(turns - np.rint(turns)).max() < 1.5 * ARCTANGENT_RAD / (2 * np.pi)


def test_arctangent_on_axes_and_diagonals_equals_closed_form() -> None:
    """Also where both are zero, and with a negative zero: never -pi."""
    places = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]
    y = np.array([*(p[0] for p in places), -0.0, 0.0, 0.0], np.float32)
    x = np.array([*(p[1] for p in places), -1.0, 0.0, -0.0], np.float32)
    expected = [*(np.pi / 4 * k for k in (0, 1, 2, 3, 4, -3, -2, -1)), np.pi, 0.0, 0.0]
    np.testing.assert_allclose(expected, arctangents(y, x), rtol=0, atol=ARCTANGENT_RAD)


def plan(*periods_px: float, n_shifts: int = 4, **options: Any) -> PatternPlan:
    return sequence(PROJECTOR, periods_px=periods_px, n_shifts=n_shifts, **options)


PLANS = {
    "4 steps, 7 Gray, light, dark": plan(16.0, light_dark=True),
    "4 steps": plan(16.0, gray="none"),
    "16 steps": plan(16.0, n_shifts=16, gray="none"),
    "3 steps, plain code": plan(16.0, n_shifts=3, gray="plain"),
    "5 steps backwards, inverses": plan(13.7, n_shifts=5, inverses=True, reverse=True),
    "12 steps, reduced code": plan(16.0, n_shifts=12, gray_bits=3),
    "two directions": plan(20.0, angles=(0.0, np.pi / 2)),
    "three periods": plan(16.0, 128.0, 1024.0, gray="none"),
    "code and two periods": plan(40.0, 11.0, gray="plain"),
    "low bits of a long code": PatternPlan(
        patterns=fringes(16.0, 4) + gray_code(8.0, 7)[3:], projector_shape=PROJECTOR
    ),
    "inverses alone": PatternPlan(
        patterns=(
            *fringes(16.0, 4),
            *(GrayBit(bit=b, n_bits=7, cell_px=8.0, inverted=True) for b in range(7)),
        ),
        projector_shape=PROJECTOR,
    ),
    "unequal steps": PatternPlan(
        patterns=tuple(Fringe(period_px=16.0, shift=s) for s in (0.1, 1.4, 3.5, 4.4, 5.9, 7.7)),
        projector_shape=PROJECTOR,
    ),
}

SHAPES = [(1, 1), (3, TILE + 5), (19, 2 * TILE), (90, 301)]


def recorded(
    patterns: PatternPlan,
    shape: tuple[int, int],
    dtype: type[np.unsignedinteger[Any]],
    noise: NoiseModel | None = None,
) -> ImageStack:
    """Return noisy images of a step with texture, with saturated, dark and spoiled pixels."""
    rng = np.random.default_rng(17)
    full = float(np.iinfo(dtype).max)
    row, col = np.mgrid[: shape[0], : shape[1]] + 0.5
    x = 1020.0 * col / shape[1] - 40.0 * (row > shape[0] / 2)
    y = 760.0 * row / shape[0]
    albedo = (0.02 + np.abs(np.sin(0.031 * row) * np.cos(0.017 * col))) * 1.05
    albedo[rng.random(shape) < 0.05] = 0.0
    light = np.stack([intensity(pattern, x, y) for pattern in patterns.patterns])
    grey = full * (0.02 + 0.97 * albedo * light + 0.004 * rng.standard_normal(light.shape))
    spoiled = rng.random(grey.shape) < 0.002
    grey[spoiled] = full * rng.random(int(spoiled.sum()))
    return ImageStack(
        images=np.clip(np.rint(grey), 0, full).astype(dtype),
        plan=patterns,
        device_name="c1",
        saturation_dn=full,
        black_level_dn=round(0.015 * full),
        noise=noise,
    )


def tied(stack: ImageStack, wrapped: WrappedPhaseMap, full: float) -> NDArray[np.bool_]:
    """Tell where a bit equals its threshold, so that rounding decides."""
    result = np.zeros(stack.shape, bool)
    for gray_set in stack.plan.gray_sets:
        mean_dn = wrapped.offset + np.float32(stack.black_level_dn)
        result |= code_words(stack, gray_set, mean_dn=mean_dn).contrast_dn < SUM_ROUNDING * full
    return result


def assert_same(expected: CameraPhases, found: CameraPhases, stack: ImageStack) -> None:
    """Compare all maps of two decoders: reasons and orders exactly, the rest within rounding."""
    full = float(np.iinfo(stack.images.dtype).max)
    ties = tied(stack, expected.directions[0].wrapped[0], full)
    assert ties.mean() < 0.05
    for one, other in zip(expected.directions, found.directions, strict=True):
        assert len(one.others) == len(other.others)
        pairs = [(one.main, other.main), *zip(one.others, other.others, strict=True)]
        for a, b in pairs:
            assert a.period_px == b.period_px
            np.testing.assert_array_equal(a.rejection[~ties], b.rejection[~ties])
            np.testing.assert_array_equal(a.order_class[~ties], b.order_class[~ties])
            np.testing.assert_array_equal(a.class_of_order, b.class_of_order)
            assert abs(a.n_mended - b.n_mended) <= ties.sum()
        for c, d in zip(one.wrapped, other.wrapped, strict=True):
            assert_same_wrapped(c, d, full)


def assert_same_wrapped(a: WrappedPhaseMap, b: WrappedPhaseMap, full: float) -> None:
    good = a.rejection == 0
    np.testing.assert_array_equal(a.rejection, b.rejection)
    np.testing.assert_array_equal(good, np.isfinite(b.phase))
    rounding = SUM_ROUNDING * full
    np.testing.assert_allclose(a.offset, b.offset, rtol=0, atol=rounding)
    np.testing.assert_allclose(a.modulation, b.modulation, rtol=0, atol=rounding)
    turn = np.abs(np.angle(np.exp(1j * (a.phase[good].astype(float) - b.phase[good]))))
    assert (turn <= 2 * rounding / a.modulation[good] + 2 * ARCTANGENT_RAD).all()
    limit = 2 * rounding / a.modulation[good] + 1e-6
    assert (np.abs(a.phase_std[good] / b.phase_std[good] - 1) <= limit).all()
    assert a.noise_dn == pytest.approx(b.noise_dn, rel=1e-4, nan_ok=True)
    assert a.harmonic_ratio == pytest.approx(b.harmonic_ratio, abs=1e-4, nan_ok=True)
    assert (a.period_px, a.angle, a.n_shifts) == (b.period_px, b.angle, b.n_shifts)


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_maps_equal_those_of_the_plain_decoder(
    name: str, shape: tuple[int, int], dtype: type[np.unsignedinteger[Any]]
) -> None:
    """Every reason and order; phase, light and sigma within rounding."""
    stack = recorded(PLANS[name], shape, dtype)
    expected = decode(stack, plain=True)
    assert_same(expected, decode(stack), stack)
    if shape == SHAPES[-1]:  # the comparison means something
        reasons = np.bitwise_or.reduce(expected.directions[0].wrapped[0].rejection, axis=None)
        assert reasons & Rejection.SATURATED
        assert reasons & Rejection.LOW_MODULATION
        assert (expected.directions[0].main.rejection == 0).mean() > 0.3


@pytest.mark.parametrize("min_modulation_dn", [None, 0.0, 12.0])
@pytest.mark.parametrize("gain", [0.0, 0.05])
def test_maps_with_a_noise_model_equal_those_of_the_plain_decoder(
    gain: float, min_modulation_dn: float | None
) -> None:
    """Its shot noise differs from pixel to pixel."""
    noise = NoiseModel(read_noise_dn=1.3, gain_dn_per_e=gain)
    stack = recorded(PLANS["4 steps, 7 Gray, light, dark"], SHAPES[-1], np.uint8, noise)
    expected = decode(stack, min_modulation_dn=min_modulation_dn, plain=True)
    assert_same(expected, decode(stack, min_modulation_dn=min_modulation_dn), stack)


def test_noise_of_zero_rejects_what_has_no_modulation() -> None:
    """Zero by zero is no small sigma."""
    images = np.zeros((4, 5, 6), np.uint8)
    images[:, 0, 0] = (150, 100, 50, 100)
    stack = ImageStack(images=images, plan=PLANS["4 steps"], device_name="c1", saturation_dn=255,
                       noise=NoiseModel(read_noise_dn=0.0))  # fmt: skip
    for plain in (False, True):
        good = decode(stack, min_modulation_dn=0.0, plain=plain).directions[0].main.rejection == 0
        assert good[0, 0]
        assert good.sum() == 1


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("name", ["4 steps, 7 Gray, light, dark", "3 steps, plain code"])
def test_maps_are_the_same_bit_for_bit_with_one_and_with_two_threads(name: str) -> None:
    stack = recorded(PLANS[name], (90, 301), np.uint8)
    results = []
    for n_threads in (1, 2):
        numba.set_num_threads(n_threads)
        results.append(decode(stack).directions[0])
    for field in ("phase", "order_class", "offset", "modulation", "phase_std", "rejection"):
        one, two = (getattr(result.main, field) for result in results)
        assert one.tobytes() == two.tobytes()
    assert results[0].main.n_mended == results[1].main.n_mended


@njit
def _nearest(order, cells, nearest, result):  # type: ignore[no-untyped-def]
    nearest_rows(order, cells, 0, order.shape[1], nearest)
    for row in range(order.shape[0]):
        for col in range(order.shape[1]):
            found = nearest_column(nearest, row, col)
            result[0, row, col], result[1, row, col] = nearest[row, found], found


@pytest.mark.parametrize("density", [0.002, 0.02, 0.3, 0.9])
def test_nearest_safe_pixels_equal_those_of_scipy(density: float) -> None:
    """Of several equally near ones the same."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        safe = rng.random(rng.integers(1, 150, 2)) < density
        safe[rng.integers(0, safe.shape[0]), rng.integers(0, safe.shape[1])] = True
        expected = ndimage.distance_transform_edt(
            ~safe, return_distances=False, return_indices=True
        )
        order = np.where(safe, 5, np.int32(NO_ORDER)).astype(np.int32)
        found = np.empty_like(expected)
        _nearest(order, np.zeros_like(order), np.empty_like(order), found)
        np.testing.assert_array_equal(expected, found)


def test_images_that_are_a_view_decode_like_their_copy() -> None:
    """Every second pixel of larger images."""
    stack = recorded(PLANS["4 steps, 7 Gray, light, dark"], (60, 202), np.uint16)
    view = replace(stack, images=stack.images[:, ::2, ::2])
    copy = replace(stack, images=stack.images[:, ::2, ::2].copy())
    before = stack.images.copy()
    one, two = decode(view).directions[0].main, decode(copy).directions[0].main
    np.testing.assert_array_equal(one.phase, two.phase)
    np.testing.assert_array_equal(one.order_class, two.order_class)
    np.testing.assert_array_equal(before, stack.images)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("n_shifts", [3, 4, 8])
def test_noise_of_a_small_object_in_a_large_image_is_that_of_its_images(
    n_shifts: int, plain: bool
) -> None:
    """A sample of rows would hold a twentieth of it; sigma of half of 1600 pixels: 3 %."""
    shape = (1200, 640)
    assert shape[0] * shape[1] > 10 * NOISE_SAMPLE
    rng = np.random.default_rng(4)
    steps = PatternPlan(patterns=fringes(16.0, n_shifts), projector_shape=PROJECTOR)
    light = np.zeros((n_shifts, *shape))
    x = np.linspace(100, 112, 40)[None] + np.linspace(0, 3, 40)[:, None]
    place = np.s_[:, 607:647, 300:340]
    light[place] = [intensity(p, x, 0 * x) for p in steps.patterns]
    grey = 20 + 150 * light
    grey[place] += 1.2 * rng.standard_normal(grey[place].shape)
    stack = ImageStack(images=np.rint(grey).astype(np.uint8), plan=steps, device_name="c1",
                       saturation_dn=255)  # fmt: skip
    result = wrapped_phase(stack, steps.fringe_sets[0], plain=plain)
    assert result.noise_dn == pytest.approx(np.sqrt(1.2**2 + 1 / 12), rel=0.1)
    assert (result.rejection[place[1:]] == 0).all()
