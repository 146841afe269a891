"""Planes through points: flatness, standard deviation, and what a smooth bend leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fringe3d.evaluate.fitting import Fit, Floats, checked_points, square_to, trimmed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane:
    """A plane; its numbers are turns about two axes within it (rad), and its height (mm).

    Parameters
    ----------
    center_mm : (3,) float, mm; mean of the points used, on the plane
    normal : (3,) float, unit length; its largest component is positive
    """

    center_mm: Floats
    normal: Floats

    @property
    def n_parameters(self) -> int:
        """Return 3."""
        return 3

    def distances(self, points_mm: Floats, /) -> Floats:
        """Return signed distances, positive on the normal's side, mm."""
        return np.asarray((points_mm - self.center_mm) @ self.normal)

    def slopes(self, points_mm: Floats, /) -> Floats:
        """Return the derivatives of the distances by turns (mm) and height, (n, 3)."""
        along = (points_mm - self.center_mm) @ square_to(self.normal).T
        return np.column_stack([along, -np.ones(len(points_mm))])

    def moved(self, step: Floats, /) -> Self:
        """Return the plane turned and raised."""
        normal = self.normal + step[:2] @ square_to(self.normal)
        normal /= np.linalg.norm(normal)
        return type(self)(center_mm=self.center_mm + step[2] * self.normal, normal=normal)


def fit_plane(points_mm: ArrayLike, /, *, rejected_part: float = 0.0) -> Fit[Plane]:
    """Fit the plane with the smallest sum of squared distances.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite, n >= 3, not all on one line
    rejected_part : float, 0 <= part < 0.5
        Part of the points (rounded down) that is left out: those farthest from the plane of the
        others. `REJECTED_PART` is what the acceptance test of VDI/VDE 2634 allows.

    Returns
    -------
    Fit of a Plane

    Raises
    ------
    ValueError
        If the points are too few, not finite, or all on one line.

    Notes
    -----
    The normal is the singular vector of the centred points with the smallest singular value.

    Examples
    --------
    >>> fit = fit_plane([[0, 0, 1.0], [1, 0, 1.1], [1, 1, 1.0], [0, 1, 1.1]])
    >>> round(fit.form_mm, 6), round(fit.sigma_mm, 6)
    (0.1, 0.1)
    """
    points = checked_points(points_mm, "plane", 3)
    return trimmed(points, _least_squares, rejected_part, kind="plane")


def sigma_without_bend(points_mm: ArrayLike, fit: Fit[Plane], /, *, degree: int = 3) -> float:
    """Return the standard deviation left after a smooth bend is taken off, too, mm.

    Errors of the calibration bend a plane; the noise of the images does not. This tells the
    noise alone. It is no figure of acceptance: for that, a bend is an error like any other.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; the points of the fit
    fit : Fit of a Plane
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
    used = np.asarray(points_mm, np.float64)[fit.is_used] - fit.surface.center_mm
    on_plane = used @ square_to(fit.surface.normal).T
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


def _least_squares(points: Floats) -> Plane:
    center = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - center, full_matrices=False)
    if sizes[1] <= 1e-12 * max(sizes[0], float(np.abs(points).max())):
        raise ValueError("plane: expected points that span a plane, found them all on one line")
    normal = axes[2]
    up = np.sign(normal[np.argmax(np.abs(normal))])
    return Plane(center_mm=center, normal=normal * up)
