"""Whether a code tells the orders on C2's own segments apart, where nobody knows the projector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closed_form import SphereScene, demo_rig, simulate
from closed_phases import PLANE, grid_of, phase_map, small_rig
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import fringe_crossing
from fringe3d.decode import decode
from fringe3d.design import GrayNeeds, assess
from fringe3d.errors import MethodError
from fringe3d.matching import Matched, match
from fringe3d.model import MeasuringVolume, PatternPlan, Rig, Scan
from fringe3d.model.plan import fringes, gray_code
from fringe3d.options import MeasureOptions, keep_images
from fringe3d.pipeline import measure
from fringe3d.segments import Segments, angles_without_code, segments_in_camera, told_apart

pytestmark = pytest.mark.usefixtures("one_thread")

PERIOD_PX = 16.0
CAMERA_PERIOD_PX = 5.0
SCENE = SphereScene(center_mm=(2.0, -2.0, -3.0), radius_mm=6.0)


def rig_of(half_height_mm: float) -> Rig:
    """Return two cameras without a projector, and a wide box: rays enter at its top."""
    volume = MeasuringVolume.box([-80, -80, -half_height_mm], [80, 80, half_height_mm])
    return replace(small_rig(projector_azimuth_deg=0.0), projector=None, volume=volume)


def segments_of(rig: Rig, camera_period_px: float = CAMERA_PERIOD_PX) -> Segments:
    camera, other = rig.cameras
    assert rig.volume is not None
    return segments_in_camera(
        camera, other, rig.volume, period_px=PERIOD_PX, camera_period_px=camera_period_px
    )


def lengths_px(rig: Rig) -> np.ndarray:
    """Return the chords of the segments in C2 that lie in its image, by another lens model."""
    camera, other = rig.cameras
    assert rig.volume is not None
    origin, directions = cv_rays(camera, grid_of(camera)[::8, ::8].reshape(-1, 2))
    top, bottom = rig.volume.offsets_mm[2], -rig.volume.offsets_mm[5]
    ends = [cv_project(other, origin + ((z - origin[2]) / directions[:, 2])[:, None] * directions)
            for z in (top, bottom)]  # fmt: skip
    size = np.array([other.n_cols, other.n_rows])
    seen = np.all([(end > 0) & (end < size - 1) for end in ends], axis=(0, 2))
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=-1)[seen])


@pytest.mark.parametrize("half_height_mm", [1.0, 2.0, 4.0])
def test_periods_are_the_length_of_the_segment_in_c2_over_the_period_seen(
    half_height_mm: float,
) -> None:
    """The image bends the segments by far less than a pixel."""
    rig = rig_of(half_height_mm)
    longest = segments_of(rig).needs.max_periods
    assert longest == pytest.approx(lengths_px(rig).max() / CAMERA_PERIOD_PX, rel=0.01)


@pytest.mark.parametrize("half_height_mm", [1.0, 2.0, 4.0, 8.0])
def test_the_design_asks_for_the_same_bits(half_height_mm: float) -> None:
    rig = rig_of(half_height_mm)
    designed = assess(rig, period_px=PERIOD_PX, camera_period_px=CAMERA_PERIOD_PX).needs
    needs = segments_of(rig).needs
    assert (needs.bits, needs.bits_beyond) == (designed.bits, designed.bits_beyond)


@pytest.mark.parametrize(
    ("classes", "expected"),
    [([0, 1, 2, 3, 0, 1, 2, 3], 4), ([0, 0, 0], 1), ([0, 1, 2], 3), ([0, 1, 1, 0], 1)],
)
def test_a_code_tells_apart_what_lies_closer_than_the_next_of_its_class(
    classes: list[int], expected: int
) -> None:
    assert told_apart(np.array(classes, np.int32)) == expected


# --- measurements --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scan() -> Scan:
    """Return a sphere before a plane, seen by two cameras; a full code of half cells."""
    patterns = fringes(PERIOD_PX, 4) + gray_code(PERIOD_PX / 2, 7)
    plan = PatternPlan(patterns=patterns, projector_shape=(768, 1024))
    found, _ = simulate(small_rig(projector_azimuth_deg=0.0), plan, SCENE, np.random.default_rng(7))
    return found


def needs_of(scan: Scan, rig: Rig) -> GrayNeeds:
    """Return the code for the period that the images of C2 show."""
    view = decode(scan.stacks[1], None).directions[0].main
    gradient, _ = fringe_crossing(view, rig.cameras[0], rig.cameras[1])
    return segments_of(rig, 2 * np.pi / gradient).needs


def matched(scan: Scan, rig: Rig, n_images: int) -> Matched:
    options = MeasureOptions(gray_bits=n_images)
    phases = tuple(decode(keep_images(stack, options), None) for stack in scan.stacks)
    camera, other = rig.cameras
    return match(phases, camera, other, None, rig.volume, method="m2", options=options)


def test_the_bits_that_the_message_names_do(scan: Scan) -> None:
    """With one less it is refused; with those, points are those of the full code."""
    rig = rig_of(8.0)
    needs = needs_of(scan, rig)
    alone = replace(scan, rig=rig)
    found = f"'c2', found up to {needs.max_periods:.1f}"
    words = rf"{found}.*do: (--method m2 with )?{needs.bits} cyclic code images"
    for n_images in range(needs.bits):
        with pytest.raises(MethodError, match=words):
            measure(alone, MeasureOptions(gray_bits=n_images))
    full, reduced = (measure(alone, MeasureOptions(gray_bits=n)).points for n in (None, needs.bits))
    assert full is not None
    assert reduced is not None
    both = full.is_valid & reduced.is_valid
    away = np.linalg.norm(full.points_mm[both] - reduced.points_mm[both], axis=-1)
    assert both.sum() > 0.98 * full.n_points
    assert (away > 0.2).mean() < 0.002  # a period is 1.7 mm


def test_surfaces_that_may_lie_beyond_the_volume_are_told(scan: Scan) -> None:
    """It is a finding, no refusal, for there may be none; with more bits it is well."""
    rig = rig_of(6.0)
    needs = needs_of(scan, rig)
    assert needs.bits_beyond > needs.bits
    (short,) = matched(scan, rig, needs.bits).findings
    assert short.name == "twin_part"
    assert short.level == "warning"
    assert f"record {needs.bits_beyond} cyclic code images" in short.text
    (enough,) = matched(scan, rig, needs.bits_beyond).findings
    assert enough.level == "ok"


def test_a_full_code_is_not_judged(scan: Scan) -> None:
    assert matched(scan, rig_of(8.0), 7).findings == ()


def test_half_the_depth_allows_twice_the_angle() -> None:
    """A segment is as long as the depth times the tangent of the angle, for small ones."""
    rig = demo_rig()
    assert rig.projector is not None
    phases = phase_map(rig.cameras[0], rig.projector, PLANE, period_px=PERIOD_PX)
    deep, flat = (
        angles_without_code(rig, MeasuringVolume.box([-80, -80, -z], [80, 80, z]), phases)
        for z in (8.0, 4.0)
    )
    axis_1, axis_p = (d.device_from_world.rotation[2] for d in (rig.cameras[0], rig.projector))
    assert deep[0] == pytest.approx(np.arccos(axis_1 @ axis_p), abs=0.01)  # they look at its middle
    assert flat[1] == pytest.approx(2 * deep[1], rel=0.05)
