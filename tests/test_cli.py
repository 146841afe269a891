"""The commands do what their help says, on small recordings."""

from __future__ import annotations

import json
import shlex
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure

from closed_form import Recording
from fringe3d.cli import main
from fringe3d.io.images import read_image
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import Rejection
from fringe3d.patterns import pattern_image


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
    assert {"points.npz", "cloud.ply", "overview.png", "measure.toml", "rig.toml"} == {
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


def test_the_record_tells_how_to_repeat_the_measurement(
    scan_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths as typed, also with a space; the recorded command gives the same cloud."""
    monkeypatch.chdir(tmp_path)
    shutil.move(scan_folder / "rig.toml", "my rig.toml")
    typed = ["measure", "scan/scan.toml", "--images", "scan", "--rig", "my rig.toml", "--out", "a"]
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/fringe3d", *typed])
    main(typed)
    request = tomllib.loads(Path("a/measure.toml").read_text())["request"]
    assert request == {
        "command": "fringe3d measure scan/scan.toml --images scan --rig 'my rig.toml' --out a",
        "scan": "scan/scan.toml",
        "images": "scan",
        "rig": "my rig.toml",
    }
    main([*shlex.split(request["command"])[1:-1], "b"])
    assert Path("a/cloud.ply").read_bytes() == Path("b/cloud.ply").read_bytes()


def test_the_same_scan_gives_the_same_bytes(scan_folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        main(["measure", str(scan_folder), "--out", str(tmp_path / name)])
    assert (tmp_path / "a/cloud.ply").read_bytes() == (tmp_path / "b/cloud.ply").read_bytes()


def test_demo_is_close_to_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["demo", "--out", str(tmp_path / "demo")])
    said = capsys.readouterr().out
    median_um = float(said.split("median ")[2].split(" um")[0])
    wrong = float(said.split("95 % below")[1].split("um, ")[1].split("%")[0])
    # 0.67 sigma of 11 um is 7.4 um; pixels on edges mix the light of two surfaces.
    assert 7 < median_um < 10
    assert wrong < 0.6
    assert (tmp_path / "demo/result/overview.png").is_file()
    assert (tmp_path / "demo/result/report.html").is_file()


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


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Return the list that every picture drawn from now on is added to."""
    drawn: list[Figure] = []
    save = Figure.savefig

    def keep(self: Figure, path: Path) -> None:
        save(self, path)
        drawn.append(self)

    monkeypatch.setattr(Figure, "savefig", keep)
    return drawn


def test_overview_shows_the_wrapped_phase_as_defined_and_hides_no_pixel(
    scan_folder: Path, tmp_path: Path, figures: list[Figure]
) -> None:
    main(["measure", str(scan_folder), "--out", str(tmp_path / "result")])
    panels = {axis.get_title(loc="left"): axis for axis in figures[0].axes}
    phase = panels["wrapped phase, rad"].images[0]
    values = phase.get_array()
    assert values is not None
    shown = np.ma.masked_invalid(values)
    assert phase.get_clim() == (-np.pi, np.pi)
    assert -np.pi < shown.min() < -3.1
    assert 3.1 < shown.max() <= np.float32(np.pi)
    assert phase.colorbar is not None
    labels = [label.get_text() for label in phase.colorbar.ax.get_yticklabels()]
    assert labels == ["\N{MINUS SIGN}\N{GREEK SMALL LETTER PI}", "0", "\N{GREEK SMALL LETTER PI}"]
    reasons = next(axis for title, axis in panels.items() if title.startswith("rejected"))
    legend = reasons.get_legend()
    assert legend is not None
    assert not legend.get_window_extent().overlaps(reasons.get_window_extent())
    whole = figures[0].bbox
    assert whole.contains(*legend.get_window_extent().min)
    assert whole.contains(*legend.get_window_extent().max)


def test_every_tile_of_the_contact_sheet_has_a_frame(tmp_path: Path, figures: list[Figure]) -> None:
    """Light is white on a white sheet; places without an image stay empty."""
    main(["patterns", "--size", "96x64", "--period", "16", "--light-dark", "--gray", "none",
          "--direction", "xy", "--out", str(tmp_path / "patterns")])  # fmt: skip
    sheet = figures[0]
    assert [axis.get_visible() for axis in sheet.axes] == [True] * 10 + [False] * 2
    for axis in sheet.axes[:10]:
        assert axis.axison
        assert all(spine.get_visible() for spine in axis.spines.values())


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
