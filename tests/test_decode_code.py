"""Every kind of plan decodes to the projector coordinates that its patterns were sampled at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.decode import DirectionPhases, decode
from fringe3d.decode.order import MAX_MISREAD, PHASE_BINS, all_orders, order_table
from fringe3d.errors import MethodError
from fringe3d.model import (
    NO_ORDER,
    GrayBit,
    ImageStack,
    NoiseModel,
    Pattern,
    PatternPlan,
    PhaseMap,
    Rejection,
)
from fringe3d.model.plan import GraySet, fringes, gray_code
from fringe3d.patterns import intensity, sequence

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHAPE = (768, 1024)
"""Rows and columns of the projector."""

DARK_DN, LIGHT_DN = 3000.0, 60000.0

EXACT_PX = 2e-3
"""Grey values of 16 bit are rounded to 0.5 DN: 1.5 / 28500 rad, 1.4e-4 px of 16 px, and 1e-3 px
of 128 px; float32 phases add 1024 * 6e-8 px."""


@cache
def gray_words(n_bits: int) -> tuple[int, ...]:
    """Return the reflected Gray code by its definition: prefix, reflect, prefix."""
    if n_bits == 0:
        return (0,)
    half = gray_words(n_bits - 1)
    return half + tuple((1 << (n_bits - 1)) | word for word in reversed(half))


def across(angle: float, x: Floats, y: Floats) -> Floats:
    """Return w from its definition."""
    return np.asarray(math.cos(angle) * (x + 0.5) + math.sin(angle) * (y + 0.5))


def ramp(n_rows: int = 40, n_cols: int = 1500, /) -> tuple[Floats, Floats]:
    """Return projector coordinates of a smooth image that covers the projector, edges included.

    Only a few fall on pixel centres of the projector.
    """
    v, u = np.meshgrid(np.linspace(0, 1, n_rows), np.linspace(0, 1, n_cols), indexing="ij")
    x = -0.49 + 1023.98 * (0.98 * u + 0.02 * v * u**2)
    y = -0.49 + 767.98 * (0.95 * v + 0.05 * u * v)
    return x, y


def scattered(n_rows: int = 60, n_cols: int = 500) -> tuple[Floats, Floats]:
    """Return projector coordinates in no order: neighbouring pixels know nothing of each other."""
    rng = np.random.default_rng(5)
    shape = (n_rows, n_cols)
    return rng.uniform(-0.49, 1023.49, shape), rng.uniform(-0.49, 767.49, shape)


def stack_of(plan: PatternPlan, light: Floats, *, noise_dn: float = 1.0) -> ImageStack:
    """Return 16-bit images of relative intensities (pattern, row, col)."""
    grey = np.rint(DARK_DN + (LIGHT_DN - DARK_DN) * light)
    return ImageStack(
        images=grey.astype(np.uint16),
        plan=plan,
        device_name="c1",
        saturation_dn=65535.0,
        noise=NoiseModel(read_noise_dn=noise_dn),
    )


def record(plan: PatternPlan, x: Floats, y: Floats) -> ImageStack:
    """Return what a camera records whose pixels see the projector coordinates x, y."""
    return stack_of(plan, np.stack([intensity(pattern, x, y) for pattern in plan.patterns]))


def directions(plan: PatternPlan, x: Floats, y: Floats) -> tuple[DirectionPhases, ...]:
    return decode(record(plan, x, y)).directions


def worst_px(phases: PhaseMap, true: Floats) -> float:
    """Return the largest error of w, px; every pixel must have one."""
    assert (phases.rejection == 0).all()
    return float(np.abs(phases.position_px - true).max())


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.radians(30), np.radians(-20)])
@pytest.mark.parametrize("inverted", [False, True])
def test_gray_images_equal_the_reflected_code_of_the_cell_counted_from_the_corner(
    angle: float, inverted: bool
) -> None:
    """Cyclic below zero, too."""
    x, y = scattered()
    for first_cell in (0, 5):
        for bit in range(4):
            pattern = GrayBit(bit=bit, n_bits=4, cell_px=11.3, angle=angle, inverted=inverted,
                              first_cell=first_cell)  # fmt: skip
            cells = [math.floor(w / 11.3) + first_cell for w in across(angle, x, y).ravel()]
            expected = [(gray_words(4)[cell % 16] >> bit) & 1 for cell in cells]
            found = intensity(pattern, x, y).ravel()
            np.testing.assert_array_equal(np.array(expected) ^ inverted, found)


ANGLES = [0.0, np.pi / 2, np.radians(30), np.radians(-20)]


@pytest.mark.parametrize("angle", ANGLES, ids=["0", "90", "30", "-20"])
@pytest.mark.parametrize("period", [16.0, 13.7, 31.4159])
@pytest.mark.parametrize("reverse", [False, True])
def test_complementary_code_decodes_to_the_sampled_coordinates(
    angle: float, period: float, reverse: bool
) -> None:
    """At every pixel for itself; with a negative angle orders below zero occur."""
    plan = sequence(SHAPE, periods_px=(period,), n_shifts=4, angles=(angle,), reverse=reverse)
    x, y = scattered()
    (direction,) = directions(plan, x, y)
    true = across(angle, x, y)
    assert worst_px(direction.main, true) < EXACT_PX
    assert direction.main.is_absolute
    assert (direction.main.first_order < 0) == (angle < 0)
    inner = np.abs(true / period - np.rint(true / period)) > EXACT_PX
    expected = np.floor(true / period).astype(int)
    np.testing.assert_array_equal(expected[inner], direction.main.order_class[inner])


@pytest.mark.parametrize("gray", ["plain", "complementary"])
@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("light_dark", [False, True])
@pytest.mark.parametrize("period", [16.0, 13.7])
def test_code_with_any_threshold_decodes_to_the_sampled_coordinates(
    gray: str, inverses: bool, light_dark: bool, period: float
) -> None:
    """On a smooth image, where a plain code can be mended; every column of the projector."""
    plan = sequence(SHAPE, periods_px=(period,), n_shifts=3, gray=gray, inverses=inverses,
                    light_dark=light_dark)  # fmt: skip
    x, y = ramp()
    (direction,) = directions(plan, x, y)
    assert worst_px(direction.main, x + 0.5) < EXACT_PX


@pytest.mark.parametrize("gray", ["plain", "complementary"])
def test_two_directions_decode_to_the_sampled_coordinates(gray: str) -> None:
    """Each from its own fringes and code, in the order of the plan."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, angles=(0.0, np.pi / 2), gray=gray)
    x, y = ramp(500, 650)
    horizontal, vertical = directions(plan, x, y)
    assert worst_px(horizontal.main, x + 0.5) < EXACT_PX
    assert worst_px(vertical.main, y + 0.5) < EXACT_PX


