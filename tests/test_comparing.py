"""Two calibrations at the same points, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from board_series import C1, C2, PROJECTOR
from changed_rigs import moved_rig
from cv_lens import cv_project, cv_rays
from fringe3d.calibrate import compare_rigs
from fringe3d.errors import CalibrationError
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform

VOLUME = MeasuringVolume.box([-50, -50, 520], [50, 50, 620])
RIG = Rig(cameras=(C1, C2), projector=PROJECTOR, volume=VOLUME)
POINTS = np.random.default_rng(0).uniform([-50, -50, 520], [50, 50, 620], (5, 6, 3))


def test_the_same_calibration_moves_nothing_whatever_its_world() -> None:
    turn = RigidTransform(rotation=[[0, 1, 0], [-1, 0, 0], [0, 0, 1]], translation=[5, 6, 7])
    found = compare_rigs(moved_rig(RIG, turn), RIG, POINTS)
    assert found.devices == ("c1", "c2")
    assert found.moved_rms_mm < 1e-6
    assert found.form_rms_mm < 1e-6
    assert found.scale == pytest.approx(1)


def test_a_longer_distance_of_the_cameras_is_a_scale_and_no_form() -> None:
    pose = C2.device_from_world
    longer = RigidTransform(rotation=pose.rotation, translation=1.01 * pose.translation)
    former = replace(RIG, cameras=(C1, replace(C2, device_from_world=longer)))
    found = compare_rigs(former, RIG, POINTS)
    assert found.scale == pytest.approx(1.01)
    assert found.form_rms_mm < 1e-6
    np.testing.assert_allclose(found.moved_mm, 0.01 * POINTS, atol=1e-6)  # C1 is the origin


def test_another_lens_changes_the_form_as_rays_by_opencv_say() -> None:
    bent = replace(C1, distortion=C1.distortion + np.r_[0.02, np.zeros(13)])
    found = compare_rigs(replace(RIG, cameras=(bent, C2)), RIG, POINTS)
    o1, d1 = cv_rays(bent, cv_project(C1, POINTS))
    o2, d2 = cv_rays(C2, cv_project(C2, POINTS))
    expected = np.empty_like(POINTS)
    for place in np.ndindex(POINTS.shape[:2]):
        a = np.stack([d1[place], -d2[place]], axis=1)
        t1, t2 = np.linalg.lstsq(a, o2 - o1, rcond=None)[0]
        expected[place] = (o1 + t1 * d1[place] + o2 + t2 * d2[place]) / 2 - POINTS[place]
    np.testing.assert_allclose(found.moved_mm, expected, atol=1e-5)
    assert 1e-3 < found.form_rms_mm < found.moved_rms_mm


def test_points_not_seen_and_other_rigs() -> None:
    points = POINTS.copy()
    points[0] = np.nan
    found = compare_rigs(RIG, RIG, points)
    assert np.isnan(found.moved_mm[0]).all()
    assert np.isfinite(found.moved_mm[1:]).all()
    with pytest.raises(CalibrationError, match="another device of the same names"):
        compare_rigs(Rig(cameras=(replace(C1, name="left"),)), RIG, POINTS)
    small = Device(
        name="c1", role="camera", n_rows=480, n_cols=640, focal_px=[800, 800], center_px=[320, 240]
    )
    with pytest.raises(CalibrationError, match="'c1' has 1280 x 1024 pixels, formerly 640 x 480"):
        compare_rigs(Rig(cameras=(small, C2)), RIG, POINTS)
    with pytest.raises(CalibrationError, match="expected points that both devices see"):
        compare_rigs(RIG, RIG, np.full((3, 3), np.nan))
