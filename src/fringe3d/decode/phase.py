"""Wrapped phase, offset, modulation and their noise from phase-shifted images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode.fit import MAX_PHASE_STD, FringeFit, fringe_fit, wrapped_map
from fringe3d.decode.fused import decode_set
from fringe3d.decode.ripple import corrected
from fringe3d.model import ImageStack, Rejection, WrappedPhaseMap
from fringe3d.model.plan import FringeSet
from fringe3d.model.rejection import reject

ROWS_AT_ONCE = 128


def wrapped_phase(
    stack: ImageStack,
    fringe_set: FringeSet,
    /,
    *,
    min_modulation_dn: float | None = None,
    plain: bool = False,
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
    plain : bool
        Compute with NumPy alone: slow, and the same within rounding. For comparison.

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
    if not plain:
        return decode_set(stack, fringe_set, min_modulation_dn).wrapped
    fit = fringe_fit(stack, fringe_set, min_modulation_dn)
    offset, cosine, sine = _solve(stack, fringe_set, fit)
    modulation = np.hypot(cosine, sine)
    phase = corrected(fit.ripple, np.arctan2(sine, cosine))
    rejection = np.zeros(stack.shape, np.uint16)
    saturated = stack.images[list(fringe_set.indices)].max(axis=0) >= stack.saturation_dn
    reject(rejection, saturated, Rejection.SATURATED)
    mean_std = replace(fit, waves=None).phase_std(offset, modulation, phase)
    usable = (modulation >= np.float32(fit.lowest_dn)) & (mean_std < MAX_PHASE_STD)
    reject(rejection, ~usable, Rejection.LOW_MODULATION)
    phase = np.where(rejection == 0, phase, np.float32(np.nan))
    return wrapped_map(
        stack,
        fringe_set,
        fit,
        phase=phase,
        offset=offset,
        modulation=modulation,
        phase_std=fit.phase_std(offset, modulation, phase),
        rejection=rejection,
        decided=rejection,
    )


def _solve(
    stack: ImageStack, fringe_set: FringeSet, fit: FringeFit
) -> tuple[NDArray[np.float32], ...]:
    """Return A above black, C and S, each (row, col)."""
    maps = np.empty((3, *stack.shape), np.float32)
    for top in range(0, stack.shape[0], ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        images = stack.images[list(fringe_set.indices), rows].astype(np.float32)
        maps[:, rows] = np.tensordot(fit.solver, images, axes=1)
    maps[0] -= np.float32(stack.black_level_dn)
    return tuple(maps)