def test_pixel_centres_on_the_edges_of_cells_decode_to_themselves() -> None:
    """Half-pixel cells: with this period every second centre lies on an edge of the code."""
    plan = sequence(SHAPE, periods_px=(15.0,), n_shifts=4)
    x, y = np.meshgrid(np.arange(1024.0), np.arange(3.0))
    (direction,) = directions(plan, x, y)
    assert worst_px(direction.main, x + 0.5) < EXACT_PX


@pytest.mark.parametrize("gray", ["plain", "complementary"])
@pytest.mark.parametrize("angle", [0.0, np.radians(-20)], ids=["0", "-20"])
@pytest.mark.parametrize("n_bits", [1, 2, 3])
def test_reduced_code_leaves_the_classes_of_orders_modulo_its_length(
    gray: str, angle: float, n_bits: int
) -> None:
    """A class is named after its smallest member and holds every 2**n-th order."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, angles=(angle,), gray=gray,
                    gray_bits=n_bits)  # fmt: skip
    x, y = ramp(200)
    main = directions(plan, x, y)[0].main
    first = math.floor(across(angle, np.array([-0.5]), np.array([767.5])).item() / 16)
    first = first if angle < 0 else 0
    assert first == main.first_order
    expected = np.arange(len(main.class_of_order)) % (1 << n_bits) + first
    np.testing.assert_array_equal(expected, main.class_of_order)
    true = across(angle, x, y) / 16
    true_order = np.floor(true).astype(int)
    turns = main.phase / (2 * np.pi) + main.order_class
    assert (main.rejection == 0).all()
    # The class of the true order, also where rounding moves the phase over the wrap.
    away = (turns - true) / (1 << n_bits)
    assert np.abs(away - np.rint(away)).max() * 16 * (1 << n_bits) < EXACT_PX
    assert np.isin(main.order_class, main.class_of_order).all()
    assert true_order.max() - true_order.min() >= 2 << n_bits  # the code repeats


@pytest.mark.parametrize("kept", [(6, 5, 4, 3, 2, 1), (5, 4, 3, 2, 1, 0), (6, 4, 2, 0), (2, 1, 0)])
def test_code_with_bits_left_out_leaves_exactly_the_orders_that_show_the_same_bits(
    kept: tuple[int, ...],
) -> None:
    """Brute force over the reflected code; low bits of a long code are no cyclic code."""
    bits = tuple(GrayBit(bit=bit, n_bits=7, cell_px=8.0) for bit in kept)
    plan = PatternPlan(patterns=fringes(16.0, 4) + bits, projector_shape=SHAPE)
    x, y = ramp()
    main = directions(plan, x, y)[0].main

    def shown(cell: int) -> tuple[int, ...]:
        return tuple((gray_words(7)[cell] >> bit) & 1 for bit in kept)

    words = [(shown(2 * order), shown(2 * order + 1)) for order in range(64)]
    expected = [words.index(word) for word in words]
    np.testing.assert_array_equal(expected, main.class_of_order)
    true_order = np.floor((x + 0.5) / 16).astype(int)
    inner = np.abs((x + 0.5) / 16 - np.rint((x + 0.5) / 16)) > EXACT_PX
    known = (main.rejection == 0) & inner
    np.testing.assert_array_equal(np.array(expected)[true_order[known]], main.order_class[known])
    assert known[inner].all()


@pytest.mark.parametrize(
    ("periods", "degrees"),
    [
        ((16.0, 128.0, 1024.0), 0),
        ((1024.0, 64.0, 8.0), 0),
        ((13.7, 111.0, 1031.5), 0),
        ((21.0, 22.1, 25.3), 0),
        ((21.0, 22.1, 25.3), -20),
        ((30.0, 31.0, 37.3), -20),
        ((21.0, 21.43), 0),
    ],
    ids=["hierarchical", "reversed", "non-integer", "heterodyne", "oblique", "three", "beat"],
)
def test_several_periods_decode_to_the_sampled_coordinates(
    periods: tuple[float, ...], degrees: float
) -> None:
    """The finest is the main one; the others stand on the same footing."""
    x, y = scattered()
    angle = math.radians(degrees)
    plan = sequence(SHAPE, periods_px=periods, n_shifts=4, angles=(angle,), gray="none")
    (direction,) = directions(plan, x, y)
    true = across(angle, x, y)
    good = direction.main.rejection == 0
    assert min(periods) == direction.main.period_px
    error = np.abs(direction.main.position_px - true)
    # Rejected only next to the border, where a neighbouring order fits as well.
    assert good.mean() > 0.999
    assert error[good].max() < EXACT_PX
    for other in direction.others:
        both = good & (other.rejection == 0)
        assert both.mean() > 0.999
        tolerance = EXACT_PX * max(1.0, other.period_px / 128)
        assert np.abs(other.position_px - true)[both].max() < tolerance


@pytest.mark.parametrize(("other", "cycle"), [(32.0, 2), (17.0, 17)])
def test_periods_that_repeat_leave_classes_of_orders(other: float, cycle: int) -> None:
    """16 and 32 px repeat after 32 px, 16 and 17 px after 272 px = 17 periods."""
    plan = sequence(SHAPE, periods_px=(16.0, other), n_shifts=4, gray="none")
    x, y = scattered()
    main = directions(plan, x, y)[0].main
    good = main.rejection == 0
    true = np.floor(across(0.0, x, y) / 16)
    assert good.mean() > 0.999
    assert not main.is_absolute
    np.testing.assert_array_equal(main.order_class[good], true[good] % cycle)
    np.testing.assert_array_equal(main.class_of_order, np.arange(len(main.class_of_order)) % cycle)


def test_one_period_without_code_leaves_one_class_of_all_orders() -> None:
    """Nothing is known but the phase."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray="none")
    x, y = scattered()
    main = directions(plan, x, y)[0].main
    assert not main.is_absolute
    assert (main.class_of_order == 0).all()
    np.testing.assert_array_equal(64, len(main.class_of_order))
    turns = (x + 0.5) / 16
    error = main.phase / (2 * np.pi) - turns
    assert np.abs(error - np.rint(error)).max() * 16 < EXACT_PX


