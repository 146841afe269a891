"""``fringe3d simulate`` from the command line: its files, its truth, its messages.

Cameras are small, so fringes are wide (48 px): a period then covers nine camera pixels.
Whether the truth is true is tested in test_simulate_scene.
"""

from __future__ import annotations

import re
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.cli import main
from fringe3d.errors import MethodError
from fringe3d.io.images import read_image
from fringe3d.io.recording import read_scan
from fringe3d.io.rigfile import read_rig
from fringe3d.model import NO_ORDER

pytest.importorskip("embreex")
trimesh = pytest.importorskip("trimesh")

from fringe3d.cli.simulation_words import parse_tilts  # noqa: E402
from fringe3d.cli.simulator import HEAD, KINDS  # noqa: E402
from fringe3d.simulate import OBJECTS, PRESETS  # noqa: E402

Maps = dict[str, NDArray[Any]]
Capture = pytest.CaptureFixture[str]

SMALL = ("--object", "plane", "--camera-size", "160x128", "--period", "48")
TINY = ("--object", "plane", "--camera-size", "64x48", "--rays", "1")
"""For what does not depend on pixels."""

C1_KEYS = {
    "points_mm", "normals", "projector_xy", "pixels_c2", "fringe_order", "in_volume", "seen_by_c2",
    "lit", "is_object",
}  # fmt: skip
C2_KEYS = {
    "points_mm_c2", "normals_c2", "projector_xy_c2", "pixels_c1_c2", "fringe_order_c2",
    "in_volume_c2", "seen_by_c1_c2", "lit_c2", "is_object_c2",
}  # fmt: skip
JARGON = r"Input should|validation error|Traceback|NoneType|\w+Error|pydantic|\[Errno|object has no"


def simulate(out: Path, *arguments: str, preset: str = "kolibri") -> Path:
    """Run the command; return its folder."""
    main(["simulate", preset, "--out", str(out), *arguments])
    return out


def truth_of(scan: Path) -> Maps:
    with np.load(scan / "truth.npz") as maps:
        return dict(maps)


