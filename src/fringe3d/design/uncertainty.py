"""The standard deviation of the points that a rig is going to measure, before it does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.reference import facing_direction, partner_of, require_volume
from fringe3d.errors import RigError
from fringe3d.geometry import depth_interval, frustum, pixel_grid, project, rays
from fringe3d.model import Device, Rig
from fringe3d.patterns import across

INTERPOLATION_WEIGHT = 4.0 / 9.0
"""Part of C2's phase variance that is left after interpolation between its pixels: the mean sum
of squared weights at a random place, (2/3)**2."""

STEP_MM = 0.05
"""Half of a central difference: lenses are smooth over metres."""

DEPTH_PARTS = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Places on each segment at which the uncertainty is taken; the map shows the middle one."""

STEEPEST_COSINE = 0.05
"""Surfaces seen flatter than that (87 deg) are not measured."""

Map = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UncertaintyMap:
    """Predicted standard deviation of the points, along the viewing rays of C1.

    Parameters
    ----------
    sigma_mm : (row, col) float, mm; in the middle of each pixel's segment; NaN where nothing is
        measured
    median_mm, low_mm, high_mm : float, mm; median, 5 and 95 % over the whole volume
    """

    sigma_mm: Map
    median_mm: float
    low_mm: float
    high_mm: float


def phase_noise(n_shifts: int, noise: float, /) -> float:
    """Return sigma_phi = sqrt(2/N) sigma_I / B, rad.

    Parameters
    ----------
    n_shifts : int, >= 3; N, of the phase steps
    noise : float, >= 0; sigma_I / B, noise of a grey value by the modulation of the fringes

    Raises
    ------
    ValueError
        If a number is outside its domain.

    Examples
    --------
    >>> round(phase_noise(8, 0.01), 4)
    0.005
    """
    if n_shifts < 3 or not 0 <= noise < math.inf:
        raise ValueError(
            "phase noise: expected at least 3 phase steps and a noise of 0 or more, found "
            f"{n_shifts} and {noise}"
        )
    return math.sqrt(2 / n_shifts) * noise


def phase_gradient(
    projector: Device, points_mm: ArrayLike, /, *, period_px: float, angle: float = 0.0
) -> Map:
    """Return the gradient of the projector's phase in space.

    Parameters
    ----------
    projector : Device
    points_mm : (..., 3) float, mm; world frame
    period_px : float, projector px
    angle : float, rad; of the fringes

    Returns
    -------
    (..., 3) float64, rad / mm; central differences of the exact lens
    """
    points = np.asarray(points_mm, np.float64)
    parts = []
    for step in STEP_MM * np.eye(3):
        ends = [project(projector, points + sign * step) for sign in (1, -1)]
        w = [across(angle, end[..., 0], end[..., 1]) for end in ends]
        parts.append((w[0] - w[1]) / (2 * STEP_MM))
    return 2 * np.pi / period_px * np.stack(parts, axis=-1)


def point_sigma(
    rig: Rig,
    points_mm: ArrayLike,
    /,
    *,
    period_px: float,
    sigma_phase: float,
    angle: float = 0.0,
    normals: ArrayLike | None = None,
) -> Map:
    """Predict the standard deviation of points along the viewing rays of C1.

    With two cameras the point is where C2 sees, on the ray of C1, the phase that C1 sees:
    ``f(t) = phi_2(pi_2(X(t))) - phi_1 = 0``. On a surface with normal n, C2 looks past X at the
    point ``X + dt (d_1 - d_2 (n.d_1)/(n.d_2))`` of the surface when X moves by dt, so that
    ``f' = grad Phi . (d_1 - d_2 (n.d_1)/(n.d_2))`` and
    ``sigma_t**2 = (sigma_1**2 + 4/9 sigma_2**2) / f'**2``.
    With one camera the phase of C1 alone places it: ``sigma_t = sigma_1 / |grad Phi . d_1|``.
    Without a calibrated projector ``f' = 2 pi / period |d pi_2 / dt|``, by the period in C2.

    Parameters
    ----------
    rig : Rig
    points_mm : (..., 3) float, mm; world frame
    period_px : float, projector px; px of C2 where the rig has no projector
    sigma_phase : float, rad; of both cameras: ``sqrt(2/N) sigma_I / B``
    angle : float, rad; of the fringes
    normals : (..., 3) float or None; of the surface; by default it faces the rig

    Returns
    -------
    (...) float64, mm
        NaN where a device would see the surface from behind, or flatter than 3 degrees.
    """
    points = np.asarray(points_mm, np.float64)
    facing = facing_direction(rig, points) if normals is None else np.asarray(normals, np.float64)
    along, seen = view(rig.cameras[0], points, facing)
    if rig.projector is None:
        slope = 2 * np.pi / period_px * image_speed(partner_of(rig), points, along)
        lit = view(partner_of(rig), points, facing)[1]
    else:
        gradient = phase_gradient(rig.projector, points, period_px=period_px, angle=angle)
        slope = np.abs((gradient * _travel(rig, points, facing)).sum(-1))
        lit = view(rig.projector, points, facing)[1]
    weight = 1 + INTERPOLATION_WEIGHT * (len(rig.cameras) > 1)
    with np.errstate(divide="ignore"):
        sigma = math.sqrt(weight) * sigma_phase / slope
    return np.asarray(np.where(np.isfinite(seen) & np.isfinite(lit), sigma, np.nan))