@pytest.mark.parametrize("gray", ["plain", "complementary"])
def test_gray_code_with_several_periods_decodes_all_to_the_sampled_coordinates(gray: str) -> None:
    """The code numbers the first period; the finer one is unwrapped by it."""
    plan = sequence(SHAPE, periods_px=(40.0, 11.0, 27.3), n_shifts=4, gray=gray)
    x, y = ramp()
    (direction,) = directions(plan, x, y)
    assert direction.main.period_px == 11.0
    assert worst_px(direction.main, x + 0.5) < EXACT_PX
    assert sorted(m.period_px for m in direction.others) == [27.3, 40.0]
    for other in direction.others:
        assert worst_px(other, x + 0.5) < EXACT_PX


@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("angle", [0.0, np.radians(-20)], ids=["0", "-20"])
def test_gray_code_alone_in_two_directions_gives_the_middle_of_the_cell(
    inverses: bool, angle: float
) -> None:
    """Of 4 px: no closer, no farther."""
    plan = sequence(SHAPE, periods_px=(4.0,), n_shifts=0, angles=(angle, angle + np.pi / 2),
                    gray="plain", inverses=inverses, light_dark=not inverses)  # fmt: skip
    x, y = scattered()
    found = decode(record(plan, x, y), whole_cells=True).directions
    for direction, turned in zip(found, (angle, angle + np.pi / 2), strict=True):
        true = across(turned, x, y)
        assert (direction.main.rejection == 0).all()
        assert direction.main.is_quantised
        expected = (np.floor(true / 4) + 0.5) * 4
        np.testing.assert_allclose(expected, direction.main.position_px, rtol=0, atol=1e-4)
        np.testing.assert_allclose(
            4 / np.sqrt(12), direction.main.phase_std * 4 / (2 * np.pi), rtol=1e-5
        )