def contents(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder, by their names."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def refused(capsys: Capture, folder: Path, *arguments: str) -> str:
    """Run a command that must fail with one line and leave the folder as it is; return the line."""
    before = contents(folder), sorted(folder.rglob("*"))
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(["simulate", *arguments])
    printed = capsys.readouterr()
    assert ended.value.code == 2, printed.err
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1, printed.err
    assert not re.search(JARGON, printed.err), printed.err
    assert before == (contents(folder), sorted(folder.rglob("*")))
    return printed.err.removeprefix("error: ").strip()


@pytest.fixture(scope="session")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a scan of a plane on `kolibri`, not to be changed."""
    return simulate(tmp_path_factory.mktemp("simulate") / "scan", *SMALL, "--seed", "5")


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the drawing of overviews, half the time of a tiny scan."""

    def touch(path: Path, *_stage_and_plan: object, title: str) -> None:
        path.write_text(title)

    monkeypatch.setattr("fringe3d.cli.simulator.draw_scene", touch)


# Files


def test_simulate_leaves_what_its_help_lists(tmp_path: Path, capsys: Capture) -> None:
    scan = simulate(tmp_path / "deep" / "scan", *TINY)
    printed = capsys.readouterr()
    assert printed.out == (f"a scan of 13 images, 2 camera(s) 64 x 48 px, with truth -> {scan}\n")
    assert printed.err == ""
    pictures = {f"c{camera}/{index:03d}.png" for camera in (1, 2) for index in range(13)}
    names = {"scan.toml", "rig.toml", "truth.npz", "simulation.toml", "overview.png"}
    assert set(contents(scan)) == names | pictures
    assert [path.name for path in scan.parent.iterdir()] == ["scan"]  # nothing half-written
    assert scan.stat().st_mode & 0o777 == 0o755


def test_truth_holds_the_promised_maps(scan: Path) -> None:
    maps = truth_of(scan)
    assert set(maps) == C1_KEYS | C2_KEYS | {"world_from_object"}
    shape = (128, 160)
    for key, values in maps.items():
        if key == "world_from_object":
            continue
        width = {"points_mm": 3, "normals": 3, "projector_xy": 2, "pixels_c2": 2, "pixels_c1": 2}
        last = width.get(key.removesuffix("_c2") if key != "pixels_c2" else key)
        assert values.shape == (shape if last is None else (*shape, last)), key
        assert values.dtype == {
            "normals": np.float32, "fringe_order": np.int32, "in_volume": bool, "lit": bool,
            "is_object": bool, "seen_by": bool, "seen_by_c1": bool,
        }.get(key.removesuffix("_c2"), np.float64), key  # fmt: skip
    pose = maps["world_from_object"]
    np.testing.assert_allclose(pose[:3, :3], np.eye(3))
    np.testing.assert_allclose(pose[:, 3], [0, 0, -13.5, 1])


def test_fringe_orders_count_the_periods_of_the_first_fringes(scan: Path) -> None:
    """From the edge of the projector: w = u + 1/2, order = floor(w / period)."""
    maps = truth_of(scan)
    for suffix in ("", "_c2"):
        w = maps[f"projector_xy{suffix}"][..., 0] + 0.5
        seen = np.isfinite(w)
        order = maps[f"fringe_order{suffix}"]
        np.testing.assert_array_equal(order[seen], np.floor(w[seen] / 48).astype(int))
        assert (order[~seen] == NO_ORDER).all()


def test_a_pixel_that_sees_nothing_has_no_order(tmp_path: Path) -> None:
    """As the conventions say of missing orders; -1 is an order beyond the projector's edge."""
    maps = truth_of(simulate(tmp_path / "scan", *TINY, "--background", "none"))
    nothing = np.isnan(maps["points_mm"]).any(axis=-1)
    assert nothing.mean() > 0.2
    assert (maps["fringe_order"][nothing] == NO_ORDER).all()
    for key in ("lit", "in_volume", "is_object", "seen_by_c2"):
        assert not maps[key][nothing].any()
    np.testing.assert_array_equal(maps["is_object"], ~nothing)


def test_measure_works_on_it_and_finds_the_truth(scan: Path, tmp_path: Path) -> None:
    main(["measure", str(scan), "--out", str(tmp_path / "result")])
    maps = truth_of(scan)
    with np.load(tmp_path / "result/points.npz") as result:
        points, accepted = result["points_mm"], result["rejection"] == 0
        order, pixels = result["fringe_order"], result["pixels_c2"]
    reference = maps["lit"] & maps["in_volume"] & maps["seen_by_c2"]
    both = accepted & reference
    assert both.sum() > 0.9 * reference.sum()
    # Six sigma of 34 um; in two pixels along the rim light of two surfaces mixes.
    close = np.linalg.norm(points - maps["points_mm"], axis=-1) < 0.2
    inner = cv2.erode(reference.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert close[both & inner].mean() > 0.999
    assert close[both].mean() > 0.95
    assert (order == maps["fringe_order"])[both].mean() > 0.99
    # A hundredth of a pixel of noise; what is seen through the lens is the truth's pixel.
    assert np.median(np.abs(pixels - maps["pixels_c2"])[both]) < 0.05


# The same bytes


def test_the_same_seed_gives_the_same_bytes_of_all_files(scan: Path, tmp_path: Path) -> None:
    again = simulate(tmp_path / "again", *SMALL, "--seed", "5")
    assert contents(scan) == contents(again)
    with zipfile.ZipFile(scan / "truth.npz") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_another_seed_gives_other_noise_and_the_same_truth(scan: Path, tmp_path: Path) -> None:
    first = contents(scan)
    second = contents(simulate(tmp_path / "other", *SMALL, "--seed", "6"))
    assert first.keys() == second.keys()
    for name in first:
        same = name in ("scan.toml", "rig.toml", "truth.npz")
        if name.startswith("c") or same or name == "simulation.toml":
            assert (first[name] == second[name]) == same, name
    pictures = [name for name in first if name.startswith("c")]
    assert len({first[name] for name in pictures}) == len(pictures)
    one, two = (
        np.stack([read_image(folder / name) for name in pictures]).astype(float)
        for folder in (scan, tmp_path / "other")
    )
    # EMVA 1288 with the default sensor: at most sqrt(10000) e of 10000 e is 2.5 DN.
    assert 0.3 < np.std(one - two) / np.sqrt(2) < 2.6
    assert abs(float(np.mean(one - two))) < 0.01
    # 13 images of 20,480 pixels: chance alone correlates the two cameras by 0.002.
    first_camera, second_camera = np.split(one - two, 2)
    assert abs(np.corrcoef(first_camera.ravel(), second_camera.ravel())[0, 1]) < 0.02


# Plans


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    ("plan", "n_images", "n_fringes"),
    [
        # 64 periods of 16 px: 7 bits with half periods; 48 periods in y: 7 bits; light and dark.
        ("m0", 24, 8),
        ("m1", 13, 4),
        ("m2", 10, 4),  # 3 bits and one
        ("m3", 4, 4),
        ("m4", 8, 8),
        ("m5", 4, 4),
        ("m6", 4, 4),
    ],
)
def test_plans_have_the_images_of_their_method(
    tmp_path: Path, plan: str, n_images: int, n_fringes: int
) -> None:
    folder = simulate(tmp_path / "scan", *TINY, "--plan", plan)
    recorded = read_scan(folder)
    assert [len(stack.images) for stack in recorded.stacks] == [n_images, n_images]
    sets = recorded.stacks[0].plan.fringe_sets
    assert sum(len(fringes.shifts) for fringes in sets) == n_fringes
    assert len(list((folder / "c2").iterdir())) == n_images


@pytest.mark.usefixtures("without_pictures")
def test_steps_and_period_are_those_asked_for(tmp_path: Path) -> None:
    plan = ("--plan", "m3", "--steps", "5", "--period", "20")
    recorded = read_scan(simulate(tmp_path / "scan", *TINY, *plan))
    (fringes,) = recorded.stacks[0].plan.fringe_sets
    assert len(fringes.shifts) == 5
    assert fringes.period_px == 20.0


@pytest.mark.usefixtures("without_pictures")
def test_a_plan_of_the_patterns_command_is_projected(tmp_path: Path) -> None:
    patterns = tmp_path / "patterns"
    main(["patterns", "--size", "1024x768", "--period", "40", "--steps", "3", "--direction", "y",
          "--out", str(patterns)])  # fmt: skip
    folder = simulate(tmp_path / "scan", *TINY, "--plan", str(patterns / "plan.toml"))
    assert len(read_scan(folder).stacks[0].images) == len(list(patterns.glob("0*.png")))
    maps = truth_of(folder)
    seen = np.isfinite(maps["projector_xy"]).all(axis=-1)
    expected = np.floor((maps["projector_xy"][seen][:, 1] + 0.5) / 40).astype(int)
    np.testing.assert_array_equal(maps["fringe_order"][seen], expected)


def test_a_plan_without_fringes_has_no_orders(tmp_path: Path) -> None:
    patterns = tmp_path / "patterns"
    main(["patterns", "--size", "1024x768", "--period", "64", "--steps", "0", "--out",
          str(patterns)])  # fmt: skip
    folder = simulate(tmp_path / "scan", *TINY, "--plan", str(patterns / "plan.toml"))
    assert set(truth_of(folder)) == (C1_KEYS | C2_KEYS | {"world_from_object"}) - {
        "fringe_order", "fringe_order_c2",
    }  # fmt: skip


# Settings


def test_settings_change_what_they_name_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "sensor.toml"
    file.write_text("[camera]\nbit_depth = 12\nblack_level_dn = 60\nexposure = 0.2\n")
    folder = simulate(tmp_path / "scan", *TINY, "--settings", str(file))
    written = tomllib.loads((folder / "simulation.toml").read_text())
    assert [*written] == ["preset", "object", "plan", "seed", "position", "steps", "camera_size",
                          "background", "rays", *KINDS]  # fmt: skip
    assert written["camera"]["bit_depth"] == 12
    assert written["camera"]["read_noise_e"] == 12.0
    assert written["surface"]["albedo"] == 0.8
    stack = read_scan(folder).stacks[0]
    assert stack.images.dtype == np.uint16
    assert stack.saturation_dn == 4095
    assert stack.black_level_dn == 60
    # A fifth of the full well for white paper, the surface is darker.
    assert 255 < stack.images.max() < 60 + 0.25 * 4095


def test_the_record_of_a_scan_can_be_given_as_settings(scan: Path, tmp_path: Path) -> None:
    """Its tables are used; what it says about the command line is not."""
    file = tmp_path / "again.toml"
    text = (scan / "simulation.toml").read_text()
    assert set(tomllib.loads(text)) == {*HEAD, *KINDS} - {
        "knock",
        "axis_off",
        "angle_error_deg",
    }  # none given
    file.write_text(text.replace("exposure = 0.8", "exposure = 0.4"))
    again = simulate(tmp_path / "again", *TINY, "--seed", "9", "--settings", str(file))
    written = tomllib.loads((again / "simulation.toml").read_text())
    assert written["camera"]["exposure"] == 0.4
    assert written["seed"] == 9
    assert written["camera_size"] == [64, 48]

    same = simulate(tmp_path / "same", *SMALL, "--seed", "5", "--settings",
                    str(scan / "simulation.toml"))  # fmt: skip
    assert contents(scan) == contents(same)


def test_dropped_images_are_missing_at_the_end(tmp_path: Path, capsys: Capture) -> None:
    """Later ones move up, as a camera that misses a trigger leaves them; measure says so."""
    file = tmp_path / "drop.toml"
    file.write_text("[recording]\ndropped = [2, 7, 2]\n[camera]\nread_noise_e = 0.0\n")
    folder = simulate(tmp_path / "scan", *TINY, "--settings", str(file))
    for camera in ("c1", "c2"):
        names = sorted(path.name for path in (folder / camera).iterdir())
        assert names == [f"{index:03d}.png" for index in range(11)]
    full = simulate(tmp_path / "full", *TINY)
    kept = [index for index in range(13) if index not in (2, 7)]
    for place, index in enumerate(kept):
        found = read_image(folder / f"c1/{place:03d}.png").astype(float)
        assert np.abs(found - read_image(full / f"c1/{index:03d}.png")).mean() < 2.5
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(["measure", str(folder), "--out", str(tmp_path / "result")])
    assert ended.value.code == 2
    assert "index 11, 12 are missing" in capsys.readouterr().err
    assert not (tmp_path / "result").exists()


@pytest.mark.usefixtures("without_pictures")
def test_a_repeated_image_shows_the_pattern_before(tmp_path: Path) -> None:
    file = tmp_path / "repeat.toml"
    file.write_text("[recording]\nrepeated = [2]\n")
    first = simulate(tmp_path / "scan", *TINY, "--settings", str(file))
    second = simulate(tmp_path / "full", *TINY)
    images, full = (
        np.stack([read_image(folder / f"c1/{i:03d}.png") for i in range(13)]).astype(float)
        for folder in (first, second)
    )
    change = np.abs(images - full).mean(axis=(1, 2))
    assert [i for i in range(13) if change[i] > 5] == [2]
    assert np.abs(images[2] - full[1]).mean() < 2.5

    # The place that repeats an image stays when that image is dropped.
    file.write_text("[recording]\nrepeated = [2]\ndropped = [1]\n")
    third = simulate(tmp_path / "both", *TINY, "--settings", str(file))
    assert len(list((third / "c1").iterdir())) == 12
    for place, index in ((0, 0), (1, 1), (2, 3)):
        found = read_image(third / f"c1/{place:03d}.png").astype(float)
        assert np.abs(found - full[index]).mean() < 2.5


# Series, rigs, objects


@pytest.mark.usefixtures("without_pictures")
def test_a_turntable_gives_a_scan_for_each_position_and_tilt(
    tmp_path: Path, capsys: Capture
) -> None:
    series = simulate(tmp_path / "series", *TINY, "--positions", "3", "--tilts", "0,20",
                      "--plan", "m3")  # fmt: skip
    assert "6 scans of 4 images" in capsys.readouterr().out
    names = [f"{number:03d}" for number in range(6)]
    assert sorted(path.name for path in series.iterdir()) == [*names, "overview.png"]
    poses = []
    for number, name in enumerate(names):
        maps = truth_of(series / name)
        poses.append(maps["world_from_object"])
        record = tomllib.loads((series / name / "simulation.toml").read_text())
        assert (record["seed"], record["position"]) == (0, number)
        assert len(read_scan(series / name).stacks) == 2
        # The top of the disc, 4 mm high before it was scaled, in the object's own frame.
        own = (np.linalg.inv(poses[-1]) @ np.append(maps["points_mm"], np.ones((48, 64, 1)), -1)[
            ..., None])[..., :3, 0]  # fmt: skip
        top = maps["is_object"] & (maps["normals"] @ poses[-1][:3, 2] > 0.999)
        assert top.sum() > 300
        np.testing.assert_allclose(own[top][:, 2], 4.0, atol=1e-6)
    for first in (0, 3):
        for k in range(3):
            turn = poses[first + k][:3, :3] @ poses[first][:3, :3].T
            angle = 2 * np.pi * k / 3
            expected = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0],
                        [0, 0, 1]]  # fmt: skip
            np.testing.assert_allclose(turn, expected, atol=1e-12)
    lean = np.degrees(np.arccos(poses[3][2, 2]))
    assert lean == pytest.approx(20.0)


