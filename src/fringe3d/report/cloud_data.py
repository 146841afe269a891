"""A cloud packed for the small 3D view of a page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from fringe3d.geometry import project
from fringe3d.io.stored import StoredResult, angle_of
from fringe3d.model import Device
from fringe3d.patterns import across
from fringe3d.report.maps import robust_limits

LEVELS = 2**16 - 1
SEED = 0

FRAME_MARGIN = 0.1

KINDS = ((90, 150, 240), (150, 150, 150), (240, 170, 50))

DEVIATION = "deviation_mm"
"""The map of a result that was compared with something."""

CERTAIN = 0.99
"""Where all fringe orders are at least so probable there is nothing to show."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """What points can be coloured by.

    Parameters
    ----------
    name : str
    unit : str
    values : (row, col) float
    colours : str; name of a colour map
    is_signed : bool; its scale is symmetric about zero
    """

    name: str
    unit: str
    values: NDArray[Any]
    colours: str
    is_signed: bool = False


def channels_of(maps: dict[str, NDArray[Any]], /) -> list[Channel]:
    """Return what the points of a result can be coloured by; a constant map tells nothing.

    Parameters
    ----------
    maps : dict; those of ``points.npz``
    """
    found = [
        Channel("depth z", "mm", maps["points_mm"][..., 2], "turbo_r"),
        Channel("brightness", "DN", maps["offset"], "gray"),
        Channel("sigma", "um", 1000 * maps["sigma_mm"], "viridis"),
    ]
    probability = maps["order_probability"]
    if np.nanmin(probability, initial=1.0) < CERTAIN:
        found.append(Channel("order probability", "", probability, "plasma"))
    return found


def channels_of_result(stored: StoredResult, /) -> list[Channel]:
    """Return what the points of a result can be coloured by, also what its rig tells of them."""
    found = channels_of(stored.maps)
    residual = residual_px(stored)
    if residual is not None:
        found.append(Channel("residual", "px", residual, "RdBu_r", is_signed=True))
    if DEVIATION in stored.maps:
        values = stored.maps[DEVIATION]
        found.append(Channel("deviation", "mm", values, "RdBu_r", is_signed=True))
    return found


def residual_px(stored: StoredResult, /) -> NDArray[np.float64] | None:
    """Return by how much points lie beside the light that their phase names, projector px.

    Where the projector's model sees a point of two cameras, less where the phase says that the
    projector lit it from, across the fringes. None without such a projector or two cameras: then
    the phase itself placed the points.
    """
    rig, maps = stored.rig, stored.maps
    if (
        rig is None
        or rig.projector is None
        or len(rig.cameras) < 2
        or stored.record["method"] == "projector"
        or "absolute_phase" not in maps
    ):
        return None
    fringes = stored.record["decoding"][0]
    valid = stored.rejection == 0
    seen = project(rig.projector, maps["points_mm"][valid])
    lit = maps["absolute_phase"][valid] / (2 * np.pi) * fringes["period_px"]
    residual = np.full(valid.shape, np.nan)
    residual[valid] = across(angle_of(fringes["direction"]), seen[:, 0], seen[:, 1]) - lit
    return residual


def thinned(valid: NDArray[np.bool_], most: int, /) -> NDArray[np.intp]:
    """Return the places (n,) of at most so many of the valid pixels, in random order.

    So the first ones of them, however many, are spread evenly, too.
    """
    return np.random.default_rng(SEED).permutation(np.flatnonzero(valid))[:most]


def packed_cloud(
    maps: dict[str, NDArray[Any]],
    camera: Device | None,
    /,
    *,
    most: int,
    channels: Sequence[Channel] | None = None,
) -> dict[str, Any]:
    """Return what the script ``cloud_view.js`` shows, ready for JSON.

    Positions are 16-bit parts of the cloud's box, colours 8-bit parts of their limits.

    Parameters
    ----------
    maps : dict; those of ``points.npz``
    camera : Device or None; from which side one looks at first; told from the points if not known
    most : int; points
    channels : sequence of Channel; by default what the maps alone tell
    """
    valid = maps["rejection"] == 0
    places = thinned(valid, most)
    seen = maps["points_mm"]
    rotation = facing(seen) if camera is None else camera.device_from_world.rotation
    shown = [_packed(channel, places) for channel in channels or channels_of(maps)]
    return packed_points(seen.reshape(-1, 3)[places], shown, rotation, of=int(valid.sum()))


def packed_points(
    points_mm: NDArray[Any],
    channels: list[dict[str, Any]],
    rotation: NDArray[np.float64],
    /,
    *,
    of: int,
) -> dict[str, Any]:
    """Return points of any kind as `packed_cloud` does.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; in random order
    channels : list of dict; see `packed_values`
    rotation : (3, 3) float; axes of the eye as rows: right, down, ahead
    of : int; so many there are
    """
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    parts = np.round((points_mm - low) / size * LEVELS).astype("<u2")
    first, last = framed(points_mm)
    return {
        "count": len(points_mm),
        "of": of,
        "low_mm": low.tolist(),
        "size_mm": size.tolist(),
        "middle_mm": ((first + last) / 2 - low).tolist(),
        "framed_mm": np.maximum(last - first, 1e-6).tolist(),
        "rotation": rotation.tolist(),
        "positions": _text(parts),
        "channels": channels,
    }


def framed(points_mm: NDArray[Any], /) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners (3,) of a box that holds 98 % of the points along each axis, and a margin.

    Parameters
    ----------
    points_mm : (n, 3) float

    Examples
    --------
    >>> points = np.linspace(0, 100, 101)[:, None] * [1, 1, 1]
    >>> points[-1, 2] = 1000  # a stray
    >>> [corner.round(6).tolist() for corner in framed(points)]
    [[0.0, 0.0, 0.0], [100.0, 100.0, 108.8]]
    """
    low, high = np.percentile(points_mm, [1, 99], axis=0)
    margin = FRAME_MARGIN * (high - low)
    return (
        np.maximum(low - margin, points_mm.min(axis=0)),
        np.minimum(high + margin, points_mm.max(axis=0)),
    )


