"""Predicted uncertainty against noise drawn at random.

The oracle measures points of a plane with noisy phases. Its projections are OpenCV's, its rays
lines through the points: it shares no code with what it judges.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from changed_rigs import cut_rig
from cv_lens import cv_points_at, cv_project
from fringe3d.design.uncertainty import (
    phase_gradient,
    phase_noise,
    point_sigma,
    predict_uncertainty,
)
from fringe3d.errors import RigError
from fringe3d.model import MeasuringVolume, Rig

pytest.importorskip("embreex")

from fringe3d.simulate import PRESETS

Floats = NDArray[np.float64]

PERIOD = 16.0
DRAWS = 4000
"""The standard deviation of so many draws is known to 1.1 %."""

SIGMA = 0.01
"""Rad; small enough for points to move in proportion."""


@pytest.fixture(scope="module")
def kolibri() -> Rig:
    return PRESETS["kolibri"]((640, 512)).rig


def phase(rig: Rig, points: Floats, angle: float) -> Floats:
    assert rig.projector is not None
    w = (cv_project(rig.projector, points) + 0.5) @ [math.cos(angle), math.sin(angle)]
    return np.asarray(2 * math.pi / PERIOD * w)


def solved(f: Callable[[Floats], Floats], n: int) -> Floats:
    """Return the zeros of f near 0, (n,), by secants."""
    a, b = np.full(n, -0.02), np.full(n, 0.02)
    fa, fb = f(a), f(b)
    for _ in range(6):
        step = np.where(fb != fa, fb * (b - a) / np.where(fb != fa, fb - fa, 1.0), 0.0)
        a, fa = b, fb
        b = b - step
        fb = f(b)
    assert np.abs(fb).max() < 1e-6
    return b


def plane(rng: np.random.Generator, normal: Floats) -> Floats:
    """Return random points of a plane through the origin, within 25 mm of it, (DRAWS, 3)."""
    x, y = rng.uniform(-18, 18, (2, DRAWS))
    return np.stack([x, y, -(normal[0] * x + normal[1] * y) / normal[2]], axis=-1)


def leaning(tilt_deg: float, azimuth_deg: float) -> Floats:
    tilt, azimuth = np.radians([tilt_deg, azimuth_deg])
    return np.array(
        [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]
    )


@pytest.mark.parametrize(
    ("tilt_deg", "azimuth_deg", "angle_deg"),
    [(0.0, 0.0, 0.0), (25.0, 0.0, 0.0), (25.0, 180.0, 0.0), (20.0, -60.0, 25.0)],
)
def test_two_cameras_scatter_as_predicted(
    kolibri: Rig, tilt_deg: float, azimuth_deg: float, angle_deg: float
) -> None:
    """C2's phase is interpolated between its pixels, and the noise with it."""
    rng = np.random.default_rng(8)
    angle, normal = math.radians(angle_deg), leaning(tilt_deg, azimuth_deg)
    points = plane(rng, normal)
    c1, c2 = (camera.center_world for camera in kolibri.cameras)
    along = points - c1
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    phi1 = phase(kolibri, points, angle) + SIGMA * rng.standard_normal(DRAWS)
    noise2 = SIGMA * rng.standard_normal(kolibri.cameras[1].shape)

    def difference(t: Floats) -> Floats:
        moved = points + t[:, None] * along
        col, row = cv_project(kolibri.cameras[1], moved).T
        x, y = np.floor(col).astype(int), np.floor(row).astype(int)
        fx, fy = col - x, row - y
        noise = (noise2[y, x] * (1 - fx) + noise2[y, x + 1] * fx) * (1 - fy)
        noise += (noise2[y + 1, x] * (1 - fx) + noise2[y + 1, x + 1] * fx) * fy
        toward = moved - c2
        met = c2 - (c2 @ normal / (toward @ normal))[:, None] * toward
        return np.asarray(phase(kolibri, met, angle) + noise - phi1)

    predicted = point_sigma(kolibri, points, period_px=PERIOD, sigma_phase=SIGMA, angle=angle,
                            normals=normal)  # fmt: skip
    error = solved(difference, DRAWS) / predicted
    # 1.1 % of chance, and pixels of C2 that several points share.
    assert error.std() == pytest.approx(1.0, abs=0.05)
    assert abs(error.mean()) < 0.06


def test_one_camera_scatters_as_predicted(kolibri: Rig) -> None:
    rng = np.random.default_rng(9)
    single = replace(kolibri, cameras=kolibri.cameras[:1])
    points = plane(rng, leaning(10.0, 30.0))
    along = points - single.cameras[0].center_world
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    phi1 = phase(single, points, 0.0) + SIGMA * rng.standard_normal(DRAWS)
    error = solved(lambda t: phase(single, points + t[:, None] * along, 0.0) - phi1, DRAWS)
    predicted = point_sigma(single, points, period_px=PERIOD, sigma_phase=SIGMA)
    assert (error / predicted).std() == pytest.approx(1.0, abs=0.04)