@pytest.mark.usefixtures("without_pictures")
def test_a_leaning_axis_moves_the_object_by_its_turns_alone(tmp_path: Path) -> None:
    """The true poses are turns about the true axis by the angles of scan.toml, and their errors."""
    more = ("--positions", "3", "--plan", "m3", "--axis-off", "4mm:3deg")
    for name, error in (("exact", "0"), ("rough", "0.5")):
        simulate(tmp_path / name, *TINY, *more, "--angle-error", error)
    turned: dict[str, list[float]] = {"exact": [], "rough": []}
    for name, angles in turned.items():
        truths = [truth_of(tmp_path / name / f"{number:03d}") for number in range(3)]
        axis, point = truths[0]["table_direction"], truths[0]["table_point_mm"]
        assert np.degrees(np.arccos(axis[2])) == pytest.approx(3.0)
        assert 3.9 < np.linalg.norm(point) <= 4.0
        for number, truth in enumerate(truths):
            motion = truth["world_from_object"] @ np.linalg.inv(truths[0]["world_from_object"])
            spun = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
            if number:
                np.testing.assert_allclose(np.cross(spun, axis), 0, atol=1e-9)
                on_axis = motion @ [*(point + 7 * axis), 1]  # stays where it was
                np.testing.assert_allclose(on_axis[:3], point + 7 * axis, atol=1e-9)
            table = read_scan(tmp_path / name / f"{number:03d}").table
            assert table is not None
            assert table.angle == pytest.approx(2 * np.pi * number / 3)
            assert table.tilt == 0
            angles.append(float((np.degrees(spun @ axis) - 120 * number + 180) % 360 - 180))
    np.testing.assert_allclose(turned["exact"], 0, atol=1e-6)
    assert 0.01 < np.abs(turned["rough"]).max() < 3


