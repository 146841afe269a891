"""What may be wrong with a recording: the faults, their names and their cures."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """A kind of fault; the value is its name in messages and files."""

    MISSING_FILES = "missing-files"
    MISSING_IMAGE = "missing-image"
    REPEATED_IMAGE = "repeated-image"
    EXCHANGED_IMAGES = "exchanged-images"
    SHIFT_DIRECTION = "shift-direction"
    PERIOD = "wrong-period"
    GRAY_POLARITY = "gray-polarity"
    GRAY_ORDER = "gray-bit-order"
    SEQUENCE = "wrong-sequence"
    SATURATION = "saturation"
    TOO_DARK = "too-dark"
    GAMMA = "gamma"
    DEFOCUS = "defocus"
    FLICKER = "flicker"
    MOVEMENT = "movement"
    CALIBRATION = "wrong-calibration"
    CAMERAS = "cameras-exchanged"
    OUTSIDE = "outside-volume"
    AMBIGUOUS = "too-few-images"

    @property
    def cure(self) -> str:
        """Return what helps."""
        return _CURES[self]


_CURES = {
    Kind.MISSING_FILES: "record again, or describe what is there (fringe3d import)",
    Kind.MISSING_IMAGE: "record again, slower or triggered; check the connection to the camera",
    Kind.REPEATED_IMAGE: "record again, and wait for the projector before each exposure",
    Kind.EXCHANGED_IMAGES: "put the sequence of scan.toml into the order of recording, or list the "
    "images in image_indices",
    Kind.SHIFT_DIRECTION: "change the sign of shift_direction of the fringes in scan.toml",
    Kind.PERIOD: "correct period_px in scan.toml, or what was projected",
    Kind.GRAY_POLARITY: "change bright_is of the Gray code in scan.toml (1 to 0, or 0 to 1)",
    Kind.GRAY_ORDER: 'set order of the Gray code in scan.toml ("msb-first" or "lsb-first")',
    Kind.SEQUENCE: "compare the sequence of scan.toml with what was projected, image by image",
    Kind.SATURATION: "expose shorter, or close the aperture; against gloss spray the surface",
    Kind.TOO_DARK: "expose longer, open the aperture, or keep other light out",
    Kind.GAMMA: "take it out with --response self, switch gamma off, or project through the "
    "measured response; with 5 steps or more it disturbs less",
    Kind.DEFOCUS: "focus projector and cameras on the object, close the aperture, or project "
    "wider fringes",
    Kind.FLICKER: "expose for whole periods of the lamp and of the mains; switch automatic "
    "exposure and gain off",
    Kind.MOVEMENT: "hold object and rig still during the recording, or record faster",
    Kind.CALIBRATION: "check that rig.toml belongs to these images; else calibrate again "
    "(--self-calibrate where devices have moved)",
    Kind.CAMERAS: "exchange the names of the cameras in scan.toml (or in rig.toml)",
    Kind.OUTSIDE: "move the object, or correct the measuring volume in rig.toml (--depth MIN:MAX)",
    Kind.AMBIGUOUS: "record a Gray code or more bits of it, or narrow the depth range (--depth)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A fault of a recording, with its evidence.

    Parameters
    ----------
    kind : Kind
    camera : str; name of the camera whose images show it, "" for the rig
    figure : str; what was measured, with its unit
    value, limit : float; the figure, and from where on it is a fault
    text : str; what is seen
    cure : str; what helps; that of the kind if empty
    images : tuple of int; places of the images concerned
    """

    kind: Kind
    camera: str
    figure: str
    value: float
    limit: float
    text: str
    cure: str = ""
    images: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.cure:
            object.__setattr__(self, "cure", self.kind.cure)
