"""Candidates that are not kept: what C2 shows of them is looked up when it is asked for.

A task of many pixels weighs its candidates once or twice. To list them takes 33 bytes for each,
and more time than to look again at the one of each pixel that is chosen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.correspond._tile import TILE
from fringe3d.correspond.choice import Index, Places, Shown
from fringe3d.kernels import over_rows
from fringe3d.model import NO_ORDER, CalibrationBias, PhaseMap

f4 = np.float32

EXPONENTS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (0, 0), (1, 0), (0, 1))
"""Of u and v in the terms of a bias, of which the last three rise with the depth; see
`fringe3d.model.bias`."""

N_STILL = 6


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """The orders on each pixel's segment: ``found[0] + a * label_step``, up to ``found[1]``.

    Parameters
    ----------
    found, inside : (n, 2) int32; lowest and highest order, and those inside the volume
    label_step : int
    """

    found: NDArray[np.int32]
    inside: NDArray[np.int32]
    label_step: int

    @property
    def n_most(self) -> int:
        """Return how many candidates a pixel has at most."""
        return int(self.counts().max(initial=0))

    def counts(self) -> NDArray[np.int32]:
        """Return how many candidates each pixel has, (n,)."""
        return np.asarray(np.maximum(self._up_to(self.found[:, 1]) + 1, 0))

    def _up_to(self, orders: NDArray[np.int32], /) -> NDArray[np.int32]:
        """Return the last place of each pixel whose order is no higher, (n,)."""
        return np.asarray((orders - self.found[:, 0]) // self.label_step, np.int32)

    def orders(self, place: int, /) -> NDArray[np.int32]:
        """Return the order in one place of each pixel, (n,); `NO_ORDER` for none."""
        orders = self.found[:, 0] + np.int32(place * self.label_step)
        return np.where(orders <= self.found[:, 1], orders, np.int32(NO_ORDER))

    def n_inside(self) -> NDArray[np.int32]:
        """Return how many of them lie inside the volume, (n,)."""
        before = self._up_to(np.maximum(self.inside[:, 0], self.found[:, 0]) - 1)
        last = self._up_to(np.minimum(self.inside[:, 1], self.found[:, 1]))
        return np.asarray(np.maximum(last - before, 0))

    def settled(self, orders: NDArray[np.int32], /) -> Ranges:
        """Return them where pixels with an order, (n,), have no other; `NO_ORDER` for none."""
        is_settled = (orders != NO_ORDER)[:, None]
        return Ranges(np.where(is_settled, orders[:, None], self.found), self.inside,
                      self.label_step)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Unlisted:
    """A `Table` of candidates that are looked up.

    Parameters
    ----------
    ranges : Ranges
    look : returns what C2 shows of the given orders, (k, N_SHOWN), of pixels `index`, and the
        squared deviations, (k,)
    """

    ranges: Ranges
    look: Callable[[NDArray[np.int32], Index], tuple[Shown, NDArray[np.float32]]]

    def orders(self, place: Places, index: Index = slice(None), /) -> NDArray[np.int32]:
        """See `Table`."""
        found, step = self.ranges.found[index], np.int32(self.ranges.label_step)
        orders = found[:, 0] + place.astype(np.int32) * step
        return np.where(orders <= found[:, 1], orders, np.int32(NO_ORDER))

    def both(
        self, place: Places, index: Index = slice(None), /
    ) -> tuple[Shown, NDArray[np.float32]]:
        """See `Table`."""
        return self.look(self.orders(place, index), index)

    def costs(self, place: Places, index: Index = slice(None), /) -> NDArray[np.float32]:
        """See `Table`."""
        return self.both(place, index)[1]

    def extras(self, place: Places, _index: Index = slice(None), /) -> NDArray[np.float32]:
        """See `Table`."""
        return np.zeros(len(place), f4)

    def shown(self, place: Places, index: Index = slice(None), /) -> Shown:
        """See `Table`."""
        return self.both(place, index)[0]

    def is_inside(self, place: Places, index: Index = slice(None), /) -> NDArray[np.bool_]:
        """See `Table`."""
        orders, inside = self.orders(place, index), self.ranges.inside[index]
        return np.asarray((orders >= inside[:, 0]) & (orders <= inside[:, 1]))

    def place_of(
        self, orders: NDArray[Any], index: NDArray[Any], /
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """See `Table`."""
        found, step = self.ranges.found[index], self.ranges.label_step
        place, left = np.divmod(orders - found[:, 0], step)
        there = (left == 0) & (place >= 0) & (orders <= found[:, 1])
        return np.where(there, place, 0).astype(np.intp), there


def has_one_class_a_column(phases: PhaseMap, label_step: int, /) -> bool:
    """Tell whether all orders in a pixel's columns are of its class."""
    names = phases.class_of_order
    return bool((names[label_step:] == names[:-label_step]).all())


def over_tiles(kernel: Callable[..., object], n: int, /, *args: object) -> None:
    """Run a compiled function over all tiles of a list of n pixels, see `over_rows`; where tiles
    begin does not depend on the number of threads."""
    over_rows(kernel, -(-n // TILE), *args)


def field_of(
    bias: CalibrationBias, covariance: NDArray[np.float64] | None, /
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a bias as `_listing.weigh_listed` takes it; covariance (9, 9), px**2, across the
    fringes, None for none."""
    frame = np.concatenate([bias.middle, 1 / bias.scale, [bias.scatter_px]]).astype(f4)
    polynomials = np.zeros((7, 5, 5))
    for a, (i, j) in enumerate(EXPONENTS):
        rises = a >= N_STILL
        polynomials[2 * rises : 2 * rises + 2, i, j] += bias.coefficients_px[:, a]
        for b, (k, m) in enumerate(EXPONENTS if covariance is not None else ()):
            assert covariance is not None
            polynomials[4 + rises + (b >= N_STILL), i + k, j + m] += covariance[a, b]
    return frame, polynomials.astype(f4)
