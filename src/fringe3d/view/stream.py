"""Clouds as they come, in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Event
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from fringe3d.model import ImageStack, Rig

MOST_POINTS = 150_000
"""More take longer to send than to measure."""

PREVIEW_COLUMNS = 320
SATURATED = (255, 60, 40)
BLANK = np.zeros((4, 4, 3), np.uint8)


class _Page:
    """A page in the browser, with a text."""

    def __init__(self, label: str, /, *, host: str, port: int) -> None:
        self.server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
        self.text = self.server.gui.add_markdown("waiting for images")

    @property
    def address(self) -> str:
        """Return where a browser finds the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """End the server."""
        self.server.stop()


class StreamView(_Page):
    """A page that shows the newest cloud, with how the measurement does and what a camera sees.

    Parameters
    ----------
    rig : Rig or None
    host : str; from which addresses the page can be reached: 127.0.0.1 is this machine alone
    port : int; the next free one is taken where it is in use
    """

    def __init__(self, rig: Rig | None, /, *, host: str, port: int) -> None:
        super().__init__("fringe3d live", host=host, port=port)
        self._rig = rig
        self._middle: NDArray[np.float64] | None = None
        self._reach = 1.0
        self.preview: Any = self.server.gui.add_image(BLANK, label="modulation (red: saturated)")
        self.cloud: Any = None

    def show(
        self, points_mm: NDArray[np.float64] | None, stack: ImageStack, text: str, /
    ) -> NDArray[np.float32]:
        """Show a cloud instead of the one before; return the points that are shown, (n, 3).

        Parameters
        ----------
        points_mm : (row, col, 3) float, mm, NaN where there is none; or None: that before stays
        stack : ImageStack of C1; its brightness colours the points
        text : str; what is said beside
        """
        self.text.content = text
        self.preview.image = preview_of(stack)
        if points_mm is None:
            return np.empty((0, 3), np.float32)
        valid = np.isfinite(points_mm).all(axis=-1)
        step = max(1, int(valid.sum()) // MOST_POINTS + 1) if valid.sum() > MOST_POINTS else 1
        points = points_mm[valid][::step]
        if len(points) == 0:
            return np.empty((0, 3), np.float32)
        middle = self._look_at(points) if self._middle is None else self._middle
        grey = stack.images.mean(axis=0)[valid][::step]
        bright = np.clip(255 * grey / max(float(np.percentile(grey, 99)), 1.0), 40, 255)
        shown = np.asarray(points - middle, np.float32)
        colours = np.repeat(bright.astype(np.uint8)[:, None], 3, axis=1)
        self.cloud = self.server.scene.add_point_cloud(
            "/points", shown, colours, point_size=1.5 * self._reach / np.sqrt(len(points)),
            precision="float32", point_shading="flat",
        )  # fmt: skip
        return shown

    def _look_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Keep the first cloud's middle as the place to look at, and return it."""
        middle = np.asarray(np.median(points, axis=0))
        self._middle = middle
        spread = np.percentile(points, 99, 0) - np.percentile(points, 1, 0)
        self._reach = max(float(np.linalg.norm(spread)), 1e-6)
        up, ahead = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        if self._rig is not None:
            _, up, ahead = self._rig.cameras[0].device_from_world.rotation * [[1], [-1], [1]]
        camera = self.server.initial_camera
        self.server.scene.set_up_direction(tuple(up))
        camera.position, camera.look_at, camera.up = (
            tuple(-1.3 * self._reach * ahead),
            (0, 0, 0),
            tuple(up),
        )
        return middle


class PreviewView(_Page):
    """A page that shows what all cameras see, before anything is recorded, and asks to go on.

    Parameters
    ----------
    names : sequence of str, of the cameras
    host, port : as in `StreamView`
    """

    def __init__(self, names: Sequence[str], /, *, host: str, port: int) -> None:
        super().__init__("fringe3d record", host=host, port=port)
        self.server.scene.world_axes.visible = False
        self.is_asked_for = Event()
        self.button = self.server.gui.add_button("record")
        self.button.on_click(lambda _: self.is_asked_for.set())
        self.previews: dict[str, Any] = {
            name: self.server.gui.add_image(BLANK, label=f"{name}: modulation (red: saturated)")
            for name in names
        }

    def show(self, stacks: Sequence[ImageStack], /) -> None:
        """Show the newest sequence of all cameras."""
        lines = []
        for stack in stacks:
            self.previews[stack.device_name].image = preview_of(stack)
            low, high = stack.images.min(axis=0), stack.images.max(axis=0)
            saturated = float((high >= stack.saturation_dn).mean())
            change = float(np.percentile((high - low) / stack.range_dn, 90))
            lines.append(f"**{stack.device_name}**: a tenth of the pixels changes by {change:.0%} "
                         f"of the range and more; {saturated:.1%} are saturated")  # fmt: skip
        self.text.content = "\n\n".join(lines)


def preview_of(stack: ImageStack, /) -> NDArray[np.uint8]:
    """Return how much each pixel changes from image to image, saturated ones in red.

    Returns
    -------
    (row, col, 3) uint8, at most 320 columns wide
    """
    step = max(1, stack.shape[1] // PREVIEW_COLUMNS)
    images = stack.images[:, ::step, ::step]
    low, high = images.min(axis=0), images.max(axis=0)
    change = (high - low).astype(np.float64) / stack.range_dn
    grey = np.clip(255 * change, 0, 255).astype(np.uint8)
    picture = np.repeat(grey[..., None], 3, axis=2)
    picture[high >= stack.saturation_dn] = SATURATED
    return picture
