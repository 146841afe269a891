"""``fringe3d merge``: from results to one body, its files as other programs read them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ball_views import AXIS, BALLS, ball_views, camera, seen_balls
from fringe3d.cli import main
from fringe3d.errors import MethodError
from fringe3d.io.clouds import read_cloud
from fringe3d.io.results import toml_document, write_points
from fringe3d.io.rigfile import rig_text
from fringe3d.io.surfaces import write_e57, write_merged_ply, write_mesh
from fringe3d.io.tablefile import read_table_axis
from fringe3d.io.viewfile import camera_of, camera_table
from fringe3d.model import (
    Fate,
    MergedCloud,
    PairResidual,
    Registration,
    Rig,
    RigidTransform,
    SurfaceMesh,
)
from fringe3d.register import odd_views
from fringe3d.report.merge_pictures import looking, splat

Capture = pytest.CaptureFixture[str]
ANGLES = (0, 60, 120, 180, 240, 300)
AXIS_FILE = f"""format = "fringe3d-table/1"
point_mm = {AXIS.point_mm.tolist()}
direction = {AXIS.direction.tolist()}
"""


def write_results(folder: Path) -> list[Path]:
    """Write six results of balls on a table, as ``fringe3d measure`` leaves them."""
    views, _ = ball_views(ANGLES, sigma_mm=0.01, seed=8, shape=(72, 96))
    paths = []
    for angle, view in zip(ANGLES, views, strict=True):
        path = folder / f"at{angle:03d}"
        path.mkdir(parents=True)
        good = view.is_valid
        write_points(path / "points.npz", {
            "points_mm": view.points_mm, "sigma_mm": view.sigma_mm,
            "skew_mm": np.zeros(good.shape, np.float32),
            "order_probability": good.astype(np.float32),
            "offset": np.full(good.shape, 100, np.float32),
            "modulation": np.full(good.shape, 50, np.float32),
            "rejection": np.where(good, 0, 2).astype(np.uint16),
        })  # fmt: skip
        (path / "rig.toml").write_text(rig_text(Rig(cameras=(view.camera,))))
        record = {
            "summary": "balls", "time": "now", "versions": {"fringe3d": "0"}, "method": "m2",
            "why_this_method": "", "images_used": 9, "images": {}, "decoding": [], "health": [],
            "options": {}, "seconds": {}, "table": {"angle_deg": float(angle), "tilt_deg": 0.0},
        }  # fmt: skip
        (path / "measure.toml").write_text(toml_document(record))
        paths.append(path)
    return paths


@pytest.fixture(scope="module")
def merged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that holds ``results`` and the ``body`` merged from them."""
    folder = tmp_path_factory.mktemp("merge")
    write_results(folder / "results")
    (folder / "axis.toml").write_text(AXIS_FILE)
    main(["merge", str(folder / "results"), "--out", str(folder / "body"), "--jobs", "1",
          "--axis", str(folder / "axis.toml"), "--formats", "ply"])  # fmt: skip
    return folder


def test_a_merge_leaves_a_cloud_pictures_and_the_axis(merged: Path) -> None:
    body = merged / "body"
    record = json.loads((body / "merge.json").read_text())
    assert [view["name"] for view in record["views"]] == [f"at{a:03d}" for a in ANGLES]
    assert sum(record["fates"].values()) == record["points_of_views"]
    assert record["odd_views"] == []
    for view, angle in zip(record["views"], ANGLES, strict=True):
        assert view["angle_deg"] == pytest.approx(angle, abs=0.03)
    table = record["table"]
    assert AXIS.distance_mm(table["point_mm"]) < 0.01
    assert np.dot(table["direction"], AXIS.direction) > 1 - 1e-6
    cloud = read_cloud(body / "cloud.ply")
    away = np.linalg.norm(cloud.points_mm[:, None] - BALLS[:, :3], axis=-1) - BALLS[:, 3]
    assert np.median(np.abs(away).min(axis=1)) < 0.006
    for name in ("overview.png", "overlaps.png", "turn.gif", "merge.md", "table.toml"):
        assert (body / name).stat().st_size > 100
    page = (body / "report.html").read_text()
    assert "data:image/gif;base64" in page
    assert "http" not in page.replace("http-equiv", "")


def test_finished_views_are_kept_and_broken_scans_named(merged: Path, capsys: Capture) -> None:
    """A second run measures nothing again; a broken result stops it, or is left out if asked."""
    results = [str(path) for path in sorted((merged / "results").iterdir())]
    broken = merged / "broken"
    broken.mkdir()
    (broken / "measure.toml").write_text("summary = 'x'\n")
    rest = ["--out", str(merged / "body"), "--jobs", "1", "--axis", str(merged / "axis.toml"),
            "--overwrite", "--json"]  # fmt: skip
    before = {f: f.stat().st_mtime_ns for f in (merged / "body-views").iterdir()}
    with pytest.raises(SystemExit):
        main(["merge", *results, str(broken), *rest])
    told = capsys.readouterr().err
    assert "1 broken: broken:" in told
    assert "--skip-broken" in told
    assert (merged / "body" / "cloud.ply").is_file()  # what was there stays
    main(["merge", *results, str(broken), *rest, "--skip-broken"])
    record = json.loads(capsys.readouterr().out)
    assert list(record["broken"]) == ["broken"]
    assert record["kept_views"] == len(ANGLES)
    assert before == {f: f.stat().st_mtime_ns for f in (merged / "body-views").iterdir()}


