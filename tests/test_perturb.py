"""Calibration errors of a rig, measured with OpenCV's projection."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from closed_form import demo_rig
from fringe3d.model import Device, Rig
from fringe3d.simulate.perturb import displacements, perturbed

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return demo_rig()


def image(device: Device, points_mm: Floats) -> Floats:
    """Project with OpenCV, (n, 2), px."""
    pose = device.device_from_world
    turn, _ = cv2.Rodrigues(pose.rotation)
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points_mm), turn, pose.translation.reshape(3, 1),
        device.camera_matrix, device.distortion,
    )  # fmt: skip
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def points_in_volume(rig: Rig, n: int = 400) -> Floats:
    """Draw points evenly from the cylinder of the demo rig, as far as all devices see them."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-45, -45, -12.5], [45, 45, 12.5], (4 * n, 3))
    points = points[np.hypot(points[:, 0], points[:, 1]) < 45.0]
    for device in rig.devices:
        x, y = image(device, points).T
        inside = (np.abs(2 * x - device.n_cols + 1) < device.n_cols) & (
            np.abs(2 * y - device.n_rows + 1) < device.n_rows
        )
        points = points[inside]
    assert len(points) > n
    return points[:n]


def found_points(true: Rig, found: Rig, points_mm: Floats, axis: int = 0) -> Floats:
    """Return the points that a calibration makes of C1's pixels and the projector's columns.

    Newton's method on OpenCV's projections, three equations for each point.
    """
    assert true.projector is not None
    assert found.projector is not None
    projector = found.projector

    def seen(rig: Rig, light: Device, points: Floats) -> Floats:
        return np.column_stack([image(rig.cameras[0], points), image(light, points)[:, axis]])

    wanted = seen(true, true.projector, points_mm)
    points = points_mm.copy()
    for _ in range(4):
        missed = seen(found, projector, points) - wanted
        slopes = np.stack(
            [
                (seen(found, projector, points + h) - seen(found, projector, points - h)) / 2e-3
                for h in 1e-3 * np.eye(3)
            ],
            axis=-1,
        )
        points = points - np.linalg.solve(slopes, missed[..., None])[..., 0]
    assert np.abs(seen(found, projector, points) - wanted).max() < 1e-7
    return points


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("rms_px", [0.05, 0.5])
def test_the_trinocular_displacement_over_the_volume_is_as_asked(
    rig: Rig, rms_px: float, seed: int
) -> None:
    """Own points, evenly in space: 15 % for the other weights of the volume's parts."""
    found = perturbed(rig, rms_px=rms_px, seed=seed)
    points = points_in_volume(rig)
    moved = image(found.cameras[1], found_points(rig, found, points)) - image(
        rig.cameras[1], points
    )
    assert np.sqrt((moved**2).sum(-1).mean()) == pytest.approx(rms_px, rel=0.15)


@pytest.mark.parametrize("axis", [0, 1])
def test_displacements_are_those_of_opencv(rig: Rig, axis: int) -> None:
    found = perturbed(rig, rms_px=0.3, seed=5)
    points = points_in_volume(rig, 100)
    there = image(found.cameras[1], found_points(rig, found, points, axis))
    moved = displacements(rig, found, points, angle=axis * np.pi / 2)
    np.testing.assert_allclose(moved, there - image(rig.cameras[1], points), atol=1e-5)


def test_without_a_projector_the_distance_to_the_epipolar_curve_counts(rig: Rig) -> None:
    """The curve is sampled finely with OpenCV; the nearest sample is 0.001 px beside its foot."""
    true = replace(rig, projector=None)
    found = perturbed(true, rms_px=0.4, seed=2)
    points = points_in_volume(rig, 20)
    moved = displacements(true, found, points)
    c1 = found.cameras[0]
    pixels = image(true.cameras[0], points)
    normalized = cv2.undistortPointsIter(
        pixels[:, None], c1.camera_matrix, c1.distortion, np.eye(3), np.eye(3),
        (cv2.TERM_CRITERIA_COUNT, 200, 0.0),
    ) if hasattr(cv2, "undistortPointsIter") else cv2.undistortPoints(
        pixels[:, None], c1.camera_matrix, c1.distortion
    )  # fmt: skip
    pose = c1.device_from_world
    for point, (x, y), step in zip(points, normalized.reshape(-1, 2), moved, strict=True):
        depth = (pose.rotation @ point + pose.translation)[2]
        depths = depth + np.linspace(-2, 2, 8001)
        along = np.outer(depths, [x, y, 1.0]) - pose.translation
        curve = image(found.cameras[1], along @ pose.rotation)
        distances = np.linalg.norm(curve - image(true.cameras[1], point[None]), axis=1)
        assert np.linalg.norm(step) == pytest.approx(distances.min(), abs=2e-3)
    every = displacements(true, found)
    assert np.sqrt((every**2).sum(-1).mean()) == pytest.approx(0.4, rel=1e-6)


