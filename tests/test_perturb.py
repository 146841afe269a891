"""Calibration errors of a rig, measured with OpenCV's projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from changed_rigs import moved_rig
from closed_form import demo_rig
from cv_lens import cv_project, cv_rays
from fringe3d.model import Device, Rig, RigidTransform
from fringe3d.simulate.perturb import displacements, perturbed

Floats = NDArray[np.float64]

DISTANCE_MM = 335.0
"""Of the devices of the demo rig from the middle of its volume."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return demo_rig()


def points_in_volume(rig: Rig, n: int = 400) -> Floats:
    """Draw points evenly from the cylinder of the demo rig, as far as all devices see them."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-45, -45, -12.5], [45, 45, 12.5], (4 * n, 3))
    points = points[np.hypot(points[:, 0], points[:, 1]) < 45.0]
    for device in rig.devices:
        x, y = cv_project(device, points).T
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
        return np.column_stack(
            [cv_project(rig.cameras[0], points), cv_project(light, points)[:, axis]]
        )

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
    moved = cv_project(found.cameras[1], found_points(rig, found, points)) - cv_project(
        rig.cameras[1], points
    )
    assert np.sqrt((moved**2).sum(-1).mean()) == pytest.approx(rms_px, rel=0.15)


@pytest.mark.parametrize("axis", [0, 1])
def test_displacements_are_those_of_opencv(rig: Rig, axis: int) -> None:
    found = perturbed(rig, rms_px=0.3, seed=5)
    points = points_in_volume(rig, 100)
    there = cv_project(found.cameras[1], found_points(rig, found, points, axis))
    moved = displacements(rig, found, points, angle=axis * np.pi / 2)
    np.testing.assert_allclose(moved, there - cv_project(rig.cameras[1], points), atol=1e-5)


def test_without_a_projector_the_distance_to_the_epipolar_curve_counts(rig: Rig) -> None:
    """The curve is sampled finely with OpenCV; the nearest sample is 0.001 px beside its foot."""
    true = replace(rig, projector=None)
    found = perturbed(true, rms_px=0.4, seed=2)
    points = points_in_volume(rig, 20)
    moved = displacements(true, found, points)
    origin, directions = cv_rays(found.cameras[0], cv_project(true.cameras[0], points))
    for point, along, step in zip(points, directions, moved, strict=True):
        depths = (point - origin) @ along + np.linspace(-2, 2, 8001)
        curve = cv_project(found.cameras[1], origin + depths[:, None] * along)
        distances = np.linalg.norm(curve - cv_project(true.cameras[1], point), axis=1)
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


def corner_shifts(true: Device, found: Device) -> Floats:
    """Return by how many px each of the 13 errors of a device alone moves its image, (13,).

    Of points that it sees in the corners, as far away as the volume, with OpenCV.
    """
    pose = true.device_from_world
    error = found.device_from_world @ pose.inverse()
    turn, still = Rotation.from_matrix(error.rotation).as_rotvec(), np.zeros(3)
    center, lens = found.center_px - true.center_px, found.distortion - true.distortion
    changed = [
        *(replace(true, device_from_world=rigid(axis * turn, still) @ pose) for axis in np.eye(3)),
        *(replace(true, device_from_world=rigid(still, axis * error.translation) @ pose)
          for axis in np.eye(3)),
        replace(true, focal_px=found.focal_px),
        *(replace(true, center_px=true.center_px + axis * center) for axis in np.eye(2)),
        *(replace(true, distortion=true.distortion + axis * lens) for axis in np.eye(14)[:4]),
    ]  # fmt: skip
    right, bottom = true.n_cols - 1, true.n_rows - 1
    origin, directions = cv_rays(true, [[0, 0], [right, 0], [0, bottom], [right, bottom]])
    points = origin + DISTANCE_MM * directions
    seen = cv_project(true, points)
    away = [np.linalg.norm(cv_project(device, points) - seen, axis=1).max() for device in changed]
    return np.array(away)


def rigid(turn: Floats, shift: Floats) -> RigidTransform:
    return RigidTransform(rotation=Rotation.from_rotvec(turn).as_matrix(), translation=shift)


def test_each_error_moves_the_image_by_as_much_at_its_border(rig: Rig) -> None:
    """The root mean square of 36 draws of each: known to 12 %."""
    drawn = []
    for seed in range(12):
        found = perturbed(rig, rms_px=0.1, seed=seed)
        pairs = zip(rig.devices, found.devices, strict=True)
        shifts = np.stack([corner_shifts(*pair) for pair in pairs])
        drawn.append(shifts / np.sqrt((shifts[:, :11] ** 2).mean()))
    spread = np.sqrt((np.concatenate(drawn) ** 2).mean(axis=0))
    # Three times 12 %, and up to 10 % for the bend of the lenses in the corners.
    np.testing.assert_allclose(spread[:11], 1.0, atol=0.46)
    # p1 and p2 move a corner by (2 x y, r^2 + 2 y^2) and so on: by 2.1 and 2.5 where r is 1.
    np.testing.assert_allclose(spread[11:], [2.1, 2.5], rtol=0.46)


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
    there = moved_rig(rig, c1_from_world)
    here, found = (perturbed(one, rms_px=0.1, seed=6) for one in (rig, there))
    for a, b in zip(here.devices, found.devices, strict=True):
        np.testing.assert_allclose(a.center_px, b.center_px, rtol=1e-6)
        np.testing.assert_allclose(
            a.device_from_world.rotation,
            (b.device_from_world @ c1_from_world).rotation,
            atol=1e-9,
        )


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
