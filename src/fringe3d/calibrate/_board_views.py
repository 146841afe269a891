"""Which views of a board can be used; what is lacking is said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._homography import homography
from fringe3d.calibrate.board_view import BoardView
from fringe3d.errors import CalibrationError
from fringe3d.model import Board

if TYPE_CHECKING:
    from fringe3d.calibrate.board import DeviceSize

Floats = NDArray[np.float64]

MIN_CORNERS = 8
"""Four fix a homography; as many again judge it."""

MIN_SPREAD = 0.08
"""Smallest over largest extent of the corners: less is a line."""

MIN_POSES = 3
"""Zhang's equations need three, or two with a known principal point."""

MIN_TILT = np.radians(4.0)
"""Between the planes of two poses at least; focal lengths follow from the tilt."""


def checked(
    board: Board, views: Sequence[BoardView], devices: Sequence[DeviceSize], /
) -> tuple[tuple[BoardView, ...], tuple[str, ...]]:
    """Return the views that can be used, and in words those that cannot.

    Raises
    ------
    CalibrationError
        If a device has too few of them, or its poses are all parallel.
    """
    names = {device.name for device in devices}
    kept, left_out = [], []
    for view in views:
        if view.device not in names:
            raise ValueError(f"board view: expected one of {sorted(names)}, found '{view.device}'")
        if len(view) and view.ids.max() >= board.n_points:
            raise ValueError(f"board view: corner {view.ids.max()} is not on {board.text}")
        why = _why_useless(board, view)
        if why:
            through = f" through {view.via}" if view.via else ""
            left_out.append(f"{view.pose}: {view.device}{through}: {why}")
        else:
            kept.append(view)
    for device in devices:
        own = [v for v in kept if v.device == device.name]
        _require_poses(board, device, own, [t for t in left_out if f": {device.name}" in t])
    return tuple(kept), tuple(left_out)


def _why_useless(board: Board, view: BoardView) -> str:
    if len(view) < MIN_CORNERS:
        return f"{len(view)} corners, expected at least {MIN_CORNERS}"
    for places in (board.points_mm[view.ids, :2], view.pixels):
        extent = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if extent[1] < MIN_SPREAD * extent[0]:
            return "all corners lie on a line"
    return ""


def _require_poses(
    board: Board, device: DeviceSize, views: list[BoardView], left_out: list[str]
) -> None:
    where = f"{device.role} '{device.name}'"
    n_poses = len({view.pose for view in views})
    wanted = 1 if device.known is not None else MIN_POSES
    if n_poses < wanted:
        why = f" ({'; '.join(left_out[:3])})" if left_out else ""
        raise CalibrationError(
            f"{where}: expected the board in at least {wanted} poses, found it in {n_poses}{why}. "
            "Record more poses, nearer, sharper or better lit; check the size of the board"
        )
    if device.known is None and _largest_change(board, device, views) < MIN_TILT:
        raise CalibrationError(
            f"{where}: expected the board tilted differently, found all {n_poses} poses parallel "
            f"(within {np.degrees(MIN_TILT):.0f} deg): they do not tell the focal length. Tilt the "
            "board by 20 to 40 deg, each time to another side"
        )


def _largest_change(board: Board, device: DeviceSize, views: list[BoardView]) -> float:
    """Return about the largest angle, rad, between two planes, as perspective shows it.

    The line that a plane's points at infinity are seen on depends on its normal alone.
    """
    size = np.array([device.shape[1], device.shape[0]], np.float64)
    to_unit = np.array([[1, 0, -size[0] / 2], [0, 1, -size[1] / 2], [0, 0, size.max()]])
    normals = []
    for view in views:
        plane = to_unit @ homography(board.points_mm[view.ids, :2], view.pixels)
        normal = np.cross(plane[:, 0], plane[:, 1])
        normals.append(normal / np.linalg.norm(normal))
    cosines = np.clip(np.abs(np.array(normals) @ np.array(normals).T), 0, 1)
    return float(np.arccos(cosines.min()))
