"""Phases averaged over neighbours, against plane waves and sampled noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import PLANE, phase_map, small_rig
from fringe3d.correspond import TwoViews, averaged_phase, quiet

SHAPE = (120, 160)
TWO_PI = 2 * np.pi
SLOPE = (-2.2, 0.9)
"""rad / px along rows and columns: neighbours of a period each three pixels."""


def wave(slope: tuple[float, float] = SLOPE, *, bend: float = 0.0) -> NDArray[np.float64]:
    rows, cols = np.indices(SHAPE)
    return np.asarray(1.0 + slope[0] * rows + slope[1] * cols + bend * cols**2)


def wrapped(phase: NDArray[np.float64]) -> NDArray[np.float32]:
    return (phase % TWO_PI).astype(np.float32)


def sigma(value: float = 0.1) -> NDArray[np.float32]:
    return np.full(SHAPE, value, np.float32)


@pytest.mark.parametrize("radius", [1, 2])
@pytest.mark.parametrize("slope", [SLOPE, (0.0, 0.0), (3.0, -3.0)])
def test_a_plane_wave_stays_what_it_is(radius: int, slope: tuple[float, float]) -> None:
    """However steep: opposite pixels cancel."""
    phase = wrapped(wave(slope))
    found, _ = averaged_phase(phase, sigma(), radius)
    np.testing.assert_allclose(found, phase, atol=2e-4)  # single precision of 500 rad


@pytest.mark.parametrize(("radius", "n"), [(1, 9), (2, 25)])
def test_noise_falls_as_predicted(radius: int, n: int) -> None:
    """The mean of n has 1/sqrt(n) of the noise; that of a pixel itself decides which pairs are left
    out, which costs up to 15 %."""
    rng = np.random.default_rng(1)
    true = wave()
    noisy = wrapped(true + 0.1 * rng.standard_normal(SHAPE))
    found, deviation = averaged_phase(noisy, sigma(), radius)
    inner = np.s_[radius:-radius, radius:-radius]
    error = found - true
    pull = (error - TWO_PI * np.rint(error / TWO_PI)) / deviation
    assert 1.0 < pull[inner].std() < 1.2
    np.testing.assert_allclose(np.median(deviation[inner]), 0.1 / np.sqrt(n), rtol=1e-6)


def test_an_average_belongs_to_the_order_of_its_pixel() -> None:
    """Wrapped again, one that passes 2 pi would be a period off."""
    rng = np.random.default_rng(2)
    noisy = wrapped(wave() + 0.2 * rng.standard_normal(SHAPE))
    found, _ = averaged_phase(noisy, sigma(0.2), 1)
    assert np.abs(found - noisy).max() < np.pi / 2
    assert found.max() > TWO_PI
    assert found.min() < 0


def test_an_edge_stays_where_it_is() -> None:
    """Two surfaces of any slope, 1 rad apart: the pairs across their border deviate by that."""
    true = wave()
    true[:, 80:] += 1.0
    found, deviation = averaged_phase(wrapped(true), sigma(0.01), 2)
    np.testing.assert_allclose(found, wrapped(true), atol=2e-4)
    assert deviation[60, 79] == pytest.approx(0.01 / np.sqrt(5))  # its own column of five
    assert deviation[60, 40] == pytest.approx(0.01 / 5)


def test_a_curved_surface_is_followed() -> None:
    """The mean of a parabola over 5 x 5 is off by its bend times the mean square distance, 2."""
    phase = wrapped(wave(bend=0.002))
    found, _ = averaged_phase(phase, sigma(), 2)
    np.testing.assert_allclose((found - phase)[2:-2, 2:-2], 0.002 * 2, atol=2e-4)


def test_what_is_unknown_stays_unknown_and_harms_nothing() -> None:
    phase = wrapped(wave())
    phase[50:60, 70] = np.nan
    found, deviation = averaged_phase(phase, sigma(), 1)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(phase))
    np.testing.assert_allclose(found, phase, atol=2e-4)
    assert deviation[55, 71] == pytest.approx(0.1 / np.sqrt(3))  # the pixels above and below


@pytest.mark.parametrize(("noise", "n"), [(0.03, 1), (0.06, 9), (0.12, 25)])
def test_views_are_averaged_as_much_as_their_noise_demands(noise: float, n: int) -> None:
    rig = small_rig()
    assert rig.projector is not None
    c1, c2 = rig.cameras
    phases1, phases2 = (phase_map(c, rig.projector, PLANE, n_classes=1, std=noise)
                        for c in (c1, c2))  # fmt: skip
    views = TwoViews(camera1=c1, camera2=c2, phases1=phases1, phases2=phases2)
    found = quiet(views)
    for before, after in ((views.phases1, found.phases1), (views.phases2, found.phases2)):
        assert np.nanmedian(after.phase_std) == pytest.approx(noise / np.sqrt(n))
        assert (after is before) == (n == 1)
        np.testing.assert_array_equal(after.order_class, before.order_class)
