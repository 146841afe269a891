"""Two cameras: the point of equal phase on the epipolar curve (methods M1 and M2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _phase, _search
from fringe3d.correspond.noise import variance_between
from fringe3d.errors import MethodError
from fringe3d.geometry import depth_interval, frustum, grid_rays, pixel_centres, project, rays
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    MeasuringVolume,
    PhaseMap,
    Rejection,
    some_known,
)
from fringe3d.model.rejection import reject

OUTSIDE_VOLUME = 9
"""State of a ray that does not meet the measuring volume; the search has its own states."""

SAMPLE = 5_000

SECOND_SIGMA, SECOND_CALIBRATION_RAD = 6.0, 0.2
"""How far the second direction may disagree: by noise, and by 0.3 px of calibration across fringes
of ten pixels."""


def match_cameras(
    phases1: PhaseMap,
    phases2: PhaseMap,
    camera1: Device,
    camera2: Device,
    volume: MeasuringVolume | None,
    /,
    *,
    second: tuple[PhaseMap, PhaseMap] | None = None,
    beyond: bool = True,
    step: int = 1,
) -> Correspondences:
    """Find in C2 the point with the phase and order of each pixel of C1.

    The epipolar curve (exact, with distortion) is followed inside the volume and the view of
    C2; where the signed phase difference changes its sign and the order class agrees, linear
    interpolation places the point, refined on the curve. A full code makes it method M1, a
    reduced one M2 without the projector's help.

    Parameters
    ----------
    phases1, phases2 : PhaseMap of C1 and C2, of the same fringes
    camera1, camera2 : Device
    volume : MeasuringVolume or None
    second : two PhaseMap or None
        Of C1 and C2, of fringes of another direction, that must agree as well (method M4 without
        a projector).
    beyond : bool
        Look for points that have no match beyond the volume, too, to call them OUTSIDE_VOLUME.
    step : int
        Of C1 there is every step-th row and column alone, as `PhaseMap.every` leaves them.

    Returns
    -------
    Correspondences
        OUTSIDE_VIEW where C2 cannot see the segment, NO_MATCH where no point of it has the
        phase, AMBIGUOUS where several have.

    Notes
    -----
    ``sigma_px = sqrt(sigma_1**2 + sum(w**2 sigma_2**2)) / |d phi_2 / ds|``.
    """
    _require_same_fringes(phases1, phases2)
    valid = phases1.rejection == 0
    origin, directions = grid_rays(camera1)
    directions = directions[::step, ::step][valid]
    seen = frustum(camera2)
    bounds = seen if volume is None else volume.intersection(seen)
    near, far = depth_interval(origin, directions, bounds)
    found = np.empty((len(near), 3))
    state = np.empty(len(near), np.int8)
    to_c2 = camera2.device_from_world
    base, along = to_c2.apply(origin), np.ascontiguousarray(to_c2.rotate(directions))
    phase1, order1 = phases1.phase[valid], phases1.order_class[valid]
    lens2 = lens_of(camera2)
    maps = (phases2.phase, spans_of(phases2.phase), phases2.order_class)
    extra = _second_direction(second, valid)
    over_rows(
        _search.search, len(near), phase1, order1, base, along, near, far, lens2, maps, extra,
        found, state, least=POINTS,
    )  # fmt: skip
    if volume is not None:
        enter, leave = depth_interval(origin, directions, volume)
        misses = ~(enter < leave)
        state[misses] = OUTSIDE_VOLUME
        if phases1.is_absolute and beyond:
            # The table under the object has its true point outside the volume: say so.
            lost = np.flatnonzero(state == _search.NONE)
            first, last = depth_interval(origin, directions[lost], seen)
            before = first, np.minimum(last, enter[lost])
            behind = np.maximum(first, leave[lost]), last
            for near, far in (before, behind):
                found_there = np.empty((len(lost), 3))
                there = np.empty(len(lost), np.int8)
                over_rows(
                    _search.search, len(lost), phase1[lost], order1[lost], base, along[lost],
                    near, far, lens2, maps,
                    _second_direction(None, valid), found_there, there, least=POINTS,
                )  # fmt: skip
                state[lost[there == _search.FOUND]] = OUTSIDE_VOLUME
    pixels_c1 = pixel_centres(camera1.shape)[::step, ::step]
    return _correspondences(phases1, phases2, camera2.name, pixels_c1, valid, found, state)


def spans_of(phase: NDArray[np.float32], /) -> NDArray[np.float32]:
    """Return the phases between the neighbours of a map, (row, col, 2); see
    `_phase.write_spans`."""
    spans = np.empty((*phase.shape, 2), np.float32)
    over_rows(_phase.write_spans, len(phase), phase, spans)
    return spans


def _second_direction(
    second: tuple[PhaseMap, PhaseMap] | None, valid: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return phases of C1, how far those of C2 may differ, rad, and the map of C2."""
    if second is None:
        return np.empty(0, np.float32), np.empty(0, np.float32), np.empty((0, 0), np.float32)
    one, two = second
    limit = SECOND_SIGMA * np.sqrt(2) * one.phase_std[valid] + SECOND_CALIBRATION_RAD
    return one.phase[valid], limit.astype(np.float32), two.phase


