"""Intensity of a pattern at projector coordinates, and images of patterns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model import Fringe, GrayBit, Pattern, PatternPlan, Response, Uniform
from fringe3d.model.plan import fringes, gray_code

EDGE_TOLERANCE = 1e-9
"""Cells; keeps a pixel centre that falls on a cell edge on its upper side despite rounding."""

ALIKE_PERIODS = 0.025
"""Periods; phases closer than that look alike: three standard deviations of 0.05 rad. Decoding
three noisy steps tells 98 % of the pixels apart at 0.025, and 2 % at 0.016 (16 and 1024 px)."""

MIN_PERIOD_PX, MIN_CELL_PX = 2.0, 1.0
"""Projector px; finer fringes and stripes cannot be shown (sampling theorem)."""


def across(angle: float, x: ArrayLike, y: ArrayLike, /) -> NDArray[np.float64]:
    """Return w, the coordinate across fringes of this angle (rad), at projector pixels (x, y).

    ``w = cos(angle) (x + 1/2) + sin(angle) (y + 1/2)``, projector px.
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    w: NDArray[np.float64] = math.cos(angle) * (x + 0.5) + math.sin(angle) * (y + 0.5)
    return w


def gray_bit(pattern: GrayBit, w: ArrayLike, /) -> NDArray[np.bool_]:
    """Tell where a Gray-code image is bright, at the coordinate w across its stripes (px)."""
    cell = np.floor(np.asarray(w, np.float64) / pattern.cell_px + EDGE_TOLERANCE).astype(np.int64)
    number = (cell + pattern.first_cell) % (1 << pattern.n_bits)
    code = number ^ (number >> 1)
    bright: NDArray[np.bool_] = ((code >> pattern.bit) & 1).astype(bool) ^ pattern.inverted
    return bright


def intensity(pattern: Pattern, x: ArrayLike, y: ArrayLike, /) -> NDArray[np.float64]:
    """Return the intensity of a pattern at projector coordinates.

    Parameters
    ----------
    pattern : Pattern
    x, y : float, projector px; pixel centres are integers

    Returns
    -------
    float64, 0 (dark) to 1 (bright), of the broadcast shape of x and y

    Raises
    ------
    ValueError
        For an `Unused` pattern, of which nothing is known.

    Examples
    --------
    >>> intensity(Fringe(period_px=16, shift=0.0), 7.5, 0.0).item()
    0.0
    """
    match pattern:
        case Fringe():
            phase = 2 * np.pi / pattern.period_px * across(pattern.angle, x, y)
            return 0.5 + 0.5 * np.cos(phase - pattern.shift)
        case GrayBit():
            return gray_bit(pattern, across(pattern.angle, x, y)).astype(np.float64)
        case Uniform():
            shape = np.broadcast_shapes(np.shape(x), np.shape(y))
            return np.full(shape, pattern.level)
        case _:
            raise ValueError("pattern: an unused image has no known intensity")


def pattern_image(
    pattern: Pattern,
    shape: tuple[int, int],
    /,
    *,
    bit_depth: int = 8,
    response: Response | None = None,
) -> NDArray[np.unsignedinteger[Any]]:
    """Return a pattern as the projector's image, sampled at its pixel centres.

    Parameters
    ----------
    pattern : Pattern
    shape : (n_rows, n_cols) of the projector
    bit_depth : 8 or 16
    response : Response with a curve, or None; what brings the wanted brightness is shown

    Returns
    -------
    (row, col) uint8 or uint16; full scale is bright
    """
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    values = intensity(pattern, cols, rows)
    if response is not None:
        values = np.interp(values, response.values, response.levels)
    values = np.broadcast_to(values, shape)
    dtype = np.uint8 if bit_depth == 8 else np.uint16
    return np.round(values * np.iinfo(dtype).max).astype(dtype)


def extent_px(shape: tuple[int, int], angle: float, /) -> tuple[float, float]:
    """Return the smallest and largest w of a projector of `shape` (n_rows, n_cols), px."""
    corners = across(angle, [-0.5, shape[1] - 0.5, -0.5, shape[1] - 0.5],
                     [-0.5, -0.5, shape[0] - 0.5, shape[0] - 0.5])  # fmt: skip
    return float(corners.min()), float(corners.max())


def full_gray_bits(shape: tuple[int, int], cell_px: float, angle: float, /) -> int:
    """Return how many Gray-code images number every cell of a projector uniquely.

    Examples
    --------
    >>> full_gray_bits((768, 1024), 16.0, 0.0)
    6
    """
    lower, upper = extent_px(shape, angle)
    n_cells = math.ceil(upper / cell_px - EDGE_TOLERANCE) - math.floor(
        lower / cell_px + EDGE_TOLERANCE
    )
    return max(1, math.ceil(math.log2(n_cells)))


