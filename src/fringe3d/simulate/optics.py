"""What real projectors, cameras, surfaces and recordings do to an ideal image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringe3d.model import NoiseModel

MOST = {"blur_px": 50.0, "aperture_mm": 200.0, "vibration_px": 1000.0}
"""Larger values are slips of the pen; the blur would take minutes and leave nothing to see."""


def _require(condition: bool, what: str, expected: str, found: object) -> None:
    if not condition:
        raise ValueError(f"{what}: expected {expected}, found {found}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """How the object's surface reflects light.

    Parameters
    ----------
    albedo : float, 0 to 1; where the mesh has no brightness of its own
    texture : "none", "mottled", "speckle" or "checker"; multiplies the albedo
    texture_mm : float, mm; size of the texture's features
    contrast : float, 0 to 1; of the texture
    gloss : float; strength of the glossy lobe beside Lambert's
    gloss_exponent : float; its narrowness (20 satin, 200 polished)
    """

    albedo: float = 0.8
    texture: str = "none"
    texture_mm: float = 3.0
    contrast: float = 0.25
    gloss: float = 0.0
    gloss_exponent: float = 40.0

    def __post_init__(self) -> None:
        kinds = ("none", "mottled", "speckle", "checker")
        _require(0 < self.albedo <= 1, "surface: albedo", "a number in (0, 1]", self.albedo)
        _require(self.texture in kinds, "surface: texture", f"one of {kinds}", self.texture)
        _require(self.texture_mm > 0, "surface: texture_mm", "a positive length", self.texture_mm)
        _require(0 <= self.contrast <= 1, "surface: contrast", "0 to 1", self.contrast)
        _require(self.gloss >= 0, "surface: gloss", "a number >= 0", self.gloss)
        _require(self.gloss_exponent > 0, "surface: gloss_exponent", "a positive number",
                 self.gloss_exponent)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorOptics:
    """A projector as a light source: a pixel of value v shines with ``dark + (1-dark) v**gamma``.

    Parameters
    ----------
    gamma : float
    dark : float; light of a black pixel over that of a white one (1 / contrast)
    blur_px : float, projector px; standard deviation of the lens blur in focus (MTF)
    aperture_mm : float, mm; diameter of the pupil; blurs what is out of focus; 0 for none
    focus_mm : float, mm; depth that is in focus; 0 for the point nearest to all optical axes
    vignetting : float; part of the natural fall-off cos^4 towards the border, as a screen
        across the axis shows it
    flicker : float; relative standard deviation of the lamp from image to image
    vibration_px : float, projector px; random displacement from image to image, each axis
    """

    gamma: float = 1.0
    dark: float = 0.002
    blur_px: float = 0.5
    aperture_mm: float = 0.0
    focus_mm: float = 0.0
    vignetting: float = 0.5
    flicker: float = 0.0
    vibration_px: float = 0.0

    def __post_init__(self) -> None:
        _require(self.gamma > 0, "projector: gamma", "a positive number", self.gamma)
        _require(self.dark <= 1, "projector: dark", "0 to 1", self.dark)
        for key in ("dark", "blur_px", "aperture_mm", "focus_mm", "vignetting", "flicker",
                    "vibration_px"):  # fmt: skip
            value, most = getattr(self, key), MOST.get(key, np.inf)
            _require(0 <= value <= most, f"projector: {key}", f"0 to {most:g}", value)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptics:
    """A camera's lens and sensor (EMVA 1288: electrons, gain, read noise, quantisation).

    Parameters
    ----------
    exposure : float; part of the full well that white paper fills which faces the projector at
        the middle of the volume
    full_well_e : float, electrons; at which the highest grey value is reached
    read_noise_e : float, electrons
    bit_depth : 8, 10, 12 or 16
    black_level_dn : float, DN; grey value without light
    gamma : float; response ``signal**gamma``, 1 is linear
    blur_px : float, px; standard deviation of the lens blur in focus
    aperture_mm, focus_mm : float, mm; as for `ProjectorOptics`
    vignetting : float; part of the natural fall-off cos^4
    hot_pixels : float; part of the pixels that are hot: they show a random constant offset
    """

    exposure: float = 0.8
    full_well_e: float = 10_000.0
    read_noise_e: float = 12.0
    bit_depth: int = 8
    black_level_dn: float = 2.0
    gamma: float = 1.0
    blur_px: float = 0.4
    aperture_mm: float = 0.0
    focus_mm: float = 0.0
    vignetting: float = 0.5
    hot_pixels: float = 0.0

    def __post_init__(self) -> None:
        _require(self.exposure > 0, "camera: exposure", "a positive number", self.exposure)
        _require(self.full_well_e > 0, "camera: full_well_e", "electrons > 0", self.full_well_e)
        _require(self.gamma > 0, "camera: gamma", "a positive number", self.gamma)
        depths = (8, 10, 12, 16)
        _require(self.bit_depth in depths, "camera: bit_depth", f"one of {depths}", self.bit_depth)
        _require(0 <= self.hot_pixels < 1, "camera: hot_pixels", "0 to 1", self.hot_pixels)
        _require(0 <= self.black_level_dn < self.top_dn, "camera: black_level_dn",
                 f"0 to {self.top_dn:g}", self.black_level_dn)  # fmt: skip
        for key in ("read_noise_e", "blur_px", "aperture_mm", "focus_mm", "vignetting"):
            value, most = getattr(self, key), MOST.get(key, np.inf)
            _require(0 <= value <= most, f"camera: {key}", f"0 to {most:g}", value)

    @property
    def top_dn(self) -> float:
        """Return the highest grey value, DN."""
        return float(2**self.bit_depth - 1)

    @property
    def gain_dn_per_e(self) -> float:
        """Return the grey values per electron: the full well reaches the highest one."""
        return (self.top_dn - self.black_level_dn) / self.full_well_e

    @property
    def noise(self) -> NoiseModel:
        """Return the noise of a grey value, with that of the quantisation (1/12 DN^2)."""
        gain = self.gain_dn_per_e
        read = float(np.hypot(self.read_noise_e * gain, 12**-0.5))
        return NoiseModel(read_noise_dn=read, gain_dn_per_e=gain)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """What happens while the images are recorded.

    Parameters
    ----------
    ambient : float; light without the projector, over that of a white pixel
    interreflection : bool; light that comes by way of one other surface
    frame_ms : float, ms; time from one image to the next
    velocity_mm_s : (3,) float, mm/s; the object moves, world frame
    spin_deg_s : float, deg/s; the object turns about the world's z axis
    dropped : places of the images that never arrived; later ones move up
    repeated : places at which the projector still showed the pattern before
    exposures : the sequence is recorded once with each of these multiples of the camera's exposure
    """

    ambient: float = 0.03
    interreflection: bool = False
    frame_ms: float = 10.0
    velocity_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin_deg_s: float = 0.0
    dropped: tuple[int, ...] = ()
    repeated: tuple[int, ...] = ()
    exposures: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _require(self.ambient >= 0, "recording: ambient", "a number >= 0", self.ambient)
        _require(self.frame_ms > 0, "recording: frame_ms", "a positive time", self.frame_ms)
        _require(all(e > 0 for e in self.exposures), "recording: exposures", "numbers > 0",
                 self.exposures)  # fmt: skip

    @property
    def moves(self) -> bool:
        """Tell whether the object moves between images."""
        return any(self.velocity_mm_s) or self.spin_deg_s != 0
