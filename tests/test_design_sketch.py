"""Rig sketches: places, lenses, volumes and messages."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fringe3d.errors import RigError
from fringe3d.geometry import above, looking_at, looking_at_origin
from fringe3d.io.rigfile import rig_text
from fringe3d.io.sketchfile import read_sketch

EXAMPLE = Path(__file__).parent.parent / "examples" / "sketches" / "kolibri.toml"


def changed(tmp_path: Path, old: str, new: str) -> Path:
    """Return the example with a part of its text replaced."""
    text = EXAMPLE.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "sketch.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_the_example_is_the_papers_rig() -> None:
    sketch = read_sketch(EXAMPLE)
    c1, c2 = sketch.rig.cameras
    projector = sketch.rig.projector
    assert projector is not None
    # sin 27 deg = 0.4539905, cos = 0.8910065; sin 31 deg = 0.5150381, cos = 0.8571673
    # 335 * 0.4539905 * 0.5150381 = 78.3305; * 0.8571673 = 130.3638; 335 * 0.8910065 = 298.4872
    np.testing.assert_allclose(c1.center_world, [-78.3305, -130.3638, 298.4872], atol=1e-3)
    np.testing.assert_allclose(c2.center_world, [78.3305, -130.3638, 298.4872], atol=1e-3)
    # sin 22 deg = 0.3746066, cos = 0.9271839
    np.testing.assert_allclose(projector.center_world, [0.0, -125.4932, 310.6066], atol=1e-3)
    # 640 px see 93 mm at 335 mm: 640 * 335 / 93 = 2305.376 px; 64.3 mm / 20 um = 3215 px
    np.testing.assert_allclose(c1.focal_px, 2305.376, atol=1e-3)
    np.testing.assert_allclose(projector.focal_px, 3215.0, atol=1e-9)
    assert (c1.shape, projector.shape) == ((512, 640), (768, 1024))
    np.testing.assert_array_equal(c1.center_px, [319.5, 255.5])
    assert not c1.distortion.any()
    assert (sketch.period_px, sketch.angle, sketch.n_shifts) == (16.0, 0.0, 4)
    volume = sketch.rig.volume
    assert volume is not None
    inside = [[39.9, 0.0, 12.4], [0.0, -39.9, -12.4]]
    outside = [[40.2, 0.0, 0.0], [0.0, 0.0, 12.6], [0.0, 0.0, -12.6], [0.0, 41.0, 0.0]]
    assert volume.contains(inside).all()
    assert not volume.contains(outside).any()


@pytest.mark.parametrize("place", [(0, 0, 335), (50, -80, 200), (-30, 90, -150), (0, 300, 0)])
def test_a_device_looks_at_its_target_with_rows_along_x(place: tuple[float, float, float]) -> None:
    target = np.array([3.0, -4.0, 5.0])
    pose = looking_at(place, target)
    np.testing.assert_allclose(pose.inverse().translation, place, atol=1e-9)
    x, y, z = pose.apply(target)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert z == pytest.approx(np.linalg.norm(target - place))
    # A step along the world's x moves the image along its row alone, to the right.
    step = pose.rotate([1.0, 0.0, 0.0])
    assert step[0] > 0.5
    assert step[1] == pytest.approx(0.0, abs=1e-12)


def test_a_device_that_looks_along_x_has_rows_along_y() -> None:
    pose = looking_at_origin([300.0, 0.0, 0.0])
    np.testing.assert_allclose(pose.rotate([0.0, 1.0, 0.0]), [1.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="apart from the point"):
        looking_at([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])


def test_azimuth_runs_from_minus_y_towards_x() -> None:
    for azimuth, direction in ((0, [0, -1, 0]), (90, [1, 0, 0]), (180, [0, 1, 0])):
        np.testing.assert_allclose(above(90.0, azimuth, 2.0), 2.0 * np.array(direction), atol=1e-12)
    np.testing.assert_allclose(above(0.0, 50.0, 7.0), [0, 0, 7], atol=1e-12)


def test_a_place_may_be_given_as_coordinates(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        "distance_mm = 335.0\ntilt_deg = 22.0\nazimuth_deg = 0.0",
        "position_mm = [10.0, 20.0, 300.0]\nlook_at_mm = [10.0, 0.0, 0.0]\n"
        "center_px = [511.5, 800.0]",
    )
    projector = read_sketch(path).rig.projector
    assert projector is not None
    np.testing.assert_allclose(projector.center_world, [10, 20, 300], atol=1e-9)
    np.testing.assert_array_equal(projector.center_px, [511.5, 800.0])
    away = np.array([0.0, -20.0, -300.0]) / math.hypot(20, 300)
    np.testing.assert_allclose(projector.device_from_world.rotation[2], away, atol=1e-12)


@pytest.mark.parametrize(
    ("table", "inside", "outside"),
    [
        ('kind = "box"\nsize_mm = [10.0, 20.0, 30.0]', [4.9, 9.9, -14.9],
         [[5.1, 0, 0], [0, 0, 16]]),
        ('kind = "depth"\ndepth_min_mm = 320.0\ndepth_max_mm = 350.0', [0.0, 0.0, 0.0],
         [[0, 0, 20], [0, 0, -20]]),
    ],
)  # fmt: skip
def test_other_volumes(
    tmp_path: Path, table: str, inside: list[float], outside: list[list[float]]
) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    head, _, rest = text.partition("[volume]")
    path = tmp_path / "sketch.toml"
    path.write_text(f"{head}[volume]\n{table}\n\n[fringes]{rest.partition('[fringes]')[2]}")
    volume = read_sketch(path).rig.volume
    assert volume is not None
    assert volume.contains(inside)
    assert not volume.contains(outside).any()


def test_fringes_and_volume_may_be_missing(tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8").partition("[volume]")[0]
    path = tmp_path / "sketch.toml"
    path.write_text(text)
    sketch = read_sketch(path)
    assert (sketch.rig.volume, sketch.period_px, sketch.n_shifts) == (None, None, None)


def test_fringe_angles_are_degrees(tmp_path: Path) -> None:
    sketch = read_sketch(changed(tmp_path, "angle_deg = 0.0", "angle_deg = 30.0"))
    assert sketch.angle == pytest.approx(math.pi / 6)


def test_a_rig_file_is_read_as_well(tmp_path: Path) -> None:
    rig = read_sketch(EXAMPLE).rig
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(rig), encoding="utf-8")
    found = read_sketch(path)
    assert [device.name for device in found.rig.devices] == ["c1", "c2", "projector"]
    assert found.period_px is None
    with pytest.raises(RigError, match="expected a file, found none"):
        read_sketch(tmp_path / "missing.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("field_mm = 93.0", "fieldmm = 93.0",
         "unknown key 'devices[0].fieldmm'. Did you mean 'field_mm'?"),
        ("diameter_mm", "diametre_mm",
         "unknown key 'volume.diametre_mm'. Did you mean 'diameter_mm'?"),
        ('kind = "cylinder"', 'kind = "box"\nsize_mm = [1.0, 2.0, 3.0]',
         "unknown key 'volume.diameter_mm'. The keys of the kind 'box': kind, size_mm"),
        ("steps = 4", "field_mm = 4",
         "unknown key 'fringes.field_mm'. The keys of the fringes: angle_deg, period_px, steps"),
        ("[volume]", "[volumes]", "unknown key 'volumes'. Did you mean 'volume'?"),
        ('kind = "cylinder"', 'kind = ["box"]', "expected one of the kinds"),
        ("tilt_deg = 27.0\n", "", "either distance_mm, tilt_deg and azimuth_deg, or position_mm, "
         "found only a part"),
        ("pixel_um = 20.0", "", "either pixel_um and focal_mm, or field_mm, found only a part"),
        ("field_mm = 93.0", "field_mm = 93.0\npixel_um = 3.0", "found some of both"),
        ("field_mm = 93.0", "", "found none of them"),
        ("distance_mm = 335.0", "distance_mm = 335.0\nposition_mm = [1.0, 2.0, 3.0]",
         "found some of both"),
        ("distance_mm = 335.0", "distance_mm = 335.0\nlook_at_mm = [0, 0, 0]",
         "look_at_mm: expected it beside position_mm"),
        ("distance_mm = 335.0", "distance_mm = -335.0", "distance_mm: expected a number above 0"),
        ("size = [640, 512]", "size = [0, 512]", "a number of at least 1"),
        ("sketch/1", "sketch/2", "Is this another kind of file"),
        ('kind = "cylinder"', 'kind = "cone"', "found 'cone'"),
        ("height_mm = 25.0", "height_mm = nan", "expected a finite number"),
        ("period_px = 16.0", "period_px = 1.0", "fringes.period_px: expected a number of at least"),
        ("steps = 4", "steps = 2", "fringes.steps: expected a number of at least 3"),
        ('name = "c2"', 'name = "c1"', "a different name for each device"),
        ('name = "c2"\nrole = "camera"', 'name = "c2"\nrole = "projector"',
         "at most one projector"),
        ("distance_mm = 335.0\ntilt_deg = 22.0\nazimuth_deg = 0.0", "position_mm = [0, 0, 0]",
         "device 'projector': expected a device apart from the point"),
    ],
)  # fmt: skip
def test_mistakes_say_where_and_what_to_do(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = changed(tmp_path, old, new)
    with pytest.raises(RigError) as caught:
        read_sketch(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_sketch_of_no_camera_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sketch.toml"
    path.write_text('format = "fringe3d-sketch/1"\ndevices = []\n')
    with pytest.raises(RigError, match="at least one device with role 'camera', found none"):
        read_sketch(path)
