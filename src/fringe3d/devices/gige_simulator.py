"""Cameras that speak GigE Vision and see whatever a function returns: for tests and trials.

The control protocol (GVCP) and the stream protocol (GVSP) as far as a host needs them: search,
registers, memory, heartbeat, software trigger, image streams with resending of lost packets.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.devices import gige_registers as reg
from fringe3d.devices.gige_registers import Registers
from fringe3d.errors import DeviceError

CONTROL_PORT = 3956
OVERHEAD = 36
"""Bytes of each stream packet for IP, UDP and GVSP."""

LEADER, TRAILER, PAYLOAD = 1, 2, 3
IMAGE = 1
KEPT_BLOCKS = 4
PAUSE_EVERY = 32
"""Packets after which the sender takes breath, so that receivers with small buffers keep up."""

See = Callable[[float, float], NDArray[np.unsignedinteger[Any]]]
"""Returns an image (row, col) for an exposure in ms and a gain in dB."""


class GigeSimulator:
    """One camera on an address of the loopback interface.

    Parameters
    ----------
    see : function of exposure (ms) and gain (dB) that returns the image (row, col)
    ip : str; each camera has its own, 127.0.0.1, 127.0.0.2, ...
    serial : str
    shape : (n_rows, n_cols)
    bytes_per_pixel : 1 or 2
    lost : (block, packet) that are not sent, nor sent again
    others : more cameras, for which this one answers a search, too

    Raises
    ------
    DeviceError
        If the port is in use.
    """

    def __init__(
        self,
        see: See,
        /,
        *,
        shape: tuple[int, int],
        ip: str = "127.0.0.1",
        serial: str = "1",
        bytes_per_pixel: int = 1,
        lost: Sequence[tuple[int, int]] = (),
        others: Sequence[GigeSimulator] = (),
    ) -> None:
        self._see, self._ip, self._lost, self._others = see, ip, set(lost), others
        self.registers = Registers(ip, serial, shape, bytes_per_pixel)
        self._began = time.monotonic_ns()
        self._block = 0
        self._blocks: dict[int, list[bytes]] = {}
        self._stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._control.bind((ip, CONTROL_PORT))
            self._stream.bind((ip, 0))
        except OSError as problem:
            self.stop()
            raise DeviceError(
                f"simulated camera: expected {ip}:{CONTROL_PORT} to be free, found {problem}. "
                "Does another simulated camera run?"
            ) from None
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def start(self) -> None:
        """Answer from now on."""
        self._thread.start()

    def stop(self) -> None:
        """Vanish: nothing is answered any more."""
        for link in (self._control, self._stream):
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            link.close()

    def _serve(self) -> None:
        while True:
            try:
                data, sender = self._control.recvfrom(2048)
            except OSError:
                return
            if len(data) < 8 or data[0] != 0x42:
                continue
            flags, command, _, number = struct.unpack(">xBHHH", data[:8])
            with contextlib.suppress(OSError):
                self._answer(command, flags, data[8:], number, sender)

    def _answer(
        self, command: int, flags: int, body: bytes, number: int, sender: tuple[str, int]
    ) -> None:
        if command == 0x40:
            self._resend(body)
            return
        if command == 0x02:
            for camera in (self, *self._others):
                self._reply(0x03, number, camera.registers.discovery(), sender)
            return
        reply = self._memory(command, body)
        if flags & 1:
            self._reply(command + 1, number, reply, sender)

    def _memory(self, command: int, body: bytes) -> bytes:
        """Read or write registers or memory; return the body of the reply."""
        if command == 0x80:
            addresses = struct.unpack(f">{len(body) // 4}I", body)
            return b"".join(self.registers.read(address, 4) for address in addresses)
        if command == 0x82:
            words = struct.unpack(f">{len(body) // 4}I", body)
            for address, value in zip(words[::2], words[1::2], strict=True):
                self._write(address, value.to_bytes(4, "big"))
            return struct.pack(">HH", 0, len(words) // 2)
        address = int.from_bytes(body[:4], "big")
        if command == 0x84:
            length = int.from_bytes(body[6:8], "big")
            return body[:4] + self.registers.read(address, length)
        if command == 0x86:
            self._write(address, body[4:])
            return struct.pack(">HH", 0, len(body) - 4)
        return b""

    def _reply(self, command: int, number: int, body: bytes, to: tuple[str, int]) -> None:
        self._control.sendto(struct.pack(">HHHH", 0, command, len(body), number) + body, to)

    def _write(self, address: int, data: bytes) -> None:
        """Write, and do what the register stands for."""
        value = int.from_bytes(data[:4], "big")
        if address == reg.TRIGGER and value:
            moment = self._ticks()
            threading.Thread(target=self._expose, args=(moment,), daemon=True).start()
        elif address == reg.LATCH and value & 2:
            self.registers.write(reg.LATCHED_HIGH, self._ticks().to_bytes(8, "big"))
        elif address == reg.START and value:
            self._block = 0
        else:
            self.registers.write(address, data)

    def _ticks(self) -> int:
        return time.monotonic_ns() - self._began

    def _expose(self, moment: int) -> None:
        """Take an image and send it."""
        image = self._see(
            self.registers.get_float(reg.EXPOSURE_US) / 1000,
            self.registers.get_float(reg.GAIN_DB),
        )
        self._block = self._block % 65535 + 1
        packets = self._packets(self._block, moment, image)
        self._blocks[self._block] = packets
        self._blocks.pop(self._block - KEPT_BLOCKS, None)
        for place, packet in enumerate(packets):
            self._send(self._block, place, packet)
            if place % PAUSE_EVERY == 0:
                time.sleep(0.0005)

    def _packets(
        self, block: int, moment: int, image: NDArray[np.unsignedinteger[Any]]
    ) -> list[bytes]:
        """Return leader, payload and trailer of an image."""
        rows, cols = image.shape
        data = image.astype(image.dtype.newbyteorder("<")).tobytes()
        kind = self.registers.get(reg.PIXEL_FORMAT)
        leader = struct.pack(">HHQIIIIIHH", 0, IMAGE, moment, kind, cols, rows, 0, 0, 0, 0)
        size = max(self.registers.get(reg.PACKET_SIZE) & 0xFFFF, 576) - OVERHEAD
        parts = [data[first : first + size] for first in range(0, len(data), size)]
        trailer = struct.pack(">HHI", 0, IMAGE, rows)
        bodies = [(LEADER, leader), *((PAYLOAD, part) for part in parts), (TRAILER, trailer)]
        return [
            struct.pack(">HHI", 0, block, (form << 24) | number) + body
            for number, (form, body) in enumerate(bodies)
        ]

    def _send(self, block: int, place: int, packet: bytes) -> None:
        if (block, place) in self._lost:
            return
        port = self.registers.get(reg.STREAM_PORT) & 0xFFFF
        address = socket.inet_ntoa(self.registers.read(reg.STREAM_ADDRESS, 4))
        if port:
            with contextlib.suppress(OSError):
                self._stream.sendto(packet, (address, port))

    def _resend(self, body: bytes) -> None:
        """Send packets of a block again."""
        _, block, first, last = struct.unpack(">HHII", body[:12])
        packets = self._blocks.get(block, [])
        for place in range(first & 0xFFFFFF, min(last & 0xFFFFFF, len(packets) - 1) + 1):
            self._send(block, place, packets[place])
