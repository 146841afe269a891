"""Cases in which a plausible method is wrong: borders, negative orders, unequal directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from closed_form import SphereScene, record_scene, simulate
from fringe3d.correspond.projector import match_projector
from fringe3d.decode import decode
from fringe3d.decode.order import order_table
from fringe3d.errors import MethodError, OutputError
from fringe3d.io.atomic import new_folder
from fringe3d.io.images import read_image
from fringe3d.model import (
    NO_ORDER,
    Device,
    Fringe,
    NoiseModel,
    PatternPlan,
    PhaseMap,
    Rejection,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.model.plan import fringes, gray_code
from fringe3d.options import Method
from fringe3d.pipeline import MeasureOptions, measure

MAD_TO_SIGMA = 1.4826


def test_a_code_does_not_wrap_around_at_the_border_of_the_projector() -> None:
    """64 periods fill the code: the first word in the last part of a period is no order 63."""
    plan = PatternPlan(patterns=gray_code(8.0, 7))
    table = order_table(plan.gray_sets[0], 16.0, (0.0, 1024.0))
    assert table.by_word[0, -1] == NO_ORDER
    assert table.by_word[0, 0] == 0
    last_word = 127 ^ (127 >> 1)
    assert table.by_word[last_word, 0] == NO_ORDER
    assert table.by_word[last_word, -1] == 63


@pytest.mark.parametrize(("period_y", "angle_deg"), [(16.0, 0.0), (128.0, 0.0), (128.0, 45.0)])
def test_sigma_of_two_directions_is_the_spread_of_the_points(
    rig: Rig, period_y: float, angle_deg: float
) -> None:
    """Also where one direction is eight times coarser, and the fringes are oblique."""
    assert rig.projector is not None
    a = np.radians(angle_deg)
    plan = PatternPlan(
        patterns=(
            *fringes(16.0, 4, angle=a), *gray_code(8.0, 8, angle=a),
            *fringes(period_y, 4, angle=a + np.pi / 2),
            *gray_code(period_y / 2, 8, angle=a + np.pi / 2),
        ),
        projector_shape=rig.projector.shape,
    )  # fmt: skip
    noise = NoiseModel(read_noise_dn=1.0)
    scan, truths = simulate(rig, plan, SphereScene(noise=noise), np.random.default_rng(3))
    result = measure(
        Scan(stacks=scan.stacks, rig=rig), MeasureOptions(method="projector", blur_px=None)
    )
    assert result.points is not None
    inner = result.points.is_valid & ~truths[0].on_sphere
    truth = truths[0].points_mm[inner]
    ray = truth - rig.cameras[0].center_world
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    error = ((result.points.points_mm[inner] - truth) * ray).sum(axis=-1)
    pull = error / result.points.sigma_mm[inner]
    # 8-bit rounding adds 4 % to the given noise.
    assert MAD_TO_SIGMA * np.median(np.abs(pull)) == pytest.approx(1.0, abs=0.1)


def quantised(cells: list[int], angle: float) -> PhaseMap:
    """Return a map of one row that sees these code cells."""
    shape = (1, len(cells))
    return PhaseMap(
        phase=np.full(shape, np.pi, np.float32),
        order_class=np.array([cells], np.int32),
        class_of_order=np.arange(-10, 30, dtype=np.int32),
        first_order=-10,
        phase_std=np.ones(shape, np.float32),
        offset=np.ones(shape, np.float32),
        modulation=np.ones(shape, np.float32),
        rejection=np.zeros(shape, np.uint16),
        period_px=1.0,
        angle=angle,
        device_name="c1",
        is_quantised=True,
    )


def test_cells_with_negative_orders_are_not_mixed_up() -> None:
    """Cells (-1, 3) and (5, 2) are two; the two pixels of cell (4, 4) meet in their middle."""
    c1 = Device(name="c1", role="camera", n_rows=1, n_cols=4, focal_px=[100, 100],
                center_px=[2, 0])  # fmt: skip
    pose = RigidTransform(rotation=np.eye(3), translation=[-10, 0, 0])
    projector = Device(name="p", role="projector", n_rows=40, n_cols=40, focal_px=[100, 100],
                       center_px=[20, 20], device_from_world=pose)  # fmt: skip
    maps = [quantised([-1, 5, 4, 4], 0.0), quantised([3, 2, 4, 4], np.pi / 2)]
    matches = match_projector(maps, c1, projector, None)
    assert matches.pixels_c1[0, :, 0].tolist() == [0.0, 1.0, 2.5, 2.5]


@pytest.mark.parametrize("cell_px", [1.0, 2.0, 8.0])
@pytest.mark.parametrize("directions", [1, 2])
def test_two_cameras_measure_with_gray_code_alone(
    rig: Rig, cell_px: float, directions: int
) -> None:
    """A cell smoothed over 7 x 7 pixels is good to a fraction of it: 15 um per px of a cell."""
    scan, truths = record_scene(
        rig,
        SphereScene(),
        seed=3,
        periods_px=(cell_px,),
        n_shifts=0,
        gray="plain",
        inverses=True,
        angles=(0.0, np.pi / 2)[:directions],
    )
    result = measure(scan)
    assert result.points is not None
    good = result.points.is_valid
    error = np.linalg.norm(result.points.points_mm - truths[0].points_mm, axis=-1)[good]
    assert good.sum() > 50_000
    assert np.median(error) < 0.015 * max(cell_px, 1)


def test_cameras_that_differ_in_focus_are_matched_by_the_same_period(rig: Rig) -> None:
    """The finer fringe is so weak in C2 that its best period is the other one."""
    scan, _ = record_scene(rig, SphereScene(), seed=3, periods_px=(16.0, 20.0))
    patterns = scan.stacks[1].plan.patterns
    fine = [i for i, p in enumerate(patterns) if isinstance(p, Fringe) and p.period_px == 16]
    images = scan.stacks[1].images.copy()
    mean = images[fine].mean(axis=0)
    images[fine] = np.rint(mean + 0.7 * (images[fine] - mean)).astype(np.uint8)
    blurred = replace(scan.stacks[1], images=images, noise=NoiseModel(read_noise_dn=1.0))
    sharp = replace(scan.stacks[0], noise=NoiseModel(read_noise_dn=1.0))
    mains = [decode(stack).directions[0].main.period_px for stack in (sharp, blurred)]
    assert mains == [16.0, 20.0]
    result = measure(Scan(stacks=(sharp, blurred), rig=scan.rig))
    assert result.points is not None
    assert result.points.n_points > 55_000


def test_one_period_without_code_is_not_absolute(rig: Rig) -> None:
    plan = PatternPlan(patterns=fringes(16.0, 4))
    scan, _ = simulate(rig, plan, SphereScene(), np.random.default_rng(3))
    assert not decode(scan.stacks[0]).directions[0].main.is_absolute


def test_trinocular_residual_keeps_whole_periods(rig: Rig) -> None:
    """A projector shifted by 20 px (1.25 periods) is told as 20 px, not as 4."""
    scan, _ = record_scene(rig, SphereScene(), seed=3)
    assert rig.projector is not None
    center = rig.projector.center_px + np.array([20.0, 0.0])
    moved = replace(rig.projector, center_px=center)
    wrong = replace(rig, projector=moved)
    with pytest.raises(ValueError, match=r"trinocular residual .*: median \|r\| (19|20)\."):
        measure(Scan(stacks=scan.stacks, rig=wrong))


def test_a_dim_linear_projector_is_not_accused_of_gamma(rig: Rig) -> None:
    """Contrast of a few grey values: the noise must not pass for a harmonic."""
    scan, _ = record_scene(rig, SphereScene(light_dn=25.0), seed=3, n_shifts=8)
    assert not [f for f in measure(scan).warnings if "gamma" in f.text]


def test_wide_periods_are_not_accused_of_gamma(rig: Rig) -> None:
    """A surface under one fringe does not show all phases alike."""
    scan, _ = record_scene(
        rig, SphereScene(), seed=3, periods_px=(16.0, 128.0, 1024.0), n_shifts=3, gray="none"
    )
    assert not [f for f in measure(scan).warnings if "gamma" in f.text]


@pytest.mark.parametrize("method", ["projector", "m2"])
@pytest.mark.parametrize("gray_bits", [5, 4, 3])
def test_a_plain_code_cut_short_is_ambiguous_where_it_is_and_nowhere_wrong(
    rig: Rig, method: Method, gray_bits: int
) -> None:
    """Periods 7 and 8 have the same three low bits in a reflected code; a second camera sees which.

    A few pixels at the rim see the plane outside the volume, whose order has a twin inside.
    """
    scan, truths = record_scene(rig, SphereScene(), seed=3, gray="plain", angles=(0.0, np.pi / 2))
    options = MeasureOptions(method=method, gray_bits=gray_bits)
    result = measure(scan, options).points
    assert result is not None
    error = np.linalg.norm(result.points_mm - truths[0].points_mm, axis=-1)[result.is_valid]
    ambiguous = (result.rejection & Rejection.AMBIGUOUS) != 0
    assert (error > 0.5).mean() < 0.005
    assert result.n_points > 35_000
    assert ambiguous.sum() < (2_000 if method == "m2" else 25_000)
    assert ambiguous.sum() > 2_000 or method == "m2"


def test_a_plain_code_cut_short_needs_the_projector_between_two_cameras(rig: Rig) -> None:
    scan, _ = record_scene(rig, SphereScene(), seed=3, gray="plain")
    alone = replace(scan, rig=replace(rig, projector=None))
    with pytest.raises(MethodError, match="repeat mirrored"):
        measure(alone, MeasureOptions(gray_bits=3))


def test_a_file_is_never_replaced_by_a_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with (
        pytest.raises(OutputError, match="found a file"),
        new_folder(tmp_path / "mine.txt", overwrite=True),
    ):
        pass
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("channels", [1, 3])
def test_tiff_compressed_by_lzw_is_read(tmp_path: Path, channels: int) -> None:
    """OpenCV writes LZW by default; blue, green, red is its order."""
    image = np.random.default_rng(1).integers(0, 60_000, (20, 30, channels), np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.tif"), image)
    found = read_image(tmp_path / "a.tif", channel="blue" if channels == 3 else "grey")
    np.testing.assert_array_equal(image[..., 0], found)