@pytest.mark.parametrize("slope", [0.35, 0.83, 1.3])
def test_gray_code_alone_in_one_direction_is_smoothed_to_its_predicted_sigma(slope: float) -> None:
    """A tilted plane: unbiased, and no worse than predicted; the sigma is a cautious one."""
    rows, cols = np.mgrid[:80, :120].astype(float)
    x = 20.2 + 4 * slope * (cols + 0.17 * rows)
    plan = sequence(SHAPE, periods_px=(4.0,), n_shifts=0, gray="plain", inverses=True)
    main = directions(plan, x, 0 * x)[0].main
    assert (main.rejection == 0).all()
    error = (main.position_px - (x + 0.5))[4:-4, 4:-4]
    sigma = (main.phase_std * main.period_px / (2 * np.pi))[4:-4, 4:-4]
    assert abs(float(error.mean())) < 0.02
    assert float(error.std()) < 4 / np.sqrt(12) / 2  # finer than cells
    assert float((error / sigma).std()) < 1.15


def test_gray_code_alone_needs_all_its_bits_and_a_threshold() -> None:
    """Both are said in words."""
    x, y = scattered(3, 4)
    reduced = sequence(SHAPE, periods_px=(4.0,), n_shifts=0, gray="plain", gray_bits=3,
                       inverses=True)  # fmt: skip
    with pytest.raises(MethodError, match="3 Gray-code bits do not tell 256 cells"):
        directions(reduced, x, y)
    bare = sequence(SHAPE, periods_px=(4.0,), n_shifts=0, gray="plain")
    with pytest.raises(MethodError, match="bit 7 has no threshold"):
        directions(bare, x, y)


