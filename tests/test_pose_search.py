"""The second camera turned until the orders fit: in which direction, and how certain it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from board_series import device
from closed_phases import small_rig
from fringe3d import pose_search
from fringe3d.correspond import DOUBT, Rivals, Solution, epipolar_direction
from fringe3d.model import CalibrationBias, RigidTransform
from fringe3d.pose_search import Fit, fit_turned

BIAS = CalibrationBias(coefficients_px=np.zeros((2, 9)), middle=np.zeros(3), scale=np.ones(3))


@pytest.mark.parametrize(("place", "way"), [((-80, 0, 0), (-1, 0)), ((0, 60, 0), (0, 1))])
def test_parallel_cameras_have_an_epipolar_direction(
    place: tuple[float, float, float], way: tuple[float, float]
) -> None:
    """A point that moves away comes nearer to the image of infinity, that of C1's own pixel."""
    lens = ([900, 900], [320, 256], [0, 0, 0, 0])
    c1, c2 = (device(name, "camera", (640, 512), *lens) for name in ("c1", "c2"))
    pose = RigidTransform(rotation=np.eye(3), translation=place)
    moved = replace(c2, device_from_world=pose)
    found = epipolar_direction(c1, moved, np.array([[320.0, 256.0], [100.0, 400.0]]), 300.0)
    np.testing.assert_allclose(found, -np.array(way), atol=1e-9)


def solution(order: int, energy: float) -> Solution:
    return Solution(BIAS, (np.full(100, order, np.int32),), energy)


def test_a_rival_counts_once_however_many_turns_lead_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The best at one turn; one and the same rival at all others, and a third beside it."""
    rig, energies = small_rig(), iter([3.0, 2.0, 0.0, 1.0, 4.0] + [5.0] * 6)

    def fit(*_: Any) -> Fit:
        energy = next(energies)
        found = [solution(0 if energy == 0 else 1, energy)]
        found += [solution(2, 6.0)] if energy == 3 else []
        return Fit(rig, Rivals((), tuple(found), np.ones(len(found))), 1.0)

    monkeypatch.setattr(pose_search, "fit_as_it_is", fit)
    monkeypatch.setattr(pose_search, "_turned", lambda rig, *_: rig)
    assert rig.volume is not None
    best = fit_turned([[]], rig, rig.volume)
    assert best is not None
    odds = np.exp(-1.0 / DOUBT) + np.exp(-6.0 / DOUBT)
    assert best.certainty == pytest.approx(1 / (1 + odds))
