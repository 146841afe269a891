"""Planes through points: flatness, standard deviation, and what a smooth bend leaves over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REJECTED_PART = 0.003
"""3 per mille of the points may be left out (VDI/VDE 2634, part 2)."""

MAX_ROUNDS = 50
PLANE_PARAMETERS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneFit:
    """The least-squares plane of a set of points.

    Parameters
    ----------
    center_mm : (3,) float, mm; mean of the points used, on the plane
    normal : (3,) float, unit length; its largest component is positive
    distances_mm : (n,) float, mm; signed distances of all points, positive on the normal's side
    is_used : (n,) bool; False for the points left out of the fit
    """

    center_mm: Floats
    normal: Floats
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

        Three degrees of freedom are the plane's; NaN for three points.
        """
        squares = float((self.distances_mm[self.is_used] ** 2).sum())
        freedom = self.n_used - PLANE_PARAMETERS
        return float(np.sqrt(squares / freedom)) if freedom > 0 else float("nan")

    @property
    def flatness_mm(self) -> float:
        """Return the largest minus the smallest distance of the points used, mm."""
        return float(np.ptp(self.distances_mm[self.is_used]))


def fit_plane(points_mm: ArrayLike, /, *, rejected_part: float = 0.0) -> PlaneFit:
    """Fit the plane with the smallest sum of squared distances.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite, n >= 3, not all on one line
    rejected_part : float, 0 <= part < 0.5
        Part of the points (rounded down) that is left out: those farthest from the plane of the
        others. `REJECTED_PART` is what the acceptance test of VDI/VDE 2634 allows.

    Returns
    -------
    PlaneFit

    Raises
    ------
    ValueError
        If the points are too few, not finite, or all on one line.

    Notes
    -----
    The normal is the singular vector of the centred points with the smallest singular value.
    Leaving out repeats fit and choice until the choice stays (concentration steps, as in least
    trimmed squares): each round lowers the sum of squares, so it ends.

    Examples
    --------
    >>> fit = fit_plane([[0, 0, 1.0], [1, 0, 1.1], [1, 1, 1.0], [0, 1, 1.1]])
    >>> round(fit.flatness_mm, 6), round(fit.sigma_mm, 6)
    (0.1, 0.1)
    """
    points = _checked(points_mm)
    if not 0 <= rejected_part < 0.5:
        raise ValueError(f"plane: rejected_part: expected 0 to 0.5, found {rejected_part}")
    n_used = len(points) - int(rejected_part * len(points))
    is_used = np.ones(len(points), bool)
    center, normal = _least_squares(points)
    for _ in range(MAX_ROUNDS if n_used < len(points) else 0):
        nearest = np.argsort(np.abs((points - center) @ normal), kind="stable")[:n_used]
        chosen = np.zeros(len(points), bool)
        chosen[nearest] = True
        if (chosen == is_used).all():
            break
        is_used = chosen
        center, normal = _least_squares(points[is_used])
    return PlaneFit(
        center_mm=center,
        normal=normal,
        distances_mm=(points - center) @ normal,
        is_used=is_used,
    )


def sigma_without_bend(points_mm: ArrayLike, fit: PlaneFit, /, *, degree: int = 3) -> float:
    """Return the standard deviation left after a smooth bend is taken off, too, mm.

    Errors of the calibration bend a plane; the noise of the images does not. This tells the
    noise alone. It is no figure of acceptance: for that, a bend is an error like any other.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; the points of the fit
    fit : PlaneFit
    degree : int, >= 1; of the polynomial in the two coordinates on the plane

    Returns
    -------
    float, mm
        Of the points used; the polynomial's terms are taken off the degrees of freedom. NaN where
        there are no more points than terms.

    Examples
    --------
    >>> x, y = (axis.ravel() for axis in np.mgrid[:20.0, :20.0])
    >>> bent = np.stack([x, y, 1e-3 * x * y], axis=-1)
    >>> sigma_without_bend(bent, fit_plane(bent)) < 1e-4 < fit_plane(bent).sigma_mm
    True
    """
    if degree < 1:
        raise ValueError(f"plane: degree: expected a whole number of at least 1, found {degree}")
    used = np.asarray(points_mm, np.float64)[fit.is_used] - fit.center_mm
    _, _, axes = np.linalg.svd(fit.normal[None])
    on_plane = used @ axes[1:].T
    on_plane = on_plane / np.abs(on_plane).max()
    terms = [
        on_plane[:, 0] ** i * on_plane[:, 1] ** j
        for i in range(degree + 1)
        for j in range(degree + 1 - i)
    ]
    freedom = len(used) - len(terms)
    if freedom <= 0:
        return float("nan")
    basis = np.stack(terms, axis=-1)
    distances = fit.distances_mm[fit.is_used]
    left = distances - basis @ np.linalg.lstsq(basis, distances)[0]
    return float(np.sqrt((left**2).sum() / freedom))


def _checked(points_mm: ArrayLike) -> Floats:
    points = np.asarray(points_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < PLANE_PARAMETERS:
        raise ValueError(
            f"plane: expected at least 3 points of shape (n, 3), found shape {points.shape}"
        )
    if not np.isfinite(points).all():
        raise ValueError("plane: expected finite points, found NaN or infinite ones")
    return points


def _least_squares(points: Floats) -> tuple[Floats, Floats]:
    center = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - center, full_matrices=False)
    if sizes[1] <= 1e-12 * max(sizes[0], float(np.abs(points).max())):
        raise ValueError("plane: expected points that span a plane, found them all on one line")
    normal = axes[2]
    return center, normal * np.sign(normal[np.argmax(np.abs(normal))])
