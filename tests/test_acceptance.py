"""Fits against closed forms, covariance against sampling, clouds with known errors accepted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.cli.run import main
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.evaluate import (
    Decision,
    Fit,
    Sphere,
    decide,
    fit_cone,
    fit_covariance,
    fit_cylinder,
    fit_plane,
    fit_sphere,
    probe_plane,
    probe_spheres,
    shortest_interval,
    spacing_mm,
)
from fringe3d.io.clouds import read_cloud

Floats = NDArray[np.float64]

SEED = 20261201
SHOWN = ("size", "spacing")
PLACE = np.array([30.0, -20.0, 400.0])


def cap(radius: float, half_deg: float, n: int, rng: np.random.Generator) -> Floats:
    """Return points evenly on a cap of a sphere about +z, centre at 0."""
    z = rng.uniform(np.cos(np.radians(half_deg)), 1, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    flat = np.sqrt(1 - z**2)
    return radius * np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def cone_points(half_deg: float, n: int, rng: np.random.Generator) -> Floats:
    """Return points on a quarter of a cone about z (radius 12 at z = 0), or of a cylinder."""
    turn, z = rng.uniform(0, np.pi / 2, n), rng.uniform(-8, 8, n)
    radius = 12 + z * np.tan(np.radians(half_deg))
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


@pytest.mark.parametrize("seed", range(4))
def test_exact_surfaces_are_found_however_they_stand(seed: int) -> None:
    """Points without noise: all numbers to rounding (1e-7 mm of 400 mm)."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed)
    ball = fit_sphere(turn.apply(cap(10, 50, 500, rng)) + PLACE)
    np.testing.assert_allclose(ball.surface.center_mm, PLACE, atol=1e-7)
    assert ball.surface.radius_mm == pytest.approx(10, abs=1e-7)
    assert ball.form_mm < 1e-7
    up = turn.apply([0.0, 0.0, 1.0])
    pipe = fit_cylinder(turn.apply(cone_points(0, 500, rng)) + PLACE)
    assert pipe.surface.radius_mm == pytest.approx(12, abs=1e-6)
    assert abs(pipe.surface.axis @ up) == pytest.approx(1, abs=1e-12)
    funnel = fit_cone(turn.apply(cone_points(20, 500, rng)) + PLACE)
    assert np.degrees(funnel.surface.half_angle) == pytest.approx(20, abs=1e-6)
    assert funnel.surface.axis @ up == pytest.approx(1, abs=1e-12)  # towards where it widens
    apex = funnel.surface.point_mm - funnel.surface.axis * (
        funnel.surface.radius_mm / np.tan(funnel.surface.half_angle)
    )
    np.testing.assert_allclose(apex, PLACE - up * 12 / np.tan(np.radians(20)), atol=1e-5)


MAKERS: dict[str, tuple[Callable[[np.random.Generator], Floats], Callable[[Floats], Fit[Any]]]] = {
    "plane": (
        lambda rng: np.column_stack([rng.uniform(-9, 9, (400, 2)), np.zeros(400)]),
        fit_plane,
    ),
    "sphere": (lambda rng: cap(10, 60, 400, rng), fit_sphere),
    "cylinder": (lambda rng: cone_points(0, 400, rng), fit_cylinder),
    "cone": (lambda rng: cone_points(25, 400, rng), fit_cone),
}
N_DRAWS = 20


@pytest.mark.parametrize("kind", MAKERS)
def test_the_covariance_of_a_fit_is_that_of_repeated_noise(kind: str) -> None:
    """Noise along the normals: the numbers' errors, squared over their covariance.

    Their mean over 20 draws of k numbers is 1 within 3 sqrt(2 / 20 k). The true numbers are those
    that move the fitted surface onto the true points.
    """
    rng = np.random.default_rng(SEED)
    make, fit = MAKERS[kind]
    true = make(rng)
    normals = _normals(fit(true).surface, true)
    sigma = 0.002 * rng.uniform(0.5, 2, len(true))
    pulls = []
    for _ in range(N_DRAWS):
        noisy = true + normals * (sigma * rng.normal(size=len(true)))[:, None]
        found = fit(noisy)
        covariance = fit_covariance(noisy, found, sigma_mm=sigma)
        slopes = found.surface.slopes(true)
        moved = np.linalg.lstsq(slopes, found.surface.distances(true), rcond=None)[0]
        pulls.append(moved @ np.linalg.solve(covariance, moved) / len(moved))
    assert np.mean(pulls) == pytest.approx(1, abs=3 * np.sqrt(2 / (N_DRAWS * len(covariance))))