def fringe_crossing(phases2: PhaseMap, camera1: Device, camera2: Device, /) -> tuple[float, float]:
    """Tell how the fringes in C2 lie to the epipolar curves.

    Returns
    -------
    gradient, sine : float
        Medians of the phase gradient along the curve, rad / px, and of the sine of the angle
        between fringe and curve: 1 where they cross squarely, 0 where they are parallel and no
        point can be found. NaN where nothing is decoded.
    """
    phase = phases2.phase
    inner = phase[1:-1, 1:-1]
    rows, cols = np.unravel_index(some_known(inner, SAMPLE), inner.shape)
    right, below = phase[rows + 1, cols + 2], phase[rows + 2, cols + 1]
    left, above = phase[rows + 1, cols], phase[rows, cols + 1]
    gradient = np.stack([right - left, below - above], axis=-1).astype(np.float64)
    gradient = (gradient - 2 * np.pi * np.rint(gradient / (2 * np.pi))) / 2
    known = np.isfinite(gradient).all(axis=-1)
    if not known.any():
        return float("nan"), float("nan")
    gradient = gradient[known]
    pixels = np.stack([cols + 1.0, rows + 1.0], axis=-1)[known]
    origin2, directions2 = rays(camera2, pixels)
    # Any depth will do: the point moves along the same line.
    depth = 10 * float(np.linalg.norm(origin2 - camera1.center_world))
    points = origin2 + depth * directions2
    moved = points + 1e-3 * (points - camera1.center_world)
    curve = project(camera2, moved) - project(camera2, points)
    curve /= np.linalg.norm(curve, axis=1, keepdims=True)
    along = np.abs((gradient * curve).sum(axis=1))
    steepness = np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
    return float(np.nanmedian(along)), float(np.nanmedian(along / steepness))


def _require_same_fringes(a: PhaseMap, b: PhaseMap) -> None:
    same = (
        a.period_px == b.period_px
        and a.angle == b.angle
        and np.array_equal(a.class_of_order, b.class_of_order)
    )
    if not same:
        raise MethodError(
            f"cameras '{a.device_name}' and '{b.device_name}': expected phases of the same fringes "
            f"and code, found periods {a.period_px:g} and {b.period_px:g} px at "
            f"{np.degrees(a.angle):g} and {np.degrees(b.angle):g} degrees"
        )


def _correspondences(
    phases1: PhaseMap,
    phases2: PhaseMap,
    name: str,
    pixels_c1: NDArray[np.float64],
    valid: NDArray[np.bool_],
    found: NDArray[np.float64],
    state: NDArray[np.int8],
) -> Correspondences:
    rejection = phases1.rejection.copy()
    full_state = np.full(valid.shape, _search.FOUND, np.int8)
    full_state[valid] = state
    for code, reason in (
        (OUTSIDE_VOLUME, Rejection.OUTSIDE_VOLUME),
        (_search.NO_VIEW, Rejection.OUTSIDE_VIEW),
        (_search.NONE, Rejection.NO_MATCH),
        (_search.SEVERAL, Rejection.AMBIGUOUS),
    ):
        reject(rejection, full_state == code, reason)
    good = rejection == 0
    pixels = np.full((*valid.shape, 2), np.nan)
    slope = np.full(valid.shape, np.nan)
    pixels[valid], slope[valid] = found[:, :2], found[:, 2]
    pixels[~good] = np.nan
    sigma = np.full(valid.shape, np.nan, np.float32)
    variance = phases1.point_std[good].astype(np.float64) ** 2
    variance += variance_between(phases2, pixels[good])
    with np.errstate(divide="ignore"):
        sigma[good] = np.sqrt(variance) / np.abs(slope[good])
    return Correspondences(
        device_name=name,
        pixels_c1=pixels_c1,
        pixels=pixels,
        sigma_px=sigma,
        epipolar_residual_px=np.full(valid.shape, np.nan, np.float32),
        fringe_order=np.where(good, phases1.order_class, NO_ORDER),
        rejection=rejection,
    )
