"""Cameras, projectors and rotary tables behind small protocols."""

from fringe3d.devices.clock import SystemClock, VirtualClock
from fringe3d.devices.faults import FaultyCamera, FaultyProjector, FrameFault
from fringe3d.devices.protocols import (
    Camera,
    CameraInfo,
    CameraSettings,
    Clock,
    Frame,
    Grey,
    Projector,
    RotaryTable,
    Trigger,
)
from fringe3d.devices.replay import FileCamera, FileProjector, replayed

__all__ = [
    "Camera",
    "CameraInfo",
    "CameraSettings",
    "Clock",
    "FaultyCamera",
    "FaultyProjector",
    "FileCamera",
    "FileProjector",
    "Frame",
    "FrameFault",
    "Grey",
    "Projector",
    "RotaryTable",
    "SystemClock",
    "Trigger",
    "VirtualClock",
    "replayed",
]
