"""A simulated laboratory in a process of its own: GigE Vision cameras, and a projector to order."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from multiprocessing.connection import Client, Connection, Listener
from typing import Any

from fringe3d.devices.clock import SystemClock
from fringe3d.devices.gige_simulator import GigeSimulator, See
from fringe3d.devices.protocols import CameraSettings, Grey
from fringe3d.devices.simulated import SimulatedWorld
from fringe3d.errors import DeviceError, DeviceLostError

HOST, PORT = "127.0.0.1", 3957
KEY = b"fringe3d"
"""Keeps other programs from talking by mistake; the port is open to this machine alone."""


def simulated_cameras(
    world: SimulatedWorld, /, *, lost: Sequence[tuple[int, int]] = ()
) -> tuple[GigeSimulator, ...]:
    """Return a GigE Vision camera for each one of a world, at 127.0.0.1, 127.0.0.2, ...

    Parameters
    ----------
    world : SimulatedWorld; with the computer's clock
    lost : (block, packet) of the first camera that never arrive
    """
    cameras: list[GigeSimulator] = []
    for number in reversed(range(len(world.cameras))):
        info = world.cameras[number].open()
        cameras.insert(
            0,
            GigeSimulator(
                _see(world, number),
                shape=info.shape,
                ip=f"127.0.0.{number + 1}",
                serial=world.cameras[number].name,
                bytes_per_pixel=1 if info.bit_depth == 8 else 2,
                lost=lost if number == 0 else (),
                others=tuple(cameras) if number == 0 else (),
            ),
        )
    for camera in cameras:
        camera.start()
    return tuple(cameras)


def _see(world: SimulatedWorld, number: int) -> See:
    def see(exposure_ms: float, gain_db: float) -> Grey:
        start = world.clock.now()
        settings = CameraSettings(exposure_ms=exposure_ms, gain_db=gain_db)
        image = world.expose(number, start, settings)
        time.sleep(max(0.0, start + exposure_ms / 1000 - world.clock.now()))
        return image

    return see


def serve(world: SimulatedWorld, /, *, port: int = PORT, ready: Any = None) -> None:
    """Run cameras and projector until the process is stopped.

    Parameters
    ----------
    world : SimulatedWorld; with the computer's clock
    port : int; where the projector takes its orders
    ready : multiprocessing event that is set when all is there, or None
    """
    if not isinstance(world.clock, SystemClock):
        raise DeviceError("lab: expected a world with the computer's clock")
    cameras = simulated_cameras(world)
    try:
        with Listener((HOST, port), authkey=KEY) as listener:
            if ready is not None:
                ready.set()
            while True:
                with listener.accept() as link:
                    _obey(world, link)
    finally:
        for camera in cameras:
            camera.stop()


def _obey(world: SimulatedWorld, link: Connection[Any, Any]) -> None:
    """Carry out the orders of one host until it leaves."""
    projector = world.projector
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            order, *arguments = link.recv()
            try:
                match order:
                    case "open":
                        link.send((True, projector.open()))
                    case "load":
                        projector.load(arguments[0])
                        link.send((True, None))
                    case "show":
                        projector.show(arguments[0])
                        link.send((True, None))
            except DeviceError as problem:
                link.send((False, str(problem)))


class LabProjector:
    """The projector of a simulated laboratory in another process.

    Parameters
    ----------
    place : str; HOST:PORT, or "" for this machine and the usual port
    """

    name, triggers_cameras = "projector", False

    def __init__(self, place: str = "", /) -> None:
        host, _, port = place.rpartition(":")
        if port and not port.isdigit():
            raise DeviceError(f"--projector lab:{place}: expected lab:HOST:PORT or lab:")
        self._address = host or HOST, int(port or PORT)
        self._link: Connection[Any, Any] | None = None

    def open(self) -> tuple[int, int]:
        """Connect; return (n_rows, n_cols)."""
        if self._link is None:
            try:
                self._link = Client(self._address, authkey=KEY)
            except OSError as problem:
                raise DeviceError(
                    f"projector: expected a simulated laboratory at {self._address[0]}:"
                    f"{self._address[1]}, found {problem}. Start one: fringe3d lab kolibri"
                ) from None
        rows, cols = self._ask("open")
        return rows, cols

    def close(self) -> None:
        """Leave."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def load(self, images: Sequence[Grey], /) -> None:
        """Hold these images."""
        self._ask("load", list(images))

    def show(self, index: int, /) -> None:
        """Show one of them."""
        self._ask("show", index)

    def _ask(self, *order: Any) -> Any:
        if self._link is None:
            raise DeviceError("projector: expected an open one, found it closed")
        try:
            self._link.send(order)
            is_done, answer = self._link.recv()
        except (OSError, EOFError) as problem:
            raise DeviceLostError(f"projector: expected an answer, found {problem}") from None
        if not is_done:
            raise DeviceError(answer)
        return answer
