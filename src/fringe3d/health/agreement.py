"""How well recorded grey values agree with a sequence of patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import GrayBit, Pattern, PatternPlan, Uniform
from fringe3d.model.plan import FringeSet
from fringe3d.patterns import EDGE_TOLERANCE, extent_px, gray_bit

STEPS_PER_PERIOD, STEPS_PER_CELL = 8, 2
MOST_PLACES = 4096
"""Places on the projector at which patterns are compared with a pixel."""

CLEAR_OF_MODULATION = 0.5
"""Distance from the threshold, parts of the modulation, from which on a bit is clear."""

JUMP_OF_PERIOD = 0.5
"""Of the period (of two cells): neighbours that lie further apart on the projector are torn."""

FAR_PERIODS, FAR_OF_PROJECTOR = 4, 0.125
"""Of distant pixels: the coarse bits of a code tear few neighbours apart, but whole regions. A
reduced code comes back too soon to tell."""

CELLS_WITHOUT_PHASE = 8
"""Times as far may neighbours lie apart where the cells of a code are all there is: cells may be as
fine as the projector's pixels."""

TWO_PI = 2 * np.pi
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Agreement:
    """How many images of a sequence contradict each other, for each pixel on average.

    Parameters
    ----------
    code : float; bits and periods against the place on the projector that fits best
    steps : float; what the fringes leave of the phase steps, over their modulation
    uniform : float; light and dark images against the mean of the fringes
    torn : float; parts of the neighbouring and of the more distant pixels that would lie apart on
        the projector
    """

    code: float
    steps: float
    uniform: float
    torn: float

    @property
    def contradictions(self) -> float:
        """Return the images in contradiction for each pixel."""
        return self.code + self.steps + self.uniform + 2 * self.torn


def agreement(
    grey: Floats, patterns: Sequence[Pattern], shape: tuple[int, int] | None, /
) -> Agreement:
    """Compare grey values with the patterns that may have been projected.

    Parameters
    ----------
    grey : (n_images, 5, n) float32; of pixels, their right and their lower neighbours, and of two
        more distant ones
    patterns : what each image is said to show
    shape : (n_rows, n_cols) of the projector, or None
    """
    plan = PatternPlan(patterns=tuple(patterns), projector_shape=shape)
    fits = {fringe_set: _fit(grey, fringe_set) for fringe_set in plan.fringe_sets}
    steps = sum(float(np.minimum(f.residual, 1).mean()) for f in fits.values())
    mean, modulation = _levels(grey, list(fits.values()))
    clear = np.maximum(CLEAR_OF_MODULATION * modulation, 1e-3)
    signs = np.clip((_with_inverses(grey, plan) - mean) / clear, -1, 1)
    uniform = sum(
        float((1 - (2 * p.level - 1) * signs[i]).mean()) / 2
        for i, p in enumerate(plan.patterns)
        if isinstance(p, Uniform) and p.level in (0.0, 1.0)
    )
    code, torn = 0.0, 0.0
    for angle in plan.angles:
        own = {s: fit.phase for s, fit in fits.items() if s.angle == angle}
        wrong, apart = _on_projector(signs, plan, angle, own)
        code, torn = code + wrong, torn + apart
    return Agreement(code, steps, uniform, torn)


@dataclass(frozen=True, slots=True)
class _Fit:
    phase: Floats
    offset: Floats
    modulation: Floats
    residual: Floats


def _fit(grey: Floats, fringe_set: FringeSet) -> _Fit:
    shifts = np.asarray(fringe_set.shifts)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    solver = np.linalg.pinv(model).astype(np.float32)
    images = grey[list(fringe_set.indices)]
    offset, cosine, sine = np.tensordot(solver, images, axes=1)
    modulation = np.hypot(cosine, sine)
    left = images - np.tensordot(model.astype(np.float32), np.stack([offset, cosine, sine]), axes=1)
    degrees = max(1, len(shifts) - 3)
    rms = np.sqrt((left**2).sum(axis=0) / degrees)
    return _Fit(np.arctan2(sine, cosine), offset, modulation, rms / np.maximum(modulation, 1e-3))


