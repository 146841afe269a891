"""A projector that is a screen: a full-screen window, pixel by pixel, by glfw and moderngl."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fringe3d.devices.protocols import Grey
from fringe3d.errors import DeviceError, DeviceLostError

VERTEX = """
#version 330
void main() {  // one triangle that covers the screen
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 0.0, 1.0);
}
"""
FRAGMENT = """
#version 330
uniform sampler2D image;
uniform int rows;
out vec4 colour;
void main() {  // texels as they are: no interpolation, and rows from the top
    float grey = texelFetch(image, ivec2(gl_FragCoord.x, rows - 1 - int(gl_FragCoord.y)), 0).r;
    colour = vec4(grey, grey, grey, 1.0);
}
"""

SWAPS = 2
"""Buffers are swapped so often for one image: then both of them hold it, and the first swap has
come to the screen when the second one returns."""


@dataclass(frozen=True, slots=True)
class Output:
    """A screen or projector of this computer.

    Parameters
    ----------
    number : int; as glfw counts, 0 is the main one
    name : str
    size : (n_cols, n_rows)
    place : (x, y) of its top-left corner on the desktop
    refresh_hz : float
    """

    number: int
    name: str
    size: tuple[int, int]
    place: tuple[int, int]
    refresh_hz: float


def _libraries() -> tuple[Any, Any]:
    try:
        import glfw
        import moderngl
    except ModuleNotFoundError as problem:
        raise DeviceError(
            f"projector window: expected the packages glfw and moderngl, found no "
            f"'{problem.name}'. Install them: pip install 'fringe3d[record]'"
        ) from None
    return glfw, moderngl


def outputs() -> tuple[Output, ...]:
    """Return the screens of this computer; none where there is no display server.

    Raises
    ------
    DeviceError
        If glfw is not installed.
    """
    glfw, _ = _libraries()
    if not _is_begun(glfw):
        return ()
    found = []
    for number, monitor in enumerate(glfw.get_monitors()):
        mode = glfw.get_video_mode(monitor)
        name = glfw.get_monitor_name(monitor)
        found.append(
            Output(
                number=number,
                name=name.decode() if isinstance(name, bytes) else str(name),
                size=(mode.size.width, mode.size.height),
                place=tuple(glfw.get_monitor_pos(monitor)),
                refresh_hz=float(mode.refresh_rate),
            )
        )
    return tuple(found)


def _is_begun(glfw: Any) -> bool:
    with contextlib.suppress(Exception):
        glfw.set_error_callback(lambda *_: None)  # what it cannot do is said by us
    return bool(glfw.init())


class WindowProjector:
    """A projector (or screen) that shows a full-screen window.

    Images are textures of one byte a pixel, shown texel by texel; with vertical synchronisation no
    image is torn.

    Parameters
    ----------
    place : str; number or name of the output; "" for the last one
    size : (n_cols, n_rows) and place of a window without a screen of its own, for trials
    """

    name, triggers_cameras = "projector", False

    def __init__(
        self, place: str = "", /, *, region: tuple[int, int, int, int] | None = None
    ) -> None:
        self._place, self._region = place, region
        self._window: Any = None
        self._context: Any = None
        self._program: Any = None
        self._triangle: Any = None
        self._textures: list[Any] = []
        self._shape = (0, 0)

    def open(self) -> tuple[int, int]:
        """Open the window; return (n_rows, n_cols)."""
        if self._window is None:
            glfw, moderngl = _libraries()
            x, y, width, height = self._where()
            self._window = _full_screen(glfw, x, y, width, height)
            glfw.make_context_current(self._window)
            glfw.swap_interval(1)
            self._context = moderngl.create_context()
            self._program = self._context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
            self._program["rows"].value = height
            self._triangle = self._context.vertex_array(self._program, [])
            self._shape = (height, width)
            self._require_pixels(glfw)
            self.load([np.zeros(self._shape, np.uint8)])
            self.show(0)
        return self._shape

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            glfw, _ = _libraries()
            self._textures.clear()
            self._context.release()
            glfw.destroy_window(self._window)
            self._window = None

    def load(self, images: Sequence[Grey], /) -> None:
        """Hold these images in the graphics memory."""
        for texture in self._textures:
            texture.release()
        self._textures = []
        for image in images:
            if image.shape != self._shape or image.dtype != np.uint8:
                raise DeviceError(
                    f"projector: expected 8-bit images of {self._shape[1]} x {self._shape[0]} "
                    f"pixels (the whole output), found {image.dtype} of {image.shape[1]} x "
                    f"{image.shape[0]}. Make the patterns for this output, or set its resolution"
                )
            texture = self._context.texture(self._shape[::-1], 1, image.tobytes(), alignment=1)
            self._textures.append(texture)

    def show(self, index: int, /) -> None:
        """Show one of them; return when it is on its way to the screen."""
        glfw, moderngl = _libraries()
        glfw.poll_events()
        if glfw.window_should_close(self._window):
            raise DeviceLostError("projector: expected its window, found that it was closed")
        texture = self._textures[index]
        for _ in range(SWAPS):
            texture.use(0)
            self._context.viewport = (0, 0, self._shape[1], self._shape[0])
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
            glfw.swap_buffers(self._window)
        self._context.finish()

    def _where(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height of the output."""
        if self._region is not None:
            return self._region
        found = outputs()
        if not found:
            raise DeviceError(
                "projector window: expected a display server, found none. Log in at the machine, "
                "or set DISPLAY"
            )
        chosen = [o for o in found if self._place in (str(o.number), o.name)]
        chosen = chosen or ([found[-1]] if not self._place else [])
        if not chosen:
            there = "; ".join(f"{o.number} ({o.name}, {o.size[0]} x {o.size[1]})" for o in found)
            raise DeviceError(
                f"--projector window:{self._place}: expected one of the outputs {there}"
            )
        return (*chosen[0].place, *chosen[0].size)

    def _require_pixels(self, glfw: Any) -> None:
        """Refuse a window whose pixels are scaled by the desktop."""
        width, height = glfw.get_framebuffer_size(self._window)
        if (height, width) != self._shape:
            self.close()
            raise DeviceError(
                f"projector window: expected {self._shape[1]} x {self._shape[0]} pixels, found "
                f"{width} x {height}: the desktop scales this output. Set its scale to 100 %"
            )


def _full_screen(glfw: Any, x: int, y: int, width: int, height: int) -> Any:
    """Return a window without frame that covers a part of the desktop."""
    if not _is_begun(glfw):
        raise DeviceError(
            "projector window: expected a display server, found none. Log in at the machine, or "
            "set DISPLAY"
        )
    for hint, value in (
        (glfw.CONTEXT_VERSION_MAJOR, 3), (glfw.CONTEXT_VERSION_MINOR, 3),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE), (glfw.OPENGL_FORWARD_COMPAT, 1),
        (glfw.DECORATED, 0), (glfw.FLOATING, 1), (glfw.RESIZABLE, 0), (glfw.FOCUSED, 0),
        (glfw.AUTO_ICONIFY, 0), (glfw.VISIBLE, 0),
    ):  # fmt: skip
        glfw.window_hint(hint, value)
    window = glfw.create_window(width, height, "fringe3d", None, None)
    if not window:
        raise DeviceError(
            "projector window: expected OpenGL 3.3, found none. Install a graphics driver"
        )
    glfw.set_window_pos(window, x, y)
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    glfw.show_window(window)
    glfw.set_window_pos(window, x, y)
    return window
