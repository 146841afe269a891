"""Where the fit of a projector begins: linear solutions for a general and for a flat scene.

Seen through fringes of one direction a pinhole projector is a camera with one row of pixels,
``w = (P1 X) / (P3 X)``: seven numbers, found linearly (DLT). Points of a plane hold only five of
them; the others follow from a likely focal length and the middle of the image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._camera import N_NUMBERS, Rows

Floats = NDArray[np.float64]

LIKELY_FOCALS = (0.7, 1.4, 2.8)
"""Of the longer side of the image: throw ratios of projectors."""

REWEIGHTINGS = 8
CAUCHY = 2.385
"""Sigma; 95 % efficient where there are no outliers."""

MAD_TO_SIGMA = 1.4826

SQUARE = 0.1
"""Sine of an angle: two directions that differ by 6 degrees or more are two."""


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What one direction shows of a pinhole; axes across and along the fringes, and forward."""

    rotation: Floats
    middle: Floats
    focal: float
    center: float


def starts(rows: Rows, shape: tuple[int, int], /) -> Iterator[tuple[Floats, Floats]]:
    """Yield numbers (15,) and rotations (3, 3) at which a fit may begin.

    Parameters
    ----------
    rows : Rows
    shape : (n_rows, n_cols) of the projector

    Yields
    ------
    numbers, rotation
        None that mirrors one direction against the other.
    """
    values, counts = np.unique(rows.angle, return_counts=True)
    angle = float(values[np.argmax(counts)])
    across = np.array([np.cos(angle), np.sin(angle)])
    axes = np.stack([across, [-across[1], across[0]]])
    middle_px = axes @ np.array([shape[1], shape[0]]) / 2
    for p1, p3 in _lines(rows.take(rows.angle == angle), float(middle_px[0]), max(shape)):
        view = _view(p1, p3)
        if view is None:
            continue
        shift, aside, aspect = _along(rows, angle, view, float(middle_px[1]), max(shape))
        if aspect <= 0:
            continue
        center = axes.T @ [view.center, middle_px[1] + aside] - 0.5
        back = np.eye(3)
        back[:2, :2] = axes.T
        numbers = np.zeros(N_NUMBERS)
        numbers[3:6] = back @ (view.middle + np.array([0, shift, 0]))
        numbers[6:8] = _focal(view.focal, aspect, angle)
        numbers[8:10] = center
        yield numbers, back @ view.rotation


def _view(p1: Floats, p3: Floats) -> _View | None:
    """Split the rows P1 and P3 of a pinhole; None where they make none."""
    p1, p3 = p1 / np.linalg.norm(p3[:3]), p3 / np.linalg.norm(p3[:3])
    center = float(p1[:3] @ p3[:3])
    first = p1[:3] - center * p3[:3]
    focal = float(np.linalg.norm(first))
    if not (np.isfinite(focal) and focal > 0):
        return None
    across = first / focal
    middle = np.array([(p1[3] - center * p3[3]) / focal, 0.0, p3[3]])
    return _View(np.stack([across, np.cross(p3[:3], across), p3[:3]]), middle, focal, center)


def _focal(focal: float, aspect: float, angle: float) -> tuple[float, float]:
    """Return the logarithms of the focal length along x and of the ratio y to x."""
    if abs(np.sin(2 * angle)) > SQUARE:  # oblique fringes: the fit finds the ratio
        return float(np.log(focal)), 0.0
    if abs(np.cos(angle)) > abs(np.sin(angle)):
        return float(np.log(focal)), float(np.log(aspect))
    return float(np.log(focal * aspect)), -float(np.log(aspect))


