"""The story of one pixel: its viewing ray, the candidates on it, and the one that was taken."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.geometry import depth_interval, frustum, project, rays, sheet_crossing
from fringe3d.io.stored import StoredResult, angle_of
from fringe3d.model import NO_ORDER, Device, MeasuringVolume, PhaseMap, Rejection
from fringe3d.options import MeasureOptions, volume_of
from fringe3d.patterns import across

TWO_PI = 2 * math.pi


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A fringe order that fits the pixel's phase, and its point.

    Parameters
    ----------
    order : int
    depth_mm : float; distance along the viewing ray
    point_mm : (3,) float, world
    pixels : dict of device name to (2,) float, px; (x, y) where the other devices see it
    is_taken : bool
    residuals : dict of camera name to float, periods; phase that the camera sees there, less that
        of C1, within half a period; NaN where it sees none
    """

    order: int
    depth_mm: float
    point_mm: NDArray[np.float64]
    pixels: dict[str, NDArray[np.float64]]
    is_taken: bool
    residuals: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelStory:
    """What is known of a pixel of C1.

    Parameters
    ----------
    row, col : int
    ends_mm : (2, 3) float, world; where the viewing ray enters and leaves the volume, NaN where it
        misses it
    segments : dict of device name to (2, 2) float, px; the ends as the other devices see them
    candidates : tuple of Candidate; empty where the pixel has no phase, or no projector is known;
        none of a rejected pixel is taken
    words : str; what was taken and why
    phase : float, rad; that of the pixel, NaN where it is not known
    """

    row: int
    col: int
    ends_mm: NDArray[np.float64]
    segments: dict[str, NDArray[np.float64]]
    candidates: tuple[Candidate, ...]
    words: str
    phase: float = math.nan


def seen_volume(stored: StoredResult, /) -> tuple[Device, MeasuringVolume]:
    """Return C1, and the measuring volume as far as C1 sees it and the projector lights it."""
    if stored.rig is None:
        raise MethodError(f"{stored.folder}: expected a rig.toml, found none. Measure again")
    name = stored.record["decoding"][0]["camera"]
    camera = next(camera for camera in stored.rig.cameras if camera.name == name)
    depth = stored.record["options"].get("depth_mm")
    volume = volume_of(stored.rig, name, MeasureOptions(depth_mm=tuple(depth) if depth else None))
    seen = frustum(camera) if volume is None else volume.intersection(frustum(camera))
    lit = stored.rig.projector
    return camera, seen if lit is None else seen.intersection(frustum(lit))


def pixel_story(
    stored: StoredResult,
    row: int,
    col: int,
    /,
    *,
    phases: Mapping[str, PhaseMap] | None = None,
) -> PixelStory:
    """Tell what a measurement made of one pixel of C1.

    Parameters
    ----------
    stored : StoredResult with a rig
    row, col : int; the pixel
    phases : mapping of camera name to PhaseMap; what the cameras see, see `seen_phases`; that of C1
        tells the candidates of rejected pixels

    Raises
    ------
    MethodError
        If there is no such pixel, or no rig.
    """
    n_rows, n_cols = stored.rejection.shape
    if not (0 <= row < n_rows and 0 <= col < n_cols):
        raise MethodError(
            f"pixel: expected row 0 to {n_rows - 1} and column 0 to {n_cols - 1}, found row {row}, "
            f"column {col}"
        )
    camera, volume = seen_volume(stored)
    assert stored.rig is not None
    others = [device for device in stored.rig.devices if device is not camera]
    origin, direction = rays(camera, [float(col), float(row)])
    near, far = (float(t[0]) for t in depth_interval(origin, direction[None], volume))
    missed = not (near < far < math.inf)
    ends = origin + np.array([[near], [far]]) * direction
    ends = np.full((2, 3), np.nan) if missed else ends
    phase = _phase(stored, (row, col), (phases or {}).get(camera.name))
    candidates = (
        () if missed else _candidates(stored, (row, col), phase, origin, direction, (near, far))
    )
    candidates = tuple(_with_residuals(phase, c, phases or {}) for c in candidates)
    return PixelStory(
        row=row,
        col=col,
        ends_mm=ends,
        segments={device.name: project(device, ends) for device in others},
        candidates=candidates,
        words=_words(stored, (row, col), candidates, missed=missed),
        phase=phase,
    )


