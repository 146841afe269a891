"""The images of one camera, with the plan that they follow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.model._array import frozen
from fringe3d.model.html import picture, table
from fringe3d.model.plan import PatternPlan
from fringe3d.model.response import Response


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """Variance of a grey value, ``read_noise_dn**2 + gain_dn_per_e * (I - black)`` (EMVA 1288).

    Parameters
    ----------
    read_noise_dn : float, DN, >= 0; dark noise with quantisation
    gain_dn_per_e : float, DN per electron, >= 0; the shot noise of the light
    """

    read_noise_dn: float
    gain_dn_per_e: float = 0.0

    def __post_init__(self) -> None:
        if not (self.read_noise_dn >= 0 and self.gain_dn_per_e >= 0):
            raise ValueError(f"noise: expected numbers >= 0, found {self}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fused:
    """Which of several exposures each pixel comes from.

    Parameters
    ----------
    exposure : (row, col) float32; amount of light, as the scan file counts it
    scale : (row, col) float32; the longest exposure over that of the pixel: grey values above black
        were multiplied by it, so that all have the brightness of one exposure
    """

    exposure: NDArray[np.float32]
    scale: NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageStack:
    """Recorded images of one camera.

    Parameters
    ----------
    images : (pattern, row, col) uint8 or uint16, DN
    plan : PatternPlan with as many patterns
    device_name : str
    saturation_dn : float, DN; grey values from here on are saturated
    black_level_dn : float, DN; grey value without light
    noise : NoiseModel or None (estimated from the images)
    is_lossy : bool; the image files were compressed with loss (JPEG)
    response : Response or None; what it does to the phase is taken out
    full_range_dn : float or None, DN; range of the sensor where it is not from black to saturation
    fused : Fused or None; how these grey values were put together from several exposures
    sigma_growth : (row, col) float32 or None; factor on the noise of the phase, where it rests on
        fewer steps
    """

    images: NDArray[np.unsignedinteger[Any]]
    plan: PatternPlan
    device_name: str
    saturation_dn: float
    black_level_dn: float = 0.0
    noise: NoiseModel | None = None
    is_lossy: bool = False
    response: Response | None = None
    full_range_dn: float | None = None
    fused: Fused | None = None
    sigma_growth: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        images = np.asarray(self.images)
        if images.ndim != 3 or images.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"camera '{self.device_name}': expected images (pattern, row, col) of 8 or 16 bit, "
                f"found shape {images.shape} of {images.dtype}"
            )
        if len(images) != self.plan.n_images:
            raise ValueError(
                f"camera '{self.device_name}': expected {self.plan.n_images} images as the plan "
                f"lists, found {len(images)}"
            )
        object.__setattr__(self, "images", frozen(images, images.dtype))

    @property
    def shape(self) -> tuple[int, int]:
        """Return (n_rows, n_cols) of the images."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def range_dn(self) -> float:
        """Return the range of grey values that the sensor resolves, DN."""
        return self.full_range_dn or self.saturation_dn - self.black_level_dn

    def subset(self, indices: Iterable[int] | Sequence[int]) -> ImageStack:
        """Return the stack that keeps only the images with these places."""
        places = list(indices)
        return replace(
            self,
            images=self.images if places == list(range(len(self.images))) else self.images[places],
            plan=self.plan.subset(places),
        )

    def with_response(self, response: Response | None, /) -> ImageStack:
        """Return the stack with another response."""
        return replace(self, response=response)

    def _repr_html_(self) -> str:
        rows, cols = self.shape
        figures = [
            ("size", f"{cols} x {rows} px, {self.images.dtype}"),
            ("saturated from", f"{self.saturation_dn:g} DN"),
            ("shown", "the first image"),
        ]
        title = f"{len(self.images)} images of camera '{self.device_name}'"
        return table(title, figures, more=picture(self.images[0], grey=True))
