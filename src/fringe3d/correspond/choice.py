"""The candidates of each pixel, and which of them is chosen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond import _orders
from fringe3d.correspond.bias import Evidence

Places = NDArray[np.intp]
Index = NDArray[np.intp] | slice
Shown = NDArray[np.float32]


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


class Table(Protocol):
    """What is known of the candidates of each pixel; each method for one of each, or of some."""

    def orders(self, place: Places, index: Index = ..., /) -> NDArray[np.int32]:
        """Return the orders, `NO_ORDER` for none."""

    def costs(self, place: Places, index: Index = ..., /) -> NDArray[np.float32]:
        """Return the squared deviation in C2 over its variance, NaN where it sees no point."""

    def both(self, place: Places, index: Index = ..., /) -> tuple[Shown, NDArray[np.float32]]:
        """Return `shown` and `costs`."""

    def extras(self, place: Places, index: Index = ..., /) -> NDArray[np.float32]:
        """Return what all else has against them, squared deviations."""

    def shown(self, place: Places, index: Index = ..., /) -> Shown:
        """Return what C2 shows of them, (n, N_SHOWN) as in `_orders`."""

    def is_inside(self, place: Places, index: Index = ..., /) -> NDArray[np.bool_]:
        """Tell whether they lie in the volume."""

    def place_of(
        self, orders: NDArray[Any], index: NDArray[Any], /
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return at which place the pixels `index` have given orders, and whether they do."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A `Table` of listed candidates and their costs, (n, m)."""

    candidates: Candidates
    cost: NDArray[np.float32]

    def orders(self, place: Places, index: Index = slice(None), /) -> NDArray[np.int32]:
        """See `Table`."""
        return _at(self.candidates.orders, place, index)

    def costs(self, place: Places, index: Index = slice(None), /) -> NDArray[np.float32]:
        """See `Table`."""
        return _at(self.cost, place, index)

    def both(
        self, place: Places, index: Index = slice(None), /
    ) -> tuple[Shown, NDArray[np.float32]]:
        """See `Table`."""
        return self.shown(place, index), self.costs(place, index)

    def extras(self, place: Places, index: Index = slice(None), /) -> NDArray[np.float32]:
        """See `Table`."""
        return _at(self.candidates.extras, place, index)

    def shown(self, place: Places, index: Index = slice(None), /) -> Shown:
        """See `Table`."""
        return _at(self.candidates.shown, place, index)

    def is_inside(self, place: Places, index: Index = slice(None), /) -> NDArray[np.bool_]:
        """See `Table`."""
        return _at(self.candidates.is_inside, place, index)

    def place_of(
        self, orders: NDArray[Any], index: NDArray[Any], /
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """See `Table`."""
        return self.candidates.place_of(orders, index)


def _at(table: NDArray[Any], place: Places, index: Index) -> NDArray[Any]:
    index = np.arange(len(place)) if isinstance(index, slice) else index
    return np.asarray(table[index, place])


@dataclass(frozen=True, eq=False)
class Choice:
    """Which candidate is chosen for each valid pixel.

    Parameters
    ----------
    table : Table
    place : (n,) int; of the one chosen
    probability : (n,) float
    outside : (n,) float; probability that the point lies outside the volume
    """

    table: Table
    place: NDArray[np.intp]
    probability: NDArray[np.float64]
    outside: NDArray[np.float64]

    @cached_property
    def order(self) -> NDArray[np.int32]:
        """Return the chosen orders, (n,)."""
        return self.table.orders(self.place)

    @cached_property
    def _both(self) -> tuple[Shown, NDArray[np.float32]]:
        return self.table.both(self.place)

    @cached_property
    def cost(self) -> NDArray[np.float64]:
        """Return what C2 has against them, (n,); NaN where it does not see the point."""
        return self._both[1].astype(np.float64)

    def against(self, index: Index, /) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return `cost` and `extra` of some of the pixels."""
        extra = self.table.extras(self.place[index], index)
        return self._both[1][index].astype(np.float64), extra.astype(np.float64)

    @cached_property
    def is_inside(self) -> NDArray[np.bool_]:
        """Tell whether the points lie in the volume, (n,)."""
        return self.table.is_inside(self.place)

    @property
    def shown(self) -> Shown:
        """Return what C2 shows of them, (n, N_SHOWN) as in `_orders`."""
        return self._both[0]

    @cached_property
    def extra(self) -> NDArray[np.float64]:
        """Return what all else has against them, (n,) squared deviations."""
        return self.table.extras(self.place).astype(np.float64)

    @cached_property
    def is_seen(self) -> NDArray[np.bool_]:
        """Tell whether C2 sees a point there, (n,); its phase may be too uncertain to judge."""
        return np.asarray(np.isfinite(self.shown[:, _orders.DIFFERENCE]))

    @cached_property
    def depth_mm(self) -> NDArray[np.float64]:
        """Return the distance along the ray, (n,)."""
        return self.shown[:, _orders.DEPTH].astype(np.float64)

    def moved(
        self, index: NDArray[np.intp], place: Places, probability: NDArray[np.float64], /
    ) -> Choice:
        """Return it with other candidates of the pixels `index`, and all probabilities, (n,)."""
        places = self.place.copy()
        places[index] = place
        other = replace(self, place=places, probability=probability)
        shown, costs = self._both
        if len(index):
            shown, costs = shown.copy(), costs.copy()
            shown[index], costs[index] = self.table.both(place, index)
        other.__dict__["_both"] = shown, costs  # not looked up again
        return other

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
