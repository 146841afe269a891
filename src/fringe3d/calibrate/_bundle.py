"""Bundle adjustment: devices, board poses and board shape from the corners that were seen.

The unknowns of the devices come first, then six for each pose, then those of the board's points,
whose equations are kept apart: they are eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._projecting import image, image_and_slopes, skew

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Loss = Literal["cauchy", "huber", "squared"]

N_LENS, N_DEVICE, N_POSE = 12, 18, 6

LIMIT = {"cauchy": 3.0, "huber": 2.5, "squared": np.inf}
"""Standard deviations of a corner's distance from which on it counts less: one good corner in a
hundred lies beyond 3."""


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Corners of one view: device, pose, numbers (n,), pixels (n, 2), sigma (n,)."""

    device: int
    pose: int
    ids: NDArray[np.int64]
    pixels: Floats
    sigma: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """All views of one device, one after the other: much faster than each by itself.

    Parameters
    ----------
    device : int
    views : sequence of (number of the view, pose, slice of the rows)
    pose, ids : (n,) int; of each corner
    pixels : (n, 2), px
    sigma : (n,), px
    """

    device: int
    views: Sequence[tuple[int, int, slice]]
    pose: NDArray[np.int64]
    ids: NDArray[np.int64]
    pixels: Floats
    sigma: Floats


def batches_of(groups: Sequence[Group], /) -> tuple[Batch, ...]:
    """Return the views by device."""
    found = []
    for device in sorted({group.device for group in groups}):
        own = [(number, g) for number, g in enumerate(groups) if g.device == device]
        ends = np.cumsum([0, *(len(g.ids) for _, g in own)])
        views = [
            (number, g.pose, slice(int(a), int(b)))
            for (number, g), a, b in zip(own, ends[:-1], ends[1:], strict=True)
        ]
        found.append(
            Batch(
                device=device,
                views=views,
                pose=np.concatenate([np.full(len(g.ids), g.pose) for _, g in own]),
                ids=np.concatenate([g.ids for _, g in own]),
                pixels=np.concatenate([g.pixels for _, g in own]),
                sigma=np.concatenate([g.sigma for _, g in own]),
            )
        )
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is known, and what is free.

    Parameters
    ----------
    points : (N, 3), mm; the board as it should be
    batches : sequence of Batch
    free : (D, 18) bool; numbers of each device: lens, turn, shift
    shape_free : (N, 3) bool
    shape_sigma : (3,), mm; how far the points are likely to be off along each axis
    loss : "cauchy", "huber" or "squared"
    noise : (D,); factor of the sigma of each device
    """

    points: Floats
    batches: Sequence[Batch]
    free: Bools
    shape_free: Bools
    shape_sigma: Floats
    loss: Loss
    noise: Floats

    @property
    def has_shape(self) -> bool:
        """Tell whether points of the board are free."""
        return bool(self.shape_free.any())

    @property
    def n_free(self) -> int:
        """Return the number of free numbers of the devices."""
        return int(self.free.sum())


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Values: lens (D, 12); device_from_world and world_from_board, rotation and translation; and
    the displacement of the board's points (N, 3)."""

    lens: Floats
    device_rotation: Floats
    device_shift: Floats
    pose_rotation: Floats
    pose_shift: Floats
    shape: Floats


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Normal equations: cost, H and gradient of devices and poses, and those of the points."""

    cost: float
    matrix: Floats
    gradient: Floats
    coupling: Floats
    blocks: Floats
    point_gradient: Floats


def loss_and_weight(s: Floats, loss: Loss, /) -> tuple[Floats, Floats]:
    """Return the loss of squared distances in sigmas, and its derivative."""
    c2 = LIMIT[loss] ** 2
    if loss == "cauchy":
        return np.asarray(c2 * np.log1p(s / c2)), np.asarray(1 / (1 + s / c2))
    if loss == "huber":
        far = np.sqrt(np.maximum(s, c2) / c2)
        return np.where(s > c2, (2 * far - 1) * c2, s), 1 / far
    return s, np.ones_like(s)


def device_points(problem: Problem, at: State, batch: Batch, /) -> tuple[Floats, Floats]:
    """Return the corners in the device frame, (n, 3), and from the board's origin along the axes
    of the world, (n, 3), mm."""
    board = problem.points[batch.ids] + at.shape[batch.ids]
    turned = (at.pose_rotation[batch.pose] @ board[..., None])[..., 0]
    world = turned + at.pose_shift[batch.pose]
    rotation, shift = at.device_rotation[batch.device], at.device_shift[batch.device]
    return world @ rotation.T + shift, turned


def residuals(problem: Problem, at: State, /) -> list[Floats]:
    """Return model minus measurement of each view, (n, 2), px."""
    found: dict[int, Floats] = {}
    for batch in problem.batches:
        points, _ = device_points(problem, at, batch)
        with np.errstate(all="ignore"):
            residual = image(points, at.lens[batch.device]) - batch.pixels
        found |= {number: residual[rows] for number, _, rows in batch.views}
    return [found[number] for number in sorted(found)]


def cost_of(problem: Problem, at: State, /) -> float:
    """Return the loss; infinite where a point lies behind a device or the lens means nothing."""
    total = _prior_cost(problem, at)
    if (at.lens[:, :2] <= 0).any():
        return float("inf")
    for batch in problem.batches:
        points, _ = device_points(problem, at, batch)
        if (points[:, 2] <= 0).any():
            return float("inf")
        with np.errstate(all="ignore"):
            residual = image(points, at.lens[batch.device]) - batch.pixels
            s = (residual**2).sum(axis=1) / (batch.sigma * problem.noise[batch.device]) ** 2
        total += float(loss_and_weight(s, problem.loss)[0].sum())
    return total if np.isfinite(total) else float("inf")


def _prior_cost(problem: Problem, at: State) -> float:
    return float(((at.shape / problem.shape_sigma) ** 2).sum()) if problem.has_shape else 0.0


def batch_slopes(
    problem: Problem, at: State, batch: Batch, /
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the residual (n, 2) and its slopes by device (n, 2, 18), pose (n, 2, 6), point."""
    points, turned = device_points(problem, at, batch)
    pixels, by_point, by_lens = image_and_slopes(points, at.lens[batch.device])
    by_device = np.concatenate([by_lens, -by_point @ skew(points), by_point], axis=2)
    by_world = by_point @ at.device_rotation[batch.device]
    by_pose = np.concatenate([-by_world @ skew(turned), by_world], axis=2)
    return pixels - batch.pixels, by_device, by_pose, by_world @ at.pose_rotation[batch.pose]


