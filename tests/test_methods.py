"""Which method plan and rig allow, which images it needs, and that those suffice."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from closed_form import SphereScene, Truth, simulate
from closed_phases import grid_of, small_rig
from cv_lens import cv_project, cv_rays
from fringe3d.errors import MethodError
from fringe3d.methods import Choice, choose_method, images_of, settle
from fringe3d.model import (
    GrayBit,
    ImageStack,
    MeasuringVolume,
    PatternPlan,
    PhaseMap,
    Rig,
    Scan,
    Uniform,
)
from fringe3d.model.plan import Pattern, fringes, gray_code
from fringe3d.options import MeasureOptions, keep_images
from fringe3d.pipeline import Measurement, measure

pytestmark = pytest.mark.usefixtures("one_thread")

DOWN = float(np.pi / 2)
LIGHT_DARK: tuple[Pattern, ...] = (Uniform(level=1.0), Uniform(level=0.0))

X: tuple[Pattern, ...] = fringes(16.0, 4)
Y: tuple[Pattern, ...] = fringes(16.0, 4, angle=DOWN)
CODE_X: tuple[Pattern, ...] = gray_code(8.0, 7)
CODE_Y: tuple[Pattern, ...] = gray_code(8.0, 7, angle=DOWN)
REDUCED: tuple[Pattern, ...] = gray_code(8.0, 3)

SCENE = SphereScene(center_mm=(2.0, -2.0, -3.0), radius_mm=6.0)
PLAIN = replace(SCENE, center_mm=(0.0, 0.0, -50.0))
"""The plane alone, at z = -8 mm."""

N_ORDERS = 64

ASLANT = float(np.arctan(0.38))
"""Fringe angle, rad. C2's curves run along the projector's rows: whole periods of one direction are
0.38, 0.76 ... periods of the other, never nearly whole ones up to the seventh."""


@cache
def rig_named(name: str) -> Rig | None:
    """Return a rig of up to 4 periods a segment, or that with changes."""
    wide = small_rig(projector_azimuth_deg=0.0)
    return {
        "wide": wide,
        "narrow": small_rig(projector_azimuth_deg=-29.0, projector_tilt_deg=26.0),
        "blind": replace(wide, projector=None),
        "single": replace(wide, cameras=wide.cameras[:1]),
        "single blind": replace(wide, cameras=wide.cameras[:1], projector=None),
        "endless": replace(wide, volume=None),
        "none": None,
    }[name]


def plan_of(*parts: tuple[Pattern, ...]) -> PatternPlan:
    return PatternPlan(patterns=sum(parts, ()), projector_shape=(768, 1024))


def stacks_of(plan: PatternPlan, n_cameras: int = 2) -> list[ImageStack]:
    """Return stacks that only carry a plan; image i is of grey level i."""
    levels = np.arange(plan.n_images, dtype=np.uint8)
    images = np.repeat(levels, 4).reshape(-1, 2, 2)
    return [ImageStack(images=images, plan=plan, device_name=f"c{i + 1}", saturation_dn=255.0)
            for i in range(n_cameras)]  # fmt: skip


def phases_with(n_classes: int) -> PhaseMap:
    """Return a phase map of one pixel whose code tells so many periods apart."""
    one = np.ones((1, 1), np.float32)
    return PhaseMap(
        phase=one,
        order_class=np.zeros((1, 1), np.int32),
        class_of_order=np.arange(N_ORDERS, dtype=np.int32) % np.int32(n_classes),
        phase_std=np.float32(0.01) * one,
        offset=one,
        modulation=one,
        rejection=np.zeros((1, 1), np.uint16),
        period_px=16.0,
        angle=0.0,
        device_name="c1",
    )


def outcome(rig: Rig | None, plan: PatternPlan, asked: str, n_classes: int) -> Choice:
    options = MeasureOptions(method=asked)  # type: ignore[arg-type]
    n_cameras = len(rig.cameras) if rig is not None else 2
    choice = choose_method(rig, stacks_of(plan, n_cameras), options)
    volume = None if rig is None else rig.volume
    return settle(choice, phases_with(n_classes), rig, volume, options)


@pytest.mark.parametrize(
    ("rig", "parts", "n_classes", "asked", "method"),
    [
        ("wide", (X, CODE_X), 64, "auto", "m1"),
        ("blind", (X, CODE_X), 64, "auto", "m1"),
        ("wide", (X, CODE_X, Y, CODE_Y), 64, "auto", "m1"),
        ("wide", (X, REDUCED), 4, "auto", "m2"),
        ("blind", (X, REDUCED), 4, "auto", "m2"),
        ("wide", (X,), 1, "auto", "m6"),
        ("narrow", (X,), 1, "auto", "m5"),
        ("wide", (X, REDUCED), 2, "auto", "m6"),
        ("wide", (X, fringes(17.0, 4)), 17, "auto", "m2"),
        ("wide", (X, fringes(32.0, 4)), 2, "auto", "m6"),
        ("wide", (X, fringes(18.7, 4)), 64, "auto", "m6"),
        ("wide", (X, fringes(128.0, 4), fringes(1024.0, 4)), 64, "auto", "m1"),
        ("blind", (X, fringes(17.0, 4)), 17, "auto", "m2"),
        ("wide", (X, Y), 1, "auto", "m4"),
        ("blind", (X, Y), 1, "auto", "m4"),
        ("single", (X, CODE_X), 64, "auto", "projector"),
        ("none", (X, CODE_X), 64, "auto", "phase"),
        ("wide", (X, CODE_X, Y, CODE_Y), 64, "m0", "m0"),
        ("endless", (X, CODE_X), 64, "m1", "m1"),
        ("wide", (X, REDUCED), 4, "m2", "m2"),
        ("wide", (X,), 1, "m3", "m3"),
        ("narrow", (X,), 1, "m3", "m3"),
        ("wide", (X, Y), 1, "m4", "m4"),
        ("narrow", (X,), 1, "m5", "m5"),
        ("blind", (X,), 1, "m5", "m5"),
        ("wide", (X, CODE_X), 64, "projector", "projector"),
    ],
)
def test_method_of_plan_and_rig(
    rig: str, parts: tuple[tuple[Pattern, ...], ...], n_classes: int, asked: str, method: str
) -> None:
    choice = outcome(rig_named(rig), plan_of(*parts), asked, n_classes)
    assert choice.method == method
    assert choice.why


@pytest.mark.parametrize(
    ("rig", "parts", "n_classes", "asked", "words"),
    [
        ("none", (X, CODE_X), 64, "m1", r"--method m1: expected a calibrated rig.*--rig"),
        ("single", (X, CODE_X), 64, "m1", r"1 camera\(s\) in the scan and 1.*--method projector"),
        ("single blind", (X, CODE_X), 64, "auto", r"projector.*second camera"),
        ("blind", (X, CODE_X), 64, "projector", r"calibrated projector.*--method m1"),
        ("wide", (X, CODE_X), 64, "m0", r"two directions, found 1.*--method m1"),
        ("wide", (X, CODE_X, Y), 64, "m0", r"Gray code in both directions, found 1.*m1 or m4"),
        ("wide", (X, CODE_X, Y, CODE_Y), 4, "m0", r"--method m0: .*4 of 64 periods.*--method m2"),
        ("wide", (X,), 1, "m1", r"--method m1: expected a Gray code.*m5 or m3.*record the code"),
        (
            "wide",
            (X, Y),
            1,
            "m1",
            r"--method m1: expected a Gray code, found fringes alone.*--method m4",
        ),
        ("wide", (X, REDUCED), 4, "m1", r"4 of 64 periods apart.*--method m2.*--depth"),
        ("wide", (X, CODE_X), 64, "m2", r"a reduced Gray code, found a full one.*--gray-bits"),
        ("wide", (X, REDUCED), 2, "m2", r"up to 2 periods.*2 cyclic code images \(3 .*--method m6"),
        (
            "wide",
            (X,),
            1,
            "m5",
            r"up to one period.*do: --method m2 with 2 cyclic.*--depth.*closer",
        ),
        ("blind", (X,), 1, "m3", r"--method m3: expected a calibrated projector.*m4 with a second"),
        ("blind", (X, CODE_X), 64, "m3", r"calibrated projector.*--method m1"),
        ("wide", (X,), 1, "m4", r"two directions, found 1.*--direction xy.*m3"),
        ("wide", (X, CODE_X), 64, "m4", r"two directions, found 1.*--method m1"),
        ("wide", (CODE_X,), 64, "m5", r"--method m5: expected fringe images, found none.*m1"),
        ("endless", (X, REDUCED), 4, "m2", r"method m2: expected a measuring volume.*--depth"),
        ("endless", (X,), 1, "auto", r"method m6: expected a measuring volume.*--depth"),
    ],
)
def test_method_that_is_not_possible_is_refused(
    rig: str, parts: tuple[tuple[Pattern, ...], ...], n_classes: int, asked: str, words: str
) -> None:
    with pytest.raises(MethodError, match=words):
        outcome(rig_named(rig), plan_of(*parts), asked, n_classes)


# --- images --------------------------------------------------------------------------------


def kept(method: str, plan: PatternPlan, rig: Rig | None, **options: object) -> list[Pattern]:
    """Return the patterns kept, and check that each still has its own image."""
    volume = None if rig is None else rig.volume
    stack = stacks_of(plan)[0]
    left = images_of(Choice(method, ""), stack, rig, volume, MeasureOptions(**options))  # type: ignore[arg-type]
    levels = left.images[:, 0, 0].tolist()
    assert [plan.patterns[i] for i in levels] == list(left.plan.patterns)
    return list(left.plan.patterns)


def test_fringes_alone_of_the_finest_period() -> None:
    rig = rig_named("wide")
    coarse: tuple[Pattern, ...] = fringes(128.0, 4)
    plan = plan_of(coarse, X, CODE_X, Y, LIGHT_DARK)
    for method in ("m3", "m4", "m5"):
        assert kept(method, plan, rig) == [*X, *Y]
    for method in ("m0", "m1", "projector", "phase"):
        assert kept(method, plan, rig) == list(plan.patterns)


def test_m2_takes_what_was_recorded_where_it_cannot_know() -> None:
    plan = plan_of(X, CODE_X, LIGHT_DARK)
    for name in ("blind", "endless", "none"):
        assert kept("m2", plan, rig_named(name)) == list(plan.patterns)
    assert kept("m2", plan, rig_named("wide"), gray_bits=7) == list(plan.patterns)


def twins_by_counting(rig: Rig, told_apart: int) -> float:
    """Return which part of the points has a twin, by trying points along the projected rays.

    Twins may lie beyond the volume by two fifths of a segment. The volume is a wide box: every
    ray enters at its top and leaves at its bottom.
    """
    assert rig.projector is not None
    assert rig.volume is not None
    camera = rig.cameras[0]
    origin, directions = cv_rays(camera, grid_of(camera)[::16, ::16].reshape(-1, 2))
    top, bottom = rig.volume.offsets_mm[2], -rig.volume.offsets_mm[5]
    ends = [cv_project(rig.projector,
                       origin + ((z - origin[2]) / directions[:, 2])[:, None] * directions)[:, 0]
            for z in (top, bottom)]  # fmt: skip
    length = np.abs(ends[0] - ends[1]) / 16.0
    guard = 3 * 0.01 / (2 * np.pi) + 0.1 / 16.0
    n_points = n_twins = 0
    for periods in length:
        at = np.arange(0.0005, periods, 0.001)
        reach = guard + 0.4 * periods
        below, above = at - told_apart >= -reach, at + told_apart <= periods + reach
        n_points, n_twins = n_points + len(at), n_twins + int((below | above).sum())
    return n_twins / n_points


@pytest.mark.parametrize(("half_height_mm", "bits"), [(3.0, 1), (5.0, 2), (10.0, 3), (25.0, 4)])
def test_m2_of_a_full_code_keeps_the_finest_bits_that_segments_need(
    half_height_mm: float, bits: int
) -> None:
    wide = rig_named("wide")
    assert wide is not None
    volume = MeasuringVolume.box([-80, -80, -half_height_mm], [80, 80, half_height_mm])
    rig = replace(wide, volume=volume)
    # Two halves of a period tell mirrored words apart: n bits of half cells number 2**n periods.
    needed = next(n for n in range(1, 7) if twins_by_counting(rig, 2**n) <= 0.01)
    assert needed == bits
    left = kept("m2", plan_of(X, CODE_X, LIGHT_DARK), rig)
    code = [p for p in left if isinstance(p, GrayBit)]
    assert [p.bit for p in code] == list(reversed(range(needed)))
    assert [p for p in left if not isinstance(p, GrayBit)] == [*X, *LIGHT_DARK]


def test_light_and_dark_images_are_left_out() -> None:
    plan = plan_of(LIGHT_DARK, X, CODE_X)
    left = keep_images(stacks_of(plan)[0], MeasureOptions(light_dark=False))
    assert left.plan.patterns == X + CODE_X
    assert left.images[:, 0, 0].tolist() == list(range(2, 13))


# --- measurements --------------------------------------------------------------------------------


@cache
def recorded(name: str, *parts: str) -> tuple[Scan, tuple[Truth, ...]]:
    rig = small_rig(projector_azimuth_deg=0.0, projector_tilt_deg=40.0) if name == "above" else (
        rig_named(name))  # fmt: skip
    assert rig is not None
    turned = [fringes(16.0, 4, angle=ASLANT + square) for square in (0.0, DOWN)]
    all_parts: dict[str, tuple[Pattern, ...]] = {
        "x": X, "y": Y, "code": CODE_X, "light": LIGHT_DARK, "u": turned[0], "v": turned[1]
    }  # fmt: skip
    plan = plan_of(*(all_parts[p] for p in parts))
    scene = PLAIN if name == "narrow" else SCENE
    return simulate(rig, plan, scene, np.random.default_rng(7))


def off_mm(result: Measurement, truth: Truth) -> np.ndarray:
    """Return the distances of the points from the truth, mm."""
    assert result.points is not None
    good = result.points.is_valid
    return np.asarray(
        np.linalg.norm(result.points.points_mm[good] - truth.points_mm[good], axis=-1)
    )


def same_points(a: Measurement, b: Measurement) -> None:
    assert a.points is not None
    assert b.points is not None
    np.testing.assert_array_equal(a.points.rejection, b.points.rejection)
    np.testing.assert_array_equal(a.points.points_mm, b.points.points_mm)


def test_m2_of_a_full_code_equals_measuring_with_its_finest_bits() -> None:
    scan, truths = recorded("wide", "x", "code", "light")
    asked = measure(scan, MeasureOptions(method="m2"))
    code = [len(code.bits) for code in images_of(
        Choice("m2", ""), scan.stacks[0], scan.rig, scan.rig.volume if scan.rig else None,
        MeasureOptions()).plan.gray_sets]  # fmt: skip
    assert code == [3]
    same_points(asked, measure(scan, MeasureOptions(gray_bits=3)))
    full = measure(scan, MeasureOptions(method="m1"))
    assert (off_mm(asked, truths[0]) > 0.2).mean() < 0.002
    assert full.points is not None
    assert asked.points is not None
    # Beside the borders of C2 neighbours have no evidence; in so small an image that is 3 %.
    assert asked.points.is_valid.sum() > 0.96 * full.points.is_valid.sum()


def test_light_and_dark_images_are_not_needed() -> None:
    """The mean of the phase steps is the threshold, with them and without."""
    scan, truths = recorded("wide", "x", "code", "light")
    with_both = measure(scan, MeasureOptions(method="m1"))
    without = measure(scan, MeasureOptions(method="m1", light_dark=False))
    same_points(with_both, without)
    wrong = off_mm(without, truths[0]) > 0.2  # a period is 3 mm or more, sigma 0.01 mm
    assert wrong.mean() < 0.005
    assert len(wrong) > 0.7 * truths[0].lit.sum()


def test_m4_without_projector() -> None:
    """Lit from outside the plane of the cameras, both phases mark one point of the curve."""
    scan, truths = recorded("above", "u", "v")
    assert scan.rig is not None
    for rig in (scan.rig, replace(scan.rig, projector=None)):
        result = measure(replace(scan, rig=rig), MeasureOptions(method="m4"))
        assert result.method == "m4"
        wrong = off_mm(result, truths[0]) > 0.2  # a period is 3 mm or more, sigma 0.01 mm
        assert wrong.mean() < 0.005
        assert len(wrong) > 0.7 * truths[0].lit.sum()


def test_m5_on_a_narrow_rig() -> None:
    """With the projector beside C1 no segment in it reaches a period: one candidate."""
    scan, truths = recorded("narrow", "x")
    for options in (MeasureOptions(), MeasureOptions(method="m5")):
        result = measure(scan, options)
        assert result.method == "m5"
        assert (off_mm(result, truths[0]) > 0.2).mean() < 0.005
        assert len(off_mm(result, truths[0])) > 0.7 * truths[0].lit.sum()


def test_m5_without_projector() -> None:
    """Without its model the segment in C2 must be below a period; where not, that is said."""
    scan, truths = recorded("narrow", "x")
    assert scan.rig is not None
    blind = replace(scan.rig, projector=None)
    with pytest.raises(MethodError, match=r"one period in 'c2'.*--depth.*calibrate projector"):
        measure(replace(scan, rig=blind), MeasureOptions(method="m5"))
    # 16 px of the projector are 1.7 mm on the plane, and C2 sees them at 54 deg / 2 from the side.
    flat = MeasuringVolume.box([-40, -40, -8.6], [40, 40, -7.4])
    short = replace(scan, rig=replace(blind, volume=flat))
    result = measure(short, MeasureOptions(method="m5"))
    assert (off_mm(result, truths[0]) > 0.2).mean() < 0.005
    assert len(off_mm(result, truths[0])) > 0.7 * truths[0].lit.sum()