def _along(
    rows: Rows, angle: float, view: _View, middle_px: float, size: int
) -> tuple[float, float, float]:
    """Return what fringes of another direction show: the middle's place along the first fringes,
    mm, the principal point's beside the image's middle, px, and the ratio of the focal lengths.
    """
    other = rows.take(np.abs(np.sin(rows.angle - angle)) > SQUARE)
    if not len(other):
        return 0.0, 0.0, 1.0
    x, y, z = (other.points @ view.rotation.T + view.middle).T
    turn = other.angle - angle
    first = view.focal * x / z + view.center
    along = (other.position - np.cos(turn) * first) / np.sin(turn) - middle_px
    columns = np.stack([view.focal * y / z, view.focal / z, np.ones(len(z))], axis=1)
    # Of a flat scene that faces the projector, shift and principal point look alike.
    weak = np.diag([1.0, 0.0, 1 / size])
    weight = np.ones(len(z))
    for _ in range(REWEIGHTINGS):
        both = np.vstack([columns * weight[:, None], weak])
        found, *_ = np.linalg.lstsq(both, np.r_[along * weight, 1.0, 0.0, 0.0], rcond=None)
        residual = columns @ found - along
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        weight = 1 / np.sqrt(1 + (residual / (CAUCHY * sigma)) ** 2)
    return float(found[1] / found[0]) if found[0] else 0.0, float(found[2]), float(found[0])


def _lines(rows: Rows, center_px: float, width: int) -> Iterator[tuple[Floats, Floats]]:
    """Yield rows P1 and P3 (4,), positive in front of the projector."""
    scale = float(np.sqrt((rows.points**2).sum(axis=1).mean())) or 1.0
    points, w = rows.points / scale, (rows.position - center_px) / width
    general = _dlt(np.column_stack([points, np.ones(len(points))]), w)
    candidates = [general]
    normal, flat = _plane(points)
    on_plane = _dlt(np.column_stack([points @ flat.T, np.ones(len(points))]), w)
    for focal in LIKELY_FOCALS:
        candidates += list(_off_plane(on_plane, normal, flat, focal))
    for p1, p3 in candidates:
        depth = points @ p3[:3] + p3[3]
        sign = np.sign(np.median(depth)) or 1.0
        p1, p3 = p1 * sign * width + p3 * sign * center_px, p3 * sign
        rescaled = np.r_[1 / scale, 1 / scale, 1 / scale, 1.0]
        yield p1 * rescaled, p3 * rescaled


def _dlt(points: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Solve ``P1 X = w P3 X`` for homogeneous points (m, k), robustly."""
    weight = np.ones(len(w))
    k = points.shape[1]
    both = np.hstack([points, -w[:, None] * points])
    for _ in range(REWEIGHTINGS):
        weighted = both * weight[:, None]
        _, vectors = np.linalg.eigh(weighted.T @ weighted)
        p1, p3 = vectors[:k, 0], vectors[k:, 0]
        depth = points @ p3
        depth = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        residual = (points @ p1) / depth - w
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-12
        weight = 1 / np.abs(depth) / np.sqrt(1 + (residual / (CAUCHY * sigma)) ** 2)
        weight /= weight.max()
    return p1, p3


def _plane(points: Floats) -> tuple[Floats, Floats]:
    """Return normal (3,) and axes (2, 3) of the plane that fits best, through the origin."""
    _, axes = np.linalg.eigh(points.T @ points)
    return axes[:, 0], axes[:, :0:-1].T


def _off_plane(
    on_plane: tuple[Floats, Floats], normal: Floats, flat: Floats, focal: float
) -> Iterator[tuple[Floats, Floats]]:
    """Yield the pinholes with a centred principal point that see a plane as found.

    ``P1 = a + alpha n``, ``P3 = b + beta n``; ``P1 P3 = 0`` and ``|P1| = focal |P3|`` give
    alpha = -(a b) / beta and a quadratic equation for beta^2 with one positive root.
    """
    a, b = on_plane
    dot, aa, bb = float(a[:2] @ b[:2]), float(a[:2] @ a[:2]), float(b[:2] @ b[:2])
    linear = aa - focal**2 * bb
    square = (linear + np.sqrt(linear**2 + 4 * focal**2 * dot**2)) / (2 * focal**2)
    for beta in (np.sqrt(square), -np.sqrt(square)):
        alpha = -dot / beta if beta else 0.0
        yield (
            np.r_[a[:2] @ flat + alpha * normal, a[2]],
            np.r_[b[:2] @ flat + beta * normal, b[2]],
        )