def test_an_interrupt_says_that_finished_views_are_kept(
    merged: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one_view(_sources: object, _options: object, folder: Path, **_more: object) -> None:
        (folder / "at000").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr("fringe3d.cli.merge_run.measure_views", one_view)
    with pytest.raises(SystemExit) as stopped:
        main(["merge", str(merged / "results"), "--out", str(tmp_path / "body")])
    assert stopped.value.code == 130
    said = " ".join(capsys.readouterr().err.split())
    assert "interrupted; the views measured so far are kept in" in said
    assert "nothing was written" not in said
    assert not (tmp_path / "body").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{}"], "expected two scans or more, found 1"),
        (["{}", "{}"], "--turns: expected an angle for each of the 2 scans, found 1"),
        (["{}", "missing"], "expected a scan or a result, found nothing"),
        (["{}", "{}", "--recalibrate"], "--recalibrate: expected scans with their images, found"),
    ],
)
def test_mistakes_get_one_message(
    merged: Path, capsys: Capture, words: list[str], message: str
) -> None:
    one = str(merged / "results" / "at000")
    turns = ["--turns", "30"] if "turns" in message else []
    with pytest.raises(SystemExit):
        main(["merge", *(w.format(one) for w in words), "--out", str(merged / "x"), *turns])
    assert message in capsys.readouterr().err
    assert not (merged / "x").exists()


def test_a_ball_that_goes_around_gives_the_tables_axis(tmp_path: Path, capsys: Capture) -> None:
    device = camera((192, 256))
    for angle in (0, 70, 150, 240):
        center = AXIS.turn(np.radians(angle)).apply([14.0, 3.0, 2.0])
        points = seen_balls(device, np.array([[*center, 6.0]]))
        np.save(tmp_path / f"{angle}.npy", points[np.isfinite(points[..., 0])])
    balls = [w for a in (0, 70, 150, 240) for w in ("--ball", str(tmp_path / f"{a}.npy"))]
    for name, turns in (("a", ["--turns", "0,70,150,240"]), ("b", [])):
        out = tmp_path / f"{name}.toml"
        main(["calibrate", "table", *balls, "--diameter", "12", *turns, "--out", str(out)])
        found = read_table_axis(out)
        assert found.distance_mm(AXIS.point_mm) < 1e-3
        assert found.direction @ AXIS.direction > 1 - 1e-8
    assert "4 places of the ball on a circle" in capsys.readouterr().out


# Files