def normal_equations(problem: Problem, at: State, /, *, efficiency: Floats | None = None) -> System:
    """Return the normal equations.

    Parameters
    ----------
    problem : Problem
    at : State
    efficiency : (D,) or None
        Weight of all corners of each device, for the information; None weights by the loss.
    """
    n = problem.n_free + N_POSE * len(at.pose_shift)
    n_points = len(problem.points) if problem.has_shape else 0
    system = System(_prior_cost(problem, at), np.zeros((n, n)), np.zeros(n),
                    np.zeros((n_points, 3, n)), np.zeros((n_points, 3, 3)),
                    np.zeros((n_points, 3)))  # fmt: skip
    columns = np.cumsum(problem.free).reshape(problem.free.shape) - 1
    cost = system.cost
    for batch in problem.batches:
        residual, by_device, by_pose, by_board = batch_slopes(problem, at, batch)
        sigma = batch.sigma * problem.noise[batch.device]
        loss, weight = loss_and_weight((residual**2).sum(axis=1) / sigma**2, problem.loss)
        cost += float(loss.sum())
        if efficiency is not None:
            weight = np.full(len(sigma), efficiency[batch.device])
        root = (np.sqrt(weight) / sigma)[:, None]
        free = problem.free[batch.device]
        slopes = np.concatenate([by_device[:, :, free], by_pose], axis=2) * root[..., None]
        own = by_board * root[..., None] * problem.shape_free[batch.ids][:, None, :]
        pull = residual * root
        for _, pose, rows in batch.views:
            place = np.r_[columns[batch.device][free],
                          problem.n_free + N_POSE * pose + np.arange(N_POSE)]  # fmt: skip
            _add(system, place, slopes[rows], pull[rows])
            if n_points:
                _add_points(system, place, batch.ids[rows], own[rows], slopes[rows], pull[rows])
    if n_points:
        held = 1 / problem.shape_sigma**2
        system.blocks[:, range(3), range(3)] += np.where(problem.shape_free, held, 1.0)
        system.point_gradient[:] += np.where(problem.shape_free, at.shape * held, 0.0)
    return replace(system, cost=cost)


def _add(system: System, place: NDArray[np.intp], slopes: Floats, pull: Floats) -> None:
    """Add a view to the equations of devices and poses."""
    flat = slopes.reshape(-1, len(place))
    system.matrix[place[:, None], place] += flat.T @ flat
    system.gradient[place] += flat.T @ pull.ravel()


def _add_points(
    system: System,
    place: NDArray[np.intp],
    ids: NDArray[np.int64],
    own: Floats,
    slopes: Floats,
    pull: Floats,
) -> None:
    """Add a view to the equations of the board's points; each is in it at most once."""
    across = np.swapaxes(own, 1, 2)
    rows = system.coupling[ids]
    rows[:, :, place] += across @ slopes
    system.coupling[ids] = rows
    system.blocks[ids] += across @ own
    system.point_gradient[ids] += (across @ pull[:, :, None])[..., 0]
