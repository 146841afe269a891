"""The live view: a server on this machine, looked at with any browser."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import viser
from matplotlib import colormaps
from numpy.typing import NDArray

from fringe3d.errors import Fringe3DError
from fringe3d.geometry import frustum_lines, volume_lines
from fringe3d.io.stored import StoredResult, angle_of
from fringe3d.model import PhaseMap
from fringe3d.patterns import across
from fringe3d.report.cloud_data import Channel, channels_of_result, thinned
from fringe3d.report.maps import robust_limits
from fringe3d.view.layers import Layers, Pacing, Surface
from fringe3d.view.pace import levels_of
from fringe3d.view.panel import (
    colour_bar,
    plain,
    rejection_image,
    rejection_legend,
    story_text,
)
from fringe3d.view.phases import seen_phases
from fringe3d.view.pixel import (
    Candidate,
    PixelStory,
    nearest_pixel,
    pixel_story,
    seen_volume,
)
from fringe3d.view.segments import segment_picture
from fringe3d.view.shapes import light_sheet

BETWEEN = 1.15
"""Results stand side by side at so many widths of the first."""

SHEET_REACH = 1.15
"""Of the distance of the point: light sheets are drawn a little beyond it."""

MOST_POINTS = 1_000_000
"""More points make turning slow; the others are left out at random."""

WHOLE_RIG = 3.0
"""Of the radius of the rig: so far away stands an eye that sees all of it."""

Place = tuple[float, float, float]

DEVICE_COLOURS = {"camera": (70, 130, 220), "projector": (230, 160, 40)}
TAKEN, OTHER, RAY = (40, 200, 80), (230, 60, 60), (120, 60, 200)
FRUSTUM_PART = 0.35
"""Of the distance to the points: devices are drawn with that much of their pyramids."""


@dataclass(slots=True, eq=False)
class _Shown:
    """A result on the stage."""

    stored: StoredResult
    places: NDArray[np.intp]
    channels: dict[str, Channel]
    aside: NDArray[np.float64]
    cloud: Layers
    surface: Surface | None = None


class LiveView:
    """Results shown by a server, with their controls.

    Parameters
    ----------
    stored : StoredResult, or several that are shown side by side: methods compared
    host : str; from which addresses the page can be reached: 127.0.0.1 is this machine alone
    port : int; the next free one is taken where it is in use
    most_points : int; of each
    phases : function that returns what the cameras saw of a result, by camera; by default it is
        decoded again from the images, when the first pixel is asked for
    """

    def __init__(
        self,
        stored: StoredResult | Sequence[StoredResult],
        /,
        *,
        host: str,
        port: int,
        most_points: int = MOST_POINTS,
        phases: Callable[[StoredResult], Mapping[str, PhaseMap]] = seen_phases,
    ) -> None:
        results = [stored] if isinstance(stored, StoredResult) else list(stored)
        self.stored, self._several = results[0], len(results) > 1
        self._phases_of, self._phases = phases, dict[int, Mapping[str, PhaseMap]]()
        self.server = viser.ViserServer(host=host, port=port, label="fringe3d", verbose=False)
        self._lock = threading.Lock()
        points = self.stored.maps["points_mm"][self.stored.rejection == 0]
        self._middle = np.median(points, axis=0)
        reach = float(np.linalg.norm(np.percentile(points, 99, 0) - np.percentile(points, 1, 0)))
        valid = [result.rejection == 0 for result in results]
        self._levels = levels_of(sum(min(most_points, int(v.sum())) for v in valid))
        self._level, self._is_surface = len(self._levels) - 1, False
        self._shown = [
            self._on_stage(number, result, reach, thinned(kept, most_points))
            for number, (result, kept) in enumerate(zip(results, valid, strict=True))
        ]
        self._channels = self._shown[0].channels
        self.cloud = self._shown[0].cloud
        self._rig_nodes: dict[str, Any] = {}
        self._add_rig()
        self._reach = reach * len(results)
        self._look_from_c1()
        self._add_controls(len(self._shown[0].places), len(points))
        self._pacing = Pacing(self.server, self._levels, self.show_level)

    def _on_stage(
        self, number: int, stored: StoredResult, reach: float, places: NDArray[np.intp]
    ) -> _Shown:
        rig = self.stored.rig
        sideways = np.eye(3)[0] if rig is None else rig.cameras[0].device_from_world.rotation[0]
        channels = {channel.name: channel for channel in channels_of_result(stored)}
        if number and stored.rejection.shape == self.stored.rejection.shape:
            away = deviation_mm(stored, self.stored)
            channels["from the first"] = Channel(
                "from the first", "mm", away, "RdBu_r", is_signed=True
            )
        aside = number * BETWEEN * reach * sideways
        points = self._staged(stored, aside)[places]
        first = colours_of(next(iter(channels.values())), places)
        ends = [round(len(places) * n / self._levels[-1]) for n in self._levels]
        cloud = Layers(
            self.server, "/points" if number == 0 else f"/points {number + 1}", points, first,
            ends, 1.5 * reach / np.sqrt(len(points)),
        )  # fmt: skip
        shown = _Shown(stored, places, channels, aside, cloud)
        if self._several:
            above = np.nanmin(points, axis=0) if len(points) else shown.aside
            name = f"{stored.folder.name}: {stored.record['method']}"
            self.server.scene.add_label(f"/label {number + 1}", name, position=tuple(above))
        return shown

    @property
    def address(self) -> str:
        """Return where a browser finds the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def colour_by(self, name: str, /) -> None:
        """Colour the points by a channel; all results on the scale of the first that has it."""
        having = [shown for shown in self._shown if name in shown.channels]
        channel = having[0].channels[name]
        low, high = robust_limits(channel.values)
        if channel.is_signed:
            low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
        for shown in having:
            shown.cloud.colour(colours_of(shown.channels[name], shown.places, (low, high)))
        self.scale.content = colour_bar(channel, low, high)

    def show_level(self, level: int, /) -> None:
        """Show the points of a level, counted from the coarsest, or the surfaces that suit it."""
        self._level = level
        with self.server.atomic():
            for shown in self._shown:
                shown.cloud.show(None if self._is_surface else level)
                if shown.surface is not None:
                    is_fine = level == len(self._levels) - 1
                    shown.surface.show(self._is_surface, is_fine=is_fine)

    def as_surface(self, is_surface: bool, /) -> None:
        """Show surfaces between neighbouring pixels instead of points, or points again."""
        for number, shown in enumerate(self._shown):
            if is_surface and shown.surface is None:
                points = self._staged(shown.stored, shown.aside)
                grid = points.reshape(*shown.stored.rejection.shape, 3)
                shown.surface = Surface(self.server, f"/surface {number + 1}", grid)
        self._is_surface = is_surface
        self.show_level(self._level)

    def show_pixel(self, row: int, col: int, /, *, number: int = 0) -> PixelStory | None:
        """Show the ray of a pixel of C1 and its candidates; None where that is not possible."""
        with self._lock:
            self.server.scene.remove_by_name("/pixel")
            self.row.value = row
            self.col.value = col
            shown = self._shown[number]
            if number not in self._phases:
                self._phases[number] = self._phases_of(shown.stored)
            try:
                story = pixel_story(shown.stored, row, col, phases=self._phases[number])
            except Fringe3DError as problem:
                self.story.content = plain(str(problem))
                self.picture.visible = False
                return None
            self._draw(shown, story)
            self.story.content = story_text(story)
            picture = segment_picture(shown.stored, story, self._phases[number])
            self.picture.visible = picture is not None
            if picture is not None:
                self.picture.image = picture
            return story

    def _draw(self, shown: _Shown, story: PixelStory) -> None:
        rig = shown.stored.rig
        assert rig is not None
        if np.isfinite(story.ends_mm).all():
            self._lines("/pixel/ray", story.ends_mm[None] + shown.aside, RAY)
        for candidate in story.candidates:
            colour = TAKEN if candidate.is_taken else OTHER
            name = "taken" if candidate.is_taken else f"order {candidate.order}"
            sight = [
                [candidate.point_mm, device.center_world]
                for device in rig.devices
                if device.name in candidate.pixels
            ]
            self._lines(f"/pixel/{name}", np.array(sight) + shown.aside, colour)
            if self.sheets.value and rig.projector is not None:
                self._add_sheet(f"/pixel/sheet of {name}", shown, candidate, colour)

    def _add_sheet(
        self, name: str, shown: _Shown, candidate: Candidate, colour: tuple[int, int, int]
    ) -> None:
        rig = shown.stored.rig
        assert rig is not None
        assert rig.projector is not None
        projector, angle = rig.projector, angle_of(shown.stored.record["decoding"][0]["direction"])
        x, y = candidate.pixels[projector.name]
        away = float(np.linalg.norm(candidate.point_mm - projector.center_world))
        position = float(across(angle, x, y))
        vertices, faces = light_sheet(projector, position, angle, SHEET_REACH * away)
        if len(faces):
            self.server.scene.add_mesh_simple(
                name, (vertices - self._middle + shown.aside).astype(np.float32),
                faces.astype(np.uint32), color=colour, opacity=0.2, side="double",
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip

    def _staged(self, stored: StoredResult, aside: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return all points (n, 3) of a result where they are shown."""
        points = stored.maps["points_mm"].reshape(-1, 3)
        return np.asarray(points - self._middle + aside, np.float32)

    def _lines(self, name: str, segments: NDArray[np.float64], colour: tuple[int, int, int]) -> Any:
        return self.server.scene.add_line_segments(
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
            self._rig_nodes[device.name] = self._lines(
                f"/rig/{device.name}", lines, DEVICE_COLOURS[device.role]
            )
        edges = volume_lines(seen_volume(self.stored)[1])
        if len(edges):
            self._rig_nodes["volume"] = self._lines("/rig/volume", edges, (150, 150, 150))

    def _look_from_c1(self) -> None:
        camera = self.server.initial_camera
        camera.position, camera.look_at, up = self._eye(whole_rig=False)
        camera.up = up
        self.server.scene.set_up_direction(up)

    def _eye(self, *, whole_rig: bool) -> tuple[Place, Place, Place]:
        """Return where the eye is, where it looks, and what is up."""
        rig, reach = self.stored.rig, self._reach
        right, up, ahead = np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
        if rig is not None:
            right, up, ahead = rig.cameras[0].device_from_world.rotation * [[1], [-1], [1]]
        # Several results stand in a row that begins in the middle of the first.
        target = (len(self._shown) - 1) / 2 * BETWEEN * reach / len(self._shown) * right
        position = target - 1.3 * reach * ahead
        if whole_rig and rig is not None:
            centers = np.array([device.center_world for device in rig.devices]) - self._middle
            target = centers.mean(axis=0) / 2
            away = WHOLE_RIG * max(reach / 2, np.linalg.norm(centers - target, axis=1).max())
            position = target + away * (-0.8 * right + 0.45 * up - 0.4 * ahead)
        return _place(position), _place(target), _place(up)

    def _add_rig_controls(self) -> None:
        """Let devices and volume be hidden, and the eye go back to C1 or see the whole rig."""
        gui, rig = self.server.gui, self.stored.rig
        if rig is None:
            return
        parts = {"devices": [device.name for device in rig.devices], "volume": ["volume"]}
        for label, names in parts.items():
            box: Any = gui.add_checkbox(label, True)
            box.on_update(partial(self._show_parts, names))
        places: Any = gui.add_button_group("look", ("from C1", "at the rig"))
        places.on_click(lambda event: self.look(whole_rig=event.target.value == "at the rig"))

    def _show_parts(self, names: Sequence[str], event: Any) -> None:
        for name in names:
            if name in self._rig_nodes:
                self._rig_nodes[name].visible = bool(event.target.value)

    def look(self, *, whole_rig: bool) -> None:
        """Let all browsers look from C1, or from where the whole rig is seen."""
        position, target, up = self._eye(whole_rig=whole_rig)
        for client in self.server.get_clients().values():
            client.camera.up_direction = up
            client.camera.position = position
            client.camera.look_at = target

    def _add_controls(self, n_shown: int, n_points: int) -> None:
        gui, shape = self.server.gui, self.stored.rejection.shape
        thin = "" if n_shown == n_points else f" of {n_points:,}, picked at random"
        summary = plain(self.stored.record["summary"])
        gui.add_markdown(f"{summary}\n\n{n_shown:,} points shown{thin}.")
        names = dict.fromkeys(name for shown in self._shown for name in shown.channels)
        self.colour = gui.add_dropdown("colour", tuple(names))
        self.scale = gui.add_html("")
        self.colour.on_update(lambda _: self.colour_by(self.colour.value))
        self.colour_by(self.colour.value)
        if len(self._levels) > 1:
            everything: Any = gui.add_checkbox(
                "all points", False,
                hint="However slow; otherwise fewer, larger ones where drawing is slow",
            )  # fmt: skip
            everything.on_update(lambda _: self._pacing.draw_everything(bool(everything.value)))
        self.surface = gui.add_checkbox(
            "surfaces", False, hint="Between neighbouring pixels, instead of points"
        )
        self.surface.on_update(lambda _: self.as_surface(bool(self.surface.value)))
        self._add_rig_controls()
        with gui.add_folder("pixel of C1"):
            self.row: Any = gui.add_number("row", shape[0] // 2, min=0, max=shape[0] - 1, step=1)
            self.col: Any = gui.add_number("column", shape[1] // 2, min=0, max=shape[1] - 1, step=1)
            self.sheets: Any = gui.add_checkbox("light sheets", False, hint="Of the candidates")
            button = gui.add_button("show its ray")
            self.picture = gui.add_image(np.zeros((1, 1, 3), np.uint8), visible=False)
            self.story = gui.add_markdown("Enter a pixel, or click a point.")

        @button.on_click
        def _(_event: Any) -> None:
            self.show_pixel(int(self.row.value), int(self.col.value))

        @self.server.scene.on_click()
        def _(event: Any) -> None:
            hits = []
            for number, shown in enumerate(self._shown):
                points = self._staged(shown.stored, shown.aside).reshape(
                    *shown.stored.rejection.shape, 3
                )
                found = nearest_pixel(
                    points.astype(np.float64), event.ray_origin, event.ray_direction
                )
                if found is not None:
                    off = points[found] - np.asarray(event.ray_origin)
                    side = np.cross(off, event.ray_direction) / np.linalg.norm(off)
                    hits.append((float(np.linalg.norm(side)), number, found))
            if hits:
                _, number, found = min(hits)
                self.show_pixel(*found, number=number)

        for shown in self._shown:
            of = f" of {shown.stored.folder.name}" if self._several else ""
            with gui.add_folder(f"rejected pixels{of}", expand_by_default=not self._several):
                gui.add_image(rejection_image(shown.stored.rejection), format="png")
                gui.add_html(rejection_legend(shown.stored.rejection))


def _place(vector: NDArray[np.float64]) -> Place:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def colours_of(
    channel: Channel, places: NDArray[np.intp], limits: tuple[float, float] | None = None, /
) -> NDArray[np.uint8]:
    """Return the colours (n, 3) of some places of a channel, between limits or its own."""
    values = np.asarray(channel.values, np.float64).ravel()[places]
    low, high = limits or robust_limits(values)
    part = np.nan_to_num(np.clip((values - low) / (high - low), 0, 1))
    return np.asarray(255 * colormaps[channel.colours](part)[:, :3]).astype(np.uint8)


def deviation_mm(stored: StoredResult, first: StoredResult, /) -> NDArray[np.float64]:
    """Return how much farther from C1 a result has its points than the first, (row, col), mm."""
    points, reference = stored.maps["points_mm"], first.maps["points_mm"]
    center = np.zeros(3) if first.rig is None else first.rig.cameras[0].center_world
    away = np.linalg.norm(points - center, axis=-1) - np.linalg.norm(reference - center, axis=-1)
    return np.asarray(away, np.float64)
