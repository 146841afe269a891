"""Sums of a robust fit, compiled: no threads of a linear algebra library, no temporary matrices."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TURN_DOUBT = 2.0
"""Standard deviations at which a residual has half the weight (Cauchy)."""


@njit(cache=True, error_model="numpy")
def normal_equations(design, data, coefficients, scatter, share, normal, right, left):  # type: ignore[no-untyped-def]
    """Sum up the normal equations of one step of a robust fit to residuals that wrap.

    design (n, k); data (n, 3): difference, turns, variance, turns**2, and squared steepness,
    (turns / px)**2; coefficients (k,): where residuals are unwrapped and weighed; scatter: px;
    share: weight of each datum. Writes normal (k, k), right (k,) and left (n,): the differences,
    unwrapped.
    """
    n_terms = design.shape[1]
    normal[:], right[:] = 0.0, 0.0
    for i in range(len(design)):
        expected = 0.0
        for a in range(n_terms):
            expected += design[i, a] * coefficients[a]
        residual = data[i, 0] - expected
        turns = np.rint(residual)
        residual -= turns
        left[i] = data[i, 0] - turns
        sigma = math.sqrt(data[i, 1] + data[i, 2] * scatter * scatter)
        doubt = residual / (TURN_DOUBT * sigma)
        weight = share / ((1 + doubt * doubt) * sigma * sigma)
        for a in range(n_terms):
            part = weight * design[i, a]
            right[a] += part * left[i]
            for b in range(a + 1):
                normal[a, b] += part * design[i, b]
    for a in range(n_terms):
        for b in range(a):
            normal[b, a] = normal[a, b]


@njit(cache=True, error_model="numpy")
def misfit_per_px(design, left, data, coefficients, misfit):  # type: ignore[no-untyped-def]
    """Write what a fit leaves of the unwrapped differences, as a displacement, px; NaN if flat."""
    for i in range(len(design)):
        expected = 0.0
        for a in range(design.shape[1]):
            expected += design[i, a] * coefficients[a]
        misfit[i] = abs(left[i] - expected) / math.sqrt(data[i, 2]) if data[i, 2] > 0 else np.nan
