"""Deviations from clouds and meshes against closed forms and brute force."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from fringe3d.cli.run import main
from fringe3d.evaluate import deviations_from_cloud, deviations_from_mesh
from fringe3d.io.clouds import read_cloud

Floats = NDArray[np.float64]

SEED = 20261202


def ball_mesh() -> Any:
    return trimesh.creation.icosphere(subdivisions=3, radius=10.0)


def test_distances_from_a_mesh_are_those_of_all_triangles_one_by_one() -> None:
    """A box with long triangles and fine ones; trimesh's formula for each pair is the oracle."""
    rng = np.random.default_rng(SEED)
    box = trimesh.creation.box([60, 40, 2])
    bump = trimesh.creation.icosphere(subdivisions=2, radius=3.0).apply_translation([5, 3, 20])
    triangles = np.concatenate([box.triangles, bump.triangles])
    points = rng.uniform([-40, -30, -12], [40, 30, 26], (400, 3))
    found = deviations_from_mesh(points, triangles, reach_mm=100.0).signed_mm
    closest: Any = trimesh.triangles.closest_point
    feet = [closest(triangles, np.repeat(p[None], len(triangles), 0)) for p in points]
    least = [np.linalg.norm(f - p, axis=1).min() for f, p in zip(feet, points, strict=True)]
    np.testing.assert_allclose(np.abs(found), least, atol=1e-9)
    in_box = (np.abs(points) < [30, 20, 1]).all(axis=1)
    in_bump = bump.contains(points)
    assert in_box.sum() > 5
    np.testing.assert_array_equal(found < 0, in_box | in_bump)


def test_a_reach_leaves_out_what_lies_farther() -> None:
    triangles = np.asarray(ball_mesh().triangles)
    found = deviations_from_mesh([[0, 0, 10.5], [0, 0, 13.0]], triangles, reach_mm=1.0)
    assert found.n_alone == 1
    # The facets lie up to 0.4 % of the radius below the sphere.
    assert found.known[0] == pytest.approx(0.5, abs=0.04)


def test_deviations_from_a_cloud_on_a_sphere_are_radial_and_positive_in_front() -> None:
    """Two sets of points on one sphere, set off by 0.02 mm; a bend raises the points.

    Twelve points of 191 on a mm^2 lie within r^2 = 0.02 mm^2; their plane lies r^2 / 4 R = 0.5 um
    below the sphere. Edges of neighbourhoods leave tenths of it.
    """
    rng = np.random.default_rng(SEED)

    def cap(n: int, radius: float) -> Floats:
        z, turn = rng.uniform(0.5, 1, n), rng.uniform(0, 2 * np.pi, n)
        flat = np.sqrt(1 - z**2)
        return radius * np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])

    reference, points = cap(60_000, 10.0), cap(3000, 10.02)
    for view, sign in (([0.0, 0.0, 300.0], 1), ([0.0, 0.0, -300.0], -1)):
        found = deviations_from_cloud(points, reference, reach_mm=1.0, viewpoint_mm=view)
        assert len(found.known) > 0.97 * 3000  # not where the border of the cap is near
        np.testing.assert_allclose(sign * found.known, 0.02, atol=2e-3)
        assert sign * found.mean_mm == pytest.approx(0.0205, abs=1e-4)
    normals = reference / 10
    found = deviations_from_cloud(points, reference, reach_mm=1.0, viewpoint_mm=[0, 0, -300],
                                  normals=normals)  # fmt: skip
    assert found.mean_mm == pytest.approx(0.0205, abs=1e-4)


def test_noise_of_the_reference_counts_with_about_a_third() -> None:
    """The plane of 12 points, at about their middle: sigma / sqrt(12), more beside it."""
    rng = np.random.default_rng(SEED)
    x, y = np.meshgrid(np.arange(100.0), np.arange(100.0))
    flat = np.column_stack([x.ravel(), y.ravel(), rng.normal(0, 0.01, x.size)])
    points = np.column_stack([rng.uniform(5, 94, (2000, 2)), np.zeros(2000)])
    found = deviations_from_cloud(points, flat, reach_mm=3.0, viewpoint_mm=[0, 0, 99])
    assert 0.01 / np.sqrt(12) < found.rms_mm < 0.01 / np.sqrt(12) * 1.3


def test_parts_of_the_reference_that_were_not_measured_are_told() -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    reference = np.column_stack([x.ravel(), y.ravel(), np.zeros(1600)])
    half = reference[reference[:, 0] < 20]
    found = deviations_from_cloud(half, reference, reach_mm=0.5, viewpoint_mm=[0, 0, 9])
    assert found.covered == 0.5
    assert found.n_alone == 0


def test_the_command_leaves_figures_a_map_and_a_coloured_cloud(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = ball_mesh()
    mesh.export(tmp_path / "ball.stl")
    points = mesh.triangles_center * 1.002
    np.savetxt(tmp_path / "cloud.csv", np.r_[points, [[50.0, 0, 0]]], delimiter=",", header="x,y,z")
    main(["evaluate", "compare", str(tmp_path / "cloud.csv"), str(tmp_path / "ball.stl"),
          "--tolerance", "0.03", "--out", str(tmp_path / "out")])  # fmt: skip
    assert "1,280 of 1,281 points compared" in capsys.readouterr().out
    record = json.loads((tmp_path / "out/compare.json").read_text())
    distance = np.linalg.norm(points, axis=1) * 0.002 / 1.002
    assert record["mean_mm"] == pytest.approx(distance.mean(), rel=2e-3)
    assert record["within_tolerance"] == 1
    assert (tmp_path / "out/overview.png").stat().st_size > 10_000
    back: Any = trimesh.load(tmp_path / "out/deviations.ply")
    np.testing.assert_allclose(back.vertices[:-1], points, atol=1e-5)
    red, _, blue, _ = np.asarray(back.visual.vertex_colors)[0]
    assert red > blue  # in front is red
    assert tuple(np.asarray(back.visual.vertex_colors)[-1][:3]) == (150, 150, 150)
    assert len(read_cloud(tmp_path / "out/deviations.ply").points_mm) == 1281


def test_clouds_apart_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    here = np.column_stack([x.ravel(), y.ravel(), np.zeros(1600)])
    np.savetxt(tmp_path / "a.xyz", here)
    np.savetxt(tmp_path / "b.xyz", here + np.array([0, 0, 1e3]))
    with pytest.raises(SystemExit):
        main(["evaluate", "compare", str(tmp_path / "a.xyz"), str(tmp_path / "b.xyz")])
    said = " ".join(capsys.readouterr().err.split())
    assert "found none. Check that both are in one frame" in said
