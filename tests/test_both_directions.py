"""M0: the point of equal phases in two directions, against OpenCV's projection of the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import (
    PLANE,
    Surface,
    grid_of,
    is_seen,
    moved,
    phase_map,
    seen_points,
    small_rig,
)
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import match_both_directions
from fringe3d.model import NO_ORDER, Correspondences, PhaseMap, Rejection, Rig

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Pair = tuple[PhaseMap, PhaseMap]

SCENE = Surface()


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return a rig with the projector off the middle."""
    return small_rig(projector_azimuth_deg=-18.0)


def phases_of(
    rig: Rig, surface: Surface, *, std: float = 0.01, seed: int | None = None, period_y: float = 24
) -> tuple[Pair, Pair]:
    """Return both directions of both cameras; periods of 16 and of `period_y` px."""
    assert rig.projector is not None
    rng = None if seed is None else np.random.default_rng(seed)
    pairs = []
    for camera in rig.cameras:
        x, y = (
            phase_map(camera, rig.projector, surface, period_px=period, angle=angle, std=s, rng=rng)
            for period, angle, s in ((16.0, 0.0, std), (period_y, np.pi / 2, 2 * std))
        )
        pairs.append((x, y))
    return pairs[0], pairs[1]


def matched(rig: Rig, phases: tuple[Pair, Pair]) -> Correspondences:
    return match_both_directions(*phases, *rig.cameras)


def truth_of(rig: Rig, surface: Surface) -> tuple[Floats, Mask]:
    """Return where C2 sees what C1 sees, (row, col, 2) px, and whether it does."""
    assert rig.projector is not None
    c1, c2 = rig.cameras
    points, _, _ = seen_points(c1, grid_of(c1), surface)
    place = cv_project(c2, points)
    size = np.array([c2.n_cols, c2.n_rows]) - 1
    inside = ((place >= 0) & (place <= size)).all(axis=-1)
    seen = inside & is_seen(c2, points, surface) & is_seen(rig.projector, points, surface)
    return place, np.asarray(seen)


def tangents(rig: Rig, surface: Surface) -> Floats:
    """Return the direction in which the point moves in C2 with rising depth, unit length."""
    c1, c2 = rig.cameras
    points, _, _ = seen_points(c1, grid_of(c1), surface)
    _, directions = cv_rays(c1, grid_of(c1))
    along = cv_project(c2, points + 0.01 * directions) - cv_project(c2, points - 0.01 * directions)
    return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True))


def test_exact_phases_give_the_exact_point(rig: Rig) -> None:
    matches = matched(rig, phases_of(rig, PLANE))
    place, seen = truth_of(rig, PLANE)
    good = matches.rejection == 0
    assert seen.sum() > 10_000
    assert good[seen].all()
    assert not good[~seen & ((place < -1) | (place > [160, 128])).any(axis=-1)].any()
    # float32 phases and bilinear interpolation of a plane under a bent lens.
    np.testing.assert_allclose(matches.pixels[good], place[good], atol=0.005)
    assert np.isnan(matches.pixels[~good]).all()
    assert (matches.fringe_order[~good] == NO_ORDER).all()
    assert np.abs(matches.epipolar_residual_px[good]).max() < 0.005
    np.testing.assert_array_equal(matches.pixels_c1, grid_of(rig.cameras[0]))


def test_curved_surface(rig: Rig) -> None:
    matches = matched(rig, phases_of(rig, SCENE))
    place, seen = truth_of(rig, SCENE)
    good = matches.rejection == 0
    error = np.linalg.norm(matches.pixels - place, axis=-1)
    assert good[seen].mean() > 0.97  # beside a silhouette and on flanks neighbours are far apart
    # Between two pixels the phase of a sphere bends by an eighth of its second difference: that
    # moves the point by 1 px^2 / (8 x 6 mm x 4.8 px / mm) = 0.004 px, more where it is steep.
    c1 = rig.cameras[0]
    points, _, on_sphere = seen_points(c1, grid_of(c1), SCENE)
    normals = (points - np.array(SCENE.center_mm)) / SCENE.radius_mm
    facing = [((c.center_world - points) * normals).sum(-1) > 0.6 * np.linalg.norm(
        c.center_world - points, axis=-1) for c in rig.cameras]  # fmt: skip
    gentle = good & seen & on_sphere & facing[0] & facing[1]
    assert gentle.sum() > 1000
    assert error[gentle].max() < 0.02
    assert np.sqrt((error[gentle] ** 2).mean()) < 0.01
    hidden = ~seen & (matches.rejection & Rejection.LOW_MODULATION == 0)
    assert good[hidden].mean() < 0.1  # across an edge four pixels may enclose any phase


def test_order_is_that_of_the_first_direction(rig: Rig) -> None:
    phases = phases_of(rig, PLANE)
    matches = matched(rig, phases)
    good = matches.rejection == 0
    np.testing.assert_array_equal(matches.fringe_order[good], phases[0][0].order_class[good])


