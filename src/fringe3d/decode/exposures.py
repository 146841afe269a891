"""Several exposures of one plan, put together pixel by pixel; saturated steps left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import _exposures
from fringe3d.decode.fit import fringe_fit
from fringe3d.decode.sensor import noise_from_steps
from fringe3d.errors import MethodError
from fringe3d.kernels import over_rows
from fringe3d.model import Fringe, Fused, ImageStack, NoiseModel
from fringe3d.model.plan import FringeSet

TOP = 65535
"""Stands for saturated grey values of images that were put together."""

MOST_GROWTH = 4.0
"""By which the noise of the phase may grow where saturated steps are left out."""

LEAST_STEPS_LEFT = 3


def fuse(stacks: Sequence[ImageStack], exposures: Sequence[float], /) -> ImageStack:
    """Put recordings of one plan with several amounts of light together.

    Each pixel comes from the longest exposure in which none of its fringe images is saturated, from
    the shortest where all are; its grey values are those of one exposure, so that the brightness of
    the surface stays even.

    Parameters
    ----------
    stacks : of one camera, one for each exposure
    exposures : amounts of light (time, or brightness of the projector), > 0

    Returns
    -------
    ImageStack of 16 bit, with a noise model

    Notes
    -----
    Grey values above black are multiplied by the longest exposure over their own (`Fused.scale`),
    and by one factor for all that makes them fit into 16 bit. Their variance is ``scale**2 read**2
    + scale gain A``, with the noise model of the longest exposure.

    Examples
    --------
    >>> from fringe3d.model import PatternPlan
    >>> from fringe3d.model.plan import fringes
    >>> plan = PatternPlan(patterns=fringes(16.0, 3))
    >>> long, short = (np.full((3, 1, 2), [[top, 40]], np.uint8) for top in (255, 90))
    >>> one, two = (ImageStack(images=i, plan=plan, device_name="c1", saturation_dn=255,
    ...             noise=NoiseModel(read_noise_dn=1.0)) for i in (long, short))
    >>> fuse([one, two], [4.0, 1.0]).images[0].tolist()
    [[360, 40]]
    """
    order = np.argsort(exposures)
    light = np.asarray(exposures, np.float64)[order]
    ordered = [stacks[i] for i in order]
    first = ordered[0]
    deciding = _deciding(first)
    choice = np.zeros(first.shape, np.intp)
    for number, stack in enumerate(ordered[1:], 1):
        choice[stack.images[deciding].max(axis=0) < stack.saturation_dn] = number
    times = light[-1] / light
    black, span = first.black_level_dn, first.saturation_dn - first.black_level_dn
    pedestal = black * times[0]
    shrink = min(1.0, (TOP - 1) / (pedestal + span * times[0]))
    scale = times.astype(np.float32)
    images = np.empty(first.images.shape, np.uint16)
    for index in range(len(images)):
        every = np.stack([stack.images[index] for stack in ordered])
        raw = np.take_along_axis(every, choice[None], axis=0)[0]
        grey = shrink * pedestal + (raw.astype(np.float32) - np.float32(black)) * (
            np.float32(shrink) * scale[choice]
        )
        grey = np.clip(np.rint(grey), 0, TOP - 1)
        images[index] = np.where((raw >= first.saturation_dn) & (index in deciding), TOP, grey)
    return ImageStack(
        images=images,
        plan=first.plan,
        device_name=first.device_name,
        saturation_dn=float(TOP),
        black_level_dn=float(shrink * pedestal),
        noise=_noise_of(ordered, shrink),
        is_lossy=first.is_lossy,
        response=first.response,
        full_range_dn=float(shrink * span),
        fused=Fused(exposure=light.astype(np.float32)[choice], scale=scale[choice]),
    )


def _deciding(stack: ImageStack) -> list[int]:
    """Return the images that must not be saturated: the fringes, or all where there are none."""
    fringes = [i for i, p in enumerate(stack.plan.patterns) if isinstance(p, Fringe)]
    return fringes or list(range(stack.plan.n_images))


def _noise_of(stacks: Sequence[ImageStack], shrink: float) -> NoiseModel | None:
    """Return the noise of the longest exposure's grey values; None where nothing tells it."""
    model = stacks[-1].noise
    if model is None and stacks[-1].plan.fringe_sets:
        model = _shown_noise(stacks)
    if model is None:
        return None
    return NoiseModel(
        read_noise_dn=shrink * model.read_noise_dn, gain_dn_per_e=shrink * model.gain_dn_per_e
    )


