"""Clouds and surfaces that can be drawn coarser while the camera moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from fringe3d.view.pace import Detail
from fringe3d.view.shapes import grid_triangles

FACES = (100_000, 1_500_000)
"""Of the coarse surface, for a camera that moves in a slow browser, and of the fine one."""

SURFACE = (190, 195, 205)


class Layers:
    """The points of one result as parts, of which the first ones alone show it, too.

    Parameters
    ----------
    server : viser.ViserServer
    name : str; of its first node
    points : (n, 3) float32, in random order
    colours : (n, 3) uint8
    ends : ints, rising to n; up to which point each level shows
    size : float; of a point where all are shown
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        points: NDArray[np.float32],
        colours: NDArray[np.uint8],
        ends: Sequence[int],
        size: float,
    ) -> None:
        self._parts = [slice(*part) for part in pairwise((0, *ends))]
        self._ends, self._size = tuple(ends), size
        self.nodes = [
            # Shown around their middle: single precision is enough there.
            server.scene.add_point_cloud(
                name if number == 0 else f"{name}, part {number + 1}", points[part], colours[part],
                point_size=size, precision="float32", point_shading="flat",
            )
            for number, part in enumerate(self._parts)
        ]  # fmt: skip

    def colour(self, colours: NDArray[np.uint8], /) -> None:
        """Colour the points, (n, 3)."""
        for node, part in zip(self.nodes, self._parts, strict=True):
            node.colors = colours[part]

    def show(self, level: int | None, /) -> None:
        """Show the points of a level, so large that they cover the same area; None for no points.

        Levels are counted from 0, the coarsest.
        """
        shown = -1 if level is None else level
        size = self._size * np.sqrt(self._ends[-1] / max(1, self._ends[shown]))
        for number, node in enumerate(self.nodes):
            node.visible = number <= shown
            if node.visible:
                node.point_size = float(size)


class Surface:
    """The surface of one result, coarse and fine.

    Parameters
    ----------
    server : viser.ViserServer
    name : str; of its first node
    points : (row, col, 3) float32; NaN where there are none
    """

    def __init__(
        self, server: viser.ViserServer, name: str, points: NDArray[np.float32], /
    ) -> None:
        self._nodes: list[Any] = []
        for most in FACES:
            # Every second, third, ... row and column, so that no part is left out.
            step = int(np.ceil(np.sqrt(2 * points[..., 0].size / most)))
            grid = np.ascontiguousarray(points[::step, ::step])
            used, renumbered = np.unique(grid_triangles(grid.astype(float)), return_inverse=True)
            self._nodes.append(server.scene.add_mesh_simple(
                f"{name} of every row" if step == 1 else f"{name} of every {step} rows",
                grid.reshape(-1, 3)[used], renumbered.reshape(-1, 3).astype(np.uint32),
                color=SURFACE, side="double", flat_shading=True, visible=False,
                cast_shadow=False, receive_shadow=False,
            ))  # fmt: skip
            if step == 1:
                return

    def show(self, is_shown: bool, *, is_fine: bool) -> None:
        """Show the fine surface, the coarse one, or none."""
        for number, node in enumerate(self._nodes):
            is_last = number == len(self._nodes) - 1
            node.visible = is_shown and (is_fine == is_last or len(self._nodes) == 1)


class Pacing:
    """Watches the cameras of all browsers, and has shown what the slowest of them can draw.

    Parameters
    ----------
    server : viser.ViserServer
    levels : ints, rising; see `fringe3d.view.pace.levels_of`
    show : function that shows the points of a level
    """

    def __init__(
        self, server: viser.ViserServer, levels: Sequence[int], show: Callable[[int], None], /
    ) -> None:
        self._levels, self._show = levels, show
        self._details: dict[int, Detail] = {}
        self._waiting: dict[int, Any] = {}
        self._loop = server.get_event_loop()
        self._level = len(levels) - 1
        self._is_everything = False
        server.on_client_connect(self._joined)
        server.on_client_disconnect(self._left)

    def draw_everything(self, is_everything: bool, /) -> None:
        """Draw all points at rest, however long that takes; or again as many as are fast."""
        self._loop.call_soon_threadsafe(self._everything, is_everything)

    # What follows runs in the thread of the server's loop, one after the other.

    def _everything(self, is_everything: bool) -> None:
        self._is_everything = is_everything
        for number, detail in self._details.items():
            detail.is_everything = is_everything
            detail.level = detail.resting
            self._go_on(number)

    async def _joined(self, client: Any) -> None:
        detail = self._details[client.client_id] = Detail(self._levels)
        detail.is_everything = self._is_everything
        self._level_shown()

        async def moved(_camera: Any) -> None:
            detail.moved(time.monotonic())
            self._go_on(client.client_id)

        client.camera.on_update(moved)

    async def _left(self, client: Any) -> None:
        self._details.pop(client.client_id, None)
        waiting = self._waiting.pop(client.client_id, None)
        if waiting is not None:
            waiting.cancel()
        if self._details:  # else the server may have ended
            self._level_shown()

    def _rested(self, number: int) -> None:
        self._details[number].rested(time.monotonic())
        self._go_on(number)

    def _go_on(self, number: int) -> None:
        self._level_shown()
        detail = self._details[number]
        waiting = self._waiting.pop(number, None)
        if waiting is not None:
            waiting.cancel()
        if detail.level < detail.resting:
            wait_s = detail.wait_s(time.monotonic())
            self._waiting[number] = self._loop.call_later(wait_s, self._rested, number)

    def _level_shown(self) -> None:
        whole = len(self._levels) - 1
        level = min((detail.level for detail in self._details.values()), default=whole)
        if level != self._level:
            self._level = level
            self._show(level)
