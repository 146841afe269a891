"""Noise and harmonics of phase-shifted images, from a sample of their pixels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import special

from fringe3d.model import ImageStack, Rejection
from fringe3d.model.plan import FringeSet

MIN_MODULATION_OF_RANGE = 0.008
"""Part of the grey-value range below which contrast is rejected, whatever the noise (2 DN of
255): quantisation alone then disturbs the phase by 0.12 rad with three steps."""

KEPT_PART = 0.5
"""Part of the pixels that the noise is estimated from; the others may be edges or motion."""

Sample = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of some pixels."""

ROUNDING_DN = 0.02
"""Lengths closer than this differ by float32 rounding only."""

NOISE_SAMPLE = 20_000
"""Pixels that give the noise to 1 %."""

HARMONIC_SAMPLE = 20_000
"""Pixels that the second harmonic and the typical noise are the medians of."""

ENOUGH_OF_SAMPLE = 0.1
"""Part of the sample that must be lit or valid; else more rows are searched for such pixels."""

MORE_ROWS = 4

MIN_STEPS_FOR_RESIDUAL = 8
"""With fewer steps the residual holds the second or third harmonic (gamma), which is no noise: it
is then believed only if it is smaller than the pixel-to-pixel noise."""

NO_PHASE = np.uint16(Rejection.SATURATED | Rejection.LOW_MODULATION)

MIN_STEPS_FOR_HARMONIC = 5
MAX_HARMONIC = 4
QUANTISATION = 1 / 12
"""DN**2; variance of rounding to whole grey values."""


