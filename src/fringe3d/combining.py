"""Points from two cameras and the projector together, each weighted by its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import variance_between
from fringe3d.geometry import project
from fringe3d.model import Correspondences, Device, PhaseMap, PointMap
from fringe3d.patterns import across

Floats = NDArray[np.float64]

DEPTH_STEP = 1e-4
"""Part of the depth by which a point is moved to find how fast its phases change."""

LEAST_POINTS = 500
"""Points that tell how well the projector agrees with the cameras; with fewer it is left out."""

SAMPLE = 40_000

MOST_APART = 5.0
"""Robust standard deviations, beyond which a disagreement counts for nothing: such a point is not
moved either."""

FIT_ROUNDS = 3

SAME_PHASE_RAD = 0.01
"""A search in C2 ends within a thousandth of a radian of the phase of C1."""

BLOCK_PX, LEAST_IN_BLOCK = 12, 36
"""Neighbours whose mean disagreement is what noise does not explain."""

MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """How the projector's phases agree with points of two cameras.

    Parameters
    ----------
    residual : (n,) rad; phase that the projector gives the points, less that of C1, without what
        follows the place smoothly
    slope : (n,) rad / mm; of the projector's phase along the viewing ray
    own_std : float, rad; standard deviation that noise of C1 and C2 does not explain
    """

    residual: Floats
    slope: Floats
    own_std: float


def combined(
    points: PointMap,
    matches: Correspondences,
    phases: Sequence[PhaseMap],
    phases2: PhaseMap,
    cameras: tuple[Device, Device],
    projector: Device,
    /,
) -> tuple[PointMap, tuple[float, ...]]:
    """Move points of two cameras along their rays to where the projector agrees best, too.

    Parameters
    ----------
    points : PointMap; of C1 and C2
    matches : Correspondences from which they were made
    phases : PhaseMap of C1, of each direction; the first is the one that was matched. Orders are
        not needed
    phases2 : PhaseMap of C2, of the first direction
    cameras : (C1, C2)
    projector : Device

    Returns
    -------
    points : PointMap; sigma is that of the combined point, never larger than before
    own_std : rad, for each direction; what the projector's phase is uncertain by besides the noise
        of C1: pattern and calibration; infinite where it could not be told

    Notes
    -----
    Along the ray of C1, C2 places the point with the error ``(e1 - e2) / f2``, the projector with
    ``(e1 - eP) / fP``: e1 is the noise of C1, which both share, e2 that of C2, f the slopes of the
    phases. The best weights are ``C^-1 1 / (1^T C^-1 1)`` with the covariance C of both: that of
    the projector may be negative. A second direction has a noise of its own.

    eP is not what a calibration report says but what the scan shows: the disagreement of all points
    is fitted by a smooth function of the place (ten terms), which is taken away, for it is an error
    of a calibration and belongs to no single point; what is left beyond the noise of C1 and C2, of
    pixels or of the means of neighbours, is eP. So a projector whose calibration is off moves no
    surface and, where its error is not smooth, weighs less.
    """
    placed = _placed(points, matches, phases[0], phases2, cameras)
    if placed is None:
        return points, tuple(np.inf for _ in phases)
    shift, variance, stds = np.zeros(len(placed.index)), placed.sigma**2, []
    for number, one in enumerate(phases):
        own = placed.of(one.point_std) ** 2
        found, explained = _compared(placed, one, projector, is_first=number == 0)
        stds.append(found.own_std)
        if np.isfinite(found.own_std):
            fits = np.abs(found.residual) < MOST_APART * np.sqrt(explained + found.own_std**2)
            shared = placed.noise1 / placed.slope2 * (number == 0)
            # Never better than C1 sees it: pattern and response are not in the noise.
            least = float(np.median(own))
            found = replace(found, own_std=float(np.sqrt(max(found.own_std**2, least))))
            stds[-1] = found.own_std
            moved, less = _weighed(shift, variance, found, own, shared)
            shift, variance = np.where(fits, moved, shift), np.where(fits, less, variance)
    best = _moved(points, placed.index, placed.rays, shift, np.sqrt(variance))
    return best, tuple(stds)


def disagreement(
    points: PointMap,
    matches: Correspondences,
    phases: PhaseMap,
    phases2: PhaseMap,
    cameras: tuple[Device, Device],
    projector: Device,
    /,
) -> Floats:
    """Return by how many standard deviations the projector disagrees with points of two cameras.

    Parameters
    ----------
    points, matches, phases, phases2, cameras, projector : see `combined`; `phases` is the map that
        was matched

    Returns
    -------
    (row, col) float64; with the sign of the phase. What follows the place smoothly, as the error of
    a calibration does, is taken away; NaN where there is nothing to compare
    """
    apart = np.full(points.rejection.shape, np.nan)
    placed = _placed(points, matches, phases, phases2, cameras)
    if placed is None:
        return apart
    found, explained = _compared(placed, phases, projector, is_first=True)
    if np.isfinite(found.own_std):
        least = float(np.median(placed.noise1))
        variance = explained + max(found.own_std**2, least)
        apart.ravel()[placed.index] = found.residual / np.sqrt(variance)
    return apart


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Placed:
    """Points that C1 and C2 place.

    Parameters
    ----------
    index : (n,) int; their pixels
    points_mm, rays : (n, 3) float
    depth_mm, sigma : (n,) mm
    noise1, noise2 : (n,) rad**2; of the phases of C1 and C2
    slope2 : (n,) rad / mm; of the phase of C2 along the ray
    shape : of the map
    """

    index: NDArray[np.intp]
    points_mm: Floats
    rays: Floats
    depth_mm: Floats
    sigma: Floats
    noise1: Floats
    noise2: Floats
    slope2: Floats
    shape: tuple[int, int]

    def of(self, values: NDArray[np.float32]) -> Floats:
        """Return the values (row, col) of the points' pixels, (n,)."""
        return values.reshape(-1)[self.index].astype(float)


