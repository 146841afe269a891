"""Wrapped phase, offset, modulation and their noise from phase-shifted images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, Rejection, WrappedPhaseMap
from fringe3d.model.plan import FringeSet
from fringe3d.model.rejection import reject

MAX_PHASE_STD = 0.25
"""rad; at a standard deviation of one 25th of a period no point is worth having."""

MIN_MODULATION_OF_RANGE = 0.008
"""Part of the grey-value range below which contrast is rejected, whatever the noise (2 DN of
255): quantisation alone then disturbs the phase by 0.12 rad with three steps."""

KEPT_PART = 0.5
"""Part of the pixels that the noise is estimated from; the others may be edges or motion."""

ROUNDING_DN = 0.02
"""Lengths closer than this differ by float32 rounding only."""

NOISE_SAMPLE = 100_000
"""Pixels that give the noise to 0.4 %."""

MIN_STEPS_FOR_RESIDUAL = 8
"""With fewer steps the residual holds the second or third harmonic (gamma), which is no noise: it
is then believed only if it is smaller than the pixel-to-pixel noise."""

MAX_HARMONIC = 4
ROWS_AT_ONCE = 128


def wrapped_phase(
    stack: ImageStack, fringe_set: FringeSet, /, *, min_modulation_dn: float | None = None
) -> WrappedPhaseMap:
    """Recover the wrapped phase of one set of phase-shifted fringes.

    Each pixel is fitted on its own by least squares, so gain, ambient light and albedo cancel.

    Parameters
    ----------
    stack : ImageStack
    fringe_set : FringeSet
        At least three shifts that determine the phase; equal steps are not required.
    min_modulation_dn : float or None, DN
        Smaller modulations are rejected; None for 0.8 % of the grey-value range.

    Returns
    -------
    WrappedPhaseMap
        NaN with `Rejection` bits where a step is saturated, the modulation is too small, or the
        noise leaves no usable phase.

    Raises
    ------
    MethodError
        If the shifts do not determine the phase.

    Notes
    -----
    Model ``I_n = A + C cos(shift_n) + S sin(shift_n)``, ``phase = atan2(S, C)``,
    ``B = hypot(C, S)``. For N equal steps ``sigma_phase = sqrt(2 / N) sigma_I / B`` [1]_.
    ``sigma_I`` comes from the stack's noise model or, without one, from the residuals of the fit
    (N >= 8), the pixel-to-pixel noise of one image (N = 3), or the smaller of both.

    References
    ----------
    .. [1] C. Zuo et al., "Phase shifting algorithms for fringe projection profilometry: a
       review", Optics and Lasers in Engineering 109 (2018), 10.1016/j.optlaseng.2018.04.019

    Examples
    --------
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> from fringe3d.patterns import pattern_image
    >>> plan = PatternPlan(patterns=fringes(16.0, 4))
    >>> images = np.stack([pattern_image(p, (1, 4)) for p in plan.patterns])
    >>> stack = ImageStack(images=images, plan=plan, device_name="c1", saturation_dn=256)
    >>> (wrapped_phase(stack, plan.fringe_sets[0]).phase / np.pi).round(2).tolist()
    [[0.05999999865889549, 0.1899999976158142, 0.3100000023841858, 0.4399999976158142]]
    """
    solver, phase_weight = _least_squares(fringe_set, stack.device_name)
    offset, cosine, sine, residual = _fit(stack, fringe_set, solver)
    modulation = np.hypot(cosine, sine)
    variance = _grey_variance(stack, fringe_set, offset, modulation, residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        phase_std = phase_weight * np.sqrt(variance) / modulation

    lowest = min_modulation_dn
    if lowest is None:
        lowest = MIN_MODULATION_OF_RANGE * (stack.saturation_dn - stack.black_level_dn)
    rejection = np.zeros(stack.shape, np.uint16)
    saturated = stack.images[list(fringe_set.indices)].max(axis=0) >= stack.saturation_dn
    reject(rejection, saturated, Rejection.SATURATED)
    reject(
        rejection,
        ~((modulation >= lowest) & (phase_std <= MAX_PHASE_STD)),
        Rejection.LOW_MODULATION,
    )
    return WrappedPhaseMap(
        phase=np.where(rejection == 0, np.arctan2(sine, cosine), np.nan),
        offset=offset,
        modulation=modulation,
        phase_std=phase_std.astype(np.float32),
        rejection=rejection,
        period_px=fringe_set.period_px,
        angle=fringe_set.angle,
        device_name=stack.device_name,
        n_shifts=len(fringe_set.indices),
        noise_dn=float(np.sqrt(np.median(variance[rejection == 0]))) if (rejection == 0).any()
        else float("nan"),
        harmonic_ratio=_harmonic_ratio(stack, fringe_set, modulation, variance, rejection == 0),
    )  # fmt: skip


def _least_squares(fringe_set: FringeSet, device_name: str) -> tuple[NDArray[np.float32], float]:
    """Return the (3, N) solver of the model and sigma_phase * B / sigma_I."""
    shifts = np.asarray(fringe_set.shifts)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    if len(shifts) < 3 or np.linalg.matrix_rank(model, tol=1e-6) < 3:
        raise MethodError(
            f"camera '{device_name}': the phase needs at least three different steps; the fringes "
            f"of {fringe_set.period_px:g} px have {np.degrees(shifts).round(3).tolist()} degrees. "
            "Keep more steps"
        )
    solver = np.linalg.pinv(model)
    # Averaged over all phases; sqrt(2 / N) for equal steps.
    weight = float(np.sqrt((solver[1:] ** 2).sum() / 2))
    return solver.astype(np.float32), weight


def _fit(
    stack: ImageStack, fringe_set: FringeSet, solver: NDArray[np.float32]
) -> tuple[NDArray[np.float32], ...]:
    """Return A above black, C, S and the sum of squared residuals, each (row, col)."""
    maps = np.empty((4, *stack.shape), np.float32)
    leftover = _leftover(fringe_set)
    for top in range(0, stack.shape[0], ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        images = stack.images[list(fringe_set.indices), rows].astype(np.float32)
        maps[:3, rows] = np.tensordot(solver, images, axes=1)
        maps[3, rows] = (np.tensordot(leftover, images, axes=1) ** 2).sum(axis=0)
    maps[0] -= np.float32(stack.black_level_dn)
    return tuple(maps)


def _leftover(fringe_set: FringeSet) -> NDArray[np.float32]:
    """Return an orthonormal basis of what neither fringe nor its harmonics explain.

    Shape (n, N), n the degrees of freedom. Harmonics (gamma) are no noise: as many as leave at
    least one degree are taken out, up to the fourth.
    """
    shifts = np.asarray(fringe_set.shifts)
    n_harmonics = max(1, min(MAX_HARMONIC, (len(shifts) - 2) // 2))
    waves = [f(h * shifts) for h in range(1, n_harmonics + 1) for f in (np.cos, np.sin)]
    basis, values, _ = np.linalg.svd(np.stack([np.ones_like(shifts), *waves], axis=1))
    rank = int((values > 1e-6 * values[0]).sum())
    return basis[:, rank:].T.astype(np.float32)


def _grey_variance(
    stack: ImageStack,
    fringe_set: FringeSet,
    offset: NDArray[np.float32],
    modulation: NDArray[np.float32],
    residual: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the variance of a grey value, DN**2, for each pixel."""
    if stack.noise is not None:
        light = np.maximum(offset, 0)
        variance = stack.noise.read_noise_dn**2 + stack.noise.gain_dn_per_e * light
        return variance.astype(np.float32)
    surplus = len(_leftover(fringe_set))
    lit = modulation > MIN_MODULATION_OF_RANGE * stack.saturation_dn
    estimates = []
    if surplus and lit.any():
        estimates.append(_robust_sigma(np.sqrt(residual[lit]), surplus))
    if len(fringe_set.indices) < MIN_STEPS_FOR_RESIDUAL:
        estimates += _pixel_noise(stack.images[fringe_set.indices[0]], lit)
    quantisation = 1 / 12
    typical = min(estimates, default=0.0) ** 2
    return np.full(stack.shape, max(typical, quantisation), np.float32)


