"""Counts of points, and the shares that the tables print. Plain numbers, no images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

DOUBT_EDGES = (0.0, *(10.0**exponent for exponent in np.arange(-6, 0.1, 0.5)))
"""Of 1 - p: two bins for each decade from a millionth on, and one below."""

ROUNDING = 1e-9
"""1 - 0.99 is a little more than 0.01."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Pixels of one measurement, or of several together.

    Parameters
    ----------
    reference : lit points of the object in the volume which both cameras see
    m1_right, m1_wrong, m1_false : reference pixels that M1 has right and wrong, false points of M1
    right, wrong : reference pixels with a point of the right and of a wrong order
    false : points where there should be none
    false_misplaced : those that also lie at a wrong place
    false_beyond_m1 : those where M1 has none
    undecided : reference pixels that are AMBIGUOUS
    """

    reference: int = 0
    m1_right: int = 0
    m1_wrong: int = 0
    m1_false: int = 0
    right: int = 0
    wrong: int = 0
    false: int = 0
    false_misplaced: int = 0
    false_beyond_m1: int = 0
    undecided: int = 0

    @property
    def completeness(self) -> float:
        """Return right points over those of M1, per cent."""
        return percent(self.right, self.m1_right)

    def of_reference(self, name: str, /) -> float:
        """Return one of the counts over the reference pixels, per cent."""
        return percent(getattr(self, name), self.reference)

    def shares(self) -> dict[str, float]:
        """Return all that the tables print, per cent."""
        names = [field.name for field in fields(self) if field.name != "reference"]
        return {"completeness": self.completeness} | {n: self.of_reference(n) for n in names}


def percent(part: float, whole: float, /) -> float:
    """Return a share in per cent; NaN of nothing.

    Examples
    --------
    >>> percent(1, 4)
    25.0
    """
    return 100 * part / whole if whole else float("nan")


def total(counts: Iterable[Counts], /) -> Counts:
    """Return the counts of several measurements together.

    Examples
    --------
    >>> total([Counts(reference=4, right=3), Counts(reference=6, right=6)]).of_reference("right")
    90.0
    """
    rows = [asdict(one) for one in counts]
    return Counts(**{field.name: sum(row[field.name] for row in rows) for field in fields(Counts)})


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Points by the doubt 1 - p in their fringe order, in the bins of `DOUBT_EDGES`.

    Parameters
    ----------
    points, wrong : (n,) float; how many there are, and how many of them are wrong
    doubt : (n,) float; the sum of 1 - p, which is how many should be wrong
    """

    points: Floats
    wrong: Floats
    doubt: Floats

    @property
    def calibration_error(self) -> float:
        """Return the expected calibration error: mean of |share wrong - mean doubt|, 0 to 1."""
        return float(np.abs(self.wrong - self.doubt).sum() / self.points.sum())

    def beyond(self, least_probability: float, /) -> tuple[float, float, float]:
        """Return how many points have at least this probability, how many of them are wrong, and
        how many should be.

        The probability should be one of the bins' edges.
        """  # fmt: skip
        bins = np.asarray(DOUBT_EDGES[1:]) <= (1 - least_probability) * (1 + ROUNDING)
        return tuple(float(a[bins].sum()) for a in (self.points, self.wrong, self.doubt))  # type: ignore[return-value]

    def record(self) -> dict[str, Any]:
        """Return the bins as plain data."""
        return {name: getattr(self, name).tolist() for name in ("points", "wrong", "doubt")}


def reliability(probability: ArrayLike, is_right: ArrayLike, /) -> Reliability:
    """Sort points into bins by the probability of their order.

    Parameters
    ----------
    probability : (n,) float, 0 to 1
    is_right : (n,) bool

    Examples
    --------
    >>> found = reliability([0.5, 0.5, 1.0, 1.0], [True, False, True, True])
    >>> found.calibration_error, found.beyond(0.99)
    (0.0, (2.0, 0.0, 0.0))
    """
    doubt = np.clip(1 - np.asarray(probability, np.float64), 0, 1)
    wrong = ~np.asarray(is_right, bool)
    edges = np.asarray(DOUBT_EDGES) * (1 + ROUNDING)
    place = np.clip(np.searchsorted(edges, doubt, side="left") - 1, 0, None)
    points, failed, expected = (
        np.bincount(place, weights, minlength=len(DOUBT_EDGES) - 1).astype(np.float64)
        for weights in (None, wrong, doubt)
    )
    return Reliability(points, failed, expected)


def pooled(parts: Iterable[Reliability], /) -> Reliability:
    """Return the points of several measurements together."""
    found = list(parts)
    points, wrong, doubt = (
        np.sum([getattr(part, name) for part in found], axis=0)
        for name in ("points", "wrong", "doubt")
    )
    return Reliability(points, wrong, doubt)
