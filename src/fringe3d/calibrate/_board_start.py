"""Where the bundle adjustment begins: each device by itself, then how they stand to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.calibrate._adjusting import COST_TOLERANCE, adjusted, with_noise
from fringe3d.calibrate._bundle import (
    N_DEVICE,
    N_LENS,
    Group,
    Problem,
    State,
    batches_of,
    cost_of,
)
from fringe3d.calibrate._homography import focal_lengths, homography, plane_pose
from fringe3d.calibrate.board_view import BoardView
from fringe3d.errors import CalibrationError
from fringe3d.model import RigidTransform

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

START_FOCAL = (0.7, 1.2, 2.0, 4.0)
"""Of the longer side; beside what the homographies tell."""

START_CORNERS = 50
"""Of each view, for the choice of the start."""

START_ITERATIONS = 10
START_TOLERANCE = 1e-4
MOST_STARTS = 3

ROUGH_TOLERANCE = 1e-6
"""Of the cost; what a device by itself ends with is where the adjustment of all begins."""
NOISE_ROUNDS = 3

FOCAL = np.zeros(N_DEVICE, bool)
FOCAL[:2] = True


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """A device by itself: its lens (12,), where it sees the board by (pose, via), its rms, px."""

    lens: Floats
    device_from_board: dict[tuple[str, str], RigidTransform]
    rms_px: float


def groups_of(
    views: Sequence[BoardView], devices: Sequence[str], poses: Sequence[str], /
) -> list[Group]:
    """Return the views with numbers for names."""
    return [
        Group(devices.index(v.device), poses.index(v.pose), v.ids, v.pixels, v.sigma_px)
        for v in views
    ]


def calibrated_alone(
    points: Floats,
    views: Sequence[BoardView],
    shape: tuple[int, int],
    free: Bools,
    /,
    *,
    lens: Floats | None = None,
) -> Alone:
    """Calibrate one device by its own views.

    Parameters
    ----------
    points : (N, 3), mm; the board
    views : sequence of BoardView; of one device, each of another pose (or through another camera)
    shape : (n_rows, n_cols)
    free : (18,) bool; of the lens
    lens : (12,) or None; where to begin
    """
    maps = [homography(points[v.ids, :2], v.pixels) for v in views]
    places = [str(number) for number in range(len(views))]
    labelled = [replace(v, pose=p) for v, p in zip(views, places, strict=True)]
    device = labelled[0].device
    starts = [lens] if lens is not None else _start_lenses(maps, shape)
    groups = groups_of(labelled, [device], places)
    problem = _alone_problem(points, groups, free)
    few = groups_of([view.thinned(START_CORNERS) for view in labelled], [device], places)
    begun = _best_start(
        _alone_problem(points, few, free if lens is None else np.zeros(N_DEVICE, bool)),
        [_placed(start, maps, len(points)) for start in starts],
    )
    problem, best = settled(replace(problem, loss="cauchy"), begun, tolerance=ROUGH_TOLERANCE)
    transforms = {
        (view.pose, view.via): RigidTransform(rotation=r, translation=t)
        for view, r, t in zip(views, best.pose_rotation, best.pose_shift, strict=True)
    }
    typical = float(np.median(np.concatenate([v.sigma_px for v in views])))
    return Alone(best.lens[0], transforms, float(problem.noise[0] * typical * np.sqrt(2)))


def _best_start(problem: Problem, starts: list[State]) -> State:
    """Return the start that a few steps bring nearest, after those steps."""
    held = replace(problem, free=problem.free & FOCAL)
    tried = [
        adjusted(held, at, iterations=START_ITERATIONS, tolerance=START_TOLERANCE)
        for at in starts
        if np.isfinite(cost_of(problem, at))
    ]
    if not tried:
        raise CalibrationError(
            "calibration: expected a board in front of the device, found none that fits. Check "
            "that the images are of this board"
        )
    tried = sorted(tried, key=lambda at: cost_of(problem, at))[:MOST_STARTS]
    fine = [
        adjusted(problem, at, iterations=2 * START_ITERATIONS, tolerance=START_TOLERANCE)
        for at in tried
    ]
    return min(fine, key=lambda at: cost_of(problem, at))


def settled(
    problem: Problem, at: State, /, *, tolerance: float = COST_TOLERANCE
) -> tuple[Problem, State]:
    """Adjust and measure the noise in turn: what sticks out is told by what is typical."""
    for rough in (*[max(ROUGH_TOLERANCE, tolerance)] * (NOISE_ROUNDS - 1), tolerance):
        problem = with_noise(problem, at)
        at = adjusted(problem, at, tolerance=rough)
    return with_noise(problem, at), at


def _alone_problem(points: Floats, groups: list[Group], free: Bools) -> Problem:
    return Problem(
        points=points, batches=batches_of(groups), free=free[None], shape_sigma=np.ones(3),
        shape_free=np.zeros((len(points), 3), bool), loss="squared", noise=np.ones(1),
    )  # fmt: skip


def _start_lenses(maps: list[Floats], shape: tuple[int, int]) -> list[Floats]:
    size = np.array([shape[1], shape[0]], np.float64)
    middle = (size - 1) / 2
    # Projectors shift their image up or down: the principal point may lie at its edge.
    centers = [middle, middle * [1, 2], middle * [1, 0]]
    guesses: list[tuple[Floats, Floats]] = []
    for center in centers:
        focal = focal_lengths(maps, center)
        if focal is not None:
            guesses.append((focal, center))
    guesses += [(np.full(2, part * size.max()), middle) for part in START_FOCAL]
    return [np.r_[focal, center, np.zeros(8)] for focal, center in guesses]


def _placed(lens: Floats, maps: list[Floats], n_points: int) -> State:
    """Return a state with the board where a lens without distortion sees it."""
    poses = [plane_pose(m, lens[:2], lens[2:4]) for m in maps]
    return State(
        lens=lens[None, :N_LENS],
        device_rotation=np.eye(3)[None],
        device_shift=np.zeros((1, 3)),
        pose_rotation=np.stack([r for r, _ in poses]),
        pose_shift=np.stack([t for _, t in poses]),
        shape=np.zeros((n_points, 3)),
    )


def typical_transform(found: Sequence[RigidTransform], reach_mm: float, /) -> RigidTransform:
    """Return the one of several that is nearest to all the others."""
    apart = distances(found, found, reach_mm)
    return found[int(np.argmin(np.median(apart, axis=1)))]


def distances(
    a: Sequence[RigidTransform], b: Sequence[RigidTransform], reach_mm: float, /
) -> Floats:
    """Return how far transforms are apart, (len(a), len(b)): turn, rad, plus shift over reach."""
    first = Rotation.from_matrix(np.stack([t.rotation for t in a]))
    shift = np.stack([t.translation for t in a])
    result = np.empty((len(a), len(b)))
    for column, other in enumerate(b):
        turn = (first * Rotation.from_matrix(other.rotation).inv()).magnitude()
        result[:, column] = turn + np.linalg.norm(shift - other.translation, axis=1) / reach_mm
    return result
