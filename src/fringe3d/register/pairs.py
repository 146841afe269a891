"""Two views that lie anywhere: features, a robust solver, generalised ICP; how well they fit."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import MethodError
from fringe3d.model import RigidTransform, SurfaceView
from fringe3d.register.overlap import Sample, land_sample, sample_of
from fringe3d.register.small_motion import nearest_rotation, vector_of

Floats = NDArray[np.float64]

EXTENT = 80.0
"""Clouds are scaled so that their diagonal is so long: the matcher's bounds suit that."""

VOXELS = (0.8, 0.5, 1.2)
"""Of the features, of that extent: one of them suits the size of the object's details."""

MOST_POINTS = 60_000
ICP_VOXELS, ICP_REACH = 3.0, 12.0
"""Typical distances of points: of the points that GICP takes, and how far it looks for partners."""

N_JUDGED = 2000
NEAR = 4.0
"""Typical distances of points: views that fit lie so near each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairFit:
    """How one view lies to another.

    Parameters
    ----------
    first_from_second : RigidTransform
    overlap : float, 0 to 1; part of the points of either that lie on the other's surface
    contradiction : float, 0 to 1; of the points that lie on it or before it, the part that the
        other camera looked through
    """

    first_from_second: RigidTransform
    overlap: float
    contradiction: float

    @property
    def quality(self) -> float:
        """Return one number to compare fits by."""
        return self.overlap * (1 - self.contradiction) ** 2


def extra(name: str, of: str, /) -> Any:
    """Return a library of an extra; say what to install where it is missing.

    Raises
    ------
    MethodError
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as problem:
        raise MethodError(
            f"merge: expected the packages of registration, found no '{name}' ({problem}). Install "
            f"them: pip install 'fringe3d[{of}]'"
        ) from None


def match_pair(first: SurfaceView, second: SurfaceView, /) -> PairFit | None:
    """Find how two views lie to each other without knowing anything.

    Parameters
    ----------
    first, second : SurfaceView

    Returns
    -------
    PairFit or None; None where nothing fits

    Raises
    ------
    MethodError
        If a library is missing.

    Notes
    -----
    KISS-Matcher: Faster-PFH features, a maximal set of consistent ones, graduated non-convexity;
    then generalised ICP by small_gicp. The best of three sizes of features is taken.
    """
    clouds = [view.points_mm[view.is_valid] for view in (first, second)]
    best: PairFit | None = None
    for rough in _by_features(*clouds):
        fit = judge_pair(first, second, refine_pair(first, second, rough))
        best = fit if best is None or fit.quality > best.quality else best
        if is_sure(best):
            break
    return best


def hypotheses_of(first: SurfaceView, second: SurfaceView, /) -> list[PairFit]:
    """Return all fits of two views that may be right, each once: those of three sizes of features.

    Raises
    ------
    MethodError
        If a library is missing.
    """
    clouds = [view.points_mm[view.is_valid] for view in (first, second)]
    middle = clouds[1].mean(axis=0)
    found: list[PairFit] = []
    for rough in _by_features(*clouds):
        fit = judge_pair(first, second, refine_pair(first, second, rough))
        near = NEAR * first.spacing_mm
        if is_possible(fit) and not any(_alike(fit, other, middle, near) for other in found):
            found.append(fit)
        if is_sure(fit):
            break
    return found


def _alike(one: PairFit, two: PairFit, middle_mm: Floats, near_mm: float) -> bool:
    vector = vector_of(one.first_from_second.inverse() @ two.first_from_second, middle_mm)
    return bool(np.linalg.norm(vector[3:]) < near_mm and np.linalg.norm(vector[:3]) < SAME_TURN)


SAME_TURN = 0.05
"""rad; fits that differ by less are one."""

SURE_OVERLAP, SURE_CONTRADICTION = 0.4, 0.1
LEAST_OVERLAP_PART, MOST_CONTRADICTION = 0.15, 0.25


def is_sure(fit: PairFit, /) -> bool:
    """Tell whether a fit leaves no doubt."""
    return fit.overlap > SURE_OVERLAP and fit.contradiction < SURE_CONTRADICTION


def is_possible(fit: PairFit, /) -> bool:
    """Tell whether a fit may be right."""
    return fit.overlap > LEAST_OVERLAP_PART and fit.contradiction < MOST_CONTRADICTION


