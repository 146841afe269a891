"""The poses of a rig's devices from its own measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import (
    FittedPoses,
    Homologous,
    ball_center,
    contradiction,
    expected_contradiction,
    fit_poses,
    homologous_points,
    located,
    moved_text,
    which_moved,
)
from fringe3d.correspond import match_both_directions, match_cameras
from fringe3d.decode import CameraPhases, decode, decode_apart
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.geometry import closest_depths, pixel_grid, project, rays
from fringe3d.health import EPIPOLAR_WARNING_PX, Finding
from fringe3d.health.finding import Level
from fringe3d.matching import best_direction_first, match
from fringe3d.methods import choose_method, images_of, settle
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    PhaseMap,
    Rejection,
    Rig,
    RigCovariance,
    Scan,
)
from fringe3d.options import MeasureOptions, keep_images, volume_of
from fringe3d.patterns import across
from fringe3d.pose_search import LEAST_CERTAINTY, fit_as_it_is, fit_turned

Floats = NDArray[np.float64]

ROUNDS = 3
"""Points on epipolar curves are searched again with the poses found."""

CONTRADICTIONS = ("epipolar_residual_px", "trinocular_residual_px", "lost_part")
"""Findings after which it is asked which device moved."""

SPARSE_POINTS = 30_000
"""Pixels of C1 that are enough to tell which device moved."""

FEW_POINTS = 4_000
"""Pixels of C1 that are enough to tell whether one did."""

LIMIT_FACTOR, LEAST_LIMIT_PX = 3.0, 0.1
"""Of what calibration and noise let expect; and what response and interreflection may add."""

NEAR_PX = 3.0
"""How far from a pixel of C1 the point may be that a known length begins at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownLength:
    """A known distance between two points of the first scan, or the centres of two balls.

    Parameters
    ----------
    first_px, second_px : (x, y), px, in C1; the points, or any on the balls
    length_mm : float, mm, > 0
    of_balls : bool
    """

    first_px: tuple[float, float]
    second_px: tuple[float, float]
    length_mm: float
    of_balls: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfCalibrated:
    """A rig with the poses that its own measurements show.

    Parameters
    ----------
    rig : Rig; without bias and covariance, which belonged to the former poses
    fitted : FittedPoses
    n_directions : int; 1 or 2, the most that a scan has
    length_factor : float; by which a known length changed the scale; 1 without one
    """

    rig: Rig
    fitted: FittedPoses
    n_directions: int
    length_factor: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Recording:
    """A decoded scan and the method that finds its correspondences."""

    scan: Scan
    phases: tuple[CameraPhases, ...]
    method: str

    @property
    def maps(self) -> list[PhaseMap]:
        """Return the phase map of C1 for each fringe angle."""
        return [direction.main for direction in self.phases[0].directions]

    @property
    def is_free(self) -> bool:
        """Tell whether the points do not depend on the poses: those of equal phases."""
        if len(self.phases) < 3 and len(self.maps) > 1:
            return all(m.is_absolute for i in range(len(self.phases)) for m in self.maps_of(i)[:2])
        return False

    @property
    def is_numbered(self) -> bool:
        """Tell whether a code or a second direction says which fringe is which."""
        return self.method != "m6" or self.maps[0].is_absolute

    def maps_of(self, camera: int) -> list[PhaseMap]:
        """Return those of a camera for the same periods."""
        pairs = zip(self.phases[camera].directions, self.maps, strict=True)
        return [direction.like(main) for direction, main in pairs]