@pytest.mark.usefixtures("without_pictures")
def test_scans_of_a_series_have_their_own_noise(tmp_path: Path) -> None:
    """The same tilt twice differs by noise alone, and so do series of neighbouring seeds."""
    series = simulate(tmp_path / "series", *TINY, "--tilts", "0,0", "--plan", "m3", "--seed", "4")
    first, second = contents(series / "000"), contents(series / "001")
    assert first["truth.npz"] == second["truth.npz"]
    for camera in ("c1", "c2"):
        assert first[f"{camera}/000.png"] != second[f"{camera}/000.png"]
    alone = contents(simulate(tmp_path / "alone", *TINY, "--plan", "m3", "--seed", "4"))
    assert alone == first
    other = contents(simulate(tmp_path / "other", *TINY, "--plan", "m3", "--seed", "5"))
    assert other["c1/000.png"] not in (first["c1/000.png"], second["c1/000.png"])


@pytest.mark.usefixtures("without_pictures")
def test_a_knock_moves_a_device_of_the_rig_that_is_written(tmp_path: Path) -> None:
    """The images stay as they were; the rig beside them says where devices stood before."""
    for name, more in (("still", ()), ("knocked", ("--knock", "c2:0.05deg:0.1mm"))):
        main(["simulate", "kolibri", *TINY, *more, "--out", str(tmp_path / name)])
    still, moved = (read_scan(tmp_path / name) for name in ("still", "knocked"))
    for a, b in zip(still.stacks, moved.stacks, strict=True):
        np.testing.assert_array_equal(a.images, b.images)
    true = read_rig(tmp_path / "knocked" / "true-rig.toml")
    assert not (tmp_path / "still" / "true-rig.toml").exists()
    assert still.rig is not None
    assert moved.rig is not None
    devices = zip(true.devices, still.rig.devices, moved.rig.devices, strict=True)
    for own, before, after in devices:
        np.testing.assert_allclose(own.center_world, before.center_world)
        off = own.device_from_world @ after.device_from_world.inverse()
        cosine = (np.trace(off.rotation) - 1) / 2
        wanted = np.radians(0.05) if own.name == "c2" else 0.0
        assert np.arccos(min(cosine, 1.0)) == pytest.approx(wanted, abs=1e-6)  # of a cosine
        shift = np.linalg.norm(own.center_world - after.center_world)
        assert shift == pytest.approx(0.1 if own.name == "c2" else 0.0, abs=1e-9)


