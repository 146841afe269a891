"""What the fit of a sinusoid needs beforehand: weights of the steps, noise, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode.noise import (
    MIN_MODULATION_OF_RANGE,
    MIN_STEPS_FOR_HARMONIC,
    Sample,
    estimated_variance,
    harmonic_ratio,
    usable_sample,
)
from fringe3d.decode.ripple import ripple_of, slope_at
from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, Ripple, WrappedPhaseMap
from fringe3d.model.plan import FringeSet

MAX_PHASE_STD = 0.25
"""rad; at a standard deviation of one 25th of a period no point is worth having."""

WAVE_PLACES, LEAST_WAVE = 16, 1e-5
"""Phases at which the noise is looked at: enough for three waves; and what is none."""


@dataclass(frozen=True, slots=True)
class NoiseWaves:
    """How the noise of a phase depends on the phase.

    With three steps, bright ones have more shot noise than dark ones, and which of them counts
    most depends on the phase; with unequal steps so does the weight of all noise.

    Parameters
    ----------
    read : tuple of complex; of the noise that all steps have, waves 0 and 2
    shot : tuple of complex; of the noise that goes with ``B cos(phase - shift)``, waves 1 and 3
    """

    read: tuple[complex, complex]
    shot: tuple[complex, complex]

    @property
    def is_even(self) -> bool:
        """Tell whether the noise is the same at all phases."""
        return max(abs(self.read[1]), *map(abs, self.shot)) < LEAST_WAVE * abs(self.read[0])

    def noise(
        self, variance: NDArray[np.float32], shot: NDArray[np.float32], phase: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return sigma_phase * B, DN.

        Parameters
        ----------
        variance : DN**2; of a grey value of the mean brightness
        shot : DN**2; what B adds to it in the brightest step
        phase : rad
        """
        turn = np.exp(1j * phase.astype(np.complex64))
        all_steps = self.read[0].real + (np.complex64(self.read[1]) * turn**2).real
        bright = (np.complex64(self.shot[0]) * turn + np.complex64(self.shot[1]) * turn**3).real
        return np.asarray(np.sqrt(np.maximum(variance * all_steps + shot * bright, 0)), np.float32)


def noise_waves(shifts_rad: tuple[float, ...], /) -> NoiseWaves:
    """Return how the noise of the phase of these steps depends on the phase.

    Notes
    -----
    ``d phase / d I_n = (S_n cos phase - C_n sin phase) / B``, C and S the weights of the fit; the
    variance of I_n is ``read + gain A + gain B cos(phase - shift_n)``.

    Examples
    --------
    >>> waves = noise_waves((0.0, 2 * np.pi / 3, 4 * np.pi / 3))
    >>> waves.is_even, round(waves.shot[1].real, 3)  # - 1/3 cos(3 phase)
    (False, -0.333)
    >>> noise_waves((0.0, np.pi / 2, np.pi, 3 * np.pi / 2)).is_even
    True
    """
    solver, _ = _least_squares(shifts_rad)
    phase = 2 * np.pi * np.arange(WAVE_PLACES) / WAVE_PLACES
    shifts = np.asarray(shifts_rad)
    weight = np.cos(phase)[:, None] * solver[2] - np.sin(phase)[:, None] * solver[1]
    read = (weight**2).sum(axis=1)
    shot = (weight**2 * np.cos(phase[:, None] - shifts)).sum(axis=1)
    read_waves, shot_waves = (np.fft.fft(values) / WAVE_PLACES for values in (read, shot))
    return NoiseWaves(
        read=(complex(read_waves[0]), complex(2 * read_waves[2])),
        shot=(complex(2 * shot_waves[1]), complex(2 * shot_waves[3])),
    )


