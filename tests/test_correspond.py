"""Homologous points and their intersection against the truth of rendered recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from changed_rigs import moved_rig
from closed_form import Recording, SphereScene, Truth, record_scene, sees, simulate
from fringe3d.correspond import match_cameras, match_projector
from fringe3d.correspond.projector import resolve_orders
from fringe3d.decode import decode
from fringe3d.errors import MethodError
from fringe3d.geometry import pixel_grid, project
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    ImageStack,
    MeasuringVolume,
    PatternPlan,
    PhaseMap,
    PointMap,
    Rejection,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.model.plan import gray_code
from fringe3d.patterns import sequence
from fringe3d.triangulate import remove_edges, remove_isolated, remove_repeated, triangulate

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCENE = SphereScene()

EDGE_PX = 2
"""Pixels closer than this to a depth edge or shadow may mix or miss neighbours."""

PULL = (0.9, 1.15)
"""Asked for. Read noise, shot noise and quantisation in one figure per image: sigma is constant
but the shot noise is not; that is worth a few per cent."""

WRONG_PX = 0.5
"""Far above 6 sigma (0.1 px), far below a period (7 px): a wrong point, not a noisy one."""

MAX_WRONG = 0.005
"""Of the accepted pixels. Only between pixels of two surfaces can a curve cross a false zero. The
pixels beside the silhouettes fill 1 % of the image, half of them on either side."""


def surface(truth: Truth) -> NDArray[np.int64]:
    """Return 0 for unlit, 1 for the plane, 2 for the sphere."""
    return np.where(truth.lit, 1 + truth.on_sphere, 0)


def next_to_edge(truth: Truth, radius: int) -> Mask:
    kind, size = surface(truth), 2 * radius + 1
    return np.asarray(ndimage.minimum_filter(kind, size) != ndimage.maximum_filter(kind, size))


def away_from_edges(truth: Truth, radius: int = EDGE_PX) -> Mask:
    return truth.lit & ~next_to_edge(truth, radius)


def at_nearest(mask: Mask, pixels: Floats) -> Mask:
    """Return a mask of another image at the nearest pixels; False outside."""
    col, row = np.moveaxis(np.rint(np.nan_to_num(pixels, nan=-1)).astype(int), -1, 0)
    inside = (col >= 0) & (row >= 0) & (col < mask.shape[1]) & (row < mask.shape[0])
    result = np.zeros(col.shape, bool)
    result[inside] = mask[row[inside], col[inside]]
    return result


@dataclass(frozen=True, eq=False)
class Judged:
    """Matches beside the truth, all on the grid of C1."""

    matches: Correspondences
    error: Floats
    visible: Mask
    clean: Mask

    @property
    def accepted(self) -> Mask:
        return np.asarray(self.matches.rejection == 0)


def tangents(other: Device, camera: Device, truth: Truth) -> Floats:
    """Return the direction of the epipolar curve at the true point, (row, col, 2), unit length."""
    away = truth.points_mm - camera.center_world
    moved = project(other, truth.points_mm + 1e-4 * away) - project(other, truth.points_mm)
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def judge(
    matches: Correspondences, camera: Device, other: Device, truth: Truth, seen: Mask, clean: Mask
) -> Judged:
    """Return the signed error along the epipolar curve, px."""
    true = project(other, truth.points_mm)
    size = np.array([other.n_cols, other.n_rows]) - 0.5
    inside = ((true >= -0.5) & (true <= size)).all(axis=-1)
    error = ((matches.pixels - true) * tangents(other, camera, truth)).sum(axis=-1)
    visible = truth.lit & inside & seen
    return Judged(matches, error, visible, visible & clean)


def judge_stereo(
    matches: Correspondences, rig: Rig, truths: Sequence[Truth], scene: SphereScene = SCENE
) -> Judged:
    camera, other = rig.cameras[:2]
    seen = sees(other, truths[0].points_mm, scene)
    true = project(other, truths[0].points_mm)
    clean = away_from_edges(truths[0]) & at_nearest(away_from_edges(truths[1], 3), true)
    return judge(matches, camera, other, truths[0], seen, clean)


def judge_projector(matches: Correspondences, rig: Rig, truths: Sequence[Truth]) -> Judged:
    assert rig.projector is not None
    everywhere = np.ones(rig.cameras[0].shape, bool)
    clean = away_from_edges(truths[0])
    return judge(matches, rig.cameras[0], rig.projector, truths[0], everywhere, clean)


def match_stereo(phases: Sequence[PhaseMap], rig: Rig) -> Correspondences:
    return match_cameras(phases[0], phases[1], rig.cameras[0], rig.cameras[1], rig.volume)


def main_phases(scan: Scan) -> list[PhaseMap]:
    return [decode(stack).directions[0].main for stack in scan.stacks]


@pytest.fixture(scope="module")
def phases(recording: Recording) -> list[PhaseMap]:
    return main_phases(recording[0])


@pytest.fixture(scope="module")
def stereo(rig: Rig, recording: Recording, phases: list[PhaseMap]) -> Judged:
    matches = match_stereo(phases, rig)
    return judge_stereo(matches, rig, recording[1])


@pytest.fixture(scope="module")
def single(rig: Rig, recording: Recording, phases: list[PhaseMap]) -> Judged:
    assert rig.projector is not None
    matches = match_projector(phases[:1], rig.cameras[0], rig.projector, rig.volume)
    return judge_projector(matches, rig, recording[1])


@pytest.fixture(params=["stereo", "single"])
def judged(request: pytest.FixtureRequest) -> Judged:
    result = request.getfixturevalue(request.param)
    assert isinstance(result, Judged)
    return result


def robust_std(values: Floats) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def test_errors_are_spread_as_sigma_predicts(judged: Judged) -> None:
    """Pull: its width, its mean, and that 95 % lie where 95 % of a normal distribution do."""
    use = judged.accepted & judged.clean
    assert use.sum() > 50_000
    pull = judged.error[use] / judged.matches.sigma_px[use]
    assert PULL[0] < robust_std(pull) < PULL[1]
    # 50 000 pixels give the mean to 0.005; a systematic part of 0.05 sigma would be none of noise.
    assert abs(float(np.median(pull))) < 0.05
    assert PULL[0] * 1.96 < float(np.quantile(np.abs(pull), 0.95)) < PULL[1] * 1.96


def test_typical_and_95_percent_error_equal_the_predicted_ones(judged: Judged) -> None:
    """In pixels, over all accepted pixels that the other device sees, edges included."""
    use = judged.accepted & judged.visible
    assert np.isfinite(judged.matches.sigma_px[use]).all()
    rng = np.random.default_rng(1)
    drawn = np.abs(judged.matches.sigma_px[use] * rng.standard_normal(use.sum()))
    found = np.abs(judged.error[use])
    for part in (0.5, 0.95):
        ratio = float(np.quantile(found, part) / np.quantile(drawn, part))
        assert PULL[0] < ratio < PULL[1]


def test_accepted_pixels_are_seen_by_the_other_device_and_right(judged: Judged) -> None:
    """No point for occluded or unlit pixels, and hardly a wrong one for the others."""
    accepted = judged.accepted
    assert (accepted & ~judged.visible).sum() <= MAX_WRONG * (~judged.visible).sum()
    wrong = accepted & ~(np.abs(judged.error) < WRONG_PX)
    assert wrong.sum() < MAX_WRONG * accepted.sum()


def test_wrong_points_lie_next_to_depth_edges_only(stereo: Judged, recording: Recording) -> None:
    """Nowhere else can there be a false crossing; there, in less than half of the pixels."""
    wrong = stereo.accepted & ~(np.abs(stereo.error) < WRONG_PX)
    assert not (wrong & stereo.clean).any()
    silhouette = next_to_edge(recording[1][0], 1)
    assert silhouette.mean() < 2.2 * MAX_WRONG
    assert wrong.sum() < silhouette.sum() / 2


def test_every_pixel_that_both_cameras_see_in_the_volume_has_a_point(
    stereo: Judged, rig: Rig, recording: Recording
) -> None:
    """Away from edges and from the border of the volume; the truth says where."""
    wanted = reachable(stereo, rig, recording[1][0])
    assert wanted.sum() > 50_000
    assert (stereo.accepted[wanted]).mean() > 0.9995


def reachable(judged: Judged, rig: Rig, truth: Truth) -> Mask:
    """Return the pixels whose true point lies well inside the volume and the image of C2."""
    assert rig.volume is not None
    inside = ndimage.binary_erosion(rig.volume.contains(truth.points_mm), np.ones((5, 5), bool))
    true = project(rig.cameras[1], truth.points_mm)
    in_image = ((true >= 1) & (true <= [318, 254])).all(axis=-1)
    return np.asarray(judged.clean & inside & in_image)


def test_matches_lie_on_the_epipolar_curve(judged: Judged, rig: Rig, recording: Recording) -> None:
    """Across the curve there is no error at all: to a hundredth of a thousandth of a pixel."""
    truth = recording[1][0]
    other = {d.name: d for d in rig.devices}[judged.matches.device_name]
    use = judged.accepted & judged.clean & (np.abs(judged.error) < WRONG_PX)
    away = judged.matches.pixels - project(other, truth.points_mm)
    along = tangents(other, rig.cameras[0], truth)
    across = (along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0])[use]
    # The curve bends (lens) by less than 1e-5 px within the largest error of 0.5 px.
    assert np.abs(across).max() < 1e-5
    assert np.isnan(judged.matches.epipolar_residual_px).all()


def test_accepted_and_rejected_pixels_are_all_and_only_accepted_ones_have_numbers(
    judged: Judged,
) -> None:
    """NaN and NO_ORDER exactly where there is a reason."""
    accepted = judged.accepted
    np.testing.assert_array_equal(accepted, np.isfinite(judged.matches.pixels).all(axis=-1))
    np.testing.assert_array_equal(accepted, np.isfinite(judged.matches.sigma_px))
    np.testing.assert_array_equal(accepted, judged.matches.fringe_order != NO_ORDER)
    np.testing.assert_array_equal(pixel_grid(accepted.shape), judged.matches.pixels_c1)


def test_swapping_the_cameras_gives_the_mirrored_correspondences(
    stereo: Judged, rig: Rig, phases: list[PhaseMap]
) -> None:
    """C1 to C2 and back ends where it began, within the noise of both ways."""
    back = match_stereo(phases[::-1], replace(rig, cameras=rig.cameras[::-1]))
    use = stereo.accepted & stereo.clean
    x, y = np.moveaxis(stereo.matches.pixels[use], -1, 0)
    returned = np.stack(
        [ndimage.map_coordinates(back.pixels[..., i], [y, x], order=1, cval=np.nan) for i in (0, 1)]
    )
    finite = np.isfinite(returned).all(axis=0)
    assert finite.mean() > 0.99
    home = np.moveaxis(pixel_grid(use.shape)[use], -1, 0)
    away = np.linalg.norm(returned - home, axis=0)[finite]
    # Both directions use the same two phases: the ways differ by their interpolations alone.
    assert float(np.quantile(away, 0.99)) < 6 * float(np.nanmedian(stereo.matches.sigma_px))
    assert away.max() < WRONG_PX


# Reduced code


@dataclass(frozen=True, eq=False)
class Twice:
    """One recording, decoded with the full and with reduced codes."""

    truths: tuple[Truth, ...]
    full: list[PhaseMap]
    reduced: dict[str, list[PhaseMap]]


def with_code(stack: ImageStack, kept: range) -> ImageStack:
    return stack.subset([*range(4), *kept])


@pytest.fixture(scope="module")
def twice(rig: Rig) -> Twice:
    """Record fringes, a full code, and reduced codes of 8 and 4 periods, in one go."""
    assert rig.projector is not None
    plan = sequence(rig.projector.shape, periods_px=(16.0,), n_shifts=4)
    assert plan.n_images == 11
    patterns = plan.patterns + gray_code(8.0, 4) + gray_code(8.0, 3)
    both = PatternPlan(patterns=patterns, projector_shape=plan.projector_shape)
    scan, truths = simulate(rig, both, SCENE, np.random.default_rng(77))

    def decoded(kept: range) -> list[PhaseMap]:
        return [decode(with_code(s, kept)).directions[0].main for s in scan.stacks]

    reduced = {"8": decoded(range(11, 15)), "4": decoded(range(15, 18)), "1": decoded(range(0))}
    return Twice(truths=truths, full=decoded(range(4, 11)), reduced=reduced)


def test_reduced_code_with_the_volume_gives_the_same_points_as_the_full_code(
    rig: Rig, twice: Twice
) -> None:
    """M2 against M1, bit by bit: 8 periods are more than fit on any segment."""
    full = match_stereo(twice.full, rig)
    reduced = match_stereo(twice.reduced["8"], rig)
    np.testing.assert_array_equal(full.pixels, reduced.pixels)
    accepted = full.rejection == 0
    np.testing.assert_array_equal(accepted, reduced.rejection == 0)
    # Only the full code can tell a point outside the volume from a hidden one.
    differs = full.rejection != reduced.rejection
    assert (full.rejection[differs] == Rejection.OUTSIDE_VOLUME).all()
    assert (reduced.rejection[differs] == Rejection.NO_MATCH).all()
    assert accepted.sum() > 50_000
    np.testing.assert_array_equal(
        full.fringe_order[accepted] % 8, reduced.fringe_order[accepted] % 8
    )


@pytest.mark.parametrize("code", ["4", "1"])
def test_code_too_short_for_the_volume_is_ambiguous_and_never_wrong(
    rig: Rig, twice: Twice, code: str
) -> None:
    """Where C2 sees the point and accepts one, it is the right one: the other was ruled out."""
    matches = match_stereo(twice.reduced[code], rig)
    judged = judge_stereo(matches, rig, twice.truths)
    wanted = reachable(judged, rig, twice.truths[0])
    ambiguous = (matches.rejection & Rejection.AMBIGUOUS) != 0
    assert (ambiguous & wanted).sum() > 0.9 * wanted.sum()
    accepted = judged.accepted & wanted
    assert (accepted & ~(np.abs(judged.error) < WRONG_PX)).sum() <= 3


def test_reduced_code_with_the_projector_resolves_to_the_true_orders(
    rig: Rig, twice: Twice
) -> None:
    """Every decoded pixel whose point lies in the volume; 8 periods and 4 segments of 4.1."""
    assert rig.projector is not None
    assert rig.volume is not None
    camera, truth = rig.cameras[0], twice.truths[0]
    true = (truth.projector_xy[..., 0] + 0.5) / 16
    inside = away_from_edges(truth) & rig.volume.contains(truth.points_mm)
    clear = np.abs(true - np.rint(true)) > 0.03  # 6 sigma of the phase
    for code in ("8", "4"):
        found = resolve_orders(twice.reduced[code][0], camera, rig.projector, rig.volume)
        assert found.is_absolute
        wanted = inside & clear & (found.rejection == 0)
        np.testing.assert_array_equal(np.floor(true[wanted]), found.order_class[wanted])
        if code == "8":
            assert (found.rejection[inside] == 0).all()
        else:
            rejected = found.rejection[inside & (found.rejection != 0)]
            assert (rejected == Rejection.AMBIGUOUS).all()


def test_reduced_code_with_the_projector_gives_the_same_points_as_the_full_code(
    rig: Rig, twice: Twice
) -> None:
    """Inside the volume."""
    assert rig.projector is not None
    assert rig.volume is not None
    camera = rig.cameras[0]
    full = match_projector(twice.full[:1], camera, rig.projector, rig.volume)
    reduced = match_projector(twice.reduced["8"][:1], camera, rig.projector, rig.volume)
    inside = (full.rejection == 0) & rig.volume.contains(twice.truths[0].points_mm)
    inside &= away_from_edges(twice.truths[0])
    assert inside.sum() > 50_000
    np.testing.assert_array_equal(full.pixels[inside], reduced.pixels[inside])


def test_reduced_code_with_the_projector_needs_a_volume(rig: Rig, twice: Twice) -> None:
    assert rig.projector is not None
    with pytest.raises(MethodError, match=r"8 of 64 periods apart.*--depth"):
        match_projector(twice.reduced["8"][:1], rig.cameras[0], rig.projector, None)


def test_phases_of_different_fringes_are_refused(rig: Rig, twice: Twice) -> None:
    """Two cameras must have seen one plan."""
    with pytest.raises(MethodError, match="same fringes and code"):
        match_stereo([twice.full[0], twice.reduced["8"][1]], rig)


# Two directions


@pytest.fixture(scope="module")
def crossed(rig: Rig) -> tuple[list[PhaseMap], Truth]:
    scan, truths = record_scene(rig, SCENE, seed=5, angles=(0.0, np.pi / 2))
    return [d.main for d in decode(scan.stacks[0]).directions], truths[0]


@pytest.mark.parametrize("moved_px", [0.0, 1.0, -1.0])
def test_epipolar_residual_equals_the_shift_of_the_projector_across_the_curve(
    rig: Rig, crossed: tuple[list[PhaseMap], Truth], moved_px: float
) -> None:
    """Zero for the true calibration; its spread is that of the decoded coordinates."""
    assert rig.projector is not None
    maps, truth = crossed
    camera, use = rig.cameras[0], away_from_edges(truth)
    along = tangents(rig.projector, camera, truth)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    middle = np.median(normal[use], axis=0)
    # A projector whose image is thought to lie `moved_px` further along the normal.
    shift = moved_px * middle / np.linalg.norm(middle)
    projector = replace(rig.projector, center_px=rig.projector.center_px + shift)
    matches = match_projector(maps, camera, projector, rig.volume)
    accepted = (matches.rejection == 0) & use
    assert accepted.sum() > 50_000
    residual = matches.epipolar_residual_px[accepted].astype(np.float64)
    sigma = np.mean([np.median(m.phase_std[use]) * 16 / (2 * np.pi) for m in maps])
    # The normal turns by a few degrees over the image; the lens adds less.
    assert -moved_px == pytest.approx(float(np.median(residual)), abs=0.01)
    assert 0.9 * sigma < robust_std(residual) < 1.15 * sigma + 0.01 * abs(moved_px)


def test_two_directions_give_the_true_projector_points_with_their_sigma(
    rig: Rig, crossed: tuple[list[PhaseMap], Truth]
) -> None:
    """Along the epipolar curve, where it matters."""
    assert rig.projector is not None
    maps, truth = crossed
    matches = match_projector(maps, rig.cameras[0], rig.projector, rig.volume)
    judged = judge_projector(matches, rig, [truth])
    use = judged.accepted & judged.clean
    assert use.sum() > 50_000
    along = tangents(rig.projector, rig.cameras[0], truth)[use]
    away = (matches.pixels - truth.projector_xy)[use]
    sigma_w = np.stack([m.phase_std[use] * 16 / (2 * np.pi) for m in maps], axis=-1)
    np.testing.assert_array_less(np.abs(np.median(away / sigma_w, axis=0)), 0.05)
    pull = (away * along).sum(axis=-1) / matches.sigma_px[use]
    assert PULL[0] < robust_std(pull) < PULL[1]


# Intersection


def test_points_equal_the_truth_where_the_correspondences_do(
    rig: Rig, recording: Recording
) -> None:
    """To a millionth of a millimetre, for both other devices."""
    camera, truth = rig.cameras[0], recording[1][0]
    assert rig.projector is not None
    for other in (rig.cameras[1], rig.projector):
        matches = exact_matches(camera, other, truth.points_mm)
        points = triangulate(matches, camera, other)
        assert (points.rejection == 0).all()
        np.testing.assert_allclose(truth.points_mm, points.points_mm, rtol=0, atol=1e-6)
        assert points.skew_mm.max() < 1e-6


def exact_matches(camera: Device, other: Device, points: Floats) -> Correspondences:
    shape = camera.shape
    return Correspondences(
        device_name=other.name,
        pixels_c1=pixel_grid(shape),
        pixels=project(other, points),
        sigma_px=np.full(shape, 0.01, np.float32),
        epipolar_residual_px=np.full(shape, np.nan, np.float32),
        fringe_order=np.zeros(shape, np.int32),
        rejection=np.zeros(shape, np.uint16),
    )


def pinhole(name: str, x_mm: float, shape: tuple[int, int] = (5, 7)) -> Device:
    """Return a camera at (x, 0, 0) that looks along +z; 1000 px, no distortion."""
    pose = RigidTransform(rotation=np.eye(3), translation=[-x_mm, 0.0, 0.0])
    return Device(name=name, role="camera", n_rows=shape[0], n_cols=shape[1],
                  focal_px=[1000.0, 1000.0], center_px=[3.0, 2.0],
                  device_from_world=pose)  # fmt: skip


def test_sigma_along_the_ray_equals_closed_form_of_two_parallel_cameras() -> None:
    """x2 = f (X - b) / Z, so that the principal ray has sigma_z = sigma_px z**2 / (f b)."""
    base, depth = 120.0, 800.0
    one, two = pinhole("c1", 0.0), pinhole("c2", base)
    x, y = np.moveaxis((pixel_grid(one.shape) - [3.0, 2.0]) / 1000.0, -1, 0)
    truth = depth * np.stack([x, y, np.ones_like(x)], axis=-1)
    points = triangulate(exact_matches(one, two, truth), one, two)
    np.testing.assert_allclose(truth, points.points_mm, rtol=0, atol=1e-6)
    expected = 0.01 * depth**2 / (1000.0 * base)
    # The step of 1e-4 of the depth makes the derivative 1e-4 too small.
    assert expected == pytest.approx(float(points.sigma_mm[2, 3]), rel=3e-4)


def test_skew_rays_meet_in_the_middle_and_far_ones_are_rejected() -> None:
    """A shift of 2 px across the epipolar line at 800 mm: 1.6 mm apart, the point 0.8 mm off."""
    one, two = pinhole("c1", 0.0), pinhole("c2", 120.0)
    x, y = np.moveaxis((pixel_grid(one.shape) - [3.0, 2.0]) / 1000.0, -1, 0)
    truth = 800.0 * np.stack([x, y, np.ones_like(x)], axis=-1)
    exact = exact_matches(one, two, truth)
    shifted = replace(
        exact,
        pixels=exact.pixels + np.array([0.0, 2.0]),
        epipolar_residual_px=np.full(one.shape, 2.0, np.float32),
    )
    points = triangulate(shifted, one, two, max_epipolar_px=2.5)
    # Rays are tilted by less than 0.15 in x: 1 % of the distance at most.
    assert points.skew_mm[2, 3] == pytest.approx(1.6, rel=0.02)
    assert points.points_mm[2, 3, 1] == pytest.approx(0.8, rel=0.02)
    rejected = triangulate(shifted, one, two, max_epipolar_px=1.5)
    assert (rejected.rejection == Rejection.RAYS_MISS).all()
    assert np.isnan(rejected.points_mm).all()


def test_rays_that_meet_behind_or_nowhere_have_no_point() -> None:
    """The point at infinity, and beyond."""
    one, two = pinhole("c1", 0.0), pinhole("c2", 120.0)
    grid = pixel_grid(one.shape)
    truth = np.concatenate([(grid - [3.0, 2.0]) / 1000.0, np.ones((*one.shape, 1))], -1) * 800.0
    exact = exact_matches(one, two, truth)
    for disparity, reason in ((-5.0, Rejection.BEHIND_DEVICE), (1e-3, Rejection.UNCERTAIN)):
        matches = replace(exact, pixels=grid - [disparity, 0.0])
        points = triangulate(matches, one, two)
        assert (points.rejection == reason).all()


def test_points_outside_the_volume_are_rejected_and_no_others(
    rig: Rig, recording: Recording
) -> None:
    """A box in space, asked of the truth."""
    camera, other, truth = *rig.cameras, recording[1][0]
    box = MeasuringVolume.box([-10.0, -10.0, -20.0], [10.0, 12.0, 20.0])
    points = triangulate(exact_matches(camera, other, truth.points_mm), camera, other, volume=box)
    lower, upper = np.array([-10.0, -10.0, -20.0]), np.array([10.0, 12.0, 20.0])
    inside = ((truth.points_mm > lower) & (truth.points_mm < upper)).all(axis=-1)
    expected = np.where(inside, 0, int(Rejection.OUTSIDE_VOLUME))
    np.testing.assert_array_equal(expected, points.rejection)


@pytest.mark.parametrize("middles", [False, True])
def test_compiled_triangulation_equals_the_plain_one(
    rig: Rig, stereo: Judged, *, middles: bool
) -> None:
    """Of whole pixels and of places between them; with points of all reasons."""
    matches = stereo.matches
    if middles:
        matches = replace(matches, pixels_c1=matches.pixels_c1 + 0.25)
    residual = np.zeros(matches.rejection.shape, np.float32)
    residual[::7] = 2.0
    matches = replace(matches, epipolar_residual_px=residual)
    low = MeasuringVolume.box([-1e3, -1e3, -1e3], [1e3, 1e3, 2.0])
    found, plain = (
        triangulate(matches, *rig.cameras, volume=low, max_epipolar_px=1.0, plain=plain)
        for plain in (False, True)
    )
    np.testing.assert_array_equal(plain.rejection, found.rejection)
    assert 0 < found.n_points < (matches.rejection == 0).sum()
    np.testing.assert_allclose(found.points_mm, plain.points_mm, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.sigma_mm, plain.sigma_mm, rtol=1e-5)
    np.testing.assert_allclose(found.skew_mm, plain.skew_mm, rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", ["stereo", "projector"])
def test_cloud_moves_with_the_world(
    method: str, rig: Rig, recording: Recording, phases: list[PhaseMap]
) -> None:
    """No device, axis or origin is special."""
    del recording
    angle = 1.1
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0,
                    np.cos(angle)]])  # fmt: skip
    world = RigidTransform(rotation=turn, translation=[400.0, -250.0, 90.0])
    clouds: list[PointMap] = []
    for each in (rig, moved_rig(rig, world)):
        assert each.projector is not None
        if method == "stereo":
            other = each.cameras[1]
            matches = match_stereo(phases, each)
        else:
            other = each.projector
            matches = match_projector(phases[:1], each.cameras[0], other, each.volume)
        clouds.append(triangulate(matches, each.cameras[0], other, volume=each.volume))
    here, there = clouds
    both = here.is_valid & there.is_valid
    # Rounding may decide otherwise for a pixel on the border of the volume.
    assert (here.is_valid != there.is_valid).sum() <= 3
    assert both.sum() > 50_000
    np.testing.assert_allclose(
        world.apply(here.points_mm[both]), there.points_mm[both], rtol=0, atol=1e-5
    )
    np.testing.assert_allclose(here.sigma_mm[both], there.sigma_mm[both], rtol=1e-3)


# Cleaning


def flat_map(shape: tuple[int, int], holes: Mask | None = None) -> PointMap:
    """Return a plane z = 0 with 1 mm between pixels, and holes."""
    points = np.concatenate([pixel_grid(shape), np.zeros((*shape, 1))], axis=-1)
    rejection = np.zeros(shape, np.uint16)
    if holes is not None:
        rejection[holes] = Rejection.NO_MATCH
        points[holes] = np.nan
    sigma = np.where(rejection == 0, 0.01, np.nan).astype(np.float32)
    return PointMap(points_mm=points, sigma_mm=sigma, skew_mm=sigma, rejection=rejection)


def lifted(points: PointMap, where: Mask, height_mm: float) -> PointMap:
    moved_points = np.array(points.points_mm)
    moved_points[where, 2] += height_mm
    return PointMap(points_mm=moved_points, sigma_mm=points.sigma_mm, skew_mm=points.skew_mm,
                    rejection=points.rejection)  # fmt: skip


def test_remove_isolated_rejects_patches_that_are_too_small_and_no_others() -> None:
    """Patches of 3 and 4 pixels, in space as well as in the image; corners do not join."""
    patch = np.zeros((8, 12), bool)
    patch[1, 1:4] = True  # three
    patch[4:6, 1:3] = True  # four
    patch[2, 4] = True  # touches the first by its corner only
    patch[:, 6:] = True  # large
    points = flat_map((8, 12), ~patch)
    island = np.zeros((8, 12), bool)
    island[3, 8:11] = True  # three pixels high above the large patch
    points = lifted(points, island, 50.0)
    cleaned = remove_isolated(points, max_gap_mm=2.0, min_pixels=4)
    expected = ~patch
    gone = np.zeros((8, 12), bool)
    gone[1, 1:4] = gone[2, 4] = True
    gone |= island
    np.testing.assert_array_equal(expected | gone, ~cleaned.is_valid)
    assert (cleaned.rejection[gone] == Rejection.ISOLATED).all()
    assert (cleaned.rejection[expected] == Rejection.NO_MATCH).all()
    np.testing.assert_array_equal(
        points.points_mm[cleaned.is_valid], cleaned.points_mm[cleaned.is_valid]
    )


def test_remove_isolated_joins_pixels_within_its_reach() -> None:
    """A comb of every third pixel is one patch with a reach of 3, dust with a reach of 2."""
    holes = np.ones((10, 10), bool)
    holes[::3, ::3] = False
    points = flat_map((10, 10), holes)
    for reach, n_left in ((3, 16), (2, 0)):
        cleaned = remove_isolated(points, max_gap_mm=6.0, min_pixels=16, reach_px=reach)
        assert n_left == cleaned.n_points


def test_remove_isolated_and_edges_leave_an_empty_map_as_it_is() -> None:
    """Nothing to clean."""
    points = flat_map((4, 5), np.ones((4, 5), bool))
    for cleaned in (
        remove_isolated(points, max_gap_mm=2.0, min_pixels=3),
        remove_edges(points, max_gap_mm=2.0),
    ):
        np.testing.assert_array_equal(points.rejection, cleaned.rejection)


def brute_force_edges(points: PointMap, max_gap_mm: float) -> Mask:
    """Return the points with a missing or far one among their 8 neighbours."""
    n_rows, n_cols = points.rejection.shape
    edge = np.zeros((n_rows, n_cols), bool)
    for row in range(n_rows):
        for col in range(n_cols):
            for i in (-1, 0, 1):
                for j in (-1, 0, 1):
                    r, c = row + i, col + j
                    if not (0 <= r < n_rows and 0 <= c < n_cols):
                        edge[row, col] = True
                        continue
                    gap = np.linalg.norm(points.points_mm[row, col] - points.points_mm[r, c])
                    edge[row, col] |= not gap <= max_gap_mm
    return edge & points.is_valid


def test_remove_edges_rejects_all_edges_of_brute_force_and_nothing_two_pixels_away() -> None:
    """One hole and one step; the border of the image is an edge, too."""
    holes = np.zeros((14, 16), bool)
    holes[4, 5] = True
    points = flat_map((14, 16), holes)
    raised = np.zeros((14, 16), bool)
    raised[:, 11:] = True
    points = lifted(points, raised, 20.0)
    cleaned = remove_edges(points, max_gap_mm=3.0)
    edges = brute_force_edges(points, 3.0)
    found = cleaned.rejection == Rejection.EDGE
    assert not (edges & ~found).any()
    assert not (found & ~ndimage.binary_dilation(edges, np.ones((3, 3), bool))).any()
    assert cleaned.n_points > 0


def test_remove_repeated_keeps_the_pixel_nearest_to_the_shared_place() -> None:
    """Three pixels of one code cell; single pixels stay."""
    points = flat_map((2, 6))
    places = pixel_grid((2, 6))
    places[0, 1:4] = [2.2, 0.0]
    places[1, 4:6] = [4.9, 1.0]
    matches = Correspondences(
        device_name="projector",
        pixels_c1=places,
        pixels=places,
        sigma_px=np.ones((2, 6), np.float32),
        epipolar_residual_px=np.zeros((2, 6), np.float32),
        fringe_order=np.zeros((2, 6), np.int32),
        rejection=np.zeros((2, 6), np.uint16),
    )
    cleaned = remove_repeated(points, matches)
    expected = np.zeros((2, 6), np.uint16)
    expected[0, [1, 3]] = expected[1, 4] = Rejection.SAME_POINT
    np.testing.assert_array_equal(expected, cleaned.rejection)
