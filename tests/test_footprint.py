"""Phases of pixel centres: what pixels and lenses average is taken out; sigma tells the rest."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.correspond import variance_between
from fringe3d.decode import centred
from fringe3d.decode.fit import noise_waves
from fringe3d.model import NO_ORDER, PhaseMap

Floats = NDArray[np.float64]

SHAPE = (60, 70)
FINE = 9
"""Rays along each axis of a pixel: an odd number, the middle one through its centre."""

BLUR_PX = 0.4


def a_map(phase: Floats, modulation: Floats, sigma: float = 1e-4) -> PhaseMap:
    unknown = np.isnan(phase)
    light = modulation.astype(np.float32)
    return PhaseMap(
        phase=(phase % (2 * np.pi)).astype(np.float32),
        order_class=np.where(unknown, NO_ORDER, 0),
        class_of_order=np.zeros(1, np.int32),
        phase_std=np.full(phase.shape, sigma, np.float32),
        offset=light,
        modulation=light,
        rejection=np.where(unknown, 2, 0),
        period_px=16.0,
        angle=0.0,
        device_name="c1",
    )


def averaged() -> tuple[Floats, Floats, Floats]:
    """Return phase and modulation of pixels, and the phase at their centres.

    A bent carrier and a brightness that falls to one side, as on a ball, on rays a ninth of a pixel
    apart, their phasors blurred by a Gaussian and by the area of a pixel.
    """
    step = 1 / FINE
    y, x = np.mgrid[: SHAPE[0] : step, : SHAPE[1] : step] - (FINE // 2) * step
    phase = 0.5 * x + 0.1 * y + 4e-3 * (x - 30) ** 2 - 3e-3 * (y - 20) ** 2
    light = 100 * np.exp(-0.02 * x + 0.01 * y)
    phasor = light * np.exp(1j * phase)
    parts = []
    for part in (phasor.real, phasor.imag):
        blurred = ndimage.gaussian_filter(part, BLUR_PX * FINE, truncate=6)
        parts.append(ndimage.uniform_filter(blurred, FINE)[FINE // 2 :: FINE, FINE // 2 :: FINE])
    mean = parts[0] + 1j * parts[1]
    return np.angle(mean), np.abs(mean), phase[FINE // 2 :: FINE, FINE // 2 :: FINE]


def away(phase: NDArray[np.floating], true: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * (phase - true))))[5:-5, 5:-5]


def test_phases_are_those_of_pixel_centres() -> None:
    """Against light averaged over fine rays: the error falls from 3 mrad to below a tenth of it.

    What is left is of the fourth order.
    """
    seen, light, true = averaged()
    before = away(seen, true)
    after = away(centred(a_map(seen, light), blur_px=BLUR_PX).phase, true)
    assert np.sqrt((before**2).mean()) > 2e-3
    assert np.sqrt((after**2).mean()) < 0.1 * np.sqrt((before**2).mean())


def test_a_bilinear_interpolation_of_them_is_right_on_average() -> None:
    """The mean of four in the middle of them and of the pixels themselves, weighted as places are.

    Simpson's rule is exact for f (1 - f): a sixth of both ends, four sixths of the middle.
    """
    x = np.broadcast_to(np.arange(SHAPE[1], dtype=float), SHAPE)
    bend = 4e-3
    true = 0.4 * x + bend * (x - 30) ** 2
    found = centred(a_map(true, np.full(SHAPE, 90.0)), blur_px=0.0, is_first=False)
    off = away(found.phase, true) + bend / 12  # the area of a pixel, which these have not
    middle = off + bend / 4  # between two pixels: half of the second difference, 2 bend, a quarter
    assert np.abs(off / 3 + 2 * middle / 3).max() < 1e-5


@pytest.mark.parametrize("is_first", [True, False])
def test_noise_hardly_grows_and_sigma_tells_by_how_much(is_first: bool) -> None:
    """At pixels and, interpolated, at places between them: 1 % for 40 x 50 pixels and 20 draws."""
    rng = np.random.default_rng(8)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    true = 0.5 * x + 0.1 * y
    places = np.stack([x, y], axis=-1)[8:-8, 8:-8].reshape(-1, 2) + 0.5 * (not is_first)
    errors, variances = [], []
    for _ in range(20):
        noisy = a_map(true + rng.normal(0, 0.02, SHAPE), np.full(SHAPE, 90.0), 0.02)
        found = centred(noisy, blur_px=BLUR_PX, is_first=is_first)
        off = np.angle(np.exp(1j * (found.phase - true)))
        if is_first:
            errors.append(off[8:-8, 8:-8])
            variances.append(found.point_std[8:-8, 8:-8].astype(float) ** 2)
        else:
            four = (off[8:-8, 8:-8] + off[8:-8, 9:-7] + off[9:-7, 8:-8] + off[9:-7, 9:-7]) / 4
            errors.append(four)
            variances.append(variance_between(found, places))
    pull = np.std(errors) / np.sqrt(np.mean(variances))
    assert pull == pytest.approx(1, abs=0.02)


def test_detail_finer_than_the_window_raises_sigma_and_planes_do_not() -> None:
    """A crease of 0.3 rad / px; elsewhere nothing but the noise."""
    x = np.broadcast_to(np.arange(SHAPE[1], dtype=float), SHAPE)
    found = centred(a_map(0.5 * x + 0.3 * np.abs(x - 30), np.full(SHAPE, 90.0)), blur_px=BLUR_PX)
    assert found.point_std[30, 30] > 100 * 1e-4
    np.testing.assert_allclose(found.point_std[30, 40], 1e-4, rtol=0.05)


def test_pixels_beside_holes_are_less_certain_and_holes_stay() -> None:
    """Light may be mixed there; two pixels away it is not."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    phase = np.where((x == 20) & (y == 20), np.nan, 0.5 * x)
    found = centred(a_map(phase, np.full(SHAPE, 90.0)), blur_px=BLUR_PX)
    assert np.isnan(found.phase[20, 20])
    assert np.isfinite(found.phase).sum() == found.phase.size - 1
    assert found.point_std[20, 21] > 0.05
    assert found.point_std[20, 22] < 2e-4