def facing(points_mm: NDArray[Any], /) -> NDArray[np.float64]:
    """Return how a camera is turned that sees such points: its axes in the world as rows, (3, 3).

    Parameters
    ----------
    points_mm : (row, col, 3) float; NaN where there are none

    Examples
    --------
    >>> y, x = np.mgrid[:3, :4].astype(float)
    >>> (facing(np.stack([x, -y, 0 * x], axis=-1)).round(6) + 0.0).tolist()
    [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    """
    row, col = np.nonzero(np.isfinite(points_mm[..., 0]))
    grid = np.column_stack([col, row, np.ones(len(row))]).astype(np.float64)
    along = np.linalg.lstsq(grid, points_mm[row, col], rcond=None)[0][:2]
    if np.linalg.matrix_rank(along) < 2:
        return np.eye(3)
    x = along[0] / np.linalg.norm(along[0])
    y = along[1] - (along[1] @ x) * x
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def _packed(channel: Channel, places: NDArray[np.intp]) -> dict[str, Any]:
    values = np.asarray(channel.values, np.float64).ravel()[places]
    return packed_values(Channel(channel.name, channel.unit, values, channel.colours,
                                 channel.is_signed))  # fmt: skip


def packed_values(channel: Channel, /) -> dict[str, Any]:
    """Return the values (n,) of the points that are shown, ready for JSON."""
    low, high = robust_limits(channel.values)
    if channel.is_signed:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    level = np.nan_to_num(np.clip((channel.values - low) / (high - low), 0, 1))
    table = (colormaps[channel.colours](np.arange(256))[:, :3] * 255).round().astype(np.uint8)
    return {
        "name": channel.name,
        "unit": channel.unit,
        "low": low,
        "high": high,
        "values": _text((255 * level).round().astype(np.uint8)),
        "colours": _text(table),
    }


def packed_kinds(name: str, kinds: NDArray[np.int64], words: tuple[str, str], /) -> dict[str, Any]:
    """Return points of three kinds (n,), 0 to 2: blue, grey, orange; words for first and last."""
    table = np.repeat(np.array(KINDS, np.uint8), (86, 84, 86), axis=0)
    values = np.array([0, 128, 255], np.uint8)[kinds]
    low, high = words
    return {"name": name, "unit": "", "low": low, "high": high, "values": _text(values),
            "colours": _text(table)}  # fmt: skip


def _text(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
