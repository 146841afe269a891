"""How well the images are exposed and focused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.health.fault import Fault, Kind
from fringe3d.health.sampling import LitMap, fitted
from fringe3d.model import Fringe, GrayBit, ImageStack

SATURATED_PART, SATURATED_PATCH, PATCH_OF_IMAGE = 0.02, 0.005, 64
"""Of the lit pixels, scattered and in patches that hold a square of that part of the smaller side
of the image: glints saturate less, and are smaller. A small object before a large table may lose
all its bright side and yet be few pixels."""

DARK_PART, DARK_PERCENTILE = 0.2, 98
"""Part of the grey values that the brightest 2 % of the lit pixels must reach."""

LEAST_CONTRAST, LEAST_VISIBILITY = 0.35, 0.2
"""Modulation of the fringes over half the difference of light and dark; over the mean, where there
is neither light nor dark nor code. A sharp recording whose fringes were projected fainter than its
code has 0.42."""

HARMONIC, MIDDLE = 0.05, 0.1
"""Second harmonic over the first, that of a gamma of 1.16; and, with three steps, by how far the
mean of the fringes is off the middle of light and dark, that of a gamma of 1.4."""

BRIGHT_OF_MODULATION = 1.2
"""Light less dark over the modulation: where the code shows less, a pixel saw one level only."""

FEW_PIXELS = 200


def check_exposure(stack: ImageStack, lit: LitMap, /) -> list[Fault]:
    """Judge saturation and brightness."""
    used = [i for i, p in enumerate(stack.plan.patterns) if isinstance(p, Fringe)]
    used = used or list(range(stack.plan.n_images))
    high = stack.images[used].max(axis=0)
    seen = lit.lit if lit.lit.any() else np.ones_like(lit.lit)
    bright = high[seen].astype(np.float64)
    where, name = f"camera '{stack.device_name}'", stack.device_name
    saturated = seen & (high >= stack.saturation_dn)
    part, patches = (float(s.sum() / seen.sum()) for s in (saturated, _patches(saturated)))
    if part > SATURATED_PART or patches > SATURATED_PATCH:
        value, limit, how = part, SATURATED_PART, ""
        if part <= SATURATED_PART:
            value, limit, how = patches, SATURATED_PATCH, ", in patches"
        text = f"{where}: {value:.1%} of the lit pixels are saturated in the fringes{how}"
        return [Fault(kind=Kind.SATURATION, camera=name, figure="part of the lit pixels",
                      value=value, limit=limit, text=text)]  # fmt: skip
    top = float(np.percentile(bright, DARK_PERCENTILE)) - stack.black_level_dn
    part = top / stack.range_dn
    if part >= DARK_PART:
        return []
    text = (
        f"{where}: the brightest lit pixels reach {part:.0%} of the grey values; "
        f"{0.8 / max(part, 1e-3):.0f} times the light would use them"
    )
    return [Fault(kind=Kind.TOO_DARK, camera=name, figure="part of the grey values",
                  value=part, limit=DARK_PART, text=text)]  # fmt: skip


def _patches(where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Keep what holds a square, and not only glints and noise."""
    side = max(3, min(where.shape) // PATCH_OF_IMAGE)
    return ndimage.binary_opening(where, np.ones((side, side), bool))


@dataclass(frozen=True, slots=True)
class Light:
    """What fringes look like beside light and dark, medians of the lit pixels.

    Parameters
    ----------
    contrast : float; modulation over half of light less dark; over the mean where neither is known
    middle : float; mean of the fringes, 0 dark to 1 light: 0.5 for a linear response; NaN where
        neither is known
    """

    contrast: float
    middle: float


def light_of(stack: ImageStack, lit: LitMap, /) -> Light | None:
    """Compare the fringes with light and dark; None where there are no fringes."""
    if not stack.plan.fringe_sets:
        return None
    rows, cols = lit.sample(stack.saturation_dn)
    if len(rows) < FEW_PIXELS:
        return None
    fit = fitted(stack, stack.plan.fringe_sets[0], rows, cols)
    offset, modulation = fit.offset, fit.modulation
    levels = _levels(stack, rows, cols)
    if levels is not None:
        dark, light = levels
        known = light - dark > BRIGHT_OF_MODULATION * modulation
        if known.sum() >= FEW_PIXELS:
            span = (light - dark)[known]
            contrast = float(np.median(2 * modulation[known] / span))
            return Light(contrast, float(np.median((offset - dark)[known] / span)))
    return Light(float(np.median(modulation / np.maximum(offset, 1))), float("nan"))


def check_focus(stack: ImageStack, light: Light | None, /) -> list[Fault]:
    """Judge the contrast of the fringes."""
    if light is None:
        return []
    limit = LEAST_CONTRAST if np.isfinite(light.middle) else LEAST_VISIBILITY
    if light.contrast >= limit:
        return []
    beside = "of what light and dark allow" if np.isfinite(light.middle) else "of the mean light"
    text = f"camera '{stack.device_name}': the fringes have {light.contrast:.0%} {beside}"
    return [Fault(kind=Kind.DEFOCUS, camera=stack.device_name, figure="contrast of the fringes",
                  value=light.contrast, limit=limit, text=text)]  # fmt: skip


def check_response(stack: ImageStack, light: Light | None, harmonic: float, /) -> list[Fault]:
    """Judge whether grey values follow the patterns linearly; `harmonic` NaN where not known."""
    name = stack.device_name
    if np.isfinite(harmonic):
        value, limit, figure = abs(harmonic), HARMONIC, "second harmonic over the first"
        text = f"bright and dark fringes have other widths (second harmonic {harmonic:+.0%})"
    elif light is not None and np.isfinite(light.middle):
        value, limit = abs(light.middle - 0.5), MIDDLE
        figure = "distance of the mean from the middle of light and dark"
        text = f"the mean of the fringes lies at {light.middle:.0%} from dark to light, not 50 %"
    else:
        return []
    if value <= limit:
        return []
    text = f"camera '{name}': {text}: the grey values do not follow the patterns linearly (gamma)"
    return [Fault(kind=Kind.GAMMA, camera=name, figure=figure, value=value, limit=limit, text=text)]


def _levels(
    stack: ImageStack, rows: NDArray[np.intp], cols: NDArray[np.intp]
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Return dark and light of pixels above the black level, from uniform images or the code."""
    plan, black = stack.plan, np.float32(stack.black_level_dn)
    dark, light = plan.uniform_index(0.0), plan.uniform_index(1.0)
    if dark >= 0 and light >= 0:
        grey = stack.images[[dark, light]][:, rows, cols].astype(np.float32) - black
        return grey[0], grey[1]
    coded = [i for i, p in enumerate(plan.patterns) if isinstance(p, GrayBit)]
    if len(coded) < 2:
        return None
    grey = stack.images[coded][:, rows, cols].astype(np.float32) - black
    return grey.min(axis=0), grey.max(axis=0)