# Edges of the code


def misread(
    plan: PatternPlan, x: Floats, angle: float, reach_px: float, *, seed: int = 7
) -> tuple[ImageStack, Ints]:
    """Return images whose code bits are read up to `reach_px` away, and the cells as read.

    Every bit of every pixel is read at a place of its own: between an edge and `reach_px` from
    it a bit is wrong at random, as noise and blur make it.
    """
    rng = np.random.default_rng(seed)
    light = np.empty((plan.n_images, *x.shape))
    word = np.zeros(x.shape, np.int64)
    n_bits, cell_px = 1, 1.0
    for index, pattern in enumerate(plan.patterns):
        moved = x
        if isinstance(pattern, GrayBit):
            moved = x + rng.uniform(-reach_px, reach_px, x.shape)
        light[index] = intensity(pattern, moved, 0 * x)
        if isinstance(pattern, GrayBit):
            assert pattern.angle == angle
            assert not pattern.inverted
            word = (word << 1) | light[index].astype(np.int64)
            n_bits, cell_px = pattern.n_bits, pattern.cell_px
    cell_of_word = np.argsort(gray_words(n_bits))
    assert cell_px > 0
    return stack_of(plan, light), cell_of_word[word]


@pytest.mark.parametrize("gray_bits", [None, 2], ids=["full", "reduced"])
@pytest.mark.parametrize("period", [16.0, 13.7])
def test_complementary_code_survives_bits_misread_up_to_a_quarter_period_from_their_edges(
    period: float, gray_bits: int | None
) -> None:
    """Each pixel for itself; the cells beyond the corner of the projector are not read."""
    plan = sequence(SHAPE, periods_px=(period,), n_shifts=4, gray_bits=gray_bits)
    rng = np.random.default_rng(11)
    x = rng.uniform(period, 1023 - period, (60, 500))
    stack, cells = misread(plan, x, 0.0, 0.249 * period)
    main = decode(stack).directions[0].main
    assert (main.rejection == 0).all()
    true = (x + 0.5) / period
    cycle = 1 << gray_bits if gray_bits else 64 if period == 16 else 128
    away = (main.phase / (2 * np.pi) + main.order_class - true) / cycle
    assert np.abs(away - np.rint(away)).max() * cycle * period < EXACT_PX
    # What the code alone would have said is wrong for a quarter of all pixels times a half.
    phase_turns = true - np.floor(true)
    clear = np.abs(phase_turns - np.rint(phase_turns)) > EXACT_PX
    n_naive = int(((cells // 2 - np.floor(true).astype(int)) % cycle != 0)[clear].sum())
    assert n_naive > 1000
    assert main.n_mended == pytest.approx(n_naive, abs=int((~clear).sum()))


@pytest.mark.parametrize("gray_bits", [None, 2], ids=["full", "reduced"])
@pytest.mark.parametrize("reach", [0.05, 0.24])
def test_plain_code_misread_near_its_edges_is_mended_on_a_smooth_surface(
    reach: float, gray_bits: int | None
) -> None:
    """By the nearest pixel in the middle of a period; each mended pixel is counted once."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray="plain", gray_bits=gray_bits)
    x = np.clip(ramp()[0], 16.0, 1007.0)
    stack, cells = misread(plan, x, 0.0, reach * 16)
    main = decode(stack).directions[0].main
    assert (main.rejection == 0).all()
    true = (x + 0.5) / 16
    cycle = 1 << gray_bits if gray_bits else 64
    away = (main.phase / (2 * np.pi) + main.order_class - true) / cycle
    assert np.abs(away - np.rint(away)).max() * cycle * 16 < EXACT_PX
    wrong = (cells - np.floor(true).astype(int)) % cycle != 0
    clear = np.abs(true - np.rint(true)) * 16 > EXACT_PX
    assert wrong.sum() > 500
    assert main.n_mended == pytest.approx(int(wrong[clear].sum()), abs=int((~clear).sum()))


@pytest.mark.parametrize("gray", ["plain", "complementary"])
@pytest.mark.parametrize("blur", [0.1, 0.2])
def test_blurred_and_noisy_gray_images_leave_no_error_of_one_period(gray: str, blur: float) -> None:
    """Blur of the code alone, in periods; noise of 8 % decides the bits at their edges."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=8, gray=gray)
    x, y = ramp()
    rng = np.random.default_rng(9)
    light = np.stack([intensity(pattern, x, y) for pattern in plan.patterns])
    per_column = 1024 / x.shape[1]
    for index, pattern in enumerate(plan.patterns):
        if isinstance(pattern, GrayBit):
            light[index] = ndimage.gaussian_filter(light[index], (0, blur * 16 / per_column))
            light[index] += 0.08 * rng.standard_normal(x.shape)
    stack = stack_of(plan, np.clip(light, -0.05, 1.09))
    main = decode(stack).directions[0].main
    inner = (x > 16) & (x < 1006)
    assert (main.rejection[inner] == 0).all()
    assert np.abs(main.position_px - (x + 0.5))[inner].max() < EXACT_PX
    assert main.n_mended > 100


def test_clean_code_mends_next_to_nothing() -> None:
    """Only pixels whose rounded phase lies across the wrap from the code."""
    for gray in ("plain", "complementary"):
        plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4, gray=gray)
        x, y = ramp()
        main = directions(plan, x, y)[0].main
        at_wrap = np.abs((x + 0.5) / 16 - np.rint((x + 0.5) / 16)) * 16 < EXACT_PX
        assert main.n_mended <= at_wrap.sum()


@pytest.mark.parametrize("displaced", [-0.3, -0.2, 0.0, 0.2, 0.3])
def test_order_equals_that_of_the_cell_as_read_nearest_to_the_phase(displaced: float) -> None:
    """Closed form round((cell + 1/2) / 2 - phase): right below a quarter period, else one off.

    No complementary code can do better: every cell as read lies near one order.
    """
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4)
    x = np.random.default_rng(3).uniform(32, 990, (40, 500))
    light = np.stack([
        intensity(pattern, x + displaced * 16 * isinstance(pattern, GrayBit), 0 * x)
        for pattern in plan.patterns
    ])  # fmt: skip
    main = decode(stack_of(plan, light)).directions[0].main
    turns = (x + 0.5) / 16
    cell = np.floor((turns + displaced) * 2)
    nearest = (cell + 0.5) / 2 - (turns - np.floor(turns))
    # The phase is looked up in sixteenths; at their borders rounding decides.
    clear = np.abs(turns * PHASE_BINS - np.rint(turns * PHASE_BINS)) > 1e-3
    np.testing.assert_array_equal(np.rint(nearest)[clear], main.order_class[clear])
    n_wrong = int((main.order_class != np.floor(turns))[clear].sum())
    assert (n_wrong > 0) == (abs(displaced) > MAX_MISREAD)


def test_words_of_cells_beyond_the_projector_are_inconsistent() -> None:
    """Seven bits number 128 cells of 8 px; the projector of 800 px has 100."""
    plan = sequence((600, 800), periods_px=(16.0,), n_shifts=4, gray_bits=6)
    x = np.random.default_rng(3).uniform(-0.4, 1023, (40, 500))
    main = decode(record(plan, x, 0 * x)).directions[0].main
    # A word may be misread by a quarter period, hence the first cell behind the border counts.
    known = x + 0.5 < 800 + 16 * MAX_MISREAD
    clear = np.abs(x + 0.5 - 800) > 16 * MAX_MISREAD
    clear &= x + 0.5 < 1024 - 16 * MAX_MISREAD
    expected = np.where(known, 0, int(Rejection.INCONSISTENT_CODE))
    np.testing.assert_array_equal(expected[clear], main.rejection[clear])


def brute_force_words(gray_set: GraySet, turns: Floats, period: float) -> list[int]:
    """Return the word at each place, from the definition of the code."""
    words = []
    for turn in turns:
        cell = math.floor(turn * period / gray_set.cell_px + 1e-9) + gray_set.first_cell
        code = gray_words(gray_set.n_bits)[cell % (1 << gray_set.n_bits)]
        word = 0
        for bit in gray_set.bits:
            word = 2 * word + ((code >> bit) & 1)
        words.append(word)
    return words


TABLES: list[tuple[Sequence[Pattern], float, tuple[float, float]]] = [
    (gray_code(8.0, 7), 16.0, (0.0, 1024.0)),
    (gray_code(8.0, 3), 16.0, (0.0, 400.0)),
    (gray_code(16.0, 3), 16.0, (-100.0, 300.0)),
    (gray_code(6.85, 5), 13.7, (-50.0, 150.0)),
    (gray_code(8.0, 6)[2:], 16.0, (0.0, 512.0)),
]


@pytest.mark.parametrize(("patterns", "period", "extent"), TABLES)
def test_order_table_equals_brute_force(
    patterns: tuple[Pattern, ...], period: float, extent: tuple[float, float]
) -> None:
    """A word means the order whose place with this word is nearest, within a quarter period.

    Places beyond the border of the projector have none.
    """
    gray_set = PatternPlan(patterns=patterns).gray_sets[0]
    table = order_table(gray_set, period, extent)
    orders = range(math.floor(extent[0] / period), math.ceil(extent[1] / period))
    assert list(orders) == [
        table.classes.first_order + i for i in range(len(table.classes.class_of_order))
    ]
    centres = (np.arange(PHASE_BINS) + 0.5) / PHASE_BINS
    profiles = [tuple(brute_force_words(gray_set, k + centres, period)) for k in orders]
    name = {k: orders[profiles.index(profile)] for k, profile in zip(orders, profiles, strict=True)}
    assert [name[k] for k in orders] == table.classes.class_of_order.tolist()

    n_steps = round(MAX_MISREAD * PHASE_BINS)
    found: dict[tuple[int, int], dict[int, set[int]]] = {}
    for k in orders:
        for step in range(-n_steps, n_steps + 1):
            seen = brute_force_words(gray_set, k + centres + step / PHASE_BINS, period)
            for part, word in enumerate(seen):
                place = (k + centres[part] + step / PHASE_BINS) * period
                if not extent[0] < place < extent[1]:
                    continue  # a cyclic code starts anew beyond the border
                by_distance = found.setdefault((word, part), {})
                by_distance.setdefault(abs(step), set()).add(name[k])
    for word in range(len(table.by_word)):
        for part in range(PHASE_BINS):
            by_distance = found.get((word, part), {})
            allowed = by_distance[min(by_distance)] if by_distance else {NO_ORDER}
            assert table.by_word[word, part] in allowed


def test_orders_of_a_projector_are_those_of_its_periods() -> None:
    """The last, cut-off period counts; a border that falls on an edge adds none."""
    assert all_orders(16.0, (0.0, 1024.0)).class_of_order.tolist() == list(range(64))
    assert all_orders(100.0, (0.0, 1024.0)).class_of_order.tolist() == list(range(11))
    assert all_orders(100.0, (-150.0, 50.0)).class_of_order.tolist() == [-2, -1, 0]
    assert all_orders(0.1, (0.0, 0.3)).class_of_order.tolist() == [0, 1, 2]


def test_saturated_and_dark_pixels_have_no_order() -> None:
    """NaN and NO_ORDER exactly where there is a reason."""
    plan = sequence(SHAPE, periods_px=(16.0,), n_shifts=4)
    x, y = ramp(6, 300)
    stack = record(plan, x, y)
    images = np.array(stack.images)
    images[:, 0] = 500
    images[0, 1] = images[1, 1] = 65535  # and so never without contrast
    spoiled = ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=65535.0)
    main = decode(spoiled).directions[0].main
    expected = np.zeros(x.shape, np.uint16)
    expected[0] = Rejection.LOW_MODULATION
    expected[1] = Rejection.SATURATED
    np.testing.assert_array_equal(expected, main.rejection)
    np.testing.assert_array_equal(expected != 0, np.isnan(main.phase))
    np.testing.assert_array_equal(expected != 0, main.order_class == NO_ORDER)
    np.testing.assert_array_equal(expected != 0, np.isnan(main.position_px))
