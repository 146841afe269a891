"""Pictures of a rig: where everything stands, and its segments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from fringe3d.design import Assessment
from fringe3d.design.reference import partner_of
from fringe3d.geometry import epipolar_segment, frustum, pixel_grid, project, rays
from fringe3d.model import Device, MeasuringVolume
from fringe3d.patterns import across

COLORS = {"c1": "#1f77b4", "c2": "#2ca02c", "projector": "#e07b00"}
VOLUME = "#8a8f98"
BACKGROUND = "#f4f5f7"
N_RAYS = 5
SEGMENT_GRID = (5, 6)
"""Rows and columns of C1 whose segments are drawn."""

CURVE_POINTS = 25

Points = NDArray[np.float64]


def draw_rig(path: Path, a: Assessment, /, *, title: str) -> None:
    """Draw the rig from above and from the side, and the volume with rays and light sheets.

    *Above* is across the plane of C1, its partner and the reference point; so the triangulation
    angle between the two is seen at its true size.
    """
    frame = _frame(a)
    figure = Figure(figsize=(14.0, 5.9), dpi=100, layout="constrained")
    above, side, volume = figure.subplots(1, 3, width_ratios=[1.1, 0.9, 1.25])
    corners = _volume_corners(a)
    for axis, (across_, label), view in (
        (above, (0, _across_label(a)), "from above"),
        (side, (1, "upwards, mm"), "from the side"),
    ):
        _draw_view(axis, a, frame[[across_, 2]], corners)
        axis.set_title(f"the rig {view}", fontsize=10, loc="left")
        axis.set_xlabel(label, fontsize=9)
        axis.set_ylabel("towards the rig, mm", fontsize=9)
    for axis in (above, side):
        axis.set_aspect("equal", adjustable="datalim")
    for axis in (above, side, volume):
        axis.set_facecolor(BACKGROUND)
        axis.tick_params(labelsize=8)
        axis.grid(color="white", linewidth=0.8)
        axis.set_axisbelow(True)
    figure.legend(
        handles=_legend(a), loc="outside lower center", ncols=7, frameon=False, fontsize=9
    )
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    volume.set_title("the measuring volume from above", fontsize=10, loc="left")
    volume.set_xlabel(_across_label(a), fontsize=9)
    volume.set_ylabel("towards the rig, mm", fontsize=9)
    figure.draw_without_rendering()  # the layout says how high the panel is
    room = volume.get_window_extent()
    _draw_volume(volume, a, frame, corners, room.height / room.width)
    figure.savefig(path)


def _legend(a: Assessment) -> list[Artist]:
    handles: list[Artist] = [
        Line2D([], [], color=_color(a, device), linewidth=1.2, label=device.name,
               marker="o" if device.role == "camera" else "s")
        for device in a.rig.devices
    ]  # fmt: skip
    first = a.rig.cameras[0].name
    handles += [
        Patch(color=VOLUME, alpha=0.45, label="measuring volume"),
        Line2D([], [], color=COLORS["c1"], linewidth=0.8, label=f"rays of {first}"),
        Line2D([], [], color="black", linewidth=2, label="their segments"),
    ]
    if a.rig.projector is not None:
        words = f"light sheets, one period ({a.period_px:g} px) apart"
        handles.append(Line2D([], [], color=COLORS["projector"], linewidth=0.8, label=words))
    return handles


def _frame(a: Assessment) -> Points:
    """Return the axes of the drawing (across, up, towards the rig), rows, in the world frame."""
    toward = a.reference.facing
    partner = partner_of(a.rig)
    base = partner.center_world - a.rig.cameras[0].center_world
    along = base - (base @ toward) * toward
    if np.linalg.norm(along) < 1e-9 * max(float(np.linalg.norm(base)), 1.0):
        along = a.rig.cameras[0].device_from_world.rotation[0]
        along = along - (along @ toward) * toward
    along = along / np.linalg.norm(along)
    # Devices have x right, y down: so the second axis points up in their images.
    return np.stack([along, np.cross(toward, along), toward])


def _across_label(a: Assessment) -> str:
    return f"from {a.rig.cameras[0].name} to {partner_of(a.rig).name}, mm"


def _color(a: Assessment, device: Device) -> str:
    if device.role == "projector":
        return COLORS["projector"]
    return COLORS["c1"] if device is a.rig.cameras[0] else COLORS["c2"]


def _volume_corners(a: Assessment) -> Points:
    """Return the corners of the volume, of what C1 sees of it where it is open: (n, 3), or none."""
    assert a.rig.volume is not None
    inside = a.reference.point_mm
    for bounds in (a.rig.volume, a.rig.volume.intersection(frustum(a.rig.cameras[0]))):
        found = _corners(bounds, inside)
        if len(found):
            return found
    return np.empty((0, 3))


def _corners(volume: MeasuringVolume, inside: Points) -> Points:
    planes = np.column_stack([volume.normals, -volume.offsets_mm])
    try:
        found = HalfspaceIntersection(planes, inside).intersections
    except (QhullError, ValueError):
        return np.empty((0, 3))
    # Of an open volume Qhull gives corners at infinity.
    reach = np.linalg.norm(found - inside, axis=1)
    closed = np.isfinite(reach).all() and reach.max() < 1e5
    return found if closed else np.empty((0, 3))


def _draw_view(axis: Axes, a: Assessment, plane: Points, corners: Points) -> None:
    """Draw devices, frusta, volume and some rays of C1, projected onto two axes."""
    reference = a.reference.point_mm

    def flat(points: Points) -> Points:
        return (points - reference) @ plane.T

    if len(corners):
        axis.add_patch(_outline(flat(corners), facecolor=VOLUME, alpha=0.45, zorder=1))
    for device in a.rig.devices:
        color = _color(a, device)
        cone = _cone(device, reference)
        axis.add_patch(_outline(flat(cone), facecolor=color, alpha=0.09, zorder=0))
        ends = flat(np.stack([device.center_world, reference]))
        axis.plot(*ends.T, color=color, linewidth=1.2)
        axis.plot(*ends[0], marker="o" if device.role == "camera" else "s", color=color,
                  markersize=8, zorder=4)  # fmt: skip
    origin, points = _some_segments(a)
    for near, far in points:
        start, end = flat(np.stack([origin, far]))
        axis.plot(*np.stack([start, end]).T, color=COLORS["c1"], linewidth=0.4, zorder=2)
        axis.plot(*flat(np.stack([near, far])).T, color="black", linewidth=2.0, zorder=3)
    axis.margins(0.08)


def _outline(points: Points, **style: Any) -> Polygon:
    hull = ConvexHull(points, qhull_options="QJ")
    return Polygon(points[hull.vertices], closed=True, edgecolor="none", **style)


def _cone(device: Device, reference: Points) -> Points:
    """Return the projection centre and the corners of the view beyond the reference point."""
    right, bottom = device.n_cols - 0.5, device.n_rows - 0.5
    pixels = [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]]
    origin, directions = rays(device, pixels)
    distance = float(np.linalg.norm(reference - origin))
    directions = directions[np.isfinite(directions).all(axis=1)]
    return np.vstack([origin, origin + 1.06 * distance * directions])


def _some_segments(a: Assessment) -> tuple[Points, list[Points]]:
    """Return C1's centre and the ends (2, 3) of the segments of some pixels in its middle row."""
    camera, partner = a.rig.cameras[0], partner_of(a.rig)
    row = project(camera, a.reference.point_mm)[1]
    columns = np.arange(camera.n_cols, dtype=np.float64)
    pixels = np.column_stack([columns, np.full_like(columns, row)])
    near, far = epipolar_segment(camera, partner, pixels, a.rig.volume)
    seen = np.flatnonzero((near < far) & np.isfinite(far))
    origin, directions = rays(camera, pixels)
    if not len(seen):
        return origin, []
    chosen = seen[np.rint(np.linspace(0.06, 0.94, N_RAYS) * (len(seen) - 1)).astype(int)]
    ends = np.stack([near, far], axis=1)[chosen]
    return origin, list(origin + ends[..., None] * directions[chosen][:, None])


