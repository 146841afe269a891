"""Several exposures become one stack; saturated steps are left out of the fit.

The truth is a closed form: fringes of a known phase on a surface whose brightness spans a factor of
400, recorded here by a sensor with shot noise.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.decode import fuse, without_saturated, wrapped_phase
from fringe3d.io.recording import read_scan
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import ImageStack, NoiseModel, PatternPlan, Rejection, Scan
from fringe3d.model.plan import fringes, gray_code
from fringe3d.pipeline import measure

SHAPE = (150, 200)
BLACK, NOISE = 5.0, NoiseModel(read_noise_dn=0.6, gain_dn_per_e=0.03)
EXPOSURES = (8.0, 0.2, 1.2)


def true_phase() -> NDArray[np.float64]:
    return 2 * np.pi * np.broadcast_to(np.arange(SHAPE[1]) + 30.0, SHAPE) / 11.3


def albedo() -> NDArray[np.float64]:
    """Return the brightness of the surface, 0.01 (dark) to 4 (gloss), from row to row."""
    return np.broadcast_to(np.geomspace(0.01, 4, SHAPE[0])[:, None], SHAPE)


def exposed(
    exposure: float, n_shifts: int, *, seed: int, noise: NoiseModel | None = NOISE
) -> ImageStack:
    plan = PatternPlan(patterns=fringes(16.0, n_shifts) + gray_code(8.0, 6))
    rng, images = np.random.default_rng(seed), []
    w = true_phase() * 16 / (2 * np.pi)
    for number, pattern in enumerate(plan.patterns):
        if number < n_shifts:
            level = 0.5 + 0.5 * np.cos(true_phase() - plan.fringe_sets[0].shifts[number])
        else:
            cell = (w // 8.0).astype(int)
            level = ((cell ^ (cell >> 1)) >> pattern.bit) & 1  # type: ignore[union-attr]
        light = 200 * exposure * albedo() * (0.03 + 0.97 * level)
        sigma = np.sqrt(NOISE.read_noise_dn**2 - 1 / 12 + NOISE.gain_dn_per_e * light)
        grey = BLACK + light + sigma * rng.standard_normal(SHAPE)
        images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    return ImageStack(images=np.stack(images), plan=plan, device_name="c1", saturation_dn=255,
                      black_level_dn=BLACK, noise=noise)  # fmt: skip


def series(n_shifts: int, *, seed: int = 1, noise: NoiseModel | None = NOISE) -> list[ImageStack]:
    return [exposed(e, n_shifts, seed=seed + i, noise=noise) for i, e in enumerate(EXPOSURES)]


def error_of(phase: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.asarray(np.angle(np.exp(1j * (phase - true_phase()))))


def test_what_any_exposure_measures_the_fused_stack_measures() -> None:
    stacks = series(4)
    fringe_set = stacks[0].plan.fringe_sets[0]
    single = [wrapped_phase(stack, fringe_set).rejection == 0 for stack in stacks]
    fused = wrapped_phase(fuse(stacks, EXPOSURES), fringe_set).rejection == 0
    some = np.any(single, axis=0)
    assert fused[some].mean() > 0.99
    assert fused.mean() > max(s.mean() for s in single) + 0.15


@pytest.mark.parametrize(("n_shifts", "noise"), [(4, NOISE), (8, NOISE), (8, None)])
def test_sigma_of_the_fused_phase_is_its_scatter(n_shifts: int, noise: NoiseModel | None) -> None:
    stacks = series(n_shifts, noise=noise)
    found = wrapped_phase(fuse(stacks, EXPOSURES), stacks[0].plan.fringe_sets[0])
    pull = error_of(found.phase) / found.phase_std
    for rows in np.array_split(np.arange(SHAPE[0]), 5):
        part = pull[rows][np.isfinite(pull[rows])]
        if len(part) > 1000:
            assert np.std(part) == pytest.approx(1, abs=0.08)


def test_brightness_is_even_over_the_exposures() -> None:
    stacks = series(8)
    stack = fuse(stacks, EXPOSURES)
    found = wrapped_phase(stack, stack.plan.fringe_sets[0])
    good = found.rejection == 0
    offset = found.offset[good] / (200 * 8.0 * albedo()[good] * (0.03 + 0.97 * 0.5))
    assert offset[good.sum() // 10 :].std() < 0.05
    assert np.median(offset) == pytest.approx(1, abs=0.01)
    assert stack.fused is not None
    assert set(np.unique(stack.fused.exposure)) == {np.float32(e) for e in EXPOSURES}


@pytest.mark.parametrize("n_shifts", [4, 5, 8, 16])
def test_saturated_steps_are_left_out(n_shifts: int) -> None:
    stack = exposed(1.5, n_shifts, seed=3)
    fringe_set = stack.plan.fringe_sets[0]
    before = wrapped_phase(stack, fringe_set)
    stack = without_saturated(stack)
    after = wrapped_phase(stack, fringe_set)
    gained = (before.rejection != 0) & (after.rejection == 0)
    assert gained.mean() > 0.03
    assert stack.sigma_growth is not None
    pull = (error_of(after.phase) / after.phase_std)[gained]
    assert np.std(pull) == pytest.approx(1, abs=0.1)
    hardly = exposed(40.0, n_shifts, seed=3)  # too few steps are left of the brightest row
    last = wrapped_phase(without_saturated(hardly), fringe_set).rejection[-1]
    assert (last & Rejection.SATURATED).any()
    np.testing.assert_array_equal(before.phase[before.rejection == 0],
                                  after.phase[before.rejection == 0])  # fmt: skip


def test_without_saturation_nothing_is_copied() -> None:
    stack = exposed(0.1, 8, seed=3)
    assert without_saturated(stack) is stack
    three = exposed(1.5, 3, seed=3)
    assert without_saturated(three) is three


def test_a_scan_folder_with_exposures_is_measured(tmp_path: Path) -> None:
    scan, *others = (Scan(stacks=(stack,)) for stack in series(4))
    write_scan(tmp_path / "scan", scan, series=others, exposures=EXPOSURES)
    text = (tmp_path / "scan" / "scan.toml").read_text()
    assert "exposures = [8.0, 0.2, 1.2]" in text
    assert len(list((tmp_path / "scan" / "c1").iterdir())) == 30
    read = read_scan(tmp_path / "scan")
    expected = fuse(series(4), EXPOSURES)
    np.testing.assert_array_equal(read.stacks[0].images, expected.images)
    result = measure(read)
    main = result.main
    good = main.rejection == 0
    assert good.mean() > 0.95
    turns = main.order_class + main.phase / (2 * np.pi)
    wrong = np.abs(turns - true_phase() / (2 * np.pi))[good] > 0.5
    assert wrong.mean() < 0.003


def test_a_16_bit_camera_fits() -> None:
    stacks = [replace(s, images=s.images.astype(np.uint16) * 257, saturation_dn=65535,
                      black_level_dn=BLACK * 257, noise=None) for s in series(8)]  # fmt: skip
    found = wrapped_phase(fuse(stacks, EXPOSURES), stacks[0].plan.fringe_sets[0])
    plain = wrapped_phase(fuse(series(8), EXPOSURES), stacks[0].plan.fringe_sets[0])
    both = (found.rejection == 0) & (plain.rejection == 0)
    assert both.mean() > 0.9
    assert np.abs(np.angle(np.exp(1j * (found.phase - plain.phase)[both]))).max() < 0.02
