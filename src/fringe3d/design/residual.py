"""What C2 shows of a wrong fringe order: the phase residual and its standard deviation.

Without a code every order k + j that lies in the measuring volume is a candidate. Taking it moves
the point along the viewing ray of C1, and C2, looking at that place, sees another part of the
surface and therefore another phase. The difference, to the nearest whole period, is all that tells
the two apart.

Derivation. Let X be the point, n its normal, Phi the phase of the projector in space (periods),
d1 and d2 the viewing directions of C1 and C2. The wrong point is X' = X + s d1, and to first order
j = s (grad Phi . d1). The viewing ray of C2 through X' meets the tangent plane in
Y = X' + t d2 with n . (s d1 + t d2) = 0. The phase there, less the phase of X, is

    grad Phi . (s d1 + t d2) = j (1 - rho),
    rho = [(grad Phi . d2) / (n . d2)] / [(grad Phi . d1) / (n . d1)]

of which only the part beyond whole periods shows: the residual is the distance of j rho to the
nearest integer. A projector in the middle between the cameras has rho = -1, and no residual.

Errors. With phi_1, phi_2 off by e_1, e_2, the projector's phase off by e_P at a point of space and
C2's image off by a displacement, the same steps give a residual of

    j (1 - rho) + e_2 - rho e_1 + (1 - rho) e_P + grad phi_2 . displacement

for e_1 moves the candidate and is taken off it again; e_P moves the candidate alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.design.counts import projector_of
from fringe3d.design.uncertainty import phase_noise
from fringe3d.errors import RigError
from fringe3d.geometry import project, rays, sheet_crossing
from fringe3d.model import Device, Rig
from fringe3d.patterns import across

Array = NDArray[np.float64]

FLOOR = 0.0015
"""Periods; what no model of noise and calibration covers: harmonics, interpolation, curvature."""

BLOCK = 8192
"""Points at a time: of more, matrix products wait for threads, for long on a busy machine."""

GRADIENT_STEP_MM = 0.05
"""Lenses are smooth over metres; rounding stays below 1e-9 px."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """How good images and calibration are.

    Parameters
    ----------
    noise : float; standard deviation of a grey value over the modulation, sigma_I / B
    n_shifts : int; number of phase-shifted images
    calibration_px : float, px; standard deviation, along any axis, of where a point that C1 places
        is seen by C2 and lit by the projector, against what the rig says
    """

    noise: float = 0.01
    n_shifts: int = 4
    calibration_px: float = 0.1

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.n_shifts >= 3 and self.calibration_px >= 0):
            raise ValueError(
                "quality: expected noise >= 0, n_shifts >= 3 and calibration_px >= 0, found "
                f"{self.noise}, {self.n_shifts} and {self.calibration_px}"
            )

    @property
    def phase_sigma(self) -> float:
        """Return the standard deviation of a phase, periods: ``sqrt(2 / N) noise / 2 pi``."""
        return phase_noise(self.n_shifts, self.noise) / (2 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """How the devices look at points: all that residuals need to know besides the normal.

    Parameters
    ----------
    gradient : (..., 3) float, periods / mm; of the projector's phase in space
    d1, d2 : (..., 3) float, mm; from C1 and C2 to the points
    beside : (..., 2, 3) float, mm; by how much C2 looks past the point one pixel on, in x and y
    """

    gradient: Array
    d1: Array
    d2: Array
    beside: Array


def sight_of(rig: Rig, points: ArrayLike, /, *, period_px: float, angle: ArrayLike = 0.0) -> Sight:
    """Return how the devices of a rig look at points.

    Parameters
    ----------
    rig : Rig of two cameras and a projector
    points : (..., 3) float, mm; world frame
    period_px : float, projector px
    angle : float, rad; of the fringes; for many angles at a time an array that broadcasts with
        (...)

    Notes
    -----
    The phase gradient is a central difference on the exact lens. Turning the fringes turns it
    linearly: ``grad w = cos(angle) grad u + sin(angle) grad v``.
    """
    points, angle = np.asarray(points, np.float64), np.asarray(angle, np.float64)
    camera1, camera2 = cameras_of(rig)
    steps = GRADIENT_STEP_MM * np.concatenate([np.eye(3), -np.eye(3)])
    seen = project(projector_of(rig), points[..., None, :] + steps)  # (..., 6, 2)
    across_u, across_v = np.moveaxis(
        (seen[..., :3, :] - seen[..., 3:, :]) / (2 * GRADIENT_STEP_MM), -1, 0
    )
    gradient = np.cos(angle)[..., None] * across_u + np.sin(angle)[..., None] * across_v
    d1, d2 = (points - camera.center_world for camera in (camera1, camera2))
    halves = np.array([[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5]])
    around = rays(camera2, project(camera2, points)[..., None, :] + halves)[1]
    distance = np.linalg.norm(d2, axis=-1)[..., None, None]
    return Sight(gradient / period_px, d1, d2, distance * (around[..., :2, :] - around[..., 2:, :]))


def phase_ratio(sight: Sight, normals: ArrayLike, /) -> Array:
    """Return rho: what a wrong order changes in C2 beyond whole periods, to first order.

    Parameters
    ----------
    sight : Sight
    normals : (..., 3) float; of any length

    Returns
    -------
    (...) float64; the order k + j leaves the distance of j rho to the nearest integer, periods
    """
    normals = np.asarray(normals, np.float64)
    across_c2 = _dot(sight.gradient, sight.d2) / _dot(normals, sight.d2)
    across_c1 = _dot(sight.gradient, sight.d1) / _dot(normals, sight.d1)
    return np.asarray(across_c2 / across_c1)


def image_gradient(sight: Sight, normals: ArrayLike, /) -> Array:
    """Return the gradient of the phase in the image of C2, (..., 2) float64, periods / px.

    As the pixel moves, the point moves on its tangent plane.

    Parameters
    ----------
    sight : Sight
    normals : (..., 3) float
    """
    normals = np.asarray(normals, np.float64)
    along = (
        np.einsum("...ai,...i->...a", sight.beside, normals) / _dot(normals, sight.d2)[..., None]
    )
    across_fringes = np.einsum("...ai,...i->...a", sight.beside, sight.gradient)
    return np.asarray(across_fringes - along * _dot(sight.gradient, sight.d2)[..., None])


def residual_sigma(
    sight: Sight, normals: ArrayLike, quality: Quality, /, *, period_px: float
) -> Array:
    """Return the standard deviation of the residual in C2, (...) float64, periods.

    Parameters
    ----------
    sight : Sight
    normals : (..., 3) float
    quality : Quality
    period_px : float, projector px

    Notes
    -----
    The errors of the module's derivation, taken for independent:
    ``sqrt(s2**2 + (rho s1)**2 + (c |grad phi_2|)**2 + ((1 - rho) c / period)**2 + floor**2)``
    with s1 = s2 the noise of a phase, c the calibration error (px) and grad phi_2 the gradient of
    the phase in C2's image, periods / px.
    """
    rho = phase_ratio(sight, normals)
    slope = np.linalg.norm(image_gradient(sight, normals), axis=-1)
    noise = quality.phase_sigma * np.hypot(1.0, rho)
    calibration = quality.calibration_px * np.hypot(slope, (1 - rho) / period_px)
    return np.asarray(np.sqrt(noise**2 + calibration**2 + FLOOR**2))


def wrong_points(
    rig: Rig, points: ArrayLike, orders: ArrayLike, /, *, period_px: float, angle: float = 0.0
) -> Array:
    """Return where C1 and projector put points whose fringe order is wrong.

    Parameters
    ----------
    rig : Rig
    points : (n, 3) float, mm; the right points
    orders : (m,) int; wrong order less right order
    period_px : float, projector px
    angle : float, rad

    Returns
    -------
    (n, m, 3) float64, mm; on the viewing ray of C1; NaN where ray and fringe do not meet
    """
    points, orders = np.asarray(points, np.float64), np.asarray(orders)
    camera, projector = cameras_of(rig)[0], projector_of(rig)
    directions = unit(points - camera.center_world)
    phase = phase_at(projector, points, period_px, angle)
    target = (phase[:, None] + orders) * period_px
    along = np.repeat(directions[:, None], len(orders), axis=1)
    depth = sheet_crossing(
        projector, camera.center_world, along.reshape(-1, 3), target.ravel(), angle
    )
    return np.asarray(camera.center_world + depth.reshape(target.shape)[..., None] * along)


def wrong_order_residuals(
    rig: Rig,
    points: ArrayLike,
    normals: ArrayLike,
    orders: ArrayLike,
    /,
    *,
    period_px: float,
    angle: float = 0.0,
) -> Array:
    """Return by how much the phase in C2 misses that of C1 if the order is wrong; exact.

    The surface is taken for its tangent plane, the lenses and rays are exact.

    Parameters
    ----------
    rig : Rig of two cameras and a projector
    points, normals : (n, 3) float; mm, world frame
    orders : (m,) int; wrong order less right order
    period_px : float, projector px
    angle : float, rad

    Returns
    -------
    (n, m) float64, periods
        Phase that C2 sees at the wrong point less the phase of C1, whole periods included: what
        images show is the distance to the nearest integer. Nearly ``j (1 - rho)``.
    """
    points, normals = np.asarray(points, np.float64), np.asarray(normals, np.float64)
    wrong = wrong_points(rig, points, orders, period_px=period_px, angle=angle)
    own = phase_at(projector_of(rig), points, period_px, angle)
    return seen_phase(rig, points, normals, wrong, period_px, angle) - own[:, None]


def seen_phase(
    rig: Rig, points: Array, normals: Array, wrong: Array, period_px: float, angle: float, /
) -> Array:
    """Return the phase, (n, m) periods, where C2 looking at wrong points meets the tangent plane.

    As in `wrong_order_residuals`, with the `wrong_points` (n, m, 3), mm, already known.
    """
    eye = cameras_of(rig)[1].center_world
    looks = wrong - eye
    reach = _dot(points - eye, normals)[:, None] / np.einsum("nmi,ni->nm", looks, normals)
    return phase_at(projector_of(rig), eye + reach[..., None] * looks, period_px, angle)


def phase_at(projector: Device, points: Array, period_px: float, angle: float, /) -> Array:
    """Return the phase of the projector at points (..., 3), periods from w = 0."""
    flat = points.reshape(-1, 3)
    blocks = [project(projector, flat[i : i + BLOCK]) for i in range(0, len(flat), BLOCK)]
    x, y = np.concatenate([np.empty((0, 2)), *blocks]).T
    return (across(angle, x, y) / period_px).reshape(points.shape[:-1])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def unit(vectors: Array, /) -> Array:
    """Return vectors (..., 3) at unit length."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def cameras_of(rig: Rig, /) -> tuple[Device, Device]:
    """Return C1 and C2; raise RigError if there is only one camera."""
    if len(rig.cameras) < 2:
        raise RigError(
            "rig: expected two cameras, for the second one tells orders apart; found one. "
            "A single camera needs a code or segments below one period"
        )
    return rig.cameras[0], rig.cameras[1]
