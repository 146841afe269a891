"""Equations of the poses: each homologous point has a depth of its own, which is eliminated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fringe3d.calibrate._projecting import image_and_slopes, skew
from fringe3d.calibrate.homologous import Homologous
from fringe3d.geometry import project, rays
from fringe3d.model import Device, RigidTransform
from fringe3d.model.covariance import LENS_NUMBERS, POSE_NUMBERS
from fringe3d.patterns import across

Floats = NDArray[np.float64]

N_POSE = 6

FAR = 3.0
"""Standard deviations from which on a point counts less (Cauchy)."""

MAX_ROUNDS = 30
TOLERANCE = 1e-2
"""Standard deviations of the best known numbers: a smaller step changes nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Viewed:
    """Homologous points with the rays of C1, which stays: origin (3,), directions (n, 3)."""

    points: Homologous
    origin: Floats
    directions: Floats


def viewed(points: Homologous, camera: Device, /) -> Viewed:
    """Return the points with their viewing rays."""
    return Viewed(points, *rays(camera, points.pixels_c1))


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """In units of their noise, for points (n) and their m equations: residual (n, m), its slopes
    by depth (n, m), 1 / mm, and by the poses (n, m, p)."""

    residual: Floats
    by_depth: Floats
    by_pose: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Normal equations of the poses: matrix (p, p), gradient (p,); and of each point the squared
    distance in sigmas that is left, and its degrees of freedom."""

    matrix: Floats
    gradient: Floats
    squares: Floats
    freedom: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """How far poses may have moved: former devices, and spread (p,), rad and mm."""

    devices: tuple[Device, ...]
    spread: Floats

    def offset(self, devices: Sequence[Device], /) -> Floats:
        """Return how far the free devices are from where they were, (p,)."""
        pairs = zip(devices[1:], self.devices[1:], strict=True)
        return np.asarray(np.concatenate([pose_change(now, before) for now, before in pairs]))


def pose_change(now: Device, before: Device, /) -> Floats:
    """Return by what a device was turned (rad) and then shifted (mm) in its own frame, (6,)."""
    off = now.device_from_world @ before.device_from_world.inverse()
    return np.asarray(np.r_[Rotation.from_matrix(off.rotation).as_rotvec(), off.translation])


def with_pose_change(device: Device, change: Floats, /) -> Device:
    """Return a device after it was turned and then shifted in its own frame."""
    turn = Rotation.from_rotvec(change[:3]).as_matrix()
    moved = RigidTransform(rotation=turn, translation=change[3:]) @ device.device_from_world
    return replace(device, device_from_world=moved)


def with_number(device: Device, number: str, by: float, /) -> Device:
    """Return a device with one of the `DEVICE_NUMBERS` changed."""
    if number in POSE_NUMBERS:
        change = np.zeros(6)
        change[POSE_NUMBERS.index(number)] = by
        return with_pose_change(device, change)
    place = LENS_NUMBERS.index(number)
    lens = np.zeros(12)
    lens[place] = by
    distortion = device.distortion.copy()
    n = min(len(distortion), 8)
    distortion[:n] += lens[4 : 4 + n]
    return replace(
        device,
        focal_px=device.focal_px + lens[:2],
        center_px=device.center_px + lens[2:4],
        distortion=distortion,
    )


def equations(view: Viewed, devices: Sequence[Device], depths: Floats, /) -> Equations:
    """Return the equations of one scan.

    The light that the projector sends to a point is that which C1 sees on it, and that which each
    further camera sees where the point is in its image. Without a projector, further cameras are
    compared with C1.

    Parameters
    ----------
    view : Viewed
    devices : C1, then the free devices
    depths : (n,), mm, along the rays of C1
    """
    points, directions = view.points, view.directions
    world = view.origin + depths[:, None] * directions
    n, k, p = points.n_points, len(points.angles), N_POSE * (len(devices) - 1)
    lit, lit_depth, lit_pose = points.position_px, np.zeros((n, k)), np.zeros((n, k, p))
    axes = np.stack([np.cos(points.angles), np.sin(points.angles)], axis=1)
    rows: list[tuple[Floats, Floats, Floats, Floats]] = []
    light = next((i for i, d in enumerate(devices) if d.role == "projector"), None)
    if light is not None:
        pixels, by_depth, by_pose = _image(devices, light, world, directions)
        lit = np.stack([across(a, pixels[:, 0], pixels[:, 1]) for a in points.angles], axis=1)
        lit_depth, lit_pose = by_depth @ axes.T, np.einsum("ka,nap->nkp", axes, by_pose)
        rows.append((lit - points.position_px, lit_depth, lit_pose, points.sigma_px))
    for sight in points.sights:
        number = next(i for i, d in enumerate(devices) if d.name == sight.device)
        pixels, by_depth, by_pose = _image(devices, number, world, directions)
        moved = np.einsum("nka,na->nk", sight.slopes, pixels - sight.pixels)
        residual = points.position_px + sight.ahead_px + moved - lit
        slope = np.einsum("nka,na->nk", sight.slopes, by_depth) - lit_depth
        slopes = np.einsum("nka,nap->nkp", sight.slopes, by_pose) - lit_pose
        sigma = sight.sigma_px
        sigma = sigma if light is not None else np.hypot(sigma, points.sigma_px)
        rows.append((residual, slope, slopes, sigma))
    residual, slope, slopes, sigma = (
        np.concatenate(part, axis=1) for part in zip(*rows, strict=True)
    )
    known = np.isfinite(residual) & np.isfinite(sigma)
    weight = np.where(known, 1 / np.where(known, sigma, 1.0), 0.0)
    return Equations(
        np.where(known, residual, 0.0) * weight,
        np.where(known, slope, 0.0) * weight,
        np.where(known[..., None], slopes, 0.0) * weight[..., None],
    )


def _image(
    devices: Sequence[Device], number: int, world: Floats, directions: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return pixels (n, 2), and their slopes by depth (n, 2) and by all poses (n, 2, p)."""
    device = devices[number]
    seen = device.device_from_world.apply(world)
    lens = np.r_[device.focal_px, device.center_px, device.distortion[:8]]
    # Exact pixels; the slopes do without the rarer terms of the lens.
    pixels, (_, by_point, _) = project(device, world), image_and_slopes(seen, lens)
    along = device.device_from_world.rotate(directions)
    by_pose = np.zeros((len(world), 2, N_POSE * (len(devices) - 1)))
    place = N_POSE * (number - 1)
    by_pose[:, :, place : place + 3] = -by_point @ skew(seen)
    by_pose[:, :, place + 3 : place + N_POSE] = by_point
    return pixels, (by_point @ along[..., None])[..., 0], by_pose


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Equations without the depths, weighted: residual (n, m), its slopes by the poses (n, m, p);
    the weights (n,), the squared distance in sigmas (n,), and the degrees of freedom (n,)."""

    residual: Floats
    by_pose: Floats
    root: Floats
    squares: Floats
    freedom: NDArray[np.int64]


def reduced(found: Equations, noise: float, /) -> Reduced:
    """Return the equations after the depths are eliminated, robust."""
    a, e = found.by_depth, found.residual
    power = np.maximum((a * a).sum(axis=1), 1e-300)
    ahead = (a * e).sum(axis=1) / power
    left = e - a * ahead[:, None]
    own = found.by_pose - a[..., None] * ((a[:, None, :] @ found.by_pose) / power[:, None, None])
    freedom = np.maximum((a != 0).sum(axis=1) - 1, 0)
    squares = (left * left).sum(axis=1) / noise**2
    weight = 1 / (1 + squares / (FAR**2 * np.maximum(freedom, 1)))
    root = np.sqrt(weight) / noise
    return Reduced(left * root[:, None], own * root[:, None, None], root, squares, freedom)


def normal_equations(found: Equations, noise: float, /) -> Normal:
    """Return the normal equations of the poses after the depths are eliminated, robust."""
    parts = reduced(found, noise)
    flat = parts.by_pose.reshape(-1, parts.by_pose.shape[2])
    return Normal(flat.T @ flat, flat.T @ parts.residual.ravel(), parts.squares, parts.freedom)


def loss_of(normals: Sequence[Normal], /) -> float:
    """Return the loss of all points, in squared sigmas."""
    total = 0.0
    for normal in normals:
        limit = FAR**2 * np.maximum(normal.freedom, 1)
        total += float((limit * np.log1p(normal.squares / limit)).sum())
    return total


def best_depths(
    view: Viewed, devices: Sequence[Device], depths: Floats, /, *, rounds: int = 2
) -> Floats:
    """Return the depths that fit best for given poses."""
    for _ in range(rounds):
        found = equations(view, devices, depths)
        power = np.maximum((found.by_depth**2).sum(axis=1), 1e-300)
        depths = depths - (found.by_depth * found.residual).sum(axis=1) / power
    return depths


def noise_of(normals: Sequence[Normal], noise: float, /) -> float:
    """Return the factor of the predicted noise that the median of the residuals shows."""
    squares = np.concatenate([n.squares[n.freedom > 0] for n in normals]) * noise**2
    freedom = np.concatenate([n.freedom[n.freedom > 0] for n in normals])
    ratio = np.median(squares / chi2.median(freedom))
    return max(float(np.sqrt(ratio)), 1e-6)


def scale_slope(devices: Sequence[Device], other: int, /) -> Floats:
    """Return the change of the distance of a device from C1 with all poses, (p,)."""
    base = devices[other].center_world - devices[0].center_world
    along = devices[other].device_from_world.rotate(base / np.linalg.norm(base))
    slope = np.zeros(N_POSE * (len(devices) - 1))
    # The centre is -R^T T: turning about the device's own centre would not move it, but the turn
    # is about its frame's origin, which is that centre.
    slope[N_POSE * (other - 1) + 3 : N_POSE * other] = -along
    return slope


def scaled(devices: Sequence[Device], factor: float, /) -> tuple[Device, ...]:
    """Return the devices after the distances of all from C1 grew by a factor."""
    origin = devices[0].center_world
    result = [devices[0]]
    for device in devices[1:]:
        rotation = device.device_from_world.rotation
        center = origin + factor * (device.center_world - origin)
        pose = RigidTransform(rotation=rotation, translation=-rotation @ center)
        result.append(replace(device, device_from_world=pose))
    return tuple(result)


def moved(devices: Sequence[Device], step: Floats, /) -> tuple[Device, ...]:
    """Return the devices after a step of all free poses."""
    parts = step.reshape(-1, N_POSE)
    rest = (with_pose_change(d, part) for d, part in zip(devices[1:], parts, strict=True))
    return (devices[0], *rest)
