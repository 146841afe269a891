"""What pixels beside much brighter ones see: their neighbours' light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode.camera import CameraPhases
from fringe3d.decode.footprint import PIXEL_VARIANCE
from fringe3d.model import PhaseMap

MOST_PX = 0.7
"""From so far away a pixel has its light at most: beside a bright field all of it comes from the
field's border, half a pixel and a little beyond."""


def mixed_camera(phases: CameraPhases, /, *, blur_px: float) -> CameraPhases:
    """Return the phases of a camera, their noise raised where neighbours are much brighter.

    See `mixed`; all phase maps of all directions.
    """
    directions = tuple(
        replace(
            direction,
            main=mixed(direction.main, blur_px=blur_px),
            others=tuple(mixed(m, blur_px=blur_px) for m in direction.others),
        )
        for direction in phases.directions
    )
    return replace(phases, directions=directions)


def mixed(phases: PhaseMap, /, *, blur_px: float = 0.4) -> PhaseMap:
    """Return a phase map whose noise counts where the light of each pixel may come from.

    Pixel and lens spread light with the variance ``s = 1/12 + blur**2``; so the light of a pixel
    comes from ``s grad B / B`` beside its centre, B its own modulation. In one exposure darker
    neighbours of bright pixels have no phase, or much noise. In a series of exposures all have
    little noise, and that place is what they are uncertain by.

    Parameters
    ----------
    phases : PhaseMap; a map known to whole code cells only stays as it is
    blur_px : float, px, >= 0; standard deviation of the lens blur

    Returns
    -------
    PhaseMap; `phase_std` and `detailed_std` raised

    Examples
    --------
    >>> phase = np.broadcast_to(0.3 * np.arange(6.0), (3, 6))
    >>> light = np.broadcast_to([1.0, 1, 1, 100, 100, 100], (3, 6))
    >>> phases = PhaseMap(phase=phase, order_class=0 * phase, class_of_order=[0],
    ...     phase_std=0 * phase + 0.01, offset=light, modulation=light, rejection=0 * phase,
    ...     period_px=16.0, angle=0.0, device_name="c1")
    >>> [f"{std:.2f}" for std in mixed(phases).phase_std[1]]  # 0.7 px of 0.3 rad beside the border
    ['0.01', '0.01', '0.21', '0.04', '0.01', '0.01']
    """
    if phases.is_quantised:
        return phases
    spread = PIXEL_VARIANCE + blur_px**2
    variance = np.zeros(phases.phase.shape, np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        for axis in (0, 1):
            light = np.nan_to_num(phases.modulation, posinf=0.0, neginf=0.0)
            place = spread * np.abs(np.gradient(light, axis=axis)) / phases.modulation
            rise = _rise(phases.phase, axis)
            variance += np.nan_to_num(np.minimum(place, MOST_PX) * rise).astype(np.float32) ** 2
        raised = np.sqrt(phases.phase_std**2 + variance)
        detailed = phases.detailed_std
        if detailed is not None:
            detailed = np.sqrt(detailed**2 + variance)
    return replace(phases, phase_std=raised, detailed_std=detailed)


def _rise(phase: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return how the phase rises along an axis, rad / px: the mean of both sides, or the known."""
    step = np.diff(phase, axis=axis)
    step -= 2 * np.pi * np.rint(step / (2 * np.pi))
    before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
    before[axis], after[axis] = (1, 0), (0, 1)
    sides = [np.pad(step, width, constant_values=np.nan) for width in (before, after)]
    left = np.where(np.isnan(sides[0]), sides[1], sides[0])
    right = np.where(np.isnan(sides[1]), sides[0], sides[1])
    return np.asarray((left + right) / 2, np.float32)
