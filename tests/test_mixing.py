"""Dark pixels beside bright ones: where their light comes from counts in their noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from fringe3d.decode import mixed
from fringe3d.model import PhaseMap

RISE = 0.4  # rad / px, about a period in sixteen pixels
BLUR_PX, CONTRAST, FINE = 0.4, 95.0, 200


def seen(border_px: float, n: int = 12) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return phase and modulation of a row of pixels, dark left of a border, bright right of it.

    The light of every place is added up through the pixel's square and a Gaussian lens.
    """
    x = (np.arange(n * FINE) + 0.5) / FINE - 0.5
    light = np.where(x < border_px, 1.0, CONTRAST) * np.exp(1j * RISE * x)
    away = x[None] - np.arange(n)[:, None]
    weight = ndtr((away + 0.5) / BLUR_PX) - ndtr((away - 0.5) / BLUR_PX)
    found = (weight * light).sum(axis=1) / weight.sum(axis=1)
    return np.angle(found), np.abs(found)


def phase_map(phase: NDArray[np.float64], light: NDArray[np.float64], *, down: bool) -> PhaseMap:
    """Return a map whose rows (columns) are all the same."""
    around, bright = (
        np.tile(row, (5, 1)).T if down else np.tile(row, (5, 1))
        for row in (phase % (2 * np.pi), light)
    )
    return _map(around.astype(np.float32), bright.astype(np.float32))


def _map(phase: NDArray[np.float32], light: NDArray[np.float32]) -> PhaseMap:
    std = np.full(phase.shape, 0.01, np.float32)
    return PhaseMap(phase=phase, order_class=np.zeros(phase.shape, np.int16),
                    class_of_order=np.zeros(1, np.int16), phase_std=std, offset=light,
                    modulation=light, rejection=np.zeros(phase.shape, np.uint16), period_px=16.0,
                    angle=0.0, device_name="c1")  # fmt: skip


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("border_px", [5.3, 5.5, 5.8, 6.0, 6.2])
def test_the_noise_counts_where_the_light_comes_from(border_px: float, down: bool) -> None:
    phase, light = seen(border_px)
    inner = slice(3, 9)  # ends of the row lack light from beyond
    error = np.angle(np.exp(1j * (phase - RISE * np.arange(len(phase)))))[inner]
    raised = mixed(phase_map(phase, light, down=down), blur_px=BLUR_PX).phase_std
    sigma = (raised[:, 2] if down else raised[2])[inner]
    # Dark pixels beside the border are wrong by more than ten times their noise ...
    assert np.abs(error).max() > 0.1
    # ... and none by more than three sigma, far from the twelve at which points are refuted.
    assert (np.abs(error) <= 3 * sigma).all()


def test_an_even_brightness_changes_nothing() -> None:
    phases = phase_map(RISE * np.arange(12.0), np.full(12, 50.0), down=False)
    np.testing.assert_array_equal(mixed(phases).phase_std, phases.phase_std)


def test_a_wrapped_phase_rises_as_an_unwrapped_one() -> None:
    # 2 pi from pixel to pixel where it wraps would count as fifteen times the rise.
    phase, light = seen(5.5)
    plain, turned = (
        mixed(phase_map(phase + turn, light, down=False)).phase_std for turn in (0.0, 2.5)
    )
    np.testing.assert_allclose(turned, plain, rtol=1e-4)


def test_pixels_without_a_phase_stay_without_and_their_neighbours_keep_theirs() -> None:
    phase, light = seen(5.5)
    phases = phase_map(phase, light, down=False)
    holes = phases.phase.copy()
    holes[2, 5] = np.nan
    found = mixed(_map(holes, phases.modulation)).phase_std
    assert np.isfinite(found).all()
    assert found[2, 6] == pytest.approx(mixed(phases).phase_std[2, 6], rel=0.5)
