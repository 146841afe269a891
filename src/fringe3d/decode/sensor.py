"""The noise model of a sensor, from the phase steps themselves or from repeated images.

``variance = read_noise**2 + gain * (I - black)`` (EMVA 1288, photon transfer): the variance of grey
values is found for many brightnesses and a straight line is laid through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode.fused import decode_set
from fringe3d.decode.noise import QUANTISATION, leftover_basis
from fringe3d.decode.response import second_harmonic
from fringe3d.errors import MethodError
from fringe3d.model import ImageStack, NoiseModel
from fringe3d.model.plan import FringeSet

Floats = NDArray[np.float64]

N_BINS = 24
LEAST_IN_BIN = 200
LEAST_BINS = 4
"""Brightness bins; fewer or emptier ones tell no line."""

MOST_PIXELS = 400_000

LEAST_STEPS, ENOUGH_STEPS, LINEAR = 5, 8, 0.005
"""Four steps leave one number, which holds the second harmonic; what fewer than eight leave may
hold the third: they tell noise where the second is less than so much of the fringe."""

OUTLYING_SIGMA = 5.0

MARGIN_DN = 0.02
"""Part of the range next to black and saturation in which clipping takes noise away."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorNoise:
    """A noise model, and what it was found from.

    Parameters
    ----------
    device_name : str
    model : NoiseModel
    read_sigma_dn, gain_sigma : float; standard deviations of its two numbers
    signal_dn, variance_dn2 : (n,) float; the points of the photon transfer curve
    source : str
    """

    device_name: str
    model: NoiseModel
    read_sigma_dn: float
    gain_sigma: float
    signal_dn: Floats
    variance_dn2: Floats
    source: str


def noise_from_steps(stack: ImageStack, /) -> SensorNoise:
    """Find the noise of a camera from what five or more phase steps leave over.

    The fringe and as many harmonics as leave at least one degree of freedom are taken out of each
    pixel; what is left is noise of the pixel's mean brightness.

    Raises
    ------
    MethodError
        If there are too few steps, or too few brightnesses.
    """
    signals, squares, n_steps = [], [], 0
    for fringe_set in stack.plan.fringe_sets:
        if len(fringe_set.shifts) < LEAST_STEPS:
            continue
        if len(fringe_set.shifts) < ENOUGH_STEPS:
            _require_linear(stack, fringe_set)
        n_steps = max(n_steps, len(fringe_set.shifts))
        signal, square = _step_residuals(stack, fringe_set)
        signals.append(signal)
        squares.append(square)
    if not signals:
        most = max((len(f.shifts) for f in stack.plan.fringe_sets), default=0)
        raise MethodError(
            f"camera '{stack.device_name}': the noise shows in five or more phase steps, found "
            f"{most}; record the scan twice and name both"
        )
    return _line(
        stack,
        np.concatenate(signals),
        [q.mean(axis=1) for q in squares],
        [q.shape[1] for q in squares],
        f"what {n_steps} steps leave over",
    )


def _require_linear(stack: ImageStack, fringe_set: FringeSet) -> None:
    ratio = second_harmonic(stack, fringe_set, decode_set(stack, fringe_set).wrapped)
    if not abs(ratio) <= LINEAR:
        raise MethodError(
            f"camera '{stack.device_name}': {len(fringe_set.shifts)} steps do not tell noise from "
            f"a nonlinear response (second harmonic {ratio:.1%}). Record eight or more, or record "
            "the scan twice and name both"
        )


def _step_residuals(stack: ImageStack, fringe_set: FringeSet) -> tuple[Floats, Floats]:
    """Return the brightness (n,) and the squares of the residuals (n, degrees) of usable pixels."""
    images = stack.images[list(fringe_set.indices)]
    low, high = images.min(axis=0), images.max(axis=0)
    index = _usable(stack, low, high)
    grey = images.reshape(len(images), -1)[:, index].astype(np.float64)
    residual = leftover_basis(fringe_set.shifts).astype(np.float64) @ grey
    return grey.mean(axis=0) - stack.black_level_dn, (residual**2).T


