"""What the recorder asks of cameras, projectors and tables, whoever made them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fringe3d.model import NoiseModel

Grey = NDArray[np.unsignedinteger[Any]]

Trigger = Literal["software", "hardware", "free"]
"""Frames come when the host asks, when a line says so, or one after the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """How a camera exposes.

    Parameters
    ----------
    exposure_ms : float, ms, > 0
    gain_db : float, dB
    trigger : "software", "hardware" or "free"

    Raises
    ------
    ValueError
        If a number is outside its domain.
    """

    exposure_ms: float = 10.0
    gain_db: float = 0.0
    trigger: Trigger = "software"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.exposure_ms) and self.exposure_ms > 0):
            raise ValueError(f"camera: exposure_ms: expected > 0, found {self.exposure_ms}")
        if not math.isfinite(self.gain_db):
            raise ValueError(f"camera: gain_db: expected a finite number, found {self.gain_db}")

    @property
    def exposure_s(self) -> float:
        """Return the exposure in seconds."""
        return self.exposure_ms / 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraInfo:
    """What an open camera says of itself.

    Parameters
    ----------
    shape : (n_rows, n_cols)
    bit_depth : int, 8 to 16; of a grey value
    black_level_dn : float, DN; grey value without light
    noise : NoiseModel or None (unknown)
    model : str; maker, type and serial number
    """

    shape: tuple[int, int]
    bit_depth: int = 8
    black_level_dn: float = 0.0
    noise: NoiseModel | None = None
    model: str = ""

    @property
    def saturation_dn(self) -> float:
        """Return the highest grey value, DN."""
        return float(2**self.bit_depth - 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One image as a camera delivers it.

    Parameters
    ----------
    image : (row, col) uint8 or uint16, DN
    number : int; the camera's own count: a gap is a lost frame
    time_s : float, s; start of the exposure (or the arrival, of cameras that do not say) on the
        clock of the recorder
    is_complete : bool; False where packets were lost, whose pixels then are black
    """

    image: Grey
    number: int
    time_s: float
    is_complete: bool = True


class Clock(Protocol):
    """Time: the computer's, or that of a simulation."""

    def now(self) -> float:
        """Return the time, s; it never goes back."""
        ...

    def sleep(self, seconds: float, /) -> None:
        """Let time pass."""
        ...


class Camera(Protocol):
    """A camera that is triggered, and hands out one frame after the other."""

    name: str

    def open(self) -> CameraInfo:
        """Connect; raise DeviceError where that is not possible."""
        ...

    def close(self) -> None:
        """Let go; harmless where the camera is not open."""
        ...

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Set exposure, gain and trigger; return what the camera made of it."""
        ...

    def trigger(self) -> None:
        """Expose one frame now (trigger "software" alone)."""
        ...

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame that was not grabbed yet.

        Raises
        ------
        FrameTimeoutError
            If none arrives within `timeout_s`; 0 asks without waiting.
        DeviceLostError
            If the camera does not answer any more.
        """
        ...


class Projector(Protocol):
    """A projector that holds images and shows one of them.

    A window holds them in the graphics memory; a DLP module is loaded with them, and triggers the
    cameras by a line as it shows one (`triggers_cameras`).
    """

    name: str
    triggers_cameras: bool

    def open(self) -> tuple[int, int]:
        """Connect; return (n_rows, n_cols)."""
        ...

    def close(self) -> None:
        """Let go; harmless where the projector is not open."""
        ...

    def load(self, images: Sequence[Grey], /) -> None:
        """Hold these images (row, col), uint8, instead of earlier ones."""
        ...

    def show(self, index: int, /) -> None:
        """Show one of them; return when the order is given (with vsync: at the swap)."""
        ...


class RotaryTable(Protocol):
    """A table that turns the object about one axis."""

    name: str

    def open(self) -> None:
        """Connect."""
        ...

    def close(self) -> None:
        """Let go; harmless where the table is not open."""
        ...

    def turn_to(self, angle_deg: float, /) -> float:
        """Turn, wait until it stands still, return the angle that was reached, deg."""
        ...