def _by_features(target: Floats, source: Floats) -> Iterator[RigidTransform]:
    """Yield ``target_from_source`` as features of several sizes say."""
    kiss = extra("kiss_matcher", "merge")
    clouds = [_thinned(cloud) for cloud in (target, source)]
    unit = max(float(np.linalg.norm(np.ptp(cloud, axis=0))) for cloud in clouds) / EXTENT
    middles = [cloud.mean(axis=0) for cloud in clouds]
    scaled = [((c - m) / unit).astype(np.float32) for c, m in zip(clouds, middles, strict=True)]
    for voxel in VOXELS:
        with _without_output():
            told = kiss.KISSMatcher(voxel).estimate(scaled[1], scaled[0])
        if told.valid:
            rotation = nearest_rotation(np.asarray(told.rotation, np.float64))
            shift = unit * np.asarray(told.translation, np.float64).ravel()
            shift += middles[0] - rotation @ middles[1]
            yield RigidTransform(rotation=rotation, translation=shift)


def place_clouds(target: Floats, source: Floats, /) -> RigidTransform | None:
    """Return ``target_from_source`` of two clouds that lie anywhere; None where nothing fits.

    Parameters
    ----------
    target, source : (n, 3), (m, 3) float, mm
    """
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    best: tuple[float, RigidTransform] | None = None
    for rough in _by_features(target, source):
        fine, fits = _generalised(target, source, rough, voxel=extent / 200, reach=extent / 50)
        if best is None or fits > best[0]:
            best = fits, fine
    return best[1] if best else None


def hypotheses_of_clouds(target: Floats, source: Floats, /) -> Iterator[RigidTransform]:
    """Yield where a cloud may lie in the frame of another, refined by generalised ICP."""
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    for rough in _by_features(target, source):
        yield _generalised(target, source, rough, voxel=extent / 200, reach=extent / 50)[0]


@contextmanager
def _without_output() -> Iterator[None]:
    """Keep what compiled libraries print off the user's terminal."""
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _thinned(points: Floats) -> Floats:
    if len(points) <= MOST_POINTS:
        return points
    return points[:: -(-len(points) // MOST_POINTS)]


def refine_pair(
    first: SurfaceView, second: SurfaceView, first_from_second: RigidTransform, /
) -> RigidTransform:
    """Return how two views lie to each other, from where they lie roughly, by generalised ICP."""
    spacing = max(first.spacing_mm, second.spacing_mm)
    target, source = (view.points_mm[view.is_valid] for view in (first, second))
    return _generalised(
        target, source, first_from_second, voxel=ICP_VOXELS * spacing, reach=ICP_REACH * spacing
    )[0]


def _generalised(
    target: Floats, source: Floats, rough: RigidTransform, *, voxel: float, reach: float
) -> tuple[RigidTransform, float]:
    """Refine by generalised ICP; return how many points found partners, too."""
    gicp = extra("small_gicp", "merge")
    middle = target.mean(axis=0)  # small numbers: turns and shifts then hang together little
    start = np.eye(4)
    start[:3, :3] = rough.rotation
    start[:3, 3] = rough.rotation @ middle + rough.translation - middle
    told = gicp.align(
        target - middle, source - middle, init_T_target_source=start, registration_type="GICP",
        downsampling_resolution=voxel, max_correspondence_distance=reach, num_threads=1,
        max_iterations=40, rotation_epsilon=1e-5, translation_epsilon=voxel / 3e4,
    )  # fmt: skip
    found = np.asarray(told.T_target_source)
    rotation = nearest_rotation(found[:3, :3])
    shift = found[:3, 3] + middle - rotation @ middle
    return RigidTransform(rotation=rotation, translation=shift), float(told.num_inliers)


def judge_pair(
    first: SurfaceView, second: SurfaceView, first_from_second: RigidTransform, /
) -> PairFit:
    """Tell how well two views fit: what lies on each other, and what the other looked through."""
    near = NEAR * max(first.spacing_mm, second.spacing_mm)
    identity = RigidTransform.identity()
    sides = (
        (sample_of(second, N_JUDGED), first_from_second, first, identity),
        (sample_of(first, N_JUDGED), identity, second, first_from_second),
    )
    n_all = n_near = n_front = 0
    for sample, own, other, pose in sides:
        counts = _counts(sample, own, other, pose, near)
        n_all, n_near, n_front = n_all + counts[0], n_near + counts[1], n_front + counts[2]
    return PairFit(
        first_from_second=first_from_second,
        overlap=n_near / max(n_all, 1),
        contradiction=n_front / max(n_near + n_front, 1),
    )


def _counts(
    sample: Sample, own: RigidTransform, other: SurfaceView, pose: RigidTransform, near: float
) -> tuple[int, int, int]:
    landed = land_sample(sample, own, other, pose)
    with np.errstate(invalid="ignore"):
        is_near = np.abs(landed.distance_mm) <= near
        is_front = (landed.behind_mm < -2 * near) & ~is_near
    return len(sample.points_mm), int(is_near.sum()), int(is_front.sum())
