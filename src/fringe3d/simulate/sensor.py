"""Light to grey values: the sensor, as in EMVA 1288."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fringe3d.simulate.optics import CameraOptics

NARROW_VARIANCE = 0.5
"""px**2; up to here three taps are all positive, and beyond a sampled Gaussian is right."""

FEW_ELECTRONS = 50.0
"""Below, electrons are counted (Poisson); above, the normal distribution is the same to 2 %."""


def expose(
    light: NDArray[np.float32],
    optics: CameraOptics,
    rng: np.random.Generator,
    hot: NDArray[np.float32],
    /,
) -> NDArray[np.unsignedinteger]:
    """Return the grey values of one image.

    Parameters
    ----------
    light : (row, col) float32; 1 for white paper at the reference
    optics : CameraOptics
    rng : Generator
    hot : (row, col) float32; offset of hot pixels, parts of the full well

    Notes
    -----
    Electrons: mean ``exposure * full_well * light``, variance mean + read_noise**2; grey values
    ``black + (top - black) (electrons / full_well)**gamma``, rounded and clipped.
    """
    mean = np.maximum(
        _blurred(light, optics.blur_px) * np.float32(optics.exposure * optics.full_well_e), 0
    )
    variance = mean + np.float32(optics.read_noise_e**2)
    electrons = mean + np.sqrt(variance) * rng.standard_normal(mean.shape, np.float32)
    few = mean < FEW_ELECTRONS
    if few.any():
        counted = rng.poisson(mean[few]).astype(np.float32)
        read = np.float32(optics.read_noise_e) * rng.standard_normal(len(counted), np.float32)
        electrons[few] = counted + read
    signal = electrons / np.float32(optics.full_well_e) + hot
    if optics.gamma != 1:
        signal = np.sign(signal) * np.abs(signal) ** np.float32(optics.gamma)
    grey = np.float32(optics.black_level_dn) + signal * np.float32(
        optics.top_dn - optics.black_level_dn
    )
    dtype = np.uint8 if optics.bit_depth == 8 else np.uint16
    return np.asarray(np.clip(np.rint(grey), 0, optics.top_dn), dtype)


def _blurred(light: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Return the image behind the lens.

    A sampled Gaussian narrower than a pixel has too little variance; three taps have it exactly.
    """
    variance = sigma_px**2
    if variance >= NARROW_VARIANCE:
        wide = cv2.GaussianBlur(light, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(wide, np.float32)
    taps = np.array([variance / 2, 1 - variance, variance / 2])
    narrow = cv2.sepFilter2D(light, -1, taps, taps, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(narrow, np.float32)


def hot_pixels(
    shape: tuple[int, int], optics: CameraOptics, rng: np.random.Generator, /
) -> NDArray[np.float32]:
    """Return the constant offsets of hot pixels, parts of the full well, (row, col)."""
    offset = np.zeros(shape, np.float32)
    hot = rng.random(shape) < optics.hot_pixels
    offset[hot] = rng.uniform(0.1, 1.0, int(hot.sum()))
    return offset