def _travel(rig: Rig, points: Map, normals: Map) -> Map:
    """Return how the phase that counts moves through space as a point moves along C1's ray.

    With one camera it is that of the point; with two that of the place of the surface on which
    C2 looks then. (..., 3), mm / mm.
    """
    along, cosine1 = view(rig.cameras[0], points, normals)
    if len(rig.cameras) == 1:
        return along
    second, cosine2 = view(rig.cameras[1], points, normals)
    return np.asarray(along - second * (cosine1 / cosine2)[..., None])


def fringe_crossing(
    rig: Rig, point_mm: ArrayLike, /, *, period_px: float, angle: float = 0.0
) -> tuple[float, float]:
    """Return how the fringes lie to the epipolar lines at a point, and how they would lie best.

    The slope f' of `point_sigma` is ``f'(0) cos(angle) + f'(pi/2) sin(angle)``: largest at
    ``atan2(f'(pi/2), f'(0))``, and nothing a quarter turn from there.

    Parameters
    ----------
    rig : Rig with a projector
    point_mm : (3,) float, mm; of a surface that faces the rig
    period_px : float, projector px
    angle : float, rad; of the fringes

    Returns
    -------
    crossing : float, rad, 0 to pi/2
        Angle between fringes and epipolar lines; pi/2 where they cross squarely and points are
        most certain, 0 where no point can be found.
    square_angle : float, rad, -pi/2 to pi/2; the fringe angle at which they do
    """
    assert rig.projector is not None
    point = np.asarray(point_mm, np.float64)
    travel = _travel(rig, point, facing_direction(rig, point))
    slopes = [
        float(phase_gradient(rig.projector, point, period_px=period_px, angle=turn) @ travel)
        for turn in (0.0, np.pi / 2)
    ]
    square = math.atan2(slopes[1], slopes[0])
    square -= math.pi * round(square / math.pi)  # fringes have no arrow
    return math.asin(min(1.0, abs(math.cos(angle - square)))), square


def image_speed(camera: Device, points: Map, directions: Map, /) -> Map:
    """Return how fast the images of points (..., 3), mm, move as these move, (...), px / mm."""
    ahead, back = (project(camera, points + step * directions) for step in (STEP_MM, -STEP_MM))
    return np.asarray(np.linalg.norm(ahead - back, axis=-1) / (2 * STEP_MM))


def view(device: Device, points: Map, normals: Map, /) -> tuple[Map, Map]:
    """Return how a device sees points (..., 3), mm, of surfaces with unit normals (..., 3).

    Returns
    -------
    directions : (..., 3) float64; unit, from the device to the points
    cosines : (...) float64
        Of the angle of incidence; NaN where the surface is seen from behind, or flatter than 3
        degrees.
    """
    away = points - device.center_world
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    cosine = -(away * normals).sum(-1)
    return away, np.where(cosine > STEEPEST_COSINE, cosine, np.nan)


def predict_uncertainty(
    rig: Rig,
    /,
    *,
    period_px: float,
    sigma_phase: float,
    angle: float = 0.0,
    step: int = 1,
) -> UncertaintyMap:
    """Predict the uncertainty over the measuring volume, for surfaces that face the rig.

    Parameters
    ----------
    rig : Rig with a volume
    period_px, sigma_phase, angle : see `point_sigma`
    step : int; only every step-th row and column of C1

    Returns
    -------
    UncertaintyMap
        Where all devices see the points.

    Raises
    ------
    RigError
        If there is no volume, no second device, or no point that all devices see.
    """
    volume = require_volume(rig)
    for other in (partner_of(rig), *((rig.projector,) if rig.projector else ())):
        volume = volume.intersection(frustum(other))
    origin, directions = rays(rig.cameras[0], pixel_grid(rig.cameras[0].shape)[::step, ::step])
    near, far = depth_interval(origin, directions, volume)
    seen = (near < far) & np.isfinite(far)
    if not seen.any():
        raise RigError(
            "rig: expected a part of the measuring volume that all devices see, found none. "
            "Correct the poses, the volume or the depth range"
        )
    near, span, along = near[seen], (far - near)[seen], directions[seen]
    samples = [
        point_sigma(
            rig,
            origin + (near + part * span)[:, None] * along,
            period_px=period_px,
            sigma_phase=sigma_phase,
            angle=angle,
        )
        for part in DEPTH_PARTS
    ]
    sigma = np.full(seen.shape, np.nan)
    sigma[seen] = samples[len(samples) // 2]
    everywhere = np.concatenate(samples)
    if not np.isfinite(everywhere).any():
        raise RigError(
            "rig: expected devices that look at the same side of a surface which faces the rig, "
            "found none. Correct the poses"
        )
    low, median, high = (float(v) for v in np.nanpercentile(everywhere, [5, 50, 95]))
    return UncertaintyMap(sigma_mm=sigma, median_mm=median, low_mm=low, high_mm=high)
