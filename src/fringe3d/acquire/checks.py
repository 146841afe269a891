"""Whether a frame can be that of its pattern: its brightness against white and black."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from fringe3d.acquire.shooting import Trouble
from fringe3d.devices import CameraInfo, Grey
from fringe3d.errors import DeviceError
from fringe3d.model import Fringe, GrayBit, Pattern, Uniform

STEP = 3
"""Every third row and column tells enough, and no fringe is in step with it everywhere."""

LIT_OF_TYPICAL, LIT_OF_RANGE = 0.25, 0.02
"""Parts of the brightest pixels' light, and of the grey values, from which on a pixel is lit."""

AROUND = 5

LEAST_LIT = 0.005
"""Part of the pixels that the projector must light to judge anything."""

LEAST_PIXELS = 50
"""Lit and not saturated: with fewer nothing is judged."""

OUTSIDE, MOST_OUTSIDE = 0.35, 0.25
"""Parts of white less black: how far a pixel may lie beyond them, and how many may."""

NEAR_END, LEAST_NEAR_END = 0.3, 0.5
"""Of a code: so near to white or black are the pixels, and so many at least (edges are blurred)."""

MEAN_OFF = 0.22
"""By which the mean of fringes may differ from one half: a gamma of 2.2 makes 0.14 of it."""

LEVEL_OFF = 0.25
"""By which a uniform image may differ from its level."""

SAME_IMAGE, DIFFERENT_PERCENT = 0.35, 90.0
"""Two images are the same where nine of ten pixels differ by less than a third of what the two
patterns differ by at most (reached by a tenth of the pixels of fringes, by most of a code)."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What a camera sees of white and black, on every third row and column.

    Parameters
    ----------
    black, span : (n,) float32, DN; of the lit pixels
    lit : (row, col) bool; and not saturated by white
    saturated : float; part of the lit pixels that white saturates
    """

    black: NDArray[np.float32]
    span: NDArray[np.float32]
    lit: NDArray[np.bool_]
    saturated: float

    def part_of(self, image: Grey, /) -> NDArray[np.float32]:
        """Return where the lit pixels lie between black (0) and white (1), (n,)."""
        grey = image[::STEP, ::STEP][self.lit].astype(np.float32)
        return (grey - self.black) / self.span


def reference_of(camera: str, white: Grey, black: Grey, info: CameraInfo, /) -> Reference:
    """Return what white and black look like.

    Raises
    ------
    DeviceError
        If the camera sees no light of the projector.
    """
    low = black[::STEP, ::STEP].astype(np.float32)
    high = white[::STEP, ::STEP].astype(np.float32)
    span = high - low
    whole = info.saturation_dn - info.black_level_dn
    least = max(LIT_OF_TYPICAL * float(np.percentile(span, 99)), LIT_OF_RANGE * whole)
    # The mean of neighbours, too: noise alone brightens many single pixels.
    lit = (span > least) & (uniform_filter(span, AROUND) > least)
    if lit.mean() < LEAST_LIT:
        raise DeviceError(
            f"camera '{camera}': expected an image that a white pattern brightens, found one that "
            f"does not differ from that of a black pattern ({100 * lit.mean():.2f} % of the pixels "
            "by more than noise). Switch the projector on, take the lens caps off, expose longer "
            "(--expose auto), or wait longer for the projector (--measure-latency)"
        )
    saturated = float((high[lit] >= info.saturation_dn).mean())
    usable = lit & (high < info.saturation_dn)
    return Reference(low[usable], span[usable], usable, saturated)


def check_content(
    camera: str,
    pattern: Pattern,
    image: Grey,
    reference: Reference,
    earlier: Mapping[int, tuple[Pattern, NDArray[np.float32]]],
    /,
) -> list[Trouble]:
    """Compare an image with what its pattern should look like, and with earlier images.

    Parameters
    ----------
    camera : str
    pattern : Pattern; what the projector should show
    image : (row, col)
    reference : Reference
    earlier : images of the same sequence as parts of white, with their patterns, by place

    Returns
    -------
    list of Trouble
    """
    if len(reference.span) < LEAST_PIXELS:
        return []
    part = reference.part_of(image)
    wrong = _brightness(pattern, part)
    if wrong:
        return [Trouble(kind="brightness", camera=camera, text=f"camera '{camera}': {wrong}")]
    for place, (other, before) in earlier.items():
        if shows_again(other, pattern, before, part):
            text = f"camera '{camera}': the image shows again what image {place} shows"
            return [Trouble(kind="repeated", camera=camera, text=text, like=place)]
    return []


def _brightness(pattern: Pattern, part: NDArray[np.float32]) -> str:
    """Say how the brightness differs from what the pattern says; "" where it does not."""
    beyond = float(((part < -OUTSIDE) | (part > 1 + OUTSIDE)).mean())
    if beyond > MOST_OUTSIDE:
        return f"{100 * beyond:.0f} % of the pixels are brighter than white or darker than black"
    match pattern:
        case Fringe() if abs(mean := float(part.mean()) - 0.5) > MEAN_OFF:
            return f"expected about 50 % of white on average, found {100 * (mean + 0.5):.0f} %"
        case GrayBit():
            near = float((np.minimum(np.abs(part), np.abs(part - 1)) < NEAR_END).mean())
            if near < LEAST_NEAR_END:
                return f"{100 * near:.0f} % of the pixels of a code are near white or black"
        case Uniform(level=level) if level in (0, 1):
            found = float(np.median(part))
            if abs(found - level) > LEVEL_OFF:
                return f"expected {100 * level:.0f} % of white, found {100 * found:.0f} %"
    return ""


def shows_again(
    before: Pattern, now: Pattern, part_before: NDArray[np.float32], part: NDArray[np.float32], /
) -> bool:
    """Tell whether two images are the same though their patterns differ."""
    most = largest_change(before, now)
    if most == 0:
        return False
    change = float(np.percentile(np.abs(part - part_before), DIFFERENT_PERCENT))
    return change < SAME_IMAGE * most


def largest_change(a: Pattern, b: Pattern, /) -> float:
    """Return what two patterns differ by at most, parts of white; 0 where nothing is known.

    Examples
    --------
    >>> from fringe3d.model.plan import fringes
    >>> first, second, *_ = fringes(16.0, 4)
    >>> round(largest_change(first, second), 3)
    0.707
    """
    if isinstance(a, Fringe) and isinstance(b, Fringe):
        if (a.period_px, a.angle) == (b.period_px, b.angle):
            return round(abs(float(np.sin((a.shift - b.shift) / 2))), 9)
        return 1.0
    if isinstance(a, GrayBit) and isinstance(b, GrayBit):
        return float(a != b)
    if isinstance(a, Uniform) and isinstance(b, Uniform):
        return abs(a.level - b.level)
    kinds = (Fringe, GrayBit, Uniform)
    return 1.0 if isinstance(a, kinds) and isinstance(b, kinds) else 0.0
