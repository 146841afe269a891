"""The noise of a sensor is found as it was put in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fringe3d.cli.run import main
from fringe3d.decode import noise_from_repeats, noise_from_steps, wrapped_phase
from fringe3d.errors import MethodError, PlanError
from fringe3d.io.noisefile import noise_for, read_noise
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import ImageStack, NoiseModel, PatternPlan, Scan
from fringe3d.model.plan import fringes

SHAPE = (160, 200)
BLACK = 12.0


def stack_of(
    model: NoiseModel, n_shifts: int, *, seed: int, gamma: float = 1.0, lamp: float = 1.0
) -> ImageStack:
    """Return images of fringes on a surface of many brightnesses, with normal noise."""
    plan = PatternPlan(patterns=fringes(16.0, n_shifts))
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    albedo = 0.1 + 0.9 * y / SHAPE[0]
    images: list[NDArray[np.uint8]] = []
    for step in plan.fringe_sets[0].shifts:
        wave = (0.5 + 0.5 * np.cos(2 * np.pi * x / 11.3 - step)) ** gamma
        light = lamp * 200 * albedo * (0.05 + 0.95 * wave)
        variance = model.read_noise_dn**2 - 1 / 12 + model.gain_dn_per_e * light
        grey = BLACK + light + np.sqrt(variance) * rng.standard_normal(SHAPE)
        images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    return ImageStack(images=np.stack(images), plan=plan, device_name="c1", saturation_dn=255,
                      black_level_dn=BLACK)  # fmt: skip


@pytest.mark.parametrize("n_shifts", [5, 8, 16])
@pytest.mark.parametrize(("read", "gain"), [(0.6, 0.02), (1.5, 0.1), (2.0, 0.0)])
def test_steps_tell_the_noise(n_shifts: int, read: float, gain: float) -> None:
    found = noise_from_steps(stack_of(NoiseModel(read_noise_dn=read, gain_dn_per_e=gain),
                                      n_shifts, seed=1))  # fmt: skip
    assert found.model.read_noise_dn == pytest.approx(read, rel=0.06)
    assert found.model.gain_dn_per_e == pytest.approx(gain, rel=0.05, abs=0.002)


def test_harmonics_are_no_noise() -> None:
    truth = NoiseModel(read_noise_dn=1.0, gain_dn_per_e=0.05)
    found = noise_from_steps(stack_of(truth, 8, seed=1, gamma=2.2)).model
    assert found.gain_dn_per_e == pytest.approx(0.05, rel=0.06)
    with pytest.raises(MethodError, match="nonlinear response"):
        noise_from_steps(stack_of(truth, 6, seed=1, gamma=2.2))


def test_repeated_recordings_tell_the_noise_of_few_steps() -> None:
    truth = NoiseModel(read_noise_dn=0.8, gain_dn_per_e=0.06)
    # The lamp is 2 % brighter the second time: a change that all pixels share is no noise.
    stacks = [stack_of(truth, 3, seed=1), stack_of(truth, 3, seed=2, lamp=1.02)]
    found = noise_from_repeats(stacks)
    assert found.model.read_noise_dn == pytest.approx(0.8, rel=0.05)
    assert found.model.gain_dn_per_e == pytest.approx(0.06, rel=0.05)
    assert abs(found.model.gain_dn_per_e - 0.06) < 4 * found.gain_sigma


def test_what_does_not_tell_the_noise_is_refused() -> None:
    truth = NoiseModel(read_noise_dn=1.0, gain_dn_per_e=0.05)
    four = stack_of(truth, 4, seed=1)
    with pytest.raises(MethodError, match="record the scan twice"):
        noise_from_steps(four)
    with pytest.raises(MethodError, match="same plan and size"):
        noise_from_repeats([four, stack_of(truth, 3, seed=1)])
    flat = replace(four, images=np.full_like(four.images, 100))
    with pytest.raises(MethodError, match="several brightnesses"):
        noise_from_repeats([flat, flat])


def test_from_scans_to_sigma(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = NoiseModel(read_noise_dn=0.8, gain_dn_per_e=0.06)
    for seed in (1, 2):
        write_scan(tmp_path / f"scan{seed}", Scan(stacks=(stack_of(truth, 3, seed=seed),)))
    out = tmp_path / "noise.toml"
    main(["noise", str(tmp_path / "scan1"), str(tmp_path / "scan2"), "--out", str(out)])
    assert "2 repeated recordings" in capsys.readouterr().out
    assert out.with_suffix(".png").is_file()
    model = noise_for(out, read_noise(out), "c1")
    stack = replace(stack_of(truth, 3, seed=3), noise=model)
    phases = wrapped_phase(stack, stack.plan.fringe_sets[0])
    true = 2 * np.pi * np.arange(SHAPE[1]) / 11.3
    error = np.angle(np.exp(1j * (phases.phase - true)))
    assert np.std(error / phases.phase_std) == pytest.approx(1, abs=0.03)
    with pytest.raises(PlanError, match="expected the noise of camera 'c2'"):
        noise_for(out, read_noise(out), "c2")
