"""Uncertainty of points from the calibration, in the files of a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from closed_form import Recording
from fringe3d.model import Rig, RigCovariance
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import measure
from fringe3d.report.folder import write_result

SHIFT_PX = 0.05


def test_results_hold_what_the_calibration_leaves_uncertain(
    rig: Rig, recording: Recording, tmp_path: Path
) -> None:
    """Only the principal point of C2 is uncertain: measured again with it moved, points move.

    Moved by one standard deviation they go by one sigma along their rays, but for where the
    midpoint between both rays lies and the noise of single pixels: 3 % in the median.
    """
    scan = recording[0]
    doubt = RigCovariance(names=("c2.cx",), matrix=np.array([[SHIFT_PX**2]]))
    doubtful = replace(scan, rig=replace(rig, covariance=doubt))
    options = MeasureOptions(method="m1")
    result = measure(doubtful, options)
    write_result(tmp_path / "out", doubtful, options, result)
    with np.load(tmp_path / "out/points.npz") as maps:
        sigma, center = maps["sigma_calibration_mm"], maps["camera_center_mm"]
    second = rig.cameras[1]
    moved = replace(second, center_px=np.add(second.center_px, (SHIFT_PX, 0)))
    again = measure(replace(scan, rig=replace(rig, cameras=(rig.cameras[0], moved))), options)
    assert result.points is not None
    assert again.points is not None
    both = result.points.is_valid & again.points.is_valid
    np.testing.assert_array_equal(np.isfinite(sigma), result.points.is_valid)
    rays = result.points.points_mm[both] - center
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    gone = (again.points.points_mm - result.points.points_mm)[both]
    along = np.abs((gone * rays).sum(axis=1))
    assert np.median(along / sigma[both]) == pytest.approx(1, abs=0.03)
    cloud: Any = trimesh.load(tmp_path / "out/cloud.ply")
    written = cloud.metadata["_ply_raw"]["vertex"]["data"]["sigma_calibration_mm"]
    np.testing.assert_array_equal(written.ravel(), sigma[np.isfinite(sigma)])