def test_without_a_projector_the_period_in_c2_decides(kolibri: Rig) -> None:
    """sigma_px = sqrt(13/9) sigma period / 2 pi, over the speed of the image; by OpenCV."""
    stereo = replace(kolibri, projector=None)
    points = plane(np.random.default_rng(2), leaning(0.0, 0.0))[:50]
    along = points - stereo.cameras[0].center_world
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    moved, here = (cv_project(stereo.cameras[1], points + t * along) for t in (0.01, 0.0))
    speed = np.linalg.norm(moved - here, axis=1) / 0.01
    expected = math.sqrt(13 / 9) * 0.02 * 11.0 / (2 * math.pi) / speed
    found = point_sigma(stereo, points, period_px=11.0, sigma_phase=0.02)
    # A one-sided difference over 0.01 mm of 335: below 1e-4.
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("n_shifts", [3, 4, 16])
def test_the_noise_of_a_phase_is_that_of_noisy_steps(n_shifts: int) -> None:
    rng = np.random.default_rng(1)
    n = 40_000
    shifts = 2 * math.pi * np.arange(n_shifts) / n_shifts
    grey = 100 + 50 * np.cos(0.7 - shifts) + 50 * 0.01 * rng.standard_normal((n, n_shifts))
    phases = np.angle(grey @ np.exp(1j * shifts))
    assert phases.mean() == pytest.approx(0.7, abs=2e-4)
    assert phases.std() == pytest.approx(phase_noise(n_shifts, 0.01), rel=0.02)


@pytest.mark.parametrize("bad", [(2, 0.01), (4, -0.1), (4, math.nan), (4, math.inf)])
def test_impossible_noise_is_refused(bad: tuple[int, float]) -> None:
    with pytest.raises(ValueError, match="phase noise: expected"):
        phase_noise(*bad)


def test_the_phase_gradient_is_that_of_opencv(kolibri: Rig) -> None:
    assert kolibri.projector is not None
    points = plane(np.random.default_rng(3), leaning(15.0, 80.0))[:20]
    found = phase_gradient(kolibri.projector, points, period_px=PERIOD, angle=0.4)
    for axis in range(3):
        step = 0.02 * np.eye(3)[axis]
        expected = (phase(kolibri, points + step, 0.4) - phase(kolibri, points - step, 0.4)) / 0.04
        np.testing.assert_allclose(found[:, axis], expected, rtol=1e-5, atol=1e-7)


def test_surfaces_seen_from_behind_have_no_sigma(kolibri: Rig) -> None:
    point = np.zeros((1, 3))
    for normal, known in (([0, 0, 1.0], True), ([0, 0, -1.0], False), ([1.0, 0, 0.05], False)):
        found = point_sigma(kolibri, point, period_px=PERIOD, sigma_phase=SIGMA, normals=[normal])
        assert np.isfinite(found[0]) == known


def test_the_map_covers_what_all_devices_see(kolibri: Rig) -> None:
    found = predict_uncertainty(kolibri, period_px=PERIOD, sigma_phase=SIGMA, step=16)
    assert found.sigma_mm.shape == (32, 40)
    assert np.isfinite(found.sigma_mm).mean() == pytest.approx(0.73, abs=0.03)
    assert found.low_mm < found.median_mm < found.high_mm
    # In the middle of the image the segment's middle is nearly the origin.
    here = point_sigma(kolibri, np.zeros(3), period_px=PERIOD, sigma_phase=SIGMA)
    assert found.sigma_mm[16, 20] == pytest.approx(float(here), rel=0.01)
    twice = predict_uncertainty(kolibri, period_px=PERIOD, sigma_phase=2 * SIGMA, step=16)
    assert twice.median_mm == pytest.approx(2 * found.median_mm, rel=1e-12)


def test_the_quantiles_are_those_of_points_all_over_the_volume(kolibri: Rig) -> None:
    """Eight centimetres deep, so that depth makes all the difference: 5.3 to 8.5 um."""
    rig = cut_rig(kolibri, 40.0)
    x, y = np.meshgrid(np.arange(0, 160, 16), np.arange(0, 128, 16))
    pixels = np.stack([x, y], axis=-1)
    top, bottom = (cv_points_at(rig.cameras[0], pixels, z) for z in (40.0, -40.0))
    part = np.random.default_rng(4).random((250, *x.shape, 1))  # 20,000 points
    sigma = point_sigma(rig, top + part * (bottom - top), period_px=PERIOD, sigma_phase=SIGMA)
    low, median, high = np.quantile(sigma, [0.05, 0.5, 0.95])
    assert high > 1.5 * low
    found = predict_uncertainty(rig, period_px=PERIOD, sigma_phase=SIGMA, step=16)
    assert found.median_mm == pytest.approx(median, rel=0.01)
    # Of five places on each segment the outermost ends a tenth of it before its end: 2 %.
    assert found.low_mm == pytest.approx(low, rel=0.025)
    assert found.high_mm == pytest.approx(high, rel=0.025)


def test_kolibri_reaches_3_um_with_16_phases_and_1_percent_noise(kolibri: Rig) -> None:
    """The source paper's order of magnitude: 2.8 um."""
    found = predict_uncertainty(
        kolibri, period_px=PERIOD, sigma_phase=phase_noise(16, 0.01), step=16
    )
    assert 2.0e-3 < found.median_mm < 3.0e-3


def test_devices_that_share_no_volume_are_refused(kolibri: Rig) -> None:
    apart = replace(kolibri, volume=MeasuringVolume.box([500, 500, -5], [510, 510, 5]))
    with pytest.raises(RigError, match="that all devices see, found none"):
        predict_uncertainty(apart, period_px=PERIOD, sigma_phase=SIGMA)
