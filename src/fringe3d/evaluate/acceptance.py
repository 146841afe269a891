"""Acceptance of a measuring system: probing error, sphere spacing, flatness (VDI/VDE 2634)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from fringe3d.errors import EmptyResultError
from fringe3d.evaluate.fitting import REJECTED_PART, Bools, Fit, Floats, square_to
from fringe3d.evaluate.plane import Plane, fit_plane
from fringe3d.evaluate.sphere import Sphere, find_spheres, fit_sphere

NEAR_MM, NEAR_SIGMAS = 0.1, 20.0
"""Points nearer to the surface than the larger of the two belong to it, right or wrong; 20 times
the robust standard deviation is far beyond what noise and ripple do."""

MAD_TO_SIGMA = 1.4826

LEAST_POINTS = 100
CORE_PART = 0.4
"""A plane is sought that has this part of the points nearest to it."""

CELLS_IN_MARGIN, FILLING = 4, 2.5
"""The patch of a plane is told in cells of a quarter of the margin, and of 2.5 distances of points
at least: some six points lie in one."""

N_TRIPLES = 200
THIN_TO = 4000


class Decision(StrEnum):
    """What may be said of a value and its limit, given the uncertainty (ISO 14253-1)."""

    PASS = "pass"
    FAIL = "fail"
    OPEN = "not decided"
    NO_LIMIT = "no limit"


def decide(value: float, limit: float | None, expanded_uncertainty: float, /) -> Decision:
    """Decide whether a value conforms to a limit.

    Parameters
    ----------
    value : float; signed
    limit : float or None; of its size
    expanded_uncertainty : float, >= 0; of the value, k = 2

    Returns
    -------
    Decision
        PASS only if the value conforms with all its uncertainty, FAIL only if it exceeds the limit
        with all of it; between it is OPEN.

    Examples
    --------
    >>> [decide(v, 10.0, 1.0).value for v in (8.9, -9.5, 10.5, -11.1)]
    ['pass', 'not decided', 'not decided', 'fail']
    """
    if limit is None:
        return Decision.NO_LIMIT
    if abs(value) + expanded_uncertainty <= limit:
        return Decision.PASS
    return Decision.FAIL if abs(value) - expanded_uncertainty > limit else Decision.OPEN


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Probed:
    """A surface of an artefact as it was measured.

    Parameters
    ----------
    fit : Fit; least squares, 3 per mille of the points may be left out
    chosen : (n,) bool; the points of the cloud that were fitted
    n_far : int; points over (or below) the part of the surface that was fitted, but too far from
        it to belong to it: other things, or gross errors
    """

    fit: Fit[Sphere] | Fit[Plane]
    chosen: Bools
    n_far: int


def probe_spheres(
    points_mm: ArrayLike, diameter_mm: float, n_spheres: int = 1, /, *, cap_deg: float = 60.0
) -> tuple[Probed, ...]:
    """Find spheres in a cloud and fit them as an acceptance test does.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite
    diameter_mm : float, mm; calibrated
    n_spheres : int, >= 1
    cap_deg : float, deg, 0 < cap <= 180; half the opening of the part that is fitted, seen from the
        centre, about the middle of what was measured; 180 takes all (merged views)

    Returns
    -------
    tuple of Probed, in the order of x (then y, z) of their centres

    Raises
    ------
    EmptyResultError
        If there are fewer spheres, or too few points on the cap.
    """
    points = np.asarray(points_mm, np.float64)
    found = find_spheres(points, diameter_mm / 2, n_spheres)
    ordered = sorted(found, key=lambda sphere: tuple(sphere.center_mm))
    return tuple(_probed_sphere(points, sphere, cap_deg) for sphere in ordered)


def _probed_sphere(points: Floats, sphere: Sphere, cap_deg: float) -> Probed:
    off = sphere.distances(points)
    near = np.abs(off) < _nearness(off[np.abs(off) < 0.05 * sphere.radius_mm])
    outward = sphere.normals(points)
    middle = outward[near].mean(axis=0)
    middle /= np.linalg.norm(middle)
    on_cap = outward @ middle >= np.cos(np.radians(cap_deg)) - 1e-12
    chosen = near & on_cap
    _require_points(chosen, f"sphere at {_place(sphere.center_mm)}: the cap of {cap_deg:g} deg")
    far = on_cap & ~near & (off < sphere.radius_mm)
    fit = fit_sphere(points[chosen], rejected_part=REJECTED_PART)
    return Probed(fit=fit, chosen=chosen, n_far=int(far.sum()))


def probe_plane(points_mm: ArrayLike, /, *, margin_mm: float = 2.0) -> Probed:
    """Find the largest plane in a cloud and fit it as an acceptance test does.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite
    margin_mm : float, mm; points nearer to the border of its largest patch are left out

    Returns
    -------
    Probed

    Raises
    ------
    EmptyResultError
        If no plane holds enough of the points.
    """
    points = np.asarray(points_mm, np.float64)
    _require_points(np.ones(len(points), bool), "plane: the cloud")
    plane = _largest_plane(points)
    for _ in range(3):
        off = plane.distances(points)
        near = np.abs(off) < _nearness(off[np.abs(off) < 1.0])
        _require_points(near, "plane")
        plane = fit_plane(points[near], rejected_part=0.1).surface
    inside = _inside(points, points[near], plane, margin_mm)
    chosen = near & inside
    _require_points(chosen, f"plane: further than {margin_mm:g} mm from its border")
    fit = fit_plane(points[chosen], rejected_part=REJECTED_PART)
    return Probed(fit=fit, chosen=chosen, n_far=int((inside & ~near).sum()))


def _nearness(off: Floats) -> float:
    sigma = MAD_TO_SIGMA * float(np.median(np.abs(off))) if len(off) else 0.0
    return max(NEAR_MM, NEAR_SIGMAS * sigma)


def _require_points(chosen: Bools, where: str) -> None:
    if chosen.sum() < LEAST_POINTS:
        raise EmptyResultError(
            f"{where}: expected at least {LEAST_POINTS} points, found {int(chosen.sum())}. Check "
            "the cloud and what it should show"
        )


def _largest_plane(points: Floats) -> Plane:
    """Return the plane through three points that lies nearest to a part of all."""
    rng = np.random.default_rng(len(points))
    sample = points[rng.permutation(len(points))[:THIN_TO]]
    best, least = None, np.inf
    for _ in range(N_TRIPLES):
        try:
            plane = fit_plane(sample[rng.choice(len(sample), 3, replace=False)]).surface
        except ValueError:  # on one line
            continue
        typical = float(np.quantile(np.abs(plane.distances(sample)), CORE_PART))
        if typical < least:
            best, least = plane, typical
    if best is None:
        raise EmptyResultError("plane: expected points that span one, found them all on one line")
    return best


def _inside(points: Floats, on_plane: Floats, plane: Plane, margin_mm: float) -> Bools:
    """Tell which points lie over the largest patch of the plane, further inside than a margin."""
    sides = square_to(plane.normal).T
    flat = (on_plane - plane.center_mm) @ sides
    low = flat.min(axis=0)
    spacing = float(np.sqrt(np.ptp(flat, axis=0).prod() / len(flat)))
    cell = max(margin_mm / CELLS_IN_MARGIN, FILLING * spacing, 1e-9)
    place = ((flat - low) / cell).astype(int) + 1
    is_there = np.zeros(place.max(axis=0) + 2, bool)  # with an empty border
    is_there[tuple(place.T)] = True
    labels, _ = ndimage.label(is_there)
    largest = labels == np.bincount(labels[is_there]).argmax()
    filled = ndimage.binary_fill_holes(largest)
    # The middle of a cell at the border is half a cell inside of it.
    is_inside = (ndimage.distance_transform_edt(filled) - 0.5) * cell >= margin_mm
    own = np.floor(((points - plane.center_mm) @ sides - low) / cell).astype(int) + 1
    within = ((own >= 0) & (own < is_there.shape)).all(axis=1)
    inside = np.zeros(len(points), bool)
    inside[within] = is_inside[tuple(own[within].T)]
    return inside


def _place(center_mm: Floats) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in center_mm) + ") mm"


def spacing_mm(first: Probed, second: Probed, /) -> float:
    """Return the distance of the centres of two fitted spheres, mm."""
    ends = [probed.fit.surface.center_mm for probed in (first, second)]
    return float(np.linalg.norm(ends[1] - ends[0]))
