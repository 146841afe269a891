"""Less noise in a phase map, without blurring edges, and with a true standard deviation."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.decode import _filter
from fringe3d.decode.camera import CameraPhases
from fringe3d.kernels import over_rows
from fringe3d.model import PhaseMap

Strength = Literal["none", "light", "medium", "strong"]

RADIUS_PX: dict[str, int] = {"light": 3, "medium": 5, "strong": 8}
"""Of the disc of neighbours: noise falls to about 1 / radius."""

BEND_SIGMAS, POOL_PX = 0.6, 21
"""A larger disc is taken only where it changes the phase by less than this part of its noise, on
average over so many pixels: it would flatten a ball by a few micrometres."""

NEAR_POOL_PX, SURE, KNOWN = 11, 2.5, 0.1
"""Where the mean square of its changes over so many pixels is larger than that of noise, by so many
standard deviations and the part to which the noise is known, there is relief that the disc
flattens: a larger disc is taken only where it wins more than it flattens, and sigma tells."""

MEAN_PX = (1, 3, 5)
"""Means of the changes over so many pixels show relief that single ones hide behind noise."""

LOCAL_SIGMAS = 3.5
"""Where the mean of the changes is that much larger than noise makes it, the pixel stays as it was:
there is a crease, or a step too low to stand out."""

N_PHASES, LEAST_OF_PHASE = 128, 20
"""Parts of a period that are looked at together, and pixels that tell their mean."""

GATE_SIGMAS, GATE_RAD = 4.0, 0.01
"""Neighbours farther from the local parabola belong to another surface. Noise hardly reaches four
standard deviations; the floor leaves room for harmonics where there is little noise."""

LEAST_PIXELS = 12
"""Twice the numbers of a parabola."""

FIRST_RADIUS_PX, GROWTH = 2, 1.5

INTERPOLATED = 4 / 9
"""Mean sum of squared weights where a phase is interpolated between pixels: `correspond` counts
with it, as if neighbours were independent."""


def filtered_camera(phases: CameraPhases, strength: Strength, /, *, is_first: bool) -> CameraPhases:
    """Return the phases of a camera with less noise.

    Parameters
    ----------
    phases : CameraPhases
    strength : "none", "light", "medium" or "strong"
    is_first : bool; False for cameras whose phases are interpolated between pixels: their filtered
        neighbours err alike, so that interpolation no longer lessens the noise. Their standard
        deviations are raised by what the interpolation will take off

    Returns
    -------
    CameraPhases
    """
    if strength == "none":
        return phases
    radius = RADIUS_PX[strength]
    directions = tuple(
        replace(
            direction,
            main=filtered(direction.main, radius, is_first=is_first),
            others=tuple(filtered(m, radius, is_first=is_first) for m in direction.others),
        )
        for direction in phases.directions
    )
    return replace(phases, directions=directions)


def filtered(phases: PhaseMap, radius_px: int, /, *, is_first: bool = True) -> PhaseMap:
    """Return a phase map with less noise; the orders stay, the phase may leave [0, 2 pi) a little.

    Parameters
    ----------
    phases : PhaseMap; a map known to whole code cells only stays as it is
    radius_px : int, >= 2; of the disc of neighbours
    is_first : bool; see `filtered_camera`

    Notes
    -----
    The phase of each pixel is taken from the parabola through its neighbours: the slope of the
    carrier and the bend of the surface are fitted and not averaged over, so that a sphere keeps its
    size. Neighbours that lie off the parabola (another surface, mixed light) do not count. The
    fit begins with the nearest pixels and grows, as far as the surface bends like a parabola.
    ``phase_std`` is that of the fit: ``(X^T X)^-1_00 sigma^2``, X the terms of the parabola at the
    neighbours that count; ``detailed_std`` adds what larger discs flatten, see `smoothed_phase`.
    """
    if phases.is_quantised:
        return phases
    phase, sigma, left = smoothed_phase(phases.phase, phases.phase_std, radius_px)
    if not is_first:
        part = interpolated_part(radius_px)
        raised = sigma * np.float32(np.sqrt(part / INTERPOLATED))
        sigma = np.where(sigma < phases.phase_std, np.minimum(raised, phases.phase_std), sigma)
        left = left / np.float32(np.sqrt(INTERPOLATED))  # neighbours share it
        phases = replace(phases, alike=(part - INTERPOLATED) / (1 - INTERPOLATED))
    detailed = np.hypot(sigma, left)
    return replace(phases, phase=phase, phase_std=sigma, detailed_std=detailed)


def smoothed_phase(
    phase: NDArray[np.float32], sigma: NDArray[np.float32], radius_px: int, /
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the phase of local parabolas, its standard deviation, and what they flatten.

    Parameters
    ----------
    phase : (row, col) float32, rad; NaN where unknown
    sigma : (row, col) float32, rad; standard deviation of each
    radius_px : int, >= 2; smaller discs are taken where the surface bends like no parabola

    Returns
    -------
    phase, sigma, left : (row, col) float32, rad; the phase is not wrapped again; `left` is the
        root of the mean square by which larger discs changed the phases around more than noise
        would

    Examples
    --------
    >>> x = np.arange(40, dtype=np.float32)
    >>> wave = np.broadcast_to((0.8 * x + 0.001 * x**2) % (2 * np.pi), (30, 40))
    >>> phase, sigma, left = smoothed_phase(wave, np.full((30, 40), 0.1, np.float32), 6)
    >>> bool(np.allclose(phase, wave, atol=1e-5)), round(float(sigma[15, 20]), 3), left.max()
    (True, 0.017, np.float32(0.0))
    """
    smaller = [radius for radius in RADIUS_PX.values() if radius < radius_px]
    found, deviation, left = phase, sigma, np.zeros_like(sigma)
    is_open, before = np.isfinite(phase), 0
    for radius in (*smaller, radius_px):
        wider, wider_deviation = _parabolas(phase, sigma, radius)
        with np.errstate(invalid="ignore"):  # infinite where there is no modulation
            noise = np.sqrt(np.nan_to_num(np.maximum(deviation**2 - wider_deviation**2, 0)))
        change = _off_the_pattern(np.where(is_open, wider - found, np.float32(np.nan)), phase)
        mean = _mean_change(change, noise)
        flattened, is_local = _flattened(change, noise, before, radius)
        more = left + flattened
        is_open &= (np.abs(mean) < BEND_SIGMAS * wider_deviation) & ~is_local
        is_open &= np.hypot(wider_deviation, more) < np.hypot(deviation, left)
        found = np.where(is_open, wider, found)
        deviation = np.where(is_open, wider_deviation, deviation)
        left = np.where(is_open, more, left)
        before = radius
    return found, deviation, left.astype(np.float32)


