"""Devices that are open while they are needed, and closed whatever happens."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

from fringe3d.acquire.shooting import GRACE_S, Devices
from fringe3d.devices import Camera, CameraSettings, Clock, Projector
from fringe3d.errors import DeviceError
from fringe3d.model import Rig


@contextmanager
def opened(
    cameras: Sequence[Camera],
    projector: Projector,
    settings: CameraSettings | Mapping[str, CameraSettings],
    clock: Clock,
    /,
    *,
    wait_s: float,
    grace_s: float = GRACE_S,
    rig: Rig | None = None,
) -> Iterator[Devices]:
    """Open cameras and projector; close them at the end, after an error and an interrupt, too.

    Parameters
    ----------
    cameras : sequence of Camera; the first is C1
    projector : Projector
    settings : CameraSettings of all, or by name
    clock : Clock
    wait_s : float, s; from an order to the light
    grace_s : float, s; for the way of a frame
    rig : Rig or None; sizes that differ from it are refused

    Raises
    ------
    DeviceError
        If a device does not open, or does not have the size of the rig.
    """
    with ExitStack() as closing:
        infos, made = {}, {}
        for camera in cameras:
            closing.callback(camera.close)
            infos[camera.name] = camera.open()
            wanted = settings if isinstance(settings, CameraSettings) else settings[camera.name]
            made[camera.name] = camera.apply(wanted)
        closing.callback(projector.close)
        shape = projector.open()
        devices = Devices(cameras=tuple(cameras), infos=infos, settings=made, projector=projector,
                          clock=clock, wait_s=wait_s, grace_s=grace_s)  # fmt: skip
        if rig is not None:
            _require_fit(devices, shape, rig)
        yield devices


def _require_fit(devices: Devices, projector_shape: tuple[int, int], rig: Rig) -> None:
    """Refuse devices of another size than those that were calibrated."""
    known = {device.name: device.shape for device in rig.cameras}
    found = {name: info.shape for name, info in devices.infos.items()}
    if rig.projector is not None:
        known[rig.projector.name] = rig.projector.shape
        found[rig.projector.name] = projector_shape
    for name, shape in found.items():
        if name not in known:
            raise DeviceError(
                f"camera '{name}': expected one of the rig's cameras "
                f"{', '.join(c.name for c in rig.cameras)}. Name it --camera NAME=ADDRESS"
            )
        if known[name] != shape:
            raise DeviceError(
                f"device '{name}': calibrated for {known[name][1]} x {known[name][0]} pixels, "
                f"found {shape[1]} x {shape[0]}. Set its region of interest, binning or "
                "resolution, or take the rig that belongs to it"
            )