def test_every_device_gets_errors_of_pose_and_lens_and_keeps_the_rest(rig: Rig) -> None:
    found = perturbed(rig, rms_px=0.1, seed=1)
    assert found.volume is rig.volume
    for old, new in zip(rig.devices, found.devices, strict=True):
        assert (new.name, new.role, new.shape) == (old.name, old.role, old.shape)
        turned = new.device_from_world.rotation @ old.device_from_world.rotation.T
        turn = np.arccos((np.trace(turned) - 1) / 2)
        assert 1e-7 < turn < 1e-3
        assert 1e-4 < np.linalg.norm(new.center_world - old.center_world) < 1.0
        assert 1e-8 < np.abs(new.focal_px / old.focal_px - 1).max() < 1e-3
        assert 1e-4 < np.abs(new.center_px - old.center_px).max() < 1.0
        changed = new.distortion - old.distortion
        assert (changed[:4] != 0).all()
        assert (changed[4:] == 0).all()


def test_the_same_seed_gives_the_same_errors_and_zero_gives_the_rig_itself(rig: Rig) -> None:
    one, same, other = (perturbed(rig, rms_px=0.1, seed=seed) for seed in (1, 1, 2))
    assert (one.cameras[0].center_px == same.cameras[0].center_px).all()
    assert (one.cameras[0].center_px != other.cameras[0].center_px).all()
    assert perturbed(rig, rms_px=0.0, seed=1) is rig


def test_errors_grow_in_proportion(rig: Rig) -> None:
    """Small errors: twice the displacement is twice every error, to a percent."""
    small, large = (perturbed(rig, rms_px=rms, seed=4) for rms in (0.05, 0.1))
    for old, once, twice in zip(rig.devices, small.devices, large.devices, strict=True):
        np.testing.assert_allclose(
            twice.center_px - old.center_px, 2 * (once.center_px - old.center_px), rtol=0.01
        )


def test_the_origin_of_the_world_does_not_matter(rig: Rig) -> None:
    """As in rigs from a stereo calibration, whose C1 stands at the origin."""
    c1_from_world = rig.cameras[0].device_from_world
    world_from_c1 = c1_from_world.inverse()

    def moved(device: Device) -> Device:
        return replace_pose(device, device.device_from_world @ world_from_c1)

    assert rig.volume is not None
    normals = c1_from_world.rotate(rig.volume.normals)
    volume = type(rig.volume)(
        normals=normals, offsets_mm=rig.volume.offsets_mm + normals @ c1_from_world.translation
    )
    assert rig.projector is not None
    there = Rig(
        cameras=tuple(moved(camera) for camera in rig.cameras),
        projector=moved(rig.projector),
        volume=volume,
    )
    here, found = (perturbed(one, rms_px=0.1, seed=6) for one in (rig, there))
    for a, b in zip(here.devices, found.devices, strict=True):
        np.testing.assert_allclose(a.center_px, b.center_px, rtol=1e-6)
        np.testing.assert_allclose(
            a.device_from_world.rotation,
            (b.device_from_world @ c1_from_world).rotation,
            atol=1e-9,
        )


def replace_pose(device: Device, pose: object) -> Device:
    return Device(
        name=device.name, role=device.role, n_rows=device.n_rows, n_cols=device.n_cols,
        focal_px=device.focal_px, center_px=device.center_px, distortion=device.distortion,
        device_from_world=pose,  # type: ignore[arg-type]
    )  # fmt: skip


def test_what_cannot_be_perturbed_is_said(rig: Rig) -> None:
    with pytest.raises(ValueError, match=r"rms_px: expected a number from 0 on, found -0\.1"):
        perturbed(rig, rms_px=-0.1, seed=0)
    with pytest.raises(ValueError, match=r"rms_px: expected a number from 0 on, found nan"):
        perturbed(rig, rms_px=float("nan"), seed=0)
    with pytest.raises(
        ValueError, match=r"two cameras and a measuring volume, found 1 camera\(s\)"
    ):
        perturbed(replace(rig, cameras=rig.cameras[:1]), rms_px=0.1, seed=0)
    with pytest.raises(ValueError, match=r"found 2 camera\(s\) and no volume"):
        perturbed(replace(rig, volume=None), rms_px=0.1, seed=0)
