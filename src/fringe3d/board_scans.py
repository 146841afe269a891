"""From scans of a board to what each device sees of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate import BoardView, light_on_corners
from fringe3d.decode import decode
from fringe3d.errors import PlanError
from fringe3d.model import Board, ImageStack, Scan

Found = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Numbers of corners (n,), and their pixels (n, 2)."""

CORNER_SIGMA_PX = 0.1
"""Of a detected corner; only ratios within a device matter."""


def board_image(stack: ImageStack, /) -> NDArray[Any]:
    """Return an image of the board as in even light, (row, col).

    The light image; else the mean of the fringes of one period; else the brightest of all.
    """
    light = stack.plan.uniform_index(1.0)
    if light >= 0:
        return np.asarray(stack.images[light])
    if stack.plan.fringe_sets:
        images = stack.images[list(stack.plan.fringe_sets[0].indices)]
        return np.asarray(np.round(images.mean(axis=0)), images.dtype)
    return np.asarray(stack.images.max(axis=0))


def views_of_scan(
    scan: Scan,
    board: Board,
    corners: Mapping[str, Found],
    /,
    *,
    pose: str,
    projector: str | None,
) -> list[BoardView]:
    """Return what the cameras, and the projector through them, see of a board.

    Parameters
    ----------
    scan : Scan
    board : Board
    corners : mapping of str to (ids, pixels); in the images of each camera
    pose : str; name of the pose
    projector : str or None; name of the projector; None leaves it out

    Raises
    ------
    PlanError
        If the projector's size is not known.
    Fringe3DError
        If the projector cannot be decoded.
    """
    views = []
    for stack in scan.stacks:
        ids, pixels = corners[stack.device_name]
        views.append(
            BoardView(
                device=stack.device_name,
                pose=pose,
                ids=ids,
                pixels=pixels,
                sigma_px=CORNER_SIGMA_PX,
            )
        )
        if projector is None or not len(ids):
            continue
        if stack.plan.projector_shape is None:
            raise PlanError(
                f"{pose}: expected the size of the projector, found none. Add 'projector_size = "
                "[width, height]' to the scan file"
            )
        phases = [d.main for d in decode(stack, whole_cells=True).directions]
        light, sigma = light_on_corners(board, ids, pixels, phases)
        is_lit = np.isfinite(sigma)
        views.append(
            BoardView(
                device=projector,
                pose=pose,
                ids=ids[is_lit],
                pixels=light[is_lit],
                sigma_px=sigma[is_lit],
                via=stack.device_name,
            )
        )
    return views