def unambiguous_px(
    periods_px: Sequence[float], extent: float, /, *, alike: float = ALIKE_PERIODS
) -> float:
    """Return the range that fringes of several periods number without a code.

    It is the smallest shift that leaves every phase as it was, within `alike` periods. A shift by
    a whole number of finest periods is meant: the others tell the orders of the finest apart.

    Parameters
    ----------
    periods_px : float, projector px
    extent : float, px; of the projector across the fringes
    alike : float, periods

    Returns
    -------
    float, px; `extent` where nothing repeats within it

    Examples
    --------
    >>> unambiguous_px([16, 17], 1024), unambiguous_px([16, 32], 1024)
    (272.0, 32.0)
    """
    finest = min(periods_px)
    shifts = finest * np.arange(1, math.ceil(extent / finest - EDGE_TOLERANCE))
    turns = shifts[:, None] / np.asarray(periods_px, np.float64)
    repeats = (np.abs(turns - np.rint(turns)) <= alike).all(axis=1)
    return float(shifts[repeats][0]) if repeats.any() else float(extent)


def sequence(
    shape: tuple[int, int],
    /,
    *,
    periods_px: tuple[float, ...],
    n_shifts: int,
    angles: tuple[float, ...] = (0.0,),
    reverse: bool = False,
    gray: str = "complementary",
    gray_bits: int | None = None,
    inverses: bool = False,
    light_dark: bool = False,
    n_ramp: int = 0,
) -> PatternPlan:
    """Compose a plan for a projector from fringes, Gray code and uniform images.

    Parameters
    ----------
    shape : (n_rows, n_cols) of the projector
    periods_px : float, projector px; the code numbers the periods of the first one
    n_shifts : int, >= 3; 0 for Gray code alone, with cells of the first period's width
    angles : float, rad; one full set of images for each
    reverse : bool; the fringes move towards smaller w
    gray : "none", "plain" (cells of one period) or "complementary" (cells of half a period;
        plain where there are no fringes)
    gray_bits : int or None
        Number of periods told apart is ``2**gray_bits`` (cyclic if that is fewer than there
        are); all of them if None. A complementary code has one image more.
    inverses, light_dark : bool; thresholds for the code, besides the mean of the fringes
    n_ramp : int; grey levels from dark to light, which show the response; 0 for none

    Raises
    ------
    ValueError
        If the projector cannot show the patterns, or if the code tells nothing.

    Examples
    --------
    >>> plan = sequence((768, 1024), periods_px=(16.0,), n_shifts=4)
    >>> plan.n_images, plan.gray_sets[0].n_bits
    (11, 7)
    """
    if not periods_px:
        raise ValueError("plan: expected at least one period_px, found none")
    if gray not in ("none", "plain", "complementary"):
        raise ValueError(f"plan: expected gray none, plain or complementary, found '{gray}'")
    _require_visible(periods_px, n_shifts)
    full = [full_gray_bits(shape, periods_px[0], angle) for angle in angles]
    if gray == "none" and gray_bits is not None:
        raise ValueError(f"plan: expected no gray_bits with gray none, found {gray_bits}")
    if gray != "none":
        _require_useful(shape, periods_px[0], angles, gray_bits, max(full))
    patterns: list[Pattern] = []
    for angle, enough in zip(angles, full, strict=True):
        for period in periods_px if n_shifts else ():
            patterns += fringes(period, n_shifts, angle=angle, reverse=reverse)
        if gray != "none":
            extra = 1 if gray == "complementary" and n_shifts else 0
            cell = periods_px[0] / (1 + extra)
            bits = min(gray_bits or enough, enough) + extra
            patterns += gray_code(cell, bits, angle=angle, inverses=inverses)
    if n_ramp:
        patterns += grey_ramp(n_ramp)
    elif light_dark:
        patterns += [Uniform(level=1.0), Uniform(level=0.0)]
    return PatternPlan(patterns=tuple(patterns), projector_shape=shape)


def grey_ramp(n_levels: int, /) -> tuple[Uniform, ...]:
    """Return uniform images of evenly spaced levels from dark to light.

    Examples
    --------
    >>> [pattern.level for pattern in grey_ramp(3)]
    [0.0, 0.5, 1.0]
    """
    if n_levels < 3:
        raise ValueError(f"plan: expected at least 3 levels of a grey ramp, found {n_levels}")
    return tuple(Uniform(level=float(level)) for level in np.linspace(0, 1, n_levels))


