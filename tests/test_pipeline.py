"""From a recording to points, against the truth of the recording."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from changed_rigs import turned
from closed_form import Recording, SphereScene, Truth, record_scene, simulate
from fringe3d.errors import CalibrationError, EmptyResultError, MethodError
from fringe3d.health import check_yield
from fringe3d.methods import choose_method
from fringe3d.model import (
    Device,
    ImageStack,
    PatternPlan,
    PointMap,
    Rejection,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.model.rejection import count_by_reason
from fringe3d.options import Direction, keep_images
from fringe3d.patterns import sequence
from fringe3d.pipeline import Measurement, MeasureOptions, measure, point_cloud
from fringe3d.report.folder import write_result

Floats = NDArray[np.float64]

PULL = (0.9, 1.15)
"""Asked for; sigma has one noise figure for an image whose shot noise varies."""

MAX_OUTLIERS = 0.005
"""Points with more than 5 sigma: noise alone gives 6e-7, edges of the sphere a few pixels."""


def ideal(**options: Any) -> MeasureOptions:
    """Return options for images whose pixels are points: no area, and no lens."""
    return MeasureOptions(blur_px=None, **options)


STEREO, PROJECTOR = ideal(), ideal(method="projector")
METHODS = [pytest.param(STEREO, id="stereo"), pytest.param(PROJECTOR, id="projector")]


def along_ray(result: Measurement, rig: Rig, truth: Truth) -> Floats:
    """Return the signed error along the viewing ray of C1, mm; NaN where there is no point."""
    assert result.points is not None
    away = truth.points_mm - rig.cameras[0].center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    return np.asarray(((result.points.points_mm - truth.points_mm) * away).sum(axis=-1))


def pulls(result: Measurement, rig: Rig, truth: Truth) -> Floats:
    """Return error over sigma of all points."""
    assert result.points is not None
    good = result.points.is_valid
    return np.asarray(along_ray(result, rig, truth)[good] / result.points.sigma_mm[good])


def robust_std(values: Floats) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


@pytest.fixture(scope="module")
def measured(recording: Recording) -> Measurement:
    return measure(recording[0], STEREO)


@pytest.fixture(scope="module")
def measured_by_projector(recording: Recording) -> Measurement:
    return measure(recording[0], PROJECTOR)


@pytest.fixture(params=["measured", "measured_by_projector"])
def result(request: pytest.FixtureRequest) -> Measurement:
    value = request.getfixturevalue(request.param)
    assert isinstance(value, Measurement)
    return value


def test_accepted_and_rejected_pixels_are_all_and_only_accepted_ones_have_numbers(
    result: Measurement, rig: Rig
) -> None:
    """Every pixel is counted once; NaN and a reason go together."""
    assert result.points is not None
    rejection = result.rejection
    n_accepted = int((rejection == 0).sum())
    counted = sum(count_by_reason(rejection).values())
    assert rig.cameras[0].n_rows * rig.cameras[0].n_cols == n_accepted + counted
    assert n_accepted == result.points.n_points
    rejected = rejection != 0
    for name in ("points_mm", "sigma_mm", "skew_mm"):
        values = getattr(result.points, name)
        missing = np.isnan(values).reshape(*rejected.shape, -1)
        np.testing.assert_array_equal(rejected, missing.any(axis=-1), err_msg=name)
        np.testing.assert_array_equal(rejected, missing.all(axis=-1), err_msg=name)
    assert (result.points.sigma_mm[~rejected] > 0).all()
    known = [int(reason) for reason in Rejection]
    assert int(np.bitwise_or.reduce(rejection, axis=None)) & ~sum(known) == 0


def test_points_lie_as_far_from_the_truth_as_sigma_predicts(
    result: Measurement, rig: Rig, recording: Recording
) -> None:
    """Width and middle of the pull along the viewing ray; the ray itself is exact."""
    assert result.points is not None
    truth = recording[1][0]
    pull = pulls(result, rig, truth)
    assert len(pull) > 50_000
    assert PULL[0] < robust_std(pull) < PULL[1]
    assert abs(float(np.median(pull))) < 0.05
    good = result.points.is_valid
    distance = np.linalg.norm(result.points.points_mm - truth.points_mm, axis=-1)[good]
    # The middle of normal errors is at 0.6745 sigma.
    expected = 0.6745 * float(np.median(result.points.sigma_mm[good]))
    assert expected == pytest.approx(float(np.median(distance)), rel=0.2)
    assert (np.abs(pull) > 5).mean() < MAX_OUTLIERS


def test_points_cover_what_both_devices_see_in_the_volume(
    result: Measurement, rig: Rig, recording: Recording
) -> None:
    """At least 97 %: what is hidden from one device is at most 3 % of this scene."""
    assert rig.volume is not None
    truth = recording[1][0]
    wanted = truth.lit & rig.volume.contains(truth.points_mm)
    assert (result.rejection[wanted] == 0).mean() > 0.97
    # Nothing outside but for points within noise (0.1 mm) of the border.
    outside = ~ndimage.binary_dilation(wanted, np.ones((3, 3), bool))
    assert (result.rejection[outside] != 0).all()


def test_sphere_through_the_points_has_the_true_radius_and_centre(
    measured: Measurement, recording: Recording
) -> None:
    """Linear least squares |p|**2 = 2 c.p + d; 2000 points of 10 um leave 0.2 um of noise."""
    assert measured.points is not None
    scene = SphereScene()
    on_sphere = ndimage.binary_erosion(recording[1][0].on_sphere, iterations=3)
    points = measured.points.points_mm[on_sphere & measured.points.is_valid]
    assert len(points) > 2000
    model = np.column_stack([2 * points, np.ones(len(points))])
    solution, *_ = np.linalg.lstsq(model, (points**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))
    # One cap of the sphere: the errors of centre and radius are some ten times larger.
    np.testing.assert_allclose(scene.center_mm, solution[:3], rtol=0, atol=0.005)
    assert scene.radius_mm == pytest.approx(radius, abs=0.005)


def test_two_runs_give_identical_results(measured: Measurement, recording: Recording) -> None:
    """Threads must not matter."""
    again = measure(recording[0], STEREO)
    assert measured.points is not None
    assert again.points is not None
    np.testing.assert_array_equal(measured.points.points_mm, again.points.points_mm)
    np.testing.assert_array_equal(measured.points.sigma_mm, again.points.sigma_mm)
    np.testing.assert_array_equal(measured.rejection, again.rejection)
    assert measured.findings == again.findings


def test_cloud_holds_the_points_of_the_map_and_where_they_come_from(measured: Measurement) -> None:
    """One for each accepted pixel, in the order of the image."""
    assert measured.points is not None
    cloud = point_cloud(measured)
    rows, cols = cloud.source_index.T
    np.testing.assert_array_equal(measured.points.points_mm[rows, cols], cloud.points_mm)
    np.testing.assert_array_equal(measured.points.sigma_mm[rows, cols], cloud.sigma_mm)
    assert measured.points.n_points == len(cloud.points_mm)
    assert len(np.unique(rows.astype(int) * 1000 + cols)) == len(rows)


def test_stages_are_announced_and_timed(recording: Recording) -> None:
    """In their order."""
    heard: list[str] = []
    seconds = measure(recording[0], stage=heard.append).seconds
    expected = ["decoding", "finding correspondences", "triangulating", "checking"]
    assert expected == heard
    assert expected == list(seconds)


def test_a_true_calibration_raises_no_finding(result: Measurement) -> None:
    """No false alarm."""
    assert result.warnings == ()


@pytest.mark.parametrize("options", METHODS)
def test_strict_gives_a_subset_with_fewer_errors(
    options: MeasureOptions, rig: Rig, recording: Recording
) -> None:
    """The same points, without edges and the uncertain; never more than 5 sigma off."""
    truth = recording[1][0]
    plain, strict = measure(recording[0], options), measure(
        recording[0], replace(options, strict=True, drop_edges=True)
    )  # fmt: skip
    assert plain.points is not None
    assert strict.points is not None
    kept = strict.points.is_valid
    assert (plain.points.is_valid | ~kept).all()
    np.testing.assert_array_equal(plain.points.points_mm[kept], strict.points.points_mm[kept])
    assert 0.9 * plain.points.n_points < strict.points.n_points < plain.points.n_points
    lost = plain.points.is_valid & ~kept
    reasons = {int(Rejection.EDGE), int(Rejection.ISOLATED)}
    assert set(strict.rejection[lost].tolist()) <= reasons
    rates = [float((np.abs(pulls(r, rig, truth)) > 5).mean()) for r in (plain, strict)]
    assert rates[1] <= rates[0]
    assert rates[1] < MAX_OUTLIERS / 10


# Fewer images


def test_keep_images_leaves_out_steps_and_coarse_bits_only(rig: Rig) -> None:
    """Of both directions, with inverses; uniform images stay."""
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(16.0, 21.0), n_shifts=8,
                    angles=(0.0, np.pi / 2), inverses=True, light_dark=True)  # fmt: skip
    images = np.arange(plan.n_images, dtype=np.uint8)[:, None, None]
    stack = ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=255.0)
    kept = keep_images(stack, ideal(n_shifts=4, gray_bits=3))
    for fringe_set in kept.plan.fringe_sets:
        shifts = np.degrees(fringe_set.shifts)
        np.testing.assert_allclose([0, 90, 180, 270], shifts, atol=1e-9)
    assert len(kept.plan.fringe_sets) == 4
    assert [code.bits for code in kept.plan.gray_sets] == [(2, 1, 0), (2, 1, 0)]
    assert all(place >= 0 for code in kept.plan.gray_sets for place in code.inverses)
    assert min(kept.plan.uniform_index(1.0), kept.plan.uniform_index(0.0)) >= 0
    # Images and patterns stay together: the image holds the place of its pattern.
    places = kept.images.ravel().tolist()
    assert [plan.patterns[i] for i in places] == list(kept.plan.patterns)
    assert keep_images(stack, ideal()).plan == plan
    assert keep_images(stack, ideal(gray_bits=0)).plan.gray_sets == ()


@pytest.mark.parametrize("n_shifts", [2, 5])
def test_impossible_numbers_of_steps_raise(n_shifts: int, recording: Recording) -> None:
    """Fewer than three, or more than recorded."""
    with pytest.raises(MethodError, match=r"--shifts: expected 3 to 4.*found"):
        measure(recording[0], ideal(n_shifts=n_shifts))


@pytest.mark.parametrize("method", ["auto", "projector"])
def test_three_of_four_steps_give_the_same_surface_with_a_larger_sigma(
    method: str, rig: Rig, recording: Recording, measured: Measurement
) -> None:
    """Steps of 0, 90 and 270 deg: the mean variance of C and S is 3/4 instead of 1/2."""
    options = ideal(method="projector" if method == "projector" else "auto", n_shifts=3)
    result = measure(recording[0], options)
    assert measured.points is not None
    assert result.phases[0].directions[0].wrapped[0].n_shifts == 3
    # The noise is told from one image of steep fringes, 7 px wide: 15 % too much at most.
    assert 0.85 < robust_std(pulls(result, rig, recording[1][0])) < PULL[1]
    assert result.rejection[measured.points.is_valid].astype(bool).mean() < 0.001


@pytest.mark.parametrize(("gray_bits", "method"), [(6, "m1"), (5, "m2"), (4, "m2"), (3, "m2")])
def test_fewer_gray_bits_give_the_same_points_while_they_are_unique_on_the_segment(
    gray_bits: int, method: str, recording: Recording, measured: Measurement
) -> None:
    """Bit by bit; the finest three leave four periods and their mirror images."""
    assert measured.points is not None
    result = measure(recording[0], ideal(gray_bits=gray_bits))
    assert result.points is not None
    assert method == result.method
    both = measured.points.is_valid & result.points.is_valid
    # The projector shortens the segments: their ends move a step of the search, nothing else.
    gap = np.abs(measured.points.points_mm - result.points.points_mm)[both]
    assert gap.max() < 1e-3
    assert both.sum() > 0.9995 * measured.points.n_points
    assert measured.matches is not None
    assert result.matches is not None
    np.testing.assert_array_equal(
        measured.matches.fringe_order[both], result.matches.fringe_order[both]
    )


def test_reduced_code_with_the_projector_gives_the_same_points(
    recording: Recording, measured_by_projector: Measurement
) -> None:
    """Four of seven bits."""
    full = measured_by_projector.points
    result = measure(recording[0], replace(PROJECTOR, gray_bits=4)).points
    assert full is not None
    assert result is not None
    np.testing.assert_array_equal(full.points_mm, result.points_mm)


def test_two_directions_with_reduced_codes_give_the_same_points(rig: Rig) -> None:
    """Each direction is resolved on the segment; 3 of 7 and 7 bits are kept."""
    scan, _ = record_scene(rig, SphereScene(), seed=5, angles=(0.0, np.pi / 2))
    full = measure(scan, PROJECTOR).points
    reduced = measure(scan, replace(PROJECTOR, gray_bits=3)).points
    assert full is not None
    assert reduced is not None
    both = full.is_valid & reduced.is_valid
    assert both.sum() > 0.9995 * full.n_points
    np.testing.assert_array_equal(full.points_mm[both], reduced.points_mm[both])


@pytest.mark.parametrize("direction", ["x", "y"])
def test_one_direction_can_be_left_out(direction: Direction, rig: Rig) -> None:
    scan, truths = record_scene(rig, SphereScene(), seed=5, angles=(0.0, np.pi / 2))
    options = replace(PROJECTOR, direction=direction)
    assert keep_images(scan.stacks[0], options).plan.angles == (
        {"x": 0.0, "y": np.pi / 2}[direction],
    )
    result = measure(scan, options).points
    assert result is not None
    error = np.linalg.norm(result.points_mm - truths[0].points_mm, axis=-1)
    assert np.nanmedian(error) < 0.1
    with pytest.raises(MethodError, match=r"--direction y: .*found none such"):
        measure(replace(scan, stacks=tuple(keep_images(s, replace(PROJECTOR, direction="x"))
                                           for s in scan.stacks)),
                replace(PROJECTOR, direction="y"))  # fmt: skip


def test_two_cameras_take_the_direction_that_crosses_the_epipolar_lines(rig: Rig) -> None:
    """The cameras stand side by side: horizontal fringes alone mark no points, and it is said."""
    scan, truths = record_scene(rig, SphereScene(), seed=5, angles=(np.pi / 2, 0.0))
    result = measure(scan)
    assert result.main.angle == 0.0
    assert result.points is not None
    error = np.linalg.norm(result.points.points_mm - truths[0].points_mm, axis=-1)
    assert np.nanmedian(error) < 0.02


@pytest.mark.parametrize("options", METHODS)
def test_code_too_short_for_the_volume_does_not_pass_in_silence(
    options: MeasureOptions, recording: Recording
) -> None:
    """Two bits are one period and its mirror image: most pixels are ambiguous, and it is said."""
    try:
        result = measure(recording[0], replace(options, gray_bits=1))
    except (CalibrationError, EmptyResultError, MethodError):
        return
    assert result.warnings
    assert (result.rejection & Rejection.AMBIGUOUS).astype(bool).mean() > 0.5


# Methods


def stacks_of(recording: Recording, n_cameras: int) -> tuple[ImageStack, ...]:
    return recording[0].stacks[:n_cameras]


def test_method_follows_from_rig_and_cameras(rig: Rig, recording: Recording) -> None:
    """Two cameras before camera and projector; without a rig phases."""
    options = ideal()
    two, one = stacks_of(recording, 2), stacks_of(recording, 1)
    single = replace(rig, cameras=rig.cameras[:1])
    assert choose_method(rig, two, options).method == "m1"
    assert choose_method(replace(rig, projector=None), two, options).method == "m1"
    assert choose_method(rig, one, options).method == "projector"
    assert choose_method(single, two, options).method == "projector"
    assert choose_method(rig, two, PROJECTOR).method == "projector"
    assert choose_method(None, two, options).method == "phase"


def test_methods_that_rig_or_images_do_not_allow_are_refused_in_words(
    rig: Rig, recording: Recording
) -> None:
    """Each message says what is missing and what to do."""
    scan = recording[0]
    unknown = replace(rig, projector=None)
    alone = replace(unknown, cameras=rig.cameras[:1])
    one = replace(scan, stacks=scan.stacks[:1])
    cases: list[tuple[Scan, MeasureOptions, str]] = [
        (replace(scan, rig=None), PROJECTOR, r"--method projector: expected a calibrated rig"),
        (one, ideal(method="m1"), r"1 camera\(s\) in the scan.*--method projector"),
        (replace(scan, rig=unknown), PROJECTOR, r"calibrated projector.*--method m1"),
        (replace(one, rig=alone), ideal(), r"record with a second camera"),
        (replace(scan, rig=unknown), ideal(method="m2"), r"a full one.*--gray-bits"),
        (
            replace(scan, rig=unknown),
            ideal(method="m3"),
            r"expected a calibrated projector",
        ),
        (scan, ideal(method="m0"), r"fringes of two directions, found 1.*--method m1"),
        (scan, ideal(method="m4"), r"fringes of two directions, found 1.*--method m1"),
        (scan, ideal(method="m5"), r"up to one period.*m2 with 2 cyclic.*closer"),
        (scan, ideal(method="m1", gray_bits=3), r"periods apart.*--method m2"),
        (scan, ideal(depth_mm=(400.0, 300.0)), r"--depth:.*400.0 and 300.0"),
        (scan, ideal(depth_mm=(-300.0, -200.0)), r"--depth:.*lie behind it"),
    ]
    for case, options, message in cases:
        with pytest.raises(MethodError, match=message):
            measure(case, options)


def test_without_a_rig_there_are_phases_and_no_points(
    recording: Recording, measured: Measurement
) -> None:
    """The same phases as with it."""
    result = measure(replace(recording[0], rig=None), STEREO)
    assert result.method == "phase"
    assert result.points is None
    assert result.matches is None
    np.testing.assert_array_equal(measured.main.absolute_phase, result.main.absolute_phase)
    np.testing.assert_array_equal(result.main.rejection, result.rejection)
    assert (result.rejection == 0).mean() > 0.95


def test_depth_range_keeps_exactly_the_points_between_the_two_depths(
    rig: Rig, recording: Recording, measured: Measurement
) -> None:
    """Along the principal ray of C1; border pixels within 0.1 mm may fall either way."""
    assert measured.points is not None
    result = measure(recording[0], ideal(depth_mm=(325.0, 332.0)))
    depth = rig.cameras[0].device_from_world.apply(measured.points.points_mm)[..., 2]
    inside = (depth > 325.1) & (depth < 331.9)
    outside = (depth < 324.9) | (depth > 332.1)
    kept = result.rejection == 0
    assert kept[outside].sum() == 0
    assert kept[inside].mean() > 0.998
    assert inside.sum() > 1000


# Wrong calibrations


def transposed(device: Device) -> Device:
    """Return a device with R inverted but not t: the commonest mistake of rig files."""
    pose = device.device_from_world
    wrong = RigidTransform(rotation=pose.rotation.T, translation=pose.translation)
    return replace(device, device_from_world=wrong)


def inverted(device: Device) -> Device:
    return replace(device, device_from_world=device.device_from_world.inverse())


Mistake = Callable[[Device], Device]

STEREO_MISTAKES: list[Mistake] = [
    lambda d: turned(d, "x", 1.0),
    lambda d: turned(d, "x", -1.0),
    lambda d: turned(d, "x", 0.3),
    transposed,
    inverted,
]
STEREO_NAMES = ["x +1 deg", "x -1 deg", "x +0.3 deg", "R transposed", "pose inverted"]


def told(scan: Scan, options: MeasureOptions) -> str:
    """Return what is said about a wrong calibration; empty where it passes in silence."""
    try:
        result = measure(scan, options)
    except (CalibrationError, EmptyResultError) as problem:
        return str(problem)
    return ". ".join(finding.text for finding in result.warnings)


@pytest.mark.parametrize("mistake", STEREO_MISTAKES, ids=STEREO_NAMES)
@pytest.mark.parametrize("has_volume", [True, False])
def test_wrong_pose_of_the_second_camera_does_not_pass_in_silence(
    mistake: Mistake, has_volume: bool, rig: Rig, recording: Recording
) -> None:
    """Also in a rig of two cameras alone. Turns in the plane of the rays are not among them."""
    cameras = (rig.cameras[0], mistake(rig.cameras[1]))
    volume = rig.volume if has_volume else None
    wrong = replace(rig, cameras=cameras, volume=volume, projector=None)
    assert "calibration" in told(replace(recording[0], rig=wrong), ideal())


@pytest.fixture(scope="module")
def crossed(rig: Rig) -> Scan:
    return record_scene(rig, SphereScene(), seed=5, angles=(0.0, np.pi / 2))[0]


PROJECTOR_MISTAKES: list[Mistake] = [
    lambda d: turned(d, "x", 1.0),
    lambda d: turned(d, "y", 1.0),
    lambda d: turned(d, "z", -1.0),
    lambda d: turned(d, "y", 0.3),
    lambda d: turned(d, "z", 0.3),
    transposed,
    inverted,
]
PROJECTOR_NAMES = ["x +1", "y +1", "z -1", "y +0.3", "z +0.3", "R transposed", "pose inverted"]


@pytest.mark.parametrize("mistake", PROJECTOR_MISTAKES, ids=PROJECTOR_NAMES)
def test_wrong_pose_of_the_projector_does_not_pass_in_silence_with_two_directions(
    mistake: Mistake, rig: Rig, crossed: Scan
) -> None:
    """The epipolar residual shows a turn about any axis."""
    assert rig.projector is not None
    wrong = replace(rig, projector=mistake(rig.projector))
    assert "calibrat" in told(replace(crossed, rig=wrong), PROJECTOR).lower()


def test_a_true_projector_with_two_directions_raises_no_finding(crossed: Scan) -> None:
    """No false alarm."""
    result = measure(crossed, PROJECTOR)
    assert result.warnings == ()
    assert "epipolar_residual_px" in [f.name for f in result.findings]


# Gamma


def test_gamma_with_three_steps_and_two_periods_is_named_and_linear_light_is_not(
    rig: Rig,
) -> None:
    """The two periods disagree by the error of gamma, three waves per period."""
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(16.0, 53.0), n_shifts=3)
    for gamma in (1.0, 2.2):
        scan, _ = simulate(rig, plan, SphereScene(gamma=gamma), np.random.default_rng(3))
        warnings = [f.text for f in measure(scan).warnings]
        if gamma == 1.0:
            assert warnings == []
        else:
            assert any("gamma" in text for text in warnings)


@pytest.mark.parametrize("n_shifts", [4, 5, 8])
def test_gamma_hardly_matters_for_two_cameras(n_shifts: int, rig: Rig) -> None:
    """Both see the same error of phase; nor does it pass for noise."""
    scan, truths = record_scene(rig, SphereScene(gamma=2.2), seed=3, n_shifts=n_shifts)
    result = measure(scan)
    assert (result.rejection == 0).sum() > 50_000
    # Five steps: the modulation of the first harmonic carries part of the fourth.
    assert 0.8 < robust_std(pulls(result, rig, truths[0])) < 1.25


# Nothing to measure


def filled(scan: Scan, level: int) -> Scan:
    stacks = tuple(replace(s, images=np.full_like(s.images, level)) for s in scan.stacks)
    return replace(scan, stacks=stacks)


@pytest.mark.parametrize("options", METHODS)
@pytest.mark.parametrize(("level", "reason"), [(0, "LOW_MODULATION"), (255, "SATURATED")])
@pytest.mark.parametrize("has_rig", [True, False])
def test_images_without_fringes_raise_with_the_reason_and_its_count(
    options: MeasureOptions, level: int, reason: str, has_rig: bool, recording: Recording
) -> None:
    """All dark, all saturated; with and without a rig."""
    scan = filled(recording[0], level)
    if not has_rig:
        scan, options = replace(scan, rig=None), ideal()
    with pytest.raises(EmptyResultError, match=f"81920 {reason}"):
        measure(scan, options)


@pytest.mark.parametrize("options", METHODS)
def test_one_dark_camera_gives_no_point_and_no_crash(
    options: MeasureOptions, recording: Recording
) -> None:
    """The first camera sees all, the second nothing; camera and projector do not mind."""
    scan = recording[0]
    dark = replace(scan.stacks[1], images=np.zeros_like(scan.stacks[1].images))
    half = replace(scan, stacks=(scan.stacks[0], dark))
    if options.method == "projector":
        assert (measure(half, options).rejection == 0).sum() > 50_000
    else:
        with pytest.raises((EmptyResultError, CalibrationError), match="point"):
            measure(half, options)


@pytest.mark.parametrize("options", METHODS)
def test_dark_and_saturated_regions_have_no_points_and_leave_the_others_alone(
    options: MeasureOptions, recording: Recording
) -> None:
    """A dark and a saturated strip in C1; the estimate of the noise may change a little."""
    scan = recording[0]
    images = np.array(scan.stacks[0].images)
    images[:, :60], images[:, 200:] = 0, 255
    spoiled = replace(scan, stacks=(replace(scan.stacks[0], images=images), *scan.stacks[1:]))
    plain, result = measure(scan, options), measure(spoiled, options)
    assert plain.points is not None
    assert result.points is not None
    assert (result.rejection[:60] & Rejection.LOW_MODULATION).all()
    assert (result.rejection[200:] & Rejection.SATURATED).all()
    # Small patches may be cut off at the new border.
    middle = slice(61, 199)
    np.testing.assert_allclose(
        plain.points.points_mm[middle], result.points.points_mm[middle], atol=1e-9
    )


@pytest.mark.parametrize("options", METHODS)
def test_images_of_one_pixel_raise_or_give_their_one_point(
    options: MeasureOptions, rig: Rig, recording: Recording
) -> None:
    """No neighbours, no crash."""
    row, col = 128, 160

    def cut(stack: ImageStack) -> ImageStack:
        return replace(stack, images=stack.images[:, row : row + 1, col : col + 1])

    def crop(camera: Device) -> Device:
        return Device(name=camera.name, role="camera", n_rows=1, n_cols=1,
                      focal_px=camera.focal_px, center_px=camera.center_px - [col, row],
                      distortion=camera.distortion,
                      device_from_world=camera.device_from_world)  # fmt: skip

    one, two = rig.cameras
    tiny = replace(rig, cameras=(crop(one), crop(two)))
    scan = Scan(stacks=tuple(cut(s) for s in recording[0].stacks), rig=tiny)
    try:
        result = measure(scan, options)
    except (EmptyResultError, CalibrationError):
        assert options.method == "auto"  # a camera of one pixel has no epipolar curve to search
        return
    assert result.points is not None
    error = along_ray(result, tiny, one_pixel(recording[1][0], row, col))
    assert abs(error.item()) < 5 * result.points.sigma_mm.item()


def one_pixel(truth: Truth, row: int, col: int) -> Truth:
    window = np.s_[row : row + 1, col : col + 1]
    return Truth(
        points_mm=truth.points_mm[window],
        projector_xy=truth.projector_xy[window],
        lit=truth.lit[window],
        on_sphere=truth.on_sphere[window],
    )


def test_plan_without_fringes_or_code_raises(recording: Recording) -> None:
    """Light and dark alone."""
    plan = sequence((768, 1024), periods_px=(16.0,), n_shifts=0, gray="none", light_dark=True)
    assert isinstance(plan, PatternPlan)
    stacks = tuple(replace(s, images=s.images[:2], plan=plan) for s in recording[0].stacks)
    with pytest.raises(MethodError, match="nothing to decode"):
        measure(replace(recording[0], stacks=stacks))


def open_everywhere(points: PointMap) -> PointMap:
    """Return the map with all of its points left open."""
    rejection = np.where(points.is_valid, np.uint16(Rejection.AMBIGUOUS), points.rejection)
    return PointMap(
        points_mm=np.full(points.points_mm.shape, np.nan),
        sigma_mm=np.full(points.sigma_mm.shape, np.nan, np.float32),
        skew_mm=np.full(points.skew_mm.shape, np.nan, np.float32),
        rejection=rejection.astype(np.uint16),
    )


def test_a_result_without_points_is_written(
    recording: Recording, measured: Measurement, tmp_path: Path
) -> None:
    assert measured.points is not None
    nothing = replace(measured, points=open_everywhere(measured.points))
    write_result(tmp_path / "out", recording[0], ideal(), nothing)
    record = tomllib.loads((tmp_path / "out" / "measure.toml").read_text())
    assert record["summary"].startswith("no points of 81,920 pixels")
    assert record["pixels"]["accepted"] == 0
    assert b"element vertex 0\n" in (tmp_path / "out" / "cloud.ply").read_bytes()
    assert (tmp_path / "out" / "overview.png").stat().st_size > 10_000


def test_open_pixels_do_not_accuse_the_calibration(measured: Measurement) -> None:
    assert measured.points is not None
    assert check_yield(open_everywhere(measured.points)) == []
