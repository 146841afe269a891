"""`fringe3d evaluate fit`: numbers of surfaces, and how certain they are, against closed forms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.cli.run import main
from fringe3d.evaluate import fit_cone, fit_cylinder, fit_plane
from fringe3d.io.clouds import CloudFile
from fringe3d.report.fitted import fit_record

Floats = NDArray[np.float64]

TURN, ALONG = (a.ravel() for a in np.meshgrid(np.arange(36) * np.pi / 18, np.linspace(-6, 6, 25)))
N = len(TURN)


def round_body(radius_mm: float, half_angle: float = 0.0) -> Floats:
    """Return points of a body that widens along z, evenly all around."""
    across = radius_mm + ALONG * np.tan(half_angle)
    return np.column_stack([across * np.cos(TURN), across * np.sin(TURN), ALONG])


def scattered(points: Floats, outward: Floats, sigma_mm: float) -> Floats:
    """Return points moved along normals by plus and minus sigma in turns: no mean, no tilt."""
    signs = np.where((np.arange(N) // 2) % 2 == np.arange(N) % 2, 1.0, -1.0)
    return np.asarray(points + sigma_mm * signs[:, None] * outward)


def test_a_cylinder_all_around_is_as_certain_as_the_mean_of_its_points() -> None:
    outward = np.column_stack([np.cos(TURN), np.sin(TURN), 0 * TURN])
    points = scattered(round_body(8.0), outward, 0.01)
    record = fit_record(CloudFile(points_mm=points), fit_cylinder(points))
    assert record["diameter_mm"] == pytest.approx(16, abs=1e-4)
    # Radius: the mean of n distances, s / sqrt(n); place across the axis: s sqrt(2 / n).
    sigma = 0.01 * np.sqrt(N / (N - 5))
    assert record["diameter_std_mm"] == pytest.approx(2 * sigma / np.sqrt(N), rel=1e-3)
    np.testing.assert_allclose(record["shift_std_mm"], sigma * np.sqrt(2 / N), rtol=1e-3)
    # A turn moves points by z cos(turn): variance s^2 / (n <z^2> / 2).
    turn = np.degrees(sigma * np.sqrt(2 / (N * (ALONG**2).mean())))
    np.testing.assert_allclose(record["turn_std_deg"], turn, rtol=1e-2)
    assert record["form_mm"] == pytest.approx(0.02, rel=0.01)


def test_a_cone_tells_its_angle_and_the_diameter_at_its_point() -> None:
    points = round_body(8.0, np.radians(10.0))
    record = fit_record(CloudFile(points_mm=points), fit_cone(points))
    assert record["half_angle_deg"] == pytest.approx(10, abs=1e-6)
    z = record["point_mm"][2] * np.sign(record["axis"][2])
    assert record["axis"][2] == pytest.approx(1)  # it widens along its axis
    assert record["diameter_mm"] == pytest.approx(16 + 2 * z * np.tan(np.radians(10)), abs=1e-6)


def test_sigma_along_the_ray_counts_by_its_part_along_the_normal() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20)))
    slope = np.radians(60)
    points = np.column_stack([x * np.cos(slope), y, x * np.sin(slope)])  # 60 deg to the rays
    far = 1e6  # rays of nearly one direction
    cloud = CloudFile(points_mm=points, sigma_mm=np.full(len(x), 0.02),
                      viewpoint_mm=np.array([0, 0, -far]))  # fmt: skip
    record = fit_record(cloud, fit_plane(points))
    assert record["height_std_mm"] == pytest.approx(0.02 * 0.5 / np.sqrt(len(x)), rel=1e-3)
    assert record["sigma_from"] == "sigma of the points"


def test_the_command_fits_what_lies_in_the_box(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bore, floor = round_body(5.0), np.column_stack([ALONG, 9 * np.sin(TURN), 0 * TURN - 20])
    np.savetxt(tmp_path / "part.xyz", np.vstack([bore, floor]))
    command = ["evaluate", "fit", str(tmp_path / "part.xyz"), "cylinder", "--box=:,:,-10:",
               "--out", str(tmp_path / "fit"), "--json"]  # fmt: skip
    main(command)
    record = json.loads(capsys.readouterr().out)
    assert record["diameter_mm"] == pytest.approx(10, abs=1e-6)
    assert record["points"] + record["left_out"] == N
    names = {path.name for path in (tmp_path / "fit").iterdir()}
    assert names == {"fit.md", "fit.json", "overview.png", "deviations.ply"}
    assert json.loads((tmp_path / "fit/fit.json").read_text()) == record


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["plane", "--box=1:2,3:4"], "X0:X1,Y0:Y1,Z0:Z1"),
        (["plane", "--box=2:1,:,:"], "each end above its beginning"),
        (["plane", "--box=100:,:,:"], "fills"),
        (["cone", "--box=4.9:,:,:-5.9"], "cone"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, words: list[str], expected: str,
                           capsys: pytest.CaptureFixture[str]) -> None:  # fmt: skip
    np.savetxt(tmp_path / "part.xyz", round_body(5.0)[:300:2])
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "fit", str(tmp_path / "part.xyz"), *words])
    assert end.value.code == 2
    told = " ".join(capsys.readouterr().err.split())
    assert expected in told
    assert "Traceback" not in told