def _require_visible(periods_px: Sequence[float], n_shifts: int) -> None:
    if len(set(periods_px)) < len(periods_px):
        raise ValueError(f"plan: expected different periods, found {list(periods_px)}")
    least = MIN_PERIOD_PX if n_shifts else MIN_CELL_PX
    for period in periods_px:
        if not least <= period < math.inf:
            what = "fringes" if n_shifts else "cells of a code"
            raise ValueError(
                f"plan: expected a period of at least {least:g} px ({what} must not be finer than "
                f"the projector's pixels can show), found {period:g}"
            )


def _require_useful(
    shape: tuple[int, int],
    period_px: float,
    angles: Sequence[float],
    gray_bits: int | None,
    full_bits: int,
) -> None:
    """Refuse a code that numbers one period only, or more periods than there are."""
    width = max(high - low for low, high in (extent_px(shape, angle) for angle in angles))
    if period_px >= width * (1 - EDGE_TOLERANCE):
        raise ValueError(
            f"plan: expected a period below {width:g} px (the projector across the stripes), found "
            f"{period_px:g}: there is nothing to number. Choose a smaller one, or gray none"
        )
    if gray_bits is None or 1 <= gray_bits <= full_bits:
        return
    raise ValueError(
        f"plan: expected gray_bits from 1 to {full_bits} ({full_bits} number all periods of "
        f"{period_px:g} px), found {gray_bits}. No code at all is gray none"
    )


def numbering(plan: PatternPlan, /) -> list[str]:
    """Say where several periods without a code number only a part of the projector.

    A single period without a code is left alone: depth range and geometry may do without.

    Returns
    -------
    list of str; one sentence for each direction: the range, and which methods can use it

    Examples
    --------
    >>> numbering(sequence((768, 1024), periods_px=(16, 17), n_shifts=4, gray="none"))[0][:53]
    'fringes of 16, 17 px look alike again after 272 px of'
    """
    if plan.projector_shape is None:
        return []
    coded, said = {code.angle for code in plan.gray_sets}, []
    for angle in plan.angles:
        periods = [f.period_px for f in plan.fringe_sets if f.angle == angle]
        low, high = extent_px(plan.projector_shape, angle)
        if angle in coded or len(periods) < 2:
            continue
        numbered = unambiguous_px(periods, high - low)
        listed = ", ".join(f"{period:g}" for period in periods)
        if numbered < high - low:
            said.append(
                f"fringes of {listed} px look alike again after {numbered:g} px of "
                f"{high - low:g}. Method m6 can use them: it needs two cameras, the "
                "calibrated projector and the measuring volume. m2 can where no segment in the "
                "projector is longer than that (fringe3d design). All else needs a code (--gray "
                "plain or complementary), or another period in between"
            )
    return said


def method_plan(
    method: str,
    shape: tuple[int, int],
    /,
    *,
    period_px: float,
    n_shifts: int = 4,
    reduced_bits: int = 2,
    angle: float = 0.0,
) -> PatternPlan:
    """Return the images that a method of the source paper needs.

    Parameters
    ----------
    method : "m0" (full Gray code, two directions), "m1" (full, one direction), "m2" (reduced),
        "m4" (two directions, no code), "m3", "m5" or "m6" (fringes alone)
    shape : (n_rows, n_cols) of the projector
    period_px : float, projector px
    n_shifts : int, >= 3
    reduced_bits : int; of the reduced code, which has one image more (over-determined)
    angle : float, rad; of the fringes; a second direction is square to it

    Examples
    --------
    >>> [method_plan(m, (768, 1024), period_px=16, n_shifts=16).n_images
    ...  for m in ("m0", "m1", "m2", "m3", "m4")]
    [48, 25, 21, 16, 32]
    """
    two = (angle, angle + math.pi / 2)
    choices: dict[str, dict[str, Any]] = {
        "m0": {"angles": two, "light_dark": True},
        "m1": {"light_dark": True},
        "m2": {"gray_bits": reduced_bits, "light_dark": True},
        "m3": {"gray": "none"},
        "m4": {"angles": two, "gray": "none"},
        "m5": {"gray": "none"},
        "m6": {"gray": "none"},
    }
    if method not in choices:
        raise ValueError(f"plan: expected one of {', '.join(choices)}, found '{method}'")
    options = {"angles": (angle,)} | choices[method]
    return sequence(shape, periods_px=(period_px,), n_shifts=n_shifts, **options)