def _robust_sigma(lengths: NDArray[np.float32], degrees: int) -> float:
    """Estimate sigma from the lengths of noise vectors, without the larger half of them.

    Grey values are integers, so the lengths may be few and far between (multiples of 1/2 for four
    steps): sigma follows from the middle of the gap above the median, and the part below it.
    """
    sample = lengths[:: max(1, len(lengths) // NOISE_SAMPLE)].astype(np.float64)
    kept = sample <= np.quantile(sample, KEPT_PART) + ROUNDING_DN
    if kept.all():
        return float(np.sqrt((sample**2).mean() / degrees))
    edge = (sample[kept].max() + sample[~kept].min()) / 2
    return float(edge / np.sqrt(stats.chi2.ppf(kept.mean(), degrees)))


def _pixel_noise(image: NDArray[np.unsignedinteger], lit: NDArray[np.bool_]) -> list[float]:
    """Estimate the noise of one image, DN, from its second differences along both axes.

    One figure, or none where there are too few pixels.

    The mask of J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996), cancels planes;
    its response to white noise of unit variance is 6. The smaller half of them ignores edges.
    """
    grey = image.astype(np.float32)
    along = grey[:, :-2] - 2 * grey[:, 1:-1] + grey[:, 2:]
    response = np.abs(along[:-2] - 2 * along[1:-1] + along[2:])
    inner = lit[1:-1, 1:-1]
    return [_robust_sigma(response[inner] / 6, 1)] if inner.any() else []


def _harmonic_ratio(
    stack: ImageStack,
    fringe_set: FringeSet,
    modulation: NDArray[np.float32],
    variance: NDArray[np.float32],
    valid: NDArray[np.bool_],
) -> float:
    """Return the second harmonic over the first, median of a sample of pixels.

    Noise alone gives a Rayleigh length, whose median square is ``2 ln 2 sigma**2``; it is
    taken off.
    """
    if len(fringe_set.indices) < 5 or not valid.any():
        return float("nan")
    shifts = np.asarray(fringe_set.shifts)
    sample = np.flatnonzero(valid)[:: max(1, int(valid.sum()) // 50_000)]
    grey = stack.images[list(fringe_set.indices)].reshape(len(shifts), -1)[:, sample]
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts),
                      np.cos(2 * shifts), np.sin(2 * shifts)], axis=1)  # fmt: skip
    solver = np.linalg.pinv(model)[3:]
    noise = 2 * np.log(2) * (solver**2).sum(axis=1).mean() * variance.ravel()[sample]
    power = ((solver @ grey) ** 2).sum(axis=0)
    first = modulation.ravel()[sample] ** 2
    return float(np.sqrt(max(float(np.median(power / first) - np.median(noise / first)), 0.0)))