def test_one_camera_alone(tmp_path: Path) -> None:
    folder = simulate(tmp_path / "scan", *SMALL, preset="single")
    assert set(truth_of(folder)) == (C1_KEYS | {"world_from_object"}) - {"pixels_c2", "seen_by_c2"}
    assert not (folder / "c2").exists()
    main(["measure", str(folder), "--out", str(tmp_path / "result")])
    assert (tmp_path / "result/cloud.ply").is_file()


@pytest.mark.usefixtures("without_pictures")
def test_a_mesh_of_ones_own_is_not_scaled(tmp_path: Path) -> None:
    file = tmp_path / "my part.stl"
    trimesh.creation.box((30.0, 20.0, 10.0)).export(file)
    folder = simulate(tmp_path / "scan", "--object", str(file), "--camera-size", "160x128",
                      "--rays", "1", "--plan", "m3", preset="face")  # fmt: skip
    maps = truth_of(folder)
    top = maps["points_mm"][maps["is_object"]].reshape(-1, 3)
    assert np.ptp(top[:, 0]) == pytest.approx(30.0, abs=4.0)  # a pixel is 3.5 mm
    assert top[:, 2].max() == pytest.approx(-0.54 * 170 + 10.0, abs=1e-5)
    assert "my part on face, plan m3" in (folder / "scan.toml").read_text()


