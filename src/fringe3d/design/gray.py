"""The Gray code that a number of periods on a segment needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ENOUGH = 0.01
"""Part of the points that may have a twin: C2 and the neighbours decide about so few."""

BEYOND = 0.4
"""Part of a segment beyond each of its ends in which surfaces outside the volume are expected,
as the table; `measure` warns of the same part."""

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class GrayNeeds:
    """The cyclic Gray code that a number of periods needs.

    Parameters
    ----------
    max_periods : float; on the longest segment
    max_orders : int; the most fringe orders that fit one wrapped phase, guard included
    twins : tuple of float; by number of bits from 0: part of the points in the volume of which
        a second place on the same segment has the same phase and code
    twins_beyond : tuple of float; the same where surfaces up to a part of a segment outside the
        volume are lit and seen, too
    """

    max_periods: float
    max_orders: int
    twins: tuple[float, ...]
    twins_beyond: tuple[float, ...]

    @property
    def exact_bits(self) -> int:
        """Return the bits with which no point at all has a twin: ``ceil(log2 max |K|)``."""
        return max(0, math.ceil(math.log2(self.max_orders)))

    @property
    def bits(self) -> int:
        """Return the least bits with which less than `ENOUGH` of the points have a twin."""
        return _first_below(self.twins)

    @property
    def bits_beyond(self) -> int:
        """Return the same where surfaces beyond the volume are seen."""
        return _first_below(self.twins_beyond)


def _first_below(shares: tuple[float, ...]) -> int:
    return next(bits for bits, share in enumerate(shares) if share < ENOUGH)


def guard_periods(sigma_phase: float, calibration_px: float, period_px: float, /) -> float:
    """Return eps, by which a phase may lie beyond the ends of its segment, in periods.

    ``3 sigma_phi / 2 pi + calibration_px / period_px``

    Parameters
    ----------
    sigma_phase : float, rad
    calibration_px : float, projector px
    period_px : float, projector px
    """
    return 3 * sigma_phase / (2 * math.pi) + calibration_px / period_px


def order_counts(periods: Map, /, *, guard: float = 0.0) -> NDArray[np.int64]:
    """Return ``|K|``, the most fringe orders that fit one wrapped phase, for each segment.

    ``floor(m + 2 guard) + 1``: of the closed interval of phases on a segment, widened by the
    guard on both sides, so many at most differ by whole periods.

    Parameters
    ----------
    periods : (...) float; m; NaN where there is no segment
    guard : float, periods; see `guard_periods`

    Returns
    -------
    (...) int64; 0 where there is no segment

    Examples
    --------
    >>> order_counts(np.array([0.9, 1.0, 4.1, np.nan]), guard=0.01).tolist()
    [1, 2, 5, 0]
    """
    counts = np.floor(np.nan_to_num(periods, nan=-1.0) + 2 * guard) + 1
    return np.where(np.isfinite(periods), counts, 0).astype(np.int64)


def twin_part(periods: Map, n_bits: float, /, *, guard: float = 0.0, beyond: float = 0.0) -> float:
    """Return how many points of the volume share phase and cyclic code with a second place.

    A cyclic code of n bits tells 2**n periods apart. On a segment of m periods a point has a
    twin where another point of the segment lies 2**n periods away: those within m - 2**n of its
    ends, guard included. Points are counted evenly along the segments, in periods.

    Parameters
    ----------
    periods : (...) float; m of each segment; NaN where there is none
    n_bits : float, >= 0; log2 of the periods that the code tells apart
    guard : float, periods
    beyond : float; part of the segment, at both ends, in which surfaces outside the volume may
        be the second place

    Returns
    -------
    float, 0 to 1

    Examples
    --------
    >>> round(twin_part(np.array([4.1]), 2), 3)  # 0.1 periods at each end
    0.049
    """
    m = periods[np.isfinite(periods)]
    reach = m * (1 + beyond) + guard - 2**n_bits
    twins = np.clip(2 * reach, 0, m)
    return float(twins.sum() / m.sum()) if m.sum() > 0 else 0.0


def gray_needs(periods: Map, /, *, guard: float = 0.0, beyond: float = BEYOND) -> GrayNeeds:
    """Return the Gray code that the segments need.

    Parameters
    ----------
    periods : (row, col) float; m of each segment; NaN where there is none; some are finite
    guard : float, periods; see `guard_periods`
    beyond : float; part of a segment, at both ends, for `GrayNeeds.twins_beyond`

    Examples
    --------
    >>> needs = gray_needs(np.array([[3.8, 4.0, 4.01]]))
    >>> needs.max_orders, needs.exact_bits, needs.bits, needs.bits_beyond
    (5, 3, 2, 3)
    """
    orders = int(order_counts(periods, guard=guard).max())
    # Beyond the volume the segments are longer by twice that part, so more bits may be needed.
    widest = math.floor((1 + 2 * beyond) * float(np.nanmax(periods)) + 2 * guard) + 1
    bits = range(math.ceil(math.log2(widest)) + 1)
    return GrayNeeds(
        max_periods=float(np.nanmax(periods)),
        max_orders=orders,
        twins=tuple(twin_part(periods, n, guard=guard) for n in bits),
        twins_beyond=tuple(twin_part(periods, n, guard=guard, beyond=beyond) for n in bits),
    )
