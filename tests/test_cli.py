"""The commands do what their help says, on small recordings."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from fringe3d.cli import main
from fringe3d.io.images import read_image
from fringe3d.io.rigfile import read_rig
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import Rejection, Rig, Scan
from fringe3d.patterns import pattern_image
from fringe3d.simulate import Truth

Recording = tuple[Scan, tuple[Truth, ...]]


@pytest.fixture
def scan_folder(recording: Recording, tmp_path: Path) -> Path:
    folder = tmp_path / "scan"
    write_scan(folder, recording[0])
    return folder


def test_measure_leaves_what_the_docs_list(
    scan_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "result"
    main(["measure", str(scan_folder), "--out", str(out)])
    assert {"points.npz", "cloud.ply", "overview.png", "measure.toml"} == {
        path.name for path in out.iterdir()
    }
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert "points of 81,920 pixels by method m1" in line
    with np.load(out / "points.npz") as maps:
        good = maps["rejection"] == 0
        assert maps["points_mm"].shape == (256, 320, 3)
        assert (np.isfinite(maps["points_mm"]).all(axis=-1) == good).all()
        assert list(maps["rejection_names"]) == [reason.name for reason in Rejection]
        points = maps["points_mm"][good]
    cloud = trimesh.load(out / "cloud.ply")
    assert isinstance(cloud, trimesh.PointCloud)
    # Single precision in the file: 6e-8 of 20 mm.
    np.testing.assert_allclose(np.asarray(cloud.vertices), points, atol=1e-5)


def test_measure_prints_json(
    scan_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["measure", str(scan_folder), "--out", str(tmp_path / "r"), "--json", "--shifts", "3"])
    record = json.loads(capsys.readouterr().out)
    assert record["method"] == "m1"
    assert record["options"]["n_shifts"] == 3
    pixels = record["pixels"]
    assert pixels["total"] == pixels["accepted"] + sum(pixels["rejected"].values())


def test_the_same_scan_gives_the_same_bytes(scan_folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        main(["measure", str(scan_folder), "--out", str(tmp_path / name)])
    assert (tmp_path / "a/cloud.ply").read_bytes() == (tmp_path / "b/cloud.ply").read_bytes()


def test_demo_is_close_to_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["demo", "--out", str(tmp_path / "demo")])
    said = capsys.readouterr().out
    median_um = float(said.split("median ")[2].split(" um")[0])
    # 0.67 sigma of 9 um is 6 um.
    assert 5 < median_um < 8
    assert (tmp_path / "demo/result/overview.png").is_file()


def foreign_folder(recording: Recording, folder: Path) -> None:
    """Write the recording as another program would: 1-based names, BMP."""
    scan = recording[0]
    for stack, name in zip(scan.stacks, ("left", "right"), strict=True):
        (folder / name).mkdir(parents=True)
        for index, image in enumerate(stack.images):
            assert cv2.imwrite(str(folder / name / f"shot{index + 1}.bmp"), image)


def write_calibration(rig: Rig, path: Path) -> None:
    """Write the stereo pair as OpenCV would: X_right = R X_left + T."""
    left, right = rig.cameras
    pose = right.device_from_world @ left.device_from_world.inverse()
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        ("M1", left.camera_matrix),
        ("D1", left.distortion[:5].reshape(1, 5)),
        ("M2", right.camera_matrix),
        ("D2", right.distortion[:5].reshape(1, 5)),
        ("R", pose.rotation),
        ("T", pose.translation.reshape(3, 1)),
    ):
        storage.write(key, value)
    storage.release()


def test_import_describes_a_recording_of_other_software(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = recording[0]
    assert scan.rig is not None
    folder = tmp_path / "images"
    foreign_folder(recording, folder)
    write_calibration(scan.rig, tmp_path / "stereo.yml")
    main(
        [
            "import", str(folder), "--camera", "c1=left/shot{index}.bmp@1",
            "--camera", "c2=right/shot{index}.bmp@1",
            "--sequence", "fringes period_px=16 n_shifts=4",
            "--sequence", "gray cell_px=8 n_bits=7", "--projector-size", "1024x768",
            "--calibration", str(tmp_path / "stereo.yml"), "--depth", "310:370",
        ]
    )  # fmt: skip
    said = capsys.readouterr().out
    assert "by method m1" in said
    assert "texture of both cameras agrees" in said
    rig = read_rig(folder / "rig.toml")
    expected = scan.rig.cameras[1].device_from_world @ (
        scan.rig.cameras[0].device_from_world.inverse()
    )
    np.testing.assert_allclose(
        expected.translation, rig.cameras[1].device_from_world.translation, atol=1e-9
    )
    main(["measure", str(folder), "--out", str(tmp_path / "result")])
    assert (tmp_path / "result" / "cloud.ply").is_file()


def test_import_says_so_when_the_pose_is_inverted(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = recording[0]
    assert scan.rig is not None
    folder = tmp_path / "images"
    foreign_folder(recording, folder)
    write_calibration(scan.rig, tmp_path / "stereo.yml")
    arguments = [
        "import", str(folder), "--camera", "c1=left/shot{index}.bmp@1",
        "--camera", "c2=right/shot{index}.bmp@1",
        "--sequence", "fringes period_px=16 n_shifts=4",
        "--sequence", "gray cell_px=8 n_bits=7", "--projector-size", "1024x768",
        "--calibration", str(tmp_path / "stereo.yml"), "--inverse-pose",
    ]  # fmt: skip
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert "the calibration" in capsys.readouterr().err


def test_measure_finds_the_images_below_or_beside_the_named_folder(
    recording: Recording, tmp_path: Path
) -> None:
    inner = tmp_path / "data" / "set" / "run"
    write_scan(inner, recording[0])
    text = (inner / "scan.toml").read_text()
    for name in ("scan.toml", "rig.toml"):
        shutil.move(inner / name, tmp_path / name)
    (tmp_path / "scan.toml").write_text('folder = "set/run"\n' + text)
    for number, base in enumerate((inner, inner.parent, inner.parent.parent)):
        out = tmp_path / f"out{number}"
        main(["measure", str(tmp_path / "scan.toml"), "--images", str(base), "--out", str(out)])
        assert (out / "cloud.ply").is_file()


def test_patterns_are_the_plan_sampled_at_pixel_centres(tmp_path: Path) -> None:
    from fringe3d.io.scanfile import read_plan

    out = tmp_path / "patterns"
    main(
        ["patterns", "--size", "96x64", "--period", "10.5", "--steps", "5", "--angle", "30",
         "--bits", "16", "--out", str(out)]
    )  # fmt: skip
    plan = read_plan(out / "plan.toml")
    for index, pattern in enumerate(plan.patterns):
        expected = pattern_image(pattern, (64, 96), bit_depth=16)
        found = read_image(out / f"{index:03d}.png")
        assert found.dtype == np.uint16
        # Degrees in the file round the angle and the shift by 1e-16.
        assert np.abs(expected.astype(int) - found).max() <= 1


def test_import_asks_where_nothing_is_given(
    recording: Recording,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An empty answer takes the proposal, which knows names and first numbers of the files."""
    write_scan(tmp_path / "mine", recording[0])
    shutil.move(tmp_path / "mine" / "rig.toml", tmp_path / "rig.toml")
    (tmp_path / "mine" / "scan.toml").unlink()
    answers = iter(["", "", "", "fringes period_px=16 n_shifts=4", "gray cell_px=8 n_bits=7", ""])
    monkeypatch.setattr("builtins.input", lambda *_: next(answers))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    main(["import", str(tmp_path / "mine"), "--rig", str(tmp_path / "rig.toml")])
    assert "by method m1" in capsys.readouterr().out
    assert next(answers, "all asked") == "all asked"