@pytest.mark.parametrize(
    ("place", "part"), [((10.0, 10.0), 1.0), ((10.5, 10.0), 0.5), ((10.5, 10.5), 0.25)]
)
def test_noise_between_pixels_is_that_of_the_weights(
    place: tuple[float, float], part: float
) -> None:
    """1 at a pixel, a half between two, a quarter between four; all alike: nothing is won."""
    x = np.broadcast_to(0.5 * np.arange(30.0), (30, 30))
    phases = a_map(x, np.full((30, 30), 90.0), 0.02)
    found = variance_between(phases, np.array([place]))
    assert found[0] == pytest.approx(part * 0.02**2, rel=1e-5)


@pytest.mark.parametrize("shifts", [(0, 120, 240), (0, 90, 180), (0, 90, 180, 270), (10, 95, 250)])
@pytest.mark.parametrize("phase", [-2.4, -0.6, 0.3, 1.9])
def test_shot_noise_of_the_phase_goes_with_the_phase(
    shifts: tuple[float, ...], phase: float
) -> None:
    """By sampling: A 1000, B 900 DN, read noise 2 DN, gain 0.5. 60,000 draws: 0.3 %."""
    rng = np.random.default_rng(4)
    steps = np.radians(shifts)
    mean = 1000 + 900 * np.cos(phase - steps)
    drawn = mean + rng.normal(size=(60_000, len(steps))) * np.sqrt(4 + 0.5 * mean)
    model = np.stack([np.ones_like(steps), np.cos(steps), np.sin(steps)], axis=1)
    _, cosine, sine = np.linalg.lstsq(model, drawn.T, rcond=None)[0]
    scatter = np.angle(np.exp(1j * (np.arctan2(sine, cosine) - phase))).std()
    waves = noise_waves(tuple(float(s) for s in steps))
    f4 = np.float32
    sigma = waves.noise(np.full(1, 504.0, f4), np.full(1, 450.0, f4), np.full(1, phase, f4)) / 900
    assert float(sigma[0]) == pytest.approx(scatter, rel=0.015)
    assert waves.is_even == (len(shifts) == 4)