def _parabolas(
    phase: NDArray[np.float32], sigma: NDArray[np.float32], radius_px: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    radii = np.array(_growing(radius_px))
    answer, sigma_answer = np.empty_like(phase), np.empty_like(sigma)
    gate = (GATE_SIGMAS, GATE_RAD)
    over_rows(_filter.smooth, len(phase), phase, sigma, radii, gate, LEAST_PIXELS,
              answer, sigma_answer)  # fmt: skip
    return answer, sigma_answer


def _mean_change(change: NDArray[np.float32], noise: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what a larger disc changes around each pixel on average, rad; NaN counts not."""
    known = np.isfinite(change) & (noise > 0)
    clipped = np.clip(np.where(known, change, 0), -GATE_SIGMAS * noise, GATE_SIGMAS * noise)
    share = np.maximum(_mean(known, POOL_PX), np.float32(1e-3))
    return np.asarray(_mean(clipped, POOL_PX) / share, np.float32)


def _off_the_pattern(
    change: NDArray[np.float32], phase: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return changes without their mean over all pixels of the same phase, rad.

    Grey values of the pattern are whole numbers, and its response is no straight line: what a disc
    flattens of that is the same in both cameras, and moves no point.
    """
    known = np.isfinite(change)
    turns = phase[known] * np.float32(N_PHASES / (2 * np.pi))
    place = np.asarray(turns, np.int64) % N_PHASES
    number = np.bincount(place, minlength=N_PHASES)
    mean = np.bincount(place, change[known], N_PHASES) / np.maximum(number, 1)
    mean[number < LEAST_OF_PHASE] = 0.0
    answer = change.copy()
    answer[known] -= mean.astype(np.float32)[place]
    return answer


def _flattened(
    change: NDArray[np.float32], noise: NDArray[np.float32], radius_px: int, wider_px: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the root of the mean square by which a wider disc changes the phases around a pixel
    beyond what noise makes it, rad, 0 where it cannot be told from noise; and where it changes the
    pixel itself by more than noise does.

    Of the changes themselves, and of their means over some pixels: noise falls by that, relief of
    their size does not.
    """
    most, is_local = np.zeros_like(noise), np.zeros(noise.shape, bool)
    known = np.isfinite(change) & (noise > 0)
    clipped = np.clip(np.where(known, change, 0), -GATE_SIGMAS * noise, GATE_SIGMAS * noise)
    for width in MEAN_PX:
        mean, whole = clipped, known
        if width > 1:
            mean = _mean(clipped, width)
            whole = ndimage.binary_erosion(known, np.ones((width, width), bool))
        part, together = _power(radius_px, wider_px, width)
        if width > 1:  # single pixels that change much are those of much noise
            is_local |= whole & (np.abs(mean) > LOCAL_SIGMAS * np.sqrt(part) * noise)
        share = np.maximum(_mean(whole, NEAR_POOL_PX), np.float32(1e-3))
        expected = part * _mean(np.where(whole, noise, 0) ** 2, NEAR_POOL_PX) / share
        square = _mean(np.where(whole, mean, 0) ** 2, NEAR_POOL_PX) / share
        doubt = np.sqrt(2 * together / (share * NEAR_POOL_PX**2))
        excess = square - expected
        is_sure = excess > (SURE * doubt + KNOWN) * expected
        most = np.where(is_sure, np.maximum(most, excess), most)
    return np.sqrt(most), is_local


@lru_cache(maxsize=64)
def _power(radius_px: int, wider_px: int, width_px: int) -> tuple[float, float]:
    """Return which part of the noise's variance is left in means over some pixels of what a wider
    disc changes, and the sum of their squared correlations with neighbours."""
    change = _weights(wider_px)
    inner = slice(wider_px - radius_px, wider_px + radius_px + 1)
    change[inner, inner] -= _weights(radius_px) if radius_px else 1.0
    mean = ndimage.uniform_filter(
        np.pad(change, 2 * wider_px + width_px), width_px, mode="constant"
    )
    power = np.abs(np.fft.fft2(mean)) ** 2
    # Parseval: correlations are the transform of the power.
    together = float(power.size * (power**2).sum() / power.sum() ** 2)
    return float((mean**2).sum() / (change**2).sum()), together


def _mean(values: NDArray[Any], width_px: int) -> NDArray[np.float32]:
    return np.asarray(ndimage.uniform_filter(values.astype(np.float32), width_px))


def interpolated_part(radius_px: int, /) -> float:
    """Return which part of the variance of filtered phases bilinear interpolation leaves, on
    average over the place between four pixels.

    Examples
    --------
    >>> round(interpolated_part(3), 2), round(interpolated_part(9), 2)
    (0.83, 0.95)
    """
    weights = _weights(radius_px)
    padded = np.pad(weights, 1)

    def shared(down: int, right: int) -> float:
        return float((padded * np.roll(padded, (down, right), (0, 1))).sum())

    # Means of products of bilinear weights: of a pixel with itself, beside, and across.
    return (4 * shared(0, 0) + 2 * shared(0, 1) + 2 * shared(1, 0) + shared(1, 1)) / (
        9 * shared(0, 0)
    )


def _weights(radius_px: int) -> NDArray[np.float64]:
    """Return with which weights the phases of a disc make up that of its middle."""
    y, x = np.mgrid[-radius_px : radius_px + 1, -radius_px : radius_px + 1].astype(float)
    on_disc = x**2 + y**2 <= radius_px * (radius_px + 1)
    terms = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=-1) * on_disc[..., None]
    flat = terms.reshape(-1, 6)
    return np.asarray((terms @ np.linalg.inv(flat.T @ flat)[0]).reshape(x.shape))


def _growing(radius_px: int) -> list[int]:
    """Return the radii of the fits: each half as large again, for it is an extrapolation; the last
    twice, so that what counts does not depend on the noise of the one before."""
    radii, radius = [radius_px, radius_px], float(radius_px)
    while (radius := radius / GROWTH) >= FIRST_RADIUS_PX:
        radii.insert(0, round(radius))
    return radii
