"""Which way phases must increase in a camera's image: fringes that move the other way show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import depth_interval, frustum, project, rays
from fringe3d.health import LitMap
from fringe3d.model import Device, ImageStack, Rig
from fringe3d.model.plan import FringeSet
from fringe3d.patterns import across

N_PLACES = 16
"""Pixels in each direction at which the rig is asked."""

CLEAR_GRADIENT = 0.1
"""Projector pixels for each camera pixel, over the mean size of a pixel: below, the fringes run
along this axis and say nothing."""

MOST_GRADIENT = 0.4
"""Of the period: from one half on, neighbours do not tell which way the phase goes."""

LEAST_PIXELS, MOST_AGAINST = 500, 0.75
"""Pixels that must be judged, and the part of them that must go the other way."""


def goes_backwards(stack: ImageStack, lit: LitMap, rig: Rig, /) -> tuple[FringeSet, ...]:
    """Return the fringes whose phases increase the other way than the calibrated rig says.

    Two exchanged images of four, or a mirrored projector, are seen by nothing else where there is
    no code.

    Parameters
    ----------
    stack : ImageStack; of a camera of the rig
    lit : LitMap
    rig : Rig; without a projector nothing is known

    Returns
    -------
    tuple of FringeSet
    """
    camera = next((c for c in rig.cameras if c.name == stack.device_name), None)
    if camera is None or rig.projector is None:
        return ()
    return tuple(
        fringes
        for fringes in stack.plan.fringe_sets
        if _is_against(stack, lit, fringes, expected_gradient(camera, rig, fringes.angle))
    )


def expected_gradient(camera: Device, rig: Rig, angle: float, /) -> NDArray[np.float64]:
    """Return how w grows from pixel to pixel along x and y, (2,), projector px for each pixel.

    That of surfaces across the view in the middle of the measuring volume; NaN where nothing is
    known.
    """
    assert rig.projector is not None
    steps = (np.arange(N_PLACES) + 0.5) / N_PLACES
    x, y = np.meshgrid(steps * camera.n_cols, steps * camera.n_rows)
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2) + np.array([[0, 0], [1, 0], [0, 1]])
    origin, directions = rays(camera, pixels)
    bound = frustum(rig.projector)
    bound = bound if rig.volume is None else rig.volume.intersection(bound)
    near, far = depth_interval(origin, directions[:, 0], bound)
    inside = (near < far) & np.isfinite(far)
    if not inside.any():
        return np.full(2, np.nan)
    depth = (near + far)[inside, None, None] / 2
    seen = project(rig.projector, origin + depth * directions[inside])
    w = across(angle, seen[..., 0], seen[..., 1])
    return np.asarray(np.nanmedian(w[:, 1:] - w[:, :1], axis=0))


def _is_against(
    stack: ImageStack, lit: LitMap, fringes: FringeSet, expected: NDArray[np.float64]
) -> bool:
    """Tell whether most phases of neighbouring pixels grow the other way."""
    if not np.isfinite(expected).all() or np.abs(expected).max() < CLEAR_GRADIENT:
        return False
    axis = int(np.argmax(np.abs(expected)))  # 0 along x, 1 along y
    if abs(expected[axis]) > MOST_GRADIENT * fringes.period_px:  # too few pixels for each fringe
        return False
    images = stack.images[list(fringes.indices)].astype(np.float32)
    turns = np.exp(1j * np.asarray(fringes.shifts)).astype(np.complex64)
    phasor = np.tensordot(turns, images, axes=1)
    here, there = (phasor[:, :-1], phasor[:, 1:]) if axis == 0 else (phasor[:-1], phasor[1:])
    usable = lit.lit & (lit.high < stack.saturation_dn)
    both = (usable[:, :-1] & usable[:, 1:]) if axis == 0 else (usable[:-1] & usable[1:])
    step = np.angle(there * here.conj())[both]
    judged = np.abs(step) > 0.2 * 2 * np.pi * abs(expected[axis]) / fringes.period_px
    if judged.sum() < LEAST_PIXELS:
        return False
    against = np.sign(step[judged]) != np.sign(expected[axis])
    return bool(against.mean() > MOST_AGAINST)
