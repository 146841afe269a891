"""Whether light, rig and object stood still while the phase steps were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.health.fault import Fault, Kind
from fringe3d.health.sampling import Fringes, LitMap, fitted, fringes_of
from fringe3d.model import ImageStack
from fringe3d.model.plan import FringeSet

N_BINS, LEAST_IN_BIN, SEEN_PART = 16, 20, 0.36
"""Of other brightness the mean over all phases shows about so much: 0.37 where one image of four is
brighter, at full contrast."""

N_ROUNDS = 6
"""Each finds two thirds of what is left, for A holds a part of the other brightness, too."""

USUAL_SIZE = 0.3
"""Part by which the contrast of a pixel may differ from the median; that of edges differs more."""

FLICKER_PART = 0.006
"""Brightness of one image over that of the others; sound scans have up to 0.002, and 1 % makes an
error of 7 mrad with four steps."""

STEP_ERROR_RAD = 0.03
"""Deviation of a phase step from the plan, rms; half a hundredth of a period."""

DISPLACED_PX, DISPLACED_WITHOUT_DARK_PX = 0.15, 0.4
"""By which the scene moves in the image from the fringes to the light image. Other light falls from
elsewhere: without a dark image, which shows it, shading alone looks like up to 0.25 px."""

TILES, LEAST_TILE_PIXELS, SMOOTH_PX = 6, 60, 1.5
PIXELS_ALIKE = 4 * np.pi * SMOOTH_PX**2
"""After smoothing the noise of so many pixels is one."""

CLEAR_OF_NOISE = 4.5
"""A displacement over its uncertainty; what is less clear counts for nothing. Noise alone
brings a tile so far once in 10**8."""

LEAST_STEPS = 4
"""Of three steps gamma leaves stripes in the mean."""

FEW_PIXELS = 500


@dataclass(frozen=True, slots=True)
class Steps:
    """What phase-shifted images show beyond a fringe that stands still.

    Parameters
    ----------
    flicker : float; largest deviation of an image's brightness from the mean, parts
    step_error : float, rad; rms deviation of the phase steps, as far as the images show it
    second_harmonic : float; over the first, positive where bright fringes are narrow
    """

    flicker: float
    step_error: float
    second_harmonic: float


def steps_of(stack: ImageStack, lit: LitMap, fringe_set: FringeSet, /) -> Steps | None:
    """Take a set of phase-shifted images apart; None where too little is lit.

    Notes
    -----
    Brightness: images of other brightness move the phasors (C + i S) / A of all pixels alike, from
    a circle about zero to one about ``c = 2/N sum eps_n exp(i delta_n)``, which a fit of the
    circle finds whatever the phases are. What c does not show, and the steps and the harmonic: the
    fit leaves of image n, to first order, that part of ``eps_n A + eta_n B sin(phi - delta_n) +
    a B cos 2(phi - delta_n)`` that no fringe explains; eps_n, eta_n and a follow by least squares
    over all pixels. Three steps leave nothing.
    """
    rows, cols = lit.sample(stack.saturation_dn)
    if len(rows) < FEW_PIXELS:
        return None
    fit = fitted(stack, fringe_set, rows, cols)
    grey = fit.grey
    shifts = np.asarray(fringe_set.shifts)
    gains: NDArray[np.float64] = np.ones(len(shifts))
    actual, harmonic = shifts, float("nan")
    for _ in range(N_ROUNDS):
        brighter, later, harmonic = _left_over(fit, actual)
        gains = gains * (1 + _shared(fit, actual) + brighter)
        actual = actual + later
        fit = fringes_of(np.asarray(grey / gains[:, None], np.float32), actual)
    flicker = float(np.abs(gains / gains.mean() - 1).max())
    flicker = min(flicker, _mean_excess(fitted(stack, fringe_set, rows, cols)) / SEEN_PART)
    has_rest = np.isfinite(harmonic)
    error = float(np.sqrt(((actual - shifts) ** 2).mean())) if has_rest else float("nan")
    return Steps(flicker, error, harmonic)


def _mean_excess(fit: Fringes) -> float:
    """Return by how much the mean of an image over evenly weighted phases exceeds A, parts of A.

    It shows a part of other brightness only, but no contrast that goes with the phase, as gamma
    or light between surfaces may make it; 0 where not all phases are seen.
    """
    bins = ((fit.phase + np.pi) * (N_BINS / (2 * np.pi))).astype(np.intp) % N_BINS
    count = np.bincount(bins, minlength=N_BINS)
    if count.min() < LEAST_IN_BIN:
        return 0.0
    weight = 1 / count[bins]
    excess = ((fit.grey - fit.offset) / fit.modulation * weight).sum(axis=1)
    return float(np.abs(excess / (fit.offset / fit.modulation * weight).sum()).max())


def _shared(fit: Fringes, shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much each image is brighter, as far as the centre of the phasors tells, (N,).

    Circle: ``|z|**2 = 2 Re(conj(c) z) + const``, by least squares.
    """
    size = fit.modulation / np.maximum(fit.offset, 1)
    x, y = size * np.cos(fit.phase), size * np.sin(fit.phase)
    usual = np.abs(size - np.median(size)) <= USUAL_SIZE * np.median(size)
    design = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)[usual].astype(np.float64)
    centre, *_ = np.linalg.lstsq(design, (size**2)[usual], rcond=None)
    return np.asarray(centre[0] * np.cos(shifts) + centre[1] * np.sin(shifts))