def _levels(grey: Floats, fits: Sequence[_Fit]) -> tuple[Floats, Floats]:
    """Return the threshold between bright and dark, and half their difference."""
    if fits:
        return fits[0].offset, fits[0].modulation
    low, high = grey.min(axis=0), grey.max(axis=0)
    return (low + high) / 2, (high - low) / 2


def _with_inverses(grey: Floats, plan: PatternPlan) -> Floats:
    """Return the grey values, a bit and its inverse as far above and below the middle."""
    pairs = [
        (i, j)
        for code in plan.gray_sets
        for i, j in zip(code.indices, code.inverses, strict=True)
        if i >= 0 and j >= 0
    ]
    if not pairs:
        return grey
    first, second = np.array(pairs).T
    mean = (grey.min(axis=0) + grey.max(axis=0)) / 2
    half = (grey[first] - grey[second]) / 2
    grey = grey.copy()
    grey[first], grey[second] = mean + half, mean - half
    return grey


def _on_projector(
    signs: Floats, plan: PatternPlan, angle: float, phases: dict[FringeSet, Floats]
) -> tuple[float, float]:
    """Return the images that contradict the best place on the projector, and torn neighbours."""
    bits = [(i, p) for i, p in enumerate(plan.patterns)
            if isinstance(p, GrayBit) and p.angle == angle]  # fmt: skip
    if not bits and len(phases) < 2:
        return 0.0, 0.0
    widths = [2 * p.cell_px for _, p in bits] or [s.period_px for s in phases]
    coarse = max(widths) * (1 if phases else CELLS_WITHOUT_PHASE)
    w, cycle = _places(plan, angle, [p for _, p in bits], phases)
    table, seen = [], []
    for index, pattern in bits:
        table.append(np.where(gray_bit(pattern, w), 0.5, -0.5))
        seen.append(signs[index])
    for fringe_set, phase in phases.items():
        waves = TWO_PI * w / fringe_set.period_px
        table += [np.cos(waves), np.sin(waves)]
        seen += [np.cos(phase), np.sin(phase)]
    model = np.stack(table, axis=1).astype(np.float32)
    flat = np.stack(seen).reshape(len(seen), -1)
    best = (model @ flat).argmax(axis=0)
    agree = (model[best].T * flat).mean(axis=1, dtype=np.float64)
    # A bit that is not clear contradicts nothing.
    against = np.maximum(-model[best].T[: len(bits)] * flat[: len(bits)], 0).mean(axis=1)
    wrong = 2 * float(against.sum()) + (len(phases) - float(agree[len(bits) :].sum())) / 2
    place = w[best].reshape(signs.shape[1:])
    step = np.abs(place[1:] - place[0])
    step = np.minimum(step, cycle - step) if cycle else step
    torn = (step[:2] > JUMP_OF_PERIOD * coarse).mean()
    if not cycle:
        torn += (step[2:] > max(FAR_PERIODS * coarse, FAR_OF_PROJECTOR * float(np.ptp(w)))).mean()
    return wrong, float(torn)


def _places(
    plan: PatternPlan, angle: float, bits: Sequence[GrayBit], phases: dict[FringeSet, Floats]
) -> tuple[NDArray[np.float64], float]:
    """Return places w across the stripes, px, and after how many px they repeat; 0 for never."""
    finest = [s.period_px / STEPS_PER_PERIOD for s in phases]
    finest += [min(p.cell_px for p in bits) / STEPS_PER_CELL] if bits else []
    step = min(finest)
    span = max((p.cell_px * (1 << p.n_bits) for p in bits), default=0.0)
    low, high = (0.0, span)
    if plan.projector_shape is not None:
        low, high = extent_px(plan.projector_shape, angle)
    is_cyclic = 0 < span < (high - low) * (1 - EDGE_TOLERANCE)
    is_cyclic |= span > 0 and plan.projector_shape is None  # the code may be a reduced one
    if is_cyclic:
        low, high = 0.0, span
    n = min(MOST_PLACES, round((high - low) / step))
    return low + (np.arange(n) + 0.5) * (high - low) / n, span if is_cyclic else 0.0
