"""A rig found again from overlaps, against closed forms: balls on a table, seen by a true rig."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ball_views import AXIS, BALLS, camera, rays_of
from fringe3d.calibrate import Homologous, Sight, compare_rigs, first_depths, placed
from fringe3d.model import Device, Rig, RigidTransform, SurfaceView, TablePosition
from fringe3d.register import RegisterOptions, TablePrior, register, split_edges, surface_view
from fringe3d.rig_from_views import RigFromViews, rig_from_views

Floats = NDArray[np.float64]

ANGLES = (0, 60, 120, 180, 240, 300)
SPAN = np.linspace(-10, 10, 5)
BOX = np.stack(np.meshgrid(SPAN, SPAN, SPAN, indexing="ij"), axis=-1).reshape(-1, 3)
"""Points of the body's box, mm."""


def turned(
    device: Device, name: str, *, role: Literal["camera", "projector"], yaw_deg: float
) -> Device:
    """Return the same device, carried about the y axis of the world."""
    carry = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
    pose = device.device_from_world
    return replace(device, name=name, role=role, device_from_world=RigidTransform(
        rotation=pose.rotation @ carry.T, translation=pose.translation))  # fmt: skip


C1 = camera()
LIGHT = turned(C1, "projector", role="projector", yaw_deg=11)
TRUE = Rig(cameras=(C1, turned(C1, "c2", role="camera", yaw_deg=28)), projector=LIGHT)


def image(device: Device, points: Floats) -> Floats:
    """Return the pinhole image (x, y)."""
    pose = device.device_from_world
    x, y, z = (points @ pose.rotation.T + pose.translation).T
    return np.stack([x / z, y / z], axis=1) * device.focal_px + device.center_px


def slopes(device: Device, points: Floats, ways: Floats) -> Floats:
    """Return the change of the image along ways (n, 3), px / mm, between two near points."""
    return (image(device, points + 1e-4 * ways) - image(device, points - 1e-4 * ways)) / 2e-4


def homologous(angle: float, noise_px: float) -> Homologous:
    """Return what the true rig sees of the balls, turned by an angle, with noise."""
    turn, origin = AXIS.turn(np.radians(angle)), C1.center_world
    directions = rays_of(C1).reshape(-1, 3)
    depth, own = np.full(len(directions), np.inf), np.full((len(directions), 3), np.nan)
    for *center, radius in BALLS:
        to = turn.apply(center) - origin
        along = directions @ to
        under = along**2 - (to @ to - radius**2)
        near = along - np.sqrt(np.where(under > 0, under, np.nan))
        nearer = near < depth
        depth[nearer] = near[nearer]
        own[nearer] = ((origin + near[:, None] * directions - origin - to) / radius)[nearer]
    points = origin + depth[:, None] * directions
    good = np.isfinite(depth)
    for device in TRUE.devices[1:]:
        to = device.center_world - points
        with np.errstate(invalid="ignore"):
            cosine = (to * own).sum(axis=1) / np.linalg.norm(to, axis=1)
        good &= np.nan_to_num(cosine) > 0.3
    points, own = points[good], own[good]
    first = np.cross(own, [0.3, 0.9, 0.1])
    both = (first, np.cross(own, first))
    by_c2 = np.stack([slopes(TRUE.cameras[1], points, way) for way in both], axis=2)
    by_light = np.stack([slopes(LIGHT, points, way)[:, 0] for way in both], axis=1)
    slope = np.linalg.solve(by_c2.transpose(0, 2, 1), by_light[..., None])[..., 0].astype(float)
    rng, n = np.random.default_rng([1, int(angle)]), len(points)
    noise, noise2 = rng.normal(0, noise_px, (2, n, 1))
    rows, cols = np.divmod(np.flatnonzero(good), C1.n_cols)
    sigma = np.full((n, 1), noise_px)
    sight = Sight(device="c2", pixels=image(TRUE.cameras[1], points), ahead_px=noise2 - noise,
                  slopes=slope[:, None], sigma_px=sigma)  # fmt: skip
    place = image(LIGHT, points)[:, :1] + 0.5 + noise
    return Homologous(pixels_c1=np.stack([cols, rows], axis=1).astype(float), angles=(0.0,),
                      position_px=place, sigma_px=sigma, sights=(sight,))  # fmt: skip


def view_of(points: Homologous, rig: Rig, angle: float) -> SurfaceView:
    """Return the view that a rig makes of what was seen."""
    devices = rig.devices
    _, world, sigma = placed(points, devices, first_depths(points, devices))
    grid, spread = np.full((*C1.shape, 3), np.nan), np.full(C1.shape, np.nan)
    cols, rows = points.pixels_c1.astype(int).T
    grid[rows, cols], spread[rows, cols] = world, sigma
    position = TablePosition(angle=np.radians(angle))
    view = surface_view(f"at{angle}", rig.cameras[0], grid, spread, position=position)
    return split_edges(view)[0]


def found_again(rig: Rig, *, noise_px: float) -> RigFromViews:
    scans = [homologous(angle, noise_px) for angle in ANGLES]
    views = [view_of(s, rig, a) for s, a in zip(scans, ANGLES, strict=True)]
    start = [AXIS.turn(-np.radians(a)) for a in ANGLES]
    placed_ = register(views, RegisterOptions(angles="known", n_samples=1500), start=start)
    return rig_from_views(scans, views, rig, placed_, TablePrior())


def form_error_mm(rig: Rig) -> float:
    """Return the rms by which the true rig's form of the body's box differs from a rig's."""
    return compare_rigs(rig, TRUE, BOX).form_rms_mm


def wrong(kind: str) -> Rig:
    """Return the true rig with its second camera turned by 0.02 deg, or a wrong focal length."""
    c1, c2 = TRUE.cameras
    pose = c2.device_from_world
    if kind == "turned":
        knock = Rotation.from_euler("xyz", [0.01, 0.015, -0.01], degrees=True).as_matrix()
        knocked = RigidTransform(rotation=knock, translation=np.zeros(3)) @ pose
        return replace(TRUE, cameras=(c1, replace(c2, device_from_world=knocked)))
    return replace(TRUE, cameras=(c1, replace(c2, focal_px=c2.focal_px * 1.0005)))


@pytest.mark.parametrize(("kind", "fold"), [("turned", 3), ("focal", 3)])
def test_overlaps_find_a_wrong_rig_again(kind: str, fold: float) -> None:
    """The form that a turn of 0.02 deg, or 0.05 % of a focal length, spoils by 4 to 6 um."""
    rig = wrong(kind)
    found = found_again(rig, noise_px=0.01)
    assert found.is_off
    assert form_error_mm(rig) > 0.004
    assert form_error_mm(found.rig) < form_error_mm(rig) / fold


def test_a_right_rig_is_not_said_to_be_off() -> None:
    """Noise of 16 um between views does not draw the rig: a smaller scale makes noise smaller,
    too, and would be 0.3 % and 15 um off if slopes were taken at noisy points.
    """
    found = found_again(TRUE, noise_px=0.02)
    assert not found.is_off
    assert form_error_mm(found.rig) < 0.004
    assert abs(compare_rigs(found.rig, TRUE, BOX).scale - 1) < 1e-3
