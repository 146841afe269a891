"""Rigs for other software: read back by OpenCV itself, and by the import."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from board_series import C1, C2, PROJECTOR
from changed_rigs import moved_device
from cv_lens import cv_project
from fringe3d.cli.run import main
from fringe3d.io.opencv_calibration import read_opencv_calibration
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Device, Rig, RigidTransform

STRONG = replace(C2, distortion=np.array([-0.1, 0.1, 1e-3, -1e-3, 0.02, 0.01, -0.02, 0.003]))
ANY_FRAME = RigidTransform(rotation=cv2.Rodrigues(np.array([0.3, -0.2, 1.0]))[0],
                           translation=[10.0, -20.0, 30.0])  # fmt: skip
POINTS = np.random.default_rng(0).uniform([-60, -60, 520], [60, 60, 620], (40, 3))

PAIRS = {
    "c1,c2": (C1, STRONG, ("M1", "D1", "M2", "D2", "R", "T")),
    "c1,projector": (C1, PROJECTOR, ("cam_K", "cam_kc", "pro_K", "pro_kc", "R", "T")),
}


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """Return a rig whose first camera is not the origin."""
    devices = [moved_device(device, ANY_FRAME) for device in (C1, STRONG, PROJECTOR)]
    path = tmp_path / "rig.toml"
    rig = Rig(cameras=(devices[0], devices[1]), projector=devices[2])
    path.write_text(rig_text(rig), encoding="utf-8")
    return path


def same(found: Device, wanted: Device, of: Device, origin: Device) -> None:
    """Compare images of points, given in the frames of the first devices."""
    points = of.device_from_world.apply(POINTS)
    there = cv_project(found, origin.device_from_world.inverse().apply(points))
    np.testing.assert_allclose(there, cv_project(wanted, POINTS), atol=1e-6)


@pytest.mark.parametrize("form", [".yml", ".yaml", ".xml", ".json"])
@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("names", list(PAIRS))
def test_opencv_reads_what_was_exported(
    names: str, inverse: bool, form: str, rig_file: Path, tmp_path: Path
) -> None:
    first, second, keys = PAIRS[names]
    out = tmp_path / f"stereo{form}"
    main(["export", str(rig_file), "--out", str(out), "--devices", names]
         + ["--inverse-pose"] * inverse)  # fmt: skip
    storage = cv2.FileStorage(str(out), cv2.FILE_STORAGE_READ)
    m1, d1, m2, d2, rotation, translation = (storage.getNode(key).mat() for key in keys)
    if inverse:
        rotation, translation = rotation.T, -rotation.T @ translation
    in_first = first.device_from_world.apply(POINTS)
    in_second = in_first @ rotation.T + translation.ravel()
    for points, matrix, distortion, device in (
        (in_first, m1, d1, first), (in_second, m2, d2, second)
    ):  # fmt: skip
        pixels, _ = cv2.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, distortion)
        np.testing.assert_allclose(pixels.reshape(-1, 2), cv_project(device, POINTS), atol=1e-6)
    sizes = [(d.n_cols, d.n_rows) for d in (first, second)]
    is_camera = second.role == "camera"
    rig = read_opencv_calibration(
        out, camera_sizes=sizes if is_camera else sizes[:1],
        projector_size=None if is_camera else sizes[1], second_from_first=not inverse,
    )  # fmt: skip
    same(rig.devices[1], second, first, rig.devices[0])


def test_the_first_two_devices_are_taken(
    rig_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["export", str(rig_file), "--out", str(tmp_path / "stereo.yml")])
    assert "c1 and c2, R and T from c1 to c2 (mm)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--devices", "c1"), "--devices: expected two different names of c1, c2, projector"),
        (("--devices", "c1,c3"), "--devices: expected two different names"),
        (("--devices", "projector,c1"), "expected a camera as first device"),
        (("--out", "rig.csv"), "expected a name that ends in .yml, .yaml, .xml, .json"),
    ],
)
def test_mistakes_are_named(
    given: tuple[str, ...],
    said: str,
    rig_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    out = () if "--out" in given else ("--out", "stereo.yml")
    with pytest.raises(SystemExit):
        main(["export", str(rig_file), *out, *given])
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "stereo.yml").exists()