def _normals(surface: Any, points: Floats) -> Floats:
    """Return normals as the gradient of the distances, by small steps."""
    step = 1e-4
    move = [surface.distances(points + step * e) for e in np.eye(3)]
    back = [surface.distances(points - step * e) for e in np.eye(3)]
    return np.asarray((np.array(move) - np.array(back)).T / (2 * step))


def test_ninety_five_percent_form_is_the_shortest_interval() -> None:
    values = np.r_[np.linspace(0, 1, 95), 50.0, 51.0, 52.0, 53.0, -70.0]
    assert shortest_interval(values, 0.95) == pytest.approx(1.0)
    assert shortest_interval(values, 1.0) == pytest.approx(123.0)


def test_a_value_is_judged_with_all_its_uncertainty() -> None:
    """ISO 14253-1, limit 10, U = 1: conforms up to 9, does not beyond 11, on both sides."""
    for sign in (1, -1):
        assert decide(sign * 9.0, 10.0, 1.0) == Decision.PASS
        assert decide(sign * 9.01, 10.0, 1.0) == Decision.OPEN
        assert decide(sign * 11.0, 10.0, 1.0) == Decision.OPEN
        assert decide(sign * 11.01, 10.0, 1.0) == Decision.FAIL
    assert decide(5.0, None, 1.0) == Decision.NO_LIMIT


def scene(rng: np.random.Generator) -> Floats:
    """Return a ball bar (diameters 16.01 mm, 50.02 mm apart) on a rough table with a wall."""
    turn = Rotation.from_euler("z", 20, degrees=True)
    ends = turn.apply([[-25.01, 0, 12.0], [25.01, 0, 12.0]])
    balls = [cap(8.005, 75, 6000, rng) * (1 + 1e-4 * rng.normal(size=(6000, 1))) + e for e in ends]
    table = np.column_stack([rng.uniform(-40, 40, (8000, 2)), rng.normal(0, 0.02, 8000)])
    wall = np.column_stack(
        [np.full(3000, 45.0), rng.uniform(-40, 40, 3000), rng.uniform(0, 20, 3000)]
    )
    return np.concatenate([table, *balls, wall])


def test_balls_are_found_among_other_things_and_their_size_and_distance_told() -> None:
    """Noise 0.8 um radially, 4600 points on each cap: numbers to 0.1 um."""
    first, second = probe_spheres(scene(np.random.default_rng(SEED)), 16.0, 2)
    for probed in (first, second):
        assert isinstance(probed.fit.surface, Sphere)
        assert 2 * probed.fit.surface.radius_mm == pytest.approx(16.01, abs=5e-4)
        assert probed.fit.sigma_mm == pytest.approx(8e-4, rel=0.05)
        assert probed.fit.n_rejected == int(0.003 * len(probed.fit.is_used))
        assert probed.n_far == 0
    assert first.fit.surface.center_mm[0] < second.fit.surface.center_mm[0]
    assert spacing_mm(first, second) == pytest.approx(50.02, abs=2e-4)


def test_gross_errors_over_the_cap_are_counted() -> None:
    rng = np.random.default_rng(SEED)
    points = np.concatenate([scene(rng), [[-20.0, -8.0, 25.0], [-26.0, -9.0, 14.0]]])
    first, second = probe_spheres(points, 16.0, 2)
    assert (first.n_far, second.n_far) == (2, 0)


def test_a_ball_that_is_not_there_is_said() -> None:
    with pytest.raises(EmptyResultError, match="expected 2 with a diameter near 16 mm, found 1"):
        probe_spheres(cap(8, 75, 3000, np.random.default_rng(0)), 16.0, 2)


def test_the_plate_is_found_without_its_border_and_what_stands_beside_it() -> None:
    """A plate with a dent of 0.05 mm, chamfers, and a block beside it; tilted by 30 deg."""
    rng = np.random.default_rng(SEED)
    plate = np.column_stack([rng.uniform(-30, 30, 20000), rng.uniform(-20, 20, 20000)])
    edge = np.maximum(np.abs(plate[:, 0]) - 29, np.abs(plate[:, 1]) - 19)
    z = -np.maximum(edge, 0) + rng.normal(0, 0.002, 20000)
    z[np.hypot(plate[:, 0] - 5, plate[:, 1]) < 3] -= 0.05
    block = rng.uniform([32, -10, 0], [40, 10, 15], (6000, 3))
    points = np.concatenate([np.column_stack([plate, z]), block])
    points = Rotation.from_euler("y", 30, degrees=True).apply(points) + PLACE
    probed = probe_plane(points)
    assert probed.n_far == 0
    # The dent's floor, and 3 sigma (2.5 sigma at 13000 points once 3 per mille are out) above.
    assert probed.fit.form_mm == pytest.approx(0.05 + 2 * 0.006, abs=0.004)
    inside = probed.chosen[:20000]
    assert edge[inside].max() < -0.4  # 2 mm inside the hull of what belongs to the plane
    assert not probed.chosen[20000:].any()


