"""The live view: a server on this machine, looked at with any browser."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import viser
from matplotlib import colormaps
from numpy.typing import NDArray

from fringe3d.errors import Fringe3DError
from fringe3d.io.stored import StoredResult
from fringe3d.model import Rejection
from fringe3d.report.advice import reason_rows
from fringe3d.report.cloud_data import Channel, channels_of, thinned
from fringe3d.report.maps import REASON_COLORS, robust_limits
from fringe3d.view.pixel import PixelStory, nearest_pixel, pixel_story, seen_volume
from fringe3d.view.shapes import frustum_lines, volume_lines

MOST_POINTS = 1_000_000
"""More points make turning slow; the others are left out at random."""

DEVICE_COLOURS = {"camera": (70, 130, 220), "projector": (230, 160, 40)}
TAKEN, OTHER, RAY = (40, 200, 80), (230, 60, 60), (120, 60, 200)
FRUSTUM_PART = 0.35
"""Of the distance to the points: devices are drawn with that much of their pyramids."""


class LiveView:
    """A result shown by a server, with its controls.

    Parameters
    ----------
    stored : StoredResult
    host : str; from which addresses the page can be reached: 127.0.0.1 is this machine alone
    port : int; the next free one is taken where it is in use
    most_points : int
    """

    def __init__(
        self, stored: StoredResult, /, *, host: str, port: int, most_points: int = MOST_POINTS
    ) -> None:
        self.stored = stored
        self.server = viser.ViserServer(host=host, port=port, label="fringe3d", verbose=False)
        self._lock = threading.Lock()
        valid = stored.rejection == 0
        self._places = thinned(valid, most_points)
        points = stored.maps["points_mm"].reshape(-1, 3)[self._places]
        self._middle = np.median(points, axis=0)
        reach = float(np.linalg.norm(np.percentile(points, 99, 0) - np.percentile(points, 1, 0)))
        self._channels = {channel.name: channel for channel in channels_of(stored.maps)}
        first = next(iter(self._channels.values()))
        # Shown around their middle: single precision is enough there.
        self.cloud = self.server.scene.add_point_cloud(
            "/points", (points - self._middle).astype(np.float32), self._colours(first),
            point_size=1.5 * reach / np.sqrt(len(points)), precision="float32",
            point_shading="flat",
        )  # fmt: skip
        self._add_rig()
        self._look_from_c1(reach)
        self._add_controls(len(points), int(valid.sum()))

    @property
    def address(self) -> str:
        """Return where a browser finds the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def colour_by(self, name: str, /) -> None:
        """Colour the points by a channel."""
        channel = self._channels[name]
        self.cloud.colors = self._colours(channel)
        low, high = robust_limits(channel.values)
        self.scale.content = f"{low:.4g} to {high:.4g} {channel.unit} ({channel.colours})"

    def show_pixel(self, row: int, col: int, /) -> PixelStory | None:
        """Show the ray of a pixel of C1 and its candidates; None where that is not possible."""
        with self._lock:
            self.server.scene.remove_by_name("/pixel")
            self.row.value = row
            self.col.value = col
            try:
                story = pixel_story(self.stored, row, col)
            except Fringe3DError as problem:
                self.story.content = plain(str(problem))
                return None
            self._draw(story)
            self.story.content = story_text(story)
            return story

    def _draw(self, story: PixelStory) -> None:
        assert self.stored.rig is not None
        if np.isfinite(story.ends_mm).all():
            self._lines("/pixel/ray", story.ends_mm[None], RAY)
        for candidate in story.candidates:
            colour = TAKEN if candidate.is_taken else OTHER
            name = "/pixel/taken" if candidate.is_taken else f"/pixel/order {candidate.order}"
            sight = [
                [candidate.point_mm, device.center_world]
                for device in self.stored.rig.devices
                if device.name in candidate.pixels
            ]
            self._lines(name, np.array(sight), colour)

    def _colours(self, channel: Channel) -> NDArray[np.uint8]:
        values = np.asarray(channel.values, np.float64).ravel()[self._places]
        low, high = robust_limits(values)
        part = np.nan_to_num(np.clip((values - low) / (high - low), 0, 1))
        colours: NDArray[np.uint8] = (255 * colormaps[channel.colours](part)[:, :3]).astype(
            np.uint8
        )
        return colours

    def _lines(
        self, name: str, segments: NDArray[np.float64], colour: tuple[int, int, int]
    ) -> None:
        self.server.scene.add_line_segments(
            name, (segments - self._middle).astype(np.float32), colour,
            thickness=2.0, thickness_units="screen",
        )  # fmt: skip

    def _add_rig(self) -> None:
        rig = self.stored.rig
        if rig is None:
            return
        for device in rig.devices:
            away = float(np.linalg.norm(self._middle - device.center_world))
            lines = frustum_lines(device, FRUSTUM_PART * away)
            self._lines(f"/rig/{device.name}", lines, DEVICE_COLOURS[device.role])
        edges = volume_lines(seen_volume(self.stored)[1])
        if len(edges):
            self._lines("/rig/volume", edges, (150, 150, 150))

    def _look_from_c1(self, reach: float) -> None:
        rig, camera = self.stored.rig, self.server.initial_camera
        up, ahead = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        if rig is not None:
            _, up, ahead = rig.cameras[0].device_from_world.rotation * [[1], [-1], [1]]
        self.server.scene.set_up_direction(tuple(up))
        camera.position, camera.look_at, camera.up = (
            tuple(-1.3 * reach * ahead),
            (0, 0, 0),
            tuple(up),
        )

    def _add_controls(self, n_shown: int, n_points: int) -> None:
        gui, shape = self.server.gui, self.stored.rejection.shape
        thin = "" if n_shown == n_points else f" of {n_points:,}, picked at random"
        summary = plain(self.stored.record["summary"])
        gui.add_markdown(f"{summary}\n\n{n_shown:,} points shown{thin}.")
        self.colour = gui.add_dropdown("colour", tuple(self._channels))
        self.scale = gui.add_markdown("")
        self.colour.on_update(lambda _: self.colour_by(self.colour.value))
        self.colour_by(self.colour.value)
        with gui.add_folder("pixel of C1"):
            self.row: Any = gui.add_number("row", shape[0] // 2, min=0, max=shape[0] - 1, step=1)
            self.col: Any = gui.add_number("column", shape[1] // 2, min=0, max=shape[1] - 1, step=1)
            button = gui.add_button("show its ray")
            self.story = gui.add_markdown("Enter a pixel, or click a point.")

        @button.on_click
        def _(_event: Any) -> None:
            self.show_pixel(int(self.row.value), int(self.col.value))

        @self.server.scene.on_click()
        def _(event: Any) -> None:
            points = self.stored.maps["points_mm"] - self._middle
            hit = nearest_pixel(points, event.ray_origin, event.ray_direction)
            if hit is not None:
                self.show_pixel(*hit)

        with gui.add_folder("rejected pixels"):
            image, legend = rejection_image(self.stored.rejection)
            gui.add_image(image)
            gui.add_markdown(legend)


def rejection_image(rejection: NDArray[np.uint16], /) -> tuple[NDArray[np.uint8], str]:
    """Return rejected pixels in the colour of their first reason, (row, col, 3), and a legend."""
    bits = rejection.astype(np.int64)
    number = np.where(bits > 0, np.log2(np.maximum(bits & -bits, 1)) + 1, 0).astype(int)
    hexes = ("#e8e8e8", *REASON_COLORS)
    table = np.array([[int(h[i : i + 2], 16) for i in (1, 3, 5)] for h in hexes], np.uint8)
    names = {reason.name: i for i, reason in enumerate(Rejection)}
    lines = [
        f"- {REASON_COLORS[names[row.name.replace(' ', '_').upper()]]} **{row.name}** "
        f"{row.n_pixels:,}: {row.meaning}"
        for row in reason_rows(rejection)
    ]
    return table[number], "\n".join(lines)


def story_text(story: PixelStory, /) -> str:
    """Return the story of a pixel as Markdown."""
    lines = [f"row {story.row}, column {story.col}: {plain(story.words)}", ""]
    for name, segment in story.segments.items():
        if np.isfinite(segment).all():
            (x1, y1), (x2, y2) = segment
            lines.append(f"- segment in {name}: ({x1:.1f}, {y1:.1f}) to ({x2:.1f}, {y2:.1f}) px")
    for candidate in story.candidates:
        places = ", ".join(f"{n} ({x:.1f}, {y:.1f})" for n, (x, y) in candidate.pixels.items())
        taken = " **taken**" if candidate.is_taken else ""
        lines.append(f"- order {candidate.order}: {candidate.depth_mm:.2f} mm, {places}{taken}")
    return "\n".join(lines)


def plain(text: str, /) -> str:
    """Return a text in which nothing is Markdown with components."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("{", "&#123;")
