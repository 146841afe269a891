"""Devices by their addresses: what stands on the command line."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from pathlib import Path

from fringe3d.devices.protocols import Camera, Clock, Projector
from fringe3d.devices.replay import FileCamera, FileProjector, replayed
from fringe3d.errors import DeviceError
from fringe3d.io.recording import read_scan

CAMERA_KINDS = ("gige", "pylon", "uvc", "file")
PROJECTOR_KINDS = ("window", "lab", "file")


def parse_address(text: str, kinds: Sequence[str], what: str, /) -> tuple[str, str]:
    """Return kind and place of an address KIND:PLACE.

    Examples
    --------
    >>> parse_address("gige:192.168.1.20", CAMERA_KINDS, "--camera")
    ('gige', '192.168.1.20')
    """
    kind, _, place = text.partition(":")
    if kind not in kinds:
        close = difflib.get_close_matches(kind, kinds, n=1)
        hint = f"Did you mean '{close[0]}'?" if close else "See fringe3d devices"
        raise DeviceError(
            f"{what} {text}: expected KIND:PLACE with one of the kinds {', '.join(kinds)}, found "
            f"'{kind}'. {hint}"
        )
    return kind, place


def cameras_at(addresses: Sequence[str], clock: Clock, /) -> tuple[Camera, ...]:
    """Return the cameras of addresses NAME=KIND:PLACE, not yet open.

    Raises
    ------
    DeviceError
        If an address is none, or a library is not installed.
    """
    cameras = []
    for text in addresses:
        name, equals, address = text.partition("=")
        if not equals or not name:
            raise DeviceError(
                f"--camera {text}: expected NAME=KIND:PLACE with the name of a camera of the rig, "
                "as c1=gige:192.168.1.20"
            )
        cameras.append(_camera(name, *parse_address(address, CAMERA_KINDS, "--camera"), clock))
    return tuple(cameras)


def projector_at(address: str, clock: Clock, /) -> Projector:
    """Return the projector of an address KIND:PLACE, not yet open."""
    kind, place = parse_address(address, PROJECTOR_KINDS, "--projector")
    if kind == "file":
        return _replayed(place, clock)[1]
    if kind == "lab":
        from fringe3d.devices.lab import LabProjector

        return LabProjector(place)
    from fringe3d.devices.window import WindowProjector

    return WindowProjector(place)


def devices_of_files(path: Path, clock: Clock, /) -> tuple[tuple[FileCamera, ...], FileProjector]:
    """Return cameras and projector that replay a scan."""
    return replayed(read_scan(path, with_rig=False), clock=clock)


def _replayed(place: str, clock: Clock) -> tuple[tuple[FileCamera, ...], FileProjector]:
    return devices_of_files(Path(place), clock)


def _camera(name: str, kind: str, place: str, clock: Clock) -> Camera:
    makers: dict[str, Callable[[str, str, Clock], Camera]] = {
        "gige": _gige, "pylon": _pylon, "uvc": _uvc, "file": _file,
    }  # fmt: skip
    return makers[kind](name, place, clock)


def _gige(name: str, place: str, clock: Clock) -> Camera:
    from fringe3d.devices.genicam import GigeCamera

    return GigeCamera(name, place, clock=clock)


def _pylon(name: str, place: str, clock: Clock) -> Camera:
    from fringe3d.devices.pylon import PylonCamera

    return PylonCamera(name, place, clock=clock)


def _uvc(name: str, place: str, clock: Clock) -> Camera:
    from fringe3d.devices.uvc import UvcCamera

    return UvcCamera(name, place, clock=clock)


def _file(name: str, place: str, clock: Clock) -> Camera:
    for camera in _replayed(place, clock)[0]:
        if camera.name == name:
            return camera
    raise DeviceError(f"--camera {name}=file:{place}: expected a scan with a camera '{name}'")
