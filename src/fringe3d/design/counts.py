"""How many fringe periods lie on the segments of a calibrated rig.

Every pixel of C1 is counted, with the distortion of all lenses and the shape of the volume.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fringe3d.design.reference import Reference, reference_of, require_volume
from fringe3d.errors import RigError
from fringe3d.geometry import epipolar_segment, pixel_grid, project, rays, triangulation_angle
from fringe3d.model import Device, Rig, RigidTransform
from fringe3d.patterns import across

SEGMENT_SAMPLES = 5
"""Points along a segment, ends included: enough for its bend, a few px at most."""

ANGLE_TOLERANCE = 1e-5

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SegmentMap:
    """The epipolar segments of C1's pixels in C2.

    Parameters
    ----------
    length_px : (row, col) float, px of C2; NaN where there is no segment
    period_px : (row, col) float, px of C2; mean period along the segment, see
        `periods_in_camera`
    periods : (row, col) float; length / period
    """

    length_px: Map
    period_px: Map
    periods: Map


def periods_on_projector(
    rig: Rig, /, *, period_px: float, angle: float = 0.0, step: int = 1
) -> Map:
    """Count the fringe periods on the projector segment of every pixel of C1.

    The segment is the image, in the projector, of the part of the viewing ray inside the volume
    that the projector lights.

    Parameters
    ----------
    rig : Rig with a projector and a volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    step : int; only every step-th row and column

    Returns
    -------
    (row, col) float64
        NaN where the ray misses the volume or the projector does not light it.

    Raises
    ------
    RigError
        If there is no projector, no volume, or if no pixel sees a lit part of it.

    Notes
    -----
    The largest less the smallest w at `SEGMENT_SAMPLES` points: w is monotone along a ray, but
    for fringes that nearly follow the epipolar lines through a distorting lens.
    """
    projector = projector_of(rig)
    pixels = pixel_grid(rig.cameras[0].shape)[::step, ::step]
    periods = _periods_of_pixels(rig, pixels, period_px, angle)
    if not np.isfinite(periods).any():
        raise _not_seen(rig, projector)
    return periods


def _periods_of_pixels(rig: Rig, pixels: Map, period_px: float, angle: float) -> Map:
    projector = projector_of(rig)
    origin, directions, near, far = _segments(rig, projector, pixels)
    low, high = np.full(near.shape, np.inf), np.full(near.shape, -np.inf)
    for part in np.linspace(0, 1, SEGMENT_SAMPLES):
        depth = near + part * (far - near)
        seen = project(projector, origin + depth[..., None] * directions)
        w = across(angle, seen[..., 0], seen[..., 1])
        low, high = np.minimum(low, w), np.maximum(high, w)
    return np.asarray((high - low) / period_px)


def projector_of(rig: Rig, /) -> Device:
    """Return the projector; raise RigError where the rig has none."""
    if rig.projector is None:
        raise RigError(
            "rig: expected a projector, found cameras alone. Add one to the rig (a sketch of its "
            "place is enough)"
        )
    return rig.projector


def _not_seen(rig: Rig, other: Device) -> RigError:
    does = "lights" if other.role == "projector" else "sees"
    return RigError(
        f"rig: expected pixels of '{rig.cameras[0].name}' that see a part of the measuring volume "
        f"which '{other.name}' {does}, too; found none. Correct the poses, the volume or the depth "
        "range"
    )


def _segments(rig: Rig, other: Device, pixels: Map) -> tuple[Map, Map, Map, Map]:
    """Return origin and rays of C1, and the ends of the segments; NaN where there is none."""
    camera = rig.cameras[0]
    origin, directions = rays(camera, pixels)
    near, far = epipolar_segment(camera, other, pixels, require_volume(rig))
    there = (near < far) & np.isfinite(far)
    return origin, directions, np.where(there, near, np.nan), np.where(there, far, np.nan)


def periods_in_camera(
    rig: Rig,
    /,
    *,
    period_px: float = math.nan,
    angle: float = 0.0,
    camera_period_px: float | None = None,
    step: int = 1,
) -> SegmentMap:
    """Count the fringe periods on the segment in C2 of every pixel of C1.

    How many periods C2 sees along a segment depends on the surface there. They are counted on
    a plane through the reference point that faces the rig (the middle between the directions to
    both cameras): C2's rays through the ends of the segment meet the plane in two points, and
    the fringes between these are the periods. So many orders come into question where C2 is
    searched without the projector's geometry.

    Parameters
    ----------
    rig : Rig with two cameras and a volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    camera_period_px : float or None, px of C2
        The period that C2 sees: needed where the projector is not calibrated, taken instead of
        the plane where given.
    step : int; only every step-th row and column

    Returns
    -------
    SegmentMap

    Raises
    ------
    RigError
        If there is no second camera, no volume, neither a projector nor `camera_period_px`, or
        if no pixel sees a part of the volume that C2 sees.
    """
    if len(rig.cameras) < 2:
        raise RigError("rig: expected a second camera, found one. Add it to the rig")
    if rig.projector is None and camera_period_px is None:
        raise RigError(
            "rig: expected a projector or the period that the second camera sees, found neither. "
            "Give the period (--camera-period PX), or add a projector to the rig"
        )
    second = rig.cameras[1]
    pixels = pixel_grid(rig.cameras[0].shape)[::step, ::step]
    origin, directions, near, far = _segments(rig, second, pixels)
    if not np.isfinite(near).any():
        raise _not_seen(rig, second)
    points = [
        origin + (near + part * (far - near))[..., None] * directions
        for part in np.linspace(0, 1, SEGMENT_SAMPLES)
    ]
    curve = np.stack([project(second, point) for point in points])
    length = np.linalg.norm(np.diff(curve, axis=0), axis=-1).sum(axis=0)
    if camera_period_px is not None:
        period = np.where(np.isfinite(length), camera_period_px, np.nan)
        return SegmentMap(length_px=length, period_px=period, periods=length / period)
    reference = reference_of(rig)
    first, last = (_w_on_plane(rig, reference, points[end], angle) for end in (0, -1))
    periods = np.abs(last - first) / period_px
    with np.errstate(divide="ignore", invalid="ignore"):
        period = length / periods
    return SegmentMap(length_px=length, period_px=period, periods=periods)


def _w_on_plane(rig: Rig, reference: Reference, points: Map, angle: float) -> Map:
    """Return w where C2's rays through points meet the plane at the reference point."""
    eye = rig.cameras[1].center_world
    toward = points - eye
    with np.errstate(divide="ignore", invalid="ignore"):
        part = ((reference.point_mm - eye) @ reference.facing) / (toward @ reference.facing)
    met = eye + np.where(part > 0, part, np.nan)[..., None] * toward
    seen = project(projector_of(rig), met)
    return across(angle, seen[..., 0], seen[..., 1])