def _left_over(
    fit: Fringes, shifts: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return what the fit leaves: brightness and phase (rad) of each step, the second harmonic."""
    brightness = fit.offset / fit.modulation
    values = (fit.grey - fit.offset) / fit.modulation
    waves = fit.phase[None] - shifts.astype(np.float32)[:, None]
    n_steps = len(shifts)
    model = np.stack([np.ones(n_steps), np.cos(shifts), np.sin(shifts)], axis=1)
    basis, singular, _ = np.linalg.svd(model)
    free = basis[:, int((singular > 1e-6).sum()) :].astype(np.float32)
    if not free.shape[1]:
        return np.zeros(n_steps), np.zeros(n_steps), float("nan")
    rows = [
        np.concatenate([
            brightness * one[:, None], np.sin(waves) * one[:, None],
            (one @ np.cos(2 * waves))[None],
        ]).T
        for one in free.T
    ]  # fmt: skip
    design, seen = np.concatenate(rows), np.concatenate([one @ values for one in free.T])
    kept = np.abs(seen) <= 2 * np.percentile(np.abs(seen), 95)  # edges
    found, *_ = np.linalg.lstsq(design[kept].astype(np.float64), seen[kept], rcond=1e-3)
    return found[:n_steps], found[n_steps:-1], float(found[-1])


def displacement_px(stack: ImageStack, lit: LitMap, /) -> float:
    """Return how far the scene moved in the image between the fringes and the light image, px.

    The largest of the tiles of the image that have enough texture or borders to tell, but one; NaN
    where there is no light image, or too little is lit.
    """
    index, dark = stack.plan.uniform_index(1.0), stack.plan.uniform_index(0.0)
    places = next((list(s.indices) for s in stack.plan.fringe_sets), [])
    if index < 0 or len(places) < LEAST_STEPS:
        return float("nan")
    early = stack.images[places].mean(axis=0, dtype=np.float32)
    late = stack.images[index].astype(np.float32)
    if dark >= 0:
        early, late = (image - stack.images[dark] for image in (early, late))
    reach = int(np.ceil(3 * SMOOTH_PX))  # smoothing carries so far what is cut off
    cut_off = ndimage.binary_dilation(lit.high >= stack.saturation_dn, iterations=reach)
    usable = ndimage.binary_erosion(lit.lit, iterations=2) & ~cut_off
    early, late = (ndimage.gaussian_filter(image, SMOOTH_PX) for image in (early, late))
    slope = tuple(np.gradient(early))
    moved = [
        step
        for rows in np.array_split(np.arange(stack.shape[0]), TILES)
        for cols in np.array_split(np.arange(stack.shape[1]), TILES)
        if np.isfinite(step := _tile_step(early, late, slope, usable, np.ix_(rows, cols)))
    ]
    return sorted(moved)[-2] if len(moved) > 1 else float("nan")


def _tile_step(
    early: NDArray[np.float32],
    late: NDArray[np.float32],
    slope: Sequence[NDArray[np.float32]],
    usable: NDArray[np.bool_],
    tile: tuple[NDArray[np.intp], ...],
) -> float:
    """Return how far one tile moved, px: ``late = a early + b + slope . step``; 0 if that may be
    noise, NaN where too little is lit."""
    good = usable[tile]
    if good.sum() < LEAST_TILE_PIXELS:
        return float("nan")
    before, after = early[tile][good], late[tile][good]
    design = np.stack([*(s[tile][good] for s in slope), before, np.ones_like(before)], axis=1)
    design = design.astype(np.float64)
    found, *_ = np.linalg.lstsq(design, after, rcond=None)
    left = float(np.std(after - design @ found))
    gain = max(abs(float(found[2])), 1e-3)
    normal = np.linalg.pinv(design.T @ design)[:2, :2]
    sigma = left * np.sqrt(PIXELS_ALIKE * float(np.trace(normal))) / gain
    step = float(np.hypot(*found[:2])) / gain
    return step if step > CLEAR_OF_NOISE * sigma else 0.0


def check_steadiness(stack: ImageStack, lit: LitMap, steps: Steps | None, /) -> list[Fault]:
    """Judge flicker of the light, and vibration or motion."""
    name, faults = stack.device_name, []
    shaken = steps.step_error if steps is not None and steps.step_error > STEP_ERROR_RAD else 0.0
    # Large deviations of the steps look like some flicker, too.
    if steps is not None and steps.flicker > max(FLICKER_PART, shaken):
        text = (
            f"camera '{name}': the brightness changes from one phase step to the next by up to "
            f"{steps.flicker:.1%}"
        )
        faults.append(Fault(kind=Kind.FLICKER, camera=name, figure="change of brightness",
                            value=steps.flicker, limit=FLICKER_PART, text=text))  # fmt: skip
    if shaken:
        text = (
            f"camera '{name}': the phase steps deviate from the plan by {shaken:.2f} rad "
            "(rms): object, projector or camera moved or shook"
        )
        faults.append(Fault(kind=Kind.MOVEMENT, camera=name, figure="deviation of the steps, rad",
                            value=shaken, limit=STEP_ERROR_RAD, text=text))  # fmt: skip
        return faults
    moved = displacement_px(stack, lit)
    has_dark = stack.plan.uniform_index(0.0) >= 0
    limit = DISPLACED_PX if has_dark else DISPLACED_WITHOUT_DARK_PX
    if moved > limit:
        text = (
            f"camera '{name}': from the fringes to the light image the scene moves by {moved:.2f} "
            "px in the image"
        )
        faults.append(Fault(kind=Kind.MOVEMENT, camera=name, figure="movement, px",
                            value=moved, limit=limit, text=text))  # fmt: skip
    return faults
