"""From images to phase: wrapped phase, Gray code, several periods."""

from fringe3d.decode.apart import decode_apart
from fringe3d.decode.camera import CameraPhases, DirectionPhases, decode
from fringe3d.decode.exposures import fuse, without_saturated
from fringe3d.decode.filtering import filtered_camera
from fringe3d.decode.footprint import centred, centred_camera
from fringe3d.decode.mixing import mixed, mixed_camera
from fringe3d.decode.motion import drift_of, stilled
from fringe3d.decode.order import has_mirrored_neighbours
from fringe3d.decode.phase import wrapped_phase
from fringe3d.decode.response import ramp_of, response_from_fringes, response_from_ramp
from fringe3d.decode.sensor import SensorNoise, noise_from_repeats, noise_from_steps
from fringe3d.kernels import tell_of_compiling

__all__ = [
    "CameraPhases",
    "DirectionPhases",
    "SensorNoise",
    "centred",
    "centred_camera",
    "decode",
    "decode_apart",
    "drift_of",
    "filtered_camera",
    "fuse",
    "has_mirrored_neighbours",
    "mixed",
    "mixed_camera",
    "noise_from_repeats",
    "noise_from_steps",
    "ramp_of",
    "response_from_fringes",
    "response_from_ramp",
    "stilled",
    "without_saturated",
    "wrapped_phase",
]

tell_of_compiling()
