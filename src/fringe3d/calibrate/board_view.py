"""What a device sees of a board in one pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """Corners of a board in the image of one device.

    Parameters
    ----------
    device : str
    pose : str; of the board; views of the same pose share it
    ids : (n,) int; numbers of the corners, each at most once
    pixels : (n, 2) float, px; (x, y) in the device
    sigma_px : (n,) float, px, > 0; standard deviation of each coordinate; the calibration scales
        those of a device by a common factor
    via : str; the camera through which a projector saw the board; "" for cameras

    Raises
    ------
    ValueError
        If shapes do not agree, a corner comes twice, or a number is not finite.
    """

    device: str
    pose: str
    ids: NDArray[np.int64]
    pixels: Floats
    sigma_px: Floats
    via: str

    def __init__(
        self,
        *,
        device: str,
        pose: str,
        ids: ArrayLike,
        pixels: ArrayLike,
        sigma_px: ArrayLike = 0.1,
        via: str = "",
    ) -> None:
        where = f"board view: {device}, {pose}"
        numbers = np.array(ids, np.int64).ravel()
        places = np.array(pixels, np.float64).reshape(-1, 2)
        if len(places) != len(numbers) or len(np.unique(numbers)) < len(numbers):
            raise ValueError(
                f"{where}: expected one pixel for each corner and each corner once, found "
                f"{len(places)} pixels and {len(np.unique(numbers))} corners"
            )
        sigma = np.array(np.broadcast_to(sigma_px, len(numbers)), np.float64)
        if not (np.isfinite(places).all() and (sigma > 0).all() and np.isfinite(sigma).all()):
            raise ValueError(f"{where}: expected finite pixels and positive sigma_px")
        for array in (numbers, places, sigma):
            array.setflags(write=False)
        for field, value in (
            ("device", device),
            ("pose", pose),
            ("ids", numbers),
            ("pixels", places),
            ("sigma_px", sigma),
            ("via", via),
        ):
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return len(self.ids)

    def renumbered(self, order: NDArray[np.int64], /) -> BoardView:
        """Return the view with corner i called ``order[i]``."""
        return replace(self, ids=order[self.ids])

    def take(self, which: NDArray[np.bool_], /) -> BoardView:
        """Return the view with some of the corners."""
        return replace(
            self, ids=self.ids[which], pixels=self.pixels[which], sigma_px=self.sigma_px[which]
        )

    def thinned(self, most: int, /) -> BoardView:
        """Return the view with every n-th corner, so that there are no more than `most`."""
        every = max(1, -(-len(self) // most))
        return self.take(np.arange(len(self)) % every == 0)
