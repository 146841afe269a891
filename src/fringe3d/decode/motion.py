"""Fringes of moving objects: how far the phase drifts from image to image, and what it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter

from fringe3d.model import ImageStack, NoiseModel
from fringe3d.model.plan import FringeSet

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

WINDOW_PX = 13
"""Neighbours of a square are taken to drift alike; it must hold most of a fringe."""

MOST_DRIFT = 0.23
"""Periods for each image, looked for in both directions. Four steps of a quarter period that drift
by a quarter themselves stand still, and say nothing."""

DRIFT_STEP = 0.008
"""Periods; between them a parabola is laid through three costs."""

SIGNIFICANT = 25.0
"""By how much a drift must lower the sum of squared residuals of its window, in units of the
variance that is left: a false alarm once in two million windows (chi squared, one freedom)."""

LEAST_PART = 0.01
"""Of the pixels that must drift for anything to be changed."""

MOST_GROWTH = 10.0
"""By which the noise of the phase may grow; where the fringes all but stand still it does more."""

TOP = 65535


def stilled(stack: ImageStack, times: Sequence[float] | None = None, /) -> ImageStack:
    """Return the images as they were if the object had stood still at the middle of the fringes.

    The phase of each pixel is taken to drift evenly, Phi + omega t, and the drift omega to be
    the same for its neighbours; with it the phase steps become ``shift - omega t``, and three
    unknowns are fitted to them as usual. Scenes that do not move are returned as they are.

    Parameters
    ----------
    stack : ImageStack; its fringes need four steps or more
    times : time of each image of the plan, in units of the time between two; 0, 1, 2 ... if None

    Returns
    -------
    ImageStack; of 16 bit where something moves, with the fringes replaced. Images of a code stay.

    Notes
    -----
    For a drift the residual of the fit is ``v P(omega) v``, v the grey values of a pixel and P the
    projection beside ``1, cos, sin`` of the steps. Summed over neighbours it needs nothing but
    their products ``v_i v_j``, averaged once.

    Examples
    --------
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> plan = PatternPlan(patterns=fringes(16.0, 4))
    >>> phase = np.tile(0.4 * np.arange(64.0), (64, 1))
    >>> moving = [120 + 80 * np.cos(phase + 0.3 * n - n * np.pi / 2) for n in range(4)]
    >>> stack = ImageStack(images=np.rint(moving).astype(np.uint8), plan=plan, device_name="c1",
    ...                    saturation_dn=255)
    >>> still = stilled(stack).images.astype(float)
    >>> found = np.arctan2(still[1] - still[3], still[0] - still[2])[32, 32]
    >>> wanted = phase[32, 32] + 0.3 * 1.5
    >>> bool(abs(np.angle(np.exp(1j * (found - wanted)))) < 0.02)
    True
    """
    when = np.arange(stack.plan.n_images, dtype=np.float64) if times is None else np.asarray(times)
    images: Floats | None = None
    growth = np.ones(stack.shape, np.float32)
    for fringes in stack.plan.fringe_sets:
        places = list(fringes.indices)
        if len(places) < 4:
            continue
        moments = when[places] - when[places].mean()
        grey = stack.images[places].astype(np.float32)
        drift = drift_of(grey, fringes, moments)
        moves = (drift != 0) & (grey.max(axis=0) < stack.saturation_dn)
        if moves.mean() < LEAST_PART:
            continue
        images = stack.images.astype(np.float32) if images is None else images
        fitted, grown = _as_if_still(grey, fringes, moments, drift)
        images[places] = np.where(moves, fitted, grey)
        growth = np.maximum(growth, np.where(moves, grown, 1))
    return stack if images is None else _sixteen_bits(stack, images, growth)


def drift_of(grey: Floats, fringes: FringeSet, moments: NDArray[np.float64], /) -> Floats:
    """Return by how much the phase grows from image to image, (row, col), rad; 0 where it stays.

    Parameters
    ----------
    grey : (N, row, col) float32, N >= 4
    fringes : FringeSet of N steps
    moments : (N,) float; times of the images, in units of the time between two
    """
    drifts = 2 * np.pi * np.arange(-MOST_DRIFT, MOST_DRIFT + DRIFT_STEP / 2, DRIFT_STEP)
    drifts = np.sort(np.append(drifts, 0.0))
    products = _products(grey)
    shifts = np.asarray(fringes.shifts)
    lowest = np.full(grey.shape[1:], np.inf, np.float32)
    costs = np.empty((len(drifts), *grey.shape[1:]), np.float32)
    for number, drift in enumerate(drifts):
        costs[number] = _cost(products, _beside(shifts - drift * moments))
        np.minimum(lowest, costs[number], out=lowest)
    best = np.argmin(costs, axis=0)
    found = _between(costs, best, drifts)
    freedoms = WINDOW_PX**2 * (len(shifts) - 3)
    still = costs[int(np.searchsorted(drifts, 0.0))]
    floor = np.float32(1 / 12)  # the grey values are whole numbers
    gain = freedoms * (still - lowest) / np.maximum(lowest, floor)
    found[gain < SIGNIFICANT] = 0
    return _from_the_better_side(found, lowest)


def _products(grey: Floats) -> dict[tuple[int, int], Floats]:
    """Return the products of all pairs of images, averaged over the window."""
    centred = grey - grey.mean(axis=0)
    return {
        (i, j): np.asarray(uniform_filter(centred[i] * centred[j], WINDOW_PX, mode="nearest"))
        for i in range(len(grey))
        for j in range(i, len(grey))
    }


def _beside(shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the projection (N, N) beside what a fringe with these steps can be."""
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    return np.asarray(np.eye(len(shifts)) - model @ np.linalg.pinv(model))


