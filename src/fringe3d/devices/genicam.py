"""GenICam cameras over GigE Vision, by viva-genicam (extra ``record``)."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame
from fringe3d.errors import DeviceError, DeviceLostError, FrameTimeoutError

SEARCH_MS = 800
NO_BLACK_LEVEL = 0.0


def viva() -> Any:
    """Return the library; say what to install where it is missing."""
    try:
        import viva_genicam
    except ModuleNotFoundError:
        raise DeviceError(
            "GigE cameras: expected the package viva-genicam, found none. Install it: "
            "pip install 'fringe3d[record]'"
        ) from None
    return viva_genicam


@contextlib.contextmanager
def _said_of(name: str) -> Iterator[None]:
    """Turn what the library raises into our words."""
    library = viva()
    try:
        yield
    except library.TransportError as problem:
        raise DeviceLostError(
            f"camera '{name}': expected an answer, found none: {problem}. Check cable, power and "
            "network, and that no other program holds the camera"
        ) from None
    except library.GenicamError as problem:
        kind = DeviceLostError if "io:" in str(problem) or "time" in str(problem) else DeviceError
        raise kind(f"camera '{name}': {problem}. Check cable, power and network") from None


class GigeCamera:
    """A GenICam camera over GigE Vision.

    Parameters
    ----------
    name : str; in the rig
    place : str; IP or MAC address; "" for the only camera there is
    clock : Clock; of the recorder, on which frames are dated
    """

    def __init__(self, name: str, place: str, /, *, clock: Clock) -> None:
        self.name, self._place, self._clock = name, place, clock
        self._camera: Any = None
        self._stream: Any = None
        self._offset_s: float | None = None

    def open(self) -> CameraInfo:
        """Connect and take control of the camera."""
        library = viva()
        with _said_of(self.name):
            found = library.discover(timeout_ms=SEARCH_MS, all=True)
            device = _chosen(self.name, self._place, found)
            self._camera = library.connect_gige(device)
            for feature in ("ExposureAuto", "GainAuto"):
                self._try(feature, "Off")
            self._try("AcquisitionMode", "Continuous")
            bits = self._monochrome()
            shape = (self._camera.get_integer("Height"), self._camera.get_integer("Width"))
            serial = self._text("DeviceSerialNumber")
        self._date()
        return CameraInfo(
            shape=shape,
            bit_depth=bits,
            black_level_dn=NO_BLACK_LEVEL,
            model=f"{device.manufacturer} {device.model} {serial} at {device.ip}",
        )

    def close(self) -> None:
        """Stop and let go."""
        with contextlib.suppress(Exception):  # it may be gone
            self._stop()
        if self._camera is not None:
            with contextlib.suppress(Exception):
                self._camera.close()
            self._camera = None

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Set exposure, gain and trigger; begin to listen to frames."""
        with _said_of(self.name):
            self._stop()
            self._camera.set_exposure_time(1000 * settings.exposure_ms)
            if settings.gain_db or self._has("Gain"):
                self._camera.set_gain(settings.gain_db)
            if settings.trigger == "free":
                self._camera.disable_trigger("FrameStart")
            else:
                source = "Software" if settings.trigger == "software" else "Line1"
                self._camera.enable_trigger("FrameStart", source)
            exposure_ms = self._camera.exposure_time() / 1000
            self._stream = self._camera.stream(deliver_incomplete=True)
            self._stream.__enter__()
        return CameraSettings(
            exposure_ms=exposure_ms, gain_db=settings.gain_db, trigger=settings.trigger
        )

    def trigger(self) -> None:
        """Expose one frame."""
        with _said_of(self.name):
            self._camera.trigger_software()

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame."""
        library = viva()
        try:
            frame = self._stream.next_frame(int(1000 * timeout_s))
        except library.TransportError as problem:
            self._require_control()
            if "timeout" not in str(problem):
                raise DeviceLostError(f"camera '{self.name}': {problem}") from None
            raise FrameTimeoutError(
                f"camera '{self.name}': expected a frame within {1000 * timeout_s:.0f} ms, found "
                "none. Check the trigger and the connection"
            ) from None
        if frame is None:
            raise DeviceLostError(f"camera '{self.name}': expected a frame, found the stream ended")
        image = np.asarray(frame.to_numpy())
        if image.ndim == 3:
            image = image[..., 1]
        when = self._clock.now()
        if frame.ts_host is not None and self._offset_s is not None:
            when = frame.ts_host + self._offset_s
        return Frame(image=image, number=frame.block_id, time_s=when, is_complete=frame.is_complete)

    def _require_control(self) -> None:
        if self._camera.control_state.value == "Lost":
            raise DeviceLostError(
                f"camera '{self.name}': expected to control it, found that it was lost. Check "
                "cable and power, and that no other program took it"
            )

    def _stop(self) -> None:
        if self._stream is not None:
            stream, self._stream = self._stream, None
            stream.__exit__(None, None, None)

    def _date(self) -> None:
        """Fit the camera's clock to the recorder's, where the camera has one."""
        try:
            self._camera.time_calibrate()
            self._offset_s = self._clock.now() - time.time()
        except viva().GenicamError:
            self._offset_s = None

    def _monochrome(self) -> int:
        """Choose a monochrome format; return its bits for each grey value."""
        kind = self._camera.get("PixelFormat")
        if not kind.startswith("Mono"):
            self._camera.set("PixelFormat", "Mono8")
            kind = "Mono8"
        bits = re.match(r"Mono(\d+)", kind)
        return int(bits[1]) if bits else 8

    def _try(self, feature: str, value: str) -> None:
        if self._has(feature):
            with contextlib.suppress(viva().GenicamError):
                self._camera.set(feature, value)

    def _has(self, feature: str) -> bool:
        return self._camera.node_info(feature) is not None

    def _text(self, feature: str) -> str:
        return str(self._camera.get(feature)) if self._has(feature) else ""


def _chosen(name: str, place: str, found: list[Any]) -> Any:
    """Return the camera of an address; say what there is where it is not."""
    wanted = place.lower()
    if not place and len(found) == 1:
        return found[0]
    for device in found:
        if wanted and wanted in (device.ip.lower(), device.mac.lower()):
            return device
    there = ", ".join(f"{d.ip} ({d.mac}, {d.manufacturer} {d.model})" for d in found) or "none"
    raise DeviceError(
        f"camera '{name}': expected a GigE camera '{place}' (IP or MAC address), found {there}. "
        "fringe3d devices lists them"
    )