def _phase(stored: StoredResult, pixel: tuple[int, int], seen: PhaseMap | None) -> float:
    """Return the phase of a pixel, rad: that of its point, else what C1 sees, else NaN."""
    if "absolute_phase" in stored.maps and not stored.rejection[pixel]:
        return float(stored.maps["absolute_phase"][pixel])
    return math.nan if seen is None else float(seen.phase[pixel])


def _candidates(
    stored: StoredResult,
    pixel: tuple[int, int],
    phase: float,
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    depths_mm: tuple[float, float],
) -> tuple[Candidate, ...]:
    """Return the places of the viewing ray that the projector lights with the pixel's phase."""
    assert stored.rig is not None
    projector = stored.rig.projector
    if projector is None or not math.isfinite(phase):
        return ()
    is_kept = not stored.rejection[pixel]
    taken = int(stored.maps["fringe_order"][pixel]) if is_kept else NO_ORDER
    if is_kept and taken == NO_ORDER:
        return ()
    fringes = stored.record["decoding"][0]
    angle, period = angle_of(fringes["direction"]), float(fringes["period_px"])
    part = phase / TWO_PI - taken if is_kept else phase / TWO_PI
    ends = project(projector, origin + np.array(depths_mm)[:, None] * direction)
    turns = np.sort(across(angle, ends[:, 0], ends[:, 1]) / period - part)
    orders = np.arange(math.ceil(turns[0]), math.floor(turns[1]) + 1)
    orders = np.union1d(orders, [taken]) if is_kept else orders
    depths = sheet_crossing(
        projector, origin, np.repeat(direction[None], len(orders), axis=0),
        (orders + part) * period, angle,
    )  # fmt: skip
    others = [device for device in stored.rig.devices if device.name != fringes["camera"]]
    return tuple(
        Candidate(
            order=int(order),
            depth_mm=float(depth),
            point_mm=origin + depth * direction,
            pixels={device.name: project(device, origin + depth * direction) for device in others},
            is_taken=is_kept and bool(order == taken),
            residuals={},
        )
        for order, depth in zip(orders, depths, strict=True)
        if np.isfinite(depth)
    )


def _with_residuals(
    phase: float, candidate: Candidate, phases: Mapping[str, PhaseMap]
) -> Candidate:
    found = {
        name: (phase_at(phases[name].phase, at) - phase) / TWO_PI
        for name, at in candidate.pixels.items()
        if name in phases
    }
    return replace(
        candidate, residuals={n: r - round(r) if r == r else r for n, r in found.items()}
    )


