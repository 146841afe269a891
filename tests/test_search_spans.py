"""What the search along epipolar curves skips: nothing that it would find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closed_form import Recording
from fringe3d.correspond import stereo
from fringe3d.correspond.stereo import spans_of
from fringe3d.pipeline import MeasureOptions, measure


def test_spans_hold_the_phases_between_neighbours_and_no_others() -> None:
    """A plane of phases over many periods, by its formula, at random places between pixels."""
    rise = 0.7, -0.4

    def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.3 + rise[0] * x + rise[1] * y

    y, x = np.mgrid[:30, :40].astype(float)
    phase = (plane(x, y) % (2 * np.pi)).astype(np.float32)
    middle, half = np.moveaxis(spans_of(phase)[:-1, :-1].astype(float), -1, 0)
    rng = np.random.default_rng(1)
    inside = plane(x + rng.random(x.shape), y + rng.random(x.shape))[:-1, :-1]
    away = np.angle(np.exp(1j * (inside - middle)))
    assert (np.abs(away) <= half).all()
    np.testing.assert_allclose(half, (abs(rise[0]) + abs(rise[1])) / 2, atol=1e-4)
    corners = np.angle(np.exp(1j * (plane(x + 1, y)[:-1, :-1] - middle)))  # the highest of four
    np.testing.assert_allclose(corners, half, atol=1e-4)


def test_holes_and_jumps_are_told() -> None:
    phase = np.zeros((4, 5), np.float32)
    phase[1, 1], phase[2, 3] = np.nan, 2.5  # one missing neighbour is continued; 2 rad are a jump
    half = spans_of(phase)[..., 1]
    assert np.isinf(half[:2, :2]).all()
    assert (half[1:3, 2:4] < 0).all()
    assert (half[-1] < 0).all()
    assert (half[:, -1] < 0).all()


@pytest.mark.parametrize("gray_bits", [None, 4])
def test_nothing_is_skipped_that_would_be_found(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, gray_bits: int | None
) -> None:
    """Two cameras alone; against the search that looks closely everywhere."""
    scan = recording[0]
    assert scan.rig is not None
    alone = replace(scan, rig=replace(scan.rig, projector=None))
    options = MeasureOptions(gray_bits=gray_bits)
    found = measure(alone, options).points

    def everywhere(phase: np.ndarray) -> np.ndarray:
        spans = np.zeros((*phase.shape, 2), np.float32)
        spans[..., 1] = np.inf
        spans[-1, :, 1] = spans[:, -1, 1] = -1  # there are no four neighbours
        return spans

    monkeypatch.setattr(stereo, "spans_of", everywhere)
    expected = measure(alone, options).points
    assert found is not None
    assert expected is not None
    assert expected.n_points > 10_000
    np.testing.assert_array_equal(found.rejection, expected.rejection)
    np.testing.assert_array_equal(found.points_mm, expected.points_mm)