def small_cloud() -> MergedCloud:
    rng = np.random.default_rng(1)
    n = 50
    normals = rng.normal(size=(n, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return MergedCloud(
        points_mm=rng.normal(0, 20, (n, 3)), normals=normals,
        sigma_mm=rng.uniform(0.001, 0.01, n).astype(np.float32),
        grey=rng.integers(0, 255, n).astype(np.uint8), n_views=np.full(n, 3, np.uint8),
        source=np.arange(n).astype(np.uint16), fates=(np.full((5, 10), int(Fate.KEPT), np.uint8),),
    )  # fmt: skip


def test_clouds_are_read_back_by_others(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    cloud = small_cloud()
    write_merged_ply(tmp_path / "c.ply", cloud, comment="mm")
    told = trimesh.load(tmp_path / "c.ply")
    np.testing.assert_allclose(told.vertices, cloud.points_mm, atol=1e-5)
    np.testing.assert_array_equal(told.colors[:, 0], cloud.grey)
    own = read_cloud(tmp_path / "c.ply")
    assert own.sigma_mm is not None
    assert own.normals is not None
    np.testing.assert_allclose(own.sigma_mm, cloud.sigma_mm, rtol=1e-6)
    np.testing.assert_allclose(own.normals, cloud.normals, atol=1e-6)
    pye57 = pytest.importorskip("pye57")
    write_e57(tmp_path / "c.e57", cloud)
    file = pye57.E57(str(tmp_path / "c.e57"))
    scan = file.read_scan(0, ignore_missing_fields=True, colors=True)
    file.close()
    found = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    np.testing.assert_allclose(1000 * found, cloud.points_mm, atol=1e-4)
    np.testing.assert_array_equal(scan["colorGreen"], cloud.grey)


@pytest.mark.parametrize("ending", ["ply", "stl", "obj"])
def test_meshes_are_read_back_by_others(tmp_path: Path, ending: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    n = len(ball.vertices)
    mesh = SurfaceMesh(
        vertices_mm=np.asarray(ball.vertices), faces=np.asarray(ball.faces, np.int32),
        normals=(np.asarray(ball.vertices) / 10).astype(np.float32),
        sigma_mm=np.full(n, 0.005, np.float32),
        grey=np.arange(n).astype(np.uint8),
    )  # fmt: skip
    assert mesh.is_closed
    write_mesh(tmp_path / f"m.{ending}", mesh, comment="test")
    told = trimesh.load_mesh(tmp_path / f"m.{ending}")
    assert told.is_watertight
    assert told.volume == pytest.approx(ball.volume, rel=1e-4)  # a flipped face would lower it
    open_ = SurfaceMesh(
        vertices_mm=mesh.vertices_mm, faces=mesh.faces[1:], normals=mesh.normals,
        sigma_mm=mesh.sigma_mm, grey=mesh.grey,
    )  # fmt: skip
    assert not open_.is_closed


def test_a_camera_survives_its_file_to_the_last_bit() -> None:
    views, _ = ball_views((0,), shape=(48, 64))
    before = views[0].camera
    after = camera_of(json.loads(json.dumps(camera_table(before))))
    for name in ("focal_px", "center_px", "distortion"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    np.testing.assert_array_equal(after.center_world, before.center_world)


# Judgement and pictures


def registration(rms_um: np.ndarray, *, gone: int | None = None) -> Registration:
    """Return pairs whose mean squares are sums of those of their views."""
    n = len(rms_um)
    pairs = tuple(
        PairResidual(first=i, second=j, n_points=900, in_sigmas=1.0, mean_mm=0.0,
                     rms_mm=float(np.hypot(rms_um[i], rms_um[j])) / 1000)
        for i in range(n) for j in range(i + 1, n) if gone not in (i, j)
    )  # fmt: skip
    return Registration(
        body_from_view=(RigidTransform.identity(),) * n, covariance=np.zeros((6 * n, 6 * n)),
        middle_mm=np.zeros(3), before=pairs, after=pairs, noise_factor=1.0, closure_mm=0.0,
        closure_rad=0.0, table=None, n_iterations=1,
    )  # fmt: skip


def test_a_view_that_differs_is_named_and_not_its_neighbours() -> None:
    assert odd_views(registration(np.full(8, 10.0))) == ()
    odd = odd_views(registration(np.array([10, 10, 25, 10, 11, 9, 10.0])))
    assert [o.view for o in odd] == [2]
    assert odd[0].rms_mm == pytest.approx(0.025, rel=0.02)
    lost = odd_views(registration(np.full(6, 10.0), gone=4))
    assert [(o.view, o.why) for o in lost] == [(4, "it lies on no other view")]


def test_the_axis_points_up_in_pictures_and_the_near_hides_the_far() -> None:
    axis = np.array([0.2, -0.1, 1.0])
    for azimuth in (0.0, 1.0, 4.0):
        look = looking(axis, azimuth)
        np.testing.assert_allclose(look @ look.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(look) == pytest.approx(1.0)
        assert look[1] @ axis < 0 < -look[2] @ axis
    look = looking(axis, 0.0)
    points = np.array([-20 * look[2], 20 * look[2], 30 * look[0], -30 * look[0]])
    colours = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250], [0, 0, 250]], np.uint8)
    picture = splat(points, colours, look, 100)
    assert (picture == [250, 0, 0]).all(axis=-1).any()
    assert not (picture == [0, 250, 0]).all(axis=-1).any()


@pytest.mark.parametrize("kind", ["poisson", "edges"])
def test_closed_meshes_are_watertight_to_two_other_programs(tmp_path: Path, kind: str) -> None:
    """A ball that was not seen from below, closed; as trimesh and Open3D read each format.

    Open3D's word for watertight also asks that no triangle cuts another.
    """
    trimesh = pytest.importorskip("trimesh")
    meshing = pytest.importorskip("fringe3d.register.meshing")
    try:
        library = meshing.open3d()
    except MethodError:
        pytest.skip("no open3d here")
    way = np.random.default_rng(2).normal(size=(800, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way = way[way[:, 2] > -0.8]
    n = len(way)
    cloud = MergedCloud(
        points_mm=10 * way, normals=way.astype(np.float32), sigma_mm=np.full(n, 0.004, np.float32),
        grey=np.full(n, 90, np.uint8), n_views=np.ones(n, np.uint8),
        source=np.zeros(n, np.uint16), fates=(np.full((1, n), int(Fate.KEPT), np.uint8),),
    )  # fmt: skip
    mesh = meshing.mesh_of(cloud, kind=kind, closed=True)
    for ending in ("ply", "stl", "obj"):
        file = tmp_path / f"m.{ending}"
        write_mesh(file, mesh, comment="test")
        told = trimesh.load_mesh(file)
        assert told.is_watertight
        assert told.is_winding_consistent
        other = library.io.read_triangle_mesh(str(file))
        if ending == "stl":  # which names each triangle's corners anew
            other.merge_close_vertices(1e-6)
        assert other.is_watertight()
        assert other.get_volume() == pytest.approx(told.volume, rel=1e-5)