def residual_along(
    stored: StoredResult, story: PixelStory, phases: PhaseMap, /, *, n_steps: int = 2000
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what another camera sees along the part of a viewing ray that lies in the volume.

    Parameters
    ----------
    stored, story : StoredResult, PixelStory; the pixel, which has a phase
    phases : PhaseMap of the other camera
    n_steps : int; places on the ray

    Returns
    -------
    depths_mm, residuals : (n_steps,) float, mm and periods
        Distance along the ray, and the phase there less that of C1, within half a period.
    """
    rig = stored.rig
    assert rig is not None
    other = next(camera for camera in rig.cameras if camera.name == phases.device_name)
    near, far = story.ends_mm
    points = near + np.linspace(0, 1, n_steps)[:, None] * (far - near)
    center = seen_volume(stored)[0].center_world
    seen = np.array([phase_at(phases.phase, at) for at in project(other, points)])
    turns = (seen - story.phase) / TWO_PI
    return np.linalg.norm(points - center, axis=1), turns - np.round(turns)


def phase_at(phase: NDArray[Any], at: NDArray[np.float64], /) -> float:
    """Return a wrapped phase between pixels, rad; NaN where one of the four has none.

    Parameters
    ----------
    phase : (row, col) float, rad
    at : (2,) float, px; (x, y)

    Examples
    --------
    >>> wrapped = np.array([[3.0, -3.0 ], [3.0, -3.0]])  # rises by 0.28 over the seam at pi
    >>> round(phase_at(wrapped, np.array([0.5, 0.5])) % TWO_PI, 3)
    3.142
    """
    if not np.isfinite(at).all():
        return math.nan
    x, y = int(np.floor(at[0])), int(np.floor(at[1]))
    if not (0 <= y < phase.shape[0] - 1 and 0 <= x < phase.shape[1] - 1):
        return math.nan
    corners = phase[y : y + 2, x : x + 2]
    turned = np.exp(1j * corners.astype(np.float64))
    u, v = at[0] - x, at[1] - y
    return float(np.angle([1 - v, v] @ turned @ [1 - u, u]))


def _words(
    stored: StoredResult,
    pixel: tuple[int, int],
    candidates: tuple[Candidate, ...],
    *,
    missed: bool,
) -> str:
    rejected = [reason for reason in Rejection if stored.rejection[pixel] & reason]
    if rejected:
        said = "no point: " + "; ".join(reason.meaning for reason in rejected)
        if candidates:
            said += f". {len(candidates)} fringe orders fit its phase{_missed(candidates)}"
        return said
    x, y, z = stored.maps["points_mm"][pixel]
    sigma = 1000 * float(stored.maps["sigma_mm"][pixel])
    place = f"x {x:.3f}, y {y:.3f}, z {z:.3f} mm, sigma {sigma:.1f} um along the ray"
    if not candidates:
        where = "the ray leaves the volume that projector and camera share" if missed else (
            "without a calibrated projector no candidates are listed"
        )  # fmt: skip
        return f"{place}; {where}"
    probability = float(stored.maps["order_probability"][pixel])
    seen = _seen(candidates)
    return (
        f"{place}; fringe order {int(stored.maps['fringe_order'][pixel])}, one of "
        f"{len(candidates)} on the segment, with probability {probability:.4f}, by method "
        f"{stored.record['method']}: {stored.record['why_this_method']}{seen}"
    )


def _missed(candidates: tuple[Candidate, ...]) -> str:
    """Say which of the candidates of a rejected pixel the other cameras fit best."""
    said = ""
    for name in candidates[0].residuals:
        misses = [(abs(c.residuals[name]), c.order) for c in candidates]
        seen = [miss for miss in misses if math.isfinite(miss[0])]
        if seen:
            least, order = min(seen)
            said += f"; in {name} order {order} misses least, by {least:.3f} periods"
        else:
            said += f"; {name} has no phase at any of them"
    return said


def _seen(candidates: tuple[Candidate, ...]) -> str:
    """Say how well the other cameras tell the candidate taken from the others."""
    said = ""
    for name in candidates[0].residuals:
        misses: dict[bool, list[float]] = {True: [], False: []}
        for candidate in candidates:
            if math.isfinite(candidate.residuals[name]):
                misses[candidate.is_taken].append(abs(candidate.residuals[name]))
        if misses[True]:
            said += f"; in {name} it misses by {misses[True][0]:.3f} periods"
            if misses[False]:
                best = min(misses[False])
                said += f", the best of the others by {best:.3f}"
                if best <= misses[True][0]:
                    said += f": {name} alone would have taken another"
    return said


def nearest_pixel(
    points_mm: NDArray[np.float64], origin: Any, direction: Any, /
) -> tuple[int, int] | None:
    """Return the pixel (row, col) whose point a line of sight hits: the one at the least angle.

    Parameters
    ----------
    points_mm : (row, col, 3) float, NaN where there are none
    origin, direction : (3,) float; of the line
    """
    away = points_mm.reshape(-1, 3) - np.asarray(origin, np.float64)
    axis = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    along = away @ axis
    square = np.einsum("ni,ni->n", away, away)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = np.where(along > 0, square / np.square(along) - 1, np.nan)
    if not np.isfinite(tangent).any():
        return None
    row, col = np.unravel_index(int(np.nanargmin(tangent)), points_mm.shape[:2])
    return int(row), int(col)
