"""What the measured surface hides from a device, against its shadow in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from closed_phases import Surface, grid_of, is_seen, moved, seen_points, small_rig
from cv_lens import cv_project, cv_rays
from fringe3d.correspond.occlusion import hidden_from
from fringe3d.model import Device, RigidTransform

pytestmark = pytest.mark.usefixtures("one_thread")

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SPHERE = Surface()
POLE_Z_MM, POLE_MM, TABLE_Z_MM = 12.0, 1.6, -8.0
NOISE_MM = 0.005
"""Neighbouring pixels of C1 see points 0.2 mm apart."""


def rolled(device: Device, degrees: float) -> Device:
    """Return a device turned about its line of sight: its epipolar lines run another way."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = RigidTransform(rotation=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]),
                          translation=np.zeros(3))  # fmt: skip
    return moved(device, device_from_world=turn @ device.device_from_world)


def unsure(hidden: Mask, pixels: int = 1) -> Mask:
    """Tell which pixels lie next to the border of what is hidden: C1 knows it to a pixel."""
    size = 2 * pixels + 1
    return np.asarray(maximum_filter(hidden, size) & ~minimum_filter(hidden, size))


def quiet(depths: Floats) -> Floats:
    return np.full(depths.shape, 1e-6)


def pole_before_table(camera: Device, device: Device) -> tuple[Floats, Mask]:
    """Return the depths of a flat pole before a table, and what of the table the pole hides."""
    origin, directions = cv_rays(camera, grid_of(camera))
    to_pole = (POLE_Z_MM - origin[2]) / directions[..., 2]
    on_pole = np.abs((origin + to_pole[..., None] * directions)[..., 0]) < POLE_MM
    depths = np.where(on_pole, to_pole, (TABLE_Z_MM - origin[2]) / directions[..., 2])
    points = origin + depths[..., None] * directions
    to_device = device.center_world - points
    part = (POLE_Z_MM - points[..., 2]) / to_device[..., 2]
    crossing = points[..., 0] + part * to_device[..., 0]
    return depths, ~on_pole & (np.abs(crossing) < POLE_MM)


@pytest.mark.parametrize("roll_deg", [0.0, 37.0, 90.0, 180.0, -60.0])
@pytest.mark.parametrize("name", ["c2", "projector"])
def test_shadow_and_back_of_a_sphere_are_hidden_whatever_way_c1_is_turned(
    name: str, roll_deg: float
) -> None:
    rig = small_rig(projector_azimuth_deg=40.0)
    assert rig.projector is not None
    camera, device = (
        rolled(rig.cameras[0], roll_deg),
        {"c2": rig.cameras[1]}.get(name, rig.projector),
    )
    points, depths, on_sphere = seen_points(camera, grid_of(camera), SPHERE)
    wide = moved(device, n_rows=4000, n_cols=4000, center_px=[2000.0, 2000.0], distortion=())
    expected = ~is_seen(wide, points, SPHERE)
    assert expected.sum() > 300
    found = hidden_from([device], camera, depths, quiet(depths))
    clear = ~unsure(expected) & ~unsure(on_sphere)
    assert (found == expected)[clear].all()


@pytest.mark.parametrize("number", [0, 1])
def test_a_pole_hides_its_shadow_and_not_what_is_seen_past_its_other_side(number: int) -> None:
    """Far behind a narrow pole the order along the lines changes, and all is visible.

    The table between pole and shadow is seen by both cameras.
    """
    rig = small_rig()
    camera, device = rig.cameras[number], rig.cameras[1 - number]
    depths, expected = pole_before_table(camera, device)
    assert expected.sum() > 1000
    found = hidden_from([device], camera, depths, quiet(depths))
    assert (found == expected)[~unsure(expected)].all()
    assert abs(int(found.sum()) - int(expected.sum())) < camera.n_rows  # half a pixel on each side


@pytest.mark.parametrize("margin_px", [1.0, 3.0])
def test_the_margin_is_a_margin_in_the_image_of_the_device(margin_px: float) -> None:
    rig = small_rig()
    camera, device = rig.cameras
    depths, shadow = pole_before_table(camera, device)
    found = hidden_from([device], camera, depths, quiet(depths), margin_px=margin_px)
    plain = hidden_from([device], camera, depths, quiet(depths))
    origin, directions = cv_rays(camera, grid_of(camera))
    x = cv_project(device, origin + depths[..., None] * directions)[..., 0]
    for row in range(8, camera.n_rows, 16):
        first, last = x[row][plain[row]].min(), x[row][plain[row]].max()
        step = np.median(np.diff(x[row]))
        expected = (
            ~plain[row] & (x[row] > first - margin_px + step) & (x[row] < last + margin_px - step)
        )
        table = depths[row] > depths[row][shadow[row]].min() - 1
        assert found[row][expected & table].all()
        beyond = (x[row] < first - margin_px - step) | (x[row] > last + margin_px + step)
        assert not found[row][beyond & table].any()


@pytest.mark.parametrize("slope", [-2.0, 0.0, 0.8])
def test_noise_hides_nothing_on_a_slope_that_all_devices_see(slope: float) -> None:
    """The plane z = slope x, 63 degrees at most, seen by C2 at 26 degrees from its surface."""
    rig = small_rig()
    camera = rig.cameras[0]
    origin, directions = cv_rays(camera, grid_of(camera))
    normal = np.array([-slope, 0.0, 1.0])
    depths = -(origin @ normal) / (directions @ normal)
    noisy = depths + np.random.default_rng(1).normal(0, NOISE_MM, depths.shape)
    seen = [
        d for d in (rig.cameras[1], rig.projector) if d is not None and d.center_world @ normal > 0
    ]
    for device in seen:
        found = hidden_from([device], camera, noisy, np.full(depths.shape, NOISE_MM))
        assert found.mean() < 1e-3


def test_holes_and_an_empty_map_hide_nothing() -> None:
    rig = small_rig()
    camera, device = rig.cameras
    empty = np.full(camera.shape, np.nan)
    assert not hidden_from([device], camera, empty, quiet(empty)).any()
    depths, expected = pole_before_table(camera, device)
    on_pole = depths < depths[~expected].max() - 10
    holes = np.where(on_pole, np.nan, depths)
    found = hidden_from([device], camera, holes, quiet(depths))
    assert not found.any()
