"""What is solved for poses: a sample of points, and how far devices are likely to have moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from fringe3d.calibrate._poses import (
    MAX_ROUNDS,
    TOLERANCE,
    Normal,
    Prior,
    Viewed,
    best_depths,
    equations,
    moved,
    normal_equations,
    scale_slope,
    scaled,
    viewed,
)
from fringe3d.calibrate.homologous import Homologous
from fringe3d.errors import EmptyResultError
from fringe3d.geometry import closest_depths, rays, sheet_crossing
from fringe3d.model import Device

Floats = NDArray[np.float64]

SAMPLE = 12_000
"""Points of all scans together; more add hardly anything, for errors of neighbours agree."""

CELLS_ACROSS, DEPTH_LAYERS = 32, 8
"""Parts of image and depth range, from each of which as many points are taken."""

LIKELY_TURN = np.radians(0.1)
LIKELY_SHIFT = 1e-3
"""Of the distance: how far devices are likely to have moved. It matters only for what the data do
not determine."""

BLOCKS_ACROSS = 16
MIN_BLOCK = 10
OUTLIER = 4.0

SMOOTH_PX = 0.01
"""Projector px, by which neighbouring points are likely to be off together, whatever the noise:
response of the cameras, lenses. It keeps weak combinations from following such errors."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    devices: tuple[Device, ...]
    depths: tuple[Floats, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PoseProblem:
    scans: tuple[Viewed, ...]
    prior: Prior

    def at(self, devices: Sequence[Device], depths: Sequence[Floats]) -> State:
        """Return the state of these devices, with the depths that fit best."""
        pairs = zip(self.scans, depths, strict=True)
        return State(tuple(devices), tuple(best_depths(s, devices, t) for s, t in pairs))

    def normals(self, at: State, noise: float) -> list[Normal]:
        return [
            normal_equations(equations(scan, at.devices, depths), noise)
            for scan, depths in zip(self.scans, at.depths, strict=True)
        ]

    def information(self, at: State, noise: float, crowding: float) -> tuple[Floats, Floats]:
        """Return the normal matrix and the gradient, without what was likely beforehand."""
        normals = self.normals(at, noise)
        matrix, gradient = sum(n.matrix for n in normals), sum(n.gradient for n in normals)
        return np.asarray(matrix / crowding), np.asarray(gradient / crowding)

    def solve(
        self,
        at: State,
        noise: float,
        crowding: float,
        /,
        *,
        free: Callable[[Sequence[Device]], Floats] | None = None,
    ) -> State:
        """Iterate to the best poses.

        Parameters
        ----------
        at : State
        noise, crowding : float
        free : function from devices to directions (p, f), rad and mm, or None
            In which poses may move; None: all that keep the distance of C1 and the next device.
        """
        spread = self.prior.spread
        for _ in range(MAX_ROUNDS):
            matrix, gradient = self.information(at, noise, crowding)
            basis = _basis(at.devices, spread, free)
            offset = self.prior.offset(at.devices) / spread
            held = basis.T @ basis
            reduced = basis.T @ (matrix * np.outer(spread, spread)) @ basis + held
            pull = basis.T @ (gradient * spread + offset)
            step = -np.linalg.solve(reduced, pull)
            at = self._after(at, spread * (basis @ step), keeps_distance=free is None)
            if float(np.sqrt(step @ reduced @ step)) < TOLERANCE:
                break
        return at

    def _after(self, at: State, step: Floats, *, keeps_distance: bool) -> State:
        """Return the state after a step, with the former distance from C1 to the next device."""
        devices = moved(at.devices, step)
        factor = _distance(self.prior.devices) / _distance(devices) if keeps_distance else 1.0
        return self.at(scaled(devices, factor), [t * factor for t in at.depths])


def _distance(devices: Sequence[Device]) -> float:
    return float(np.linalg.norm(devices[1].center_world - devices[0].center_world))


def _basis(
    devices: Sequence[Device],
    spread: Floats,
    free: Callable[[Sequence[Device]], Floats] | None,
) -> Floats:
    if free is None:
        return without_scale(devices, spread)
    return free(devices) / spread[:, None]


def without_scale(devices: Sequence[Device], spread: Floats) -> Floats:
    """Return the directions (p, p - 1), in units of the spread, that keep the distance."""
    return np.asarray(null_space((scale_slope(devices, 1) * spread)[None]))


def first_depths(scan: Homologous, devices: Sequence[Device]) -> Floats:
    """Return the depths of the points with the former poses, (n,), mm; NaN where there is none."""
    origin, directions = rays(devices[0], scan.pixels_c1)
    for sight in scan.sights:
        other = next(d for d in devices if d.name == sight.device)
        depths, behind = closest_depths(origin, directions, *rays(other, sight.pixels))
        return np.where((depths > 0) & (behind > 0), depths, np.nan)
    projector = devices[-1]
    w = scan.position_px[:, 0]
    return sheet_crossing(projector, origin, directions, w, scan.angles[0])


def _even(scan: Homologous, depths: Floats, wanted: int) -> tuple[Homologous, Floats]:
    """Return points that are spread evenly over image and depth."""
    good = np.flatnonzero(np.isfinite(depths) & (depths > 0))
    if not len(good):
        raise EmptyResultError(f"{scan.name}: expected points in front of the devices, found none")
    pixels = scan.pixels_c1[good]
    side = max(float(np.ptp(pixels, axis=0).max()) / CELLS_ACROSS, 1.0)
    cell = ((pixels - pixels.min(axis=0)) // side).astype(int) @ [1, 1000]
    low, high = np.percentile(depths[good], [0.5, 99.5])
    edges = np.linspace(low, high, DEPTH_LAYERS + 1)[1:-1]
    part = cell * DEPTH_LAYERS + np.searchsorted(edges, depths[good])
    order = np.random.default_rng(0).permutation(len(good))
    by_part = order[np.argsort(part[order], kind="stable")]
    _, first, counts = np.unique(part[by_part], return_index=True, return_counts=True)
    rank = np.arange(len(good)) - np.repeat(first, counts)
    kept = good[np.sort(by_part[np.argsort(rank, kind="stable")[:wanted]])]
    return scan.subset(kept), depths[kept]


def _spread(devices: Sequence[Device], depths: Floats) -> Floats:
    one = [LIKELY_TURN] * 3 + [LIKELY_SHIFT * float(np.median(depths))] * 3
    return np.array(one * (len(devices) - 1))


def problem_of_points(
    scans: Sequence[Homologous], devices: Sequence[Device]
) -> tuple[PoseProblem, State]:
    """Return what is to be solved, of points spread evenly, and the state before."""
    begun = [first_depths(scan, devices) for scan in scans]
    chosen = [_even(s, t, SAMPLE // len(scans)) for s, t in zip(scans, begun, strict=True)]
    prior = Prior(tuple(devices), _spread(devices, np.concatenate([t for _, t in chosen])))
    problem = PoseProblem(tuple(viewed(s, devices[0]) for s, _ in chosen), prior)
    return problem, problem.at(devices, tuple(t for _, t in chosen))


def left_over(scan: Viewed, at: State, depths: Floats) -> tuple[Floats, Floats]:
    """Return what is left of the residuals after the best depth, in sigmas, and the sigmas."""
    found = equations(scan, at.devices, depths)
    power = np.maximum((found.by_depth**2).sum(axis=1, keepdims=True), 1e-300)
    ahead = (found.by_depth * found.residual).sum(axis=1, keepdims=True) / power
    left = found.residual - found.by_depth * ahead
    points = scan.points
    has_light = at.devices[-1].role == "projector"
    columns = [points.sigma_px] if has_light else []
    sigma = np.concatenate([*columns, *(s.sigma_px for s in points.sights)], axis=1)
    return np.where(found.by_depth == 0, np.nan, left), sigma


def contradiction_px(problem: PoseProblem, at: State) -> float:
    """Return the median of the root mean square of what is left of each point, projector px; NaN
    where no point has more than one datum."""
    per_point = []
    for scan, depths in zip(problem.scans, at.depths, strict=True):
        left, sigma = left_over(scan, at, depths)
        squares, known = (left * sigma) ** 2, np.isfinite(left * sigma)
        many = known.sum(axis=1) > 1
        total = np.where(known, squares, 0.0).sum(axis=1)[many]
        per_point.append(np.sqrt(total / known.sum(axis=1)[many]))
    values = np.concatenate(per_point)
    return float(np.median(values)) if len(values) else float("nan")


def crowding_of(problem: PoseProblem, at: State, noise: float) -> float:
    """Return by how much means over blocks of neighbours vary more than noise alone would do."""
    ratios = []
    for scan, depths in zip(problem.scans, at.depths, strict=True):
        left, sigma = left_over(scan, at, depths)
        side = max(float(np.ptp(scan.points.pixels_c1, axis=0).max()) / BLOCKS_ACROSS, 1.0)
        block = ((scan.points.pixels_c1 - scan.points.pixels_c1.min(axis=0)) // side).astype(
            int
        ) @ [1, 1000]
        _, block = np.unique(block, return_inverse=True)
        for column, own in zip((left / noise).T, (sigma * noise).T, strict=True):
            good = np.abs(column) < OUTLIER
            if not good.any():
                continue
            counts = np.bincount(block[good])
            means = np.bincount(block[good], column[good]) / np.maximum(counts, 1)
            full, spread = counts >= MIN_BLOCK, float((column[good] ** 2).mean())
            if full.any():
                ratios.append(float((means[full] ** 2 * counts[full]).mean()) / spread)
                likely = (SMOOTH_PX / float(np.median(own[good]))) ** 2
                ratios.append(1 + likely * float(np.median(counts[full])))
    return max(1.0, max(ratios, default=1.0))
