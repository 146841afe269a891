"""Real recordings by others: what must come out, and what must not pass.

These tests do not prove absolute accuracy: the calibrations are as given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fringe3d.design import assess
from fringe3d.errors import CalibrationError, Fringe3DError, MethodError
from fringe3d.health import period_disagreement
from fringe3d.io.recording import read_scan
from fringe3d.model import Device, Rig, RigidTransform, Scan
from fringe3d.options import volume_of
from fringe3d.pipeline import Measurement, MeasureOptions, measure

DESCRIPTIONS = Path(__file__).parent.parent / "examples" / "captures"

RELIEF_MM = (690.0, 786.0)
"""The data set states 694 to 775 mm; the noise of single pixels adds up to 10 mm (6 sigma of
0.6 mm, more at the rim)."""

MAX_RELIEF_STEP_MM = 30.0
"""One period of 60 px is about 120 mm of depth here; a stripe of that height is far above this."""


def read(captures: Path, name: str, folder: str) -> Scan:
    return read_scan(DESCRIPTIONS / f"{name}.toml", images=captures / folder)


@pytest.fixture(scope="module")
def relief(captures: Path) -> Scan:
    return read(captures, "slmaster-relief", "slmaster-relief")


@pytest.fixture(scope="module")
def bust(captures: Path) -> Scan:
    return read(captures, "slmaster-bust-rendered", "slmaster-bust-rendered")


@pytest.fixture(scope="module")
def bust_points(bust: Scan) -> Measurement:
    return measure(bust)


@pytest.mark.parametrize("n_shifts", [12, 6, 4, 3])
def test_relief_is_clean_with_any_number_of_steps(relief: Scan, n_shifts: int) -> None:
    result = measure(relief, MeasureOptions(n_shifts=n_shifts))
    assert result.points is not None
    depth = result.points.points_mm[..., 2]
    assert result.points.n_points > 210_000
    assert np.nanmin(depth) >= RELIEF_MM[0]
    assert np.nanmax(depth) <= RELIEF_MM[1]
    assert result.main.n_mended > 0.01 * result.points.n_points


def test_relief_has_no_stripes_of_one_period(relief: Scan) -> None:
    result = measure(relief)
    assert result.points is not None
    depth = result.points.points_mm[..., 2]
    steps = np.abs(np.diff(depth, axis=1))
    assert np.nanmax(steps) < MAX_RELIEF_STEP_MM


@pytest.mark.parametrize("gray_bits", [5, 3, 1])
def test_relief_with_fewer_bits_and_a_depth_range_is_the_same(relief: Scan, gray_bits: int) -> None:
    everything = measure(relief)
    reduced = measure(relief, MeasureOptions(gray_bits=gray_bits, depth_mm=(680.0, 800.0)))
    assert everything.points is not None
    assert reduced.points is not None
    assert reduced.points.n_points > 0.995 * everything.points.n_points
    both = everything.points.is_valid & reduced.points.is_valid
    difference = everything.points.points_mm[both] - reduced.points.points_mm[both]
    assert (np.abs(difference).max(axis=-1) > 1e-6).mean() < 1e-3


def test_bust_depth_is_as_stated(bust_points: Measurement) -> None:
    assert bust_points.points is not None
    depth = bust_points.points.points_mm[..., 2]
    low, high = np.nanpercentile(depth, [0.5, 98.5])
    assert 507 <= low <= 520
    assert 630 <= high <= 643


def test_bust_matches_equal_an_independent_search_in_rectified_images(
    bust: Scan, bust_points: Measurement
) -> None:
    """OpenCV rectifies; along its rows the phase of C2 is searched by brute force."""
    assert bust.rig is not None
    assert bust_points.points is not None
    assert bust_points.matches is not None
    main1, main2 = (camera.directions[0].main for camera in bust_points.phases)
    c1, c2 = bust.rig.cameras
    in_view, columns, rectified_column = rectified_search(
        c1, c2, main1.absolute_phase, main2.absolute_phase
    )
    accepted = bust_points.points.is_valid
    assert (accepted & in_view).sum() >= 0.95 * in_view.sum()
    both = accepted & in_view
    found = rectified_column(bust_points.matches.pixels[both])
    # The brute force searches the nearest row: half a row off, fringes tilted by 10 degrees
    # displace the crossing by up to 0.1 px.
    assert np.median(np.abs(found - columns[both])) < 0.1
    assert (np.abs(found - columns[both]) > 2).mean() < 0.005


def rectified_search(
    c1: Device,
    c2: Device,
    phase1: NDArray[np.float64],
    phase2: NDArray[np.float64],
) -> tuple[
    NDArray[np.bool_], NDArray[np.float64], Callable[[NDArray[np.float64]], NDArray[np.float64]]
]:
    """Return which pixels of C1 have their phase in C2's row, the rectified column there, and
    the function that gives the rectified column of pixels of C2.
    """
    pose = c2.device_from_world @ c1.device_from_world.inverse()
    size = (c1.n_cols, c1.n_rows)
    d1, d2 = c1.distortion[:5], c2.distortion[:5]
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        c1.camera_matrix, d1, c2.camera_matrix, d2, size, pose.rotation,
        pose.translation.reshape(3, 1),
    )  # fmt: skip

    def rectified_column(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), c2.camera_matrix, d2, R=r2, P=p2)
        return np.asarray(flat.reshape(-1, 2)[:, 0])

    maps = cv2.initUndistortRectifyMap(c2.camera_matrix, d2, r2, p2, size, cv2.CV_32FC1)
    rows2 = cv2.remap(phase2.astype(np.float32), maps[0], maps[1], cv2.INTER_LINEAR,
                      borderValue=float("nan"))  # fmt: skip
    valid = np.argwhere(np.isfinite(phase1))
    pixels = valid[:, ::-1].astype(np.float64).reshape(-1, 1, 2)
    rectified = cv2.undistortPoints(pixels, c1.camera_matrix, d1, R=r1, P=p1).reshape(-1, 2)
    row_of = np.rint(rectified[:, 1]).astype(int)
    in_view = np.zeros(phase1.shape, bool)
    columns = np.full(phase1.shape, np.nan)
    for row in np.unique(row_of[(row_of >= 0) & (row_of < len(rows2))]):
        chosen = valid[row_of == row]
        difference = rows2[row][None] - phase1[chosen[:, 0], chosen[:, 1]][:, None]
        left, right = difference[:, :-1], difference[:, 1:]
        with np.errstate(invalid="ignore"):
            crossing = (left * right <= 0) & (np.abs(right - left) < 1.5)
        has = crossing.any(axis=1)
        at = np.argmax(crossing, axis=1)
        pick = np.arange(len(chosen))
        a, b = left[pick, at], right[pick, at]
        in_view[chosen[has, 0], chosen[has, 1]] = True
        columns[chosen[has, 0], chosen[has, 1]] = (at + a / np.where(a == b, 1, a - b))[has]
    return in_view, columns, rectified_column


@pytest.mark.parametrize("gray_bits", [5, 3])
def test_bust_with_fewer_bits_is_the_same_where_both_measure(
    bust: Scan, bust_points: Measurement, gray_bits: int
) -> None:
    reduced = measure(bust, MeasureOptions(gray_bits=gray_bits, depth_mm=(500.0, 680.0)))
    assert bust_points.points is not None
    assert reduced.points is not None
    assert reduced.method == "m2"
    assert reduced.points.n_points > 0.99 * bust_points.points.n_points
    both = bust_points.points.is_valid & reduced.points.is_valid
    away = np.linalg.norm(
        bust_points.points.points_mm[both] - reduced.points.points_mm[both], axis=-1
    )
    assert (away > 0.1).mean() < 0.002


def test_bust_breaks_at_the_number_of_bits_that_the_design_predicts(bust: Scan) -> None:
    """The period is the median in C2's images; without the projector C2's segments are counted."""
    depth = (500.0, 650.0)
    assert bust.rig is not None
    options = MeasureOptions(depth_mm=depth)
    rig = replace(bust.rig, volume=volume_of(bust.rig, bust.stacks[0].device_name, options))
    needs = assess(rig, period_px=12.0, camera_period_px=26.9).needs
    assert needs.bits == 3
    enough = measure(bust, replace(options, gray_bits=3))
    assert enough.points is not None
    assert enough.points.n_points > 375_000
    for gray_bits in (2, 1, 0):
        with pytest.raises(MethodError, match=r"in 'c2', found up to [67].*3 cyclic code images"):
            measure(bust, replace(options, gray_bits=gray_bits))


@pytest.mark.parametrize("number", ["0020", "0021"])
def test_shell_agrees_with_the_cloud_of_its_author(captures: Path, number: str) -> None:
    result = measure(read(captures, f"sltk-shell-{number}", "sltk-shell"))
    assert result.points is not None
    assert result.matches is not None
    cloud = trimesh.load(captures / "sltk-shell" / f"scan_{number}_cloud.ply")
    assert isinstance(cloud, trimesh.PointCloud)
    theirs = np.asarray(cloud.vertices) * [1, -1, -1]
    ours = result.points.points_mm[result.points.is_valid]
    assert len(ours) > 95_000
    for a, b in ((ours, theirs), (theirs, ours)):
        distance, _ = cKDTree(b).query(a)
        assert np.median(distance) <= 0.06
        assert np.percentile(distance, 90) <= 0.4
    # The random part of the residual is that of whole projector pixels; the rest is the given
    # calibration (a smooth pattern of half a pixel).
    residual = result.matches.epipolar_residual_px[result.points.is_valid]
    assert np.median(np.abs(residual)) < 0.5


def test_bricks_notice_that_gamma_makes_the_periods_disagree(captures: Path) -> None:
    result = measure(read(captures, "phaseshift-bricks", "phaseshift-bricks"))
    assert result.method == "phase"
    assert len(result.phases[0].directions) == 2
    for direction in result.phases[0].directions:
        assert len(direction.others) == 1
        difference = period_disagreement(direction.main, direction.others[0])
        typical = np.nanmedian(np.abs(difference))
        assert 2 < typical < 6
    said = [f for f in result.warnings if f.name == "c1_period_disagreement_px"]
    assert len(said) == 1
    assert "gamma" in said[0].text
    assert {key[:4] for key in said[0].figures} == {"c1_x", "c1_y"}
    assert len(result.warnings) == 2


def changed(rig: Rig, pose: RigidTransform) -> Rig:
    """Return the rig with another pose of its second device."""
    second = rig.projector or rig.cameras[1]
    moved = replace(second, device_from_world=pose)
    if rig.projector is not None:
        return replace(rig, projector=moved)
    return replace(rig, cameras=(rig.cameras[0], moved))


@pytest.mark.parametrize("fault", ["R inverted", "pose inverted"])
@pytest.mark.parametrize("name", ["relief", "bust"])
def test_an_inverted_pose_does_not_pass_silently(
    request: pytest.FixtureRequest, name: str, fault: str
) -> None:
    scan: Scan = request.getfixturevalue(name)
    assert scan.rig is not None
    second = scan.rig.projector or scan.rig.cameras[1]
    pose = second.device_from_world
    inverted = RigidTransform(rotation=pose.rotation.T, translation=pose.translation)
    wrong = changed(scan.rig, inverted if fault == "R inverted" else pose.inverse())
    assert_noticed(Scan(stacks=scan.stacks, rig=wrong))


@pytest.mark.parametrize("degrees", [1.0, 5.0])
def test_a_turned_second_camera_does_not_pass_silently(bust: Scan, degrees: float) -> None:
    assert bust.rig is not None
    pose = bust.rig.cameras[1].device_from_world
    turned = RigidTransform(
        rotation=Rotation.from_euler("x", degrees, degrees=True).as_matrix() @ pose.rotation,
        translation=pose.translation,
    )
    assert_noticed(Scan(stacks=bust.stacks, rig=changed(bust.rig, turned)))


def test_shell_with_an_inverted_pose_is_an_error(captures: Path) -> None:
    scan = read(captures, "sltk-shell-0020", "sltk-shell")
    assert scan.rig is not None
    assert scan.rig.projector is not None
    pose = scan.rig.projector.device_from_world.inverse()
    with pytest.raises(CalibrationError, match="epipolar residual"):
        measure(Scan(stacks=scan.stacks, rig=changed(scan.rig, pose)))


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("slmaster-relief", "slmaster-bust-rendered"),
        ("slmaster-relief", "sltk-shell"),
        ("slmaster-bust-rendered", "slmaster-relief"),
        ("sltk-shell-0020", "slmaster-relief"),
    ],
)
def test_the_calibration_of_another_set_is_refused(captures: Path, name: str, other: str) -> None:
    folder = name.removesuffix("-0020")
    with pytest.raises(Fringe3DError, match=r"expected|calibrated for"):
        measure(
            read_scan(
                DESCRIPTIONS / f"{name}.toml",
                images=captures / folder,
                rig=DESCRIPTIONS / f"{other}-rig.toml",
            )
        )


def assert_noticed(scan: Scan) -> None:
    """Assert that measuring gives an error, or a warning that names the calibration."""
    try:
        result = measure(scan)
    except CalibrationError:
        return
    assert any("calibration" in finding.text for finding in result.warnings)