@pytest.mark.usefixtures("without_pictures")
def test_an_earlier_scan_is_replaced_if_asked(tmp_path: Path) -> None:
    first = contents(simulate(tmp_path / "scan", *TINY, "--plan", "m3"))
    second = contents(simulate(tmp_path / "scan", *TINY, "--plan", "m4", "--overwrite"))
    assert len(second) == len(first) + 8


# Mistakes

ONE_LINE = {
    "knock": (
        ["kolibri", "--knock", "c2:0.05:0.1"],
        "--knock: expected device, turn and shift, as c2:0.05deg:0.1mm, found 'c2:0.05:0.1'",
    ),
    "knock of what": (
        ["kolibri", "--knock", "c3:0.05deg:0.1mm"],
        "--knock 'c3:0.05deg:0.1mm': expected one of the devices c1, c2, projector, found 'c3'",
    ),
    "near preset": (["kolibry"], "preset: expected one of .*single, found 'kolibry'. "
                                 "Did you mean 'kolibri'?"),
    "far preset": (["xyz"], "preset: expected one of .*, found 'xyz'. Choose one of them"),
    "near object": (["kolibri", "--object", "tooth"],
                    "--object: expected one of plane, .*, or a mesh file (.stl, .ply, .obj), "
                    "found 'tooth'. Did you mean 'teeth'?"),
    "far object": (["kolibri", "--object", "a.step"],
                   "--object: expected one of .*, found 'a.step'. Choose one of them"),
    "missing mesh": (["kolibri", "--object", "no.stl"],
                     "no.stl: expected a mesh file, found none. Check the path"),
    "mesh is a folder": (["kolibri", "--object", "folder.stl"],
                         "folder.stl: expected a mesh file, found a folder. Check the path"),
    "empty mesh": (["kolibri", "--object", "empty.stl"],
                   "empty.stl: expected a mesh of triangles, found none. Check the file"),
    "no mesh": (["kolibri", "--object", "text.ply"],
                "text.ply: expected STL, PLY or OBJ, cannot read it: "),
    "mesh out of view": (["kolibri", "--object", "speck.stl", *TINY[2:]],
                         "simulate: expected a camera that sees the object lit, found none. "
                         "Move the object"),
    "tilts": (["kolibri", "--tilts", "0,x"],
              "--tilts: expected degrees from -90 to 90 with commas between, as 0,30, found '0,x'"),
    "steep tilt": (["kolibri", "--tilts", "91"], "--tilts: expected degrees from -90 to 90"),
    "no tilt": (["kolibri", "--tilts", "nan"], "--tilts: expected degrees from -90 to 90"),
    "positions": (["kolibri", "--positions", "0"],
                  'Invalid value "0" for --positions. Expected a number of at least 1.'),
    "rays": (["kolibri", *TINY[:4], "--rays", "5"],
             "rays for each pixel: expected one of [1, 4, 9, 16], found 5"),
    "steps": (["kolibri", "--steps", "2"],
              'Invalid value "2" for --steps. Expected a number of at least 3.'),
    "seed": (["kolibri", "--seed", "-1"],
             'Invalid value "-1" for --seed. Expected a number of at least 0.'),
    "camera size": (["kolibri", "--camera-size", "big"], "--camera-size: expected "),
    "background": (["kolibri", "--background", "sky"], "sky"),
    "plan": (["kolibri", "--plan", "m9"], "plan: expected one of m0, .*m6, found 'm9'"),
    "missing plan": (["kolibri", "--plan", "no.toml"], "no.toml: expected a file, found none."),
    "plan of another projector": (
        ["kolibri", *TINY, "--plan", "patterns/plan.toml"],
        "patterns/plan.toml: expected a plan for 1024 x 768 projector pixels, found one for "
        "800 x 600. Make it for the projector of 'kolibri'",
    ),
    "missing settings": (["kolibri", "--settings", "no.toml"],
                         "no.toml: expected a file, found none. Check the path"),
    "existing output": (["kolibri", "--out", "folder.stl"],
                        "folder.stl: expected a path that does not exist yet, found an existing "
                        "folder. Choose another, or add --overwrite"),
    "output holds the mesh": (["kolibri", "--object", "mine/part.stl", "--out", "mine",
                               "--overwrite"],
                              "mine: expected a path apart from the input, found that it holds "
                              "mine/part.stl. Choose another path"),
}  # fmt: skip


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working directory, with some files that do not suit."""
    monkeypatch.chdir(tmp_path)
    Path("folder.stl").mkdir()
    Path("mine").mkdir()
    Path("mine/overview.png").touch()
    Path("empty.stl").write_text("solid nothing\nendsolid nothing\n")
    Path("text.ply").write_text("not a mesh")
    trimesh.creation.box((1e-3, 1e-3, 1e-3)).export("speck.stl")
    trimesh.creation.box((9, 9, 9)).export("mine/part.stl")
    Path("patterns").mkdir()
    Path("patterns/plan.toml").write_text(
        'format = "fringe3d-scan/1"\nprojector_size = [800, 600]\n'
        '[[sequence]]\nkind = "fringes"\nperiod_px = 16\nn_shifts = 4\n'
    )
    return tmp_path


@pytest.mark.parametrize(("arguments", "message"), ONE_LINE.values(), ids=ONE_LINE.keys())
def test_mistakes_get_one_clear_line(
    work: Path, capsys: Capture, arguments: list[str], message: str
) -> None:
    """``.*`` in a message stands for anything, all else for itself."""
    where = [] if "--out" in arguments else ["--out", "scan"]
    line = refused(capsys, work, *arguments, *where)
    pattern = ".*".join(re.escape(part) for part in message.split(".*"))
    assert re.search(pattern, line), line
    if ".toml: " in line:  # a file is wrong, not the command line
        assert "--help" not in line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[camera]\nread_noise = 3",
            "unknown key 'camera.read_noise'. Did you mean 'read_noise_e'",
        ),
        ("[camra]\ngamma = 2", "unknown key 'camra'. Did you mean 'camera'?"),
        ("sed = 3", "unknown key 'sed'. Did you mean 'seed'?"),
        (
            "[camera]\nbit_depth = 9",
            "camera: bit_depth: expected one of .*8, 10, 12, 16.*, found 9",
        ),
        ("[camera]\nbit_depth = 8.5", "camera.bit_depth: expected a whole number, found 8.5"),
        ("[camera]\nexposure = 'x'", "camera.exposure: expected a number, found 'x'. Correct it"),
        ("[camera]\nexposure = nan", "camera.exposure: expected a finite number, found nan"),
        ("[camera]\nexposure = 0", "camera: exposure: expected a positive number, found 0"),
        ("[camera]\nblack_level_dn = 255", "camera: black_level_dn: expected 0 to 255"),
        ("[projector]\ngamma = -1", "projector: gamma: expected a positive number, found -1"),
        ("[projector]\ndark = 2", "projector: dark: expected 0 to 1, found 2"),
        ("[surface]\ngloss_exponent = -9", "gloss_exponent: expected a positive number, found -9"),
        ("[surface]\ntexture = 'wood'", "surface: texture: expected one of .*, found wood"),
        ("[surface]\nalbedo = 1.2", "surface: albedo: expected a number in (0, 1], found 1.2"),
        ("[recording]\nvelocity_mm_s = [1, 2]", "recording.velocity_mm_s: expected at least 3 ent"),
        (
            "[recording]\ndropped = ['a']",
            "recording.dropped[0]: expected a whole number, found 'a'",
        ),
        ("[recording]\nframe_ms = 0", "recording: frame_ms: expected a positive time, found 0"),
        ("camera = 3", "camera: expected a table, found 3. Correct it"),
        ("[camera", "expected TOML, found a mistake: "),
    ],
)
def test_wrong_settings_name_their_place(
    work: Path, capsys: Capture, text: str, message: str
) -> None:
    Path("wrong.toml").write_text(text)
    line = refused(capsys, work, "kolibri", *TINY, "--out", "scan", "--settings", "wrong.toml")
    assert line.startswith("wrong.toml: ")
    pattern = ".*".join(re.escape(part) for part in message.split(".*"))
    assert re.search(pattern, line), line


@pytest.mark.parametrize("key", ["dropped", "repeated"])
@pytest.mark.parametrize("place", [-1, 13])
def test_images_that_the_plan_does_not_have_cannot_be_dropped(
    work: Path, capsys: Capture, key: str, place: int
) -> None:
    Path("wrong.toml").write_text(f"[recording]\n{key} = [{place}]\n")
    line = refused(capsys, work, "kolibri", *TINY, "--out", "scan", "--settings", "wrong.toml")
    assert (
        f"recording: {key}: expected places 0 to 12 of the plan's images, found [{place}]" in line
    )


def test_a_folder_that_is_no_scan_is_not_replaced(work: Path, capsys: Capture) -> None:
    Path("patterns/notes.txt").write_text("keep me")
    line = refused(capsys, work, "kolibri", *TINY, "--out", "patterns", "--overwrite")
    assert "patterns: expected an earlier result to replace" in line


@pytest.mark.parametrize("package", ["embreex", "manifold3d", "trimesh", "skimage"])
@pytest.mark.parametrize("command", [["simulate", "kolibri"], ["demo"]])
def test_without_the_extra_the_message_tells_what_to_install(
    package: str,
    command: list[str],
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loaded = ("fringe3d.simulate", "fringe3d.cli.simulator", "fringe3d.cli.demo",
              "fringe3d.report.simulation", package)  # fmt: skip
    for name in [n for n in sys.modules if n.startswith(loaded)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(SystemExit) as ended:
        main([*command, "--out", str(tmp_path / "scan")])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        f"error: {command[0]}: expected the packages of the simulator, found no '{package}'. "
        "Install them: pip install 'fringe3d[simulate]'\n"
    )
    assert not any(tmp_path.iterdir())


# Help


def test_help_names_every_choice(capsys: Capture) -> None:
    main(["simulate", "--help"])
    text = " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    names = text.replace("- ", "-")
    for name in (*PRESETS, *OBJECTS, *(f"[{kind}]" for kind in KINDS), "m0 to m6", "plan.toml",
                 "truth.npz", "simulation.toml", "overview.png", "1, 4, 9 or 16"):  # fmt: skip
        assert name in names, name
    for option in ("--out", "--object", "--plan", "--seed", "--steps", "--period", "--camera-size",
                   "--background", "--rays", "--positions", "--tilts", "--settings",
                   "--overwrite"):  # fmt: skip
        assert option in text


def test_tilts_are_numbers_with_commas_between() -> None:
    assert parse_tilts("0,-30.5, 90") == (0.0, -30.5, 90.0)
    with pytest.raises(MethodError, match="found ''"):
        parse_tilts("")
