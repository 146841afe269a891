"""Surfaces through points by least squares of the distances: what all kinds have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model.html import table

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REJECTED_PART = 0.003
"""3 per mille of the points may be left out (VDI/VDE 2634, part 2)."""

MAX_ROUNDS = 50
MAX_STEPS = 60
SETTLED = 1e-13
"""Relative gain of the sum of squares below which a fit is done."""

FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e8


class Surface(Protocol):
    """A surface with a few numbers that can be moved a little."""

    @property
    def n_parameters(self) -> int:
        """Return how many numbers a fit determines."""

    def distances(self, points_mm: Floats, /) -> Floats:
        """Return the signed distances of points (n, 3), mm."""

    def slopes(self, points_mm: Floats, /) -> Floats:
        """Return the derivatives of the distances by the numbers, (n, n_parameters)."""

    def moved(self, step: Floats, /) -> Self:
        """Return the surface with its numbers changed by a step."""


S = TypeVar("S", bound=Surface)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit(Generic[S]):
    """The least-squares surface of a set of points.

    Parameters
    ----------
    surface : Plane, Sphere, Cylinder or Cone
    distances_mm : (n,) float, mm; signed distances of all points
    is_used : (n,) bool; False for the points left out of the fit
    """

    surface: S
    distances_mm: Floats
    is_used: Bools

    @property
    def n_used(self) -> int:
        """Return the number of points used."""
        return int(self.is_used.sum())

    @property
    def n_rejected(self) -> int:
        """Return the number of points left out."""
        return len(self.is_used) - self.n_used

    @property
    def sigma_mm(self) -> float:
        """Return the standard deviation of the distances of the points used, mm.

        The surface's numbers are taken off the degrees of freedom; NaN where none is left.
        """
        squares = float((self.distances_mm[self.is_used] ** 2).sum())
        freedom = self.n_used - self.surface.n_parameters
        return float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")

    @property
    def form_mm(self) -> float:
        """Return the largest minus the smallest distance of the points used, mm."""
        return float(np.ptp(self.distances_mm[self.is_used]))

    @property
    def form95_mm(self) -> float:
        """Return the width of the shortest interval with 95 % of the distances used, mm."""
        return shortest_interval(self.distances_mm[self.is_used], 0.95)

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [
            (field.name, _in_words(field.name, getattr(self.surface, field.name)))
            for field in fields(self.surface)  # type: ignore[arg-type]
        ]
        rows += [
            ("points", f"{self.n_used:,} used, {self.n_rejected:,} left out"),
            ("sigma", f"{1000 * self.sigma_mm:.4g} um"),
            ("form", f"{1000 * self.form_mm:.4g} um; of 95 % {1000 * self.form95_mm:.4g} um"),
        ]
        return table(f"{type(self.surface).__name__.lower()} through points", rows)


def _in_words(name: str, value: Any) -> str:
    """Return a number of a surface with its unit, as its name tells it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    unit = " mm" if name.endswith("_mm") else " rad" if name.endswith("angle") else ""
    numbers = np.atleast_1d(np.asarray(value, np.float64))
    text = ", ".join(f"{number:.4f}" for number in numbers)
    return (f"({text})" if numbers.size > 1 else text) + unit


def shortest_interval(values: ArrayLike, part: float, /) -> float:
    """Return the width of the shortest interval that holds a part of the values.

    Parameters
    ----------
    values : (n,) float, n >= 1
    part : float, 0 < part <= 1; of the values, rounded up to whole ones

    Examples
    --------
    >>> shortest_interval([0.0, 5.0, 5.5, 6.0, 20.0], 0.6)
    1.0
    """
    ordered = np.sort(np.asarray(values, np.float64))
    held = min(len(ordered), int(np.ceil(part * len(ordered) - 1e-9)))
    return float((ordered[held - 1 :] - ordered[: len(ordered) - held + 1]).min())