def _shown_noise(stacks: Sequence[ImageStack]) -> NoiseModel:
    for stack in reversed(stacks):
        try:
            return noise_from_steps(stack).model
        except MethodError:
            continue
    fit = fringe_fit(stacks[0], stacks[0].plan.fringe_sets[0], None)
    return NoiseModel(read_noise_dn=float(np.sqrt(fit.read_variance)))


def without_saturated(stack: ImageStack, /) -> ImageStack:
    """Leave saturated phase steps out of the fit, where at least three others determine it.

    Their grey values become what the others say of them; the noise grows accordingly
    (`ImageStack.sigma_growth`). Where a response is to be taken out, all steps are needed, and the
    stack is returned as it is.
    """
    sets = [f for f in stack.plan.fringe_sets if len(f.shifts) > LEAST_STEPS_LEFT]
    if stack.response is not None or not sets:
        return stack
    lost = [_incomplete(stack, fringe_set) for fringe_set in sets]
    if not any(len(pixels) for pixels in lost):
        return stack
    images, growth = stack.images.astype(np.uint16), np.ones(stack.shape, np.float32)
    for index in (i for f in stack.plan.fringe_sets for i in f.indices):
        images[index][stack.images[index] >= stack.saturation_dn] = TOP
    filled = [_fill_in(stack, images, growth, f, p) for f, p in zip(sets, lost, strict=True)]
    if not any(filled):
        return stack
    return replace(stack, images=images, saturation_dn=float(TOP), sigma_growth=growth,
                   full_range_dn=stack.range_dn)  # fmt: skip


def _incomplete(stack: ImageStack, fringe_set: FringeSet) -> NDArray[np.intp]:
    """Return the numbers of the pixels of which some steps are saturated, and enough are not."""
    found, steps = np.empty(stack.shape, np.bool_), np.asarray(fringe_set.indices)
    over_rows(_exposures.find_incomplete, stack.shape[0], stack.images, steps,
              np.float32(stack.saturation_dn), LEAST_STEPS_LEFT, found)  # fmt: skip
    return np.flatnonzero(found)


def _fill_in(
    stack: ImageStack,
    images: NDArray[np.uint16],
    growth: NDArray[np.float32],
    fringe_set: FringeSet,
    some: NDArray[np.intp],
) -> bool:
    """Fill in saturated steps of some pixels, and how the noise grows; tell whether any was."""
    if not len(some):
        return False
    grey = images.reshape(len(images), -1)[np.ix_(np.asarray(fringe_set.indices), some)]
    lost = grey == TOP
    shifts = np.asarray(fringe_set.shifts)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
    plain = (np.linalg.pinv(model)[1:] ** 2).sum() / 2  # phase variance, all steps, over (s/B)**2
    kinds, kind_of = np.unique(lost, axis=1, return_inverse=True)
    changed = False
    for number, missing in enumerate(kinds.T):
        left = model[~missing]
        if np.linalg.matrix_rank(left, tol=1e-6) < 3:
            continue
        chosen = kind_of.ravel() == number
        found = np.linalg.pinv(left) @ grey[:, chosen][~missing]
        filled = model[missing] @ found
        variance = _variance(stack, grey[:, chosen][~missing], found, some[chosen])
        grown = np.sqrt((_across(np.linalg.pinv(left), found) ** 2 * variance).sum(axis=0) / plain)
        good = (grown <= MOST_GROWTH) & (filled.max(axis=0) < TOP - 1)
        pixels = some[chosen][good]
        for place, values in zip(np.flatnonzero(missing), filled[:, good], strict=True):
            images[fringe_set.indices[place]].reshape(-1)[pixels] = np.rint(np.maximum(values, 0))
        flat = growth.reshape(-1)
        flat[pixels] = np.maximum(flat[pixels], grown[good])
        changed |= len(pixels) > 0
    return changed


def _across(solver: NDArray[np.float64], found: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights (steps, n) of the steps for what lies across each phasor."""
    length = np.hypot(found[1], found[2]) + 1e-12
    c, s = found[1] / length, found[2] / length
    return np.asarray(c * solver[2][:, None] - s * solver[1][:, None])


def _variance(
    stack: ImageStack,
    grey: NDArray[np.uint16],
    found: NDArray[np.float64],
    pixels: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the variance of grey values (steps, n) over that of a grey value of the mean A.

    What is saturated is bright, and shot noise with it: the steps that are left have less.
    """
    if stack.noise is None:
        return np.ones(grey.shape)
    scale = 1.0 if stack.fused is None else stack.fused.scale.reshape(-1)[pixels]
    read, gain = scale * stack.noise.read_noise_dn**2, stack.noise.gain_dn_per_e
    own = read + gain * np.maximum(grey - stack.black_level_dn, 0)
    return np.asarray(own / (read + gain * np.maximum(found[0] - stack.black_level_dn, 0)))
