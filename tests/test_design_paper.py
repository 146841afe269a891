"""Equations (1) to (5): hand calculations; pinholes in a plane are the oracle of the exact forms.

The paper's rig: fringes of 16 pixels of 20 um, c_P = 64.3 mm, depths 320, 335, 350 mm,
angles 27 deg (C1-C2) and 13.6 deg (C-P).
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from fringe3d.cli.console import Reporter
from fringe3d.design.paper import (
    Depths,
    angle_for_one_period_exact,
    angle_for_one_period_printed,
    gray_bits_printed,
    nominal_period,
    periods_printed,
    segment_length_exact,
    segment_length_printed,
    shortest_period_exact,
    shortest_period_printed,
)

pytest.importorskip("embreex")

from fringe3d.cli import paper as experiment

DEPTHS = Depths(depth_min_mm=320.0, depth_ref_mm=335.0, depth_max_mm=350.0)
PERIOD_MM, FOCAL_P_MM = 16 * 0.020, 64.3
FOCAL_C2_MM = 12.0
TAU_CC, TAU_CP = math.radians(27.0), math.radians(13.6)


def image(focal: float, angle: float, distance: float, point: tuple[float, float]) -> float:
    """Return where a pinhole in the plane sees a point.

    It stands at `distance` from the reference point (0, 0), turned by `angle` from the y axis
    towards x, and looks at it. Written out without any of the code under test.
    """
    place = distance * np.array([math.sin(angle), math.cos(angle)])
    forward, right = -place / distance, np.array([-math.cos(angle), math.sin(angle)])
    away = np.asarray(point) - place
    return float(focal * (away @ right) / (away @ forward))


def test_equation_1_is_the_hand_calculation() -> None:
    # 0.32 mm * 12 mm / 64.3 mm = 0.0597201 mm;
    # tan 13.6 deg = 0.2419253; (350 - 320) / 320 = 0.09375; 0.2419253 * 12 * 0.09375 = 0.2721659 mm
    printed = shortest_period_printed(PERIOD_MM, FOCAL_P_MM, FOCAL_C2_MM, TAU_CP, DEPTHS)
    assert printed == pytest.approx(0.0597201 - 0.2721659, abs=2e-6)
    # which is -3.5 times the period that a facing surface shows: the form does not hold.
    nominal = nominal_period(PERIOD_MM, FOCAL_P_MM, FOCAL_C2_MM)
    assert nominal == pytest.approx(0.0597201, abs=1e-7)
    assert printed / nominal == pytest.approx(-3.557, abs=2e-3)


def test_equation_1_is_positive_where_the_range_is_less_than_a_period() -> None:
    # Depths 334 to 336: tan * 12 * 2 / 334 = 0.0173839; 0.0597201 - 0.0173839 = 0.0423362
    thin = Depths(depth_min_mm=334.0, depth_ref_mm=335.0, depth_max_mm=336.0)
    printed = shortest_period_printed(PERIOD_MM, FOCAL_P_MM, FOCAL_C2_MM, TAU_CP, thin)
    assert printed == pytest.approx(0.0423362, abs=2e-6)


def test_equation_2_is_the_hand_calculation() -> None:
    # 15/320 + 15/350 = 0.046875 + 0.0428571 = 0.0897321; tan 27 deg = 0.5095254
    # 12 * 0.0897321 * 0.5095254 = 0.5486502 mm
    assert segment_length_printed(FOCAL_C2_MM, TAU_CC, DEPTHS) == pytest.approx(0.5486502, abs=2e-6)


def test_equation_3_is_undefined_where_equation_1_is_not_positive() -> None:
    assert periods_printed(0.55, 0.05) == pytest.approx(11.0)
    assert math.isnan(periods_printed(0.55, -0.2))
    assert math.isnan(periods_printed(0.55, 0.0))


@pytest.mark.parametrize(
    ("periods", "bits"), [(0.4, 0), (1.0, 0), (1.01, 1), (2.0, 1), (3.0, 2), (4.0, 2), (4.1, 3)]
)
def test_equation_4_brackets_the_periods(periods: float, bits: int) -> None:
    found = gray_bits_printed(periods)
    assert found == bits
    assert periods <= 2**found
    assert found == 0 or periods > 2 ** (found - 1)


@pytest.mark.parametrize("periods", [0.0, -1.0, math.nan, math.inf])
def test_equation_4_refuses_what_is_no_number_of_periods(periods: float) -> None:
    with pytest.raises(ValueError, match="expected a positive finite number"):
        gray_bits_printed(periods)


def test_equation_5_is_the_hand_calculation() -> None:
    # 0.32 / 64.3 = 0.00497667; / 0.0897321 = 0.0554614; atan = 3.1745 deg
    printed = math.degrees(angle_for_one_period_printed(PERIOD_MM, FOCAL_P_MM, DEPTHS))
    assert printed == pytest.approx(3.1745, abs=2e-4)
    exact = math.degrees(angle_for_one_period_exact(PERIOD_MM, FOCAL_P_MM, DEPTHS, 335.0))
    assert exact == pytest.approx(3.18, abs=0.005)


@pytest.mark.parametrize("angle", [TAU_CP, TAU_CC, math.radians(50.0)])
@pytest.mark.parametrize("distance", [335.0, 280.0])
def test_the_exact_segment_is_what_a_pinhole_sees_of_c1s_ray(angle: float, distance: float) -> None:
    """C1 looks along -y; its ray holds the points (0, e), e towards C1."""
    ends = [image(FOCAL_C2_MM, angle, distance, (0.0, e)) for e in (15.0, -15.0)]
    exact = segment_length_exact(FOCAL_C2_MM, angle, DEPTHS, distance)
    assert exact == pytest.approx(abs(ends[1] - ends[0]), rel=1e-12)


def test_the_exact_segment_is_not_symmetric_in_depth() -> None:
    """Swapped ends e+ and e- would show where the reference point is not the middle."""
    depths = Depths(depth_min_mm=300.0, depth_ref_mm=335.0, depth_max_mm=340.0)
    ends = [image(FOCAL_C2_MM, TAU_CC, 335.0, (0.0, e)) for e in (35.0, -5.0)]
    exact = segment_length_exact(FOCAL_C2_MM, TAU_CC, depths, 335.0)
    assert exact == pytest.approx(abs(ends[1] - ends[0]), rel=1e-12)


def test_the_printed_segment_is_too_long_between_converging_axes() -> None:
    for angle, excess in ((TAU_CC, 0.12), (TAU_CP, 0.03)):
        printed = segment_length_printed(FOCAL_C2_MM, angle, DEPTHS)
        exact = segment_length_exact(FOCAL_C2_MM, angle, DEPTHS, 335.0)
        assert printed / exact - 1 == pytest.approx(excess, abs=0.005)


def test_at_the_exact_angle_the_light_moves_by_one_period() -> None:
    angle = angle_for_one_period_exact(PERIOD_MM, FOCAL_P_MM, DEPTHS, 335.0)
    ends = [image(FOCAL_P_MM, angle, 335.0, (0.0, e)) for e in (15.0, -15.0)]
    assert abs(ends[1] - ends[0]) == pytest.approx(PERIOD_MM, rel=1e-8)


def test_no_angle_is_too_wide_for_a_very_wide_period() -> None:
    assert angle_for_one_period_exact(200.0, FOCAL_P_MM, DEPTHS, 335.0) == math.inf


def local_period(slope: float, distance_p: float, distance_c2: float) -> float:
    """Return the period that C2 sees on a line through the reference point, by small steps.

    C2 stands on the y axis, P to its right; the normal leans by `slope` from C2 towards P.
    """
    along = np.array([math.cos(slope), -math.sin(slope)])
    steps = [tuple(s * along) for s in (-1e-3, 1e-3)]
    in_c2 = [image(FOCAL_C2_MM, 0.0, distance_c2, step) for step in steps]
    in_p = [image(FOCAL_P_MM, TAU_CP, distance_p, step) for step in steps]
    return PERIOD_MM * abs((in_c2[1] - in_c2[0]) / (in_p[1] - in_p[0]))


@pytest.mark.parametrize("distances", [(335.0, 335.0), (400.0, 300.0)])
def test_the_exact_shortest_period_is_that_of_the_steepest_surface(
    distances: tuple[float, float],
) -> None:
    limit = math.radians(30.0)
    exact = shortest_period_exact(PERIOD_MM, FOCAL_P_MM, FOCAL_C2_MM, TAU_CP, *distances,
                                  max_slope=limit)  # fmt: skip
    assert exact == pytest.approx(local_period(limit, *distances), rel=1e-6)
    others = [local_period(slope, *distances) for slope in np.linspace(-limit, limit, 41)]
    assert min(others) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    "depths", [(0.0, 1.0, 2.0), (-5.0, 1.0, 2.0), (3.0, 2.0, 4.0), (1.0, 5.0, 4.0),
               (1.0, 2.0, math.inf), (math.nan, 2.0, 3.0)]
)  # fmt: skip
def test_depths_out_of_order_are_refused(depths: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected 0 < depth_min_mm"):
        Depths(depth_min_mm=depths[0], depth_ref_mm=depths[1], depth_max_mm=depths[2])


@pytest.mark.parametrize("quiet", [False, True])
def test_the_experiment_tells_its_progress_in_a_log(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    """Standard error is no terminal here: a line for each scan, none if only figures are wanted."""
    monkeypatch.setattr(experiment, "_work", lambda *_: [])
    options = experiment.PaperOptions(
        steps=(4,), objects=("plane", "teeth"), noise=0.01, calibration_error_px=0.05, seed=1,
        camera_size=(320, 256), period_px=None, out=None, overwrite=False, jobs=1,
    )  # fmt: skip
    assert experiment._all_tried(options, Reporter(quiet=quiet)) == []
    lines = capsys.readouterr().err.splitlines()
    if quiet:
        assert lines == []
        return
    assert lines[0] == "6 scans to simulate and measure, 1 at a time"
    assert [line.rpartition(" (")[0] for line in lines[1:]] == [
        "1/6 plane, rig kolibri",
        "2/6 plane, rig kolibri-m5",
        "3/6 plane on a table, rig kolibri",
        "4/6 teeth, rig kolibri",
        "5/6 teeth, rig kolibri-m5",
        "6/6 teeth on a table, rig kolibri",
    ]
