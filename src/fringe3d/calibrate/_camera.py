"""The projector as a function of 15 numbers, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import Device, RigidTransform

Floats = NDArray[np.float64]

NAMES = (
    "rotation_x", "rotation_y", "rotation_z", "middle_x", "middle_y", "middle_z",
    "log_focal", "log_aspect", "center_x", "center_y", "k1", "k2", "p1", "p2", "k3",
)  # fmt: skip
"""Rotation: a vector, rad, in the device frame, on top of the pose at which the fit began. Middle:
the middle of the points in the device frame, mm; unlike the translation it hardly depends on the
rotation. Aspect: principal distance along y over that along x."""

INDEX = {name: number for number, name in enumerate(NAMES)}
N_NUMBERS = len(NAMES)

LEAST_DEPTH = 1e-3
"""Part of the middle's depth; points behind the device are kept there, where they fit badly."""


MAX_LOGARITHM = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """One equation for each known coordinate: point, angle, coordinate and its noise.

    Parameters
    ----------
    points : (m, 3), mm; from the middle of all points
    angle : (m,), rad
    position : (m,), px
    sigma : (m,), px; of the coordinate
    noise : (m, 3), mm; displacement of the point by one standard deviation
    block : (m,) int
    """

    points: Floats
    angle: Floats
    position: Floats
    sigma: Floats
    noise: Floats
    block: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.position)

    def take(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Rows:
        """Return some of the rows."""
        return Rows(
            self.points[which], self.angle[which], self.position[which], self.sigma[which],
            self.noise[which], self.block[which],
        )  # fmt: skip


def position_and_slopes(
    numbers: Floats, start: Floats, points: Floats, angle: Floats, /
) -> tuple[Floats, Floats, Floats]:
    """Return the coordinate across the fringes, and its derivatives.

    Parameters
    ----------
    numbers : (15,); see `NAMES`
    start : (3, 3); rotation at which the fit began
    points : (m, 3), mm; from the middle
    angle : (m,), rad

    Returns
    -------
    (m,) px; (m, 15) by the numbers; (m, 3) by the point, px / mm
    """
    turn = Rotation.from_rotvec(numbers[:3]).as_matrix()
    turned = points @ (turn @ start).T
    x_mm, y_mm, z_mm = (turned + numbers[3:6]).T
    z = np.maximum(z_mm, LEAST_DEPTH * abs(numbers[5]))
    x, y = x_mm / z, y_mm / z
    u, v, ux, uy, vx, vy, lens = _image(numbers, x, y)
    cos, sin = np.cos(angle), np.sin(angle)
    by_x, by_y = cos * ux + sin * vx, cos * uy + sin * vy  # of the normalised point
    by_point = np.stack([by_x / z, by_y / z, -(by_x * x + by_y * y) / z], axis=1)
    slopes = np.empty((len(points), N_NUMBERS))
    slopes[:, :3] = np.cross(turned, by_point) @ _left_jacobian(numbers[:3])
    slopes[:, 3:6] = by_point
    slopes[:, 6:] = cos[:, None] * lens[0] + sin[:, None] * lens[1]
    return cos * (u + 0.5) + sin * (v + 0.5), slopes, by_point @ (turn @ start)


def _image(numbers: Floats, x: Floats, y: Floats) -> tuple[Floats, ...]:
    """Return u, v, their derivatives by x and y, and those by the 9 numbers of the lens."""
    k1, k2, p1, p2, k3 = numbers[10:]
    fx, fy = focal_of(numbers)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    ux = fx * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x)
    vy = fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)
    zero, one = np.zeros_like(x), np.ones_like(x)
    powers = (r2, r2 * r2, r2 * r2 * r2)
    of_u = [fx * xd, zero, one, zero, fx * x * powers[0], fx * x * powers[1],
            fx * 2 * x * y, fx * (r2 + 2 * x * x), fx * x * powers[2]]  # fmt: skip
    of_v = [fy * yd, fy * yd, zero, one, fy * y * powers[0], fy * y * powers[1],
            fy * (r2 + 2 * y * y), fy * 2 * x * y, fy * y * powers[2]]  # fmt: skip
    lens = np.stack([np.stack(of_u, axis=1), np.stack(of_v, axis=1)])
    return fx * xd + numbers[8], fy * yd + numbers[9], ux, fx * cross, fy * cross, vy, lens


def focal_of(numbers: Floats, /) -> Floats:
    """Return the focal lengths along x and y, (2,), px; a wild step of the fit stays finite."""
    log_x, log_ratio = np.clip(numbers[6:8], -MAX_LOGARITHM, MAX_LOGARITHM)
    return np.asarray(np.exp([log_x, log_x + log_ratio]))


def _left_jacobian(vector: Floats) -> Floats:
    """Return how a change of a rotation vector turns the frame: the left Jacobian of SO(3)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + skew / 2)
    a, b = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * skew + b * skew @ skew)


def rotation_of(numbers: Floats, start: Floats, /) -> Floats:
    """Return ``device_from_world``'s rotation, (3, 3)."""
    return np.asarray(Rotation.from_rotvec(numbers[:3]).as_matrix() @ start)


def device_of(
    numbers: Floats, start: Floats, middle_mm: Floats, shape: tuple[int, int], name: str, /
) -> Device:
    """Return the numbers as a projector."""
    rotation = rotation_of(numbers, start)
    return Device(
        name=name,
        role="projector",
        n_rows=shape[0],
        n_cols=shape[1],
        focal_px=focal_of(numbers),
        center_px=numbers[8:10],
        distortion=numbers[10:],
        device_from_world=RigidTransform(
            rotation=rotation, translation=numbers[3:6] - rotation @ middle_mm
        ),
    )
