"""The small 3D view of what was written: merged bodies, deviations, rigs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import Fringe3DError
from fringe3d.geometry import frustum_lines, volume_lines
from fringe3d.io.clouds import CloudFile, read_cloud
from fringe3d.io.rigfile import read_rig
from fringe3d.model import Rig
from fringe3d.report.cloud_data import (
    Channel,
    packed_kinds,
    packed_points,
    packed_values,
    thinned,
)

Floats = NDArray[np.float64]

MOST_POINTS = 150_000
DOTS = 40_000
"""As many draw the lines of a rig."""

CLOUDS = ("deviations.ply", "cloud.ply")
FRUSTUM_PART = 0.4
"""Of the distance to the measured things: devices are drawn with that much of their pyramids."""

FROM_THE_SIDE = np.array([0.35, 0.75, -0.55])
"""Direction of view onto bodies that were seen from all sides, and onto rigs."""

CAMERA, VOLUME, PROJECTOR = range(3)


def cloud_beside(report: Path, /) -> dict[str, Any] | None:
    """Return what the 3D view of a written report shows, ready for JSON; None for nothing.

    Parameters
    ----------
    report : Path; of a merge, comparison or acceptance test, with its cloud beside; of a design or
        calibration, with the rig beside
    """
    stem = report.stem.rpartition("-")[0] if report.stem != "design" else "rig"
    rig = report.with_name(f"{stem}.toml")
    try:
        for name in CLOUDS:
            if (report.parent / name).is_file():
                return packed_file(read_cloud(report.parent / name))
        return packed_rig(read_rig(rig)) if stem and rig.is_file() else None
    except Fringe3DError:  # a page without the view is better than none
        return None


def packed_file(cloud: CloudFile, /) -> dict[str, Any]:
    """Return the points of a file, coloured by what it knows of them."""
    places = thinned(np.ones(len(cloud.points_mm), bool), MOST_POINTS)
    points = cloud.points_mm[places]
    channels = [Channel("depth z", "mm", points[:, 2], "turbo_r")]
    if cloud.sigma_mm is not None:
        channels.append(Channel("sigma", "um", 1000 * cloud.sigma_mm[places], "viridis"))
    if cloud.deviation_mm is not None:
        deviation = 1000 * cloud.deviation_mm[places]
        channels.insert(0, Channel("deviation", "um", deviation, "RdBu_r", is_signed=True))
    ahead, up = FROM_THE_SIDE, np.array([0.0, 0.0, 1.0])
    if cloud.viewpoint_mm is not None:
        ahead, up = points.mean(axis=0) - cloud.viewpoint_mm, np.array([0.0, 1.0, 0.0])
    return packed_points(points, [packed_values(channel) for channel in channels],
                         eye(ahead, up), of=len(cloud.points_mm))  # fmt: skip


def packed_rig(rig: Rig, /) -> dict[str, Any]:
    """Return devices and measuring volume as dots along their lines."""
    edges = np.empty((0, 2, 3)) if rig.volume is None else volume_lines(rig.volume)
    centers = np.array([device.center_world for device in rig.devices])
    axes = np.array([device.device_from_world.rotation[2] for device in rig.devices])
    far = float(np.linalg.norm(np.ptp(centers, axis=0))) or 1.0
    middle = edges.mean(axis=(0, 1)) if len(edges) else (centers + 2 * far * axes).mean(axis=0)
    lines, kinds = [edges], [np.full(len(edges), VOLUME)]
    for device, center in zip(rig.devices, centers, strict=True):
        length = FRUSTUM_PART * float(np.linalg.norm(middle - center))
        lines.append(frustum_lines(device, length))
        kind = PROJECTOR if device.role == "projector" else CAMERA
        kinds.append(np.full(len(lines[-1]), kind))
    points, of_line = dotted(np.concatenate(lines))
    order = thinned(np.ones(len(points), bool), len(points))
    channel = packed_kinds("device", np.concatenate(kinds)[of_line][order], ("camera", "projector"))
    rotation = rig.cameras[0].device_from_world.rotation
    ahead = 0.8 * rotation[0] + 0.5 * rotation[1] + 0.5 * rotation[2]
    return packed_points(points[order], [channel], eye(ahead, -rotation[1]), of=len(points))


def dotted(lines_mm: Floats, /) -> tuple[Floats, NDArray[np.int64]]:
    """Return evenly spaced dots (n, 3) on lines (m, 2, 3), and the line of each, (n,).

    Examples
    --------
    >>> dots, of_line = dotted(np.array([[[0.0, 0, 0], [3, 0, 0]], [[0, 0, 0], [0, 1, 0]]]))
    >>> np.bincount(of_line).tolist()
    [30001, 10001]
    """
    lengths = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    counts = np.round(DOTS * lengths / lengths.sum()).astype(int) + 1
    of_line = np.repeat(np.arange(len(lines_mm)), counts)
    along = np.concatenate([np.linspace(0, 1, count) for count in counts])[:, None]
    begin, end = lines_mm[of_line, 0], lines_mm[of_line, 1]
    return begin + along * (end - begin), of_line


def eye(ahead: Floats, up: Floats, /) -> Floats:
    """Return the axes of an eye as rows: right, down, ahead.

    Examples
    --------
    >>> (eye(np.array([0, 0, -2.0]), np.array([0, 1.0, 0])) + 0.0).tolist()
    [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    """
    z = ahead / np.linalg.norm(ahead)
    x = np.cross(z, up)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([x, np.cross(z, x), z])