def test_sigma_by_monte_carlo(rig: Rig) -> None:
    std = 0.05
    matches = matched(rig, phases_of(rig, PLANE, std=std, seed=1))
    place, _ = truth_of(rig, PLANE)
    good = matches.rejection == 0
    along = ((matches.pixels - place) * tangents(rig, PLANE)).sum(axis=-1)[good]
    predicted = matches.sigma_px[good]
    assert 0.01 < np.median(predicted) < 0.2
    # 15 000 points: 1 %; one weight stands for all places between four pixels: some per cent more.
    assert np.std(along / predicted) == pytest.approx(1, abs=0.1)
    assert np.mean(along / predicted) == pytest.approx(0, abs=0.05)
    twice = matched(rig, phases_of(rig, PLANE, std=2 * std))
    exact = matched(rig, phases_of(rig, PLANE, std=std))
    both = (twice.rejection == 0) & (exact.rejection == 0)
    np.testing.assert_allclose(twice.sigma_px[both], 2 * exact.sigma_px[both], rtol=1e-5)


def test_sigma_grows_with_the_noise_of_either_direction(rig: Rig) -> None:
    """Each direction counts by its own noise: a hand calculation from exact gradients."""
    one = phases_of(rig, PLANE)
    loud = tuple((x, replace(y, phase_std=10 * y.phase_std)) for x, y in one)
    silent = tuple((replace(x, phase_std=0 * x.phase_std), y) for x, y in one)
    quiet, noisy, only_y = (matched(rig, p) for p in (one, loud, silent))  # type: ignore[arg-type]
    good = quiet.rejection == 0
    # sigma^2 = x + y, noisy^2 = x + 100 y, only_y^2 = y
    y2 = (noisy.sigma_px[good] ** 2 - quiet.sigma_px[good] ** 2) / 99
    np.testing.assert_allclose(only_y.sigma_px[good] ** 2, y2, rtol=1e-3, atol=1e-9)
    assert (y2 < quiet.sigma_px[good] ** 2).all()


@pytest.mark.parametrize("shift", [(0.0, 0.4), (0.0, -0.4), (-0.2, 0.5)])
def test_epipolar_residual_shows_a_displaced_camera(rig: Rig, shift: tuple[float, float]) -> None:
    """Positive to the right of rising depth (y points down): cross product by hand."""
    c1, c2 = rig.cameras
    wrong = moved(c2, center_px=np.asarray(c2.center_px) + np.array(shift))
    phases = phases_of(rig, PLANE)
    matches = match_both_directions(*phases, c1, wrong)
    good = matches.rejection == 0
    place, _ = truth_of(rig, PLANE)
    np.testing.assert_allclose(matches.pixels[good], place[good], atol=0.005)  # no geometry in it
    tangent = tangents(replace(rig, cameras=(c1, wrong)), PLANE)[good]
    expected = tangent[:, 0] * -shift[1] - tangent[:, 1] * -shift[0]
    assert np.abs(expected).max() > 0.02
    np.testing.assert_allclose(matches.epipolar_residual_px[good], expected, atol=0.006)


def test_holes_have_no_match(rig: Rig) -> None:
    phases1, (x2, y2) = phases_of(rig, PLANE)
    hole = np.zeros(rig.cameras[1].shape, np.uint16)
    hole[30:60, 50:100] = Rejection.SATURATED
    for pair in ((x2.rejecting(hole), y2), (x2, y2.rejecting(hole))):
        matches = matched(rig, (phases1, pair))
        place, seen = truth_of(rig, PLANE)
        inside = ((place > [49.1, 29.1]) & (place < [99.9, 59.9])).all(axis=-1)
        near = ((place > [48.9, 28.9]) & (place < [100.1, 60.1])).all(axis=-1)
        assert inside.sum() > 1000
        assert (matches.rejection[inside] == Rejection.NO_MATCH).all()
        assert (matches.rejection[seen & ~near] == 0).all()


def test_what_c1_rejects_keeps_its_reason(rig: Rig) -> None:
    (x1, y1), phases2 = phases_of(rig, PLANE)
    bad = np.zeros(x1.rejection.shape, np.uint16)
    bad[10:20, 5:15] = Rejection.SATURATED
    other = np.zeros(x1.rejection.shape, np.uint16)
    other[30:40, 5:15] = Rejection.INCONSISTENT_CODE
    matches = matched(rig, ((x1.rejecting(bad), y1.rejecting(other)), phases2))
    assert (matches.rejection[10:20, 5:15] == Rejection.SATURATED).all()
    assert (matches.rejection[30:40, 5:15] == Rejection.INCONSISTENT_CODE).all()


def test_nothing_seen_gives_nothing(rig: Rig) -> None:
    phases1, (x2, y2) = phases_of(rig, PLANE)
    all_bad = np.full(x2.rejection.shape, np.uint16(Rejection.LOW_MODULATION))
    matches = matched(rig, (phases1, (x2.rejecting(all_bad), y2)))
    lit = phases1[0].rejection == 0
    assert (matches.rejection[lit] == Rejection.NO_MATCH).all()


def test_order_of_the_directions_does_not_matter(rig: Rig) -> None:
    """Only which fringe order is told depends on it."""
    (x1, y1), (x2, y2) = phases_of(rig, PLANE)
    forth = matched(rig, ((x1, y1), (x2, y2)))
    back = matched(rig, ((y1, x1), (y2, x2)))
    both = (forth.rejection == 0) & (back.rejection == 0)
    assert both.sum() > 10_000
    np.testing.assert_allclose(forth.pixels[both], back.pixels[both], atol=1e-6)
    np.testing.assert_allclose(forth.sigma_px[both], back.sigma_px[both], rtol=1e-4)
