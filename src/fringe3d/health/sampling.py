"""Lit pixels of a recording with their neighbours: what checks of the images look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import Fringe, GrayBit, ImageStack, PatternPlan, Uniform
from fringe3d.model.plan import FringeSet

LIT_OF_TYPICAL, LIT_OF_RANGE = 0.25, 0.03
"""Parts of the brightest pixels' change from image to image, and of the grey values, from which on
a pixel is lit."""

TYPICAL_PERCENTILE = 95

AT_THE_TOP = 0.998
"""Of the range of one of several exposures: brighter is saturated in it; what is rounded stays
above."""

SAMPLE, LEAST_MODULATION_DN = 8_000, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LitMap:
    """How far grey values change from image to image, and where the projector lights the scene.

    Parameters
    ----------
    low, high : (row, col) uint; the darkest and the brightest value of each pixel; where one
        of several exposures is saturated, the saturation of all
    lit : (row, col) bool
    """

    low: NDArray[np.unsignedinteger[Any]]
    high: NDArray[np.unsignedinteger[Any]]
    lit: NDArray[np.bool_]

    def sample(self, saturation_dn: float, /) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of some lit pixels that are never saturated."""
        index = np.flatnonzero(self.lit & (self.high < saturation_dn))
        index = index[:: max(1, len(index) // SAMPLE) | 1]  # an odd step leaves out no column
        rows, cols = np.unravel_index(index, self.lit.shape)
        return rows, cols


@dataclass(frozen=True, slots=True, eq=False)
class Fringes:
    """Fringes of some pixels.

    Parameters
    ----------
    grey : (N, n) float32, DN above black
    phase : (n,) float32, rad, (-pi, pi]
    offset, modulation : (n,) float32, DN
    """

    grey: NDArray[np.float32]
    phase: NDArray[np.float32]
    offset: NDArray[np.float32]
    modulation: NDArray[np.float32]


def fitted(
    stack: ImageStack, fringe_set: FringeSet, rows: NDArray[np.intp], cols: NDArray[np.intp], /
) -> Fringes:
    """Fit the fringes of some pixels by least squares."""
    grey = stack.images[list(fringe_set.indices)][:, rows, cols].astype(np.float32)
    return fringes_of(grey - np.float32(stack.black_level_dn), np.asarray(fringe_set.shifts))


def fringes_of(grey: NDArray[np.float32], shifts: NDArray[np.float64], /) -> Fringes:
    """Fit grey values (N, n) above black of phase steps (N,), rad, by least squares."""
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    offset, cosine, sine = np.linalg.pinv(model).astype(np.float32) @ grey
    modulation = np.maximum(np.hypot(cosine, sine), LEAST_MODULATION_DN)
    return Fringes(grey, np.arctan2(sine, cosine), offset, modulation)


def lit_map(stack: ImageStack, /) -> LitMap:
    """Find the pixels that the projector lights."""
    shown = stack.images[_shown(stack.plan)]
    low, high = shown.min(axis=0), shown.max(axis=0)
    span = (high - low).astype(np.float32)
    if stack.fused is not None:
        scale = stack.fused.scale
        span /= scale  # as the exposure showed it that the pixel comes from
        # Only the fringes choose the exposure: light and code may be saturated in it.
        top = stack.black_level_dn + AT_THE_TOP * stack.range_dn * scale
        high = np.where(high >= top, high.dtype.type(stack.saturation_dn), high)
    typical = float(np.percentile(span, TYPICAL_PERCENTILE))
    least = max(LIT_OF_TYPICAL * typical, LIT_OF_RANGE * stack.range_dn)
    return LitMap(low, high, span > least)


def _shown(plan: PatternPlan) -> list[int]:
    """Return the places of the images of which the plan says what they show."""
    known = Fringe | GrayBit | Uniform
    return [i for i, pattern in enumerate(plan.patterns) if isinstance(pattern, known)]


def neighbours(
    lit: NDArray[np.bool_], n_places: int, distances: Sequence[int], /
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return lit pixels whose right and lower neighbours at some distances are lit.

    Parameters
    ----------
    lit : (row, col) bool
    n_places : int; about how many, evenly from all over the image
    distances : int, px; the largest first

    Returns
    -------
    rows, cols : (1 + 2 m, n) int; the pixels, then for each distance those to the right and those
        below
    """
    whole = lit.copy()
    for apart in distances:
        whole[:, :-apart] &= lit[:, apart:]
        whole[:-apart] &= lit[apart:]
    whole[-max(distances) :] = whole[:, -max(distances) :] = False
    index = np.flatnonzero(whole)
    index = index[:: max(1, len(index) // n_places) | 1]  # an odd step leaves out no column
    row, col = np.unravel_index(index, whole.shape)
    steps = [(0, 0), *(step for apart in distances for step in ((0, apart), (apart, 0)))]
    down, right = np.array(steps).T
    return row + down[:, None], col + right[:, None]
