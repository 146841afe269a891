"""Basler cameras by pypylon (extra ``record``)."""

from __future__ import annotations

import contextlib
import warnings
from typing import Any

import numpy as np

from fringe3d.devices.protocols import CameraInfo, CameraSettings, Clock, Frame
from fringe3d.errors import DeviceError, DeviceLostError, FrameTimeoutError

READY_MS = 1000


def pylon() -> Any:
    """Return the library; say what to install where it is missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of its wrapper (SWIG)
            from pypylon import pylon as library
    except ImportError:
        raise DeviceError(
            "Basler cameras: expected the package pypylon, found none. Install it: "
            "pip install 'fringe3d[pylon]'"
        ) from None
    return library


class PylonCamera:
    """A Basler camera.

    Parameters
    ----------
    name : str; in the rig
    place : str; serial number or user-defined name; "" for the only camera there is
    clock : Clock; of the recorder, on which frames are dated
    """

    def __init__(self, name: str, place: str, /, *, clock: Clock) -> None:
        self.name, self._place, self._clock = name, place, clock
        self._camera: Any = None
        self._trigger = "software"

    def open(self) -> CameraInfo:
        """Connect."""
        library = pylon()
        device = self._chosen(library)
        try:
            self._camera = library.InstantCamera(
                library.TlFactory.GetInstance().CreateDevice(device)
            )
            self._camera.Open()
        except library.GenericException as problem:
            raise DeviceError(f"camera '{self.name}': cannot be opened: {problem}") from None
        for feature in ("ExposureAuto", "GainAuto"):
            self._set(feature, "Off")
        kind = str(self._camera.PixelFormat.Value)
        if not kind.startswith("Mono"):
            self._set("PixelFormat", "Mono8")
            kind = "Mono8"
        bits = int("".join(c for c in kind if c.isdigit()) or 8)
        shape = (int(self._camera.Height.Value), int(self._camera.Width.Value))
        model = f"Basler {device.GetModelName()} {device.GetSerialNumber()}"
        return CameraInfo(shape=shape, bit_depth=bits, model=model)

    def close(self) -> None:
        """Stop and let go."""
        if self._camera is not None:
            with contextlib.suppress(Exception):  # it may be gone
                self._camera.StopGrabbing()
                self._camera.Close()
            self._camera = None

    def apply(self, settings: CameraSettings, /) -> CameraSettings:
        """Set exposure, gain and trigger; begin to listen to frames."""
        library = pylon()
        self._camera.StopGrabbing()
        time = "ExposureTime" if self._has("ExposureTime") else "ExposureTimeAbs"
        self._set(time, 1000 * settings.exposure_ms)
        self._set("Gain", settings.gain_db)
        self._set("TriggerSelector", "FrameStart")
        self._set("TriggerMode", "Off" if settings.trigger == "free" else "On")
        source = "Line1" if settings.trigger == "hardware" else "Software"
        self._set("TriggerSource", source)
        self._trigger = settings.trigger
        self._camera.StartGrabbing(library.GrabStrategy_OneByOne)
        exposure_ms = float(getattr(self._camera, time).Value) / 1000
        return CameraSettings(
            exposure_ms=exposure_ms, gain_db=settings.gain_db, trigger=settings.trigger
        )

    def trigger(self) -> None:
        """Expose one frame, once the camera is ready for it."""
        library = pylon()
        try:
            self._camera.WaitForFrameTriggerReady(READY_MS, library.TimeoutHandling_ThrowException)
            self._camera.ExecuteSoftwareTrigger()
        except library.GenericException as problem:
            raise DeviceLostError(f"camera '{self.name}': cannot be triggered: {problem}") from None

    def grab(self, timeout_s: float, /) -> Frame:
        """Return the oldest frame."""
        library = pylon()
        if self._camera.IsCameraDeviceRemoved():
            raise DeviceLostError(f"camera '{self.name}': expected an answer, found it removed")
        try:
            result = self._camera.RetrieveResult(
                int(1000 * timeout_s), library.TimeoutHandling_Return
            )
        except library.GenericException as problem:
            raise DeviceLostError(f"camera '{self.name}': {problem}") from None
        if result is None or not result.IsValid():
            raise FrameTimeoutError(
                f"camera '{self.name}': expected a frame within {1000 * timeout_s:.0f} ms, found "
                "none. Check the trigger and the connection"
            )
        with result:
            is_complete = bool(result.GrabSucceeded())
            image = np.array(result.Array) if is_complete else np.zeros(self._shape(), np.uint8)
            return Frame(image=image, number=int(result.ImageNumber), time_s=self._clock.now(),
                         is_complete=is_complete)  # fmt: skip

    def _shape(self) -> tuple[int, int]:
        return int(self._camera.Height.Value), int(self._camera.Width.Value)

    def _chosen(self, library: Any) -> Any:
        found = list(library.TlFactory.GetInstance().EnumerateDevices())
        if not self._place and len(found) == 1:
            return found[0]
        for device in found:
            if self._place and self._place in (
                device.GetSerialNumber(), device.GetUserDefinedName()
            ):  # fmt: skip
                return device
        there = ", ".join(f"{d.GetSerialNumber()} ({d.GetModelName()})" for d in found) or "none"
        raise DeviceError(
            f"camera '{self.name}': expected a Basler camera '{self._place}' (serial number or "
            f"name), found {there}. fringe3d devices lists them"
        )

    def _has(self, feature: str) -> bool:
        return self._camera.GetNodeMap().GetNode(feature) is not None

    def _set(self, feature: str, value: Any) -> None:
        library = pylon()
        if not self._has(feature):
            return
        try:
            getattr(self._camera, feature).Value = value
        except library.GenericException as problem:
            if feature in ("ExposureAuto", "GainAuto"):
                return
            raise DeviceError(
                f"camera '{self.name}': {feature}: {value} is refused: {problem}"
            ) from None