def self_calibrate(
    scans: Sequence[Scan],
    rig: Rig,
    options: MeasureOptions | None = None,
    /,
    *,
    length: KnownLength | None = None,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> SelfCalibrated:
    """Find the poses of all devices from scans without any target.

    Lenses, and the place of C1, stay as they are; the distance from C1 to the second camera (to the
    projector, if there is one camera) gives the scale, or a known length.

    Parameters
    ----------
    scans : sequence of Scan; of anything, recorded since the devices stand as they do
    rig : Rig; as they stood
    options : MeasureOptions or None; which of the images to use, and the depth range
    length : KnownLength or None
    step : called with the work, what is done and what there is to do

    Returns
    -------
    SelfCalibrated

    Raises
    ------
    MethodError
        If no device could contradict another: one camera, or two without a projector, with fringes
        of one direction.
    EmptyResultError
        If there are too few homologous points.

    Notes
    -----
    See `fringe3d.calibrate.fit_poses`. With full code in two directions the second camera's point
    is that of equal phases. Otherwise it is searched on the epipolar curve, where it is off along
    its fringe as far as devices moved, and is searched again with the poses found.
    """
    options = options or MeasureOptions()
    work, n_steps = "self-calibrating", len(scans) + ROUNDS
    recordings = []
    for number, scan in enumerate(scans):
        step(work, number, n_steps)
        recordings.append(_decoded(scan, rig, options))
    before = _devices(rig, recordings)
    is_numbered = any(r.is_numbered for r in recordings)
    fitted, found = None, rig
    if not is_numbered:
        found = _with_orders(recordings, rig, options, step)
    for number in range(1 if all(r.is_free for r in recordings) else ROUNDS):
        step(work, len(scans) + number, n_steps)
        points = [_homologous(r, found, options) for r in recordings]
        near = fitted.devices if fitted is not None else _devices(found, recordings)
        fitted = fit_poses(points, before, near=near)
        found = _with(rig, fitted.devices)
        if not is_numbered and number < ROUNDS - 1:
            found = _with_orders(recordings, found, options)
    step(work, n_steps, n_steps)
    assert fitted is not None
    factor = 1.0
    if length is not None:
        factor = length.length_mm / distance_of(length, points[0], fitted.devices)
        found = _with(rig, fitted.scaled(factor))
    return SelfCalibrated(
        rig=found,
        fitted=fitted,
        n_directions=max(len(p.angles) for p in points),
        length_factor=factor,
    )


def check_moved(
    findings: Sequence[Finding],
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    covariance: RigCovariance | None = None,
    /,
) -> list[Finding]:
    """Say which device moved, where devices contradict each other by more than the calibration.

    Parameters
    ----------
    findings : what the other checks found
    phases : CameraPhases of two cameras; the direction that was matched first
    matches : Correspondences of the second camera
    devices : the cameras of `phases`, then the projector if there is one
    covariance : RigCovariance or None
        Of the calibration: the limit of the contradictions follows from it. Without one what other
        checks found is asked, and the limit is 0.5 px.
    """
    found = [f for f in findings if f.name in CONTRADICTIONS and f.level != "ok"]
    maps = [direction.main for direction in phases[0].directions]
    if len(devices) < 3 or any(m.is_quantised for m in maps):
        return []
    limit, judged = EPIPOLAR_WARNING_PX, []
    try:
        if covariance is not None:
            limit, value = _limit(phases, matches, devices, covariance)
            if value < limit:
                text = f"devices contradict each other by {value:.2f} px, at most {limit:.2f} px"
                judged = [Finding("ok", "contradiction_px", value, f"{text} by the calibration")]
            elif not found:
                return _moved(phases, matches, devices, limit, level="warning")
        if not found or judged:
            return judged
    except EmptyResultError:
        pass
    is_error = any(f.level == "error" for f in found)
    return _moved(phases, matches, devices, limit, level="error" if is_error else "warning")


def _limit(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    covariance: RigCovariance,
) -> tuple[float, float]:
    """Return how far devices may contradict each other, and how far they do, px."""
    few = np.zeros(matches.rejection.shape, bool)
    step = max(1, round(np.sqrt(few.size / FEW_POINTS)))
    few[::step, ::step] = True
    sparse = replace(matches, rejection=np.where(few, matches.rejection, Rejection.NO_MATCH))
    points = homologous_of(phases[:2], sparse, devices)
    value = contradiction([points], devices)
    if value < LEAST_LIMIT_PX:
        return LEAST_LIMIT_PX, value
    expected = LIMIT_FACTOR * expected_contradiction(points, devices, covariance)
    return float(np.clip(expected, LEAST_LIMIT_PX, EPIPOLAR_WARNING_PX)), value


def _moved(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    limit_px: float,
    *,
    level: Level,
) -> list[Finding]:
    """Say which device moved; nothing below the limit."""
    maps = [direction.main for direction in phases[0].directions]
    pairs = zip(phases[1].directions, maps, strict=True)
    sparse = [_sparse(m) for m in maps]
    matches = _freely(sparse, [d.like(m) for d, m in pairs], devices) or matches
    points = [homologous_of(phases[:2], matches, devices)]
    try:
        if contradiction(points, devices) < limit_px:
            return []
        moved = which_moved(points, devices)
    except EmptyResultError:
        return []
    if moved.residual_px < EPIPOLAR_WARNING_PX and not moved.is_of_poses:
        return []  # what is left is that of fringes, not of poses
    again = "Calibrate again (--self-calibrate)" if moved.is_of_poses else "Calibrate with a board"
    advice = f"{again}. Limit: {limit_px:.2f} px"
    return [Finding(level, "moved_px", moved.residual_px, f"{moved_text(moved)}. {advice}")]


def _sparse(phases: PhaseMap) -> PhaseMap:
    """Return the phases of about `SPARSE_POINTS` pixels on a grid."""
    step = max(1, round(np.sqrt(phases.rejection.size / SPARSE_POINTS)))
    left_out = np.full(phases.rejection.shape, np.uint16(Rejection.NO_MATCH))
    left_out[::step, ::step] = 0
    return phases.rejecting(left_out)


def _with_orders(
    recordings: Sequence[_Recording],
    rig: Rig,
    options: MeasureOptions,
    step: Callable[[str, int, int], object] | None = None,
) -> Rig:
    """Return a rig with a bias that fits the fringe orders; with a `step` C2 may be turned for it.

    Raises
    ------
    MethodError
        If none fits, or several do.
    """
    phases = [r.phases[:2] for r in recordings]
    volume = volume_of(rig, phases[0][0].device_name, options)
    assert volume is not None  # without one nothing is measured by M6
    if step is None:
        fit = fit_as_it_is(phases, rig, volume)
    else:
        fit = fit_turned(phases, rig, volume, step=partial(step, "trying turns"))
    if fit is None or fit.certainty < LEAST_CERTAINTY:
        several = "none" if fit is None else f"several (the best is {fit.certainty:.0%} likely)"
        raise MethodError(
            "self-calibration: expected fringe orders that go with one place of the devices, found "
            f"{several}. The images have no code: take scans with steps and slopes all over the "
            "image, or record a Gray code or a second direction"
        )
    return fit.rig


def _decoded(scan: Scan, rig: Rig, options: MeasureOptions) -> _Recording:
    """Decode a scan, and choose how to find its correspondences."""
    stacks = [keep_images(stack, options) for stack in scan.stacks]
    plan = stacks[0].plan
    if set(plan.angles) - {fringes.angle for fringes in plan.fringe_sets}:
        raise MethodError(
            "self-calibration: expected fringes in each direction, found Gray code alone: its "
            "cells are too coarse. Record fringes, too"
        )
    choice = choose_method(rig, stacks, options)
    volume = volume_of(rig, stacks[0].device_name, options)
    stacks = [images_of(choice, stack, rig, volume, options) for stack in stacks]
    shape = rig.projector.shape if rig.projector is not None else None
    apart = decode_apart if choice.method == "m6" else decode
    least = options.min_modulation_dn
    phases = tuple(apart(stack, shape, min_modulation_dn=least) for stack in stacks)
    if choice.method != "projector":
        cameras = {camera.name: camera for camera in rig.cameras}
        phases = best_direction_first(phases, *(cameras[s.device_name] for s in stacks[:2]))
        choice = settle(choice, phases[0].directions[0].main, rig, volume, options)
    recording = _Recording(scan, phases, choice.method)
    if (len(phases) == 1 or rig.projector is None) and len(recording.maps) < 2:
        with_what = "one camera" if len(phases) == 1 else "two cameras without a projector"
        raise MethodError(
            f"self-calibration: expected fringes of two directions with {with_what}, found one: "
            "nothing then contradicts a wrong pose. Record both (fringe3d patterns --direction xy)"
        )
    return recording


def _devices(rig: Rig, recordings: Sequence[_Recording]) -> tuple[Device, ...]:
    """Return C1, the further cameras of all scans and the projector."""
    cameras = {camera.name: camera for camera in rig.cameras}
    names = [[phases.device_name for phases in r.phases] for r in recordings]
    if any(own != names[0] for own in names):
        raise MethodError(
            f"self-calibration: expected the same cameras in all scans, found {names}"
        )
    own = tuple(cameras[name] for name in names[0])
    return (*own, rig.projector) if rig.projector is not None else own


def _with(rig: Rig, devices: Sequence[Device]) -> Rig:
    """Return the rig with devices in place of those of their names."""
    named = {device.name: device for device in devices}
    projector = rig.projector
    return Rig(
        cameras=tuple(named.get(camera.name, camera) for camera in rig.cameras),
        projector=named.get(projector.name, projector) if projector is not None else None,
        volume=rig.volume,
        provenance=rig.provenance,
    )


def _homologous(recording: _Recording, rig: Rig, options: MeasureOptions) -> Homologous:
    """Find homologous points with the poses of a rig."""
    devices = _devices(rig, [recording])
    n_cameras = len(recording.phases)
    name = recording.scan.title
    if n_cameras == 1:
        maps = recording.maps
        good = np.logical_and.reduce([m.rejection == 0 for m in maps])
        return homologous_points(maps, [m.position_px for m in maps], [], good, name=name)
    matches = _matches(recording, devices, rig, options)
    return homologous_of(recording.phases, matches, devices, name=name)


def homologous_of(
    phases: Sequence[CameraPhases],
    matches: Correspondences,
    devices: Sequence[Device],
    /,
    *,
    name: str = "",
) -> Homologous:
    """Return the homologous points of a measurement by two cameras or more.

    Parameters
    ----------
    phases : CameraPhases of each camera; the direction that was matched first
    matches : Correspondences of the second camera
    devices : the cameras of `phases`, then the projector if there is one
    name : str; of the scan
    """
    maps = [direction.main for direction in phases[0].directions]
    good = matches.rejection == 0
    origin, directions = rays(devices[0], pixel_grid(good.shape)[good])
    depths, _ = closest_depths(origin, directions, *rays(devices[1], matches.pixels[good]))
    points = np.full((*good.shape, 3), np.nan)
    points[good] = origin + depths[:, None] * directions
    projector = devices[-1] if devices[-1].role == "projector" else None
    seen = []
    for own, device in zip(phases[1:], devices[1:], strict=False):
        pixels = matches.pixels if device is devices[1] else project(device, points)
        pairs = zip(own.directions, maps, strict=True)
        seen.append((device.name, pixels, [direction.like(main) for direction, main in pairs]))
    orders: list[NDArray[np.int32] | None] = [matches.fringe_order, *[None] * (len(maps) - 1)]
    positions = [_position(m, o, points, projector) for m, o in zip(maps, orders, strict=True)]
    return homologous_points(maps, positions, seen, good, name=name)


def _position(
    phases: PhaseMap,
    orders: NDArray[np.int32] | None,
    points: Floats,
    projector: Device | None,
) -> Floats:
    """Return the coordinate w of the light in C1, (row, col); orders not known: the likeliest."""
    if phases.is_absolute:
        return phases.position_px
    turns = phases.phase.astype(np.float64) / (2 * np.pi)
    if projector is None:
        return np.asarray(turns * phases.period_px)  # only differences count
    if orders is not None:
        return np.asarray(np.where(orders == NO_ORDER, np.nan, turns + orders) * phases.period_px)
    x, y = np.moveaxis(project(projector, points), -1, 0)
    predicted = across(phases.angle, x, y) / phases.period_px
    return np.asarray((turns + np.rint(predicted - turns)) * phases.period_px)


def _matches(
    recording: _Recording, devices: Sequence[Device], rig: Rig, options: MeasureOptions
) -> Correspondences:
    """Find the points of the second camera; where orders are known, without the projector."""
    c1, c2 = devices[:2]
    found = _freely(recording.maps, recording.maps_of(1), devices)
    if found is not None:
        return found
    further = devices[2 : len(recording.phases)]
    volume = volume_of(rig, c1.name, options)
    return match(recording.phases, c1, c2, rig.projector, volume, method=recording.method,
                 options=options, bias=rig.bias, cameras=further).matches  # fmt: skip


def _freely(
    maps: Sequence[PhaseMap], maps2: Sequence[PhaseMap], devices: Sequence[Device]
) -> Correspondences | None:
    """Return the points of the second camera without projector and volume; None without a code."""
    c1, c2 = devices[:2]
    if len(maps) > 1 and all(m.is_absolute for m in (*maps[:2], *maps2[:2])):
        return match_both_directions((maps[0], maps[1]), (maps2[0], maps2[1]), c1, c2)
    return match_cameras(maps[0], maps2[0], c1, c2, None) if maps[0].is_absolute else None


def distance_of(length: KnownLength, points: Homologous, devices: Sequence[Device], /) -> float:
    """Return the distance of two points, or of two balls, with the poses found, mm.

    Raises
    ------
    EmptyResultError
        If there is no point near one of the ends, or no ball.
    """
    ends = []
    if length.of_balls:
        cloud = located(points, devices)
        for pixel in (length.first_px, length.second_px):
            ends.append(ball_center(cloud, points.pixels_c1, pixel))
        return float(np.linalg.norm(ends[1] - ends[0]))
    for pixel in (length.first_px, length.second_px):
        away = np.linalg.norm(points.pixels_c1 - np.asarray(pixel, np.float64), axis=1)
        nearest = int(np.argmin(away))
        if not away[nearest] <= NEAR_PX:
            raise EmptyResultError(
                f"known length: expected a point at pixel {pixel} (x, y) of C1, found none within "
                f"{NEAR_PX:g} px"
            )
        ends.append(located(points.subset(np.array([nearest])), devices)[0])
    return float(np.linalg.norm(ends[1] - ends[0]))
