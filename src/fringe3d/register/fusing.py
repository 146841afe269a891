"""One surface from registered views: overlaps averaged, every point accounted for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.kernels import n_threads
from fringe3d.model import Fate, MergedCloud, RigidTransform, SurfaceView
from fringe3d.register.overlap import all_points, land_on

Floats = NDArray[np.float64]

SAME_SURFACE = 4.0
"""Points within so many standard deviations of each other are of one surface."""

LAYER = 3.0
"""Typical distances of points within which two layers of one surface may lie apart."""

LATER_BETTER, EARLIER_BETTER = 1.08, 1 / 1.02
"""How much more steeply the rays of a later view must meet the surface to stand for the place, and
those of an earlier one: of views that are alike the earlier stands, and between both limits both
do, so that nothing gapes."""

LOOKED_THROUGH = 2
"""Views that must have looked through a point that none confirms."""


@dataclass(slots=True, eq=False)
class _Sums:
    """What all other views say of the points of one."""

    weight: Floats
    pull: Floats
    against: Floats
    n_views: NDArray[np.int64]
    n_through: NDArray[np.int64]
    is_best: NDArray[np.bool_]


def fuse(
    views: Sequence[SurfaceView],
    body_from_view: Sequence[RigidTransform],
    /,
    *,
    noise_factor: float = 1.0,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> MergedCloud:
    """Make one cloud of registered views.

    Parameters
    ----------
    views : sequence of SurfaceView
    body_from_view : sequence of RigidTransform
    noise_factor : float; size of the residuals over the points' sigmas, of the registration
    step : called with the work, what is done and what there is to do

    Returns
    -------
    MergedCloud

    Notes
    -----
    Each point is moved along its normal to the mean of what all views saw at its place, weighted
    by their variances along the normal. Of the views that saw a place the one whose rays
    meet it most steeply stands for it; the points of the others are averaged into it. Where views
    disagree by more than four sigmas the heavier layer stays. A point that two other views looked
    through, and none confirms, is dropped.
    """
    scale = SAME_SURFACE * max(noise_factor, 1.0)
    parts, fates = [], []
    with ThreadPoolExecutor(n_threads()) as pool:  # what is not compiled takes half of the time
        work = pool.map(lambda i: _fused_view(views, body_from_view, i, scale), range(len(views)))
        for number, (part, fate) in enumerate(work):
            step("fusing views", number, len(views))
            parts.append(part)
            fates.append(fate)
    step("fusing views", len(views), len(views))
    points, normals, sigma, grey, n_views, source = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    return MergedCloud(points_mm=points, normals=normals, sigma_mm=sigma, grey=grey,
                       n_views=n_views, source=source, fates=tuple(fates))  # fmt: skip


def _fused_view(
    views: Sequence[SurfaceView], poses: Sequence[RigidTransform], i: int, scale: float
) -> tuple[tuple[NDArray, ...], NDArray[np.uint8]]:  # type: ignore[type-arg]
    view = views[i]
    has_normal = np.isfinite(view.normals[..., 0])
    sample = all_points(view)
    rays = sample.points_mm - view.camera.center_world
    cosine = np.abs((rays * sample.normals).sum(axis=1)) / np.linalg.norm(rays, axis=1)
    sigma = np.maximum(sample.sigma_mm, 1e-9)
    n = len(sigma)
    sums = _Sums(sigma**-2.0, np.zeros(n), np.zeros(n), np.ones(n, np.int64),
                 np.zeros(n, np.int64), np.ones(n, bool))  # fmt: skip
    for j, other in enumerate(views):
        if j != i:
            other_from_own = poses[j].inverse() @ poses[i]
            better = LATER_BETTER if j > i else EARLIER_BETTER
            _add(sums, other, other_from_own.apply(sample.points_mm),
                 other_from_own.rotate(sample.normals), sigma, better * cosine, scale)  # fmt: skip
    is_layer = sums.against > sums.weight
    is_through = (sums.n_views == 1) & (sums.n_through >= LOOKED_THROUGH)
    told = np.full(n, int(Fate.KEPT), np.uint8)
    told[~sums.is_best] = Fate.AVERAGED
    told[is_layer] = Fate.OTHER_LAYER
    told[is_through] = Fate.SEEN_THROUGH
    fate = np.where(view.is_valid, int(Fate.NO_NORMAL), int(Fate.NONE)).astype(np.uint8)
    fate[has_normal] = told
    keep = told == Fate.KEPT
    moved = sample.points_mm + (sums.pull / sums.weight)[:, None] * sample.normals
    return (
        poses[i].apply(moved[keep]),
        poses[i].rotate(sample.normals[keep]).astype(np.float32),
        (sums.weight[keep] ** -0.5).astype(np.float32),
        view.grey[has_normal][keep],
        np.minimum(sums.n_views[keep], 255).astype(np.uint8),
        np.full(int(keep.sum()), i, np.uint16),
    ), fate


def _add(
    sums: _Sums, other: SurfaceView, points: Floats, normals: Floats, sigma: Floats,
    cosine: Floats, scale: float,
) -> None:  # fmt: skip
    """Add what one other view says; with a larger `cosine` it stands for the place itself."""
    towards = other.camera.center_world - points
    faces = np.flatnonzero((towards * normals).sum(axis=1) > 0)  # it cannot see the others
    sigma, cosine = sigma[faces], cosine[faces]
    landed = land_on(other, points[faces], normals[faces])
    layer = LAYER * other.spacing_mm
    with np.errstate(invalid="ignore"):
        both = np.hypot(sigma, landed.sigma_mm)
        same = np.abs(landed.distance_mm) <= scale * both
        is_close = np.abs(landed.distance_mm) <= layer
        beside = ~same & is_close & landed.is_smooth
        through = ~same & ~is_close & (landed.behind_mm < -2 * layer)
        is_better = same & (landed.cosine > cosine)
    weight = np.maximum(landed.sigma_mm, 1e-9) ** -2.0
    sums.weight[faces[same]] += weight[same]
    sums.pull[faces[same]] -= (weight * landed.distance_mm)[same]
    sums.against[faces[beside]] += weight[beside]
    sums.n_views[faces[same]] += 1
    sums.n_through[faces[through]] += 1
    sums.is_best[faces[is_better]] = False