def test_the_command_judges_leaves_a_report_and_fails_where_a_limit_is_broken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "bar.xyz", scene(np.random.default_rng(SEED)), header="x y z")
    command = ["evaluate", "acceptance", "--ball-bar", str(tmp_path / "bar.xyz"), "--diameter",
               "16", "--distance", "50", "--max-size", "0.02", "--uncertainty", "0.001",
               "--out", str(tmp_path / "out")]  # fmt: skip
    main(command)
    said = capsys.readouterr().out
    assert "probing error, size: +" in said
    assert "decision: pass (U = 1 um" in said
    record = json.loads((tmp_path / "out/acceptance.json").read_text())
    values = {kind: [v for v in record["values"] if v["value"] == kind] for kind in SHOWN}
    assert [v["decision"] for v in values["size"]] == ["pass", "pass"]
    assert [v["value_mm"] for v in values["size"]] == pytest.approx([0.01, 0.01], abs=5e-4)
    assert values["spacing"][0]["value_mm"] == pytest.approx(0.02, abs=2e-4)
    report = (tmp_path / "out/acceptance.md").read_text()
    assert "# Acceptance: pass" in report
    assert (tmp_path / "out/overview.png").stat().st_size > 10_000
    with pytest.raises(SystemExit) as ended:
        main([*command, "--overwrite", "--max-spacing", "0.01"])
    assert ended.value.code == 1
    assert "limit 10 um: fail" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "expected results of artefacts, found none"),
        (["--ball", "x"], "--diameter: expected the calibrated diameter"),
        (["--ball-bar", "x", "--diameter", "16"], "--distance: expected the calibrated distance"),
        (["--plane", "nothing"], "expected a result folder or a cloud"),
    ],
)
def test_what_is_missing_is_said(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["evaluate", "acceptance", *words])
    assert message in " ".join(capsys.readouterr().err.split())


def test_clouds_of_any_kind_of_ply_are_read(tmp_path: Path) -> None:
    """ASCII and binary of both byte orders, with normals and properties that nobody asked for."""
    points = np.array([[1.5, -2.25, 3.0], [np.nan, 0, 0], [4, 5, 6]])
    fields = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("quality", "u2"), ("nx", "f4"),
              ("ny", "f4"), ("nz", "f4")]  # fmt: skip
    names = {"f8": "double", "u2": "ushort", "f4": "float"}
    for form, order in (("ascii", "="), ("binary_little_endian", "<"), ("binary_big_endian", ">")):
        table = np.zeros(3, [(name, order + kind) for name, kind in fields])
        table["x"], table["y"], table["z"] = points.T
        table["nz"] = 1
        head = [f"ply\nformat {form} 1.0\nelement vertex 3"]
        head += [f"property {names[kind]} {name}" for name, kind in fields]
        head += ["element face 1", "property list uchar int vertex_indices", "end_header\n"]
        if form == "ascii":
            body = "\n".join(" ".join(str(v) for v in row) for row in table.tolist()).encode()
            body += b"\n3 0 1 2\n"
        else:
            body = table.tobytes() + b"\x03" + np.arange(3, dtype=order + "i4").tobytes()
        (tmp_path / "a.ply").write_bytes("\n".join(head).encode() + body)
        cloud = read_cloud(tmp_path / "a.ply")
        np.testing.assert_array_equal(cloud.points_mm, points[[0, 2]])
        assert cloud.normals is not None
        np.testing.assert_array_equal(cloud.normals, [[0, 0, 1]] * 2)
        assert cloud.noise_mm is None


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"solid", "it does not begin as a PLY file does"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n",
         "cannot read it"),
        ("a.ply", b"ply\nelement vertex 2\nproperty float x\nend_header\n1\n", "its format is ''"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex\nend_header\n", "header is damaged"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "it says 0 vertices with"),
        ("a.npy", b"", "cannot read it"),
        ("a.txt", b"1,5 2,5 3,5\n", "decimal commas"),
        ("a.xyz", b"nothing here\n", "expected points, found none"),
        ("a.doc", b"1 2 3", "expected a cloud as"),
        ("a.npz", b"1 2 3", "cannot read it"),
    ],
)  # fmt: skip
def test_what_is_no_cloud_is_said(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MethodError, match=message):
        read_cloud(tmp_path / name)


@pytest.mark.parametrize("shape", [(3, 4), (4, 2), ()])
def test_an_array_of_another_shape_is_no_cloud(shape: tuple[int, ...], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(MethodError, match="not numbers"):
        read_cloud(tmp_path / "a.npy")
