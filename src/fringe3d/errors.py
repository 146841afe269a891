"""What can go wrong, and how it is said.

Every message reads *where: what was expected, what was found, what to do*.
Contract violations raise; a bad pixel never does (see ``model.rejection``).
"""

from __future__ import annotations


class Fringe3DError(Exception):
    """A mistake that the user can mend; shown without a traceback."""


class RigError(Fringe3DError, ValueError):
    """The rig (or its file) cannot be used."""


class PlanError(Fringe3DError, ValueError):
    """The plan (or the file that describes a recording) cannot be used."""


class ImageError(Fringe3DError, ValueError):
    """An image is missing, unreadable, or not what the plan says."""


class MethodError(Fringe3DError, ValueError):
    """Rig and plan do not support what was asked for."""


class CalibrationError(Fringe3DError, ValueError):
    """The images contradict the calibration."""


class EmptyResultError(Fringe3DError, ValueError):
    """Not a single pixel gave a point."""


class RegistrationError(Fringe3DError, ValueError):
    """Views cannot be placed without doubt."""


class OutputError(Fringe3DError):
    """The result cannot be written."""


class AccuracyWarning(UserWarning):
    """A result that can be used but is less good than it should be."""


class DeviceError(Fringe3DError):
    """A camera, projector or table does not do what it was asked for."""


class FrameTimeoutError(DeviceError):
    """A frame did not arrive in time."""


class DeviceLostError(DeviceError):
    """A device does not answer any more."""