@dataclass(frozen=True, slots=True, eq=False)
class FringeFit:
    """How the images of one fringe set become phases.

    Parameters
    ----------
    solver : (3, N) float32; weights of the steps for A, C and S
    phase_weight : float; ``sigma_phase * B / sigma_I``
    read_variance, gain : float, DN**2 and DN
        ``sigma_I**2 = read_variance + gain * max(A, 0)``, A above the black level.
    lowest_dn : float, DN; smallest modulation
    ripple : Ripple or None; what a nonlinear response does to the phase
    scale, growth : (row, col) float32 or None; see `Fused` and `ImageStack.sigma_growth`
    waves : NoiseWaves or None; how the noise depends on the phase; None where it does not
    """

    solver: NDArray[np.float32]
    phase_weight: float
    read_variance: float
    gain: float
    lowest_dn: float
    ripple: Ripple | None = None
    scale: NDArray[np.float32] | None = None
    growth: NDArray[np.float32] | None = None
    waves: NoiseWaves | None = None

    def variance(
        self, offset: NDArray[np.float32], at: Sample | None = None
    ) -> NDArray[np.float32]:
        """Return the variance of a grey value, DN**2, where A (above black) is `offset`.

        Shape (1,) where it is the same everywhere; `at` are the places of `offset`, if not all.
        """
        if self.gain == 0 and self.scale is None:
            return np.full(1, self.read_variance, np.float32)
        light = np.maximum(offset, 0)
        if self.scale is None:
            return np.float32(self.read_variance) + np.float32(self.gain) * light
        scale = self.scale if at is None else self.scale[at]
        scaled = scale * np.float32(self.read_variance) + np.float32(self.gain) * light
        return np.asarray(scale * scaled, np.float32)

    def phase_std(
        self,
        offset: NDArray[np.float32],
        modulation: NDArray[np.float32],
        phase: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Return the standard deviation of the phase, rad; `phase` is without its ripple.

        Where it is NaN: that of a phase on average.
        """
        noise = np.float32(self.phase_weight) * np.sqrt(self.variance(offset))
        if self.waves is not None:
            shot = self.gain if self.scale is None else self.gain * self.scale
            waving = self.waves.noise(self.variance(offset), shot * modulation, phase)
            noise = np.where(np.isnan(phase), noise, waving)
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = np.asarray(noise / modulation, np.float32)
        if self.growth is not None:
            sigma = sigma * self.growth
        return sigma if self.ripple is None else sigma * slope_at(self.ripple, phase)


def fringe_fit(
    stack: ImageStack, fringe_set: FringeSet, min_modulation_dn: float | None, /
) -> FringeFit:
    """Prepare the fit of one fringe set.

    Raises
    ------
    MethodError
        If the shifts do not determine the phase.
    """
    solver, weight = _least_squares(fringe_set.shifts)
    if not np.isfinite(weight):
        shifts_deg = np.degrees(fringe_set.shifts).round(3).tolist()
        raise MethodError(
            f"camera '{stack.device_name}': the phase needs at least three different steps; the "
            f"fringes of {fringe_set.period_px:g} px have {shifts_deg} degrees. Keep more steps"
        )
    if stack.noise is not None:
        read_variance, gain = stack.noise.read_noise_dn**2, stack.noise.gain_dn_per_e
    else:
        read_variance, gain = estimated_variance(stack, fringe_set, solver), 0.0
    lowest = min_modulation_dn
    if lowest is None:
        lowest = MIN_MODULATION_OF_RANGE * stack.range_dn
    ripple = ripple_of(stack.response, fringe_set)
    scale = None if stack.fused is None else stack.fused.scale
    waves = noise_waves(fringe_set.shifts)
    return FringeFit(
        solver, weight, read_variance, gain, lowest, ripple, scale, stack.sigma_growth,
        None if waves.is_even else waves,
    )  # fmt: skip


@lru_cache(maxsize=32)
def _least_squares(shifts_rad: tuple[float, ...]) -> tuple[NDArray[np.float32], float]:
    """Return the (3, N) solver of the model and sigma_phase * B / sigma_I.

    The latter is infinite where the shifts do not determine the phase.
    """
    shifts = np.asarray(shifts_rad)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    solver = np.linalg.pinv(model)
    if len(shifts) < 3 or np.linalg.matrix_rank(model, tol=1e-6) < 3:
        return solver.astype(np.float32), math.inf
    # Averaged over all phases; sqrt(2 / N) for equal steps.
    weight = float(np.sqrt((solver[1:] ** 2).sum() / 2))
    return solver.astype(np.float32), weight


def wrapped_map(
    stack: ImageStack,
    fringe_set: FringeSet,
    fit: FringeFit,
    /,
    *,
    phase: NDArray[np.float32],
    offset: NDArray[np.float32],
    modulation: NDArray[np.float32],
    phase_std: NDArray[np.float32],
    rejection: NDArray[np.uint16],
    decided: NDArray[np.uint16],
) -> WrappedPhaseMap:
    """Compose the map of one fringe set; add its noise and its second harmonic.

    `decided` are reasons that may hold those of a code, too.
    """
    sample = usable_sample(decided)
    noise_dn, harmonic = float("nan"), float("nan")
    if len(sample[0]):
        variance = fit.variance(offset[sample], sample)
        noise_dn = math.sqrt(float(np.median(variance)))
        if len(fringe_set.indices) >= MIN_STEPS_FOR_HARMONIC:
            light = modulation[sample]
            harmonic = harmonic_ratio(stack, fringe_set, sample, light, variance)
    return WrappedPhaseMap(
        phase=phase,
        offset=offset,
        modulation=modulation,
        phase_std=phase_std,
        rejection=rejection,
        period_px=fringe_set.period_px,
        angle=fringe_set.angle,
        device_name=stack.device_name,
        n_shifts=len(fringe_set.indices),
        noise_dn=noise_dn,
        harmonic_ratio=harmonic,
    )
