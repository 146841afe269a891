"""What viewing rays are to light sheets and to C2: it depends on the rig alone."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _curves
from fringe3d.geometry import grid_intervals, grid_rays, projection
from fringe3d.geometry.projection import lens_of
from fringe3d.kernels import POINTS, over_rows
from fringe3d.model import Device, MeasuringVolume

OUTSIDE_PART = 0.4
"""Part of the segment on each side of the volume where surfaces are expected, as the table."""

CURVES_KEPT = 4
"""Pairs of cameras whose curves are kept between measurements, 80 bytes a pixel."""

Arrays = dict[str, NDArray[Any]]
Keeper = Callable[[Iterable[str | bytes | NDArray[Any]], Callable[[], Arrays]], Arrays]
"""Returns the arrays that follow from some inputs: those it has kept, or those that are made."""

SOURCES = tuple(Path(module.__file__ or "") for module in (_curves, projection))
"""Other code, other curves."""

ROWS_AT_ONCE = 64


@dataclass(frozen=True, slots=True, eq=False)
class RayCurves:
    """Curves of all pixels of C1, for one direction of fringes.

    Parameters
    ----------
    ends : (row, col, 2) float32, mm; where the rays enter and leave the volume; not rising where
        they miss it
    depths_mm : (row, col, 2) float; in which surfaces are expected
    curves : (row, `_curves.N_CURVE`, col) float32; see `_curves`
    wide, inner : (row, col, 2) float32, projector px; least and largest w in which surfaces are
        expected, and inside the volume; NaN where there is none
    """

    ends: NDArray[np.float32]
    depths_mm: NDArray[np.float64]
    curves: NDArray[np.float32]
    wide: NDArray[np.float32]
    inner: NDArray[np.float32]


class _Store:
    """The curves that were used last, and where they are kept between runs."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.kept: dict[tuple[Any, ...], RayCurves] = {}
        self.keeper: Keeper | None = None


_STORE = _Store()


def keep_curves(keeper: Keeper | None, /) -> None:
    """Say where curves are kept between runs; None for nowhere, as it is at first."""
    _STORE.keeper = keeper


def ray_curves(
    camera1: Device,
    camera2: Device,
    projector: Device,
    volume: MeasuringVolume,
    angle: float,
    /,
) -> RayCurves:
    """Return the curves of all pixels of C1, kept for the next call.

    Parameters
    ----------
    camera1, camera2, projector : Device
    volume : MeasuringVolume
    angle : float, rad; of the fringes
    """
    key = camera1, camera2, projector, volume, angle
    with _STORE.lock:
        found = _STORE.kept.pop(key, None) or traced_curves(*key)
        _STORE.kept[key] = found  # the last one
        while len(_STORE.kept) > CURVES_KEPT:
            del _STORE.kept[next(iter(_STORE.kept))]
    return found


def traced_curves(
    camera1: Device,
    camera2: Device,
    projector: Device,
    volume: MeasuringVolume,
    angle: float,
    /,
) -> RayCurves:
    """Do what `ray_curves` does where nothing is kept in memory."""
    ends = grid_intervals(camera1, camera2, volume)[..., :2]
    depths = np.broadcast_to(expected_depths(ends), ends.shape)

    def make() -> Arrays:
        return _traced(camera1, camera2, projector, ends, depths, angle)

    if _STORE.keeper is None:
        return RayCurves(ends, depths, **make())
    parts: list[str | bytes | NDArray[Any]] = [
        *(_numbers(device) for device in (camera1, camera2, projector)),
        volume.normals,
        volume.offsets_mm,
        repr((camera1.shape, camera2.shape, angle)),
        *(source.read_bytes() for source in SOURCES),
    ]
    return RayCurves(ends, depths, **_STORE.keeper(parts, make))


def _numbers(device: Device) -> NDArray[np.float64]:
    pose = device.device_from_world
    return np.concatenate([lens_of(device), pose.rotation.ravel(), pose.translation])


def _traced(
    camera1: Device,
    camera2: Device,
    projector: Device,
    ends: NDArray[np.float32],
    depths: NDArray[np.float64],
    angle: float,
) -> Arrays:
    """Return the curves and spans of `RayCurves`."""
    origin, directions = grid_rays(camera1)
    to_p, to_2 = projector.device_from_world, camera2.device_from_world
    sheets = (to_p.apply(origin), lens_of(projector), np.array([np.cos(angle), np.sin(angle)]))
    seen = (to_2.apply(origin), lens_of(camera2))
    shape = camera1.shape
    curves = np.empty((shape[0], _curves.N_CURVE, shape[1]), np.float32)
    wide, inner = (np.empty((*shape, 2), np.float32) for _ in range(2))
    for top in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(top, top + ROWS_AT_ONCE)
        own = ends[rows].reshape(-1, 2).astype(np.float64)
        is_inside = own[:, 0] < own[:, 1]
        own[~is_inside] = np.nan
        far_ends = np.where(is_inside[:, None], depths[rows].reshape(-1, 2), np.nan)
        along_p, along_2 = (
            np.ascontiguousarray(to.rotate(directions[rows].reshape(-1, 3))) for to in (to_p, to_2)
        )
        found = np.empty((len(own), _curves.N_CURVE))
        spans = np.empty((2, len(own), 2))
        over_rows(_curves.trace, len(own), far_ends, along_p, along_2, sheets, seen, found,
                  spans[0], least=POINTS)  # fmt: skip
        over_rows(_curves.span_of, len(own), own, along_p, sheets, spans[1], least=POINTS)
        curves[rows] = found.reshape(-1, shape[1], _curves.N_CURVE).swapaxes(1, 2)
        for table, values in ((wide, spans[0]), (inner, spans[1])):
            table[rows] = values.reshape(table[rows].shape)
    for table in (curves, wide, inner):
        table.flags.writeable = False
    return {"curves": curves, "wide": wide, "inner": inner}


def expected_depths(ends: NDArray[np.float32], /) -> NDArray[np.float64]:
    """Return the depths, (2,), mm, in which surfaces are expected: the volume's and more.

    A ray that leaves the volume through its side meets the table below it further on: so all rays
    share the depths of all others. NaN where none meets the volume.
    """
    near, far = ends[..., 0], ends[..., 1]
    inside = near < far
    if not inside.any():
        return np.full(2, np.nan)
    near, far = near[inside].astype(np.float64), far[inside].astype(np.float64)
    more = OUTSIDE_PART * (far - near).max()
    nearest = near.min()
    return np.array([max(nearest - more, nearest / 2), far.max() + more])