def estimated_variance(
    stack: ImageStack, fringe_set: FringeSet, solver: NDArray[np.float32], /
) -> float:
    """Return the variance of a grey value, DN**2, as the images show it.

    From what the fit and its harmonics leave over (N >= 8), the pixel-to-pixel noise of one image
    (N = 3), or the smaller of both; at least that of rounding.

    Parameters
    ----------
    stack : ImageStack
    fringe_set : FringeSet
    solver : (3, N) float32; weights of the steps for A, C and S
    """
    leftover = leftover_basis(fringe_set.shifts)
    n_steps, dark = len(fringe_set.indices), MIN_MODULATION_OF_RANGE * stack.range_dn
    wanted = NOISE_SAMPLE
    if n_steps >= MIN_STEPS_FOR_RESIDUAL:
        wanted //= len(leftover)  # each pixel tells so many times
    every = _row_step(stack.shape, wanted)
    while True:
        modulation, residual = _modulation_and_residual(stack, fringe_set, solver, leftover, every)
        lit = modulation > dark
        if every == 1 or lit.sum() >= ENOUGH_OF_SAMPLE * wanted:
            break
        every = max(1, every // MORE_ROWS)
    estimates = []
    if len(leftover) and lit.any():
        estimates.append(_robust_sigma(np.sqrt(residual[lit]), len(leftover)))
    if n_steps < MIN_STEPS_FOR_RESIDUAL:
        rows = np.arange(stack.shape[0])[_middle_rows(every)]
        estimates += _pixel_noise(stack.images[fringe_set.indices[0]], rows, lit)
    return max(min(estimates, default=0.0) ** 2, QUANTISATION)


def _row_step(shape: tuple[int, int], n_wanted: int) -> int:
    """Return n so that every n-th row gives this number of pixels."""
    return max(1, min(shape[0] * shape[1] // n_wanted, shape[0] // 3))


def _middle_rows(every: int) -> slice:
    return slice(every // 2, None, every)


@lru_cache(maxsize=32)
def leftover_basis(shifts_rad: tuple[float, ...]) -> NDArray[np.float32]:
    """Return an orthonormal basis of what neither fringe nor its harmonics explain.

    Shape (n, N), n the degrees of freedom. Harmonics (gamma) are no noise: as many as leave at
    least one degree are taken out, up to the fourth.
    """
    shifts = np.asarray(shifts_rad)
    n_harmonics = max(1, min(MAX_HARMONIC, (len(shifts) - 2) // 2))
    waves = [f(h * shifts) for h in range(1, n_harmonics + 1) for f in (np.cos, np.sin)]
    basis, values, _ = np.linalg.svd(np.stack([np.ones_like(shifts), *waves], axis=1))
    rank = int((values > 1e-6 * values[0]).sum())
    return basis[:, rank:].T.astype(np.float32)


def _modulation_and_residual(
    stack: ImageStack,
    fringe_set: FringeSet,
    solver: NDArray[np.float32],
    leftover: NDArray[np.float32],
    every: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return B and the sum of squared residuals of every n-th row."""
    rows = _middle_rows(every)
    images = np.stack([stack.images[i, rows] for i in fringe_set.indices]).astype(np.float32)
    cosine, sine = combined(solver[1:], images)
    residual = np.zeros_like(cosine)
    for part in combined(leftover, images):
        residual += part**2
    return np.hypot(cosine, sine), residual


def combined(weights: NDArray[np.float32], images: NDArray[np.float32], /) -> NDArray[np.float32]:
    """Return the weighted sums (n, row, col) of images (N, row, col), weights (n, N).

    Without the threads of a linear algebra library, which wait for each other on a busy machine.
    """
    return np.asarray(np.einsum("nk,kij->nij", weights, images))


def _robust_sigma(lengths: NDArray[np.float32], degrees: int) -> float:
    """Estimate sigma from the lengths of noise vectors, without the larger half of them.

    Grey values are integers, so the lengths may be few and far between (multiples of 1/2 for four
    steps): sigma follows from the middle of the gap above the median, and the part below it.
    """
    sample = lengths[:: max(1, len(lengths) // NOISE_SAMPLE)]
    limit = float(np.quantile(sample, KEPT_PART)) + ROUNDING_DN
    kept = sample <= limit
    if kept.all():
        return float(np.sqrt((sample.astype(np.float64) ** 2).mean() / degrees))
    edge = (float(sample[kept].max()) + float(sample[~kept].min())) / 2
    # The chi-square of this part of the sample.
    return edge / float(np.sqrt(2 * special.gammaincinv(degrees / 2, kept.mean())))


def _pixel_noise(
    image: NDArray[np.unsignedinteger], rows: NDArray[np.intp], lit: NDArray[np.bool_]
) -> list[float]:
    """Estimate the noise of one image, DN, from its second differences along both axes.

    One figure, or none where there are too few pixels. `lit` belongs to these rows.

    The mask of J. Immerkaer, "Fast noise variance estimation", CVIU 64 (1996), cancels planes;
    its response to white noise of unit variance is 6. The smaller half of them ignores edges.
    """
    is_inner = (rows > 0) & (rows < image.shape[0] - 1)
    rows, inner = rows[is_inner], lit[is_inner, 1:-1]
    above, here, below = (image[rows + step].astype(np.float32) for step in (-1, 0, 1))
    down = above - 2 * here + below
    response = np.abs(down[:, :-2] - 2 * down[:, 1:-1] + down[:, 2:])
    return [_robust_sigma(response[inner] / 6, 1)] if inner.any() else []


def usable_sample(rejection: NDArray[np.uint16], /) -> Sample:
    """Return places (row, col) of pixels with a phase, from rows all over the image.

    About as many as `HARMONIC_SAMPLE`; none only where there are none at all.

    Parameters
    ----------
    rejection : (row, col) uint16; also with what a code adds
    """
    rows = np.arange(rejection.shape[0])[_middle_rows(_row_step(rejection.shape, HARMONIC_SAMPLE))]
    usable = (rejection[rows] & NO_PHASE) == 0
    if np.count_nonzero(usable) < ENOUGH_OF_SAMPLE * HARMONIC_SAMPLE:
        rows = np.arange(rejection.shape[0])
        usable = (rejection & NO_PHASE) == 0
    places = np.flatnonzero(usable)
    places = places[:: max(1, len(places) // HARMONIC_SAMPLE)]
    row, col = np.divmod(places, rejection.shape[1])
    return rows[row], col


def harmonic_ratio(
    stack: ImageStack,
    fringe_set: FringeSet,
    sample: Sample,
    modulation: NDArray[np.float32],
    variance: NDArray[np.float32],
    /,
) -> float:
    """Return the second harmonic over the first, median of a sample of pixels.

    Noise alone gives a Rayleigh length, whose median square is ``2 ln 2 sigma**2``; it is
    taken off. It takes `MIN_STEPS_FOR_HARMONIC` steps.

    Parameters
    ----------
    stack : ImageStack
    fringe_set : FringeSet
    sample : places (row, col) of n pixels, from `usable_sample`
    modulation : (n,) float32, DN
    variance : (n,) or (1,) float32, DN**2; of a grey value
    """
    shifts = np.asarray(fringe_set.shifts)
    grey = np.stack([stack.images[i][sample] for i in fringe_set.indices])
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts),
                      np.cos(2 * shifts), np.sin(2 * shifts)], axis=1)  # fmt: skip
    solver = np.linalg.pinv(model)[3:]
    noise = 2 * np.log(2) * (solver**2).sum(axis=1).mean() * variance
    power = (np.einsum("nk,ki->ni", solver, grey.astype(np.float64)) ** 2).sum(axis=0)
    first = modulation**2
    return float(np.sqrt(max(float(np.median(power / first) - np.median(noise / first)), 0.0)))