def trimmed(
    points: Floats, fitted: Callable[[Floats], S], rejected_part: float, /, *, kind: str
) -> Fit[S]:
    """Fit a surface, a part of the points left out: those farthest from that of the others.

    Parameters
    ----------
    points : (n, 3) float, mm
    fitted : fits the surface to points, all of them used
    rejected_part : float, 0 <= part < 0.5; rounded down to whole points
    kind : str; of the surface, for messages

    Notes
    -----
    Fit and choice are repeated until the choice stays (concentration steps, as in least trimmed
    squares): each round lowers the sum of squares, so it ends.
    """
    if not 0 <= rejected_part < 0.5:
        raise ValueError(f"{kind}: rejected_part: expected 0 to 0.5, found {rejected_part}")
    n_used = len(points) - int(rejected_part * len(points))
    is_used = np.ones(len(points), bool)
    surface = fitted(points)
    for _ in range(MAX_ROUNDS if n_used < len(points) else 0):
        nearest = np.argsort(np.abs(surface.distances(points)), kind="stable")[:n_used]
        chosen = np.zeros(len(points), bool)
        chosen[nearest] = True
        if (chosen == is_used).all():
            break
        is_used = chosen
        surface = fitted(points[is_used])
    return Fit(surface=surface, distances_mm=surface.distances(points), is_used=is_used)


def settled(surface: S, points: Floats, /) -> S:
    """Move a surface until the sum of squared distances is least (Levenberg-Marquardt).

    Parameters
    ----------
    surface : Surface to start from
    points : (n, 3) float, mm
    """
    distances = surface.distances(points)
    cost, damping = float(distances @ distances), FIRST_DAMPING
    for _ in range(MAX_STEPS):
        slopes = surface.slopes(points)
        normal, gradient = slopes.T @ slopes, slopes.T @ distances
        scale = np.diag(np.maximum(np.diagonal(normal), 1e-300))
        step, *_ = np.linalg.lstsq(normal + damping * scale, -gradient)
        tried = surface.moved(np.asarray(step, np.float64))
        new = tried.distances(points)
        new_cost = float(new @ new)
        if new_cost <= cost:  # NaN is not
            gain, surface, distances = cost - new_cost, tried, new
            done, cost, damping = gain <= SETTLED * cost, new_cost, damping / 10
        else:
            done, damping = damping > LARGEST_DAMPING, damping * 10
        if done:
            break
    return surface


def fit_covariance(points_mm: ArrayLike, fit: Fit[S], /, *, sigma_mm: ArrayLike) -> Floats:
    """Return the covariance of the numbers of a fitted surface.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; the points of the fit
    fit : Fit
    sigma_mm : (n,) float or one for all, mm; standard deviations of the points' distances: that
        of a point along its viewing ray, times the cosine between ray and normal

    Returns
    -------
    (k, k) float64; order and units of the numbers as the surface says

    Notes
    -----
    The fit weighs all points alike (as acceptance demands), so its numbers are ``H d`` with
    ``H = (J^T J)^-1 J^T``, J the slopes and d the distances; their covariance is
    ``H diag(sigma^2) H^T``. Noise of neighbours is taken as independent.

    Examples
    --------
    >>> from fringe3d.evaluate import fit_plane
    >>> square = [[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]
    >>> np.sqrt(np.diagonal(fit_covariance(square, fit_plane(square), sigma_mm=0.02))).tolist()
    [0.01, 0.01, 0.01]
    """
    used = np.asarray(points_mm, np.float64)[fit.is_used]
    sigma = np.broadcast_to(np.asarray(sigma_mm, np.float64), fit.is_used.shape)[fit.is_used]
    slopes = fit.surface.slopes(used)
    weighted = np.linalg.solve(slopes.T @ slopes, slopes.T) * sigma
    return np.asarray(weighted @ weighted.T)


def checked_points(points_mm: ArrayLike, kind: str, least: int, /) -> Floats:
    """Return points as an array (n, 3); raise ValueError if they are too few or not finite."""
    points = np.asarray(points_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        raise ValueError(
            f"{kind}: expected at least {least} points of shape (n, 3), found shape {points.shape}"
        )
    if not np.isfinite(points).all():
        raise ValueError(f"{kind}: expected finite points, found NaN or infinite ones")
    return points


def square_to(axis: Floats, /) -> Floats:
    """Return two unit vectors square to an axis and to each other, (2, 3)."""
    return np.asarray(np.linalg.svd(axis[None])[2][1:], np.float64)
