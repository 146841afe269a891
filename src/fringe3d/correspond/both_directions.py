"""Two cameras and two fringe directions: the point of equal phases, no epipolar geometry (M0)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fringe3d.correspond._phase import MAX_JUMP
from fringe3d.correspond.noise import variance_between
from fringe3d.correspond.projector import epipolar_line_at
from fringe3d.geometry import pixel_grid, rays
from fringe3d.model import NO_ORDER, Correspondences, Device, PhaseMap, Rejection
from fringe3d.model.rejection import reject

NEWTON_STEPS = 8
EDGE = 0.02
"""Part of a pixel by which a point may lie beyond the four neighbours that enclose it."""

REACH_PX = 8.0
"""Projector px; a nearest neighbour farther away is another surface."""


@njit(cache=True, error_model="numpy")
def _inside(u, v, row, col, u2, v2, jumps):  # type: ignore[no-untyped-def]
    """Return the place (x, y) of (u, v) among four neighbours, and the gradients there.

    Neighbours whose u or v differ by more than `jumps` lie on several surfaces and enclose nothing.
    """
    ua, ub, uc, ud = u2[row, col], u2[row, col + 1], u2[row + 1, col], u2[row + 1, col + 1]
    va, vb, vc, vd = v2[row, col], v2[row, col + 1], v2[row + 1, col], v2[row + 1, col + 1]
    if not (
        max(ua, ub, uc, ud) - min(ua, ub, uc, ud) <= jumps[0]
        and max(va, vb, vc, vd) - min(va, vb, vc, vd) <= jumps[1]
    ):
        return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan
    x, y = 0.5, 0.5
    ux, uy, vx, vy = np.nan, np.nan, np.nan, np.nan
    for _ in range(NEWTON_STEPS):
        ux, uy = (ub - ua) * (1 - y) + (ud - uc) * y, (uc - ua) * (1 - x) + (ud - ub) * x
        vx, vy = (vb - va) * (1 - y) + (vd - vc) * y, (vc - va) * (1 - x) + (vd - vb) * x
        du = u - ((ua * (1 - x) + ub * x) * (1 - y) + (uc * (1 - x) + ud * x) * y)
        dv = v - ((va * (1 - x) + vb * x) * (1 - y) + (vc * (1 - x) + vd * x) * y)
        det = ux * vy - uy * vx
        x, y = x + (vy * du - uy * dv) / det, y + (ux * dv - vx * du) / det
    if -EDGE <= x <= 1 + EDGE and -EDGE <= y <= 1 + EDGE:
        return col + x, row + y, ux, uy, vx, vy
    return np.nan, np.nan, ux, uy, vx, vy


@njit(cache=True, parallel=True, error_model="numpy")
def _place(u1, v1, rows, cols, u2, v2, jumps, found):  # type: ignore[no-untyped-def]
    """Write x, y and the gradients of u and v for each point; NaN where nothing encloses it."""
    n_rows, n_cols = u2.shape
    for i in prange(len(u1)):
        found[i, :] = np.nan
        for down in range(-1, 1):
            for right in range(-1, 1):
                row, col = rows[i] + down, cols[i] + right
                if not (0 <= row < n_rows - 1 and 0 <= col < n_cols - 1):
                    continue
                x, y, ux, uy, vx, vy = _inside(u1[i], v1[i], row, col, u2, v2, jumps)
                if not math.isnan(x):
                    found[i, 0], found[i, 1] = x, y
                    found[i, 2], found[i, 3], found[i, 4], found[i, 5] = ux, uy, vx, vy


def match_both_directions(
    phases1: tuple[PhaseMap, PhaseMap],
    phases2: tuple[PhaseMap, PhaseMap],
    camera1: Device,
    camera2: Device,
    /,
) -> Correspondences:
    """Find in C2 the point with both absolute phases of each pixel of C1 (method M0).

    The epipolar geometry is not used: the distance of the point from the epipolar curve is an
    independent check of the calibration.

    Parameters
    ----------
    phases1, phases2 : two PhaseMap each, absolute, of two fringe angles
    camera1, camera2 : Device

    Returns
    -------
    Correspondences
        NO_MATCH where no four neighbouring pixels of C2 enclose the phases.

    Notes
    -----
    Bilinear interpolation of both phases between four pixels of C2, inverted by Newton's method.
    """
    first, other = phases1
    rejection = first.rejection | other.rejection
    valid = rejection == 0
    wanted = np.column_stack([m.position_px[valid] for m in phases1])
    u2, v2 = (m.position_px for m in phases2)
    found = np.full((len(wanted), 6), np.nan)
    seen = np.argwhere(np.isfinite(u2 + v2))
    if len(seen) and len(wanted):
        tree = cKDTree(np.column_stack([u2[seen[:, 0], seen[:, 1]], v2[seen[:, 0], seen[:, 1]]]))
        away, nearest = tree.query(wanted, distance_upper_bound=REACH_PX, workers=-1)
        near = np.isfinite(away)
        rows, cols = seen[np.where(near, nearest, 0)].T
        jumps = np.array([m.period_px for m in phases2]) * (MAX_JUMP / (2 * np.pi))
        _place(wanted[:, 0], wanted[:, 1], rows, cols, u2, v2, jumps, found)
        found[~near] = np.nan
    missed = valid.copy()
    missed[valid] = np.isnan(found[:, 0])
    reject(rejection, missed, Rejection.NO_MATCH)
    return _compose(phases1, phases2, camera1, camera2, valid, found, rejection)


def _compose(
    phases1: tuple[PhaseMap, PhaseMap],
    phases2: tuple[PhaseMap, PhaseMap],
    camera1: Device,
    camera2: Device,
    valid: NDArray[np.bool_],
    found: NDArray[np.float64],
    rejection: NDArray[np.uint16],
) -> Correspondences:
    good = rejection == 0
    x, y, ux, uy, vx, vy = found[good[valid]].T
    pixels, grid = np.column_stack([x, y]), pixel_grid(valid.shape)
    origin, directions = rays(camera1, grid[good])
    base, tangent = epipolar_line_at(camera2, origin, directions, pixels)
    away = pixels - base
    # Noise of u and v moves the point by the inverse of their gradients; along the curve counts.
    along_u = (vy * tangent[:, 0] - vx * tangent[:, 1]) / (ux * vy - uy * vx)
    along_v = (ux * tangent[:, 1] - uy * tangent[:, 0]) / (ux * vy - uy * vx)
    variance = np.zeros(len(x))
    for one, two, weight in zip(phases1, phases2, (along_u, along_v), strict=True):
        to_px = one.period_px / (2 * np.pi)
        noise = one.point_std[good] ** 2 + variance_between(two, pixels)
        variance += (weight * to_px) ** 2 * noise
    maps = {
        "pixels": np.full((*valid.shape, 2), np.nan),
        "sigma_px": np.full(valid.shape, np.nan, np.float32),
        "epipolar_residual_px": np.full(valid.shape, np.nan, np.float32),
    }
    maps["pixels"][good] = pixels
    maps["sigma_px"][good] = np.sqrt(variance)
    maps["epipolar_residual_px"][good] = tangent[:, 0] * away[:, 1] - tangent[:, 1] * away[:, 0]
    return Correspondences(
        device_name=camera2.name,
        pixels_c1=grid,
        fringe_order=np.where(good, phases1[0].order_class, NO_ORDER),
        rejection=rejection,
        **maps,
    )
