"""Less noise in a phase map, without blurring edges, and with a true standard deviation."""

from __future__ import annotations

from dataclasses import replace
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

MOST_EXCESS, NEAR_POOL_PX = 2.0, 11
"""Nor where the mean square of its changes next to a pixel is that much larger than noise makes it:
there is relief finer than the disc."""

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
    ``sigma`` is that of the fit: ``(X^T X)^-1_00 sigma^2``, X the terms of the parabola at the
    neighbours that count.
    """
    if phases.is_quantised:
        return phases
    phase, sigma = smoothed_phase(phases.phase, phases.phase_std, radius_px)
    if not is_first:
        part = interpolated_part(radius_px)
        raised = sigma * np.float32(np.sqrt(part / INTERPOLATED))
        sigma = np.where(sigma < phases.phase_std, np.minimum(raised, phases.phase_std), sigma)
        phases = replace(phases, alike=(part - INTERPOLATED) / (1 - INTERPOLATED))
    detailed = None
    if phases.detailed_std is not None:  # what is no noise stays
        more = np.maximum(phases.detailed_std**2 - phases.phase_std**2, 0)
        detailed = np.sqrt(sigma**2 + more)
    return replace(phases, phase=phase, phase_std=sigma, detailed_std=detailed)


def smoothed_phase(
    phase: NDArray[np.float32], sigma: NDArray[np.float32], radius_px: int, /
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the phase of local parabolas, and its standard deviation.

    Parameters
    ----------
    phase : (row, col) float32, rad; NaN where unknown
    sigma : (row, col) float32, rad; standard deviation of each
    radius_px : int, >= 2; smaller discs are taken where the surface bends like no parabola

    Returns
    -------
    phase, sigma : (row, col) float32, rad; the phase is not wrapped again

    Examples
    --------
    >>> x = np.arange(40, dtype=np.float32)
    >>> wave = np.broadcast_to((0.8 * x + 0.001 * x**2) % (2 * np.pi), (30, 40))
    >>> phase, sigma = smoothed_phase(wave, np.full((30, 40), 0.1, np.float32), 6)
    >>> bool(np.allclose(phase, wave, atol=1e-5)), round(float(sigma[15, 20]), 3)
    (True, 0.017)
    """
    smaller = [radius for radius in RADIUS_PX.values() if radius < radius_px]
    found, deviation = phase, sigma
    is_open = np.ones(phase.shape, bool)
    for radius in (*smaller, radius_px):
        wider, wider_deviation = _parabolas(phase, sigma, radius)
        change, excess = _changes(
            wider - found, np.sqrt(np.maximum(deviation**2 - wider_deviation**2, 0))
        )
        is_open &= (np.abs(change) < BEND_SIGMAS * wider_deviation) & (excess < MOST_EXCESS)
        is_open &= wider_deviation < deviation
        found = np.where(is_open, wider, found)
        deviation = np.where(is_open, wider_deviation, deviation)
    return found, deviation


def _parabolas(
    phase: NDArray[np.float32], sigma: NDArray[np.float32], radius_px: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    radii = np.array(_growing(radius_px))
    answer, sigma_answer = np.empty_like(phase), np.empty_like(sigma)
    gate = (GATE_SIGMAS, GATE_RAD)
    over_rows(_filter.smooth, len(phase), phase, sigma, radii, gate, LEAST_PIXELS,
              answer, sigma_answer)  # fmt: skip
    return answer, sigma_answer


def _changes(
    change: NDArray[np.float32], deviation: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return what a larger disc changes around each pixel: on average, rad; and its mean square,
    over that of the noise. The noise of one pixel hides what neighbours share."""
    known = np.isfinite(change) & (deviation > 0)
    clipped = np.clip(np.where(known, change, 0), -GATE_SIGMAS * deviation, GATE_SIGMAS * deviation)
    square = np.where(known, change / np.maximum(deviation, np.float32(1e-9)), 0) ** 2
    square = np.minimum(square, np.float32(GATE_SIGMAS**2))
    share = np.maximum(_mean(known, POOL_PX), np.float32(1e-3))
    near_share = np.maximum(_mean(known, NEAR_POOL_PX), np.float32(1e-3))
    mean = _mean(np.where(known, clipped, 0), POOL_PX) / share
    mean_square = _mean(np.where(known, square, 0), NEAR_POOL_PX) / near_share
    return mean.astype(np.float32), mean_square.astype(np.float32)


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
    y, x = np.mgrid[-radius_px : radius_px + 1, -radius_px : radius_px + 1].astype(float)
    on_disc = x**2 + y**2 <= radius_px * (radius_px + 1)
    terms = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=-1) * on_disc[..., None]
    flat = terms.reshape(-1, 6)
    weights = (terms @ np.linalg.inv(flat.T @ flat)[0]).reshape(x.shape)
    padded = np.pad(weights, 1)

    def shared(down: int, right: int) -> float:
        return float((padded * np.roll(padded, (down, right), (0, 1))).sum())

    # Means of products of bilinear weights: of a pixel with itself, beside, and across.
    return (4 * shared(0, 0) + 2 * shared(0, 1) + 2 * shared(1, 0) + shared(1, 1)) / (
        9 * shared(0, 0)
    )


def _growing(radius_px: int) -> list[int]:
    """Return the radii of the fits: each half as large again, for it is an extrapolation; the last
    twice, so that what counts does not depend on the noise of the one before."""
    radii, radius = [radius_px, radius_px], float(radius_px)
    while (radius := radius / GROWTH) >= FIRST_RADIUS_PX:
        radii.insert(0, round(radius))
    return radii