def _cost(
    products: dict[tuple[int, int], Floats], projection: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the mean squared residual for each freedom."""
    freedoms = len(projection) - 3
    total = np.zeros_like(products[0, 0])
    for (i, j), product in products.items():
        total += np.float32(projection[i, j] * (1 if i == j else 2) / freedoms) * product
    return np.maximum(total, 0)


def _between(costs: Floats, best: NDArray[np.intp], drifts: NDArray[np.float64]) -> Floats:
    """Return the lowest point of the parabola through three costs around the lowest."""
    inner = np.clip(best, 1, len(drifts) - 2)
    rows, cols = np.ogrid[: best.shape[0], : best.shape[1]]
    before, here, after = (costs[inner + k, rows, cols].astype(np.float64) for k in (-1, 0, 1))
    left, middle, right = (drifts[inner + k] for k in (-1, 0, 1))
    slopes = (here - before) / (middle - left), (after - here) / (right - middle)
    bend = (slopes[1] - slopes[0]) / ((right - left) / 2)
    at = (left + middle) / 2 - slopes[0] / np.where(bend > 0, bend, np.inf)
    return np.asarray(np.clip(np.where(bend > 0, at, drifts[best]), left, right), np.float32)


def _from_the_better_side(drift: Floats, cost: Floats) -> Floats:
    """Take the drift of the window that fits best of those that hold the pixel.

    Windows across the border of two surfaces fit neither; one at its side does.
    """
    half = WINDOW_PX // 2
    best, found = cost.copy(), drift.copy()
    for down in (-half, 0, half):
        for right in (-half, 0, half):
            there = _moved(cost, down, right)
            better = there < 0.7 * best
            found[better] = _moved(drift, down, right)[better]
            best[better] = there[better]
    return np.asarray(median_filter(found, 5), np.float32)


def _moved(values: Floats, down: int, right: int) -> Floats:
    """Return the values of pixels further down and right; those of the border beyond it."""
    rows = np.clip(np.arange(values.shape[0]) + down, 0, values.shape[0] - 1)
    cols = np.clip(np.arange(values.shape[1]) + right, 0, values.shape[1] - 1)
    return values[np.ix_(rows, cols)]


def _as_if_still(
    grey: Floats, fringes: FringeSet, moments: NDArray[np.float64], drift: Floats
) -> tuple[Floats, Floats]:
    """Return the images without drift, and by how much the noise of the phase grew."""
    shifts = np.asarray(fringes.shifts)[:, None, None]
    steps = shifts - drift[None] * moments[:, None, None]
    basis = np.stack([np.ones_like(steps), np.cos(steps), np.sin(steps)])
    normal = np.einsum("anrc,bnrc->rcab", basis, basis) + 1e-6 * np.eye(3)
    right = np.einsum("anrc,nrc->rca", basis, grey)
    offset, weight = _offset_around(grey, basis, normal, right)
    normal[..., 0, 0] += weight
    right[..., 0] += weight * offset
    inverse = np.linalg.inv(normal)
    offset, cosine, sine = np.moveaxis(np.einsum("rcab,rcb->rca", inverse, right), -1, 0)
    still = offset + cosine * np.cos(shifts) + sine * np.sin(shifts)
    size = np.maximum(np.hypot(cosine, sine), 1e-6)
    across = np.stack([-sine / size, cosine / size], axis=-1)
    variance = np.einsum("rca,rcab,rcb->rc", across, inverse[..., 1:, 1:], across)
    grown = np.sqrt(variance * len(moments) / 2)
    return still.astype(np.float32), np.clip(grown, 1, MOST_GROWTH).astype(np.float32)


def _offset_around(
    grey: Floats, basis: Doubles, normal: Doubles, right: Doubles
) -> tuple[Doubles, Doubles]:
    """Return the offset that the neighbours let expect, (row, col), and its weight against one
    image.

    Steps that all but stand still do not tell the offset from a fringe; where the surface is plain
    its neighbours do. How far they differ beyond their noise says how plain it is.
    """
    inverse = np.linalg.inv(normal)
    fitted = np.einsum("rcab,rcb->rca", inverse, right)
    left = grey - np.einsum("anrc,rca->nrc", basis, fitted)
    noise = _around((left**2).sum(axis=0)) / (len(grey) - 3)
    certain = 1 / inverse[..., 0, 0]
    total = _around(certain)
    mean = _around(certain * fitted[..., 0]) / total
    spread = _around(certain * (fitted[..., 0] - mean) ** 2) / total - noise / total
    return mean, noise / np.maximum(spread, noise / WINDOW_PX**2)


def _around(values: Doubles) -> Doubles:
    return np.asarray(uniform_filter(values, WINDOW_PX, mode="nearest"))


def _sixteen_bits(stack: ImageStack, images: Floats, growth: Floats) -> ImageStack:
    """Return a stack with these images, finer than they were."""
    scale = float(2 ** max(0, 16 - int(np.ceil(np.log2(stack.saturation_dn + 1)))))
    noise = stack.noise and NoiseModel(
        read_noise_dn=scale * stack.noise.read_noise_dn,
        gain_dn_per_e=scale * stack.noise.gain_dn_per_e,
    )
    before = 1.0 if stack.sigma_growth is None else stack.sigma_growth
    return replace(
        stack,
        images=np.clip(np.rint(scale * images), 0, TOP).astype(np.uint16),
        saturation_dn=scale * stack.saturation_dn,
        black_level_dn=scale * stack.black_level_dn,
        full_range_dn=stack.full_range_dn and scale * stack.full_range_dn,
        noise=noise,
        sigma_growth=np.asarray(before * growth, np.float32),
    )