def _draw_volume(axis: Axes, a: Assessment, frame: Points, corners: Points, shape: float) -> None:
    """Draw the volume from above: rays of C1, and the light sheets one period apart.

    `shape` is height over width of the panel.
    """
    plane = frame[[0, 2]]
    reference = a.reference.point_mm
    origin, segments = _some_segments(a)
    shown = np.concatenate([corners, *segments]) if segments or len(corners) else reference[None]
    flat = (shown - reference) @ plane.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    low, high = _filling(low, high, shape)
    if len(corners):
        hull = (corners - reference) @ plane.T
        axis.add_patch(_outline(hull, facecolor=VOLUME, alpha=0.3, zorder=1))
    if a.rig.projector is not None:
        xs, ys = (np.linspace(low[i], high[i], 240) for i in (0, 1))
        grid = np.stack(np.meshgrid(xs, ys), axis=-1)
        seen = project(a.rig.projector, reference + grid @ plane)
        phase = across(a.angle, seen[..., 0], seen[..., 1]) / a.period_px
        whole = np.arange(np.ceil(np.nanmin(phase)), np.nanmax(phase))
        if 0 < len(whole) < 400:
            axis.contour(xs, ys, phase, levels=whole, colors=COLORS["projector"], linewidths=0.7,
                         linestyles="solid")  # fmt: skip
    for ends in segments:
        start, near, far = ((p - reference) @ plane.T for p in (origin, *ends))
        entry = near + (high[1] - low[1]) * (start - near) / np.linalg.norm(start - near)
        axis.plot(*np.stack([entry, far]).T, color=COLORS["c1"], linewidth=0.8, zorder=2)
        axis.plot(*np.stack([near, far]).T, color="black", linewidth=2.2, zorder=3)
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def _filling(low: Points, high: Points, shape: float) -> tuple[Points, Points]:
    """Return limits (2,) around others, with room, for a panel of this height over width."""
    size = 1.24 * (high - low)
    size = np.maximum(size, [size[1] / shape, size[0] * shape])
    middle = (low + high) / 2
    return middle - size / 2, middle + size / 2


