"""One camera and the projector: the decoded coordinates are the correspondence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond.curves import OUTSIDE_PART
from fringe3d.errors import MethodError
from fringe3d.geometry import (
    closest_depths,
    epipolar_segment,
    pixel_grid,
    project,
    rays,
    sheet_crossing,
)
from fringe3d.model import (
    NO_ORDER,
    Correspondences,
    Device,
    MeasuringVolume,
    PhaseMap,
    Rejection,
)
from fringe3d.model.rejection import reject
from fringe3d.patterns import across

TWO_PI = 2 * np.pi

DEPTH_STEP = 1e-4
"""Part of the depth by which the ray is moved to find the direction of the epipolar curve."""

GUARD_SIGMA = 3.0
GUARD_PX = 0.5
"""Candidates are accepted this far beyond the ends of the segment (calibration error)."""


def match_projector(
    maps: Sequence[PhaseMap],
    camera: Device,
    projector: Device,
    volume: MeasuringVolume | None,
    /,
) -> Correspondences:
    """Find the projector point of every pixel of a camera.

    With one direction the point is where the epipolar curve crosses the decoded fringe; with
    two it is decoded outright, and its distance from the epipolar curve is a check.

    Parameters
    ----------
    maps : one or two PhaseMap of the camera, of different angles
    camera, projector : Device
    volume : MeasuringVolume or None
        Needed where the code is reduced: the order is then the only one of its class on the
        pixel's epipolar segment (AMBIGUOUS where there are several), in each direction.

    Returns
    -------
    Correspondences

    Raises
    ------
    MethodError
        If the code is reduced and there is no volume.
    """
    first, *more = [resolve_orders(phases, camera, projector, volume) for phases in maps]
    if not more:
        return _on_curve(first, camera, projector)
    return _from_two_directions(first, more[0], camera, projector)


def resolve_orders(
    phases: PhaseMap, camera: Device, projector: Device, volume: MeasuringVolume | None, /
) -> PhaseMap:
    """Single out the fringe order by the pixel's segment in the projector.

    A candidate is an order of the observed class whose absolute phase lies on the image, in the
    projector, of the viewing ray inside the volume: ``K(p) = {k : Phi(near) - eps <= phi + 2 pi k
    <= Phi(far) + eps}``. A map that is absolute already is returned as it is.
    Where no order fits, the surface lies outside the volume.
    """
    if phases.is_absolute:
        return phases
    if volume is None:
        n_classes = len(np.unique(phases.class_of_order))
        raise MethodError(
            f"camera '{camera.name}': the code tells {n_classes} of {len(phases.class_of_order)} "
            "periods apart. Give the depth range of the object (--depth MIN:MAX) or keep more bits"
        )
    valid = phases.rejection == 0
    lowest, highest = _order_range(phases, valid, camera, projector, volume)
    count, chosen = _candidates(phases, valid, lowest, highest)
    rejection = np.zeros(valid.shape, np.uint16)
    found = np.zeros(valid.shape, np.int32)
    found[valid] = count
    reject(rejection, valid & (found == 0), Rejection.OUTSIDE_VOLUME)
    reject(rejection, found > 1, Rejection.AMBIGUOUS)
    order_map = np.full(valid.shape, NO_ORDER, np.int32)
    order_map[valid] = chosen
    all_orders = np.arange(len(phases.class_of_order), dtype=np.int32) + phases.first_order
    resolved = replace(phases, order_class=order_map, class_of_order=all_orders)
    return resolved.rejecting(rejection)


def twin_share(
    phases: PhaseMap, camera: Device, projector: Device, volume: MeasuringVolume, /
) -> float:
    """Return how many pixels have their only order in the volume, but another one close to it.

    Close is within `OUTSIDE_PART` of the segment's length on both sides. Where a table or a wall
    stands there, it is taken for a part of the volume.

    Returns
    -------
    float, 0 to 1, of the pixels with exactly one order in the volume; 0 for a full code
    """
    valid = phases.rejection == 0
    if phases.is_absolute or not valid.any():
        return 0.0
    lowest, highest = _order_range(phases, valid, camera, projector, volume)
    more = OUTSIDE_PART * (highest - lowest)
    inside, _ = _candidates(phases, valid, lowest, highest)
    around, _ = _candidates(phases, valid, lowest - more, highest + more)
    return float((around > 1)[inside == 1].mean()) if (inside == 1).any() else 0.0


def _candidates(
    phases: PhaseMap,
    valid: NDArray[np.bool_],
    lowest: NDArray[np.float64],
    highest: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the number of orders of the class between two phases (turns), and the last of them."""
    turns = phases.phase[valid] / TWO_PI
    guard = guard_px(phases)[valid] / phases.period_px
    wanted = phases.order_class[valid]
    count = np.zeros(len(turns), np.int32)
    chosen = np.full(len(turns), NO_ORDER, np.int32)
    for offset, name in enumerate(phases.class_of_order):
        order = phases.first_order + offset
        fits = wanted == name
        fits &= (turns + order >= lowest - guard) & (turns + order <= highest + guard)
        count += fits
        chosen[fits] = order
    return count, chosen


