"""Points and fringe orders against the truth: how many are there, how many are wrong.

Everything here takes plain arrays, so that the result of any program can be judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Verdict(IntEnum):
    """What became of a pixel."""

    MISSING = 0
    RIGHT = 1
    WRONG = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """How complete a measurement is, and how wrong.

    Parameters
    ----------
    n_reference : int; pixels that should have a point
    n_right : int; reference pixels with a point of the right order
    n_wrong : int; reference pixels with a point of a wrong order
    n_accepted_anywhere : int; points, of all pixels
    n_wrong_anywhere : int; points of a wrong order, of all pixels
    """

    n_reference: int
    n_right: int
    n_wrong: int
    n_accepted_anywhere: int
    n_wrong_anywhere: int

    @property
    def completeness(self) -> float:
        """Return right points over reference pixels; NaN without a reference."""
        return _share(self.n_right, self.n_reference)

    @property
    def error_rate(self) -> float:
        """Return wrong points over all points, of the reference pixels; NaN without points."""
        return _share(self.n_wrong, self.n_right + self.n_wrong)

    @property
    def error_rate_anywhere(self) -> float:
        """Return wrong points over all points, of all pixels; NaN without points."""
        return _share(self.n_wrong_anywhere, self.n_accepted_anywhere)


def errors_along_rays(
    points_mm: ArrayLike, true_points_mm: ArrayLike, origin_mm: ArrayLike, /
) -> Floats:
    """Return how far points lie behind the true ones, along the viewing rays of these.

    Parameters
    ----------
    points_mm, true_points_mm : (..., 3) float, mm, world frame; NaN where there is none
    origin_mm : (3,) float, mm; the centre of projection of the camera

    Returns
    -------
    (...) float64, mm
        Signed: positive beyond the true point. What lies across the ray does not count. NaN
        where one of the points is missing.

    Examples
    --------
    >>> errors_along_rays([3.0, 0.1, 4.0], [0.0, 0.0, 5.0], [0.0, 0.0, 0.0]).item()
    -1.0
    """
    true = np.asarray(true_points_mm, np.float64)
    rays = true - np.asarray(origin_mm, np.float64)
    with np.errstate(invalid="ignore"):
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    error: Floats = ((np.asarray(points_mm, np.float64) - true) * rays).sum(axis=-1)
    return error


def verdicts(errors_mm: ArrayLike, accepted: ArrayLike, limit_mm: ArrayLike, /) -> NDArray[np.int8]:
    """Judge points by their distance from the true ones.

    Parameters
    ----------
    errors_mm : (...) float, mm; NaN where there is no true point
    accepted : (...) bool; there is a point
    limit_mm : (...) float or one for all, mm
        Half the step by which one fringe order moves a point tells right from wrong orders; a
        plain threshold tells good from bad points.

    Returns
    -------
    (...) int8, `Verdict`
        A point is WRONG beyond its limit, and also where there is nothing to be seen.

    Examples
    --------
    >>> verdicts([0.1, -4.0, np.nan, np.nan], [True, True, True, False], 3.0).tolist()
    [1, 2, 2, 0]
    """
    is_right = np.abs(np.asarray(errors_mm, np.float64)) <= np.asarray(limit_mm, np.float64)
    return _verdicts(is_right, accepted)


def verdicts_of_orders(
    orders: ArrayLike, true_orders: ArrayLike, accepted: ArrayLike, /
) -> NDArray[np.int8]:
    """Judge fringe orders by the true ones.

    Parameters
    ----------
    orders, true_orders : (...) int; they must count from the same period
    accepted : (...) bool; there is a point

    Returns
    -------
    (...) int8, `Verdict`

    Notes
    -----
    Next to the wrap of the phase, noise moves a point from one order into the next although it
    hardly moves in space: `verdicts` of the distances do not count that as wrong.

    Examples
    --------
    >>> verdicts_of_orders([3, 4, 5], [3, 5, 5], [True, True, False]).tolist()
    [1, 2, 0]
    """
    return _verdicts(np.asarray(orders) == np.asarray(true_orders), accepted)


def _verdicts(is_right: Bools, accepted: ArrayLike) -> NDArray[np.int8]:
    chosen = np.where(is_right, Verdict.RIGHT, Verdict.WRONG)
    return np.where(np.asarray(accepted, bool), chosen, Verdict.MISSING).astype(np.int8)


def score(verdict: ArrayLike, reference: ArrayLike, /) -> Score:
    """Count verdicts.

    Parameters
    ----------
    verdict : (...) int, `Verdict`; of all pixels
    reference : (...) bool; the pixels that should have a point: those lit, in the volume and seen
        by both cameras, or those that a better method measured right

    Returns
    -------
    Score

    Raises
    ------
    ValueError
        If the two have different shapes.

    Examples
    --------
    >>> found = score([1, 1, 2, 0, 2], [True, True, True, True, False])
    >>> found.completeness, round(found.error_rate, 3), found.error_rate_anywhere
    (0.5, 0.333, 0.5)
    """
    found, wanted = np.asarray(verdict), np.asarray(reference, bool)
    if found.shape != wanted.shape:
        raise ValueError(
            f"score: expected a reference of shape {found.shape}, found {wanted.shape}"
        )
    right, wrong = found == Verdict.RIGHT, found == Verdict.WRONG
    return Score(
        n_reference=int(wanted.sum()),
        n_right=int((right & wanted).sum()),
        n_wrong=int((wrong & wanted).sum()),
        n_accepted_anywhere=int((right | wrong).sum()),
        n_wrong_anywhere=int(wrong.sum()),
    )


def false_share(accepted: ArrayLike, on_object: ArrayLike, may_be: ArrayLike, /) -> float:
    """Return the points where there should be none, over the points of the object.

    Parameters
    ----------
    accepted : (...) bool; there is a point
    on_object : (...) bool; the pixel sees the object inside the volume
    may_be : (...) bool; pixels whose points are not counted as false, besides those of the
        object: next to its border a pixel sees both, object and surroundings

    Returns
    -------
    float, >= 0
        May exceed 1; NaN where the object has no points.

    Examples
    --------
    >>> false_share([True, True, True, False], [True, True, False, False], [False] * 4)
    0.5
    """
    there, own = np.asarray(accepted, bool), np.asarray(on_object, bool)
    false = there & ~own & ~np.asarray(may_be, bool)
    return _share(int(false.sum()), int((there & own).sum()))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