def noise_from_repeats(stacks: Sequence[ImageStack], /) -> SensorNoise:
    """Find the noise of a camera from recordings of the same plan and an unchanged scene.

    Each image is compared with its next repetition; a change of the light that all pixels share is
    taken out.

    Parameters
    ----------
    stacks : two or more stacks of one camera

    Raises
    ------
    MethodError
        If there are fewer than two, they differ in plan or size, or the scene changed.
    """
    first = stacks[0]
    if len(stacks) < 2:
        raise MethodError("noise: expected at least two recordings of the same, found one")
    for other in stacks[1:]:
        if other.images.shape != first.images.shape or other.plan != first.plan:
            raise MethodError(
                f"camera '{first.device_name}': expected repeated recordings of the same plan and "
                f"size, found {first.images.shape} and {other.images.shape} (images, rows, columns)"
            )
    signals, squares = [], []
    n_pairs = (len(stacks) - 1) * len(first.images)
    for a, b in pairwise(stacks):
        for one, two in zip(a.images, b.images, strict=True):
            index = _usable(first, np.minimum(one, two), np.maximum(one, two), n_pairs)
            before, after = (x.ravel()[index].astype(np.float64) for x in (one, two))
            mean = (before + after) / 2 - first.black_level_dn
            change = after - before
            if len(mean) > LEAST_IN_BIN:
                change -= mean * float(change @ mean / (mean @ mean))
            signals.append(mean)
            squares.append(change**2 / 2)
    return _line(first, np.concatenate(signals), squares, [1] * len(squares),
                 f"{len(stacks)} repeated recordings")  # fmt: skip


def _usable(
    stack: ImageStack, low: NDArray[np.generic], high: NDArray[np.generic], shared: int = 1
) -> NDArray[np.intp]:
    """Return places of pixels that clipping does not touch, a sample where there are many."""
    margin = MARGIN_DN * stack.range_dn
    good = (high.astype(np.float64) < stack.saturation_dn - margin) & (low.astype(np.float64) > 0)
    index = np.flatnonzero(good)
    return index[:: max(1, len(index) * shared // MOST_PIXELS) | 1]


def _line(
    stack: ImageStack, signal: Floats, squares: list[Floats], degrees: list[int], source: str
) -> SensorNoise:
    """Lay a line through the variance over brightness; each part has its degrees of freedom."""
    square = np.concatenate(squares)
    edges: Floats = np.empty(0)
    if len(signal):
        edges = np.unique(np.quantile(signal, np.linspace(0, 1, N_BINS + 1)))
    bin_of = np.searchsorted(edges, signal, side="right") - 1
    freedom = np.repeat(degrees, [len(s) for s in squares])
    points = []
    for number in range(max(len(edges) - 1, 0)):
        chosen = bin_of == number
        if chosen.sum() < LEAST_IN_BIN:
            continue
        level = float(signal[chosen].mean())
        points.append((level, _mean_square(square[chosen]), float(freedom[chosen].sum())))
    if len(points) < LEAST_BINS:
        raise MethodError(
            f"camera '{stack.device_name}': the noise needs pixels of several brightnesses, found "
            f"{len(points)} of {LEAST_BINS}. Record something with light and dark parts"
        )
    level, variance, weight = np.array(points).T
    read_variance, gain, covariance = _fitted(level, variance, weight)
    read = float(np.sqrt(read_variance))
    return SensorNoise(
        device_name=stack.device_name,
        model=NoiseModel(read_noise_dn=read, gain_dn_per_e=gain),
        read_sigma_dn=float(np.sqrt(covariance[0, 0])) / (2 * read),
        gain_sigma=float(np.sqrt(covariance[1, 1])),
        signal_dn=level,
        variance_dn2=variance,
        source=source,
    )


def _mean_square(squares: Floats) -> float:
    """Return the mean square without what is no noise: edges and motion, beyond five sigma."""
    mean = float(squares.mean())
    for _ in range(5):
        mean = float(squares[squares <= OUTLYING_SIGMA**2 * mean].mean())
    return mean


def _fitted(level: Floats, variance: Floats, weight: Floats) -> tuple[float, float, Floats]:
    """Return read variance, gain and their covariance; neither is negative."""
    design = np.stack([np.ones_like(level), level], axis=1)
    model = variance
    for _ in range(5):  # the variance of a variance is 2 / degrees of its square
        scale = np.sqrt(weight / 2) / np.maximum(model, QUANTISATION)
        found, *_ = np.linalg.lstsq(design * scale[:, None], variance * scale, rcond=None)
        model = design @ found
    if found[1] < 0:
        found = np.array([float(np.average(variance, weights=scale**2)), 0.0])
    found[0] = max(found[0], QUANTISATION)
    covariance = np.linalg.inv((design * scale[:, None] ** 2).T @ design)
    return float(found[0]), float(found[1]), np.asarray(covariance, np.float64)