def _placed(
    points: PointMap,
    matches: Correspondences,
    phases: PhaseMap,
    phases2: PhaseMap,
    cameras: tuple[Device, Device],
) -> _Placed | None:
    """Return the points that C2 places, None where they are too few."""
    good = points.is_valid & _is_crossing(matches.pixels, phases.phase, phases2.phase)
    index = np.flatnonzero(good.ravel())
    if len(index) < LEAST_POINTS:
        return None
    here = points.points_mm.reshape(-1, 3)[index]
    rays = here - cameras[0].center_world
    depth = np.linalg.norm(rays, axis=1)
    rays /= depth[:, None]
    pixels = matches.pixels.reshape(-1, 2)[index]
    sigma = points.sigma_mm.reshape(-1)[index].astype(float)
    noise1 = phases.point_std.reshape(-1)[index].astype(float) ** 2
    noise2 = variance_between(phases2, pixels)
    slope2 = np.sqrt(noise1 + noise2) / sigma
    slope2 *= _sign_along(phases2, pixels, here, rays * (DEPTH_STEP * depth)[:, None], cameras[1])
    return _Placed(index=index, points_mm=here, rays=rays, depth_mm=depth, sigma=sigma,
                   noise1=noise1, noise2=noise2, slope2=slope2, shape=good.shape)  # fmt: skip


def _compared(
    placed: _Placed, one: PhaseMap, projector: Device, *, is_first: bool
) -> tuple[Agreement, Floats]:
    """Return how the projector agrees, and the variance of that which noise explains, rad**2.

    is_first: the direction that was matched; C1's noise then moves the point and is asked for, too.
    """
    raw, slope = _residual(one, placed.of(one.phase), placed.points_mm, placed.rays,
                           placed.depth_mm, projector)  # fmt: skip
    part = slope / placed.slope2
    if is_first:
        explained = placed.noise1 * (part - 1) ** 2 + placed.noise2 * part**2
    else:
        own = placed.of(one.point_std) ** 2
        explained = own + (placed.noise1 + placed.noise2) * part**2
    return _agreement(
        raw, slope, explained, placed.points_mm, placed.index, placed.shape
    ), explained


