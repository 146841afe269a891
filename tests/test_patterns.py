"""What a pattern looks like, against hand-computed tables and the formulas of other software."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fringe3d.cli import main
from fringe3d.errors import PlanError
from fringe3d.io.scanfile import plan_text, read_plan
from fringe3d.io.sequencefile import FringesTable, GrayTable
from fringe3d.model import Fringe, GrayBit, Pattern, PatternPlan, Uniform, Unused
from fringe3d.model.plan import fringes, gray_code
from fringe3d.patterns import (
    across,
    extent_px,
    full_gray_bits,
    intensity,
    numbering,
    pattern_image,
    sequence,
    unambiguous_px,
)

Floats = NDArray[np.float64]

ROUNDING = 1e-12
"""float64 rounding of a cosine of some hundred radians."""

DEGREES_ROUNDING = 1e-9
"""Angles and shifts go through the file in degrees."""

HALF_STEP_8 = 0.5 / 255 + ROUNDING
HALF_STEP_16 = 0.5 / 65535 + ROUNDING
"""Largest rounding error of an image of 8 or 16 bit, of full scale."""

angles = st.sampled_from([0.0, math.pi / 2, math.radians(37), math.radians(-20), 3.0])
periods = st.floats(2.5, 100)
coordinates = st.floats(-10, 1500)


def code_number(bits: list[NDArray[np.bool_]]) -> NDArray[np.int64]:
    """Return the number of a Gray code, MSB first, by running parity."""
    binary = np.logical_xor.accumulate(np.array(bits), axis=0)
    weights = 1 << np.arange(len(bits))[::-1]
    return np.asarray(weights @ binary.astype(np.int64))


def cells_of(patterns: tuple[Pattern, ...], n_cells: int, cell_px: float) -> NDArray[np.bool_]:
    """Return (pattern, cell), True where the middle of a cell is bright; stripes along y."""
    middles = (np.arange(n_cells) + 0.5) * cell_px - 0.5
    return np.array([intensity(pattern, middles, 0.0) > 0.5 for pattern in patterns])


class TestFringe:
    @pytest.mark.parametrize(
        ("x", "y", "shift_deg", "angle_deg", "expected"),
        [
            # w = x + 1/2 at 0 deg, y + 1/2 at 90 deg; one period is 8 px.
            (-0.5, 99.0, 0, 0, 1.0),
            (1.5, 99.0, 0, 0, 0.5),
            (3.5, 99.0, 0, 0, 0.0),
            (0.5, 99.0, 0, 0, 0.5 + 0.5 * math.sqrt(0.5)),
            (0.5, 99.0, 45, 0, 1.0),
            (0.5, 99.0, -45, 0, 0.5),
            (1.5, 99.0, 90, 0, 1.0),
            (1.5, 99.0, -90, 0, 0.0),
            (99.0, 1.5, 90, 90, 1.0),
            (99.0, 3.5, 0, 90, 0.0),
            # At 45 deg (x, y) = (3.5, 3.5) has w = 8 / sqrt(2).
            (3.5, 3.5, 360 / math.sqrt(2), 45, 1.0),
            (3.5, -4.5, 0, 45, 1.0),
            (3.5, -4.5, 180, 45, 0.0),
        ],
    )
    def test_intensity_equals_hand_computed_table(
        self, x: float, y: float, shift_deg: float, angle_deg: float, expected: float
    ) -> None:
        pattern = Fringe(period_px=8, shift=math.radians(shift_deg), angle=math.radians(angle_deg))
        assert expected == pytest.approx(intensity(pattern, x, y).item(), abs=ROUNDING)

    @given(periods, angles, st.floats(-7, 7), coordinates, coordinates)
    def test_intensity_equals_the_formula_of_the_conventions(
        self, period_px: float, angle: float, shift: float, x: float, y: float
    ) -> None:
        w = math.cos(angle) * (x + 0.5) + math.sin(angle) * (y + 0.5)
        expected = 0.5 + 0.5 * math.cos(2 * math.pi * w / period_px - shift)
        found = intensity(Fringe(period_px=period_px, shift=shift, angle=angle), x, y).item()
        large_phases = 1e-10
        assert expected == pytest.approx(found, abs=large_phases)

    @pytest.mark.parametrize("n_shifts", [3, 4, 5, 7, 8, 16])
    @pytest.mark.parametrize("reverse", [False, True])
    def test_phase_of_the_first_harmonic_grows_with_x(self, n_shifts: int, reverse: bool) -> None:
        x = np.arange(40.0)
        images = [intensity(p, x, 0.0) for p in fringes(9.7, n_shifts, reverse=reverse)]
        direction = -1 if reverse else 1
        steps = np.exp(direction * 2j * np.pi * np.arange(n_shifts) / n_shifts)
        phase = np.angle(steps @ np.array(images))
        expected = 2 * np.pi * (x + 0.5) / 9.7
        np.testing.assert_allclose(1, np.exp(1j * (phase - expected)), atol=ROUNDING)

    def test_bright_line_moves_to_larger_coordinates_from_image_to_image(self) -> None:
        x = np.arange(0, 7.9, 0.01)
        for reverse, sign in ((False, 1), (True, -1)):
            first, second, *_ = fringes(16, 8, reverse=reverse)
            shifted = intensity(first, x - sign * 2.0, 0.0)
            np.testing.assert_allclose(shifted, intensity(second, x, 0.0), atol=ROUNDING)

    def test_broadcast_of_rows_and_columns_gives_an_image(self) -> None:
        x, y = np.arange(5)[None], np.arange(3)[:, None]
        assert intensity(Fringe(period_px=4, shift=0), x, y).shape == (3, 5)
        assert intensity(Uniform(level=0.25), x, y).tolist() == [[0.25] * 5] * 3

    def test_unused_image_has_no_intensity(self) -> None:
        with pytest.raises(ValueError, match="no known intensity"):
            intensity(Unused(), 0.0, 0.0)


class TestAcross:
    def test_coordinate_starts_at_the_corner_of_the_projector(self) -> None:
        for angle in (0.0, 0.6, math.pi / 2):
            assert across(angle, -0.5, -0.5).item() == 0

    @given(angles, st.integers(1, 60), st.integers(1, 60))
    def test_extent_is_the_range_over_the_whole_area(
        self, angle: float, n_rows: int, n_cols: int
    ) -> None:
        x, y = np.meshgrid(np.linspace(-0.5, n_cols - 0.5, 9), np.linspace(-0.5, n_rows - 0.5, 9))
        w = (x + 0.5) * math.cos(angle) + (y + 0.5) * math.sin(angle)
        expected = (w.min(), w.max())
        assert expected == pytest.approx(extent_px((n_rows, n_cols), angle), abs=ROUNDING)


class TestGrayCode:
    @pytest.mark.parametrize("n_bits", [1, 2, 5, 8])
    def test_neighbouring_cells_differ_in_one_bit_also_where_the_code_starts_again(
        self, n_bits: int
    ) -> None:
        bits = cells_of(gray_code(3.5, n_bits), 3 << n_bits, 3.5)
        assert set((bits[:, 1:] != bits[:, :-1]).sum(axis=0)) == {1}

    def test_three_bits_equal_the_table_of_the_reflected_code(self) -> None:
        expected = ["000", "001", "011", "010", "110", "111", "101", "100"]
        bits = cells_of(gray_code(4, 3), 8, 4.0)
        assert expected == ["".join("01"[int(bit)] for bit in cell) for cell in bits.T]

    @pytest.mark.parametrize("n_bits", [1, 3, 6])
    def test_number_of_a_cell_counts_up_and_starts_again(self, n_bits: int) -> None:
        n_cells = 3 << n_bits
        found = code_number(list(cells_of(gray_code(7.3, n_bits), n_cells, 7.3)))
        assert [k % (1 << n_bits) for k in range(n_cells)] == found.tolist()

    def test_cyclic_code_is_unique_in_every_window_of_its_length(self) -> None:
        bits = cells_of(gray_code(5, 3), 40, 5.0)
        codes = [tuple(cell) for cell in bits.T]
        for start in range(40 - 8 + 1):
            assert len(set(codes[start : start + 8])) == 8

    def test_low_bits_of_a_longer_code_would_not_be_unique_in_a_window(self) -> None:
        low = cells_of(gray_code(5, 5)[2:], 32, 5.0)
        codes = [tuple(cell) for cell in low.T]
        assert min(len(set(codes[i : i + 8])) for i in range(25)) < 8

    @pytest.mark.parametrize("angle_deg", [0, 90, 37, -20, 120])
    @pytest.mark.parametrize("period", [16.0, 13.7])
    def test_full_code_numbers_every_cell_of_the_projector_uniquely(
        self, angle_deg: float, period: float
    ) -> None:
        shape, angle = (77, 150), math.radians(angle_deg)
        n_bits = full_gray_bits(shape, period, angle)
        y, x = np.mgrid[: shape[0], : shape[1]]
        w = math.cos(angle) * (x + 0.5) + math.sin(angle) * (y + 0.5)
        cell = np.floor(w / period + ROUNDING).astype(int)
        bits = [intensity(p, x, y) > 0.5 for p in gray_code(period, n_bits, angle=angle)]
        number = code_number([bit.ravel() for bit in bits])
        pairs = set(zip(cell.ravel().tolist(), number.tolist(), strict=True))
        assert len(pairs) == len({c for c, _ in pairs}) == len({n for _, n in pairs})
        n_cells = cell.max() - cell.min() + 1
        assert n_cells <= 2**n_bits

    @pytest.mark.parametrize(("n_cols", "expected"), [(128, 3), (129, 4), (16, 1), (1024, 6)])
    def test_full_code_takes_no_image_more_than_its_cells_need(
        self, n_cols: int, expected: int
    ) -> None:
        assert expected == full_gray_bits((10, n_cols), 16.0, 0.0)

    def test_inverse_is_bright_where_the_image_is_dark(self) -> None:
        x = np.arange(-5.0, 300.0)
        code = gray_code(6.5, 4, inverses=True)
        for plain, inverse in zip(code[::2], code[1::2], strict=True):
            assert (1 - intensity(plain, x, 0.0)).tolist() == intensity(inverse, x, 0.0).tolist()

    def test_pixel_center_on_an_edge_belongs_to_the_cell_that_starts_there(self) -> None:
        # At 270 deg w = -(y + 1/2), up to a rounding that grows with x.
        pattern = GrayBit(bit=0, n_bits=2, cell_px=0.5, angle=math.radians(270))
        y = np.arange(100)
        expected = [-(2 * row + 1) % 4 in (1, 2) for row in range(100)]
        assert expected == (intensity(pattern, 1500.0, y) > 0.5).tolist()

    @pytest.mark.parametrize("first_cell", [1, 3, -2])
    def test_first_cell_is_the_number_at_the_edge(self, first_cell: int) -> None:
        shifted = tuple(
            GrayBit(bit=bit, n_bits=3, cell_px=4, first_cell=first_cell) for bit in (2, 1, 0)
        )
        found = code_number(list(cells_of(shifted, 20, 4.0)))
        assert [(k + first_cell) % 8 for k in range(20)] == found.tolist()

    def test_complementary_code_has_one_edge_in_and_one_at_the_end_of_each_period(self) -> None:
        # The coarser bits together number the periods, and the finest image has its edges in the
        # middle of the periods alone: no edge of it lies where the phase wraps.
        period = 16.0
        plan = sequence((20, 256), periods_px=(period,), n_shifts=4)
        code = [p for p in plan.patterns if isinstance(p, GrayBit)]
        assert {p.cell_px for p in code} == {period / 2}
        finest = next(p for p in code if p.bit == 0)
        around = np.arange(1, 16) * period - 0.5
        before, after = (intensity(finest, around + side, 0.0) for side in (-0.1, 0.1))
        assert before.tolist() == after.tolist()
        middles = around - period / 2
        before, after = (intensity(finest, middles + side, 0.0) for side in (-0.1, 0.1))
        assert (before != after).all()

    def test_coarser_bits_of_the_complementary_code_change_at_wraps_only(self) -> None:
        code = gray_code(8, 6)
        middles = np.arange(1, 31) * 16.0 - 8.0 - 0.5
        for pattern in code[:-1]:
            before, after = (intensity(pattern, middles + side, 0.0) for side in (-0.1, 0.1))
            assert before.tolist() == after.tolist()


class TestPatternImage:
    @pytest.mark.parametrize(
        ("bit_depth", "dtype", "half_step"),
        [(8, np.uint8, HALF_STEP_8), (16, np.uint16, HALF_STEP_16)],
    )
    def test_image_is_the_intensity_at_the_pixel_centers_rounded(
        self, bit_depth: int, dtype: type[np.generic], half_step: float
    ) -> None:
        pattern = Fringe(period_px=9.3, shift=0.7, angle=0.4)
        image = pattern_image(pattern, (12, 31), bit_depth=bit_depth)
        assert image.shape == (12, 31)
        assert image.dtype == np.dtype(dtype)
        expected = [
            [
                0.5 + 0.5 * math.cos(
                    2 * math.pi * (math.cos(0.4) * (x + 0.5) + math.sin(0.4) * (y + 0.5)) / 9.3
                    - 0.7
                )
                for x in range(31)
            ]
            for y in range(12)
        ]  # fmt: skip
        np.testing.assert_allclose(expected, image / (2**bit_depth - 1), atol=half_step)

    def test_light_and_dark_are_full_scale_and_zero(self) -> None:
        for bit_depth in (8, 16):
            light = pattern_image(Uniform(level=1.0), (2, 3), bit_depth=bit_depth)
            dark = pattern_image(Uniform(level=0.0), (2, 3), bit_depth=bit_depth)
            assert (light.min(), dark.max()) == (2**bit_depth - 1, 0)

    def test_vertical_stripes_vary_along_columns_only(self) -> None:
        image = pattern_image(Fringe(period_px=8, shift=0), (6, 8))
        assert (image == image[:1]).all()
        assert len(set(image[0].tolist())) > 1
        turned = pattern_image(Fringe(period_px=8, shift=0, angle=math.pi / 2), (8, 6))
        assert image.T.tolist() == turned.tolist()


class TestSequence:
    @pytest.mark.parametrize(
        ("n_shifts", "options", "n_images"),
        [
            # 1024 / 16 = 64 periods: 6 bits, 7 complementary; counts of the paper's methods.
            (4, {"gray": "none"}, 4),
            (16, {"gray": "none"}, 16),
            (4, {"gray": "plain"}, 10),
            (4, {}, 11),
            (4, {"light_dark": True}, 13),
            (16, {"light_dark": True}, 25),
            (4, {"light_dark": True, "gray_bits": 2}, 9),
            (4, {"inverses": True}, 18),
            (4, {"angles": (0.0, math.pi / 2), "light_dark": True}, 24),
            (3, {"periods_px": (16.0, 17.5), "gray": "none"}, 6),
            (0, {"gray": "plain"}, 6),
        ],
    )
    def test_number_of_images_equals_hand_count(
        self, n_shifts: int, options: dict[str, object], n_images: int
    ) -> None:
        given_options = {"periods_px": (16.0,), **options}
        plan = sequence((768, 1024), n_shifts=n_shifts, **given_options)  # type: ignore[arg-type]
        assert n_images == plan.n_images
        assert plan.projector_shape == (768, 1024)

    def test_code_alone_has_cells_of_the_period(self) -> None:
        for gray in ("plain", "complementary"):
            plan = sequence((20, 64), periods_px=(2.0,), n_shifts=0, gray=gray)
            (code,) = plan.gray_sets
            assert (code.cell_px, code.n_bits) == (2.0, 5)

    def test_code_numbers_the_periods_of_the_first_period(self) -> None:
        plan = sequence((20, 256), periods_px=(16.0, 50.0), n_shifts=3, gray="plain")
        (code,) = plan.gray_sets
        assert (code.cell_px, code.n_bits) == (16.0, 4)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"n_shifts": 2}, "at least 3 phase steps, found 2"),
            ({"periods_px": ()}, "at least one period_px, found none"),
            ({"gray": "binary"}, "expected gray none, plain or complementary, found 'binary'"),
            ({"gray_bits": 0}, "expected gray_bits from 1 to 2 .*, found 0"),
            ({"gray_bits": 3}, r"from 1 to 2 \(2 number all periods of 16 px\), found 3"),
            ({"n_shifts": 0, "gray": "none"}, "at least one pattern, found none"),
            ({"periods_px": (-1.0,)}, "period of at least 2 px .*found -1"),
            ({"periods_px": (16.0, 1.99)}, "period of at least 2 px .*found 1.99"),
            ({"periods_px": (0.99,), "n_shifts": 0}, "period of at least 1 px .*found 0.99"),
            ({"periods_px": (64.0,)}, "period below 64 px .*found 64"),
        ],
    )
    def test_impossible_sequence_is_refused(self, options: dict[str, object], message: str) -> None:
        arguments = {"periods_px": (16.0,), "n_shifts": 4, **options}
        with pytest.raises(ValueError, match=message):
            sequence((20, 64), **arguments)  # type: ignore[arg-type]

    def test_code_takes_no_image_more_than_each_direction_needs(self) -> None:
        plan = sequence((256, 1024), periods_px=(16.0,), n_shifts=3, gray="plain", gray_bits=6,
                        angles=(0.0, math.pi / 2))  # fmt: skip
        assert [code.n_bits for code in plan.gray_sets] == [6, 4]


class TestUnambiguousRange:
    @pytest.mark.parametrize(
        ("periods_px", "expected"),
        [
            ((16.0,), 16.0),
            ((16.0, 32.0), 32.0),
            # Least common multiple of whole periods without common divisor.
            ((16.0, 17.0), 272.0),
            ((17.0, 16.0), 272.0),
            ((20.0, 21.0), 420.0),
            # 320 px are 5.33 and 5 periods; 960 are 15, 13.5; 22 080 are 368, 345 and 310.99.
            ((60.0, 64.0), 960.0),
            ((60.0, 64.0, 71.0), 22_080.0),
            # 192 px are 12 and 10.98 periods: near enough to be taken for 11; 10.97 are not.
            ((16.0, 17.49), 192.0),
            ((16.0, 17.5), 560.0),
            # Neighbouring periods differ by 0.016 of the wide one, which is too little; by 0.125.
            ((16.0, 1024.0), 16.0),
            ((16.0, 128.0), 128.0),
            ((16.0, 128.0, 1024.0), 1024.0),
            # The same for a beat: 0.0099, 0.048.
            ((100.0, 101.0), 100.0),
            ((100.0, 105.0), 2_100.0),
        ],
    )
    def test_range_equals_hand_computed_table(
        self, periods_px: tuple[float, ...], expected: float
    ) -> None:
        assert expected == pytest.approx(unambiguous_px(periods_px, 30_000.0))

    def test_extent_bounds_the_range(self) -> None:
        assert unambiguous_px([16.0, 17.0], 272.0) == 272.0
        assert unambiguous_px([16.0, 17.0], 200.0) == 200.0
        assert unambiguous_px([16.0], 10.0) == 10.0

    @given(st.lists(st.integers(7, 40), min_size=1, max_size=3), st.integers(50, 2000))
    def test_range_of_whole_periods_divides_their_least_common_multiple(
        self, whole: list[int], extent: int
    ) -> None:
        found = unambiguous_px([float(period) for period in whole], float(extent))
        assert found <= math.lcm(*whole)
        assert 0 < found <= extent

    @pytest.mark.parametrize(
        ("periods_px", "gray", "numbered"),
        [
            ((16.0,), "none", True),
            ((16.0, 32.0), "none", False),
            ((16.0, 32.0), "plain", True),
            ((16.0, 1024.0), "none", False),
            ((16.0, 128.0, 1024.0), "none", True),
            ((32.0, 33.0), "none", True),
            ((16.0, 17.0), "none", False),
        ],
    )
    def test_periods_that_do_not_number_the_projector_are_for_m6(
        self, periods_px: tuple[float, ...], gray: str, numbered: bool
    ) -> None:
        plan = sequence((768, 1024), periods_px=periods_px, n_shifts=3, gray=gray)
        said = numbering(plan)
        assert len(said) == (0 if numbered else 1)
        for text in said:
            assert re.search(r"look alike again after \d+ px of 1024\. Method m6 can use", text)

    def test_each_direction_is_judged_by_its_own_width(self) -> None:
        angles = (0.0, math.pi / 2)
        plan = sequence((260, 280), periods_px=(16.0, 17.0), n_shifts=3, gray="none", angles=angles)
        assert [text[:60] for text in numbering(plan)] == [
            "fringes of 16, 17 px look alike again after 272 px of 280. M"
        ]


def assert_same_patterns(expected: PatternPlan, found: PatternPlan) -> None:
    """Compare by what the projector shows."""
    assert expected.projector_shape == found.projector_shape
    assert len(expected.patterns) == len(found.patterns)
    x, y = np.meshgrid(np.arange(0.25, 200, 3.7), np.arange(0.25, 90, 4.1))
    for one, other in zip(expected.patterns, found.patterns, strict=True):
        assert type(one) is type(other)
        if not isinstance(one, Unused):
            np.testing.assert_allclose(
                intensity(one, x, y), intensity(other, x, y), atol=DEGREES_ROUNDING
            )


TURN = math.radians(37)

PLANS: dict[str, tuple[Pattern, ...]] = {
    "fringes": fringes(16, 4),
    "fringes reversed": fringes(13.37, 5, reverse=True),
    "fringes along y": fringes(16, 3, angle=math.pi / 2),
    "fringes at an angle": fringes(21.5, 8, angle=TURN),
    "unequal steps": tuple(Fringe(period_px=9, shift=s) for s in (0.3, 1.9, 2.2, 5.0)),
    "two steps": tuple(Fringe(period_px=9, shift=s) for s in (0.0, math.pi)),
    "two periods in turn": tuple(
        itertools.chain.from_iterable(zip(fringes(16, 3), fringes(17, 3), strict=True))
    ),
    "gray": gray_code(8, 7),
    "gray with inverses": gray_code(8, 5, inverses=True, angle=math.pi / 2),
    "gray, inverses after": gray_code(8, 3)
    + tuple(GrayBit(bit=b, n_bits=3, cell_px=8, inverted=True) for b in (2, 1, 0)),
    "gray, inverses only": tuple(
        GrayBit(bit=b, n_bits=3, cell_px=8, inverted=True) for b in (2, 1, 0)
    ),
    "gray, inverse first": gray_code(8, 3, inverses=True)[::-1],
    "gray, LSB first": gray_code(8, 4)[::-1],
    "gray, some bits": gray_code(8, 6, angle=TURN)[3:],
    "gray, one inverse": (*gray_code(8, 3), GrayBit(bit=0, n_bits=3, cell_px=8, inverted=True)),
    "gray twice": gray_code(8, 3) + gray_code(8, 3),
    "gray, shifted": tuple(GrayBit(bit=b, n_bits=3, cell_px=10.5, first_cell=2) for b in (2, 1, 0)),
    "light and dark": (Uniform(level=1.0), Uniform(level=0.0)),
    "light twice": (Uniform(level=1.0), Uniform(level=1.0), Uniform(level=0.0)),
    "unused": (Unused(), Unused(), *fringes(16, 4), Unused()),
    "everything": sequence(
        (90, 200),
        periods_px=(16.0, 18.1),
        n_shifts=4,
        angles=(0.0, TURN, math.pi / 2),
        inverses=True,
        light_dark=True,
    ).patterns,
}


class TestPlanFile:
    @pytest.mark.parametrize("name", PLANS)
    @pytest.mark.parametrize("shape", [None, (90, 200)])
    def test_plan_file_round_trips(
        self, name: str, shape: tuple[int, int] | None, tmp_path: Path
    ) -> None:
        plan = PatternPlan(patterns=PLANS[name], projector_shape=shape)
        path = tmp_path / "plan.toml"
        path.write_text(plan_text(plan, title="a plan"), encoding="utf-8")
        assert_same_patterns(plan, read_plan(path))

    def test_sets_of_the_plan_survive_the_file(self, tmp_path: Path) -> None:
        plan = sequence((90, 200), periods_px=(16.0, 18.1), n_shifts=4, angles=(0.0, TURN))
        path = tmp_path / "plan.toml"
        path.write_text(plan_text(plan), encoding="utf-8")
        found = read_plan(path)
        assert [s.indices for s in plan.fringe_sets] == [s.indices for s in found.fringe_sets]
        assert [s.indices for s in plan.gray_sets] == [s.indices for s in found.gray_sets]
        assert [s.bits for s in plan.gray_sets] == [s.bits for s in found.gray_sets]
        for expected, angle in zip(plan.angles, found.angles, strict=True):
            assert expected == pytest.approx(angle, abs=DEGREES_ROUNDING)

    def test_regular_set_takes_one_entry(self) -> None:
        text = plan_text(sequence((90, 200), periods_px=(16.0,), n_shifts=8, inverses=True))
        assert text.count("[[sequence]]") == 2

    def test_a_grey_level_is_said(self) -> None:
        assert "levels = [0.5]" in plan_text(PatternPlan(patterns=(Uniform(level=0.5),)))


class TestForeignFringes:
    @given(
        period_px=periods,
        n_shifts=st.integers(3, 9),
        direction=st.sampled_from([1, -1]),
        offset_deg=st.floats(-360, 360),
        first=st.sampled_from([0.0, 0.5, 1.0, -3.0]),
        along=st.sampled_from(["x", "y"]),
    )
    def test_fringes_equal_the_foreign_formula(
        self,
        period_px: float,
        n_shifts: int,
        direction: int,
        offset_deg: float,
        first: float,
        along: str,
    ) -> None:
        table = FringesTable.model_validate(
            {
                "kind": "fringes",
                "direction": along,
                "period_px": period_px,
                "n_shifts": n_shifts,
                "shift_direction": direction,
                "phase_offset_deg": offset_deg,
                "first_coordinate": first,
            }
        )
        number = np.arange(50)
        x, y = (number, 7.0) if along == "x" else (7.0, number)
        large_phases = 1e-10
        for n, pattern in enumerate(table.patterns()):
            phase = 2 * np.pi * (number + first) / period_px + math.radians(offset_deg)
            expected = 0.5 + 0.5 * np.cos(phase - direction * 2 * np.pi * n / n_shifts)
            np.testing.assert_allclose(expected, intensity(pattern, x, y), atol=large_phases)
        assert n_shifts == len(table.patterns())

    def test_listed_steps_stand_for_equal_ones(self) -> None:
        table = FringesTable(
            kind="fringes", period_px=10.0, shifts_deg=[0.0, 30.0, 250.0], phase_offset_deg=15.0
        )
        x = np.arange(40)
        for step, pattern in zip((0, 30, 250), table.patterns(), strict=True):
            phase = 2 * np.pi * (x + 0.5) / 10 + math.radians(15 - step)
            expected = 0.5 + 0.5 * np.cos(phase)
            np.testing.assert_allclose(expected, intensity(pattern, x, 3.0), atol=ROUNDING)

    def test_slanted_fringes_count_both_coordinates_from_the_first(self) -> None:
        table = FringesTable(
            kind="fringes", period_px=10.0, n_shifts=3, angle_deg=30.0, first_coordinate=1.0
        )
        y, x = np.mgrid[:20, :30]
        w = math.cos(math.radians(30)) * (x + 1.0) + math.sin(math.radians(30)) * (y + 1.0)
        expected = 0.5 + 0.5 * np.cos(2 * np.pi * w / 10)
        np.testing.assert_allclose(expected, intensity(table.patterns()[0], x, y), atol=ROUNDING)

    @pytest.mark.parametrize("steps", [{}, {"n_shifts": 4, "shifts_deg": [0.0, 1.0, 2.0]}])
    def test_steps_given_twice_or_never_are_refused(self, steps: dict[str, object]) -> None:
        with pytest.raises(ValueError, match="either n_shifts"):
            FringesTable.model_validate({"kind": "fringes", "period_px": 8.0, **steps})


class TestForeignGray:
    def recorded(self, **keys: object) -> list[tuple[int, bool]]:
        table = GrayTable.model_validate({"kind": "gray", "cell_px": 4.0, "n_bits": 3, **keys})
        patterns = table.patterns()
        assert {(p.n_bits, p.cell_px) for p in patterns if isinstance(p, GrayBit)} == {(3, 4.0)}
        return [(p.bit, p.inverted) for p in patterns if isinstance(p, GrayBit)]

    def test_order_and_inverses_equal_hand_made_lists(self) -> None:
        plain = [(2, False), (1, False), (0, False)]
        inverse = [(2, True), (1, True), (0, True)]
        pairs = [(2, False), (2, True), (1, False), (1, True), (0, False), (0, True)]
        assert plain == self.recorded()
        assert plain[::-1] == self.recorded(order="lsb-first")
        assert inverse == self.recorded(inverses="only")
        assert plain + inverse == self.recorded(inverses="after")
        assert pairs == self.recorded(inverses="interleaved")
        assert self.recorded(bits=[1, 0]) == [(1, False), (0, False)]
        assert self.recorded(bits=[0, 2], order="lsb-first") == [(0, False), (2, False)]

    def test_dark_ones_exchange_image_and_inverse(self) -> None:
        for inverses in ("none", "only", "after", "interleaved"):
            bright = self.recorded(inverses=inverses)
            dark = self.recorded(inverses=inverses, bright_is=0)
            assert [(bit, not inverted) for bit, inverted in bright] == dark

    def test_stripes_equal_the_binary_reflected_code_of_the_cell(self) -> None:
        table = GrayTable(kind="gray", cell_px=4.0, n_bits=3, first_cell=1, direction="y")
        rows = np.arange(60)
        for bit, pattern in zip((2, 1, 0), table.patterns(), strict=True):
            numbers = [(row // 4 + 1) % 8 for row in rows]
            expected = [float(((k ^ (k >> 1)) >> bit) & 1) for k in numbers]
            assert expected == intensity(pattern, 5.0, rows).tolist()

    def test_bit_that_the_code_has_not_is_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "plan.toml"
        path.write_text(
            'format = "fringe3d-scan/1"\n[[sequence]]\nkind = "gray"\ncell_px = 8\nn_bits = 3\n'
            "bits = [3]\n",
            encoding="utf-8",
        )
        with pytest.raises(PlanError, match="0 <= bit < n_bits"):
            read_plan(path)


def run_patterns(out: Path, *options: str) -> None:
    main(["patterns", "--size", "96x40", "--period", "12.5", "--out", str(out), *options])


class TestPatternsCommand:
    @pytest.mark.parametrize(
        ("options", "n_images", "bit_depth"),
        [
            (("--steps", "3", "--gray", "none"), 3, 8),
            (("--direction", "xy", "--inverses", "--light-dark"), 24, 8),
            (("--angle", "37", "--reverse", "--bits", "16"), 9, 16),
            (("--steps", "0"), 3, 8),
        ],
    )
    def test_written_images_equal_the_written_plan(
        self,
        options: tuple[str, ...],
        n_images: int,
        bit_depth: int,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        out = tmp_path / "patterns"
        run_patterns(out, *options)
        assert f"{n_images} images of 96 x 40 px, {bit_depth} bit" in capsys.readouterr().out
        plan = read_plan(out / "plan.toml")
        assert plan.projector_shape == (40, 96)
        names = [f"{index:03d}.png" for index in range(n_images)]
        assert sorted([*names, "overview.png", "plan.toml"]) == sorted(
            path.name for path in out.iterdir()
        )
        half_step = HALF_STEP_8 if bit_depth == 8 else HALF_STEP_16
        y, x = np.mgrid[:40, :96]
        for name, pattern in zip(names, plan.patterns, strict=True):
            image = cv2.imread(str(out / name), cv2.IMREAD_UNCHANGED)
            assert image is not None
            assert (image.shape, image.dtype) == ((40, 96), np.dtype(f"uint{bit_depth}"))
            expected = intensity(pattern, x, y)
            np.testing.assert_allclose(
                expected, image / (2**bit_depth - 1), atol=half_step + DEGREES_ROUNDING
            )

    def test_folder_that_exists_is_kept_unless_told(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "patterns"
        run_patterns(out, "--steps", "3")
        before = (out / "000.png").read_bytes()
        with pytest.raises(SystemExit) as stopped:
            run_patterns(out, "--steps", "5")
        assert stopped.value.code == 2
        assert "patterns" in capsys.readouterr().err
        assert before == (out / "000.png").read_bytes()
        run_patterns(out, "--steps", "5", "--gray", "none", "--overwrite")
        assert len(list(out.glob("0*.png"))) == 5

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (("--steps", "2"), "at least 3"),
            (("--gray-bits", "0"), "at least 1"),
        ],
    )
    def test_impossible_request_ends_with_code_two_and_no_folder(
        self,
        options: tuple[str, ...],
        message: str,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        out = tmp_path / "patterns"
        with pytest.raises(SystemExit) as stopped:
            run_patterns(out, *options)
        assert stopped.value.code == 2
        assert message in capsys.readouterr().err
        assert not out.exists()
