"""What is connected: cameras and outputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fringe3d.errors import DeviceError
from fringe3d.io.uvc import uvc_cameras


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundDevice:
    """A device that was found, or a way to find some that is not there.

    Parameters
    ----------
    kind : "camera" or "projector"
    address : str; for --camera NAME=ADDRESS or --projector ADDRESS
    about : str; maker, model, size
    """

    kind: str
    address: str
    about: str


def find_devices() -> tuple[tuple[FoundDevice, ...], tuple[str, ...]]:
    """Look for cameras and outputs by all libraries that are installed.

    Returns
    -------
    devices, and what could not be searched and why
    """
    found: list[FoundDevice] = []
    missing: list[str] = []
    searches: tuple[Callable[[], list[FoundDevice]], ...] = (_gige, _pylon, _uvc, _outputs)
    for search in searches:
        try:
            found += search()
        except DeviceError as problem:
            missing.append(str(problem))
    return tuple(found), tuple(missing)


def _gige() -> list[FoundDevice]:
    from fringe3d.devices.genicam import SEARCH_MS, viva

    library = viva()
    try:
        cameras = library.discover(timeout_ms=SEARCH_MS, all=True)
    except library.GenicamError as problem:
        raise DeviceError(f"GigE cameras: the search failed: {problem}") from None
    return [
        FoundDevice(kind="camera", address=f"gige:{c.ip}",
                    about=f"{c.manufacturer} {c.model}, MAC {c.mac}")
        for c in cameras
    ]  # fmt: skip


def _pylon() -> list[FoundDevice]:
    from fringe3d.devices.pylon import pylon

    devices = pylon().TlFactory.GetInstance().EnumerateDevices()
    return [
        FoundDevice(kind="camera", address=f"pylon:{d.GetSerialNumber()}",
                    about=f"Basler {d.GetModelName()}")
        for d in devices
    ]  # fmt: skip


def _uvc() -> list[FoundDevice]:
    return [
        FoundDevice(kind="camera", address=f"uvc:{number}", about="UVC camera")
        for number in uvc_cameras()
    ]


def _outputs() -> list[FoundDevice]:
    from fringe3d.devices.window import outputs

    return [
        FoundDevice(kind="projector", address=f"window:{o.number}",
                    about=f"{o.name}, {o.size[0]} x {o.size[1]} px at ({o.place[0]}, "
                    f"{o.place[1]}), {o.refresh_hz:g} Hz")
        for o in outputs()
    ]  # fmt: skip
