"""One pattern, all cameras: show, wait, trigger, grab."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fringe3d.devices import Camera, CameraInfo, CameraSettings, Clock, Frame, Projector
from fringe3d.errors import FrameTimeoutError

GRACE_S = 0.5
"""How long a frame may be under way beyond its exposure."""

STALE_PART = 0.5
"""Of that time: by how much a frame may claim to be older than its trigger, for the clocks of
cameras are fitted to the computer's. A late frame is older: its trigger was waited for so long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """What is wrong with one frame, or was and is mended.

    Parameters
    ----------
    kind : str; as "missing", "incomplete", "repeated", "late", "size", "brightness", "exchanged"
    camera : str
    text : str
    like : int; place of the image that this one repeats, -1 for none
    """

    kind: str
    camera: str
    text: str
    like: int = -1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Devices:
    """Open devices that record together.

    Parameters
    ----------
    cameras : tuple of Camera; the first is C1
    infos : what they say of themselves, by name
    settings : how they expose, by name
    projector : Projector
    clock : Clock
    wait_s : float, s; from the order to show an image until it is certain to be there
    grace_s : float, s; for the way of a frame
    """

    cameras: tuple[Camera, ...]
    infos: Mapping[str, CameraInfo]
    settings: Mapping[str, CameraSettings]
    projector: Projector
    clock: Clock
    wait_s: float
    grace_s: float = GRACE_S

    @property
    def longest_s(self) -> float:
        """Return the longest exposure, s."""
        return max(settings.exposure_s for settings in self.settings.values())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """The frames of one pattern, by camera, and what was wrong on the way.

    Parameters
    ----------
    frames : frames that arrived, by camera
    troubles : what is wrong with this shot: it must be taken again
    notes : what was wrong on the way, and is no matter any more
    """

    frames: Mapping[str, Frame]
    troubles: tuple[Trouble, ...] = ()
    notes: tuple[Trouble, ...] = ()


def shoot(
    devices: Devices, index: int, last: Mapping[str, int], /, *, longer_s: float = 0.0
) -> Shot:
    """Show an image of the projector and take it with all cameras at once.

    Parameters
    ----------
    devices : Devices
    index : int; of the images that the projector holds
    last : number of the last frame of each camera, -1 for none
    longer_s : float, s; to wait beyond the usual

    Returns
    -------
    Shot

    Raises
    ------
    DeviceLostError
        If a device does not answer any more.
    """
    notes = [trouble for camera in devices.cameras for trouble in _drained(camera)]
    clock = devices.clock
    if devices.projector.triggers_cameras:
        triggered = clock.now()
        devices.projector.show(index)
    else:
        devices.projector.show(index)
        clock.sleep(devices.wait_s + longer_s)
        triggered = clock.now()
        for camera in devices.cameras:
            camera.trigger()
    frames: dict[str, Frame] = {}
    troubles: list[Trouble] = []
    for camera in devices.cameras:
        try:
            oldest = triggered - STALE_PART * devices.grace_s
            frame, late = _awaited(camera, oldest, devices.longest_s + devices.grace_s)
        except FrameTimeoutError as problem:
            troubles.append(Trouble(kind="missing", camera=camera.name, text=str(problem)))
            continue
        notes += late
        frames[camera.name] = frame
        wrong = _of_frame(camera.name, frame, devices.infos[camera.name], last[camera.name])
        troubles += wrong
    return Shot(frames=frames, troubles=tuple(troubles), notes=tuple(notes))


def _drained(camera: Camera) -> Sequence[Trouble]:
    """Take frames that came too late out of the camera."""
    late: list[Trouble] = []
    while True:
        try:
            frame = camera.grab(0.0)
        except FrameTimeoutError:
            return late
        late.append(_late(camera.name, frame))


def _awaited(camera: Camera, oldest: float, timeout_s: float) -> tuple[Frame, list[Trouble]]:
    """Return the frame of the trigger; frames that were exposed before it are passed over."""
    late: list[Trouble] = []
    while True:
        frame = camera.grab(timeout_s)
        if frame.time_s >= oldest:
            return frame, late
        late.append(_late(camera.name, frame))


def _late(camera: str, frame: Frame) -> Trouble:
    text = f"camera '{camera}': frame {frame.number} of an earlier trigger came late, and was left"
    return Trouble(kind="late", camera=camera, text=text)


def _of_frame(camera: str, frame: Frame, info: CameraInfo, last: int) -> list[Trouble]:
    """Tell what the frame itself says: its size, its number, and whether it is whole."""
    where = f"camera '{camera}': frame {frame.number}"
    if frame.image.shape != info.shape:
        found = f"{frame.image.shape[1]} x {frame.image.shape[0]}"
        text = f"{where}: expected {info.shape[1]} x {info.shape[0]} pixels, found {found}"
        return [Trouble(kind="size", camera=camera, text=text)]
    if not frame.is_complete:
        text = f"{where}: packets were lost on the way"
        return [Trouble(kind="incomplete", camera=camera, text=text)]
    if frame.number <= last:
        text = f"{where}: expected a number above {last}: this frame was there before"
        return [Trouble(kind="repeated", camera=camera, text=text)]
    return []
