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
    depth_part,
    fit_poses,
    homologous_points,
    located,
)
from fringe3d.decode import CameraPhases, decode, decode_apart
from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.matching import best_direction_first, match
from fringe3d.methods import choose_method, images_of, settle
from fringe3d.model import (
    Correspondences,
    Device,
    PhaseMap,
    Rig,
    Scan,
)
from fringe3d.options import MeasureOptions, keep_images, volume_of
from fringe3d.pose_search import LEAST_CERTAINTY, fit_as_it_is, fit_turned
from fringe3d.recorded_points import freely_matched, homologous_of

Floats = NDArray[np.float64]

ROUNDS = 3
"""Points on epipolar curves are searched again with the poses found."""

LEAST_DEPTH_PART = 0.03
"""By how much points must leave their common plane, over their distance, where nothing numbers the
fringes. A plane of which a part took another order is two planes, 0.012 apart on `kolibri`; its
objects fill 0.07."""

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
        of one direction. If nothing says which fringe is which, and other poses go with other
        fringe orders: several fit, or the points lie in a plane.
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
    n_rounds = 1 if all(r.is_free for r in recordings) else ROUNDS
    for number in range(n_rounds):
        step(work, len(scans) + number, n_steps)
        points = [_homologous(r, found, options) for r in recordings]
        near = fitted.devices if fitted is not None else _devices(found, recordings)
        is_last = number == n_rounds - 1
        fitted = fit_poses(points, before, near=near, known=rig.covariance if is_last else None)
        found = rig.with_devices(fitted.devices)
        if not is_numbered and not is_last:
            found = _with_orders(recordings, found, options)
    step(work, n_steps, n_steps)
    assert fitted is not None
    if not is_numbered:
        _require_depth(points, fitted.devices)
    factor = 1.0
    if length is None:
        found = replace(found, covariance=fitted.joint)
    else:
        factor = length.length_mm / distance_of(length, points[0], fitted.devices)
        found = rig.with_devices(fitted.scaled(factor))
    return SelfCalibrated(
        rig=found,
        fitted=fitted,
        n_directions=max(len(p.angles) for p in points),
        length_factor=factor,
    )


def recorded_homologous(
    scan: Scan, rig: Rig, options: MeasureOptions | None = None, /
) -> Homologous:
    """Return the homologous points of a scan with the poses of a rig.

    Parameters
    ----------
    scan : Scan
    rig : Rig; as the devices stood, nearly
    options : MeasureOptions or None; which of the images to use, and the depth range

    Raises
    ------
    MethodError
        If no device could contradict another, or there is Gray code alone.
    """
    options = options or MeasureOptions()
    return _homologous(_decoded(scan, rig, options), rig, options)


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


def _require_depth(points: Sequence[Homologous], devices: Sequence[Device]) -> None:
    """Raise MethodError if all points lie in a plane.

    Of a plane every order fits as well: a plane a period further on is what turned cameras see.
    """
    cloud = np.concatenate([located(p, devices) for p in points])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    distance = float(np.median(np.linalg.norm(cloud - devices[0].center_world, axis=1)))
    part = depth_part(cloud, distance)
    if part < LEAST_DEPTH_PART:
        raise MethodError(
            f"self-calibration: expected an object with depth, found points that leave their "
            f"common plane by {part:.1%} of their distance. The images have no code, and a plane "
            "fits at other fringe orders as well, with other poses. Take an object that fills the "
            "measuring volume, or record a Gray code or a second direction"
        )


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


def _matches(
    recording: _Recording, devices: Sequence[Device], rig: Rig, options: MeasureOptions
) -> Correspondences:
    """Find the points of the second camera; where orders are known, without the projector."""
    c1, c2 = devices[:2]
    found = freely_matched(recording.maps, recording.maps_of(1), devices)
    if found is not None:
        return found
    further = devices[2 : len(recording.phases)]
    volume = volume_of(rig, c1.name, options)
    return match(recording.phases, c1, c2, rig.projector, volume, method=recording.method,
                 options=options, bias=rig.bias, cameras=further).matches  # fmt: skip


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
