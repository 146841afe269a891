"""Points of two cameras and the projector: truer than those of the cameras, and never less true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import Recording, SphereScene, record_scene
from fringe3d.errors import MethodError
from fringe3d.model import Rig
from fringe3d.pipeline import Measurement, MeasureOptions, measure

Floats = NDArray[np.float64]

CAMERAS = MeasureOptions(method="m1", blur_px=None)
"""The pixels of these images are points."""

BEST = replace(CAMERAS, best_estimate=True)


@pytest.fixture(scope="module")
def plain(recording: Recording) -> Measurement:
    return measure(recording[0], CAMERAS)


def errors(result: Measurement, rig: Rig, recording: Recording) -> tuple[Floats, Floats]:
    """Return errors along the rays, mm, and over sigma."""
    assert result.points is not None
    true = recording[1][0].points_mm
    away = true - rig.cameras[0].center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    good = result.points.is_valid
    off = ((result.points.points_mm - true) * away).sum(axis=-1)[good]
    return off, off / result.points.sigma_mm[good]


def spread(values: Floats) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def moved(scan_rig: Rig, shift_px: float) -> Rig:
    projector = scan_rig.projector
    assert projector is not None
    center_px = np.add(projector.center_px, (shift_px, 0.0))
    return replace(scan_rig, projector=replace(projector, center_px=center_px))


def test_points_of_all_three_are_truer_and_sigma_is_true(
    plain: Measurement, rig: Rig, recording: Recording
) -> None:
    """The same noise with and without the projector: both spreads share it, so that a part in a
    thousand is told apart."""
    best = measure(recording[0], BEST)
    before, pull_before = errors(plain, rig, recording)
    after, pull_after = errors(best, rig, recording)
    assert spread(after) < 0.999 * spread(before)
    assert spread(pull_after) == pytest.approx(spread(pull_before), abs=0.03)
    assert abs(np.median(after)) < 0.05 * spread(after)
    assert plain.points is not None
    assert best.points is not None
    np.testing.assert_array_equal(plain.points.rejection, best.points.rejection)
    good = best.points.is_valid
    assert (best.points.sigma_mm[good] <= plain.points.sigma_mm[good] * (1 + 1e-5)).all()


@pytest.mark.parametrize("shift_px", [0.3, -0.3])
def test_a_projector_that_is_off_does_no_harm(
    shift_px: float, rig: Rig, recording: Recording
) -> None:
    """0.3 px of 16 px are 0.12 rad, fifteen times the noise: by inverse variances alone the points
    would be moved by several sigma."""
    wrong = replace(recording[0], rig=moved(rig, shift_px))
    before, _ = errors(measure(wrong, CAMERAS), rig, recording)
    after, pull = errors(measure(wrong, BEST), rig, recording)
    assert spread(after) <= 1.002 * spread(before)
    assert np.quantile(np.abs(after), 0.95) <= 1.01 * np.quantile(np.abs(before), 0.95)
    assert abs(np.median(after)) < 0.05 * spread(after)
    assert spread(pull) < 1.1


def test_points_stay_on_their_rays(plain: Measurement, rig: Rig, recording: Recording) -> None:
    best = measure(recording[0], BEST)
    assert plain.points is not None
    assert best.points is not None
    good = best.points.is_valid
    origin = rig.cameras[0].center_world
    one, two = (p.points_mm[good] - origin for p in (plain.points, best.points))
    off = np.linalg.norm(np.cross(one, two), axis=1) / np.linalg.norm(one, axis=1)
    assert off.max() < 1e-9


def test_without_a_second_camera_or_a_projector_it_is_refused(recording: Recording) -> None:
    scan = recording[0]
    assert scan.rig is not None
    with pytest.raises(MethodError, match=r"--best-estimate.*one camera"):
        measure(scan, replace(BEST, method="projector"))
    with pytest.raises(MethodError, match=r"--best-estimate.*no projector"):
        measure(replace(scan, rig=replace(scan.rig, projector=None)), replace(BEST, method="auto"))


def test_a_second_direction_helps_where_it_crosses_the_rays(rig: Rig) -> None:
    """Its noise is its own; here it runs nearly along them and must at least do no harm."""
    recording = record_scene(rig, SphereScene(), seed=5, angles=(0.0, np.pi / 2))
    off, _ = errors(measure(recording[0], CAMERAS), rig, recording)
    best, pull = errors(measure(recording[0], BEST), rig, recording)
    assert spread(best) < 1.002 * spread(off)
    assert spread(pull) == pytest.approx(1, abs=0.12)
