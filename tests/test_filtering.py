"""Filtered phases: less noise, true sigma, sharp edges, round things stay round."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import Recording
from fringe3d.decode.filtering import INTERPOLATED, filtered, interpolated_part, smoothed_phase
from fringe3d.model import NO_ORDER, PhaseMap, Rig
from fringe3d.options import Filter
from fringe3d.pipeline import MeasureOptions, measure

Floats = NDArray[np.float64]

SEED = 20261203
SHAPE = (80, 90)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
CARRIER = 0.7 * X + 0.1 * Y


def noisy(true: Floats, sigma: float) -> NDArray[np.float32]:
    rng = np.random.default_rng(SEED)
    return np.asarray((true + rng.normal(0, sigma, true.shape)) % (2 * np.pi), np.float32)


def error(phase: NDArray[np.float32], true: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * (phase - true))))


def flat(sigma: float) -> NDArray[np.float32]:
    return np.full(SHAPE, sigma, np.float32)


@pytest.mark.parametrize(("radius", "gain"), [(3, 2.9), (6, 5.4), (9, 7.6)])
@pytest.mark.parametrize("sigma", [0.01, 0.1])
def test_noise_falls_and_sigma_tells_by_how_much(radius: int, gain: float, sigma: float) -> None:
    """A bent carrier. Errors hang together over the disc: some 40 of them (r = 9) are independent,
    so that the pull of 7200 pixels is known to a tenth; 5 % for small discs.
    """
    true = CARRIER + 6e-4 * (X - 40) ** 2
    phase, predicted, _ = smoothed_phase(noisy(true, sigma), flat(sigma), radius)
    off = error(phase, true)
    inner = off[radius:-radius, radius:-radius]
    assert sigma / inner.std() > gain
    assert (off / predicted).std() == pytest.approx(1, abs=0.03 + 0.008 * radius)
    # At the rim the disc is cut and the parabola is extrapolated.
    assert predicted[0, 0] > 2 * predicted[40, 40]


def test_a_step_stays_where_it_is_and_as_high_as_it_is() -> None:
    """A jump of 1 rad along a slanted edge, noise 0.03 rad: no pixel is drawn across.

    The mean error beside the edge is 0 within 4 sigma / sqrt(300) = 0.007 rad: less than 1 %.
    """
    right = X + 0.3 * Y > 55
    true = CARRIER + np.where(right, 1.0, 0.0)
    phase, *_ = smoothed_phase(noisy(true, 0.03), flat(0.03), 6)
    off = error(phase, true)
    beside = np.abs(X + 0.3 * Y - 55) < 4
    assert np.abs(off).max() < np.abs(error(noisy(true, 0.03), true)).max()
    assert abs(off[beside & right].mean() - off[beside & ~right].mean()) < 0.01
    assert off[beside].std() < 0.03 / 1.7  # half a disc


def test_a_blurring_of_the_phasor_would_draw_edges() -> None:
    """The test above would see it: a mean of 7 x 7 phasors without the carrier leaves 0.3 rad."""
    from scipy.ndimage import uniform_filter

    right = X + 0.3 * Y > 55
    true = CARRIER + np.where(right, 1.0, 0.0)
    phasor = np.exp(1j * (noisy(true, 0.03) - CARRIER))
    mean = uniform_filter(phasor.real, 7) + 1j * uniform_filter(phasor.imag, 7)
    assert np.abs(error(np.angle(mean) + CARRIER, true)).max() > 0.3


def test_thin_walls_and_lone_pixels_stay_as_they_are() -> None:
    """A line one pixel wide, 1.5 rad off, and a pixel among unknown ones."""
    true = CARRIER + np.where(X == 30, 1.5, 0.0)
    phase = noisy(true, 0.02)
    phase[40:60, 60:80] = np.nan
    phase[50, 70] = 1.0
    answer, sigma, _ = smoothed_phase(phase, flat(0.02), 6)
    np.testing.assert_array_equal(answer[50, 70], phase[50, 70])
    assert sigma[50, 70] == np.float32(0.02)
    assert np.isnan(answer[41, 61])
    assert np.abs(error(answer, true)[:, 30]).max() < 0.1
    assert np.abs(error(answer, true)[:, [29, 31]]).max() < 0.08


def test_a_ball_keeps_its_bend() -> None:
    """A cap of a sphere in phase: the fourth order that a parabola leaves out stays below 1e-3 rad
    up to slopes of 45 deg; a mean over the same disc is off by r^2 / 8 times the bend: 0.02 rad.
    """
    radius = 60.0
    depth = np.sqrt(np.maximum(radius**2 - (X - 45) ** 2 - (Y - 40) ** 2, 0))
    true = CARRIER + 0.2 * depth
    inside = np.hypot(X - 45, Y - 40) < radius * np.sin(np.radians(40))
    phase, *_ = smoothed_phase(np.asarray(true % (2 * np.pi), np.float32), flat(0.02), 6)
    assert np.abs(error(phase, true)[inside]).max() < 1e-3


def test_what_discs_flatten_is_in_sigma() -> None:
    """Waves of 7 px, a little higher than the noise: a disc of radius 5 would take most of them.

    Sigma with what is flattened is that of the errors within 10 %; without it they are larger.
    """
    true = 0.77 * X + 0.23 * Y + 0.05 * np.sin(2 * np.pi * Y / 7)
    phase, sigma, left = smoothed_phase(noisy(true, 0.03), flat(0.03), 5)
    off = error(phase, true)[8:-8, 8:-8]
    told = np.hypot(sigma, left)[8:-8, 8:-8]
    assert (off / told).std() == pytest.approx(1, abs=0.1)
    assert (off / sigma[8:-8, 8:-8]).std() > 1.15
    assert off.std() < 0.03


def test_a_ripple_of_the_pattern_is_no_relief() -> None:
    """Twelve waves in each period, as of whole grey values: both cameras see it, no point moves."""
    rippled = noisy(CARRIER + 0.02 * np.sin(12 * CARRIER), 0.02)
    _, sigma, left = smoothed_phase(rippled, flat(0.02), 5)
    assert (sigma < 0.02 / 4).mean() > 0.9
    assert left.mean() < 0.1 * 0.02


def test_pixels_without_modulation_leave_the_others_alone() -> None:
    """Their sigma is infinite."""
    sigma = flat(0.05)
    phase = noisy(CARRIER, 0.05)
    sigma[40, 40], phase[40, 40] = np.inf, np.nan
    _, found, left = smoothed_phase(phase, sigma, 5)
    away = np.hypot(X - 40, Y - 40) > 30
    _, expected, _ = smoothed_phase(phase, flat(0.05), 5)
    np.testing.assert_array_equal(found[away], expected[away])
    assert np.isfinite(left).all()


@pytest.mark.parametrize("radius", [3, 6])
def test_what_interpolation_leaves_of_filtered_noise_is_that_of_sampling(radius: int) -> None:
    """Noise filtered, then interpolated halfway and elsewhere between pixels; 5 %: few of the
    errors are independent."""
    phase, *_ = smoothed_phase(noisy(CARRIER, 0.05), flat(0.05), radius)
    off = error(phase, CARRIER)
    parts = []
    for a in (0.1, 0.3, 0.5, 0.7, 0.9):
        for b in (0.1, 0.3, 0.5, 0.7, 0.9):
            mixed = (1 - b) * ((1 - a) * off[:-1, :-1] + a * off[:-1, 1:]) + b * (
                (1 - a) * off[1:, :-1] + a * off[1:, 1:]
            )
            parts.append(mixed[radius:-radius, radius:-radius].var())
    inner = off[radius:-radius, radius:-radius].var()
    assert np.mean(parts) / inner == pytest.approx(interpolated_part(radius), rel=0.05)
    assert interpolated_part(radius) > INTERPOLATED


def test_orders_and_reasons_stay() -> None:
    """The phase may leave [0, 2 pi) a little, and goes on belonging to its order."""
    wrapped = noisy(CARRIER, 0.05)
    order = np.round((CARRIER - wrapped) / (2 * np.pi)).astype(np.int32)
    bad = np.zeros(SHAPE, bool)
    bad[10:20, 10:20] = True
    phases = PhaseMap(
        phase=np.where(bad, np.float32(np.nan), wrapped),
        order_class=np.where(bad, NO_ORDER, order),
        class_of_order=np.arange(20, dtype=np.int32),
        phase_std=flat(0.05), offset=flat(100), modulation=flat(50),
        rejection=np.where(bad, 2, 0).astype(np.uint16),
        period_px=16.0, angle=0.0, device_name="c1",
    )  # fmt: skip
    first = filtered(phases, 6)
    np.testing.assert_array_equal(first.order_class, phases.order_class)
    np.testing.assert_array_equal(np.isnan(first.phase), bad)
    assert np.abs(first.absolute_phase - CARRIER)[~bad].max() < 0.1
    second = filtered(phases, 6, is_first=False)
    ratio = second.phase_std[40, 40] / first.phase_std[40, 40]
    assert ratio == pytest.approx(np.sqrt(interpolated_part(6) / INTERPOLATED), rel=1e-6)
    assert (second.phase_std <= phases.phase_std).all()


def test_a_filtered_measurement_is_less_noisy_and_its_sigma_true(
    rig: Rig, recording: Recording
) -> None:
    """A sphere before a plane, from noisy images, against the truth along the rays of C1.

    The pull may be wider by what the curved rim of the sphere leaves; gross errors do not grow.
    """
    scan, (truth, *_) = recording
    away = truth.points_mm - rig.cameras[0].center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    spread, gross = {}, {}
    strengths: tuple[Filter, ...] = ("none", "medium")
    for strength in strengths:
        points = measure(scan, MeasureOptions(filter=strength, blur_px=None)).points
        assert points is not None
        off = ((points.points_mm - truth.points_mm) * away).sum(axis=-1)[points.is_valid]
        spread[strength] = 1.4826 * float(np.median(np.abs(off - np.median(off))))
        gross[strength] = float((np.abs(off) > 0.1).mean())
        pull = off / points.sigma_mm[points.is_valid]
        assert 1.4826 * np.median(np.abs(pull)) == pytest.approx(1, abs=0.15)
    assert spread["none"] / spread["medium"] > 3.5
    assert gross["medium"] < gross["none"] + 0.001