def draw_segments(path: Path, a: Assessment, /, *, title: str) -> None:
    """Draw some pixels of C1, and their segments in the images of C2 and the projector."""
    camera = a.rig.cameras[0]
    others = [*a.rig.cameras[1:2], *((a.rig.projector,) if a.rig.projector else ())]
    rows, cols = (
        (np.arange(n) + 0.5) / n * size - 0.5
        for n, size in zip(SEGMENT_GRID, camera.shape, strict=True)
    )
    pixels = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    hues = np.linspace(0, 1, len(pixels))
    devices = (camera, *others)
    shares = [device.n_cols / device.n_rows for device in devices]
    figure = Figure(figsize=(3.9 * sum(shares) + 0.6, 4.7), dpi=100, layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(devices), width_ratios=shares))
    colors = colormaps["turbo"](hues)
    axes[0].scatter(*pixels.T, c=colors, s=26)
    axes[0].set_title(f"pixels of '{camera.name}'", fontsize=10, loc="left")
    for axis, device in zip(axes, devices, strict=True):
        axis.set_xlim(-0.5, device.n_cols - 0.5)
        axis.set_ylim(device.n_rows - 0.5, -0.5)
        axis.set_aspect("equal")
        axis.set_facecolor(BACKGROUND)
        axis.tick_params(labelsize=8)
        axis.set_xlabel("x, px", fontsize=9)
    axes[0].set_ylabel("y, px", fontsize=9)
    for axis, device in zip(axes[1:], others, strict=True):
        _draw_curves(axis, a, device, pixels, colors)
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    figure.savefig(path)


def _draw_curves(
    axis: Axes, a: Assessment, device: Device, pixels: Points, colors: NDArray[Any]
) -> None:
    """Draw the segments of pixels in the image of a device, with a dot at their near end."""
    camera = a.rig.cameras[0]
    origin, directions = rays(camera, pixels)
    near, far = epipolar_segment(camera, device, pixels, a.rig.volume)
    words = f"their segments in '{device.name}' (dot: near end)"
    if device.role == "projector":
        words = f"the same in '{device.name}'; lines: periods of {a.period_px:g} px"
        _draw_periods(axis, a, device)
    for i in np.flatnonzero((near < far) & np.isfinite(far)):
        depths = np.linspace(near[i], far[i], CURVE_POINTS)
        curve = project(device, origin + depths[:, None] * directions[i])
        axis.plot(*curve.T, color=colors[i], linewidth=2.0)
        axis.plot(*curve[0], marker="o", color=colors[i], markersize=4)
    axis.set_title(words, fontsize=10, loc="left")


def _draw_periods(axis: Axes, a: Assessment, device: Device) -> None:
    """Draw where the periods begin, as thin lines."""
    grid = pixel_grid(device.shape)[:: max(1, device.n_rows // 60), :: max(1, device.n_cols // 80)]
    w = across(a.angle, grid[..., 0], grid[..., 1]) / a.period_px
    whole = np.arange(np.ceil(w.min()), w.max())
    if 0 < len(whole) < 200:
        axis.contour(grid[0, :, 0], grid[:, 0, 1], w, levels=whole, colors="#c9ccd2",
                     linewidths=0.5)  # fmt: skip
