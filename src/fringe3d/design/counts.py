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
from fringe3d.geometry import (
    depth_interval,
    epipolar_segment,
    frustum,
    project,
    rays,
    triangulation_angle,
)
from fringe3d.model import Device, Rig, RigidTransform
from fringe3d.patterns import across

SEGMENT_SAMPLES = 5
"""Points along a segment, ends included: enough for its bend, a few px at most."""

ANGLE_TOLERANCE = 1e-6
"""Rad; how far below the limit an angle without code may be: a ten-thousandth of a degree."""

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


def spread_pixels(shape: tuple[int, int], step: int, /, *, edges: bool = True) -> Map:
    """Return every step-th row and column of an image, and with `edges` the last ones, too.

    Parameters
    ----------
    shape : (n_rows, n_cols)
    step : int
    edges : bool; segments are often longest in a corner of the image

    Returns
    -------
    (row, col, 2) float64, px; (x, y)

    Examples
    --------
    >>> spread_pixels((3, 6), 4)[..., 0].tolist()
    [[0.0, 4.0, 5.0], [0.0, 4.0, 5.0]]
    """
    last = [[n - 1] if edges else [] for n in shape]
    rows, cols = (
        np.union1d(np.arange(0, n, step), end) for n, end in zip(shape, last, strict=True)
    )
    return np.asarray(np.stack(np.meshgrid(cols, rows), axis=-1), np.float64)


def periods_on_projector(
    rig: Rig, /, *, period_px: float, angle: float = 0.0, step: int = 1, edges: bool = False
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
    edges : bool; and the last ones, whatever the step

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
    pixels = spread_pixels(rig.cameras[0].shape, step, edges=edges)
    periods = _periods_of_pixels(rig, pixels, period_px, angle)
    if not np.isfinite(periods).any():
        raise _not_seen(rig, projector)
    return periods


def _periods_of_pixels(rig: Rig, pixels: Map, period_px: float, angle: float) -> Map:
    projector = projector_of(rig)
    origin, directions, near, far = _segments(rig, projector, pixels)
    low, high = _ends_of_w(projector, origin, directions, near, far, np.array([angle]))
    return np.asarray((high - low)[0] / period_px)


def _ends_of_w(
    projector: Device, origin: Map, directions: Map, near: Map, far: Map, angles: Map
) -> tuple[Map, Map]:
    """Return the least and the largest w between two depths of rays (...), (n_angles, ...)."""
    turn = angles.reshape(-1, *[1] * near.ndim)
    low = np.full((len(angles), *near.shape), np.inf)
    high = -low
    for part in np.linspace(0, 1, SEGMENT_SAMPLES):
        depth = near + part * (far - near)
        seen = project(projector, origin + depth[..., None] * directions)
        u, v = (across(angle, seen[..., 0], seen[..., 1]) for angle in (0.0, np.pi / 2))
        w = np.cos(turn) * u + np.sin(turn) * v
        low, high = np.minimum(low, w), np.maximum(high, w)
    return low, high


def longest_reach(
    rig: Rig, pixels: Map, angles: Map, /, *, period_px: float, beyond: float = 0.0
) -> Map:
    """Return the most periods between a point of the volume and another on its ray that is lit.

    Parameters
    ----------
    rig : Rig with a projector and a volume
    pixels : (..., 2) float, px; of C1
    angles : (n_angles,) float, rad; of the fringes
    period_px : float, projector px
    beyond : float; the other point may lie up to this part of the ray's depth beyond the volume;
        with 0 it is the length of the longest segment

    Returns
    -------
    (n_angles,) float64

    Raises
    ------
    RigError
        If there is no projector, no volume, or if no pixel sees a lit part of it.
    """
    projector = projector_of(rig)
    origin, directions, near, far = _segments(rig, projector, pixels)
    if not np.isfinite(near).any():
        raise _not_seen(rig, projector)
    low, high = _ends_of_w(projector, origin, directions, near, far, angles)
    lowest, highest = low, high
    if beyond > 0:
        top, bottom = depth_interval(origin, directions, require_volume(rig))
        enter, leave = depth_interval(origin, directions, frustum(projector))
        room = beyond * (bottom - top)
        ends = np.fmax(top - room, enter), np.fmin(bottom + room, leave)
        lowest, highest = _ends_of_w(projector, origin, directions, *ends, angles)
    reach = np.maximum(high - lowest, highest - low).reshape(len(angles), -1)
    return np.asarray(np.nanmax(reach, axis=1) / period_px)


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
    edges: bool = False,
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
    edges : bool; and the last ones, whatever the step

    Returns
    -------
    SegmentMap

    Raises
    ------
    RigError
        If there is no second camera, no volume, neither a projector nor `camera_period_px`, or
        if no pixel sees a part of the volume that C2 sees.
    """
    second = _second_camera(rig, camera_period_px)
    pixels = spread_pixels(rig.cameras[0].shape, step, edges=edges)
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


def _second_camera(rig: Rig, camera_period_px: float | None) -> Device:
    """Return C2; raise RigError where there is none, or no period for it."""
    if len(rig.cameras) < 2:
        raise RigError("rig: expected a second camera, found one. Add it to the rig")
    if rig.projector is None and camera_period_px is None:
        raise RigError(
            "rig: expected a projector or the period that the second camera sees, found neither. "
            "Give the period (--camera-period PX), or add a projector to the rig"
        )
    return rig.cameras[1]


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
    return replace(rig, projector=moved, covariance=None)


def angle_without_code(
    rig: Rig,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
    guard: float = 0.0,
    principal_ray: bool = False,
    step: int = 1,
    beyond: float = 0.0,
) -> float:
    """Return the largest angle between C1 and P with less than a period on every segment.

    The projector is moved as in `with_projector_at`; ``max m + 2 guard`` is just below 1 there.

    Parameters
    ----------
    rig : Rig with a projector and a volume
    period_px : float, projector px
    angle : float, rad; of the fringes
    guard : float, periods
    principal_ray : bool
        Count the ray through the reference point alone, as equation (5) does.
    step : int; count every step-th row and column, and the last ones
    beyond : float; see `longest_reach`

    Returns
    -------
    float, rad; infinite where even 60 degrees give less than a period; NaN where the guard alone
        takes the whole period
    """
    camera = rig.cameras[0]
    pixels = spread_pixels(camera.shape, step)
    if principal_ray:
        pixels = project(camera, reference_of(rig).point_mm)[None]

    def excess(tau: float) -> float:
        moved = with_projector_at(rig, tau)
        reach = longest_reach(moved, pixels, np.array([angle]), period_px=period_px, beyond=beyond)
        return float(reach[0]) + 2 * guard - 1

    if 2 * guard >= 1:
        return math.nan
    narrow = 0.0
    for wide in np.radians([2.0, 5.0, 10.0, 20.0, 40.0, 60.0]):
        if excess(float(wide)) >= 0:
            found = float(brentq(excess, narrow, float(wide), xtol=ANGLE_TOLERANCE))
            # A root lies within the tolerance of the true one: this is below it.
            return max(0.0, found - 2 * ANGLE_TOLERANCE)
        narrow = float(wide)
    return math.inf