def with_projector_at(rig: Rig, angle: float, /) -> Rig:
    """Return the rig with its projector turned about the reference point to an angle from C1.

    It moves on the circle through its place and the ray of C1, keeps its distance from the
    reference point and its aim, and turns with the circle, so that the fringes stay as they are
    to the epipolar plane.

    Parameters
    ----------
    rig : Rig with a projector and a volume
    angle : float, rad; new triangulation angle between C1 and P at the reference point
    """
    projector, camera, pivot = projector_of(rig), rig.cameras[0], reference_of(rig).point_mm
    to_camera, to_projector = (d.center_world - pivot for d in (camera, projector))
    axis = np.cross(to_camera, to_projector)
    if np.linalg.norm(axis) < 1e-9 * np.linalg.norm(to_camera) * np.linalg.norm(to_projector):
        # In one line with C1 there is no circle yet: take the one through the second camera, or
        # along C1's rows.
        aside = camera.device_from_world.rotation[0]
        if len(rig.cameras) > 1:
            aside = rig.cameras[1].center_world - pivot
        axis = np.cross(to_camera, aside)
    turn = angle - triangulation_angle(camera, projector, pivot)
    rotation = Rotation.from_rotvec(turn * axis / np.linalg.norm(axis)).as_matrix()
    back = RigidTransform(rotation=rotation.T, translation=pivot - rotation.T @ pivot)
    moved = replace(projector, device_from_world=projector.device_from_world @ back)
    return replace(rig, projector=moved)


def angle_without_code(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
    guard: float = 0.0,
    principal_ray: bool = False,
    step: int = 1,
) -> float:
    """Return the largest angle between C1 and P with less than a period on every segment.

    The projector is moved as in `with_projector_at`; ``max m + 2 guard = 1`` there.

    Parameters
    ----------
    rig : Rig with a projector and a volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    guard : float, periods
    principal_ray : bool
        Count the ray through the reference point alone, as equation (5) does.
    step : int; count every step-th row and column

    Returns
    -------
    float, rad; infinite where even 60 degrees give less than a period; NaN where the guard alone
        takes the whole period
    """
    camera = rig.cameras[0]
    pixels = pixel_grid(camera.shape)[::step, ::step]
    if principal_ray:
        pixels = project(camera, reference_of(rig).point_mm)[None]

    def excess(tau: float) -> float:
        moved = with_projector_at(rig, tau)
        periods = _periods_of_pixels(moved, pixels, period_px, angle)
        if not np.isfinite(periods).any():
            raise _not_seen(moved, projector_of(moved))
        return float(np.nanmax(periods)) + 2 * guard - 1

    if 2 * guard >= 1:
        return math.nan
    narrow = 0.0
    for wide in np.radians([2.0, 5.0, 10.0, 20.0, 40.0, 60.0]):
        if excess(float(wide)) >= 0:
            return float(brentq(excess, narrow, float(wide), xtol=ANGLE_TOLERANCE))
        narrow = float(wide)
    return math.inf