def guard_px(phases: PhaseMap, /) -> NDArray[np.float64]:
    """Return how far noise and calibration may shift a phase in the projector, (row, col), px."""
    sigma_px = phases.phase_std.astype(np.float64) * (phases.period_px / TWO_PI)
    return GUARD_SIGMA * sigma_px + GUARD_PX


def _order_range(
    phases: PhaseMap,
    valid: NDArray[np.bool_],
    camera: Device,
    projector: Device,
    volume: MeasuringVolume,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the absolute phase, in turns, at the two ends of each valid pixel's segment."""
    pixels = pixel_grid(phases.phase.shape)[valid]
    origin, directions = rays(camera, pixels)
    near, far = epipolar_segment(camera, projector, pixels, volume)
    ends = []
    for depth in (near, far):
        finite = np.where(near < far, np.clip(depth, 1e-3, 1e9), np.nan)
        seen = project(projector, origin + finite[:, None] * directions)
        ends.append(_across(seen, phases.angle) / phases.period_px)
    return np.fmin(*ends), np.fmax(*ends)


def _across(pixels: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    return across(angle, pixels[..., 0], pixels[..., 1])


def _on_curve(phases: PhaseMap, camera: Device, projector: Device) -> Correspondences:
    valid = phases.rejection == 0
    origin, directions = rays(camera, pixel_grid(valid.shape)[valid])
    position = phases.position_px[valid]
    depth = sheet_crossing(projector, origin, directions, position, phases.angle)
    met = np.isfinite(depth)
    points = origin + np.where(met, depth, 1.0)[:, None] * directions
    pixels = project(projector, points)
    moved = project(projector, points + (DEPTH_STEP * depth)[:, None] * directions)
    travel = moved - pixels
    slope = (_across(moved, phases.angle) - _across(pixels, phases.angle)) / np.linalg.norm(
        travel, axis=1
    )
    sigma_w = phases.point_std[valid] * phases.period_px / TWO_PI
    rejection = phases.rejection.copy()
    behind = valid.copy()
    behind[valid] = ~met
    reject(rejection, behind, Rejection.BEHIND_DEVICE)
    outside = valid.copy()
    outside[valid] = met & ~_inside(pixels, projector)
    reject(rejection, outside, Rejection.OUTSIDE_PROJECTOR)
    return _compose(
        projector.name,
        pixel_grid(valid.shape),
        valid,
        pixels,
        sigma_w / np.abs(slope),
        np.full(len(pixels), np.nan),
        phases.order_class,
        rejection,
    )


def _from_two_directions(
    a: PhaseMap, b: PhaseMap, camera: Device, projector: Device
) -> Correspondences:
    axes = np.array([[np.cos(m.angle), np.sin(m.angle)] for m in (a, b)])
    if abs(np.linalg.det(axes)) < 0.1:
        raise MethodError(
            "plan: the two fringe directions are less than 6 degrees apart; they do not fix a "
            "projector point. Measure with one of them"
        )
    rejection = a.rejection | b.rejection
    valid = rejection == 0
    pixels_c1, n_shared = _middle_of_cells(a, b, valid)
    w = np.stack([m.position_px[valid] for m in (a, b)], axis=-1)
    pixels = w @ np.linalg.inv(axes).T - 0.5
    sigma_w = np.stack([m.point_std[valid] * m.period_px / TWO_PI for m in (a, b)], axis=-1)
    sigma_w /= np.sqrt(n_shared)[:, None]

    origin, directions = rays(camera, pixels_c1[valid])
    base, tangent = epipolar_line_at(projector, origin, directions, pixels)
    away = pixels - base
    residual = tangent[:, 0] * away[:, 1] - tangent[:, 1] * away[:, 0]
    # The point is not weighted: both coordinates move it along the curve as they move the pixel.
    sigma = np.sqrt((((tangent @ np.linalg.inv(axes)) * sigma_w) ** 2).sum(axis=-1))
    outside = valid.copy()
    outside[valid] = np.logical_not(_inside(pixels, projector))
    reject(rejection, outside, Rejection.OUTSIDE_PROJECTOR)
    return _compose(
        projector.name, pixels_c1, valid, pixels, sigma, residual, a.order_class, rejection
    )


def _middle_of_cells(
    a: PhaseMap, b: PhaseMap, valid: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where C1 sees the coordinates, (row, col, 2), and how many pixels see the same.

    With fringes every pixel has its own coordinates. Without, all pixels in one code cell of
    both directions see one projector pixel, and their middle is its place.
    """
    grid = pixel_grid(valid.shape)
    if not (a.is_quantised and b.is_quantised):
        return grid, np.ones(int(valid.sum()))
    column, row = (m.order_class[valid].astype(np.int64) for m in (a, b))
    if not len(column):
        return grid, np.ones(0)
    column -= column.min()  # orders may be negative
    _, cell = np.unique(row * (column.max() + 1) + column, return_inverse=True)
    places = grid[valid]
    count = np.bincount(cell)
    middle = [np.bincount(cell, places[:, axis]) / count for axis in (0, 1)]
    grid[valid] = np.stack(middle, axis=-1)[cell]
    return grid, count[cell].astype(np.float64)


def epipolar_line_at(
    projector: Device,
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    pixels: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the point of each epipolar curve closest to a pixel, and the unit tangent there."""
    from_projector, toward = rays(projector, pixels)
    depth, _ = closest_depths(origin, directions, from_projector, toward)
    for _ in range(2):
        base = project(projector, origin + depth[:, None] * directions)
        step = DEPTH_STEP * depth
        moved = project(projector, origin + (depth + step)[:, None] * directions)
        speed = (moved - base) / step[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            depth = depth + ((pixels - base) * speed).sum(-1) / (speed**2).sum(-1)
    tangent = speed / np.linalg.norm(speed, axis=-1, keepdims=True)
    return base, tangent


def _inside(pixels: NDArray[np.float64], device: Device) -> NDArray[np.bool_]:
    """Tell which pixels lie in the image, give or take one pixel of calibration error."""
    limit = np.array([device.n_cols, device.n_rows]) + 0.5
    return np.asarray(((pixels > -1.5) & (pixels < limit)).all(axis=-1))


def _compose(
    name: str,
    pixels_c1: NDArray[np.float64],
    valid: NDArray[np.bool_],
    pixels: NDArray[np.float64],
    sigma: NDArray[np.float64],
    residual: NDArray[np.float64],
    order: NDArray[np.int32],
    rejection: NDArray[np.uint16],
) -> Correspondences:
    grid = np.full((*valid.shape, 2), np.nan)
    sigma_map = np.full(valid.shape, np.nan, np.float32)
    residual_map = np.full(valid.shape, np.nan, np.float32)
    grid[valid], sigma_map[valid], residual_map[valid] = pixels, sigma, residual
    bad = rejection != 0
    grid[bad] = np.nan
    sigma_map[bad] = residual_map[bad] = np.nan
    return Correspondences(
        device_name=name,
        pixels_c1=pixels_c1,
        pixels=grid,
        sigma_px=sigma_map,
        epipolar_residual_px=residual_map,
        fringe_order=np.where(bad, NO_ORDER, order),
        rejection=rejection,
    )