def _is_crossing(
    pixels: Floats, phase1: NDArray[np.float32], phase2: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Tell where C2 has the phase of C1: elsewhere the projector has placed the point already."""
    n_rows, n_cols = phase2.shape
    x, y = (np.nan_to_num(pixels[..., axis], nan=-1.0) for axis in (0, 1))
    inside = (x >= 0) & (y >= 0) & (x < n_cols - 1) & (y < n_rows - 1)
    col, row = (np.where(inside, v, 0).astype(int) for v in (x, y))
    right, below = x - col, y - row
    away = np.zeros(inside.shape)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (right if j else 1 - right) * (below if i else 1 - below)
        off = phase2[row + i, col + j].astype(float) - phase1
        away += weight * (off - 2 * np.pi * np.rint(off / (2 * np.pi)))
    return np.asarray(inside & (np.abs(away) < SAME_PHASE_RAD))


def _weighed(
    shift: Floats, variance: Floats, found: Agreement, own: Floats, shared: Floats
) -> tuple[Floats, Floats]:
    """Return shift and variance, mm and mm**2, with one more place along the ray.

    shared: mm rad; what its noise and that of the point have in common, times its slope.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        place = -found.residual / found.slope
        its = (own + found.own_std**2) / found.slope**2
        both = shared / found.slope
        weight = (variance - both) / (variance + its - 2 * both)
        better = variance - weight * (variance - both)
    weight = np.where(np.isfinite(weight + place), weight, 0.0)
    better = np.where(weight != 0, better, variance)
    return shift + weight * (np.nan_to_num(place) - shift), np.minimum(better, variance)


def _residual(
    phases: PhaseMap, phase: Floats, points: Floats, rays: Floats, depth: Floats, projector: Device
) -> tuple[Floats, Floats]:
    """Return the phase that the projector gives points, less that of C1, rad, wrapped; and how
    fast it changes along the rays, rad / mm."""
    step = (DEPTH_STEP * depth)[:, None]
    per_px = 2 * np.pi / phases.period_px
    seen, then = (
        per_px * across(phases.angle, *project(projector, place).T)
        for place in (points, points + step * rays)
    )
    away = seen - phase
    away -= 2 * np.pi * np.rint(away / (2 * np.pi))
    return away, (then - seen) / step[:, 0]


def _sign_along(
    phases: PhaseMap, pixels: Floats, points: Floats, step: Floats, camera: Device
) -> Floats:
    """Return whether the phase of C2 rises (1) or falls (-1) as points move along their rays."""
    way = project(camera, points + step) - project(camera, points)
    n_rows, n_cols = phases.phase.shape
    col = np.clip(pixels[:, 0].astype(int), 0, n_cols - 2)
    row = np.clip(pixels[:, 1].astype(int), 0, n_rows - 2)
    here = phases.phase[row, col].astype(float)
    right = phases.phase[row, col + 1] - here
    below = phases.phase[row + 1, col] - here
    gradient = np.stack([right, below], axis=1)
    gradient -= 2 * np.pi * np.rint(gradient / (2 * np.pi))
    return np.where(np.nan_to_num((gradient * way).sum(axis=1)) < 0, -1.0, 1.0)


def _agreement(
    raw: Floats,
    slope: Floats,
    explained: Floats,
    points: Floats,
    index: NDArray[np.intp],
    shape: tuple[int, int],
) -> Agreement:
    """Take away what follows the place smoothly, and tell what noise does not explain."""
    known = np.flatnonzero(np.isfinite(raw + explained) & (explained > 0))
    if len(known) < LEAST_POINTS:
        return Agreement(residual=raw, slope=slope, own_std=np.inf)
    part = known[:: max(1, len(known) // SAMPLE)]
    terms = _terms(points)
    left, kept = raw - np.median(raw[part]), part
    for number in range(FIT_ROUNDS + 1):
        if number > 0:  # a small part that is far off must not bend the first fit
            weight = 1 / np.sqrt(explained[kept])
            model = terms[kept] * weight[:, None]
            smooth, *_ = np.linalg.lstsq(model, raw[kept] * weight, rcond=None)
            left = raw - terms @ smooth
        left -= 2 * np.pi * np.rint(left / (2 * np.pi))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(left[part]) / np.sqrt(explained[part])))
        kept = part[np.abs(left[part]) < MOST_APART * spread * np.sqrt(explained[part])]
    of_pixels = (spread**2 - 1) * float(np.median(explained[part]))
    own = max(of_pixels, _of_blocks(left, explained, known, index, shape), 0.0)
    return Agreement(residual=left, slope=slope, own_std=float(np.sqrt(own)))


def _of_blocks(
    left: Floats,
    explained: Floats,
    known: NDArray[np.intp],
    index: NDArray[np.intp],
    shape: tuple[int, int],
) -> float:
    """Return the variance of the means of neighbours that their noise does not explain, rad**2."""
    row, col = np.unravel_index(index[known], shape)
    block = row // BLOCK_PX * (shape[1] // BLOCK_PX + 1) + col // BLOCK_PX
    number = np.bincount(block)
    enough = number >= LEAST_IN_BLOCK
    if not enough.any():
        return 0.0
    mean = np.bincount(block, left[known])[enough] / number[enough]
    noise = np.bincount(block, explained[known])[enough] / number[enough] ** 2
    # Half of the blocks, those that agree best, are free of edges and of wrong orders.
    return float((MAD_TO_SIGMA * np.median(np.abs(mean))) ** 2 - np.median(noise))


def _terms(points: Floats) -> Floats:
    """Return 1 and all products up to the second order of the place, (n, 10), scaled to one."""
    middle = np.median(points, axis=0)
    scale = np.maximum(np.percentile(np.abs(points - middle), 90, axis=0), 1e-6)
    x, y, z = ((points - middle) / scale).T
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x], axis=1)


def _moved(
    points: PointMap, index: NDArray[np.intp], rays: Floats, shift: Floats, sigma: Floats
) -> PointMap:
    places, deviation = points.points_mm.reshape(-1, 3).copy(), points.sigma_mm.ravel().copy()
    places[index] += shift[:, None] * rays
    deviation[index] = sigma
    return replace(
        points,
        points_mm=places.reshape(points.points_mm.shape),
        sigma_mm=deviation.reshape(points.sigma_mm.shape),
    )
