"""Which corner is which: orders that detection left mirrored or turned, and how devices stand."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fringe3d.calibrate._board_start import Alone, distances, typical_transform
from fringe3d.calibrate._homography import homography, orientation
from fringe3d.calibrate.board_view import BoardView
from fringe3d.errors import CalibrationError
from fringe3d.model import Board, RigidTransform

Views = tuple[BoardView, ...]

SAME_PLACE = 1e-3
"""Part of the distance: two cameras nearer than that are one."""

LARGEST_DISAGREEMENT = 0.1
"""rad, plus part of the distance: devices that agree less do not see one board. Poses of a device
by itself are good to a hundredth, with few corners to a few."""


def _mirrored(board: Board) -> NDArray[np.int64]:
    row, col = np.divmod(np.arange(board.n_points), board.n_cols)
    return np.asarray(row * board.n_cols + board.n_cols - 1 - col)


def _signs(board: Board, views: Views) -> list[float]:
    points = board.points_mm[:, :2]
    return [
        orientation(homography(points[v.ids], v.pixels), points[v.ids].mean(axis=0)) for v in views
    ]


def unmirrored(
    board: Board, views: Views, roles: dict[str, str], /
) -> tuple[Views, tuple[str, ...]]:
    """Return the views with mirrored orders of corners put right; and what was left out, and why.

    A projector that sees the board mirrored where its camera does not is left out there.

    Raises
    ------
    CalibrationError
        If a device sees the board mirrored in most poses: that is not the order of the corners.
    """
    signs = _signs(board, views)
    by_device: dict[str, list[float]] = defaultdict(list)
    for view, sign in zip(views, signs, strict=True):
        by_device[view.device].append(sign)
    for device, found in by_device.items():
        n_mirrored = int((np.array(found) < 0).sum())
        if 2 * n_mirrored > len(found):
            raise CalibrationError(_why_mirrored(device, roles[device], n_mirrored, len(found)))
    wrong = {(v.pose, v.device) for v, g in zip(views, signs, strict=True) if g < 0 and not v.via}
    order = _mirrored(board)
    kept: list[BoardView] = []
    refused: dict[tuple[str, str], list[str]] = defaultdict(list)
    for view, sign in zip(views, signs, strict=True):
        is_turned = (view.pose, view.via or view.device) in wrong
        if view.via and (sign < 0) != is_turned:
            refused[view.pose, view.device].append(view.via)
        else:
            kept.append(view.renumbered(order) if is_turned else view)
    return tuple(kept), tuple(_why_refused(*where, via) for where, via in refused.items())


def _why_refused(pose: str, device: str, cameras: list[str]) -> str:
    return (
        f"{pose}: '{device}' sees the board mirrored, {' and '.join(cameras)} not: in this "
        "recording rows and columns of the patterns are exchanged, one direction counts from the "
        "other side, or the cameras' images are mirrored"
    )


def _why_mirrored(device: str, role: str, n_mirrored: int, n_views: int) -> str:
    where = f"{role} '{device}': sees the board mirrored in {n_mirrored} of {n_views} poses"
    if role == "projector":
        return (
            f"{where}. Rows and columns of its patterns are exchanged, or one direction counts "
            "from the other side: correct 'direction', 'bright_is' or the order of the images in "
            "the description of the scans"
        )
    return f"{where}. Its images are mirrored: record them as the camera sees, or turn them back"


def upright(board: Board, views: Views, /) -> Views:
    """Return the views of a board that looks the same turned by half with x to the right.

    Which way such a board is turned cannot be seen. All cameras of one rig see it alike, unless
    one of them stands on its head.
    """
    order = board.half_turned
    if order is None:
        return views
    points = board.points_mm
    turned = set()
    for view in views:
        if not view.via:
            x = points[view.ids, 0] - points[view.ids, 0].mean()
            if x @ view.pixels[:, 0] < 0:
                turned.add((view.pose, view.device))
    return _turned(views, turned, order)


def _turned(views: Views, which: set[tuple[str, str]], order: NDArray[np.int64]) -> Views:
    return tuple(v.renumbered(order) if (v.pose, v.via or v.device) in which else v for v in views)


def half_turn(board: Board, /) -> RigidTransform:
    """Return the motion that brings a board that looks the same turned by half to itself."""
    last = board.points_mm[-1]
    return RigidTransform(rotation=np.diag([-1.0, -1.0, 1.0]), translation=[last[0], last[1], 0.0])


def together(
    board: Board, views: Views, alone: dict[str, Alone], roles: dict[str, str], /
) -> tuple[Views, dict[str, RigidTransform], dict[str, RigidTransform]]:
    """Return the views with matching orders, device_from_first, and first_from_board by pose.

    Raises
    ------
    CalibrationError
        If devices share no pose, do not see one board, or are one and the same.
    """
    first = next(iter(alone))
    seen = {name: dict(found.device_from_board) for name, found in alone.items()}
    placed = {first: RigidTransform.identity()}
    poses = _poses_by_camera(seen[first])
    while len(placed) < len(alone):
        # Cameras first: a projector was seen through them, in their order of corners.
        name = max(
            (n for n in alone if n not in placed),
            key=lambda n: (roles[n] == "camera", _n_shared(seen[n], poses)),
        )
        _require_shared(name, roles[name], _n_shared(seen[name], poses), list(placed))
        who = f"{roles[name]} '{name}'"
        relative, turned = _relative(board, seen[name], poses, who=who)
        views = _turned(views, {(pose, name) for pose in turned}, np.arange(board.n_points)[::-1])
        for device in seen:
            for pose, via in list(seen[device]):
                if pose in turned and (via or device) == name:
                    seen[device][pose, via] = seen[device][pose, via] @ half_turn(board)
        _require_apart(name, first, relative, poses, roles)
        placed[name] = relative
        for pose, first_from_board in _poses_by_camera(seen[name]).items():
            poses.setdefault(pose, relative.inverse() @ first_from_board)
    return views, placed, poses


def _poses_by_camera(seen: dict[tuple[str, str], RigidTransform]) -> dict[str, RigidTransform]:
    found: dict[str, RigidTransform] = {}
    for (pose, _), transform in seen.items():
        found.setdefault(pose, transform)
    return found


def _n_shared(seen: dict[tuple[str, str], RigidTransform], poses: dict[str, RigidTransform]) -> int:
    return len({pose for pose, _ in seen} & set(poses))


def _relative(
    board: Board,
    seen: dict[tuple[str, str], RigidTransform],
    poses: dict[str, RigidTransform],
    *,
    who: str,
) -> tuple[RigidTransform, set[str]]:
    """Return device_from_first, and the poses in which the board must be turned by half."""
    shared = [key for key in seen if key[0] in poses]
    reach = float(np.median([np.linalg.norm(pose.translation) for pose in poses.values()]))
    plain = [seen[key] @ poses[key[0]].inverse() for key in shared]
    # What a camera found through the projector is turned with that camera's own view.
    may_turn = board.half_turned is not None and not any(via for _, via in shared)
    if may_turn:
        turn = half_turn(board)
        other = [seen[key] @ turn @ poses[key[0]].inverse() for key in shared]
        candidates = plain + other
        near, far = (distances(found, candidates, reach) for found in (plain, other))
        best = int(np.argmin(np.minimum(np.minimum(near, far), 1.0).sum(axis=0)))
        is_turned = far[:, best] < near[:, best]
        chosen = [o if t else p for p, o, t in zip(plain, other, is_turned, strict=True)]
    else:
        is_turned, chosen = np.zeros(len(shared), bool), plain
    relative = typical_transform(chosen, reach)
    apart = float(np.median(distances(chosen, [relative], reach)))
    if apart > LARGEST_DISAGREEMENT:
        raise CalibrationError(
            f"{who}: expected it to stand alike to the other devices in all poses, found it to "
            f"differ by {apart:.2f} (turn in rad plus shift over its distance; poses "
            f"{_name_of(shared)}). Are its images mirrored or turned, of another camera or of "
            "other poses than the names say, or is the size of --board another one?"
        )
    return relative, {key[0] for key, t in zip(shared, is_turned, strict=True) if t}


def _name_of(shared: Sequence[tuple[str, str]]) -> str:
    poses = list(dict.fromkeys(pose for pose, _ in shared))
    return ", ".join(poses[:3]) + (" ..." if len(poses) > 3 else "")


def _require_shared(name: str, role: str, n_shared: int, placed: list[str]) -> None:
    if not n_shared:
        raise CalibrationError(
            f"{role} '{name}': expected poses in which it and {' or '.join(placed)} see the board, "
            "found none. Record poses that both see: they tell how the devices stand"
        )


def _require_apart(
    name: str,
    first: str,
    relative: RigidTransform,
    poses: dict[str, RigidTransform],
    roles: dict[str, str],
) -> None:
    distance = float(np.median([np.linalg.norm(pose.translation) for pose in poses.values()]))
    if roles[name] != "camera" or np.linalg.norm(relative.translation) > SAME_PLACE * distance:
        return
    raise CalibrationError(
        f"camera '{name}': expected another place than that of '{first}', found the same. Are the "
        "images of one camera used twice?"
    )
