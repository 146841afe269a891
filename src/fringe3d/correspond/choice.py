"""The candidates of each pixel, and which of them is chosen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _orders
from fringe3d.correspond.bias import Evidence


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The orders on each pixel's segment, (n, m), and what the devices show of them.

    Column a stands for the order ``first + a * label_step``, or for none (`NO_ORDER`).
    """

    first: NDArray[np.int32]
    label_step: int
    orders: NDArray[np.int32]
    shown: NDArray[np.float32]
    extras: NDArray[np.float32]
    is_inside: NDArray[np.bool_]

    def place_of(
        self, orders: NDArray[Any], index: NDArray[Any], /
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return at which place the pixels `index` list given orders, and whether they do."""
        hits = self.orders[index] == orders[:, None]
        return hits.argmax(axis=1), hits.any(axis=1)


class Placed(Protocol):
    """Chosen orders, (n,), and the depths of their points, mm."""

    @property
    def order(self) -> NDArray[np.int32]:
        """Return the orders, `NO_ORDER` for none."""

    @property
    def depth_mm(self) -> NDArray[np.float64]:
        """Return the distances along the rays."""


@dataclass(frozen=True, eq=False)
class Choice:
    """Which candidate is chosen for each valid pixel.

    Parameters
    ----------
    candidates : Candidates
    costs : (n, m) float; squared residual over its variance, NaN where C2 does not see the point
    place : (n,) int; of the one chosen
    probability : (n,) float
    outside : (n,) float; probability that the point lies outside the volume
    """

    candidates: Candidates
    costs: NDArray[np.float32]
    place: NDArray[np.intp]
    probability: NDArray[np.float64]
    outside: NDArray[np.float64]

    @cached_property
    def order(self) -> NDArray[np.int32]:
        """Return the chosen orders, (n,)."""
        return self._at(self.candidates.orders)

    @cached_property
    def cost(self) -> NDArray[np.float64]:
        """Return what C2 has against them, (n,); NaN where it does not see the point."""
        return self._at(self.costs).astype(np.float64)

    @cached_property
    def is_inside(self) -> NDArray[np.bool_]:
        """Tell whether the points lie in the volume, (n,)."""
        return self._at(self.candidates.is_inside)

    @cached_property
    def shown(self) -> NDArray[np.float32]:
        """Return what C2 shows of them, (n, N_SHOWN) as in `_orders`."""
        return self._at(self.candidates.shown)

    @cached_property
    def extra(self) -> NDArray[np.float64]:
        """Return what all else has against them, (n,) squared deviations."""
        return self._at(self.candidates.extras).astype(np.float64)

    @cached_property
    def is_seen(self) -> NDArray[np.bool_]:
        """Tell whether C2 sees a point there, (n,); its phase may be too uncertain to judge."""
        return np.asarray(np.isfinite(self.shown[:, _orders.DIFFERENCE]))

    @cached_property
    def depth_mm(self) -> NDArray[np.float64]:
        """Return the distance along the ray, (n,)."""
        return self.shown[:, _orders.DEPTH].astype(np.float64)

    def _at(self, table: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(table[np.arange(len(self.place)), self.place])

    def clear(self, pixels: NDArray[np.float64], where: NDArray[Any], /) -> Evidence:
        """Return what some of the pixels tell of the calibration."""
        shown = self.shown[where].astype(np.float64)
        return Evidence(
            pixels=pixels[where],
            depths_mm=shown[:, _orders.DEPTH],
            difference=shown[:, _orders.DIFFERENCE],
            gradient=shown[:, [_orders.GRADIENT_X, _orders.GRADIENT_Y]],
            variance=shown[:, _orders.VARIANCE],
        )
