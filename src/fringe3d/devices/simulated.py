"""Cameras, projector and table that are simulated: the whole chain without hardware."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.devices.clock import VirtualClock
from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame, Grey
from fringe3d.devices.queue import FrameQueue
from fringe3d.errors import DeviceError
from fringe3d.simulate import Shown, Stage, hot_of, see, show

BASE_EXPOSURE_MS = 10.0
"""Exposure at which the simulated cameras collect the light that their optics say."""

READOUT_S = 0.002


@dataclass(frozen=True, slots=True)
class _Order:
    """What the projector was told to show, and from when on."""

    time_s: float
    index: int


class SimulatedWorld:
    """A scene before a rig: what the simulated devices share.

    A camera sees what the projector was told to show a latency ago. With the exposure of
    `BASE_EXPOSURE_MS` and the same seed its first frame of each pattern has the grey values of
    `fringe3d.simulate.record`, bit for bit; later ones have other noise.

    Parameters
    ----------
    stages : Stage, or function of the number of a table position that returns one
    seed : int
    clock : Clock or None (time passes only as somebody waits)
    latency_s : float, s; from an order to the light
    n_positions : int; positions of the table

    Examples
    --------
    >>> from fringe3d.simulate import OBJECTS, PRESETS, prepare
    >>> made = PRESETS["kolibri"]((64, 48))
    >>> world = SimulatedWorld(prepare(made.rig, made.scene(OBJECTS["sphere"]())), seed=1)
    >>> world.projector.load([np.zeros((768, 1024), np.uint8)])
    >>> world.projector.show(0)
    >>> camera = world.cameras[0]
    >>> camera.open().shape
    (48, 64)
    >>> camera.trigger()
    >>> camera.grab(1.0).image.shape
    (48, 64)
    """

    def __init__(
        self,
        stages: Stage | Callable[[int], Stage],
        /,
        *,
        seed: int,
        clock: Clock | None = None,
        latency_s: float = 0.03,
        n_positions: int = 1,
    ) -> None:
        first = stages if isinstance(stages, Stage) else stages(0)
        self._stages = stages
        self.stage, self.position, self.n_positions = first, 0, n_positions
        self.seed, self.latency_s = seed, latency_s
        self.clock: Clock = clock or VirtualClock()
        self._lock = threading.Lock()
        self._images: Sequence[Grey] = ()
        self._orders: list[_Order] = []
        self._shown: dict[int, Shown] = {}
        self._takes: dict[tuple[int, int], int] = {}
        self.projector = SimulatedProjector(self)
        self.table = SimulatedTable(self)
        self.cameras = tuple(
            SimulatedCamera(self, number) for number in range(len(first.rig.cameras))
        )

    def load(self, images: Sequence[Grey], /) -> None:
        """Hold other images; the projector shows nothing."""
        self._images = tuple(images)
        self._orders.clear()
        self._forget()

    def order(self, index: int, /) -> None:
        """Show an image from a latency later on."""
        if not 0 <= index < len(self._images):
            raise DeviceError(
                f"projector: expected an image 0 to {len(self._images) - 1}, found {index}. "
                "Load the images first"
            )
        with self._lock:
            self._render(index)  # beforehand: with the computer's clock it must not take time later
        self._orders.append(_Order(self.clock.now() + self.latency_s, index))

    def turn(self, position: int, /) -> None:
        """Turn the table to one of its positions."""
        self.position = position
        if not isinstance(self._stages, Stage):
            self.stage = self._stages(position)
        self._forget()

    def expose(self, number: int, start_s: float, settings: CameraSettings, /) -> Grey:
        """Return what a camera sees from `start_s` on."""
        factor = settings.exposure_ms / BASE_EXPOSURE_MS * 10 ** (settings.gain_db / 20)
        parts = self._parts(start_s, settings.exposure_s)
        with self._lock:  # cameras may be triggered at once
            seen = [(part, self._see(number, index, factor)) for index, part in parts.items()]
        if len(seen) == 1:
            return seen[0][1]
        mixed = sum(part * image.astype(np.float64) for part, image in seen)
        return np.asarray(np.rint(mixed), seen[0][1].dtype)

    def _forget(self) -> None:
        self._shown.clear()
        self._takes.clear()

    def _parts(self, start_s: float, exposure_s: float) -> dict[int, float]:
        """Return which images are shown during an exposure, and for which part of it."""
        parts: dict[int, float] = {}
        ends = [order.time_s for order in self._orders[1:]] + [np.inf]
        for order, end in zip(self._orders, ends, strict=True):
            low, high = max(order.time_s, start_s), min(end, start_s + exposure_s)
            if high > low:
                parts[order.index] = parts.get(order.index, 0.0) + (high - low) / exposure_s
        dark = 1 - sum(parts.values())
        return parts | ({-1: dark} if dark > 1e-9 else {})

    def _render(self, index: int) -> None:
        if index not in self._shown:
            if len(self._shown) > 1:  # blurred light for all depths is large: keep two
                self._shown.pop(next(iter(self._shown)))
            self._shown[index] = self._show(index)

    def _see(self, number: int, index: int, factor: float) -> Grey:
        self._render(index)
        take = self._takes.get((number, index), 0)
        self._takes[number, index] = take + 1
        entropy = [self.seed, 2, self.position, number, index + (index < 0) * 10**6]
        rng = np.random.default_rng(entropy + [take] * (take > 0))
        return see(self._shown[index], number, rng, self._hot(number), exposure=factor)

    def _show(self, index: int) -> Shown:
        assert self.stage.rig.projector is not None
        black = np.zeros(self.stage.rig.projector.shape, np.uint8)
        image = black if index < 0 else self._images[index]
        return show(self.stage, image, place=max(index, 0), n_images=max(len(self._images), 1),
                    seed=self.seed, position=self.position)  # fmt: skip

    def _hot(self, number: int) -> NDArray[np.float32]:
        return hot_of(self.stage, number, seed=self.seed)


class SimulatedProjector:
    """The projector of a simulated world."""

    triggers_cameras = False

    def __init__(self, world: SimulatedWorld, /) -> None:
        self._world = world
        self.name = _projector(world).name

    def open(self) -> tuple[int, int]:
        """Return (n_rows, n_cols)."""
        shape: tuple[int, int] = _projector(self._world).shape
        return shape

    def close(self) -> None:
        """Do nothing."""

    def load(self, images: Sequence[Grey], /) -> None:
        """Hold these images."""
        for image in images:
            if image.shape != self.open():
                raise DeviceError(
                    f"projector '{self.name}': expected images of {self.open()} (rows, columns), "
                    f"found {image.shape}. Make the plan for this projector"
                )
        self._world.load(images)

    def show(self, index: int, /) -> None:
        """Show one of them, after the latency."""
        self._world.order(index)


class SimulatedCamera:
    """One camera of a simulated world."""

    def __init__(self, world: SimulatedWorld, number: int, /) -> None:
        self._world, self._number = world, number
        self.name = world.stage.rig.cameras[number].name
        self._settings = CameraSettings(exposure_ms=BASE_EXPOSURE_MS)
        self._queue = FrameQueue(self.name, world.clock)
        self._count = 0

    def open(self) -> CameraInfo:
        """Return what the camera is."""
        optics, device = self._world.stage.setup.camera, self._world.stage.rig.cameras[self._number]
        return CameraInfo(
            shape=device.shape,
            bit_depth=optics.bit_depth,
            black_level_dn=optics.black_level_dn,
            noise=optics.noise if optics.gamma == 1 else None,
            model="simulated",
        )

    def close(self) -> None:
        """Forget the frames that were not grabbed."""
        self._queue.clear()

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Take other settings."""
        if settings.trigger != "software":
            raise DeviceError(
                f"camera '{self.name}': expected trigger software of a simulated camera, found "
                f"{settings.trigger}"
            )
        self._settings = settings
        return settings

    def trigger(self) -> None:
        """Expose."""
        now = self._world.clock.now()
        image = self._world.expose(self._number, now, self._settings)
        self._count += 1
        frame = Frame(image=image, number=self._count, time_s=now)
        self._queue.put(frame, now + self._settings.exposure_s + READOUT_S)

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame."""
        return self._queue.grab(timeout_s)


class SimulatedTable:
    """The table of a simulated world; it has few positions, and time passes as it turns."""

    name = "table"

    def __init__(self, world: SimulatedWorld, /, *, seconds_per_turn: float = 12.0) -> None:
        self._world, self._seconds = world, seconds_per_turn

    def open(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def turn_to(self, angle_deg: float, /) -> float:
        """Turn to the nearest position."""
        step = 360 / self._world.n_positions
        position = round(angle_deg / step) % self._world.n_positions
        way = abs(position - self._world.position) / self._world.n_positions
        self._world.clock.sleep(way * self._seconds)
        self._world.turn(position)
        return position * step


def _projector(world: SimulatedWorld) -> Any:
    projector = world.stage.rig.projector
    assert projector is not None
    return projector
